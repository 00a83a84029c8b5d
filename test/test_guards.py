"""What is checked before anything is sent. Oracles: limits stated in each test; geodesy is tested in test_geodesy."""

from __future__ import annotations

import math

import pytest

from jpap_ros.fleet.config import MapOrigin
from jpap_ros.fleet.fence import Fence
from jpap_ros.mavlink.authority import Authority, Holder
from jpap_ros.mavlink.autopilots import AltitudeDatum
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.mavlink.goals import Goal
from jpap_ros.mavlink.guards import (
    GoalLimits,
    GoalRefused,
    PlanDeadman,
    check_fence,
    check_jump,
    datum_problem,
    echo_problem,
    target_of,
)
from jpap_ros.mavlink.vehicle import Home, TargetEcho, Vehicle

FRAME = LocalFrame(MapOrigin(-37.8136, 144.9631, 20.0))


@pytest.mark.parametrize("field", ["east_m", "north_m", "up_m", "yaw"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_refused_by_name(field: str, value: float) -> None:
    numbers: dict[str, float] = {"east_m": 0.0, "north_m": 0.0, "up_m": 50.0, field: value}
    with pytest.raises(GoalRefused, match=f"{field} must be finite, got {value!r}"):
        target_of(Goal(**numbers), FRAME)


def test_off_the_map_is_refused() -> None:
    with pytest.raises(GoalRefused, match="off the map"):
        target_of(Goal(1e7, 0.0, 50.0), FRAME)


def test_zero_zero_is_refused_although_in_range() -> None:
    with pytest.raises(GoalRefused, match="latitude 0, longitude 0"):
        target_of(Goal(0.0, 0.0, 50.0), LocalFrame(MapOrigin(0.0, 0.0)))


def test_heights_and_heading_of_a_target() -> None:
    target = target_of(Goal(0.0, 0.0, 50.0, yaw=0.0), FRAME)
    # At the origin itself: its own coordinates; AMSL is origin + up; east is 90 degrees clockwise from north.
    assert (target.lat_e7, target.lon_e7) == (-378136000, 1449631000)
    assert (target.height_m, target.amsl_m) == (50.0, 70.0)
    assert target.yaw_ned == pytest.approx(math.pi / 2)


@pytest.mark.parametrize("up_m", [0.0, -50.0, 0.99])
def test_a_height_left_at_zero_does_not_land_an_aircraft(up_m: float) -> None:
    with pytest.raises(GoalRefused, match="at least 1 m above the ground"):
        target_of(Goal(0.0, 0.0, up_m), FRAME)


def test_an_echo_at_another_altitude_is_told() -> None:
    # Meant: home at 33 m AMSL + 50 m = 83 m.
    home = Home(-37.8136, 144.9631, 33.0)
    for frame, altitude_m in ((0, 80.0), (5, 87.9), (3, 47.0), (6, 54.9)):
        assert echo_problem(TargetEcho(0, 0, altitude_m, frame, 0.0), 83.0, home) is None
    for frame, altitude_m, flown in ((5, 50.0, "50.0"), (6, 83.0, "116.0")):
        problem = echo_problem(TargetEcho(0, 0, altitude_m, frame, 0.0), 83.0, home)
        assert problem is not None and flown in problem and "83.0 m is meant" in problem
    # Height above terrain: nothing can be said.
    assert echo_problem(TargetEcho(0, 0, 500.0, 11, 0.0), 83.0, home) is None


def test_fence_and_jump() -> None:
    limits = GoalLimits(Fence(center_m=(0.0, 0.0), radius_m=100.0, min_height_m=5.0, max_height_m=120.0), 500.0)
    check_fence(Goal(60.0, 79.0, 50.0), limits)
    for goal in (Goal(60.0, 81.0, 50.0), Goal(0.0, 0.0, 4.0), Goal(0.0, 0.0, 121.0)):
        with pytest.raises(GoalRefused):
            check_fence(goal, limits)
    check_fence(Goal(1e4, 0.0, 4.0), GoalLimits(None))
    check_jump(499.0, limits)
    for far in (501.0, math.nan):
        with pytest.raises(GoalRefused, match="max_goal_jump_m"):
            check_jump(far, limits)


class TestDatum:
    def vehicle(self, home_amsl_m: float, separation_m: float | None = None) -> Vehicle:
        vehicle = Vehicle(1)
        vehicle.home = Home(-37.8136, 144.9631, home_amsl_m)
        vehicle.geoid_separation_m = separation_m
        return vehicle

    def test_an_origin_near_home_is_right(self) -> None:
        assert datum_problem(self.vehicle(28.0), AltitudeDatum.AMSL, 20.0) is None

    def test_an_origin_above_the_ellipsoid_is_recognised(self) -> None:
        # Melbourne: the ellipsoid's height is 5 m more, Zurich's 48 m more than the height above mean sea level.
        problem = datum_problem(self.vehicle(408.0, 48.0), AltitudeDatum.AMSL, 456.0)
        assert problem is not None and "ellipsoid" in problem and "altitude_datum relative" in problem

    def test_another_wrong_altitude_is_told_without_guessing(self) -> None:
        problem = datum_problem(self.vehicle(408.0, 48.0), AltitudeDatum.AMSL, 0.0)
        assert problem is not None and "ellipsoid" not in problem and "408.0" in problem

    def test_heights_above_home_have_no_datum_to_be_wrong(self) -> None:
        assert datum_problem(self.vehicle(408.0), AltitudeDatum.RELATIVE, 0.0) is None


class TestDeadman:
    def test_the_first_goal_starts_the_clock_and_no_other_does(self) -> None:
        deadman = PlanDeadman(10.0)
        deadman.start(100.0)
        deadman.start(105.0)
        assert deadman.silence_s(109.9) is None
        assert deadman.silence_s(112.0) == 12.0

    def test_silence_counts_from_the_last_sign(self) -> None:
        deadman = PlanDeadman(10.0)
        assert deadman.silence_s(1e6) is None  # there never was a goal
        deadman.feed(100.0)
        assert deadman.silence_s(109.9) is None
        assert deadman.silence_s(112.0) == 12.0
        deadman.feed(112.0)
        assert deadman.silence_s(112.1) is None

    def test_zero_switches_it_off(self) -> None:
        deadman = PlanDeadman(0.0)
        deadman.feed(0.0)
        assert deadman.silence_s(1e9) is None


class TestAuthority:
    """Oracle: "pilot first", followed by hand."""

    def ours(self) -> Authority:
        authority = Authority()
        authority.take({"STABILIZE", "GUIDED"}, 0.0)
        authority.observe("STABILIZE", False, 0.1)
        authority.expect({"GUIDED"}, 1.0)
        assert not authority.observe("GUIDED", True, 1.1)
        return authority

    def test_nobody_has_it_at_first_and_no_mode_matters(self) -> None:
        authority = Authority()
        assert not authority.ours
        assert not authority.observe("LOITER", True, 0.0)
        assert authority.holder is Holder.NOBODY

    def test_a_mode_that_was_not_asked_for_is_a_pilot(self) -> None:
        authority = self.ours()
        assert authority.observe("LOITER", True, 5.0)
        assert authority.holder is Holder.OTHERS
        assert "LOITER" in authority.reason and "bridge/launch" in authority.reason

    def test_it_is_not_taken_back_when_the_mode_returns(self) -> None:
        authority = self.ours()
        authority.observe("LOITER", True, 5.0)
        assert not authority.observe("GUIDED", True, 6.0)
        assert authority.holder is Holder.OTHERS
        authority.expect({"GUIDED"}, 7.0)
        assert not authority.ours
        authority.take({"GUIDED"}, 8.0)
        assert authority.ours and not authority.observe("GUIDED", True, 9.0)

    def test_a_late_heartbeat_is_no_pilot_but_one_that_stays_is(self) -> None:
        authority = self.ours()
        assert not authority.observe("STABILIZE", True, 1.9)
        assert authority.observe("STABILIZE", True, 2.1)

    def test_a_mode_never_asked_for_is_a_pilot_even_right_after_a_change(self) -> None:
        authority = self.ours()
        assert authority.observe("LAND", True, 1.2)

    def test_disarming_is_a_takeover(self) -> None:
        authority = self.ours()
        assert authority.observe("GUIDED", False, 5.0)
        assert "disarmed" in authority.reason

    def test_released_is_not_watched(self) -> None:
        authority = self.ours()
        authority.release("returns home")
        assert not authority.observe("RTL", True, 5.0)
        assert (authority.holder, authority.reason) == (Holder.NOBODY, "returns home")

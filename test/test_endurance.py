"""When a battery is low and when it is critical. Oracle: distances, speeds and drains worked by hand."""

import math

import pytest

from jpap_ros.fleet.endurance import Endurance, EndurancePolicy

# At 10 m/s over ground and 2 m/s up, a full battery for 1000 s: 0.001 a second until it is measured.
POLICY = EndurancePolicy(
    endurance_s=1000.0, cruise_m_s=10.0, climb_m_s=2.0, way_factor=1.5, relief_slack_s=40.0, station_above_m=10.0
)
PAD, STATION = (0.0, 0.0, 0.0), (1200.0, 0.0, 50.0)


def taken_off():
    """Return an aircraft that took off at PAD at 100 s with 90 %."""
    endurance = Endurance(POLICY)
    endurance.observe(99.0, "a", False, 0.9, PAD)
    endurance.observe(100.0, "a", True, 0.9, (0.0, 0.0, 1.0))
    return endurance


def test_the_way_of_the_nearest_relief_counts_twice_there_and_back_home():
    endurance = taken_off()
    # Home is 1200/10 + 60/2 = 150 s away: 0.15, and 0.05 to land with.
    assert endurance.critical(110.0, "a", 0.89, STATION) == pytest.approx(0.2)
    # The nearest relief needs 60 + 30 = 90 s, half as much again for turns, and 40 s: 175 s, 0.175 more.
    reliefs = [(0.0, 0.0, 0.0), (600.0, 0.0, 0.0)]
    assert endurance.low(110.0, "a", 0.89, STATION, reliefs) == pytest.approx(0.375)
    # Without a reserve, the next one will start where this one did: 265 s.
    assert endurance.low(110.0, "a", 0.89, STATION, []) == pytest.approx(0.465)


def test_near_home_and_relief_the_fixed_shares_count():
    endurance = taken_off()
    near = (0.0, 0.0, 50.0)
    assert endurance.critical(110.0, "a", 0.89, near) == POLICY.critical_battery
    assert endurance.low(110.0, "a", 0.89, near, [PAD]) == POLICY.low_battery


def test_far_away_both_stay_below_what_a_launch_needs():
    endurance = taken_off()
    far = (9000.0, 0.0, 50.0)
    assert endurance.critical(110.0, "a", 0.89, far) == pytest.approx(0.5)
    assert endurance.low(110.0, "a", 0.89, far, []) == pytest.approx(0.55)


@pytest.mark.parametrize(
    ("now_s", "battery", "drain"),
    [
        (150.0, 0.5, 0.001),  # after 50 s nothing is measured yet
        (200.0, 0.7, 0.002),  # 0.2 in 100 s
        (200.0, 0.9, 0.0005),  # whole per cent may not have changed: half the plan's at least
        (200.0, math.nan, 0.001),
    ],
)
def test_the_drain_is_measured_from_the_take_off(now_s, battery, drain):
    assert taken_off().drain(now_s, "a", battery) == pytest.approx(drain)


def test_a_jump_is_no_drain():
    endurance = taken_off()
    endurance.observe(199.0, "a", True, 0.7, STATION)
    assert endurance.drain(199.0, "a", 0.7) == pytest.approx(0.2 / 99)
    endurance.observe(200.0, "a", True, 0.28, STATION)
    assert endurance.drain(201.0, "a", 0.28) == 0.001
    endurance.observe(300.0, "a", True, 0.18, STATION)
    assert endurance.drain(300.0, "a", 0.08) == pytest.approx(0.002)
    endurance.observe(301.0, "a", True, 1.0, STATION)
    assert endurance.drain(302.0, "a", 1.0) == 0.001


def test_a_flight_begins_anew_after_a_landing():
    endurance = taken_off()
    endurance.observe(300.0, "a", False, 1.0, PAD)
    endurance.observe(400.0, "a", True, 1.0, PAD)
    assert endurance.drain(500.0, "a", 0.8) == pytest.approx(0.002)


def test_of_one_that_is_first_seen_in_the_air_no_home_is_known():
    endurance = Endurance(POLICY)
    endurance.observe(0.0, "a", True, 0.9, STATION)
    assert endurance.critical(10.0, "a", 0.9, STATION) == POLICY.critical_battery
    assert endurance.low(10.0, "a", 0.9, STATION, []) == POLICY.low_battery


def test_time_left_is_what_lies_above_critical():
    endurance = taken_off()
    assert endurance.left_s(110.0, "a", 0.5, STATION) == pytest.approx(300.0)  # (0.5 - 0.2) / 0.001
    assert endurance.left_s(110.0, "a", math.nan, STATION) == 0.0
    assert endurance.left_s(110.0, "a", 0.1, STATION) == 0.0


@pytest.mark.parametrize("name", ["endurance_s", "cruise_m_s", "climb_m_s"])
def test_what_is_divided_by_must_not_be_zero(name):
    with pytest.raises(ValueError, match=f"{name} must be greater than 0, got 0"):
        EndurancePolicy(**{name: 0})

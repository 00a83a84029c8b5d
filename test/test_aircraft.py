"""One aircraft in the bridge's care, on a fake clock with a fake wire.

Oracle: what DESIGN.md and MAVLINK.md demand, stated in each test; messages are made by pymavlink.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.fleet.config import MapOrigin, UavConfig
from jpap_ros.fleet.fence import Fence
from jpap_ros.fleet.traffic import Setpoint
from jpap_ros.mavlink import procedures
from jpap_ros.mavlink.aircraft import Aircraft
from jpap_ros.mavlink.aircraft_settings import AircraftSettings
from jpap_ros.mavlink.autopilots import Transport
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.mavlink.goals import Goal, GoalState
from jpap_ros.mavlink.guards import GoalLimits, PlanDeadman
from jpap_ros.mavlink.problems import problems_of
from jpap_ros.mavlink.streams import WANTED

ORIGIN = MapOrigin(-37.8136, 144.9631, 20.0)
VEHICLE = (1, 1)
GUIDED, LOITER = 4, 5


class Rig:
    """An aircraft, its clock and its wire; commands are answered at once, as a perfect autopilot would."""

    def __init__(self, config: UavConfig | None = None, answers: bool = True, **settings: Any) -> None:
        self.now = 100.0
        self.wire: list[Any] = []
        self.deadman = PlanDeadman(0.0)
        self.answers = answers
        self.mode, self.autopilot = GUIDED, 3
        self.aircraft = Aircraft(
            config or UavConfig("uav1", 1, ()),
            LocalFrame(ORIGIN),
            AircraftSettings(**settings),
            (245, 191),
            self._send,
            self.deadman,
            {message_id: wanted.rate_hz for message_id, wanted in WANTED.items()},
        )
        self.done: list[tuple[bool, str]] = []

    def _send(self, message: Any) -> None:
        self.wire.append(message)
        if self.answers and message.get_type().startswith("COMMAND"):
            if message.command == mavlink.MAV_CMD_DO_SET_MODE:
                main, sub = int(message.param2), int(message.param3)
                self.mode = main if self.autopilot == 3 else main << 16 | sub << 24
            self.hear(mavlink.MAVLink_command_ack_message(message.command, 0, 0, 0, 245, 191))

    def hear(self, message: Any, source: tuple[int, int] = VEHICLE) -> None:
        self.aircraft.hear(message, source, self.now)

    def heartbeat(self, autopilot: int | None = None, kind: int = mavlink.MAV_TYPE_QUADROTOR, status: int = 4) -> None:
        autopilot = self.autopilot if autopilot is None else autopilot
        self.hear(mavlink.MAVLink_heartbeat_message(kind, autopilot, 0x81, self.mode, status, 3))

    def position(self, east_m: float = 0.0, north_m: float = 0.0, up_m: float = 50.0) -> None:
        lat, lon = LocalFrame(ORIGIN).to_geodetic(east_m, north_m)
        up_mm = round(up_m * 1e3)
        self.hear(
            mavlink.MAVLink_global_position_int_message(
                round(self.now * 1e3), round(lat * 1e7), round(lon * 1e7), 20_000 + up_mm, up_mm, 0, 0, 0, 0
            )
        )

    def flying(self, home: bool = True) -> None:
        """Everything that a healthy aircraft in the air says."""
        self.heartbeat()
        self.hear(mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 15_900, -1, 87, 0, 0, 0, 0, 0, 0))
        self.landed_state()
        if home:
            lat, lon = round(ORIGIN.latitude * 1e7), round(ORIGIN.longitude * 1e7)
            self.hear(mavlink.MAVLink_home_position_message(lat, lon, 20_000, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0))
        self.position()

    def landed_state(self) -> None:
        self.hear(mavlink.MAVLink_extended_sys_state_message(0, mavlink.MAV_LANDED_STATE_IN_AIR))

    def run(self, seconds: float, position: bool = True, landed: bool = True) -> None:
        for tenth in range(round(seconds * 10)):
            self.now += 0.1
            if tenth % 10 == 0:
                self.heartbeat()
            if position and tenth % 5 == 0:
                self.position()
            if landed and tenth % 5 == 0:
                self.landed_state()
            self.aircraft.tick(self.now)

    def launched(self) -> Rig:
        self.flying()
        self.aircraft.run(procedures.launch(self.aircraft), lambda ok, text: self.done.append((ok, text)), "launch")
        self.run(1.0)
        assert self.done == [(True, "in the air already; flies its goals now")]
        return self

    @property
    def targets(self) -> list[Any]:
        return [m for m in self.wire if m.get_type() == "SET_POSITION_TARGET_GLOBAL_INT"]

    @property
    def goal(self) -> tuple[GoalState, str]:
        return self.aircraft.life.state, self.aircraft.life.reason


def test_nothing_is_flown_before_a_launch_even_in_the_right_mode_and_in_the_air() -> None:
    rig = Rig()
    rig.flying()
    rig.aircraft.set_goal(Goal(100.0, 0.0, 50.0))
    rig.run(5.0)
    assert rig.targets == []
    assert rig.goal == (GoalState.NONE, "waiting for bridge/launch")


def test_targets_flow_at_the_rate_asked_for_and_a_new_goal_at_once() -> None:
    rig = Rig(setpoint_rate_hz=2.0).launched()
    rig.aircraft.set_goal(Goal(100.0, 0.0, 50.0))
    rig.run(0.1)
    rig.wire.clear()
    rig.run(10.0)
    assert 19 <= len(rig.targets) <= 21
    rig.wire.clear()
    rig.aircraft.set_goal(Goal(0.0, 100.0, 50.0))
    rig.aircraft.tick(rig.now)
    assert len(rig.targets) == 1
    lat, lon = LocalFrame(ORIGIN).to_geodetic(0.0, 100.0)
    assert (rig.targets[0].lat_int, rig.targets[0].lon_int) == (round(lat * 1e7), round(lon * 1e7))


def test_a_gap_in_positions_turns_nobody_back() -> None:
    rig = Rig().launched()
    rig.aircraft.set_goal(Goal(100.0, 0.0, 50.0))
    rig.run(2.0)
    before = rig.targets[-1].lon_int
    rig.wire.clear()
    rig.run(8.0, position=False)
    assert {m.lon_int for m in rig.targets} == {before}
    assert rig.goal[0] is not GoalState.NONE


def test_without_a_position_it_holds_in_the_end_where_it_was_last_heard() -> None:
    """Oracle: 10 s by hand. Nothing else could be known of how it flies on."""
    rig = Rig().launched()
    rig.aircraft.set_goal(Goal(100.0, 0.0, 50.0))
    rig.run(1.0)
    rig.position(east_m=20.0)
    rig.run(9.8, position=False)
    assert rig.goal[0] is GoalState.EN_ROUTE
    rig.wire.clear()
    rig.run(3.0, position=False)
    assert rig.goal == (GoalState.NONE, "waiting: its position is not known")
    assert len({(m.lat_int, m.lon_int, m.alt) for m in rig.targets[1:]}) == 1
    last = rig.targets[-1]
    assert LocalFrame(ORIGIN).to_map(last.lat_int / 1e7, last.lon_int / 1e7) == pytest.approx((20.0, 0.0), abs=0.1)
    rig.run(1.0)
    assert rig.goal[0] is GoalState.SENT


@pytest.mark.parametrize("transport", list(Transport))
@pytest.mark.parametrize("autopilot", [3, 12])
def test_who_is_told_to_hold_and_does_not_tell_its_home_holds(autopilot: int, transport: Transport) -> None:
    """ArduPilot's hold and PX4's with `reposition` are targets; the vehicle's own altitude needs no home."""
    rig = Rig(transport=transport)
    rig.autopilot = autopilot
    rig.flying(home=False)
    rig.aircraft.run(procedures.hold(rig.aircraft), lambda ok, text: rig.done.append((ok, text)), "hold")
    rig.run(3.0)
    ((success, _),) = rig.done
    assert success
    positions = [m for m in rig.wire if m.get_type() == "COMMAND_INT" and m.command == mavlink.MAV_CMD_DO_REPOSITION]
    sent = [(m.coordinate_frame, m.alt) for m in rig.targets] + [(m.frame, m.z) for m in positions]
    assert set(sent) == (set() if (autopilot, transport) == (12, Transport.SETPOINT) else {(5, 70.0)})


def test_a_target_that_cannot_be_encoded_is_told_and_nothing_is_sent() -> None:
    rig = Rig().launched()
    rig.aircraft.set_goal(Goal(100.0, 0.0, 50.0))
    rig.run(1.0)
    assert rig.goal[0] is GoalState.SENT
    rig.wire.clear()
    rig.aircraft.vehicle.home = None
    rig.run(2.0)
    assert rig.goal[0] is GoalState.REJECTED and "home is not set" in rig.goal[1]
    assert rig.targets == []


HOLD_PX4 = 4 << 16 | 3 << 24


@pytest.mark.parametrize(
    ("message", "taken"),
    [
        (mavlink.MAVLink_set_mode_message(1, 1, HOLD_PX4), True),
        (mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_DO_SET_MODE, 0, 1, 4, 3, 0, 0, 0, 0), True),
        (
            mavlink.MAVLink_command_int_message(1, 1, 5, mavlink.MAV_CMD_DO_REPOSITION, 0, 0, -1, 1, 0, 0, 1, 1, 50),
            True,
        ),
        (mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_DO_PAUSE_CONTINUE, 0, 0, 0, 0, 0, 0, 0, 0), True),
        (mavlink.MAVLink_mission_item_int_message(1, 1, 0, 6, 16, 2, 0, 0, 0, 0, 0, 1, 1, 50), True),
        (mavlink.MAVLink_mission_item_int_message(1, 1, 0, 6, 16, 0, 1, 0, 0, 0, 0, 1, 1, 50), False),
        # What a heartbeat will show, if it is done; and what changes nothing.
        (mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_DO_SET_MODE, 0, 1, 4, 5, 0, 0, 0, 0), False),
        (mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, 33, 0, 0, 0, 0, 0, 0), False),
        (mavlink.MAVLink_param_request_list_message(1, 1), False),
    ],
)
def test_a_station_that_steers_in_the_very_mode_of_the_goals_has_the_aircraft(message: Any, taken: bool) -> None:
    """PX4 by reposition: Hold is the mode of the goals and of the station's Hold alike."""
    rig = Rig(transport=Transport.REPOSITION)
    rig.autopilot, rig.mode = 12, HOLD_PX4
    rig.launched()
    rig.aircraft.set_goal(Goal(100.0, 0.0, 50.0))
    rig.run(1.0)
    parser = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    (heard,) = mavlink.MAVLink(None).parse_buffer(message.pack(parser)) or []
    rig.aircraft.overhear(heard, rig.now)
    rig.wire.clear()
    rig.aircraft.set_goal(Goal(50.0, 0.0, 50.0))
    rig.run(3.0)
    assert rig.aircraft.authority.ours is not taken
    assert bool([m for m in rig.wire if getattr(m, "command", 0) == mavlink.MAV_CMD_DO_REPOSITION]) is not taken
    if taken:
        assert rig.goal[0] is GoalState.YIELDED and "sysid 255" in rig.goal[1] and message.get_type() in rig.goal[1]


def test_an_error_that_nobody_foresaw_leaves_it_to_its_autopilot_until_the_next_order() -> None:
    rig = Rig().launched()
    rig.aircraft.set_goal(Goal(100.0, 0.0, 50.0))
    rig.run(1.0)
    assert rig.aircraft.fail(KeyError("x"), rig.now) and not rig.aircraft.fail(KeyError("x"), rig.now)
    rig.wire.clear()
    rig.run(3.0)
    assert rig.targets == [] and rig.goal[0] is GoalState.YIELDED
    assert any("KeyError" in problem for problem in problems_of(rig.aircraft))
    rig.aircraft.run(procedures.hold(rig.aircraft), lambda ok, text: rig.done.append((ok, text)), "hold")
    rig.run(1.0)
    assert rig.done[-1][0] and problems_of(rig.aircraft) == [] and rig.targets


def test_a_critical_vehicle_gets_no_goal_and_holds() -> None:
    rig = Rig().launched()
    rig.aircraft.set_goal(Goal(100.0, 0.0, 50.0))
    rig.run(1.0)
    rig.heartbeat(status=mavlink.MAV_STATE_CRITICAL)
    rig.wire.clear()
    rig.aircraft.tick(rig.now)
    assert rig.goal[0] is GoalState.REJECTED and "MAV_STATE 5" in rig.goal[1]
    here = rig.aircraft.vehicle.position
    assert here is not None
    assert [(m.lat_int, m.alt) for m in rig.targets] == [(round(here.latitude * 1e7), 50.0)]


def test_home_not_set_is_told_and_nothing_relative_to_it_is_sent() -> None:
    rig = Rig()
    rig.flying(home=False)
    rig.aircraft.run(procedures.launch(rig.aircraft), lambda ok, text: rig.done.append((ok, text)), "launch")
    rig.aircraft.set_goal(Goal(100.0, 0.0, 50.0))
    rig.run(35.0)
    assert rig.done == [(False, "not ready: home is not set")]
    assert rig.targets == []
    assert any("home is not set" in problem for problem in problems_of(rig.aircraft))


def test_a_wrong_altitude_datum_is_refused_before_anything_is_sent() -> None:
    config = UavConfig("uav1", 1, (), altitude_datum="amsl")
    rig = Rig(config)
    rig.flying()
    high = mavlink.MAVLink_home_position_message(1, 1, 408_000, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0)
    rig.hear(high)
    rig.aircraft.run(procedures.launch(rig.aircraft), lambda ok, text: rig.done.append((ok, text)), "launch")
    rig.aircraft.set_goal(Goal(100.0, 0.0, 50.0))
    rig.run(2.0)
    assert rig.goal[0] is GoalState.REJECTED and "altitude datum" in rig.goal[1]
    assert {m.alt for m in rig.targets} == {70.0}, "only the place where it holds, 70 m above mean sea level"
    assert any("altitude datum" in problem for problem in problems_of(rig.aircraft))


@pytest.mark.parametrize(
    ("wanted", "autopilot", "kind", "served", "words"),
    [
        ("auto", 3, mavlink.MAV_TYPE_QUADROTOR, "ardupilot", ""),
        ("auto", 12, mavlink.MAV_TYPE_HEXAROTOR, "px4", ""),
        ("px4", 3, mavlink.MAV_TYPE_QUADROTOR, "", "its heartbeat says ardupilot, the fleet file px4"),
        ("auto", 3, mavlink.MAV_TYPE_FIXED_WING, "", "not a multicopter"),
        ("auto", 0, mavlink.MAV_TYPE_QUADROTOR, "", "MAV_AUTOPILOT 0"),
        ("px4", 0, mavlink.MAV_TYPE_GENERIC, "px4", ""),
    ],
)
def test_who_is_served(wanted: str, autopilot: int, kind: int, served: str, words: str) -> None:
    rig = Rig(UavConfig("uav1", 1, (), autopilot=wanted))
    rig.heartbeat(autopilot, kind)
    rig.aircraft.set_goal(Goal(100.0, 0.0, 50.0))
    rig.aircraft.tick(rig.now)
    assert (rig.aircraft.autopilot.name if rig.aircraft.autopilot else "") == served
    assert words in rig.aircraft.identity_problem
    assert bool(words) == (rig.goal[0] is GoalState.REJECTED)
    assert bool(words) == (rig.wire == []), "an aircraft that is not served is not even asked for telemetry"


def test_gimbals_and_companions_of_the_same_system_are_not_the_vehicle() -> None:
    rig = Rig().launched()
    rig.hear(mavlink.MAVLink_heartbeat_message(26, 8, 0, 0, 4, 3), (1, 154))
    rig.hear(mavlink.MAVLink_heartbeat_message(18, 8, 0, LOITER, 4, 3), (1, 1))
    rig.hear(mavlink.MAVLink_extended_sys_state_message(0, mavlink.MAV_LANDED_STATE_ON_GROUND), (1, 191))
    assert (rig.aircraft.mode, rig.aircraft.vehicle.in_air, rig.aircraft.authority.ours) == ("GUIDED", True, True)


def test_heard_but_never_obeyed() -> None:
    rig = Rig(answers=False)
    rig.flying()
    rig.run(30.0)
    assert rig.targets == []
    (problem,) = problems_of(rig.aircraft)
    assert "does not obey" in problem and "SYSID_ENFORCE" in problem
    # An answer ends it.
    rig.hear(mavlink.MAVLink_command_ack_message(511, 0, 0, 0, 245, 191))
    assert problems_of(rig.aircraft) == []


def test_everything_is_asked_for_again_when_positions_stop() -> None:
    rig = Rig()
    rig.flying()
    rig.run(5.0)
    asked = {round(m.param1) for m in rig.wire if m.get_type() == "COMMAND_LONG" and m.command == 511}
    assert asked == set(WANTED)
    rig.wire.clear()
    rig.run(3.0)
    assert rig.wire == [], "while they come, nothing is asked"
    rig.run(10.0, position=False)
    assert {round(m.param1) for m in rig.wire if m.command == 511} == set(WANTED)


def test_the_landed_state_alone_is_asked_for_again_when_it_falls_silent() -> None:
    rig = Rig()
    rig.flying()
    rig.run(5.0)
    rig.wire.clear()
    rig.run(10.0, landed=False)
    asked = {round(m.param1) for m in rig.wire if m.command == 511}
    assert asked == {mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE}
    rig.run(1.0)
    rig.wire.clear()
    rig.run(5.0)
    assert rig.wire == []


def test_the_deadman_holds_and_releases() -> None:
    rig = Rig().launched()
    rig.deadman.timeout_s = 3.0
    rig.deadman.feed(rig.now)
    rig.aircraft.set_goal(Goal(100.0, 0.0, 50.0))
    rig.run(2.0)
    assert rig.goal[0] is GoalState.SENT
    rig.run(2.0)
    assert rig.goal == (GoalState.NONE, "planner silent for 4 s: it holds")
    rig.deadman.feed(rig.now)
    rig.run(0.2)
    assert rig.goal[0] is GoalState.SENT


def test_a_goal_far_from_where_a_pilot_left_the_aircraft_is_refused() -> None:
    rig = Rig().launched()
    rig.aircraft.settings = replace(
        rig.aircraft.settings, limits=replace(rig.aircraft.settings.limits, max_jump_m=200.0)
    )
    rig.aircraft.set_goal(Goal(100.0, 0.0, 50.0))
    rig.run(1.0)
    assert rig.goal[0] is GoalState.SENT
    rig.mode = LOITER
    rig.heartbeat()
    rig.position(-1000.0)
    rig.aircraft.tick(rig.now)
    assert rig.goal[0] is GoalState.YIELDED
    rig.aircraft.run(procedures.launch(rig.aircraft), lambda ok, text: rig.done.append((ok, text)), "launch")
    for _ in range(20):
        rig.now += 0.1
        rig.heartbeat()
        rig.position(-1000.0)
        rig.aircraft.tick(rig.now)
    assert rig.goal == (GoalState.REJECTED, "goal is 1100 m away, most 200 m (max_goal_jump_m)")


def echo(rig: Rig, up_m: float, east_m: float = 0.0) -> None:
    """ArduPilot's POSITION_TARGET_GLOBAL_INT: frame 0, above mean sea level; home is at 20 m."""
    lat, lon = LocalFrame(ORIGIN).to_geodetic(east_m, 0.0)
    zeros = [0.0] * 8
    rig.hear(
        mavlink.MAVLink_position_target_global_int_message(
            0, 0, 0x0DF8, round(lat * 1e7), round(lon * 1e7), 20.0 + up_m, *zeros
        )
    )


def test_a_moving_target_goes_out_with_its_velocity_in_north_east_down_and_at_least_5_hz() -> None:
    # By hand from the message definition: POSITION_TARGET_TYPEMASK ignores acceleration (64 + 128 + 256), yaw (1024)
    # and yaw rate (2048), but neither position (1, 2, 4) nor velocity (8, 16, 32): 448 + 3072 = 3520.
    rig = Rig(setpoint_rate_hz=1.0).launched()
    rig.aircraft.set_goal(Goal(100.0, 0.0, 50.0))
    rig.wire.clear()
    rig.aircraft.setpoint = Setpoint((10.0, 20.0, 60.0), (3.0, -4.0, 0.5))
    rig.run(2.0)
    lat, lon = LocalFrame(ORIGIN).to_geodetic(10.0, 20.0)
    first = rig.targets[0]
    assert first.type_mask == 3520 == 0x0DC0
    assert (first.lat_int, first.lon_int, first.alt) == (round(lat * 1e7), round(lon * 1e7), 60.0)
    # East 3, north -4, up 0.5 is north -4, east 3, down -0.5.
    assert (first.vx, first.vy, first.vz) == (-4.0, 3.0, -0.5)
    assert 9 <= len(rig.targets) <= 11
    # At rest in the end: position alone (mask 0x0DF8), at the slow rate asked for.
    rig.aircraft.setpoint = Setpoint((100.0, 0.0, 50.0))
    rig.run(0.2)
    assert rig.targets[-1].type_mask == 0x0DF8
    rig.wire.clear()
    rig.run(5.0)
    assert 4 <= len(rig.targets) <= 6


def test_under_traffic_control_nothing_but_its_setpoint_is_flown() -> None:
    rig = Rig().launched()
    rig.aircraft.under_traffic_control = True
    rig.aircraft.set_goal(Goal(100.0, 0.0, 50.0))
    rig.wire.clear()
    rig.run(1.0)
    assert rig.goal == (GoalState.NONE, "waiting for traffic control")
    here = round(ORIGIN.longitude * 1e7)
    assert {m.lon_int for m in rig.targets} == {here}, "it holds where it is"
    rig.aircraft.setpoint = Setpoint((1.0, 0.0, 50.0), (1.0, 0.0, 0.0))
    rig.run(0.2)
    assert rig.goal[0] is GoalState.SENT and rig.targets[-1].lon_int > here


def test_who_follows_a_detour_obeys_and_who_stays_behind_does_not() -> None:
    # PX4 echoes nothing in OFFBOARD, so where it is has to do. OBEY_TIMEOUT_S is 5 s, FOLLOWING_M 5 m.
    rig = Rig().launched()
    rig.aircraft.under_traffic_control = True
    rig.aircraft.set_goal(Goal(100.0, 0.0, 50.0))
    rig.aircraft.setpoint = Setpoint((0.0, 0.0, 52.0), (0.0, 0.0, 1.0))
    rig.run(10.0)
    assert rig.goal[0] is GoalState.SENT
    rig.aircraft.setpoint = Setpoint((0.0, 0.0, 58.0), (0.0, 0.0, 1.0))
    rig.run(6.0)
    assert rig.goal[0] is GoalState.REJECTED and "no sign of obeying" in rig.goal[1]


def test_an_echo_of_a_target_before_is_no_wrong_altitude_datum_but_one_that_stays_is() -> None:
    rig = Rig().launched()
    rig.aircraft.under_traffic_control = True
    rig.aircraft.set_goal(Goal(0.0, 0.0, 30.0))
    # Relief waits 12 m above its cell, and then drops to it.
    rig.aircraft.setpoint = Setpoint((0.0, 0.0, 42.0))
    rig.run(1.0)
    rig.aircraft.setpoint = Setpoint((0.0, 0.0, 30.0))
    rig.run(0.5)
    assert rig.targets[-1].alt == 30.0
    echo(rig, 42.0)
    assert rig.goal[0] is GoalState.ACCEPTED and problems_of(rig.aircraft) == []
    rig.run(4.0)
    # Nothing was heard since: still no reason to think so.
    assert problems_of(rig.aircraft) == []
    echo(rig, 42.0)
    (problem,) = problems_of(rig.aircraft)
    assert "altitude datum" in problem and "62.0 m" in problem and "50.0 m" in problem
    echo(rig, 30.0)
    assert problems_of(rig.aircraft) == []


def test_while_the_target_moves_an_echo_nearby_is_of_it() -> None:
    # 500 units of 1e-7 deg of latitude are 5.6 m; a target at rest allows 2 units, 2 cm.
    rig = Rig().launched()
    rig.aircraft.set_goal(Goal(100.0, 0.0, 50.0))
    rig.aircraft.setpoint = Setpoint((10.0, 0.0, 50.0), (1.0, 0.0, 0.0))
    rig.run(0.1)
    echo(rig, 50.0, east_m=8.0)
    assert rig.goal[0] is GoalState.SENT, "it has not moved yet"
    rig.aircraft.setpoint = Setpoint((11.0, 0.0, 50.0), (1.0, 0.0, 0.0))
    rig.run(0.2)
    echo(rig, 50.0, east_m=30.0)
    assert rig.goal[0] is GoalState.SENT, "that is somewhere else"
    echo(rig, 50.0, east_m=8.0)
    assert rig.goal[0] is GoalState.ACCEPTED


def test_after_a_lost_link_nothing_is_sent_and_nobody_reckons_with_it_before_it_says_where_it_is() -> None:
    """Oracle: the issue's rule that unclear state makes an aircraft hold; where it was is not where it is."""
    rig = Rig().launched()
    rig.aircraft.under_traffic_control = True
    rig.position(6.5)
    rig.aircraft.set_goal(Goal(100.0, 0.0, 50.0))
    rig.aircraft.setpoint = Setpoint((6.5, 0.0, 50.0))
    rig.run(1.0, position=False)
    assert rig.aircraft.traveller().obeys and rig.targets
    for _ in range(270):
        rig.now += 0.1
        rig.aircraft.tick(rig.now)
    lost = rig.aircraft.traveller()
    assert not lost.obeys and not lost.heard and lost.flies
    rig.aircraft.setpoint = None  # traffic control has dismissed it
    rig.wire.clear()
    rig.run(2.0, position=False)
    assert not rig.aircraft.traveller().obeys and rig.aircraft.traveller().heard
    assert rig.targets == []
    assert rig.goal == (GoalState.NONE, "waiting: its position is not known")
    rig.position(60.0)
    back = rig.aircraft.traveller()
    assert back.obeys and back.position == pytest.approx((60.0, 0.0, 50.0), abs=0.1)


def test_a_position_from_just_before_the_link_came_back_does_not_count() -> None:
    rig = Rig().launched()
    rig.aircraft.under_traffic_control = True
    for _ in range(50):
        rig.now += 0.1
        rig.aircraft.tick(rig.now)
    rig.position(6.5)
    rig.now += 0.1
    rig.heartbeat()
    assert not rig.aircraft.traveller().obeys
    rig.position(6.5)
    assert rig.aircraft.traveller().obeys


def test_a_gap_in_positions_takes_nobody_out_of_traffic_control() -> None:
    rig = Rig().launched()
    rig.aircraft.setpoint = Setpoint((0.0, 0.0, 50.0))
    rig.run(10.0, position=False)
    assert rig.aircraft.traveller().obeys


def test_no_setpoint_outside_the_fence_is_sent() -> None:
    """Oracle: a fence of 50 m radius by hand. One outside already may be led back in, but not farther out."""
    rig = Rig(limits=GoalLimits(Fence(center_m=(0.0, 0.0), radius_m=50.0, max_height_m=60.0))).launched()
    rig.aircraft.under_traffic_control = True
    rig.aircraft.set_goal(Goal(40.0, 0.0, 50.0))
    frame = LocalFrame(ORIGIN)

    def sent(here: tuple[float, float], setpoint: Setpoint) -> tuple[float, float]:
        rig.position(*here)
        rig.aircraft.setpoint = setpoint
        rig.wire.clear()
        rig.run(1.0, position=False)
        return frame.to_map(rig.targets[-1].lat_int / 1e7, rig.targets[-1].lon_int / 1e7)

    assert sent((20.0, 0.0), Setpoint((30.0, 0.0, 50.0))) == pytest.approx((30.0, 0.0), abs=0.1)
    for place in ((51.0, 0.0, 50.0), (30.0, 0.0, 61.0)):
        assert sent((20.0, 0.0), Setpoint(place)) == pytest.approx((20.0, 0.0), abs=0.1)
        assert rig.goal == (GoalState.REJECTED, "its way leads out of the fence: it holds")
    assert sent((60.0, 0.0), Setpoint((59.0, 0.0, 50.0), (-5.0, 0.0, 0.0))) != pytest.approx((60.0, 0.0), abs=0.1)


def test_without_traffic_control_a_goal_behind_the_fence_is_not_flown_to() -> None:
    notched = ((-10, -10), (110, -10), (110, 100), (60, 100), (60, 20), (40, 20), (40, 100), (-10, 100))
    rig = Rig(limits=GoalLimits(Fence(polygon_m=notched))).launched()
    rig.position(0.0, 80.0)
    rig.aircraft.set_goal(Goal(100.0, 80.0, 50.0))
    rig.wire.clear()
    rig.run(1.0, position=False)
    assert rig.goal == (GoalState.REJECTED, "the straight way to the goal leads out of the fence")
    rig.aircraft.set_goal(Goal(100.0, 0.0, 50.0))
    rig.position(0.0, 0.0)
    rig.run(1.0, position=False)
    assert rig.goal[0] is GoalState.SENT

"""The fleet controller against simulated vehicles over real sockets on loopback.

Oracle: the simulated vehicle's own record of where it is (`position`, which the bridge does not see) and of what
reached it (`received`).
"""

from __future__ import annotations

import math
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import pytest
from fleet_rig import (
    ARM,
    AUTOPILOTS,
    GROUND,
    ORIGIN,
    PATIENCE_S,
    TAKEOFF,
    Rig,
    commands,
    distance,
    order,
    setpoints,
    until,
    velocity,
)
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.fleet.config import FleetConfig, LinkUrl
from jpap_ros.fleet.fence import Fence
from jpap_ros.mavlink.autopilots import Transport
from jpap_ros.mavlink.fleet_controller import ControllerSettings, FleetController, FleetOrder, OrderResult
from jpap_ros.mavlink.goals import Goal, GoalState
from jpap_ros.mavlink.guards import GoalLimits
from jpap_ros.mavlink.vehicle import LinkState
from jpap_ros.sim import VehicleOptions


@pytest.fixture
def rig(free_ports: Callable[[int], list[int]]) -> Iterator[Rig]:
    with ExitStack() as stack:
        yield Rig(stack, free_ports)


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_launch_fly_hold_and_return(rig: Rig, autopilot: str) -> None:
    fleet = rig.fleet(2, autopilot=autopilot)
    sim, controller = rig.launched(fleet)
    goals = {"uav1": Goal(30.0, 40.0, 50.0, plan_id=7), "uav2": Goal(-25.0, 10.0, 35.0, plan_id=7)}
    for name, goal in goals.items():
        controller.set_goal(name, goal)
    for name, goal in goals.items():
        snapshot = rig.watch.until_goal(name, GoalState.REACHED)
        assert snapshot.goal_plan_id == 7 and snapshot.goal_distance_m <= 1.0
        assert distance(sim[name], goal) < 1.5
        seen = rig.watch.goal_states(name)
        flight = seen[seen.index(GoalState.SENT) :]
        # At ten times the speed an echo may come after the first progress.
        assert flight == sorted(flight) and flight[-1] is GoalState.REACHED
        assert len(commands(sim[name], ARM)) == len(commands(sim[name], TAKEOFF)) == 1

    results = order(controller, FleetOrder.HOLD, fleet.names)
    assert all(result.success for result in results.values()), results
    controller.set_goal("uav1", Goal(300.0, 0.0, 50.0))
    held = rig.watch.until("uav1", lambda s: s.goal_state is GoalState.NONE and "held by the operator" in s.goal_reason)
    assert held.link is LinkState.CONNECTED
    assert distance(sim["uav1"], goals["uav1"]) < 1.5

    results = order(controller, FleetOrder.RETURN_HOME, ("uav2",))
    assert results["uav2"].success, results
    assert rig.watch.now("uav2").mode in ("RTL", "AUTO.RTL")
    rig.watch.until("uav2", lambda s: not s.armed)
    assert math.dist(sim["uav2"].position, (20.0, 0.0, 0.0)) < 1.5

    assert order(controller, FleetOrder.LAUNCH, ("uav1",))["uav1"].success
    rig.watch.until_goal("uav1", GoalState.EN_ROUTE)


@pytest.mark.parametrize(
    ("goal", "words"),
    [
        (Goal(600.0, 0.0, 50.0), "outside"),
        (Goal(0.0, 0.0, 300.0), "height"),
        (Goal(math.nan, 0.0, 50.0), "east_m must be finite"),
        (Goal(0.0, 450.0, 50.0), "max_goal_jump_m"),
    ],
)
def test_a_goal_that_must_not_be_flown_never_reaches_the_wire(rig: Rig, goal: Goal, words: str) -> None:
    fleet = rig.fleet()
    limits = GoalLimits(Fence(center_m=GROUND, radius_m=500.0, max_height_m=100.0), max_jump_m=300.0)
    sim, controller = rig.launched(fleet, limits=limits)
    controller.set_goal("uav1", Goal(50.0, 0.0, 50.0))
    rig.watch.until_goal("uav1", GoalState.REACHED)
    with sim["uav1"].lock:
        sim["uav1"].received.clear()
    controller.set_goal("uav1", goal)
    rejected = rig.watch.until_goal("uav1", GoalState.REJECTED)
    assert words in rejected.goal_reason
    until(lambda: len(setpoints(sim["uav1"])) >= 3, "the stream goes on, for holding")
    for message in setpoints(sim["uav1"]):
        here = sim["uav1"].frame.to_map(message.lat_int / 1e7, message.lon_int / 1e7)
        assert math.dist((*here, message.alt), (50.0, 0.0, 50.0)) < 2.0


def test_no_goal_any_more_means_hold(rig: Rig) -> None:
    fleet = rig.fleet()
    sim, controller = rig.launched(fleet)
    controller.set_goal("uav1", Goal(3000.0, 0.0, 50.0))
    rig.watch.until_goal("uav1", GoalState.EN_ROUTE)
    controller.clear_goal("uav1", "no cell in plan 8")
    cleared = rig.watch.until_goal("uav1", GoalState.NONE)
    assert cleared.goal_reason == "no cell in plan 8" and math.isnan(cleared.goal_distance_m)
    until(lambda: math.hypot(*velocity(sim["uav1"])) < 0.1, "it stands in the air")
    assert sim["uav1"].position[0] < 2000.0


@pytest.mark.parametrize("kind", ["udpin", "udpout", "tcp"])
@pytest.mark.parametrize("bridge_first", [True, False])
def test_any_order_of_starting_on_any_link(rig: Rig, kind: str, bridge_first: bool) -> None:
    fleet = rig.fleet(kind=kind)
    if bridge_first:
        rig.control(fleet)
        rig.watch.until("uav1", lambda s: s.link is LinkState.NEVER_SEEN)
        rig.fly(fleet)
    else:
        rig.fly(fleet)
        rig.control(fleet)
    rig.watch.until("uav1", lambda s: s.link is LinkState.CONNECTED and s.position is not None)


def test_goals_by_reposition_command(rig: Rig) -> None:
    fleet = rig.fleet(1)
    sim, controller = rig.launched(fleet, transport=Transport.REPOSITION)
    goal = Goal(40.0, 30.0, 30.0)
    controller.set_goal("uav1", goal)
    rig.watch.until_goal("uav1", GoalState.REACHED)
    assert distance(sim["uav1"], goal) < 1.5
    assert setpoints(sim["uav1"]) == []


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_heights_above_mean_sea_level(rig: Rig, autopilot: str) -> None:
    fleet = rig.fleet(autopilot=autopilot, altitude_datum="amsl")
    sim, controller = rig.launched(fleet)
    controller.set_goal("uav1", Goal(20.0, 0.0, 40.0))
    rig.watch.until_goal("uav1", GoalState.REACHED)
    # Ground at the origin's 20 m, goal 40 m above it.
    assert {(m.coordinate_frame, round(m.alt, 3)) for m in setpoints(sim["uav1"])[-1:]} == {(5, 60.0)}
    assert distance(sim["uav1"], Goal(20.0, 0.0, 40.0)) < 1.5


@pytest.mark.parametrize(("autopilot", "left_in"), [("ardupilot", "GUIDED"), ("px4", "HOLD")])
def test_how_aircraft_are_left_when_the_bridge_stops(rig: Rig, autopilot: str, left_in: str) -> None:
    fleet = rig.fleet(autopilot=autopilot)
    sim, controller = rig.launched(fleet)
    controller.set_goal("uav1", Goal(30.0, 0.0, 30.0))
    rig.watch.until_goal("uav1", GoalState.REACHED)
    controller.close()
    assert (sim["uav1"].mode, sim["uav1"].armed) == (left_in, True)


def test_an_order_replaces_the_one_before(rig: Rig) -> None:
    fleet = rig.fleet()
    sim = rig.fly(fleet, VehicleOptions(gps_delay_s=1e6))
    controller = rig.control(fleet)
    first = controller.order(FleetOrder.LAUNCH, ["uav1"])["uav1"]
    rig.watch.until("uav1", lambda s: s.link is LinkState.CONNECTED)
    assert order(controller, FleetOrder.HOLD, ("uav1",))["uav1"] == OrderResult(True, "on the ground; stays there")
    assert first.result(PATIENCE_S) == OrderResult(False, "superseded by hold")
    assert commands(sim["uav1"]) == []


def test_the_bridges_heartbeat(rig: Rig) -> None:
    """Oracle: MAVLINK.md; heard by a plain socket, decoded by pymavlink."""
    fleet = rig.fleet(kind="udpout")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", fleet.uavs[0].urls[0].port))
        listener.settimeout(PATIENCE_S)
        rig.control(fleet)
        parser = mavlink.MAVLink(None)
        beats, times = [], []
        while len(beats) < 3:
            messages = parser.parse_buffer(listener.recv(2048)) or []
            beats += messages
            times += [time.monotonic()] * len(messages)
    for beat in beats:
        assert beat.get_type() == "HEARTBEAT"
        assert (beat.get_srcSystem(), beat.get_srcComponent()) == (245, 191)
        assert (beat.type, beat.autopilot) == (mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID)
    assert times[2] - times[0] > 1.5, "1 Hz"


def test_a_vehicle_with_two_links_gets_everything_once(rig: Rig) -> None:
    one = rig.fleet().uavs[0]
    second = rig.fleet(kind="tcp").uavs[0].urls
    fleet = FleetConfig(ORIGIN, (replace(one, urls=one.urls + second),))
    sim, controller = rig.launched(fleet)
    goal = Goal(30.0, 40.0, 50.0)
    controller.set_goal("uav1", goal)
    assert rig.watch.until_goal("uav1", GoalState.REACHED).problems == ()
    assert distance(sim["uav1"], goal) < 1.5
    assert [m.command for m in commands(sim["uav1"])] == [mavlink.MAV_CMD_DO_SET_MODE, ARM, TAKEOFF]


def test_ground_stations_are_told_in_words_by_the_aircrafts_onboard_computer(rig: Rig) -> None:
    """Oracle: STATUSTEXT as pymavlink reads it from a plain socket; the text and its 50 bytes by hand."""
    (port,) = rig.ports(1)
    fleet = replace(rig.fleet(), gcs_urls=(LinkUrl("udpout", "127.0.0.1", port),))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind(("127.0.0.1", port))
        station.settimeout(PATIENCE_S)
        rig.control(fleet).announce("uav1", "Plan 7: " + "x" * 100)
        parser = mavlink.MAVLink(None)
        heard: list[Any] = []
        while not any(message.get_type() == "STATUSTEXT" for message in heard):
            heard += parser.parse_buffer(station.recv(2048)) or []
    (words,) = [message for message in heard if message.get_type() == "STATUSTEXT"]
    assert (words.get_srcSystem(), words.get_srcComponent()) == (1, 191)
    assert words.text == "Plan 7: " + "x" * 42


def test_an_own_system_id_that_is_a_vehicles_is_refused(rig: Rig) -> None:
    with pytest.raises(ValueError, match="sysid 1 is that of uav1"):
        FleetController(rig.fleet(), ControllerSettings(sysid=1))

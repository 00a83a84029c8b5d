"""The fleet controller against simulated vehicles over real sockets on loopback.

Oracle: the simulated vehicle's own record of where it is (`position`, which the bridge does not see) and of what
reached it (`received`). One controller serves most tests.
"""

from __future__ import annotations

import math
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any

import pytest
from fleet_rig import (
    ARM,
    GROUND,
    ORIGIN,
    PATIENCE_S,
    TAKEOFF,
    Rig,
    commands,
    distance,
    distinct,
    order,
    setpoints,
    until,
    velocity,
)
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.fleet.config import LinkUrl
from jpap_ros.fleet.fence import Fence
from jpap_ros.fleet.transit_plan import TransitLimits
from jpap_ros.mavlink.aircraft_settings import AircraftSettings
from jpap_ros.mavlink.autopilots import Transport
from jpap_ros.mavlink.fleet_controller import ControllerSettings, FleetController, FleetOrder, OrderResult
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.mavlink.goals import Goal, GoalState
from jpap_ros.mavlink.guards import GoalLimits
from jpap_ros.mavlink.vehicle import LinkState
from jpap_ros.sim import Fence as SimFence
from jpap_ros.sim import SimFleet, VehicleOptions

AUTOPILOTS = ("ardupilot", "px4")


@pytest.fixture
def rig(free_ports: Callable[[int], list[int]]) -> Iterator[Rig]:
    with ExitStack() as stack:
        yield Rig(stack, free_ports)


@dataclass(frozen=True)
class Sky:
    """Vehicles in the air, launched together; each test has some of its own."""

    rig: Rig
    sim: SimFleet
    controller: FleetController


@pytest.fixture(scope="module")
def sky(free_ports: Callable[[int], list[int]]) -> Iterator[Sky]:
    with ExitStack() as stack:
        rig = Rig(stack, free_ports)
        own = {
            f"{purpose}_{autopilot}": {"autopilot": autopilot, **keys}
            for purpose, keys in {"tour": {}, "sent": {}, "amsl": {"altitude_datum": "amsl"}}.items()
            for autopilot in AUTOPILOTS
        }
        fleet = rig.mixed(**own, limited={}, stopped={}, double={})
        double = fleet.uavs[-1]
        second = LinkUrl("tcp", "127.0.0.1", *rig.ports(1))
        fleet = replace(fleet, uavs=(*fleet.uavs[:-1], replace(double, urls=(*double.urls, second))))
        limits = GoalLimits(Fence(center_m=GROUND, radius_m=5000.0, max_height_m=100.0), max_jump_m=3500.0)
        yield Sky(rig, *rig.launched(fleet, limits=limits))


def test_launch_fly_hold_and_return(sky: Sky) -> None:
    watch, names = sky.rig.watch, ("tour_ardupilot", "tour_px4", "sent_ardupilot", "sent_px4")
    places = [(30.0, 40.0, 50.0), (-25.0, 10.0, 35.0), (130.0, 30.0, 40.0), (110.0, -30.0, 45.0)]
    goals = {name: Goal(*place, plan_id=7) for name, place in zip(names, places, strict=True)}
    for name, goal in goals.items():
        sky.controller.set_goal(name, goal)
    for name, goal in goals.items():
        snapshot = watch.until_goal(name, GoalState.REACHED)
        assert snapshot.goal_plan_id == 7 and snapshot.goal_distance_m <= 1.0
        assert distance(sky.sim[name], goal) < 1.5
        seen = watch.goal_states(name)
        flight = seen[seen.index(GoalState.SENT) :]
        # At ten times the speed an echo may come after the first progress.
        assert flight == sorted(flight) and flight[-1] is GoalState.REACHED
        assert len(distinct(sky.sim[name], ARM)) == len(distinct(sky.sim[name], TAKEOFF)) == 1

    results = order(sky.controller, FleetOrder.HOLD, names)
    assert all(result.success for result in results.values()), results
    tour, sent = names[:2], names[2:]
    for name in tour:
        sky.controller.set_goal(name, Goal(300.0, 0.0, 50.0))
        held = watch.until(name, lambda s: s.goal_state is GoalState.NONE and "held by the operator" in s.goal_reason)
        assert held.link is LinkState.CONNECTED
        assert distance(sky.sim[name], goals[name]) < 1.5

    results = order(sky.controller, FleetOrder.RETURN_HOME, sent)
    assert all(result.success for result in results.values()), results
    for name, home in zip(sent, ((100.0, 0.0, 0.0), (150.0, 0.0, 0.0)), strict=True):
        watch.until(name, lambda s: not s.armed)
        assert {"RTL", "AUTO.RTL"} & {seen.mode for seen in watch.history[name]}
        assert math.dist(sky.sim[name].position, home) < 1.5

    assert all(result.success for result in order(sky.controller, FleetOrder.LAUNCH, tour).values())
    for name in tour:
        watch.until_goal(name, GoalState.EN_ROUTE)


@pytest.mark.parametrize(
    ("goal", "words"),
    [
        (Goal(6000.0, 0.0, 50.0), "outside"),
        (Goal(0.0, 0.0, 300.0), "height"),
        (Goal(math.nan, 0.0, 50.0), "east_m must be finite"),
        (Goal(0.0, 4500.0, 50.0), "max_goal_jump_m"),
    ],
)
def test_a_goal_that_must_not_be_flown_never_reaches_the_wire(sky: Sky, goal: Goal, words: str) -> None:
    vehicle, watch = sky.sim["limited"], sky.rig.watch
    sky.controller.set_goal("limited", Goal(350.0, 0.0, 50.0))
    watch.until_goal("limited", GoalState.REACHED)
    with vehicle.lock:
        vehicle.received.clear()
    sky.controller.set_goal("limited", goal)
    rejected = watch.until_goal("limited", GoalState.REJECTED)
    assert words in rejected.goal_reason
    until(lambda: len(setpoints(vehicle)) >= 3, "the stream goes on, for holding")
    for message in setpoints(vehicle):
        here = vehicle.frame.to_map(message.lat_int / 1e7, message.lon_int / 1e7)
        assert math.dist((*here, message.alt), (350.0, 0.0, 50.0)) < 2.0


def test_no_goal_any_more_means_hold(sky: Sky) -> None:
    sky.controller.set_goal("stopped", Goal(3000.0, 0.0, 50.0))
    sky.rig.watch.until_goal("stopped", GoalState.EN_ROUTE)
    sky.controller.clear_goal("stopped", "no cell in plan 8")
    cleared = sky.rig.watch.until_goal("stopped", GoalState.NONE)
    assert cleared.goal_reason == "no cell in plan 8" and math.isnan(cleared.goal_distance_m)
    until(lambda: math.hypot(*velocity(sky.sim["stopped"])) < 0.1, "it stands in the air")
    assert sky.sim["stopped"].position[0] < 2000.0


def test_heights_above_mean_sea_level(sky: Sky) -> None:
    names = ("amsl_ardupilot", "amsl_px4")
    for name in names:
        sky.controller.set_goal(name, Goal(220.0, 0.0, 40.0))
    for name in names:
        sky.rig.watch.until_goal(name, GoalState.REACHED)
        # Ground at the origin's 20 m, goal 40 m above it.
        assert {(m.coordinate_frame, round(m.alt, 3)) for m in setpoints(sky.sim[name])[-1:]} == {(5, 60.0)}
        assert distance(sky.sim[name], Goal(220.0, 0.0, 40.0)) < 1.5


def test_a_vehicle_with_two_links_gets_everything_once(sky: Sky) -> None:
    goal = Goal(430.0, 40.0, 50.0)
    sky.controller.set_goal("double", goal)
    assert sky.rig.watch.until_goal("double", GoalState.REACHED).problems == ()
    assert distance(sky.sim["double"], goal) < 1.5
    assert [m.command for m in distinct(sky.sim["double"])] == [mavlink.MAV_CMD_DO_SET_MODE, ARM, TAKEOFF]


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
    """Neither autopilot is sent a setpoint; PX4 takes goals in Hold."""
    fleet = rig.mixed(ardupilot={"autopilot": "ardupilot"}, px4={"autopilot": "px4"})
    fenced = VehicleOptions(fence=SimFence(radius_m=200.0))
    sim, controller = rig.launched(fleet, {"px4": fenced}, transport=Transport.REPOSITION)
    for goal in (Goal(40.0, 30.0, 30.0, plan_id=1), Goal(10.0, -20.0, 40.0, plan_id=2)):
        for name in fleet.names:
            controller.set_goal(name, goal)
        for name in fleet.names:
            snapshot = rig.watch.until_goal(name, GoalState.REACHED, goal.plan_id)
            assert snapshot.goal_distance_m <= 1.0 and distance(sim[name], goal) < 1.5
    for name, mode in (("ardupilot", "GUIDED"), ("px4", "HOLD")):
        assert sim[name].mode == mode and setpoints(sim[name]) == []
        sent = commands(sim[name], mavlink.MAV_CMD_DO_REPOSITION)
        assert [m.get_type() for m in sent] == ["COMMAND_INT"] * len(sent) and len(sent) >= 2
        assert len(distinct(sim[name], ARM)) == len(distinct(sim[name], TAKEOFF)) == 1
    # PX4 acknowledges what its fence forbids, and stays.
    controller.set_goal("px4", Goal(400.0, 0.0, 30.0, plan_id=3))
    rejected = rig.watch.until_goal("px4", GoalState.REJECTED, 3)
    assert "has not been flown" in rejected.goal_reason and "outside geofence" in rejected.goal_reason


def test_how_aircraft_are_left_when_the_bridge_stops(rig: Rig) -> None:
    fleet = rig.mixed(ardupilot={"autopilot": "ardupilot"}, px4={"autopilot": "px4"})
    sim, controller = rig.launched(fleet)
    for name in fleet.names:
        controller.set_goal(name, Goal(30.0, 0.0, 30.0))
    for name in fleet.names:
        rig.watch.until_goal(name, GoalState.REACHED)
    controller.close()
    for name, left_in in (("ardupilot", "GUIDED"), ("px4", "HOLD")):
        assert (sim[name].mode, sim[name].armed) == (left_in, True)


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
        while len(beats) < 5:
            messages = parser.parse_buffer(listener.recv(2048)) or []
            beats += messages
            times += [time.monotonic()] * len(messages)
    for beat in beats:
        assert beat.get_type() == "HEARTBEAT"
        assert (beat.get_srcSystem(), beat.get_srcComponent()) == (245, 191)
        assert (beat.type, beat.autopilot) == (mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID)
    # Four seconds; the first may have waited for a busy machine, but not for one of them.
    assert times[4] - times[0] > 3.0, "1 Hz"


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


def test_under_traffic_control_nobody_is_sent_out_of_the_fence(rig: Rig) -> None:
    """Oracle: each position target that reached a vehicle, against the fence's heights and notch by hand."""
    west, east, notch = ((-50, 90), (-50, -50)), ((150, -50), (150, 90)), ((65, 90), (65, 20), (35, 20), (35, 90))
    notched = tuple((float(x), float(y)) for x, y in (*west, *east, *notch))
    fence = Fence(polygon_m=notched, max_height_m=40.0)
    fleet = rig.mixed(a={"home_m": (0.0, 0.0)}, b={"home_m": (100.0, 0.0)}, c={"home_m": (0.0, 60.0)})
    sim = rig.fly(fleet)
    aircraft = AircraftSettings(limits=GoalLimits(fence))
    traffic = TransitLimits(min_separation_m=10.0, tracking_error_m=2.0, speed_m_s=8.0)
    controller = rig.control(fleet, ControllerSettings(aircraft=aircraft, launch_stagger_s=0.0, traffic=traffic))
    assert all(result.success for result in order(controller, FleetOrder.LAUNCH, fleet.names).values())
    controller.set_goal("a", Goal(100.0, 0.0, 30.0, plan_id=1))
    controller.set_goal("b", Goal(0.0, 0.0, 30.0, plan_id=1))
    controller.set_goal("c", Goal(100.0, 60.0, 30.0, plan_id=1))
    rig.watch.until("c", lambda s: "the fence" in s.goal_reason)
    for name in ("a", "b"):
        rig.watch.until(name, lambda s: s.goal_state is GoalState.REACHED or "no separated path" in s.goal_reason)
    controller.set_goal("c", Goal(0.0, 80.0, 30.0, plan_id=2))
    rig.watch.until_goal("c", GoalState.REACHED, 2)
    frame = LocalFrame(ORIGIN)
    for name in fleet.names:
        for message in setpoints(sim[name]):
            east_m, north_m = frame.to_map(message.lat_int / 1e7, message.lon_int / 1e7)
            assert fence.outside_m((east_m, north_m, message.alt)) < 0.1


def test_one_that_was_left_in_the_air_and_is_silent_keeps_its_place(rig: Rig) -> None:
    fleet = rig.mixed(a={"home_m": (0.0, 0.0)}, gone={"home_m": (500.0, 0.0)})
    rig.fly(replace(fleet, uavs=fleet.uavs[:1]))
    controller = rig.control(
        fleet, ControllerSettings(traffic=TransitLimits(min_separation_m=10.0, tracking_error_m=2.0))
    )
    controller.resume([], {"gone": ((60.0, 0.0, 30.0), (140.0, 0.0, 30.0)), "sold": ((0.0, 0.0, 10.0),)})
    assert order(controller, FleetOrder.LAUNCH, ("a",))["a"].success
    controller.set_goal("a", Goal(100.0, 0.0, 30.0))
    held = rig.watch.until("a", lambda s: "no separated path" in s.goal_reason)
    assert "gone" in held.goal_reason
    assert rig.watch.now("gone").line_m == ((60.0, 0.0, 30.0), (140.0, 0.0, 30.0)), "for the one after this"

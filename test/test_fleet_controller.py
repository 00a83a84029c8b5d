"""The fleet controller against simulated vehicles over real sockets on loopback.

Oracle: the simulated vehicle's own record of where it is (`position`, which the bridge does not see) and of what
reached it (`received`).
"""

from __future__ import annotations

import math
import socket
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.fleet.config import FleetConfig, LinkUrl, MapOrigin, UavConfig
from jpap_ros.fleet.fence import Fence
from jpap_ros.mavlink.aircraft import AircraftSettings
from jpap_ros.mavlink.autopilots import Transport
from jpap_ros.mavlink.fleet_controller import ControllerSettings, FleetController, FleetOrder, OrderResult
from jpap_ros.mavlink.goals import Goal, GoalState
from jpap_ros.mavlink.guards import GoalLimits
from jpap_ros.mavlink.snapshot import AircraftSnapshot
from jpap_ros.mavlink.vehicle import LinkState
from jpap_ros.sim import Fence as SimFence
from jpap_ros.sim import LinkFaults, SimFleet, SimVehicle, VehicleOptions

ORIGIN = MapOrigin(-37.8136, 144.9631, 20.0)
GROUND = (0.0, 0.0)
#: Far beyond what anything here takes on an idle machine.
PATIENCE_S = 60.0
SPEEDUP = 10.0
ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
TAKEOFF = mavlink.MAV_CMD_NAV_TAKEOFF


class Watch:
    """Keeps every snapshot and waits for conditions."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self.history: dict[str, list[AircraftSnapshot]] = {}

    def __call__(self, snapshot: AircraftSnapshot) -> None:
        with self._changed:
            self.history.setdefault(snapshot.name, []).append(snapshot)
            self._changed.notify_all()

    def now(self, name: str) -> AircraftSnapshot:
        with self._changed:
            return self.history[name][-1]

    def until(self, name: str, condition: Callable[[AircraftSnapshot], bool]) -> AircraftSnapshot:
        """Wait until an aircraft's newest snapshot satisfies a condition."""
        with self._changed:
            satisfied = self._changed.wait_for(
                lambda: bool(self.history.get(name)) and condition(self.history[name][-1]), PATIENCE_S
            )
            newest = self.history.get(name, [None])[-1]
        assert satisfied, f"waited in vain; newest: {newest}"
        assert newest is not None
        return newest

    def until_goal(self, name: str, state: GoalState) -> AircraftSnapshot:
        return self.until(name, lambda s: s.goal_state is state)

    def goal_states(self, name: str) -> list[GoalState]:
        """Goal states in the order they were seen, repetitions left out."""
        with self._changed:
            states = [s.goal_state for s in self.history[name]]
        return [state for i, state in enumerate(states) if i == 0 or states[i - 1] is not state]


class Rig:
    """A controller and simulated vehicles that begin and end with the test."""

    def __init__(self, stack: ExitStack, free_ports: Callable[[int], list[int]]) -> None:
        self._stack = stack
        self._free_ports = free_ports
        self.watch = Watch()

    def ports(self, count: int) -> list[int]:
        return self._free_ports(count)

    def fleet(self, count: int = 1, kind: str = "udpin", autopilot: str = "ardupilot", **uav: Any) -> FleetConfig:
        ports = self._free_ports(count)
        return FleetConfig(
            ORIGIN,
            tuple(
                UavConfig(
                    f"uav{i}",
                    i,
                    (LinkUrl(kind, "127.0.0.1", port),),
                    autopilot,
                    **{"home_m": (20.0 * (i - 1), 0.0), **uav},
                )
                for i, port in enumerate(ports, 1)
            ),
        )

    def fly(self, fleet: FleetConfig, options: Any = None) -> SimFleet:
        return self._stack.enter_context(SimFleet(fleet, speedup=SPEEDUP, options=options))

    def control(
        self, fleet: FleetConfig, settings: ControllerSettings | None = None, **aircraft: Any
    ) -> FleetController:
        settings = settings or ControllerSettings(aircraft=AircraftSettings(**aircraft), launch_stagger_s=0.0)
        return self._stack.enter_context(FleetController(fleet, settings, self.watch))

    def launched(self, fleet: FleetConfig, options: Any = None, **aircraft: Any) -> tuple[SimFleet, FleetController]:
        sim = self.fly(fleet, options)
        controller = self.control(fleet, **aircraft)
        results = order(controller, FleetOrder.LAUNCH, fleet.names)
        assert all(result.success for result in results.values()), results
        return sim, controller


@pytest.fixture
def rig(free_ports: Callable[[int], list[int]]) -> Iterator[Rig]:
    with ExitStack() as stack:
        yield Rig(stack, free_ports)


def order(controller: FleetController, what: FleetOrder, names: tuple[str, ...]) -> dict[str, OrderResult]:
    futures: dict[str, Future[OrderResult]] = controller.order(what, list(names))
    return {name: future.result(2 * PATIENCE_S) for name, future in futures.items()}


def commands(vehicle: SimVehicle, command: int | None = None) -> list[Any]:
    """Commands that reached a vehicle, requests for telemetry left out."""
    chatter = (mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_REQUEST_MESSAGE)
    with vehicle.lock:
        heard = [r.message for r in vehicle.received if r.kind in ("COMMAND_LONG", "COMMAND_INT")]
    return [m for m in heard if m.command not in chatter and command in (None, m.command)]


def setpoints(vehicle: SimVehicle) -> list[Any]:
    with vehicle.lock:
        return [r.message for r in vehicle.received if r.kind == "SET_POSITION_TARGET_GLOBAL_INT"]


def distance(vehicle: SimVehicle, goal: Goal) -> float:
    with vehicle.lock:
        return math.dist(vehicle.position, (goal.east_m, goal.north_m, goal.up_m))


AUTOPILOTS = ("ardupilot", "px4")


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


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_a_pilot_takes_over_and_only_an_operator_gives_back(rig: Rig, autopilot: str) -> None:
    fleet = rig.fleet(autopilot=autopilot)
    sim, controller = rig.launched(fleet)
    vehicle = sim["uav1"]
    controller.set_goal("uav1", Goal(2000.0, 0.0, 50.0))
    rig.watch.until_goal("uav1", GoalState.EN_ROUTE)
    vehicle.pilot_takes("ALT_HOLD" if autopilot == "ardupilot" else "ALTCTL")
    yielded = rig.watch.until_goal("uav1", GoalState.YIELDED)
    assert "without the bridge asking" in yielded.goal_reason
    with vehicle.lock:
        vehicle.received.clear()
    controller.set_goal("uav1", Goal(0.0, 100.0, 50.0))
    # The pilot even returns to the goal mode: still the pilot's.
    if autopilot == "ardupilot":
        vehicle.pilot_takes("GUIDED")
        rig.watch.until("uav1", lambda s: s.mode == "GUIDED")
    time.sleep(1.5)  # only to see that nothing happens
    assert commands(vehicle) == [] and setpoints(vehicle) == []
    assert rig.watch.now("uav1").goal_state is GoalState.YIELDED
    assert order(controller, FleetOrder.LAUNCH, ("uav1",))["uav1"].success
    rig.watch.until_goal("uav1", GoalState.REACHED)
    assert commands(vehicle, ARM) == commands(vehicle, TAKEOFF) == []


def test_every_reason_not_to_fly_is_told_and_nothing_arms(rig: Rig) -> None:
    fleet = rig.fleet(5)
    sim = rig.fly(
        fleet,
        {
            "uav1": VehicleOptions(prearm_failure="PreArm: Compass not calibrated"),
            "uav2": VehicleOptions(refuse_arming=True),
            "uav3": VehicleOptions(gps_delay_s=1e6),
            "uav4": VehicleOptions(sysid_enforce=True),
        },
    )
    sim["uav5"].silent = True
    controller = rig.control(fleet, ready_timeout_s=6.0)
    results = order(controller, FleetOrder.LAUNCH, (*fleet.names, "uav9"))
    assert not any(result.success for result in results.values())
    messages = {name: result.message for name, result in results.items()}
    assert "pre-arm check fails" in messages["uav1"]
    assert "arm: failed" in messages["uav2"] and "Arming disabled" in messages["uav2"]
    assert "position is not known" in messages["uav3"] or "home is not set" in messages["uav3"]
    assert messages["uav4"]
    assert messages["uav5"] == "not ready: never heard"
    assert "no UAV named 'uav9'" in messages["uav9"] and "uav1, uav2" in messages["uav9"]
    assert [len(commands(sim[name], ARM)) for name in ("uav1", "uav2", "uav3", "uav5")] == [0, 1, 0, 0]
    assert not any(vehicle.armed for vehicle in sim)
    enforced = rig.watch.until("uav4", lambda s: any("does not obey" in p for p in s.problems))
    assert any("SYSID_ENFORCE" in problem for problem in enforced.problems)


def test_a_failed_takeoff_is_disarmed_again(rig: Rig) -> None:
    fleet = rig.fleet()
    # The autopilot's own fence forbids the height.
    sim = rig.fly(fleet, VehicleOptions(fence=SimFence(max_height_m=5.0)))
    controller = rig.control(fleet, takeoff_height_m=20.0)
    result = order(controller, FleetOrder.LAUNCH, ("uav1",))["uav1"]
    assert not result.success and "take off: failed" in result.message
    rig.watch.until("uav1", lambda s: not s.armed)
    assert len(commands(sim["uav1"], TAKEOFF)) == 1


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_a_terrible_link_reaches_the_goal_and_repeats_nothing_dangerous(rig: Rig, autopilot: str) -> None:
    fleet = rig.fleet(autopilot=autopilot)
    faults = LinkFaults(loss=0.3, duplicate=0.1, reorder=0.1, delay_s=0.2, jitter_s=0.05)
    sim = rig.fly(fleet, VehicleOptions(link_faults=faults))
    controller = rig.control(fleet, link_timeout_s=8.0)
    controller.set_goal("uav1", Goal(60.0, 0.0, 50.0))
    orders = 0
    while not (result := order(controller, FleetOrder.LAUNCH, ("uav1",))["uav1"]).success:
        # Arming or take-off may be lost; then the operator asks again.
        orders += 1
        assert orders < 10, result
    rig.watch.until_goal("uav1", GoalState.REACHED)
    # A frame that the link itself doubled has the same sequence number.
    for command in (ARM, TAKEOFF):
        sent = {m.get_seq() for m in commands(sim["uav1"], command) if m.param1 != 0.0 or command == TAKEOFF}
        assert len(sent) <= 1 + orders


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
    _until(lambda: len(setpoints(sim["uav1"])) >= 3, "the stream goes on, for holding")
    for message in setpoints(sim["uav1"]):
        here = sim["uav1"].frame.to_map(message.lat_int / 1e7, message.lon_int / 1e7)
        assert math.dist((*here, message.alt), (50.0, 0.0, 50.0)) < 2.0


def test_the_autopilots_own_fence_shows_as_a_rejection(rig: Rig) -> None:
    fleet = rig.fleet()
    _, controller = rig.launched(fleet, VehicleOptions(fence=SimFence(radius_m=100.0)))
    controller.set_goal("uav1", Goal(50.0, 0.0, 30.0))
    rig.watch.until_goal("uav1", GoalState.REACHED)
    controller.set_goal("uav1", Goal(250.0, 0.0, 30.0))
    rejected = rig.watch.until_goal("uav1", GoalState.REJECTED)
    assert "keeps another target" in rejected.goal_reason


def test_no_goal_any_more_means_hold(rig: Rig) -> None:
    fleet = rig.fleet()
    sim, controller = rig.launched(fleet)
    controller.set_goal("uav1", Goal(3000.0, 0.0, 50.0))
    rig.watch.until_goal("uav1", GoalState.EN_ROUTE)
    controller.clear_goal("uav1", "no cell in plan 8")
    cleared = rig.watch.until_goal("uav1", GoalState.NONE)
    assert cleared.goal_reason == "no cell in plan 8" and math.isnan(cleared.goal_distance_m)
    _until(lambda: math.hypot(*_velocity(sim["uav1"])) < 0.1, "it stands in the air")
    assert sim["uav1"].position[0] < 2000.0


def test_a_silent_planner_means_hold_and_its_return_means_flying_on(rig: Rig) -> None:
    fleet = rig.fleet()
    settings = ControllerSettings(plan_timeout_s=2.0)
    sim = rig.fly(fleet)
    controller = rig.control(fleet, settings)
    controller.set_goal("uav1", Goal(3000.0, 0.0, 50.0))
    assert order(controller, FleetOrder.LAUNCH, ("uav1",))["uav1"].success
    controller.planner_alive()
    rig.watch.until_goal("uav1", GoalState.EN_ROUTE)
    silent = rig.watch.until("uav1", lambda s: "planner silent" in s.goal_reason)
    assert silent.goal_state is GoalState.NONE
    _until(lambda: math.hypot(*_velocity(sim["uav1"])) < 0.1, "it stands in the air")
    controller.planner_alive()
    rig.watch.until_goal("uav1", GoalState.EN_ROUTE)


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_a_lost_link_is_told_and_the_flight_goes_on_when_it_is_back(rig: Rig, autopilot: str) -> None:
    fleet = rig.fleet(autopilot=autopilot)
    sim, controller = rig.launched(fleet)
    controller.set_goal("uav1", Goal(50.0, 0.0, 50.0))
    rig.watch.until_goal("uav1", GoalState.REACHED)
    sim["uav1"].silent = True
    lost = rig.watch.until_goal("uav1", GoalState.LOST)
    assert lost.link is LinkState.LOST
    sim["uav1"].silent = False
    back = rig.watch.until("uav1", lambda s: s.link is LinkState.CONNECTED and s.goal_state is not GoalState.LOST)
    if autopilot == "ardupilot":
        # It kept its target in GUIDED all the while.
        rig.watch.until_goal("uav1", GoalState.REACHED)
    else:
        # OFFBOARD does not outlive the stream: PX4's own failsafe has it now.
        assert back.goal_state is GoalState.YIELDED
    assert len(commands(sim["uav1"], ARM)) == len(commands(sim["uav1"], TAKEOFF)) == 1


def test_a_reboot_in_the_air_ends_the_goal_and_everything_is_asked_for_again(rig: Rig) -> None:
    fleet = rig.fleet()
    sim, controller = rig.launched(fleet)
    controller.set_goal("uav1", Goal(50.0, 0.0, 50.0))
    rig.watch.until_goal("uav1", GoalState.REACHED)
    vehicle = sim["uav1"]
    # Long enough ago that the clock going back is no reordering.
    _until(lambda: rig.watch.now("uav1").goal_state is GoalState.REACHED and vehicle.boot_ms() > 8_000, "8 s of uptime")
    with vehicle.lock:
        vehicle.received.clear()
    vehicle.reboot()
    lost = rig.watch.until("uav1", lambda s: s.reboots == 1 and s.goal_state is GoalState.LOST)
    assert "rebooted" in lost.goal_reason
    assert commands(vehicle) == []
    _until(lambda: len(vehicle.received) > 0, "telemetry is asked for again")
    _until(lambda: vehicle.on_ground, "it has fallen")
    assert order(controller, FleetOrder.LAUNCH, ("uav1",))["uav1"].success
    rig.watch.until_goal("uav1", GoalState.REACHED)


def test_a_battery_failsafe_is_not_overruled(rig: Rig) -> None:
    fleet = rig.fleet()
    sim, controller = rig.launched(fleet)
    controller.set_goal("uav1", Goal(500.0, 0.0, 50.0))
    rig.watch.until_goal("uav1", GoalState.EN_ROUTE)
    sim["uav1"].set_battery(0.15)
    yielded = rig.watch.until_goal("uav1", GoalState.YIELDED)
    assert "RTL" in yielded.goal_reason and "Battery" in yielded.goal_reason
    assert yielded.battery.charge_state in (0, 1, 2, 3)
    rig.watch.until("uav1", lambda s: not s.armed)
    assert math.dist(sim["uav1"].position[:2], GROUND) < 2.0


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


def test_two_vehicles_with_one_system_id_are_reported_and_not_served(rig: Rig) -> None:
    fleet = rig.fleet()
    sims = [rig.fly(fleet), rig.fly(fleet)]
    controller = rig.control(fleet, ready_timeout_s=8.0)
    told = rig.watch.until("uav1", lambda s: any("several vehicles" in p for p in s.problems))
    assert "sysid 1" in told.problems[0] and "127.0.0.1" in told.problems[0]
    result = order(controller, FleetOrder.LAUNCH, ("uav1",))["uav1"]
    assert not result.success
    assert not any(commands(sim["uav1"]) for sim in sims)


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


def _velocity(vehicle: SimVehicle) -> tuple[float, float, float]:
    with vehicle.lock:
        return vehicle.body.vx, vehicle.body.vy, vehicle.body.vz


def _until(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, f"waited in vain until {what}"
        time.sleep(0.05)

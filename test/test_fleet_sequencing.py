"""Take-offs and landings in turn, with simulated vehicles over real sockets.

Oracle: the simulator's own record of how near vehicles came to each other in the air
(`SimFleet.least_separation_m`) and of where they are, neither of which the bridge sees; heights by hand.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace

import pytest
from fleet_rig import PATIENCE_S, Rig, order, until

from jpap_ros.fleet.config import FleetConfig
from jpap_ros.fleet.transit_plan import TransitLimits
from jpap_ros.mavlink.aircraft_settings import AircraftSettings
from jpap_ros.mavlink.fleet_controller import ControllerSettings, FleetController, FleetOrder
from jpap_ros.mavlink.goals import Goal, GoalState
from jpap_ros.sim import SimFleet, VehicleOptions

LIMITS = TransitLimits(min_separation_m=10.0, tracking_error_m=2.0, speed_m_s=8.0)
#: A second launch while the first waits for its turn is another question: none is needed here.
SETTINGS = ControllerSettings(aircraft=AircraftSettings(simulated_clock=True), launch_stagger_s=0.0, traffic=LIMITS)


@pytest.fixture
def rig(free_ports: Callable[[int], list[int]]) -> Iterator[Rig]:
    with ExitStack() as stack:
        yield Rig(stack, free_ports)


def ready(rig: Rig, fleet: FleetConfig, **options: VehicleOptions) -> tuple[SimFleet, FleetController]:
    """Vehicles on pads 10 m apart in a row, where the planned separation is 14 m, heard by a bridge."""
    sim = rig.fly(fleet, options)
    controller = rig.control(fleet, SETTINGS)
    for name in fleet.names:
        rig.watch.until(name, lambda s: s.enu_m is not None and s.landed_state == 1)
    return sim, controller


def row(rig: Rig, count: int, autopilot: str = "ardupilot") -> FleetConfig:
    fleet = rig.fleet(count, autopilot=autopilot)
    return replace(fleet, uavs=tuple(replace(uav, home_m=(10.0 * i, 0.0)) for i, uav in enumerate(fleet.uavs)))


def landed(sim: SimFleet, name: str, home: tuple[float, float]) -> bool:
    with sim[name].lock:
        return not sim[name].armed and math.dist(sim[name].position, (*home, 0.0)) < 1.5


def test_four_on_close_pads_take_off_fly_and_come_home(rig: Rig) -> None:
    fleet = row(rig, 4)
    # Two of them have no goal and stay above their pads, in the way of whoever climbs after them at the wrong height.
    sim, controller = ready(rig, fleet)
    goals = {"uav4": Goal(100.0, 0.0, 50.0, plan_id=1), "uav1": Goal(-60.0, 80.0, 50.0, plan_id=1)}
    for name, goal in goals.items():
        controller.set_goal(name, goal)
    results = order(controller, FleetOrder.LAUNCH, fleet.names)
    # 10 m, and 14 + 1 m more where somebody near climbs below: uav1 and uav3 climb first.
    assert [(result.success, result.message.split(";")[0]) for result in results.values()] == [
        (True, "in the air at 25 m"),
        (True, "in the air at 10 m"),
        (True, "in the air at 25 m"),
        (True, "in the air at 10 m"),
    ]
    for name in goals:
        rig.watch.until_goal(name, GoalState.REACHED)
    results = order(controller, FleetOrder.RETURN_HOME, fleet.names)
    assert all(result.success for result in results.values()), results
    for uav in fleet.uavs:
        until(lambda uav=uav: landed(sim, uav.name, uav.home_m), f"{uav.name} stands on its pad")
    assert sim.least_separation_m >= LIMITS.min_separation_m
    seen = rig.watch.now("uav1")
    assert seen.goal_state is GoalState.YIELDED and "returns home by the operator's command" in seen.goal_reason
    # On its way home it was under way in the mode that takes goals, and only landed by the autopilot's own mode.
    assert {s.mode for s in rig.watch.history["uav1"]}.isdisjoint({"RTL"})
    assert order(controller, FleetOrder.LAUNCH, ("uav1",))["uav1"].success


def test_one_that_will_not_arm_lets_its_neighbours_go(rig: Rig) -> None:
    fleet = row(rig, 3)
    sim, controller = ready(rig, fleet, uav1=VehicleOptions(refuse_arming=True))
    results = order(controller, FleetOrder.LAUNCH, fleet.names)
    assert [result.success for result in results.values()] == [False, True, True], results
    assert sim["uav1"].position[2] < 0.5
    assert sim.least_separation_m >= LIMITS.min_separation_m


def test_px4_returns_under_traffic_control_and_two_land_where_they_are(rig: Rig) -> None:
    fleet = row(rig, 2, autopilot="px4")
    sim, controller = ready(rig, fleet)
    results = order(controller, FleetOrder.LAUNCH, fleet.names)
    assert all(result.success for result in results.values()), results
    results = order(controller, FleetOrder.LAND, ("uav1", "uav2"))
    assert [result.message for result in results.values()] == ["lands (AUTO.LAND)"] * 2
    for uav in fleet.uavs:
        until(lambda uav=uav: landed(sim, uav.name, uav.home_m), f"{uav.name} has landed")
    assert order(controller, FleetOrder.LAUNCH, ("uav2",))["uav2"].success
    controller.set_goal("uav2", Goal(60.0, 20.0, 40.0))
    rig.watch.until_goal("uav2", GoalState.REACHED)
    answer = order(controller, FleetOrder.RETURN_HOME, ("uav2",))["uav2"]
    assert (answer.success, answer.message) == (
        True,
        "flies home under traffic control and lands there in its turn",
    )
    until(lambda: landed(sim, "uav2", (10.0, 0.0)), "it stands on its pad")
    assert {s.mode for s in rig.watch.history["uav2"]}.isdisjoint({"AUTO.RTL"})
    assert sim.least_separation_m >= LIMITS.min_separation_m


def test_without_traffic_control_it_is_the_autopilots_own_way_home(rig: Rig) -> None:
    fleet = rig.fleet(1)
    sim, controller = rig.launched(fleet)
    assert order(controller, FleetOrder.RETURN_HOME, ("uav1",))["uav1"].message == "returns home (RTL)"
    until(lambda: landed(sim, "uav1", (0.0, 0.0)), "it stands on its pad")


def test_a_second_order_of_the_same_kind_keeps_the_turn_of_the_first(rig: Rig) -> None:
    fleet = row(rig, 1)
    sim, controller = ready(rig, fleet, uav1=VehicleOptions(gps_delay_s=20.0))
    first = controller.order(FleetOrder.LAUNCH, ["uav1"])["uav1"]
    second = controller.order(FleetOrder.LAUNCH, ["uav1"])["uav1"]
    assert first.result(PATIENCE_S) == second.result(PATIENCE_S)
    assert first.result(0).success and sim["uav1"].position[2] > 5.0

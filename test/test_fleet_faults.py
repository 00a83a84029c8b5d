"""The fleet controller when pilots, links, planners and vehicles do not do as they should.

Oracle: the simulated vehicle's own record of where it is (`position`, which the bridge does not see) and of what
reached it (`received`).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest
from fleet_rig import (
    ARM,
    AUTOPILOTS,
    GROUND,
    TAKEOFF,
    Rig,
    commands,
    order,
    setpoints,
    until,
    velocity,
)

from jpap_ros.mavlink.fleet_controller import ControllerSettings, FleetOrder
from jpap_ros.mavlink.goals import Goal, GoalState
from jpap_ros.mavlink.vehicle import LinkState
from jpap_ros.sim import Fence as SimFence
from jpap_ros.sim import LinkFaults, VehicleOptions


@pytest.fixture
def rig(free_ports: Callable[[int], list[int]]) -> Iterator[Rig]:
    with ExitStack() as stack:
        yield Rig(stack, free_ports)


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
    # On the ground and not launched, it is nobody's: a change of mode is no takeover.
    sim["uav2"].pilot_takes("LOITER")
    assert rig.watch.until("uav2", lambda s: s.mode == "LOITER").goal_state is GoalState.NONE
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


def test_the_autopilots_own_fence_shows_as_a_rejection(rig: Rig) -> None:
    fleet = rig.fleet()
    _, controller = rig.launched(fleet, VehicleOptions(fence=SimFence(radius_m=100.0)))
    controller.set_goal("uav1", Goal(50.0, 0.0, 30.0))
    rig.watch.until_goal("uav1", GoalState.REACHED)
    controller.set_goal("uav1", Goal(250.0, 0.0, 30.0))
    rejected = rig.watch.until_goal("uav1", GoalState.REJECTED)
    assert "keeps another target" in rejected.goal_reason


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
    until(lambda: math.hypot(*velocity(sim["uav1"])) < 0.1, "it stands in the air")
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
    until(lambda: rig.watch.now("uav1").goal_state is GoalState.REACHED and vehicle.boot_ms() > 8_000, "8 s of uptime")
    with vehicle.lock:
        vehicle.received.clear()
    vehicle.reboot()
    lost = rig.watch.until("uav1", lambda s: s.reboots == 1 and s.goal_state is GoalState.LOST)
    assert "rebooted" in lost.goal_reason
    assert commands(vehicle) == []
    until(lambda: len(vehicle.received) > 0, "telemetry is asked for again")
    until(lambda: vehicle.on_ground, "it has fallen")
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
    rig.watch.until("uav1", lambda s: not s.armed)
    assert math.dist(sim["uav1"].position[:2], GROUND) < 2.0


def test_two_vehicles_with_one_system_id_are_reported_and_not_served(rig: Rig) -> None:
    fleet = rig.fleet()
    sims = [rig.fly(fleet), rig.fly(fleet)]
    controller = rig.control(fleet, ready_timeout_s=8.0)
    told = rig.watch.until("uav1", lambda s: any("several vehicles" in p for p in s.problems))
    assert "sysid 1" in told.problems[0] and "127.0.0.1" in told.problems[0]
    result = order(controller, FleetOrder.LAUNCH, ("uav1",))["uav1"]
    assert not result.success
    assert not any(commands(sim["uav1"]) for sim in sims)

"""The fleet controller when pilots, links, planners and vehicles do not do as they should.

Oracle: the simulated vehicle's own record of where it is (`position`, which the bridge does not see) and of what
reached it (`received`). One controller serves most tests; each has vehicles of its own there.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace

import pytest
from fleet_rig import (
    ARM,
    TAKEOFF,
    Rig,
    commands,
    distinct,
    order,
    setpoints,
    until,
    velocity,
)
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from sim_peer import Peer

from jpap_ros.fleet.config import LinkUrl
from jpap_ros.mavlink.aircraft import Aircraft
from jpap_ros.mavlink.autopilots import Transport
from jpap_ros.mavlink.fleet_controller import ControllerSettings, FleetController, FleetOrder
from jpap_ros.mavlink.goals import Goal, GoalState
from jpap_ros.mavlink.vehicle import LinkState
from jpap_ros.sim import Fence as SimFence
from jpap_ros.sim import SimFleet, VehicleOptions

ARDUPILOT, PX4 = {"autopilot": "ardupilot"}, {"autopilot": "px4"}


@pytest.fixture
def rig(free_ports: Callable[[int], list[int]]) -> Iterator[Rig]:
    with ExitStack() as stack:
        yield Rig(stack, free_ports)


@dataclass(frozen=True)
class Sky:
    """Vehicles in the air, launched together."""

    rig: Rig
    sim: SimFleet
    controller: FleetController


@pytest.fixture(scope="module")
def sky(free_ports: Callable[[int], list[int]]) -> Iterator[Sky]:
    with ExitStack() as stack:
        rig = Rig(stack, free_ports)
        fleet = rig.mixed(
            taken_ap=ARDUPILOT,
            taken_px4=PX4,
            lost_ap=ARDUPILOT,
            lost_px4=PX4,
            fenced=ARDUPILOT,
            rebooting=ARDUPILOT,
            empty=ARDUPILOT,
        )
        sim, controller = rig.launched(
            fleet, {"fenced": VehicleOptions(fence=SimFence(radius_m=100.0))}, link_timeout_s=2.5
        )
        yield Sky(rig, sim, controller)


def test_a_pilot_takes_over_and_only_an_operator_gives_back(sky: Sky) -> None:
    names, watch = ("taken_ap", "taken_px4"), sky.rig.watch
    for name in names:
        sky.controller.set_goal(name, Goal(2000.0, 0.0, 50.0))
    for name, mode in zip(names, ("ALT_HOLD", "ALTCTL"), strict=True):
        watch.until_goal(name, GoalState.EN_ROUTE)
        sky.sim[name].pilot_takes(mode)
    for name in names:
        assert "without the bridge asking" in watch.until_goal(name, GoalState.YIELDED).goal_reason
        with sky.sim[name].lock:
            sky.sim[name].received.clear()
        sky.controller.set_goal(name, Goal(0.0, 100.0, 50.0))
    # The pilot even returns to the goal mode: still the pilot's.
    sky.sim["taken_ap"].pilot_takes("GUIDED")
    watch.until("taken_ap", lambda s: s.mode == "GUIDED")
    time.sleep(1.5)  # only to see that nothing happens
    for name in names:
        assert commands(sky.sim[name]) == [] and setpoints(sky.sim[name]) == []
        assert watch.now(name).goal_state is GoalState.YIELDED
    assert all(result.success for result in order(sky.controller, FleetOrder.LAUNCH, names).values())
    for name in names:
        watch.until_goal(name, GoalState.REACHED)
        assert commands(sky.sim[name], ARM) == commands(sky.sim[name], TAKEOFF) == []


def test_a_lost_link_is_told_and_the_flight_goes_on_when_it_is_back(sky: Sky) -> None:
    names, watch = ("lost_ap", "lost_px4"), sky.rig.watch
    for name in names:
        sky.controller.set_goal(name, Goal(150.0, 30.0, 50.0))
    for name in names:
        watch.until_goal(name, GoalState.REACHED)
        sky.sim[name].silent = True
    for name in names:
        assert watch.until_goal(name, GoalState.LOST).link is LinkState.LOST
        sky.sim[name].silent = False
    back = {
        name: watch.until(name, lambda s: s.link is LinkState.CONNECTED and s.goal_state is not GoalState.LOST)
        for name in names
    }
    # ArduCopter kept its target in GUIDED all the while. OFFBOARD does not outlive the stream: PX4's own failsafe has
    # it now.
    watch.until_goal("lost_ap", GoalState.REACHED)
    assert back["lost_px4"].goal_state is GoalState.YIELDED
    for name in names:
        assert len(distinct(sky.sim[name], ARM)) == len(distinct(sky.sim[name], TAKEOFF)) == 1


def test_the_autopilots_own_fence_shows_as_a_rejection(sky: Sky) -> None:
    # Its home, the middle of the fence, is 200 m east.
    sky.controller.set_goal("fenced", Goal(250.0, 0.0, 30.0))
    sky.rig.watch.until_goal("fenced", GoalState.REACHED)
    sky.controller.set_goal("fenced", Goal(450.0, 0.0, 30.0))
    rejected = sky.rig.watch.until_goal("fenced", GoalState.REJECTED)
    assert "keeps another target" in rejected.goal_reason


def test_a_reboot_in_the_air_ends_the_goal_and_everything_is_asked_for_again(sky: Sky) -> None:
    watch, vehicle = sky.rig.watch, sky.sim["rebooting"]
    sky.controller.set_goal("rebooting", Goal(300.0, 0.0, 20.0))
    watch.until_goal("rebooting", GoalState.REACHED)
    # Long enough ago that the clock going back is no reordering.
    until(lambda: vehicle.boot_ms() > 8_000, "8 s of uptime")
    with vehicle.lock:
        vehicle.received.clear()
    vehicle.reboot()
    lost = watch.until("rebooting", lambda s: s.reboots == 1 and s.goal_state is GoalState.LOST)
    assert "rebooted" in lost.goal_reason
    assert commands(vehicle) == []
    until(lambda: len(vehicle.received) > 0, "telemetry is asked for again")
    until(lambda: vehicle.on_ground, "it has fallen")
    assert order(sky.controller, FleetOrder.LAUNCH, ("rebooting",))["rebooting"].success
    watch.until_goal("rebooting", GoalState.REACHED)


def test_a_battery_failsafe_is_not_overruled(sky: Sky) -> None:
    sky.controller.set_goal("empty", Goal(900.0, 0.0, 30.0))
    sky.rig.watch.until_goal("empty", GoalState.EN_ROUTE)
    sky.sim["empty"].set_battery(0.15)
    yielded = sky.rig.watch.until_goal("empty", GoalState.YIELDED)
    assert "RTL" in yielded.goal_reason and "Battery" in yielded.goal_reason
    sky.rig.watch.until("empty", lambda s: not s.armed)
    assert math.dist(sky.sim["empty"].position[:2], (300.0, 0.0)) < 2.0


def test_every_reason_not_to_fly_is_told_and_nothing_arms(rig: Rig) -> None:
    fleet = rig.fleet(6)
    sim = rig.fly(
        fleet,
        {
            "uav1": VehicleOptions(prearm_failure="PreArm: Compass not calibrated"),
            "uav2": VehicleOptions(refuse_arming=True),
            "uav3": VehicleOptions(gps_delay_s=1e6),
            "uav4": VehicleOptions(sysid_enforce=True),
            # The autopilot's own fence forbids the take-off height.
            "uav6": VehicleOptions(fence=SimFence(max_height_m=5.0)),
        },
    )
    sim["uav5"].silent = True
    controller = rig.control(fleet, ready_timeout_s=4.0)
    results = order(controller, FleetOrder.LAUNCH, (*fleet.names, "uav9"))
    assert not any(result.success for result in results.values())
    messages = {name: result.message for name, result in results.items()}
    assert "pre-arm check fails" in messages["uav1"]
    assert "arm: failed" in messages["uav2"] and "Arming disabled" in messages["uav2"]
    assert "position is not known" in messages["uav3"] or "home is not set" in messages["uav3"]
    assert messages["uav4"]
    assert messages["uav5"] == "not ready: never heard"
    assert "take off: failed" in messages["uav6"]
    assert "no UAV named 'uav9'" in messages["uav9"] and "uav1, uav2" in messages["uav9"]
    armings = [sum(m.param1 == 1.0 for m in distinct(vehicle, ARM)) for vehicle in sim]
    assert armings == [0, 1, 0, 0, 0, 1]
    # A failed take-off is disarmed again.
    rig.watch.until("uav6", lambda s: not s.armed)
    assert len(distinct(sim["uav6"], TAKEOFF)) == 1
    assert not any(vehicle.armed for vehicle in sim)
    # On the ground and not launched, it is nobody's: a change of mode is no takeover.
    sim["uav2"].pilot_takes("LOITER")
    assert rig.watch.until("uav2", lambda s: s.mode == "LOITER").goal_state is GoalState.NONE
    enforced = rig.watch.until("uav4", lambda s: any("does not obey" in p for p in s.problems))
    assert any("SYSID_ENFORCE" in problem for problem in enforced.problems)
    unknown = rig.watch.until("uav3", lambda s: s.link is LinkState.CONNECTED)
    assert unknown.position is None


def test_a_pilot_who_takes_over_the_moment_it_is_armed_keeps_it(rig: Rig) -> None:
    """ArduCopter would take off in LOITER too. It was in LOITER just before: the heartbeat could be a late one."""
    fleet = rig.fleet()
    sim = rig.fly(fleet)
    vehicle = sim["uav1"]
    vehicle.pilot_takes("LOITER")
    vehicle.armed_now = lambda: vehicle.change_mode("LOITER")  # type: ignore[method-assign]
    controller = rig.control(fleet)
    result = order(controller, FleetOrder.LAUNCH, ("uav1",))["uav1"]
    assert not result.success and "LOITER without the bridge asking" in result.message
    time.sleep(1.5)  # only to see that nothing happens
    assert {m.command for m in commands(vehicle)} == {mavlink.MAV_CMD_DO_SET_MODE, ARM}
    assert vehicle.mode == "LOITER"


def test_a_stations_hold_is_a_takeover_though_px4_flies_goals_in_hold(rig: Rig) -> None:
    """Oracle: the vehicle's record: after the station's command nothing of the bridge reaches it."""
    with Peer.udp(*rig.ports(1)) as station:
        fleet = replace(rig.fleet(autopilot="px4"), gcs_urls=(LinkUrl("udpout", "127.0.0.1", station.port),))
        sim, controller = rig.launched(fleet, transport=Transport.REPOSITION)
        controller.set_goal("uav1", Goal(3000.0, 0.0, 50.0))
        rig.watch.until_goal("uav1", GoalState.EN_ROUTE)
        station.mav.srcSystem, station.mav.srcComponent = 255, 190
        hold = (mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, 4, 3)
        station.send(mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_DO_SET_MODE, 0, *hold, 0, 0, 0, 0))
        yielded = rig.watch.until_goal("uav1", GoalState.YIELDED)
        assert "ground station with sysid 255" in yielded.goal_reason
        until(lambda: any(r.source[0] == 255 for r in sim["uav1"].received), "the station's command has arrived")
        with sim["uav1"].lock:
            sim["uav1"].received.clear()
        controller.set_goal("uav1", Goal(0.0, 100.0, 50.0))
        time.sleep(1.5)  # only to see that nothing happens
        assert commands(sim["uav1"]) == []


def test_an_error_with_one_aircraft_is_told_and_the_others_fly_on(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    fleet = rig.mixed(bad=PX4, good=PX4)
    sim, controller = rig.launched(fleet)
    for name in fleet.names:
        controller.set_goal(name, Goal(3000.0, 50.0, 50.0))
    for name in fleet.names:
        rig.watch.until_goal(name, GoalState.EN_ROUTE)
    tick = Aircraft.tick

    def broken(aircraft: Aircraft, now: float) -> None:
        if aircraft.config.name == "bad" and aircraft.authority.ours:
            raise KeyError("nobody foresaw it")
        tick(aircraft, now)

    monkeypatch.setattr(Aircraft, "tick", broken)
    told = rig.watch.until("bad", lambda s: s.goal_state is GoalState.YIELDED)
    assert any("nobody foresaw it" in problem for problem in told.problems)
    # As when the bridge stops: OFFBOARD would end in a failsafe.
    rig.watch.until("bad", lambda s: s.mode == "AUTO.LOITER")
    monkeypatch.undo()
    assert sim["good"].mode == "OFFBOARD" and controller.failure is None
    assert "Traceback" in caplog.text and caplog.text.count("nobody foresaw it") < 5
    controller.set_goal("good", Goal(100.0, 0.0, 30.0))
    rig.watch.until_goal("good", GoalState.REACHED)
    assert order(controller, FleetOrder.LAUNCH, ("bad",))["bad"].success
    rig.watch.until("bad", lambda s: s.goal_state is GoalState.EN_ROUTE and s.problems == ())


def test_a_silent_planner_means_hold_and_its_return_means_flying_on(rig: Rig) -> None:
    fleet = rig.fleet()
    settings = ControllerSettings(plan_timeout_s=1.0)
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


def test_two_vehicles_with_one_system_id_are_reported_and_not_served(rig: Rig) -> None:
    fleet = rig.fleet()
    sims = [rig.fly(fleet), rig.fly(fleet)]
    controller = rig.control(fleet, ready_timeout_s=2.0)
    told = rig.watch.until("uav1", lambda s: any("several vehicles" in p for p in s.problems))
    assert "sysid 1" in told.problems[0] and "127.0.0.1" in told.problems[0] and "give each its own" in told.problems[0]
    result = order(controller, FleetOrder.LAUNCH, ("uav1",))["uav1"]
    assert not result.success and "used by several vehicles" in result.message
    assert not any(commands(sim["uav1"]) for sim in sims)


def test_a_system_id_heard_where_another_is_expected_is_reported_on_both_and_not_served(rig: Rig) -> None:
    """Factory settings: both vehicles came with system id 1."""
    fleet = rig.fleet(2)
    first, second = fleet.uavs
    sims = [rig.fly(replace(fleet, uavs=(replace(uav, sysid=1),))) for uav in fleet.uavs]
    controller = rig.control(fleet, ready_timeout_s=2.0)
    told = rig.watch.until("uav1", lambda s: any("expected on" in p for p in s.problems))
    assert "sysid 1" in told.problems[0] and str(second.urls[0]) in told.problems[0]
    told = rig.watch.until("uav2", lambda s: any("expected 2 here" in p for p in s.problems))
    assert told.link is LinkState.NEVER_SEEN and "sysid 1 is heard from 127.0.0.1" in told.problems[0]
    results = order(controller, FleetOrder.LAUNCH, fleet.names)
    assert not results["uav1"].success and "expected on" in results["uav1"].message
    assert not results["uav2"].success
    assert not any(commands(vehicle) for sim in sims for vehicle in sim.vehicles.values())
    # The second one gets its own id: both are served.
    sims[1].close()
    rig.fly(replace(fleet, uavs=(second,)))
    for name in fleet.names:
        rig.watch.until(name, lambda s: s.link is LinkState.CONNECTED and not s.problems)
    assert order(controller, FleetOrder.LAUNCH, (first.name,))[first.name].success


def test_two_vehicles_on_the_urls_of_one_are_reported_and_not_served(rig: Rig) -> None:
    """They stand 50 m apart; with one vehicle on both urls everything is as with one."""
    ports = rig.ports(4)
    urls = [tuple(LinkUrl("udpin", "127.0.0.1", port) for port in pair) for pair in (ports[:2], ports[2:])]
    fleet = rig.mixed(two={"urls": urls[0], "autopilot": "px4"}, one={"urls": urls[1], "autopilot": "px4"})
    two, one = fleet.uavs
    sims = [
        rig.fly(replace(fleet, uavs=(replace(two, urls=(url,), home_m=(-50.0 * i, 0.0)),)))
        for i, url in enumerate(urls[0])
    ]
    rig.fly(replace(fleet, uavs=(one,)))
    controller = rig.control(fleet, ready_timeout_s=2.0)
    told = rig.watch.until("two", lambda s: any("several vehicles" in p for p in s.problems))
    assert all(str(url) in told.problems[0] for url in urls[0])
    results = order(controller, FleetOrder.LAUNCH, fleet.names)
    assert not results["two"].success and "several vehicles" in results["two"].message
    assert results["one"].success
    assert not any(commands(sim["two"]) for sim in sims)
    assert not any("several vehicles" in p for s in rig.watch.history["one"] for p in s.problems)

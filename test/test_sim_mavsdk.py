"""MAVSDK, an independent peer, flies the simulated vehicles as it would fly real ones."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator

import pytest
from mavsdk import Autopilot, ComponentType, Configuration, ConnectionResult, Mavsdk, System
from mavsdk.plugins.action import Action
from mavsdk.plugins.action.action import ActionError, ActionResult
from mavsdk.plugins.offboard import Offboard
from mavsdk.plugins.offboard.offboard import OffboardError, PositionGlobalYaw
from mavsdk.plugins.telemetry import Telemetry
from sim_peer import PATIENCE_S, fleet_of

from jpap_ros.sim import SimFleet, VehicleOptions

pytest_plugins = ["jpap_ros.sim.pytest_plugin"]

StartFleet = Callable[..., SimFleet]
Connect = Callable[[int], System]


@pytest.fixture
def connect() -> Iterator[Connect]:
    """Return a function that listens on a port as MAVSDK and waits for the first autopilot."""
    clients: list[Mavsdk] = []

    def listen(port: int) -> System:
        client = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
        clients.append(client)
        assert client.add_any_connection(f"udpin://127.0.0.1:{port}") == ConnectionResult.SUCCESS
        system = client.first_autopilot(PATIENCE_S)
        assert system is not None, "MAVSDK found no autopilot"
        return system

    yield listen
    for client in clients:
        client.destroy()


def until(condition: Callable[[], bool], what: str) -> None:
    """Wait for something, with patience."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, f"waited in vain for {what}"
        time.sleep(0.02)


def start(sim_fleet: StartFleet, kind: str, port: int, **options: object) -> SimFleet:
    """One vehicle that flies ten times as fast as real ones."""
    uav = f'{{name: uav1, sysid: 7, url: "udpin:127.0.0.1:{port}", autopilot: {kind}}}'
    return sim_fleet(fleet_of(uav), speedup=10.0, options=VehicleOptions(**options))  # type: ignore[arg-type]


@pytest.mark.parametrize(("kind", "autopilot"), [("ardupilot", Autopilot.ARDUPILOT), ("px4", Autopilot.PX4)])
def test_mavsdk_connects_arms_takes_off_goes_somewhere_and_returns(
    sim_fleet: StartFleet, connect: Connect, free_ports: Callable[[int], list[int]], kind: str, autopilot: Autopilot
) -> None:
    """Oracle: MAVSDK's own view of the vehicle on one side, ground truth on the other; they must agree."""
    (port,) = free_ports(1)
    vehicle = start(sim_fleet, kind, port)["uav1"]
    system = connect(port)
    assert (system.get_system_id(), system.autopilot_type()) == (7, autopilot)
    action, telemetry = Action(system), Telemetry(system)
    if kind == "ardupilot":
        # ArduPilot streams only what it is asked for.
        telemetry.set_rate_position(10.0)
        telemetry.set_rate_gps_info(2.0)
        telemetry.set_rate_in_air(5.0)
        telemetry.set_rate_battery(2.0)
    until(lambda: math.isfinite(telemetry.position().latitude_deg), "a position")
    assert telemetry.position().absolute_altitude_m == pytest.approx(20.0, abs=0.1)

    action.set_takeoff_altitude(15.0)
    assert action.arm() == ActionResult.SUCCESS
    until(telemetry.armed, "MAVSDK to see it armed")
    assert action.takeoff() == ActionResult.SUCCESS
    until(lambda: telemetry.position().relative_altitude_m > 14.9, "the take-off height")
    assert vehicle.position == pytest.approx((0.0, 0.0, 15.0), abs=0.2)
    until(telemetry.in_air, "MAVSDK to see it in the air")

    lat, lon = vehicle.frame.to_geodetic(60.0, 30.0)
    assert action.goto_location(lat, lon, 60.0, 90.0) == ActionResult.SUCCESS
    until(lambda: math.dist(vehicle.position, (60.0, 30.0, 40.0)) < 0.2, "the place it was sent to")
    until(lambda: telemetry.position().latitude_deg == pytest.approx(lat, abs=2e-6), "MAVSDK to see it there")
    assert telemetry.position().longitude_deg == pytest.approx(lon, abs=2e-6)

    assert action.return_to_launch() == ActionResult.SUCCESS
    until(lambda: not telemetry.armed(), "landing and disarming at home")
    assert vehicle.position == pytest.approx((0.0, 0.0, 0.0), abs=0.01)


@pytest.mark.parametrize("kind", ["ardupilot", "px4"])
def test_mavsdk_flies_offboard(
    sim_fleet: StartFleet, connect: Connect, free_ports: Callable[[int], list[int]], kind: str
) -> None:
    """Oracle: ground truth of the place that MAVSDK's own setpoints lead to; height above home as MAVSDK encodes it."""
    (port,) = free_ports(1)
    vehicle = start(sim_fleet, kind, port)["uav1"]
    system = connect(port)
    action, offboard = Action(system), Offboard(system)
    action.set_takeoff_altitude(10.0)
    until(lambda: _succeeds(action.arm), "arming")
    assert action.takeoff() == ActionResult.SUCCESS
    until(lambda: vehicle.position[2] > 9.9, "the take-off height")
    until(lambda: vehicle.landed_state() == 2, "the end of the take-off")

    lat, lon = vehicle.frame.to_geodetic(-20.0, 50.0)
    offboard.set_position_global(PositionGlobalYaw(lat, lon, 30.0, 0.0, PositionGlobalYaw.AltitudeType.REL_HOME))
    # PX4 grants OFFBOARD once the targets have been streaming for a second.
    until(lambda: _succeeds(offboard.start), "offboard")
    until(lambda: math.dist(vehicle.position, (-20.0, 50.0, 30.0)) < 0.2, "the place of the setpoints")
    assert vehicle.mode == {"ardupilot": "GUIDED", "px4": "OFFBOARD"}[kind]
    assert {r.kind for r in vehicle.received} >= {"SET_POSITION_TARGET_GLOBAL_INT"}


@pytest.mark.parametrize("kind", ["ardupilot", "px4"])
def test_mavsdk_sees_that_arming_is_refused(
    sim_fleet: StartFleet, connect: Connect, free_ports: Callable[[int], list[int]], kind: str
) -> None:
    (port,) = free_ports(1)
    fleet = start(sim_fleet, kind, port, prearm_failure="Compass not calibrated")
    action = Action(connect(port))
    with pytest.raises(ActionError):
        action.arm()
    assert not fleet["uav1"].armed


def _succeeds(action: Callable[[], object]) -> bool:
    try:
        action()
    except (ActionError, OffboardError):
        return False
    return True

"""MAVSDK's autopilot server behind the bridge's controller.

Oracle: MAVSDK's own C++ MAVLink implementation, which shares no code with ours: what its action server accepted, and
the fields of our setpoints as its own parser (libmav) read them.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest
from mavsdk.component_type import ComponentType
from mavsdk.mavsdk import Configuration, Mavsdk
from mavsdk.plugins.action_server.action_server import ActionServer, AllowableFlightModes, FlightMode
from mavsdk.plugins.mavlink_direct_server.mavlink_direct_server import MavlinkDirectServer
from mavsdk.plugins.telemetry_server import telemetry_server as telemetry

from jpap_ros.fleet.config import FleetConfig, LinkUrl, MapOrigin, UavConfig
from jpap_ros.mavlink.aircraft_settings import AircraftSettings
from jpap_ros.mavlink.fleet_controller import ControllerSettings, FleetController, FleetOrder
from jpap_ros.mavlink.goals import Goal

PATIENCE_S = 60.0
# MAVSDK 4.1 sends HOME_POSITION.altitude as 0 whatever it is told.
HOME_AMSL_M = 0.0
LATITUDE, LONGITUDE = -37.8136, 144.9631


class MavsdkAutopilot:
    """A PX4-like aircraft: MAVSDK speaks, this class moves it up and down."""

    def __init__(self, sysid: int, port: int) -> None:
        configuration = Configuration.create_with_component_type(ComponentType.AUTOPILOT)
        configuration.system_id = sysid
        self._sdk = Mavsdk(configuration)
        self._sdk.add_any_connection(f"udpout://127.0.0.1:{port}")
        component = self._sdk.server_component_by_type(ComponentType.AUTOPILOT)
        self._action = ActionServer(component)
        self._telemetry = telemetry.TelemetryServer(component)
        self._direct = MavlinkDirectServer(component)
        self._height_m = 0.0
        self._climbing = False
        self.armed: list[bool] = []
        self.takeoffs = 0
        self.modes: list[FlightMode] = []
        self.setpoints: list[dict[str, Any]] = []
        self._action.set_armable(True, False)
        self._action.set_disarmable(True, False)
        self._action.set_allow_takeoff(True)
        self._action.set_allowable_flight_modes(AllowableFlightModes(True, True, True, True, True, True, True))
        self._action.set_flight_mode_internal(FlightMode.HOLD)
        self._action.subscribe_arm_disarm(lambda result, data, _: self.armed.append(bool(data.arm)))
        self._action.subscribe_takeoff(lambda result, data, _: self._on_takeoff())
        self._action.subscribe_flight_mode_change(lambda result, mode, _: self.modes.append(FlightMode(mode)))
        self._direct.subscribe_message(
            "SET_POSITION_TARGET_GLOBAL_INT", lambda message, _: self.setpoints.append(json.loads(message.fields_json))
        )
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._live, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._sdk.destroy()

    def _on_takeoff(self) -> None:
        self.takeoffs += 1
        self._climbing = True
        self._action.set_flight_mode_internal(FlightMode.TAKEOFF)

    def _live(self) -> None:
        while not self._stop.wait(0.2):
            if self._climbing:
                self._height_m = min(10.0, self._height_m + 1.0)
                if self._height_m == 10.0:
                    self._climbing = False
                    self._action.set_flight_mode_internal(FlightMode.HOLD)
            landed = telemetry.LandedState.ON_GROUND if self._height_m == 0.0 else telemetry.LandedState.IN_AIR
            if self._climbing:
                landed = telemetry.LandedState.TAKING_OFF
            where = telemetry.Position(LATITUDE, LONGITUDE, HOME_AMSL_M + self._height_m, self._height_m)
            home = telemetry.Position(LATITUDE, LONGITUDE, HOME_AMSL_M, 0.0)
            battery = telemetry.Battery(16.0, 0.9)
            self._telemetry.publish_position(where, telemetry.VelocityNed(0.0, 0.0, 0.0), telemetry.Heading(90.0))
            self._telemetry.publish_home(home)
            self._telemetry.publish_sys_status(battery, True, True, True, True, True)
            self._telemetry.publish_extended_sys_state(telemetry.VtolState.UNDEFINED, landed)


def until(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, f"waited in vain until {what}"
        time.sleep(0.05)


def test_mavsdk_is_armed_taken_off_and_sent_to_a_goal_in_offboard(free_ports: Callable[[int], list[int]]) -> None:
    (port,) = free_ports(1)
    uav = UavConfig("uav1", 7, (LinkUrl("udpin", "127.0.0.1", port),), autopilot="px4")
    fleet = FleetConfig(MapOrigin(LATITUDE, LONGITUDE, 20.0), (uav,))
    peer = MavsdkAutopilot(7, port)
    try:
        with FleetController(fleet, ControllerSettings(aircraft=AircraftSettings(takeoff_height_m=10.0))) as controller:
            controller.set_goal("uav1", Goal(0.0, 0.0, 50.0))
            result = controller.order(FleetOrder.LAUNCH, ["uav1"])["uav1"].result(2 * PATIENCE_S)
            assert result.success, result
            assert peer.armed == [True] and peer.takeoffs == 1
            assert peer.modes[-1] is FlightMode.OFFBOARD
            # At first the place where it hovers, 10 m above home, then the goal, 50 m above it.
            until(lambda: any(s["alt"] == HOME_AMSL_M + 50.0 for s in peer.setpoints), "the goal is on the wire")
            target = peer.setpoints[-1]
            assert (target["lat_int"], target["lon_int"]) == (round(LATITUDE * 1e7), round(LONGITUDE * 1e7))
            assert (target["coordinate_frame"], target["type_mask"]) == (5, 3576)
            assert (target["target_system"], target["target_component"]) == (7, 1)
            assert peer.setpoints[0]["alt"] == pytest.approx(HOME_AMSL_M + 10.0, abs=0.01)

    finally:
        peer.close()

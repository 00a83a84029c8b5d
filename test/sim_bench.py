"""One simulated vehicle on a bench: real MAVLink bytes in and out, and a clock that the test turns by hand.

Nothing here waits: ten minutes of flight take a second, and a time-out of one second is one second exactly.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.fleet.config import LinkUrl, MapOrigin, UavConfig
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.sim.ardupilot import ArduPilotVehicle
from jpap_ros.sim.options import VehicleOptions
from jpap_ros.sim.px4 import Px4Vehicle
from jpap_ros.sim.vehicle import SimVehicle

ORIGIN = MapOrigin(-37.8136, 144.9631, 20.0)
SYSID = 7
BRIDGE = (245, 191)
GCS = (255, 190)
STEP_S = 0.02
POSITION_ONLY = 0b110111111000
VELOCITY_ONLY = 0b110111000111
PX4_OFFBOARD, PX4_HOLD, PX4_TAKEOFF, PX4_RTL, PX4_LAND = (6, 0), (4, 3), (4, 2), (4, 5), (4, 6)
ARDUPILOT_MODES = {"STABILIZE": 0, "GUIDED": 4, "LOITER": 5, "RTL": 6, "LAND": 9}


def over_the_wire(message: Any, source: tuple[int, int]) -> Any:
    """What the other side's parser makes of a message."""
    data = message.pack(mavlink.MAVLink(None, *source))
    (parsed,) = mavlink.MAVLink(None).parse_buffer(data)
    return parsed


class Bench:
    """A vehicle, one peer, and time."""

    def __init__(self, kind: type[SimVehicle], start: tuple[float, float] = (0.0, 0.0), **options: Any) -> None:
        self.frame = LocalFrame(ORIGIN)
        config = UavConfig("uav1", SYSID, (LinkUrl("udpin", "127.0.0.1", 14550),))
        self.vehicle = kind(config, self.frame, start, VehicleOptions(**options), 1, threading.RLock())
        self.channel = self.vehicle.attach(0)
        self.parser = mavlink.MAVLink(None)
        self.now = 1000.0
        self.heard: list[Any] = []

    def send(self, message: Any, source: tuple[int, int] = BRIDGE) -> None:
        """Let a message arrive at once."""
        self.vehicle.receive(over_the_wire(message, source), self.channel, self.now)
        self._listen()

    def run(self, seconds: float, each_step: Callable[[], None] | None = None) -> None:
        """Let time pass, flight and peers alike."""
        for _ in range(round(seconds / STEP_S)):
            self.now += STEP_S
            if each_step is not None:
                each_step()
            self.vehicle.advance(STEP_S)
            self.vehicle.tick(self.now)
            self._listen()

    def run_until(self, condition: Callable[[], bool], limit_s: float = 600.0) -> float:
        """Let time pass until something holds; return how long it took."""
        began = self.now
        while not condition():
            assert self.now - began < limit_s, f"not within {limit_s:g} s of simulated time"
            self.run(STEP_S)
        return self.now - began

    def last(self, kind: str) -> Any:
        """The newest message of a kind heard, or None."""
        return next((m for m in reversed(self.heard) if m.get_type() == kind), None)

    def texts(self) -> list[str]:
        """Every STATUSTEXT heard."""
        return [m.text for m in self.heard if m.get_type() == "STATUSTEXT"]

    def command(
        self, command: int, *params: float, source: tuple[int, int] = BRIDGE, target: int = SYSID
    ) -> int | None:
        """Send a COMMAND_LONG; return the result of its COMMAND_ACK, or None without one."""
        padded = (*params, *(0.0,) * (7 - len(params)))
        message = mavlink.MAVLink_command_long_message(target, 1, command, 0, *padded)
        return self._acknowledged(message, command, source)

    def command_int(self, command: int, frame: int, *params: float, x: int, y: int, z: float) -> int | None:
        """Send a COMMAND_INT; return the result of its COMMAND_ACK, or None without one."""
        message = mavlink.MAVLink_command_int_message(SYSID, 1, frame, command, 0, 0, *params, x, y, z)
        return self._acknowledged(message, command, BRIDGE)

    def target(self, east: float, north: float, altitude: float, frame: int, mask: int = POSITION_ONLY) -> Any:
        """Make a SET_POSITION_TARGET_GLOBAL_INT."""
        lat, lon = self.frame.to_geodetic(east, north)
        return mavlink.MAVLink_set_position_target_global_int_message(
            0, SYSID, 1, frame, mask, round(lat * 1e7), round(lon * 1e7), altitude, *(0.0,) * 8
        )

    def at(self, east: float, north: float, up: float, within: float = 0.05) -> bool:
        """Whether the vehicle hovers there; a position on the wire is good to 1.1 cm."""
        body = self.vehicle.body
        return math.dist(body.position, (east, north, up)) < within and (body.vx, body.vy, body.vz) == (0.0, 0.0, 0.0)

    def _acknowledged(self, message: Any, command: int, source: tuple[int, int]) -> int | None:
        before = len(self.heard)
        self.send(message, source)
        acks = [m for m in self.heard[before:] if m.get_type() == "COMMAND_ACK" and m.command == command]
        if not acks:
            return None
        (ack,) = acks
        assert (ack.target_system, ack.target_component) == source
        return int(ack.result)

    def _listen(self) -> None:
        for frame in self.channel.take():
            self.heard += self.parser.parse_buffer(frame) or []


def ardupilot_in_the_air(height: float = 20.0, **options: Any) -> Bench:
    """An ArduCopter in GUIDED, hovering above its home at (0, 0)."""
    bench = Bench(ArduPilotVehicle, **options)
    assert bench.command(mavlink.MAV_CMD_DO_SET_MODE, 1, ARDUPILOT_MODES["GUIDED"]) == 0
    assert bench.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0
    assert bench.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, height) == 0
    bench.run_until(lambda: bench.at(0.0, 0.0, height), 60.0)
    return bench


def px4_in_the_air(height: float = 20.0, **options: Any) -> Bench:
    """A PX4 in Hold, hovering above its home at (0, 0)."""
    bench = Bench(Px4Vehicle, **options)
    nan = math.nan
    assert bench.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0
    amsl = ORIGIN.altitude_amsl_m + height
    assert bench.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, nan, nan, nan, amsl) == 0
    bench.run_until(lambda: bench.vehicle.mode == "HOLD", 60.0)
    return bench

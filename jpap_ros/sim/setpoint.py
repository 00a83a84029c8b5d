"""SET_POSITION_TARGET_*: which parts of a message count, and points in its frames."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.fleet.checks import MAX_MAP_M

if TYPE_CHECKING:
    from jpap_ros.sim.flight import Point
    from jpap_ros.sim.vehicle import SimVehicle

_POSITION, _VELOCITY, _ACCELERATION = 0b111, 0b111000, 0b111000000
_FORCE, _YAW = 0x200, 0x400

#: Higher or lower no aircraft is asked to fly [m]; beyond it a number is taken for garbage.
MAX_HEIGHT_M = 10_000.0
#: The same across the ground [m].
MAX_DISTANCE_M = 100_000.0

AMSL_FRAMES = frozenset((mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT))
RELATIVE_FRAMES = frozenset((mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT))
TERRAIN_FRAMES = frozenset((mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT, mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT))


@dataclass(frozen=True)
class Parts:
    """Which parts of a setpoint count: a group with one axis ignored is ignored whole."""

    position: bool
    velocity: bool
    acceleration: bool
    force: bool
    yaw: float | None

    @classmethod
    def of(cls, message: Any) -> Parts:
        """Read a message's type mask."""
        mask = message.type_mask
        yaw = message.yaw if not mask & _YAW and math.isfinite(message.yaw) else None
        return cls(not mask & _POSITION, not mask & _VELOCITY, not mask & _ACCELERATION, bool(mask & _FORCE), yaw)


def up_of_altitude(vehicle: SimVehicle, frame: int, altitude: float) -> float | None:
    """Up coordinate in the map of an altitude in a global frame [m]; None for a frame without meaning here."""
    if not abs(altitude) <= MAX_HEIGHT_M:
        return None
    if frame in AMSL_FRAMES:
        return altitude - vehicle.frame.origin.altitude_amsl_m
    if frame in RELATIVE_FRAMES:
        return altitude + vehicle.home_z()
    # The simulated terrain is the plane z = 0.
    return altitude if frame in TERRAIN_FRAMES else None


def local_point(vehicle: SimVehicle, message: Any) -> Point | None:
    """Map point of a SET_POSITION_TARGET_LOCAL_NED; None for a frame without meaning here."""
    body, origin = vehicle.body, vehicle.ekf_origin
    near = all(abs(v) <= MAX_MAP_M for v in (message.x, message.y)) and abs(message.z) <= MAX_HEIGHT_M
    if origin is None or not near:
        return None
    if message.coordinate_frame == mavlink.MAV_FRAME_LOCAL_NED:
        return origin[0] + message.y, origin[1] + message.x, origin[2] - message.z
    if message.coordinate_frame == mavlink.MAV_FRAME_LOCAL_OFFSET_NED:
        return body.x + message.y, body.y + message.x, body.z - message.z
    return None


def velocity_enu(message: Any) -> Point | None:
    """Velocity of a setpoint, (east, north, up) [m/s]; None if it is not finite."""
    if not all(math.isfinite(v) for v in (message.vx, message.vy, message.vz)):
        return None
    return message.vy, message.vx, -message.vz

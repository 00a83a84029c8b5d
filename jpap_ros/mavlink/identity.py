"""Which autopilot a vehicle has by its heartbeat, and why one that is heard is not served."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.mavlink.autopilots import REGISTRY, Autopilot, by_heartbeat
from jpap_ros.mavlink.vehicle import Vehicle

_MULTICOPTERS = frozenset(
    {
        mavlink.MAV_TYPE_QUADROTOR,
        mavlink.MAV_TYPE_COAXIAL,
        mavlink.MAV_TYPE_HELICOPTER,
        mavlink.MAV_TYPE_HEXAROTOR,
        mavlink.MAV_TYPE_OCTOROTOR,
        mavlink.MAV_TYPE_TRICOPTER,
        mavlink.MAV_TYPE_DODECAROTOR,
        mavlink.MAV_TYPE_DECAROTOR,
    }
)


def identify(vehicle: Vehicle, wanted: str) -> Autopilot | None:
    """Personality of the heartbeat; a generic heartbeat leaves the choice to the fleet file.

    Parameters
    ----------
    vehicle : Vehicle
    wanted : str
        The fleet file's: a name of the registry, or "auto".

    Returns
    -------
    Autopilot or None
        None: the vehicle is not served; `mismatch` says why.
    """
    heard = by_heartbeat(vehicle.autopilot if vehicle.autopilot is not None else mavlink.MAV_AUTOPILOT_INVALID)
    types = _MULTICOPTERS
    if wanted != "auto" and vehicle.autopilot == mavlink.MAV_AUTOPILOT_GENERIC:
        heard = REGISTRY[wanted]
        types = _MULTICOPTERS | {mavlink.MAV_TYPE_GENERIC}
    fits = heard is not None and (wanted == "auto" or heard is REGISTRY[wanted])
    return heard if fits and vehicle.vehicle_type in types else None


def mismatch(vehicle: Vehicle, wanted: str) -> str:
    """Why a vehicle that was heard, and that `identify` does not know, is not served."""
    if vehicle.vehicle_type not in _MULTICOPTERS and vehicle.vehicle_type != mavlink.MAV_TYPE_GENERIC:
        return f"MAV_TYPE {vehicle.vehicle_type} is not a multicopter: not served"
    heard = None if vehicle.autopilot is None else by_heartbeat(vehicle.autopilot)
    name = heard.name if heard else f"MAV_AUTOPILOT {vehicle.autopilot}"
    return f"its heartbeat says {name}, the fleet file {wanted}: not served"

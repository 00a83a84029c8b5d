"""Simulated vehicles that speak MAVLink, one endpoint each, as stand-ins for real aircraft."""

from jpap_ros.sim.dynamics import MotionLimits
from jpap_ros.sim.fleet import SimFleet
from jpap_ros.sim.options import Fence, LinkFaults, VehicleOptions
from jpap_ros.sim.received import Received, ReceivedLog
from jpap_ros.sim.transport import SimError
from jpap_ros.sim.vehicle import SimVehicle

__all__ = [
    "Fence",
    "LinkFaults",
    "MotionLimits",
    "Received",
    "ReceivedLog",
    "SimError",
    "SimFleet",
    "SimVehicle",
    "VehicleOptions",
]

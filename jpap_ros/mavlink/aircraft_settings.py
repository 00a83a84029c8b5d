"""How aircraft are flown, the same for the whole fleet."""

from __future__ import annotations

from dataclasses import dataclass, field

from jpap_ros.mavlink.autopilots import Transport
from jpap_ros.mavlink.guards import GoalLimits


@dataclass(frozen=True)
class AircraftSettings:
    """How aircraft are flown; the same for the whole fleet.

    Attributes
    ----------
    setpoint_rate_hz : float
        Position targets a second to one aircraft; raised to what its autopilot needs.
    arrival_radius_m : float
        Goal reached within this distance [m].
    takeoff_height_m : float
        Above home [m].
    link_timeout_s : float
        Lost after this long without a heartbeat [s].
    ready_timeout_s : float
        How long a launch waits for GPS, home and pre-arm checks [s].
    transport : Transport
    simulated_clock : bool
        The aircraft are simulated, and may fly faster than the clock.
    limits : GoalLimits
    """

    setpoint_rate_hz: float = 2.0
    arrival_radius_m: float = 1.0
    takeoff_height_m: float = 10.0
    link_timeout_s: float = 4.0
    ready_timeout_s: float = 30.0
    transport: Transport = Transport.SETPOINT
    simulated_clock: bool = False
    limits: GoalLimits = field(default_factory=GoalLimits)

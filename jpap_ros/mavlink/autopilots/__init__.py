"""Autopilot personalities: every quirk of a firmware in one place."""

from jpap_ros.mavlink.autopilots import ardupilot, px4
from jpap_ros.mavlink.autopilots.base import (
    REGISTRY,
    AltitudeDatum,
    Autopilot,
    Target,
    TargetError,
    Transport,
    by_heartbeat,
)

__all__ = [
    "REGISTRY",
    "AltitudeDatum",
    "Autopilot",
    "Target",
    "TargetError",
    "Transport",
    "ardupilot",
    "by_heartbeat",
    "px4",
]

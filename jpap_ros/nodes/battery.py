"""When a battery asks for the operator's attention: from the charges at which the planner, as it comes, acts."""

from __future__ import annotations

from jpap_ros.fleet.availability import FleetPolicy

# Values of MAV_BATTERY_CHARGE_STATE, https://mavlink.io/en/messages/common.html
_LOW, _CRITICAL = 2, 3
_LIFE = FleetPolicy()


def is_low(remaining: float, charge_state: int) -> bool:
    """Whether a battery is low or worse, by its charge [0..1], NaN if unknown, or by the autopilot's word."""
    return remaining <= _LIFE.low_battery or charge_state >= _LOW


def is_critical(remaining: float, charge_state: int) -> bool:
    """Whether a battery is critical or worse, likewise."""
    return remaining <= _LIFE.critical_battery or charge_state >= _CRITICAL

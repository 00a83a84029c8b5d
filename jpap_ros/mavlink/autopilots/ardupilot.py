"""ArduPilot (Copter): GUIDED takes position targets in relative and AMSL frames and keeps the last one for ever."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.mavlink.autopilots.base import AltitudeDatum, Autopilot, Target, TargetError, Transport, register
from jpap_ros.mavlink.commands import ORDER_ATTEMPTS, Command
from jpap_ros.mavlink.vehicle import Vehicle

_PREFIX = "COPTER_MODE_"


@register
class ArduPilot(Autopilot):
    """ArduCopter's manners.

    Notes
    -----
    GUIDED needs no stream: a position target is kept after the sender has gone (GUID_TIMEOUT covers velocity,
    acceleration and attitude only). Targets are repeated because a lost one is not noticed otherwise. Holding is a
    position target too, not LOITER, whose height follows the throttle stick of a pilot who may not be there.
    https://ardupilot.org/dev/docs/copter-commands-in-guided-mode.html
    """

    name = "ardupilot"
    mav_autopilot = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    modes: ClassVar[dict[str, int]] = {
        entry.name.removeprefix(_PREFIX): number
        for number, entry in mavlink.enums["COPTER_MODE"].items()
        if not entry.name.endswith("ENUM_END")
    }
    goal_mode: ClassVar[dict[Transport, str]] = {Transport.SETPOINT: "GUIDED", Transport.REPOSITION: "GUIDED"}
    takeoff_modes: ClassVar[frozenset[str]] = frozenset({"GUIDED"})
    mode_before_takeoff = "GUIDED"
    hold_mode = "GUIDED"
    return_mode = "RTL"
    land_mode = "LAND"
    stream_lead_s = 0.0
    min_stream_hz = 0.0
    # GUID_TIMEOUT, its default, and v / 2a to brake from 8 m/s at WPNAV_ACCEL, 2.5 m/s^2.
    keeps_velocity_s = 3.0 + 1.6
    unasked_hz: ClassVar[Mapping[int, float]] = {}

    def set_mode(self, mode: str) -> Command:
        """DO_SET_MODE with the Copter mode number as custom mode."""
        params = (float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED), float(self.modes[mode]))
        return Command(mavlink.MAV_CMD_DO_SET_MODE, params, f"mode {mode}", True, attempts=ORDER_ATTEMPTS)

    def takeoff(self, vehicle: Vehicle, height_m: float) -> Command:
        """NAV_TAKEOFF; Copter reads its altitude as height above home."""
        return Command(mavlink.MAV_CMD_NAV_TAKEOFF, (0.0,) * 6 + (height_m,), "take off")

    def frame_and_altitude(self, target: Target, vehicle: Vehicle, datum: AltitudeDatum) -> tuple[int, float]:
        """Relative: frame 6 (GLOBAL_RELATIVE_ALT_INT); AMSL: frame 5 (GLOBAL_INT)."""
        if datum is AltitudeDatum.AMSL:
            return mavlink.MAV_FRAME_GLOBAL_INT, target.amsl_m
        if vehicle.home is None:
            raise TargetError(
                "home is not set: wait for a GPS fix or set home in the ground station, or use altitude_datum amsl"
            )
        return mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, target.height_m

    def parting(self, mode: str) -> Command | None:
        """Nothing: in GUIDED it flies to its last target and hovers there."""
        return None

"""PX4: OFFBOARD lives on an unbroken stream of targets; altitudes go out above mean sea level."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.mavlink.autopilots.base import AltitudeDatum, Autopilot, Target, TargetError, Transport, register
from jpap_ros.mavlink.commands import ORDER_ATTEMPTS, Command
from jpap_ros.mavlink.vehicle import Vehicle

_AUTO = 4
#: Main mode and sub mode by name.
_MODES = {
    "MANUAL": (1, 0),
    "ALTCTL": (2, 0),
    "POSCTL": (3, 0),
    "AUTO.READY": (_AUTO, 1),
    "AUTO.TAKEOFF": (_AUTO, 2),
    "AUTO.LOITER": (_AUTO, 3),
    "AUTO.MISSION": (_AUTO, 4),
    "AUTO.RTL": (_AUTO, 5),
    "AUTO.LAND": (_AUTO, 6),
    "AUTO.FOLLOW_TARGET": (_AUTO, 8),
    "AUTO.PRECLAND": (_AUTO, 9),
    "ACRO": (5, 0),
    "OFFBOARD": (6, 0),
    "STABILIZED": (7, 0),
    "RATTITUDE": (8, 0),
}


@register
class Px4(Autopilot):
    """PX4's manners.

    Notes
    -----
    OFFBOARD is refused unless targets have been arriving for a second, and left by failsafe once they have stopped
    for COM_OF_LOSS_T. Frame 6 has a sign error in some versions, so a height above home is sent as frame 5 with
    HOME_POSITION's altitude added. https://docs.px4.io/main/en/flight_modes/offboard.html
    """

    name = "px4"
    mav_autopilot = mavlink.MAV_AUTOPILOT_PX4
    modes: ClassVar[dict[str, int]] = {name: main << 16 | sub << 24 for name, (main, sub) in _MODES.items()}
    goal_mode: ClassVar[dict[Transport, str]] = {
        Transport.SETPOINT: "OFFBOARD",
        Transport.REPOSITION: "AUTO.LOITER",
    }
    # Take-off ends in Hold.
    takeoff_modes: ClassVar[frozenset[str]] = frozenset({"AUTO.TAKEOFF", "AUTO.LOITER"})
    mode_before_takeoff = None
    hold_mode = "AUTO.LOITER"
    return_mode = "AUTO.RTL"
    land_mode = "AUTO.LAND"
    stream_lead_s = 1.5
    min_stream_hz = 5.0
    # COM_OF_LOSS_T, its default, and v / 2a for Hold to brake from 8 m/s at MPC_ACC_HOR, 3 m/s^2.
    keeps_velocity_s = 1.0 + 1.3
    # MAVLINK_MODE_NORMAL of mavlink_main.cpp from 1 Hz on, without what the bridge asks for.
    unasked_hz: ClassVar[Mapping[int, float]] = {
        mavlink.MAVLINK_MSG_ID_ATTITUDE: 15.0,
        mavlink.MAVLINK_MSG_ID_RC_CHANNELS: 5.0,
        mavlink.MAVLINK_MSG_ID_VFR_HUD: 4.0,
        mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: 2.0,
        mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 1.5,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 1.0,
        mavlink.MAVLINK_MSG_ID_ALTITUDE: 1.0,
        mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: 1.0,
    }

    def set_mode(self, mode: str) -> Command:
        """DO_SET_MODE with main mode and sub mode apart."""
        main, sub = _MODES[mode]
        params = (float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED), float(main), float(sub))
        return Command(mavlink.MAV_CMD_DO_SET_MODE, params, f"mode {mode}", True, attempts=ORDER_ATTEMPTS)

    def takeoff(self, vehicle: Vehicle, height_m: float) -> Command:
        """NAV_TAKEOFF at the present position; PX4 reads its altitude as AMSL."""
        amsl_m = _home_amsl_m(vehicle) + height_m
        # Pitch 0; yaw, latitude, longitude NaN: as they are.
        params = (0.0, 0.0, 0.0, math.nan, math.nan, math.nan, amsl_m)
        return Command(mavlink.MAV_CMD_NAV_TAKEOFF, params, "take off")

    def frame_and_altitude(self, target: Target, vehicle: Vehicle, datum: AltitudeDatum) -> tuple[int, float]:
        """Frame 5 (GLOBAL_INT) always."""
        if datum is AltitudeDatum.AMSL:
            return mavlink.MAV_FRAME_GLOBAL_INT, target.amsl_m
        return mavlink.MAV_FRAME_GLOBAL_INT, _home_amsl_m(vehicle) + target.height_m

    def parting(self, mode: str) -> Command | None:
        """From OFFBOARD into Hold: the stream is about to end, and its failsafe might fly home instead."""
        return self.set_mode("AUTO.LOITER") if mode == "OFFBOARD" else None


def _home_amsl_m(vehicle: Vehicle) -> float:
    if vehicle.home is None:
        raise TargetError("home is not set: PX4 needs HOME_POSITION to turn a height into an altitude; wait for GPS")
    return vehicle.home.amsl_m

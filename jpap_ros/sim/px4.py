"""A simulated PX4 multicopter. `docs/simulated-vehicles.md` gives the source of each rule."""

from __future__ import annotations

import math
from types import MappingProxyType
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.sim.channel import Channel
from jpap_ros.sim.commands import ACCEPTED, DENIED, TEMPORARILY_REJECTED, UNSUPPORTED, Command
from jpap_ros.sim.flight import FlyAt, FlyTo, Follow, Point, Rest, TakeOff
from jpap_ros.sim.setpoint import MAX_HEIGHT_M, Parts, local_point, velocity_enu
from jpap_ros.sim.vehicle import SimVehicle

_AUTO = 4
#: Main and sub mode by name.
MODES = {
    "MANUAL": (1, 0),
    "ALTCTL": (2, 0),
    "POSCTL": (3, 0),
    "TAKEOFF": (_AUTO, 2),
    "HOLD": (_AUTO, 3),
    "MISSION": (_AUTO, 4),
    "RTL": (_AUTO, 5),
    "LAND": (_AUTO, 6),
    "OFFBOARD": (6, 0),
    "STABILIZED": (7, 0),
}
_NAMES = {numbers: name for name, numbers in MODES.items()}
_NO_POSITION_NEEDED = ("MANUAL", "ALTCTL", "STABILIZED", "LAND")

RTL_RETURN_ALT_M = 60.0
RTL_CONE_SLOPE = 1.0
NAV_ACC_RAD_M = 2.0
#: Gain of the position controller: a target at rest with velocity v is overrun by v / MPC_XY_P [1/s].
MPC_XY_P = 0.95
#: A goal this far above the ground makes an aircraft in OFFBOARD take off [m].
_LIFT_OFF_M = 0.3


class Px4Vehicle(SimVehicle):
    """PX4 1.15 as a peer sees it."""

    AUTOPILOT = mavlink.MAV_AUTOPILOT_PX4
    MODE_NAMES = tuple(MODES)
    CAPABILITIES = (
        mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
        | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
        | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    )
    FLIGHT_SW_VERSION = 0x010F00FF
    BOOT_RATES_HZ = MappingProxyType(
        {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
            mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0,
            mavlink.MAVLINK_MSG_ID_ATTITUDE: 15.0,
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 1.0,
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 5.0,
            mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: 0.1,
            mavlink.MAVLINK_MSG_ID_VFR_HUD: 4.0,
            mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: 1.0,
            mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 1.5,
            mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
            mavlink.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
            mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1.0,
        }
    )
    ECHO_FRAME = mavlink.MAV_FRAME_GLOBAL_INT
    ECHO_TYPE_MASK = 0
    PARAMETERS = MappingProxyType(
        {
            "MAV_SYS_ID": 1,
            "MIS_TAKEOFF_ALT": 2.5,
            "MPC_XY_VEL_MAX": 12.0,
            "RTL_RETURN_ALT": RTL_RETURN_ALT_M,
            "COM_OF_LOSS_T": 1.0,
            "COM_DISARM_PRFLT": 10.0,
        }
    )
    BYTEWISE_PARAMETERS = True
    UNKNOWN_REQUEST_RESULT = DENIED
    LAND_SPEED = 0.7
    DISARM_AFTER_LANDING_S = 2.0
    ARMING_REFUSED_TEXT = "Arming denied: {}"
    ARMING_REFUSED_RESULT = TEMPORARILY_REJECTED
    FORCE_ARMS = False
    NO_POSITION_TEXT = "No valid global position estimate"
    ARMED_TEXT = "Armed by external command"
    DISARMED_TEXT = "Disarmed: {}"

    def booted(self) -> None:
        """Start in Hold."""
        self._mode = "HOLD"
        self._stream_began = self._stream_last = -math.inf
        self._take_off_amsl = math.nan
        self._gcs_heard: float | None = None

    @property
    def mode(self) -> str:
        """Flight mode by name."""
        return self._mode

    @property
    def custom_mode(self) -> int:
        """Main mode in bits 16 to 23, sub mode above."""
        main, sub = MODES[self._mode]
        return main << 16 | sub << 24

    def base_mode(self) -> int:
        """MAV_MODE_FLAG bits of the heartbeat."""
        auto = MODES[self._mode][0] == _AUTO
        flags = mavlink.MAV_MODE_FLAG_AUTO_ENABLED | mavlink.MAV_MODE_FLAG_GUIDED_ENABLED if auto else 0
        return int(super().base_mode() | flags)

    def global_target(self) -> Point | None:
        """The navigator's goal; the navigator does not run in OFFBOARD."""
        return None if self._mode == "OFFBOARD" else super().global_target()

    # Modes

    def do_set_mode(self, command: Command) -> int:
        """MAV_CMD_DO_SET_MODE: main mode and sub mode apart."""
        if not command.integer(1) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            return TEMPORARILY_REJECTED
        main, sub = command.integer(2), command.integer(3)
        return self._request(_NAMES.get((main, sub if main == _AUTO else 0)))

    def request_mode(self, custom_mode: int) -> bool:
        """SET_MODE, with main and sub mode packed."""
        return self._request(_NAMES.get((custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF))) == ACCEPTED

    def _request(self, name: str | None) -> int:
        """Any mode while disarmed; when armed, what it needs must be there."""
        if name is None or (self.armed and self._cannot_run(name) is not None):
            shown = "mode" if name is None else name.capitalize()
            self.say(f"Switching to mode '{shown}' is currently not possible", mavlink.MAV_SEVERITY_CRITICAL)
            return TEMPORARILY_REJECTED
        if self.failsafe == "OFFBOARD":
            self.failsafe = None
        self.change_mode(name)
        return ACCEPTED

    def _cannot_run(self, name: str) -> str | None:
        if name not in _NO_POSITION_NEEDED and not self.gps_ready:
            return self.NO_POSITION_TEXT
        if name == "OFFBOARD" and not self._stream_proven():
            return "No offboard signal"
        return "No valid mission available" if name == "MISSION" else None

    def _stream_proven(self) -> bool:
        fresh = self.now - self._stream_last <= self.options.offboard_loss_s
        return fresh and self.now - self._stream_began >= self.options.offboard_proof_s

    def change_mode(self, mode: str) -> None:
        """Change to a mode that exists, and do what it does."""
        if mode == self._mode:
            return
        self._mode = mode
        if self.armed:
            self._fly_mode()

    def _fly_mode(self) -> None:
        if self._mode == "TAKEOFF" and self.on_ground:
            self._begin_take_off()
        elif self._mode == "LAND":
            self.land_here()
        elif self._mode == "RTL":
            self._begin_return()
        else:
            self.hold_here()

    def _begin_take_off(self) -> None:
        lowest = self.home_z() + self.parameters["MIS_TAKEOFF_ALT"]
        wanted = self._take_off_amsl - self.frame.origin.altitude_amsl_m
        self.manoeuvre = TakeOff(
            (self.body.x, self.body.y, max(wanted, lowest) if abs(wanted) <= MAX_HEIGHT_M else lowest)
        )

    def _begin_return(self) -> None:
        home = self.home if self.home is not None else self.body.position
        far = math.hypot(self.body.x - home[0], self.body.y - home[1])
        if far <= NAV_ACC_RAD_M:
            climb_to = 2.0 * far
        else:
            climb_to = max(2.0 * NAV_ACC_RAD_M, min(RTL_RETURN_ALT_M, RTL_CONE_SLOPE * far))
        self.return_home(max(self.body.stopping_point()[2], home[2] + climb_to), 0.0)

    # Commands

    def arming_problem(self) -> str | None:
        """The mode must be able to run."""
        if self._mode in ("RTL", "LAND"):
            return f"Mode {self._mode} prevents arming"
        return self._cannot_run(self._mode) or super().arming_problem()

    def armed_now(self) -> None:
        """A mode chosen on the ground begins."""
        if self._mode == "TAKEOFF":
            self._begin_take_off()

    def refused_disarm(self) -> int:
        """PX4 does not disarm in the air."""
        self.say("Disarming denied: not landed", mavlink.MAV_SEVERITY_CRITICAL)
        return TEMPORARILY_REJECTED

    def land_command(self) -> int:
        """MAV_CMD_NAV_LAND."""
        return self._request("LAND")

    def return_command(self) -> int:
        """MAV_CMD_NAV_RETURN_TO_LAUNCH."""
        return self._request("RTL")

    def take_off(self, command: Command) -> int:
        """The altitude is above mean sea level, at least MIS_TAKEOFF_ALT above home; not armed, it waits."""
        self._take_off_amsl = command.param(7)
        if self._mode == "TAKEOFF" and self.armed and self.on_ground and self.gps_ready:
            self._begin_take_off()
            return ACCEPTED
        return self._request("TAKEOFF")

    def take_off_finished(self) -> None:
        """Take-off ends in Hold."""
        goal = self.manoeuvre.goal
        self._mode = "HOLD"
        if goal is not None:
            self.manoeuvre = FlyTo(goal)

    def reposition(self, command: Command) -> int:
        """Into Hold, and to the place if the fence allows it; the acknowledgement is for the mode alone."""
        if command.integer(2) != mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE:
            return UNSUPPORTED
        result = self._request("HOLD")
        if result != ACCEPTED or not self.armed or self.on_ground:
            return result
        lat, lon = command.lat_lon()
        amsl, yaw = command.param(7), command.param(4)
        up = amsl - self.frame.origin.altitude_amsl_m if abs(amsl) <= MAX_HEIGHT_M else self.body.z
        goal: Point | None = (self.body.x, self.body.y, up)
        if abs(lat) <= 90.0 and abs(lon) <= 180.0:
            goal = self.map_point(round(lat * 1e7), round(lon * 1e7), up)
        if goal is None or not self.within_fence(goal):
            self.say("Reposition is outside geofence", mavlink.MAV_SEVERITY_CRITICAL)
        else:
            self.manoeuvre = FlyTo(goal, yaw if math.isfinite(yaw) else None)
        return result

    # OFFBOARD

    def setpoint(self, message: Any) -> None:
        """Valid targets prove the stream in every mode and steer in OFFBOARD."""
        parts = Parts.of(message)
        goal: Point | None = None
        if parts.position:
            goal = self._goal(message)
            if goal is None:
                return
        velocity = velocity_enu(message) if parts.velocity else None
        if velocity is None and (goal is None or parts.velocity):
            return
        if self.now - self._stream_last > self.options.offboard_loss_s:
            self._stream_began = self.now
        self._stream_last = self.now
        if self.failsafe == "OFFBOARD" and self.options.offboard_resumes and self._stream_proven():
            self.failsafe = None
            self.change_mode("OFFBOARD")
        if self._mode != "OFFBOARD" or not self.armed:
            return
        if self.on_ground and goal is not None and goal[2] > _LIFT_OFF_M:
            self.on_ground = False
        if goal is None:
            if velocity is not None:
                self.manoeuvre = FlyAt(velocity, parts.yaw, math.inf)
        elif velocity is not None and not self.on_ground:
            self.manoeuvre = Follow(goal, velocity, parts.yaw, self.patience_s(1.0 / MPC_XY_P))
        elif not isinstance(self.manoeuvre, FlyTo) or (self.manoeuvre.goal, self.manoeuvre.yaw) != (goal, parts.yaw):
            self.manoeuvre = FlyTo(goal, parts.yaw)

    def _goal(self, message: Any) -> Point | None:
        if message.get_type() == "SET_POSITION_TARGET_LOCAL_NED":
            known = message.coordinate_frame == mavlink.MAV_FRAME_LOCAL_NED
            return local_point(self, message) if known else None
        if self.ekf_origin is None or not abs(message.alt) <= MAX_HEIGHT_M:
            return None
        frame = message.coordinate_frame
        if frame == mavlink.MAV_FRAME_GLOBAL_INT:
            up = message.alt - self.frame.origin.altitude_amsl_m
        elif frame == mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT:
            # PX4's sign error: right only where home and the estimator's origin are level.
            up = message.alt + 2.0 * self.ekf_origin[2] - self.home_z()
        elif frame == mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT:
            up = message.alt
        else:
            text = f"SET_POSITION_TARGET_GLOBAL_INT invalid frame {frame}"
            self.say(text, mavlink.MAV_SEVERITY_CRITICAL)
            return None
        return self.map_point(message.lat_int, message.lon_int, up)

    # Failsafes

    def heard_heartbeat(self, message: Any, channel: Channel) -> None:
        """Feeds the data link failsafe."""
        if message.type == mavlink.MAV_TYPE_GCS:
            self._gcs_heard = self.now

    def watch_peers(self, now: float) -> None:
        """COM_OF_LOSS_T after the last target OFFBOARD ends; NAV_DLL_ACT returns home without a ground station."""
        if not self.armed:
            return
        if self._mode == "OFFBOARD" and now - self._stream_last > self.options.offboard_loss_s:
            self.failsafe = "OFFBOARD"
            self.say("Failsafe activated: No offboard signal", mavlink.MAV_SEVERITY_CRITICAL)
            self.change_mode(self.options.offboard_loss_mode)
        limit = self.options.gcs_failsafe_s
        missing = limit is not None and self._gcs_heard is not None and now - self._gcs_heard > limit
        if missing and not self.on_ground and self.failsafe != "GCS":
            self.failsafe = "GCS"
            self.say("Failsafe activated: GCS connection lost", mavlink.MAV_SEVERITY_CRITICAL)
            self.change_mode("RTL")

    def _watch_battery(self) -> None:
        if self.battery <= 0.5 * self.options.battery_critical:
            self._battery_failsafe("BATTERY EMERGENCY", "Dangerously low", "LAND")
        elif self.battery <= self.options.battery_critical:
            self._battery_failsafe("BATTERY CRITICAL", "Critical", "RTL")

    def _battery_failsafe(self, failsafe: str, level: str, mode: str) -> None:
        if self.failsafe in (failsafe, "BATTERY EMERGENCY"):
            return
        self.failsafe = failsafe
        self.say(f"{level} battery, {mode.lower()}ing", mavlink.MAV_SEVERITY_CRITICAL)
        if self._mode != "LAND":
            self.change_mode(mode)

    def disarmed(self) -> None:
        """Modes that prevent arming give way to Hold."""
        if self.on_ground:
            self.manoeuvre = Rest()
        if self._mode in ("RTL", "LAND", "TAKEOFF"):
            self._mode = "HOLD"

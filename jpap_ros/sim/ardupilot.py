"""A simulated ArduCopter. `docs/simulated-vehicles.md` gives the source of each rule."""

from __future__ import annotations

import math
from types import MappingProxyType
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.sim.channel import Channel
from jpap_ros.sim.commands import ACCEPTED, DENIED, FAILED, UNSUPPORTED, Command
from jpap_ros.sim.flight import FlyAt, FlyTo, Follow, Point, Rest, TakeOff
from jpap_ros.sim.setpoint import MAX_HEIGHT_M, RELATIVE_FRAMES, Parts, local_point, up_of_altitude, velocity_enu
from jpap_ros.sim.vehicle import SimVehicle

MODES = {
    "STABILIZE": 0,
    "ALT_HOLD": 2,
    "AUTO": 3,
    "GUIDED": 4,
    "LOITER": 5,
    "RTL": 6,
    "LAND": 9,
    "POSHOLD": 16,
    "BRAKE": 17,
}
_NAMES = {number: name for name, number in MODES.items()}
_NO_POSITION_NEEDED = ("STABILIZE", "ALT_HOLD", "LAND")
_TAKE_OFF = ("GUIDED", "LOITER", "POSHOLD")
_NOT_ARMABLE = ("RTL", "LAND", "BRAKE", "AUTO")

RTL_ALT_M = 15.0
RTL_CONE_SLOPE = 3.0
RTL_ALT_MIN_M = 2.0
RTL_LOIT_TIME_S = 5.0
GUID_TIMEOUT_S = 3.0


class ArduPilotVehicle(SimVehicle):
    """ArduCopter 4.6 as a peer sees it."""

    AUTOPILOT = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    MODE_NAMES = tuple(MODES)
    CAPABILITIES = (
        mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
        | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
        | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    )
    FLIGHT_SW_VERSION = 0x040600FF
    BOOT_RATES_HZ = MappingProxyType({mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0})
    ECHO_FRAME = mavlink.MAV_FRAME_GLOBAL
    # Position counts; velocity, acceleration and yaw do not; the highest bits are set as ArduPilot sets them.
    ECHO_TYPE_MASK = 0xFDF8
    PARAMETERS = MappingProxyType(
        {
            "MAV_SYSID": 1,
            "MAV_GCS_SYSID": 255,
            "DISARM_DELAY": 10,
            "RTL_ALT": 1500.0,
            "WPNAV_SPEED": 1000.0,
            "FENCE_ENABLE": 0,
        }
    )
    BYTEWISE_PARAMETERS = False
    LAND_SPEED = 0.5
    DISARM_AFTER_LANDING_S = 1.0
    ARMING_REFUSED_TEXT = "Arm: {}"
    ARMING_REFUSED_RESULT = FAILED
    NO_POSITION_TEXT = "Need Position Estimate"
    ARMED_TEXT = "Arming motors"
    DISARMED_TEXT = "Disarming motors"

    def booted(self) -> None:
        """Start in STABILIZE."""
        self._mode = "STABILIZE"
        self._gcs_heard: float | None = None

    @property
    def mode(self) -> str:
        """Flight mode by name."""
        return self._mode

    @property
    def custom_mode(self) -> int:
        """Flight mode by number."""
        return MODES[self._mode]

    def base_mode(self) -> int:
        """MAV_MODE_FLAG bits of the heartbeat."""
        guided = mavlink.MAV_MODE_FLAG_GUIDED_ENABLED if self._mode in ("GUIDED", "AUTO", "RTL") else 0
        return int(super().base_mode() | mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED | guided)

    def _healthy_status(self) -> int:
        return int(mavlink.MAV_STATE_STANDBY if self.on_ground else mavlink.MAV_STATE_ACTIVE)

    def position_before_fix(self) -> Any:
        """ArduPilot sends GLOBAL_POSITION_INT all the same, at 0, 0."""
        return mavlink.MAVLink_global_position_int_message(self.boot_ms(), 0, 0, 0, 0, 0, 0, 0, 0)

    def global_target(self) -> Point | None:
        """The flight mode's waypoint: the target that was sent in GUIDED, the way home in RTL, nothing elsewhere."""
        manoeuvre = self.manoeuvre
        sent = self._mode == "GUIDED" and isinstance(manoeuvre, FlyTo) and manoeuvre.face_goal
        return super().global_target() if sent or self._mode == "RTL" else None

    # Who may command

    def obeys(self, sysid: int) -> bool:
        """With SYSID_ENFORCE only the ground station."""
        return not self.options.sysid_enforce or sysid == self.options.gcs_sysid

    def heard_heartbeat(self, message: Any, channel: Channel) -> None:
        """Feeds the ground station failsafe."""
        if message.get_srcSystem() == self.options.gcs_sysid:
            self._gcs_heard = self.now
            if self.failsafe == "GCS":
                self.failsafe = None

    def watch_peers(self, now: float) -> None:
        """FS_GCS_ENABLE: return home once the ground station, heard before, is missing."""
        limit = self.options.gcs_failsafe_s
        if limit is None or self._gcs_heard is None or not self.armed or self.on_ground or self.failsafe is not None:
            return
        if now - self._gcs_heard > limit:
            self.failsafe = "GCS"
            self.say("GCS Failsafe", mavlink.MAV_SEVERITY_WARNING)
            self.change_mode("RTL")

    # Modes

    def do_set_mode(self, command: Command) -> int:
        """MAV_CMD_DO_SET_MODE."""
        if not command.integer(1) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            return UNSUPPORTED
        return ACCEPTED if self.request_mode(command.integer(2)) else FAILED

    def request_mode(self, custom_mode: int) -> bool:
        """Change the mode if it exists and, when armed, has what it needs."""
        name = _NAMES.get(custom_mode)
        if name is None:
            self.say(f"No such mode {custom_mode}", mavlink.MAV_SEVERITY_WARNING)
            return False
        if self.armed and name not in _NO_POSITION_NEEDED and not self.gps_ready:
            self.say(f"Mode change to {name} failed: requires position", mavlink.MAV_SEVERITY_WARNING)
            return False
        self.change_mode(name)
        return True

    def change_mode(self, mode: str) -> None:
        """Change to a mode that exists, and do what it does."""
        if mode == self._mode:
            return
        self._mode = mode
        self.beat()
        if not self.armed:
            return
        if mode == "LAND":
            self.land_here()
        elif mode == "RTL":
            home = self.home if self.home is not None else self.body.position
            far = math.hypot(self.body.x - home[0], self.body.y - home[1])
            climb_to = home[2] + min(RTL_ALT_M, max(RTL_ALT_MIN_M, RTL_CONE_SLOPE * far))
            self.return_home(max(self.body.stopping_point()[2], climb_to), RTL_LOIT_TIME_S)
        else:
            self.hold_here()

    def arming_problem(self) -> str | None:
        """Some modes cannot be armed in."""
        return f"{self._mode} mode not armable" if self._mode in _NOT_ARMABLE else super().arming_problem()

    def armed_now(self) -> None:
        """Nothing: take-off is asked for separately."""

    def refused_disarm(self) -> int:
        """ArduCopter does not disarm in the air."""
        return FAILED

    def land_command(self) -> int:
        """MAV_CMD_NAV_LAND switches to LAND."""
        return ACCEPTED if self.request_mode(MODES["LAND"]) else FAILED

    def return_command(self) -> int:
        """MAV_CMD_NAV_RETURN_TO_LAUNCH switches to RTL."""
        return ACCEPTED if self.request_mode(MODES["RTL"]) else FAILED

    def take_off(self, command: Command) -> int:
        """Needs a mode with a take-off, armed, on the ground; the altitude is relative to home."""
        if command.is_int and command.frame not in RELATIVE_FRAMES:
            return DENIED
        height = command.param(7)
        # Parameter 3: the pilot steers sideways, so that no position has to be held.
        fits = self._mode in _TAKE_OFF or (self._mode == "ALT_HOLD" and command.param(3) != 0.0)
        if not fits or not self.armed or not self.on_ground or not 0.0 < height <= MAX_HEIGHT_M:
            return FAILED
        goal = (self.body.x, self.body.y, self.home_z() + height)
        if not self.within_fence(goal):
            return FAILED
        self.manoeuvre = TakeOff(goal)
        return ACCEPTED

    def take_off_finished(self) -> None:
        """Stay where the climb ended."""
        goal = self.manoeuvre.goal
        if goal is not None:
            self.manoeuvre = FlyTo(goal)

    # Guided flight

    def setpoint(self, message: Any) -> None:
        """GUIDED only; what cannot be flown stops the aircraft, what the fence forbids changes nothing."""
        if self._mode != "GUIDED" or not self.armed:
            return
        parts = Parts.of(message)
        if parts.force and parts.acceleration:
            self.hold_here()
        elif parts.position:
            goal = self._goal(message)
            velocity = velocity_enu(message) if parts.velocity else None
            if goal is None or (parts.velocity and velocity is None):
                self.hold_here()
            elif velocity is None or self.on_ground:
                self._fly_to(goal, parts.yaw)
            elif self.within_fence(goal):
                self.manoeuvre = Follow(goal, velocity, parts.yaw, self.patience_s(GUID_TIMEOUT_S))
        elif parts.velocity and not self.on_ground and (velocity := velocity_enu(message)) is not None:
            self.manoeuvre = FlyAt(velocity, parts.yaw, self.patience_s(GUID_TIMEOUT_S))
        else:
            self.hold_here()

    def reposition(self, command: Command) -> int:
        """Out of another mode only with the change-mode flag; as COMMAND_LONG the altitude is AMSL."""
        change = command.integer(2) & mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE
        if self._mode != "GUIDED" and not change:
            return DENIED
        lat, lon = command.lat_lon()
        up = up_of_altitude(self, command.frame, command.param(7))
        if up is None or not (abs(lat) <= 90.0 and abs(lon) <= 180.0):
            return DENIED
        goal = self.map_point(round(lat * 1e7), round(lon * 1e7), up)
        if goal is None:
            return DENIED
        if not self.gps_ready or not self.within_fence(goal):
            return FAILED
        self.change_mode("GUIDED")
        if self.armed:
            self._fly_to(goal, None)
        return ACCEPTED

    def _goal(self, message: Any) -> Point | None:
        if message.get_type() == "SET_POSITION_TARGET_LOCAL_NED":
            return local_point(self, message)
        up = up_of_altitude(self, message.coordinate_frame, message.alt)
        if up is None or abs(message.lat_int) > 900_000_000 or abs(message.lon_int) > 1_800_000_000:
            return None
        return self.map_point(message.lat_int, message.lon_int, up)

    def _fly_to(self, goal: Point, yaw: float | None) -> None:
        if not self.within_fence(goal):
            return
        present = self.manoeuvre
        if isinstance(present, FlyTo) and present.goal == goal and present.yaw == yaw:
            return
        self.manoeuvre = FlyTo(goal, yaw, face_goal=True)

    # Failsafes

    def _watch_battery(self) -> None:
        if self.battery <= self.options.battery_critical and self.failsafe != "BATTERY CRITICAL":
            self._battery_failsafe("BATTERY CRITICAL", "critical", "LAND")
        elif self.battery <= self.options.battery_low and self.failsafe not in ("BATTERY", "BATTERY CRITICAL"):
            self._battery_failsafe("BATTERY", "low", "RTL")

    def _battery_failsafe(self, failsafe: str, level: str, mode: str) -> None:
        self.failsafe = failsafe
        self.say(f"Battery 1 is {level}", mavlink.MAV_SEVERITY_WARNING)
        self.say("Battery Failsafe", mavlink.MAV_SEVERITY_WARNING)
        if self._mode != "LAND":
            self.change_mode(mode)

    def disarmed(self) -> None:
        """The mode stays."""
        if self.on_ground:
            self.manoeuvre = Rest()

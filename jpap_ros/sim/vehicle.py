"""A simulated vehicle without any input or output: messages in, messages out, time given from outside."""

from __future__ import annotations

import math
import random
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.fleet.config import UavConfig
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.sim.anchor import GeodeticAnchor
from jpap_ros.sim.channel import Channel
from jpap_ros.sim.commands import (
    ACCEPTED,
    COMMAND_INT_ONLY,
    COMMAND_LONG_ONLY,
    FAILED,
    FORCE_ARM_MAGIC,
    UNSUPPORTED,
    Command,
)
from jpap_ros.sim.dynamics import PointMass
from jpap_ros.sim.flight import Fall, FlyTo, Land, Manoeuvre, Point, Rest, ReturnHome, TakeOff
from jpap_ros.sim.options import VehicleOptions
from jpap_ros.sim.parameters import ParameterTable
from jpap_ros.sim.received import ReceivedLog
from jpap_ros.sim.requests import QUESTIONS, REQUESTS
from jpap_ros.sim.telemetry import BUILDERS

#: A peer that sends targets five times a second of the wall clock is not timed out between two of them, nor by a
#: little delay [s].
_TARGET_GAP_S = 0.6
#: Share of the hovering current that idling motors draw.
_IDLE_DRAIN = 0.1


class SimVehicle(ABC):
    """What both autopilots have in common.

    The simulation runs on two clocks. Flight (motion, battery, GPS start-up, waits in the air) runs on simulated
    time, `dt`, which a speed-up factor stretches. Whatever a peer times (message intervals, setpoint streams,
    heartbeats of a ground station, automatic disarming on the ground) runs on the wall clock, `now`.

    Parameters
    ----------
    config : UavConfig
    frame : LocalFrame
        The map.
    start : tuple of float
        Where it stands, (east, north) [m].
    options : VehicleOptions
    seed : int
    lock : threading.RLock
        Held by the fleet while it works on the vehicle.
    """

    AUTOPILOT: ClassVar[int]
    MODE_NAMES: ClassVar[tuple[str, ...]]
    CAPABILITIES: ClassVar[int]
    FLIGHT_SW_VERSION: ClassVar[int]
    BOOT_RATES_HZ: ClassVar[Mapping[int, float]]
    ECHO_FRAME: ClassVar[int]
    ECHO_TYPE_MASK: ClassVar[int]
    PARAMETERS: ClassVar[Mapping[str, int | float]]
    BYTEWISE_PARAMETERS: ClassVar[bool]
    AUTO_DISARM_S: ClassVar[float] = 10.0
    FORCE_ARMS: ClassVar[bool] = True
    UNKNOWN_REQUEST_RESULT: ClassVar[int] = FAILED
    LAND_SPEED: ClassVar[float]
    DISARM_AFTER_LANDING_S: ClassVar[float]

    def __init__(
        self,
        config: UavConfig,
        frame: LocalFrame,
        start: tuple[float, float],
        options: VehicleOptions,
        seed: int,
        lock: threading.RLock,
    ) -> None:
        self.name, self.sysid = config.name, config.sysid
        self.frame, self.options = frame, options
        self.body = PointMass(start[0], start[1], 0.0, options.limits)
        self.random = random.Random(f"{seed}:{config.sysid}")
        self.lock = lock
        self.channels: list[Channel] = []
        self.received = ReceivedLog()
        self.battery = options.battery
        self.link_faults = options.link_faults
        self.silent = False
        self.prearm_failure = options.prearm_failure
        self.refuse_arming = options.refuse_arming
        self.now = 0.0
        #: Simulated seconds a second of the wall clock.
        self.speedup = 1.0
        self._anchor = GeodeticAnchor(frame)
        self._commands = self._command_table()
        # What a reboot sets anew; see _boot.
        self.clock_s = 0.0
        self.armed = self.crashed = self.gps_ready = False
        self.on_ground = True
        self.failsafe: str | None = None
        self.home: Point | None = None
        self.ekf_origin: Point | None = None
        self.manoeuvre: Manoeuvre = Rest()
        self._goal_wire: tuple[Point, tuple[int, int]] | None = None
        self._idle_since = self._gps_at_s = 0.0
        self._boot()

    # State that tests and the demo look at

    @property
    def position(self) -> Point:
        """True position, (east, north, up) [m]."""
        return self.body.position

    @property
    @abstractmethod
    def mode(self) -> str:
        """Flight mode by name."""

    def base_mode(self) -> int:
        """MAV_MODE_FLAG bits of the heartbeat."""
        flags = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
        return int(flags | mavlink.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else flags)

    @property
    @abstractmethod
    def custom_mode(self) -> int:
        """Flight mode of the heartbeat."""

    def system_status(self) -> int:
        """MAV_STATE of the heartbeat."""
        if self.crashed:
            return int(mavlink.MAV_STATE_EMERGENCY)
        if not self.gps_ready and not self.armed:
            return int(mavlink.MAV_STATE_CALIBRATING)
        if self.failsafe is not None:
            return int(mavlink.MAV_STATE_CRITICAL)
        return int(self._healthy_status())

    def _healthy_status(self) -> int:
        return int(mavlink.MAV_STATE_ACTIVE if self.armed else mavlink.MAV_STATE_STANDBY)

    def landed_state(self) -> int:
        """MAV_LANDED_STATE."""
        if isinstance(self.manoeuvre, TakeOff) and self.armed:
            return int(mavlink.MAV_LANDED_STATE_TAKEOFF)
        if self.on_ground:
            return int(mavlink.MAV_LANDED_STATE_ON_GROUND)
        if isinstance(self.manoeuvre, Land):
            return int(mavlink.MAV_LANDED_STATE_LANDING)
        return int(mavlink.MAV_LANDED_STATE_IN_AIR)

    def charge_state(self) -> int:
        """MAV_BATTERY_CHARGE_STATE."""
        if self.battery > self.options.battery_low:
            return int(mavlink.MAV_BATTERY_CHARGE_STATE_OK)
        if self.battery > self.options.battery_critical:
            return int(mavlink.MAV_BATTERY_CHARGE_STATE_LOW)
        if self.battery > 0.5 * self.options.battery_critical:
            return int(mavlink.MAV_BATTERY_CHARGE_STATE_CRITICAL)
        return int(mavlink.MAV_BATTERY_CHARGE_STATE_EMERGENCY)

    # Geodesy

    def amsl(self, up: float) -> float:
        """Height above mean sea level of a height in the map [m]."""
        return self.frame.origin.altitude_amsl_m + up

    def home_z(self) -> float:
        """Height in the map that relative altitudes count from [m]."""
        return 0.0 if self.home is None else self.home[2]

    def lat_lon_e7(self) -> tuple[int, int]:
        """Present latitude and longitude [1e-7 deg]."""
        lat, lon = self._anchor.to_geodetic(self.body.x, self.body.y)
        return round(lat * 1e7), round(lon * 1e7)

    def geodetic_e7(self, x: float, y: float) -> tuple[int, int]:
        """Latitude and longitude of a map point [1e-7 deg]."""
        lat, lon = self.frame.to_geodetic(x, y)
        return round(lat * 1e7), round(lon * 1e7)

    def goal_e7(self, goal: Point) -> tuple[int, int]:
        """Latitude and longitude of the present goal [1e-7 deg]."""
        if self._goal_wire is None or self._goal_wire[0] != goal:
            self._goal_wire = (goal, self.geodetic_e7(goal[0], goal[1]))
        return self._goal_wire[1]

    def global_target(self) -> Point | None:
        """Where POSITION_TARGET_GLOBAL_INT says that it is flying to; None where it says nothing."""
        return self.manoeuvre.goal if self.armed and self.gps_ready else None

    def map_point(self, lat_e7: int, lon_e7: int, z: float) -> Point | None:
        """The map point of a position on the wire; None if it is not on the map."""
        if self._goal_wire is not None and self._goal_wire[1] == (lat_e7, lon_e7):
            x, y, _ = self._goal_wire[0]
        else:
            try:
                x, y = self.frame.to_map(lat_e7 / 1e7, lon_e7 / 1e7)
            except ValueError:
                return None
        point = (x, y, z)
        self._goal_wire = (point, (lat_e7, lon_e7))
        return point

    # Time

    def boot_ms(self) -> int:
        """Simulated time since boot [ms]."""
        return int(self.clock_s * 1e3)

    def boot_us(self) -> int:
        """Simulated time since boot [µs]."""
        return int(self.clock_s * 1e6)

    def patience_s(self, timeout_s: float) -> float:
        """Simulated time that a moving target lasts for an autopilot's time-out [s].

        It is the aircraft's own, so it does not fly farther than speed times time-out, but for simulations so fast
        that the time-out would be over before the peer's next target.
        """
        return max(timeout_s, _TARGET_GAP_S * self.speedup)

    def beat(self) -> None:
        """Send a HEARTBEAT now, beside those that are due."""
        for channel in self.channels:
            channel.put(BUILDERS[mavlink.MAVLINK_MSG_ID_HEARTBEAT](self))

    def attach(self, link_id: int) -> Channel:
        """Open another channel."""
        channel = Channel(self.sysid, self.BOOT_RATES_HZ, self.options.signing_key, self.random.random(), link_id)
        self.channels.append(channel)
        return channel

    def advance(self, dt: float) -> None:
        """Let simulated time pass: at most `MAX_STEP_S` seconds."""
        self.clock_s += dt
        if not self.gps_ready and self.clock_s >= self._gps_at_s:
            self._find_position()
        if self.armed and not self.crashed:
            rate = _IDLE_DRAIN if self.on_ground else 1.0
            self.battery = max(0.0, self.battery - rate * dt / self.options.endurance_s)
            if not self.on_ground:
                self._watch_battery()
        self.manoeuvre.step(self, dt)

    def tick(self, now: float) -> None:
        """Do what depends on the wall clock, and pack the messages that are due."""
        self.now = now
        self.watch_peers(now)
        if not self.armed or not self.on_ground or isinstance(self.manoeuvre, TakeOff):
            self._idle_since = now
        elif now - self._idle_since > self.AUTO_DISARM_S:
            self.disarm("auto disarm on the ground")
        for channel in self.channels:
            for kind in channel.due(now):
                message = BUILDERS[kind](self)
                if message is not None:
                    channel.put(message)

    @abstractmethod
    def watch_peers(self, now: float) -> None:
        """Failsafes on streams and heartbeats."""

    # Messages in

    def receive(self, message: Any, channel: Channel, now: float) -> None:
        """Act on a message from a peer."""
        self.now = now
        if self.silent or message.get_srcSystem() == self.sysid:
            return
        handler = _HANDLERS.get(message.get_type())
        if handler is None:
            return
        if getattr(message, "target_system", 0) not in (0, self.sysid):
            return
        if getattr(message, "target_component", 0) not in (0, mavlink.MAV_COMP_ID_AUTOPILOT1):
            return
        self.received.note(message, now)
        if message.get_type() == "HEARTBEAT" or self.obeys(message.get_srcSystem()):
            handler(self, message, channel)

    def obeys(self, sysid: int) -> bool:
        """Whether a sender may command this vehicle."""
        return True

    @abstractmethod
    def heard_heartbeat(self, message: Any, channel: Channel) -> None:
        """A peer's HEARTBEAT."""

    def _on_command(self, message: Any, channel: Channel) -> None:
        command = Command.of(message)
        action = self._commands.get(command.command)
        request = REQUESTS.get(command.command)
        if command.command in (self.options.long_only if command.is_int else self.options.int_only):
            result = COMMAND_LONG_ONLY if command.is_int else COMMAND_INT_ONLY
        elif request is not None:
            result = request(self, command, channel)
        else:
            result = action(command) if action is not None else UNSUPPORTED
        ack = mavlink.MAVLink_command_ack_message(command.command, result, 0, 0, *command.source)
        channel.put(ack)
        if command.command == mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN and result == ACCEPTED:
            self.reboot()

    def _on_set_mode(self, message: Any, channel: Channel) -> None:
        if message.base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            self.request_mode(message.custom_mode)

    def _on_setpoint(self, message: Any, channel: Channel) -> None:
        self.setpoint(message)

    # Commands

    def _command_table(self) -> dict[int, Callable[[Command], int]]:
        return {
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM: self._arm_disarm,
            mavlink.MAV_CMD_DO_SET_MODE: self.do_set_mode,
            mavlink.MAV_CMD_NAV_TAKEOFF: self.take_off,
            mavlink.MAV_CMD_NAV_LAND: lambda _: self.land_command(),
            mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda _: self.return_command(),
            mavlink.MAV_CMD_DO_REPOSITION: self.reposition,
            mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: self._reboot_command,
        }

    @abstractmethod
    def do_set_mode(self, command: Command) -> int:
        """MAV_CMD_DO_SET_MODE."""

    @abstractmethod
    def request_mode(self, custom_mode: int) -> bool:
        """Change the mode for a peer; False, with a STATUSTEXT, if it cannot be had."""

    @abstractmethod
    def take_off(self, command: Command) -> int:
        """MAV_CMD_NAV_TAKEOFF."""

    @abstractmethod
    def land_command(self) -> int:
        """MAV_CMD_NAV_LAND."""

    @abstractmethod
    def return_command(self) -> int:
        """MAV_CMD_NAV_RETURN_TO_LAUNCH."""

    @abstractmethod
    def reposition(self, command: Command) -> int:
        """MAV_CMD_DO_REPOSITION."""

    @abstractmethod
    def setpoint(self, message: Any) -> None:
        """SET_POSITION_TARGET_GLOBAL_INT or SET_POSITION_TARGET_LOCAL_NED."""

    def _arm_disarm(self, command: Command) -> int:
        force = command.param(2) == FORCE_ARM_MAGIC
        if command.param(1) not in (0.0, 1.0):
            return UNSUPPORTED
        if command.param(1) == 0.0:
            if not self.armed:
                return ACCEPTED
            if not self.on_ground and not force:
                return self.refused_disarm()
            self.disarm("command")
            if not self.on_ground:
                self.manoeuvre = Fall()
            return ACCEPTED
        if self.armed:
            return ACCEPTED
        problem = None if force and self.FORCE_ARMS else self.prearm_problem() or self.arming_problem()
        if problem is not None:
            self.say(self.ARMING_REFUSED_TEXT.format(problem), mavlink.MAV_SEVERITY_CRITICAL)
            return self.ARMING_REFUSED_RESULT
        self._arm()
        return ACCEPTED

    ARMING_REFUSED_TEXT: ClassVar[str]
    ARMING_REFUSED_RESULT: ClassVar[int]

    @abstractmethod
    def refused_disarm(self) -> int:
        """Answer to a request to disarm in the air."""

    def arming_problem(self) -> str | None:
        """What forbids arming in the present mode, or None."""
        return "Arming disabled" if self.refuse_arming else None

    def prearm_problem(self) -> str | None:
        """The failing pre-arm check in the autopilot's words, or None."""
        if self.prearm_failure is not None:
            return self.prearm_failure
        if self.crashed:
            return "Motors: Check frame class and type"
        return None if self.gps_ready else self.NO_POSITION_TEXT

    NO_POSITION_TEXT: ClassVar[str]

    def _arm(self) -> None:
        self.armed = True
        self._idle_since = self.now
        if self.gps_ready:
            self.home = self.body.position
        self.say(self.ARMED_TEXT, mavlink.MAV_SEVERITY_INFO)
        self.armed_now()

    @abstractmethod
    def armed_now(self) -> None:
        """What arming sets off in the present mode."""

    ARMED_TEXT: ClassVar[str]
    DISARMED_TEXT: ClassVar[str]

    def disarm(self, reason: str) -> None:
        """Stop the motors."""
        self.armed = False
        self.failsafe = None
        if self.on_ground:
            self.manoeuvre = Rest()
        self.say(self.DISARMED_TEXT.format(reason), mavlink.MAV_SEVERITY_INFO)
        self.disarmed()

    @abstractmethod
    def disarmed(self) -> None:
        """The mode after disarming."""

    def _reboot_command(self, command: Command) -> int:
        if command.param(1) != 1.0:
            return UNSUPPORTED
        return FAILED if self.armed else ACCEPTED

    # Flight

    def hold_here(self) -> None:
        """Brake and stay where that ends."""
        self.manoeuvre = Rest() if self.on_ground else FlyTo(self.body.stopping_point())

    def land_here(self) -> None:
        """Come down where it is."""
        self.manoeuvre = self._landing(self.body.stopping_point())

    def return_home(self, height: float, wait_s: float) -> None:
        """Fly home at a height in the map [m] and land there."""
        home = self.home if self.home is not None else self.body.position
        self.manoeuvre = ReturnHome(self.body.stopping_point(), home, height, wait_s, self._landing(home))

    def _landing(self, at: Point) -> Land:
        return Land(at, self.LAND_SPEED, self.DISARM_AFTER_LANDING_S)

    @abstractmethod
    def take_off_finished(self) -> None:
        """The take-off height is reached."""

    def touch_down(self) -> None:
        """The ground takes all motion."""
        self.on_ground = True
        self.body.z = 0.0
        self.body.halt()

    def within_fence(self, point: Point) -> bool:
        """Whether the fence allows a point."""
        home = self.home if self.home is not None else (0.0, 0.0, 0.0)
        far = math.hypot(point[0] - home[0], point[1] - home[1]) > self.options.fence.radius_m
        return not far and point[2] - home[2] <= self.options.fence.max_height_m

    def say(self, text: str, severity: int) -> None:
        """Send a STATUSTEXT on all channels."""
        for channel in self.channels:
            channel.put(mavlink.MAVLink_statustext_message(severity, text.encode()[:50]))

    @abstractmethod
    def _watch_battery(self) -> None:
        """Failsafe on the battery."""

    # Faults, to be called from any thread

    def pilot_takes(self, mode: str) -> None:
        """The pilot changes the mode with the remote control."""
        if mode not in self.MODE_NAMES:
            raise ValueError(f"mode must be one of {', '.join(self.MODE_NAMES)}, got {mode!r}")
        with self.lock:
            self.change_mode(mode)

    @abstractmethod
    def change_mode(self, mode: str) -> None:
        """Change to a mode that exists, whoever flies."""

    def set_battery(self, charge: float) -> None:
        """Set the battery's charge, 0 to 1."""
        if not 0.0 <= charge <= 1.0:
            raise ValueError(f"charge must be from 0 to 1, got {charge!r}")
        with self.lock:
            self.battery = charge

    def reboot(self) -> None:
        """Restart the autopilot: its clock at 0, disarmed, everything asked for forgotten; it falls if it flew."""
        with self.lock:
            self._boot()

    def crash(self) -> None:
        """A motor fails and the aircraft falls."""
        with self.lock:
            self.crashed = True
            self.armed = False
            self.manoeuvre = Fall()
            self.say("Crash: Disarming", mavlink.MAV_SEVERITY_EMERGENCY)

    def _boot(self) -> None:
        self.clock_s = 0.0
        self.armed = self.crashed = self.gps_ready = False
        self.failsafe = self.home = self.ekf_origin = self._goal_wire = None
        self.on_ground = self.body.z <= 0.0
        self.manoeuvre = Rest() if self.on_ground else Fall()
        self.parameters = ParameterTable(self.PARAMETERS, self.BYTEWISE_PARAMETERS)
        self._idle_since = self.now
        self._gps_at_s = self.options.gps_delay_s
        for channel in self.channels:
            channel.reset(self.now)
        self.booted()
        if self._gps_at_s == 0.0:
            self._find_position()

    @abstractmethod
    def booted(self) -> None:
        """Set what the personality starts with."""

    def _find_position(self) -> None:
        self.gps_ready = True
        self.ekf_origin = (self.body.x, self.body.y, self.body.z)
        self.home = self.ekf_origin

    def position_before_fix(self) -> Any:
        """GLOBAL_POSITION_INT while the position is not known, or None."""
        return None


_HANDLERS: dict[str, Callable[[SimVehicle, Any, Channel], None]] = {
    "HEARTBEAT": lambda vehicle, message, channel: vehicle.heard_heartbeat(message, channel),
    "COMMAND_LONG": SimVehicle._on_command,
    "COMMAND_INT": SimVehicle._on_command,
    "SET_MODE": SimVehicle._on_set_mode,
    "SET_POSITION_TARGET_GLOBAL_INT": SimVehicle._on_setpoint,
    "SET_POSITION_TARGET_LOCAL_NED": SimVehicle._on_setpoint,
    **QUESTIONS,
}

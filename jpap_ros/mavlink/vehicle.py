"""Everything heard from one autopilot, and whether it is still there."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from itertools import pairwise
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

#: The autopilot's own component; gimbals and companions share its system id.
AUTOPILOT_COMPONENT = 1
#: The autopilot's clock is compared with ours over windows of this length [s]. It runs fast if so many in a row are
#: beyond this rate: after a stall of the link one is, when all that was held up comes at once.
CLOCK_WINDOWS, CLOCK_WINDOW_S = 3, 1.0
FAST_CLOCK = 1.5
#: time_boot_ms may fall behind by this much without a reboot: packets overtake one another [ms].
REORDER_MS = 5_000
#: After this long without GLOBAL_POSITION_INT the position is not known any more [s].
POSITION_TIMEOUT_S = 5.0
#: After this long without EXTENDED_SYS_STATE, though heard otherwise, it does not count any more [s].
LANDED_TIMEOUT_S = 10.0
#: No multicopter is higher above or deeper below mean sea level [mm].
MAX_ALTITUDE_MM = 20_000_000
_WORDS_KEPT = 20
_UNKNOWN_UINT16 = 0xFFFF


class LinkState(IntEnum):
    """Whether a vehicle is heard; numbers as in VehicleState.msg."""

    NEVER_SEEN = 0
    CONNECTED = 1
    LOST = 2


@dataclass(frozen=True)
class Position:
    """Where a vehicle is, from GLOBAL_POSITION_INT.

    Attributes
    ----------
    latitude, longitude : float
        WGS-84 [deg].
    amsl_m, relative_m : float
        Height above mean sea level and above home [m].
    velocity_ned : tuple of float
        (north, east, down) [m/s].
    yaw_ned : float
        Heading, clockwise from north [rad]; NaN if unknown.
    received_at : float
        Local clock [s].
    """

    latitude: float
    longitude: float
    amsl_m: float
    relative_m: float
    velocity_ned: tuple[float, float, float]
    yaw_ned: float
    received_at: float


@dataclass(frozen=True)
class Home:
    """HOME_POSITION: WGS-84 [deg] and height above mean sea level [m]."""

    latitude: float
    longitude: float
    amsl_m: float


@dataclass(frozen=True)
class TargetEcho:
    """POSITION_TARGET_GLOBAL_INT: where the autopilot says it is going. Units of 1e-7 deg; [m] in `frame`'s datum."""

    lat_e7: int
    lon_e7: int
    altitude_m: float
    frame: int
    received_at: float


@dataclass(frozen=True)
class Words:
    """One STATUSTEXT, put together from its chunks."""

    severity: int
    text: str
    received_at: float


@dataclass
class Battery:
    """Charge in [0, 1], voltage [V], MAV_BATTERY_CHARGE_STATE; NaN and 0 where unknown."""

    remaining: float = math.nan
    voltage_v: float = math.nan
    charge_state: int = 0


class Vehicle:
    """One autopilot as it is heard; it never sends.

    Parameters
    ----------
    sysid : int
        MAVLink system id.
    link_timeout_s : float
        Lost after this long without a heartbeat.
    simulated_clock : bool
        It may be a simulation whose clock runs faster than ours; a real one's never does, whatever a link makes of it.
    """

    def __init__(self, sysid: int, link_timeout_s: float = 4.0, simulated_clock: bool = False) -> None:
        self.sysid = sysid
        self.link_timeout_s = link_timeout_s
        self._simulated_clock = simulated_clock
        self.link = LinkState.NEVER_SEEN
        self.heartbeat_at = -math.inf
        self.reboots = 0
        self._handlers: dict[str, Callable[[Any, float], None]] = {
            "HEARTBEAT": self._heartbeat,
            "GLOBAL_POSITION_INT": self._global_position,
            "EXTENDED_SYS_STATE": self._extended_sys_state,
            "SYS_STATUS": self._sys_status,
            "BATTERY_STATUS": self._battery_status,
            "HOME_POSITION": self._home_position,
            "POSITION_TARGET_GLOBAL_INT": self._position_target,
            "GPS_RAW_INT": self._gps_raw,
            "STATUSTEXT": self._statustext,
        }
        self._forget()

    def _forget(self) -> None:
        self.autopilot: int | None = None
        self.vehicle_type = mavlink.MAV_TYPE_GENERIC
        self.custom_mode = 0
        self.armed = False
        self.system_status = mavlink.MAV_STATE_UNINIT
        self.landed_state = mavlink.MAV_LANDED_STATE_UNDEFINED
        #: When the landed state was last heard, local clock [s].
        self.landed_at = -math.inf
        self.position: Position | None = None
        self.home: Home | None = None
        self.echo: TargetEcho | None = None
        self.battery = Battery()
        #: Whether SYS_STATUS has come, and what it says of the pre-arm check; None: it does not know that check.
        self.health_known = False
        self.prearm_ok: bool | None = None
        self.geoid_separation_m: float | None = None
        self.words: deque[Words] = deque(maxlen=_WORDS_KEPT)
        self._chunks: dict[int, dict[int, str]] = {}
        self._boot_ms: int | None = None
        #: The autopilot's clock [ms] and ours [s] at the ends of the last windows.
        self._clock_marks: deque[tuple[int, float]] = deque(maxlen=CLOCK_WINDOWS + 1)
        #: Seconds of the autopilot's clock in one of ours: 1, or more in a simulation that runs faster.
        self.clock_rate = 1.0

    def hear(self, message: Any, now: float) -> bool:
        """Take one message from the autopilot's component.

        Returns
        -------
        bool
            True if the message told of a reboot: everything known before it is forgotten.
        """
        rebooted = self._rebooted(message)
        if rebooted:
            self.reboots += 1
            self._forget()
            self._boot_ms = message.time_boot_ms
        handler = self._handlers.get(message.get_type())
        if handler:
            handler(message, now)
        return rebooted

    def update(self, now: float) -> None:
        """Notice silence."""
        if self.link is LinkState.CONNECTED and now - self.heartbeat_at > self.link_timeout_s:
            self.link = LinkState.LOST
        if self.link is LinkState.CONNECTED and now - self.landed_at > LANDED_TIMEOUT_S:
            self.landed_state = mavlink.MAV_LANDED_STATE_UNDEFINED

    def position_fresh(self, now: float) -> bool:
        """True while the position is recent enough to act on."""
        return self.position is not None and now - self.position.received_at <= POSITION_TIMEOUT_S

    @property
    def in_air(self) -> bool:
        """In the air by EXTENDED_SYS_STATE; where that does not come, armed and off the ground by 1 m."""
        if self.landed_state == mavlink.MAV_LANDED_STATE_UNDEFINED:
            return self.armed and self.position is not None and self.position.relative_m > 1.0
        return bool(self.landed_state == mavlink.MAV_LANDED_STATE_IN_AIR)

    @property
    def on_ground(self) -> bool:
        """On the ground by EXTENDED_SYS_STATE; where that does not come, not armed."""
        if self.landed_state == mavlink.MAV_LANDED_STATE_UNDEFINED:
            return not self.armed
        return bool(self.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND)

    @property
    def critical(self) -> bool:
        """MAV_STATE critical, emergency or flight termination: not to be given goals."""
        return self.system_status in (
            mavlink.MAV_STATE_CRITICAL,
            mavlink.MAV_STATE_EMERGENCY,
            mavlink.MAV_STATE_FLIGHT_TERMINATION,
        )

    def words_since(self, since: float, worst: int = mavlink.MAV_SEVERITY_WARNING) -> str:
        """The autopilot's own words since a time, severe ones only, joined; empty if it said nothing."""
        texts = [w.text for w in self.words if w.received_at >= since and w.severity <= worst]
        return "; ".join(dict.fromkeys(texts))

    def _rebooted(self, message: Any) -> bool:
        boot_ms = getattr(message, "time_boot_ms", None)
        if boot_ms is None or message.get_type() == "POSITION_TARGET_GLOBAL_INT":
            return False
        before, self._boot_ms = self._boot_ms, max(boot_ms, self._boot_ms or 0)
        return before is not None and boot_ms + REORDER_MS < before

    def _heartbeat(self, message: Any, now: float) -> None:
        self.autopilot = message.autopilot
        self.vehicle_type = message.type
        self.custom_mode = message.custom_mode
        self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        self.system_status = message.system_status
        self.heartbeat_at = now
        self.link = LinkState.CONNECTED

    def _watch_clock(self, boot_ms: int, now: float) -> None:
        marks = self._clock_marks
        if not self._simulated_clock or (marks and now - marks[-1][1] < CLOCK_WINDOW_S):
            return
        marks.append((boot_ms, now))
        # What differs by less is delay on the link.
        fast = all(_rate(*window) > FAST_CLOCK for window in pairwise(marks))
        self.clock_rate = _rate(marks[0], marks[-1]) if fast and len(marks) > CLOCK_WINDOWS else 1.0

    def _global_position(self, message: Any, now: float) -> None:
        self._watch_clock(message.time_boot_ms, now)
        if not _plausible(message.lat, message.lon, message.alt):
            return
        yaw = math.nan if message.hdg == _UNKNOWN_UINT16 else math.radians(message.hdg / 100)
        self.position = Position(
            message.lat / 1e7,
            message.lon / 1e7,
            message.alt / 1e3,
            message.relative_alt / 1e3,
            (message.vx / 100, message.vy / 100, message.vz / 100),
            yaw,
            now,
        )

    def _extended_sys_state(self, message: Any, now: float) -> None:
        self.landed_state = message.landed_state
        self.landed_at = now

    def _sys_status(self, message: Any, now: float) -> None:
        self.health_known = True
        if message.voltage_battery != _UNKNOWN_UINT16:
            self.battery.voltage_v = message.voltage_battery / 1e3
        if message.battery_remaining >= 0:
            self.battery.remaining = message.battery_remaining / 100
        bit = mavlink.MAV_SYS_STATUS_PREARM_CHECK
        if message.onboard_control_sensors_present & message.onboard_control_sensors_enabled & bit:
            self.prearm_ok = bool(message.onboard_control_sensors_health & bit)

    def _battery_status(self, message: Any, now: float) -> None:
        if message.id != 0:
            return
        if message.battery_remaining >= 0:
            self.battery.remaining = message.battery_remaining / 100
        self.battery.charge_state = message.charge_state

    def _home_position(self, message: Any, now: float) -> None:
        if not _plausible(message.latitude, message.longitude, message.altitude):
            return
        self.home = Home(message.latitude / 1e7, message.longitude / 1e7, message.altitude / 1e3)

    def _position_target(self, message: Any, now: float) -> None:
        self.echo = TargetEcho(message.lat_int, message.lon_int, message.alt, message.coordinate_frame, now)

    def _gps_raw(self, message: Any, now: float) -> None:
        if message.alt_ellipsoid != 0 and message.alt != 0:
            self.geoid_separation_m = (message.alt_ellipsoid - message.alt) / 1e3

    def _statustext(self, message: Any, now: float) -> None:
        raw = message.text
        text = raw.decode("utf-8", "replace") if isinstance(raw, bytes) else raw
        full = len(text) >= 50
        text = text.rstrip("\0")
        if message.id:
            chunks = self._chunks.setdefault(message.id, {})
            chunks[message.chunk_seq] = text
            if full and len(self._chunks) <= _WORDS_KEPT:
                return
            del self._chunks[message.id]
            text = "".join(chunks[i] for i in sorted(chunks))
        self.words.append(Words(message.severity, text, now))


def _rate(begin: tuple[int, float], end: tuple[int, float]) -> float:
    """Seconds of the autopilot's clock in one of ours, between two marks."""
    return (end[0] - begin[0]) / 1e3 / (end[1] - begin[1])


def _plausible(lat_e7: int, lon_e7: int, altitude_mm: int) -> bool:
    """Whether a position can be one: autopilots send (0, 0) before their first fix, and radios garble."""
    if lat_e7 == 0 and lon_e7 == 0:
        return False
    return abs(lat_e7) <= 900_000_000 and abs(lon_e7) <= 1_800_000_000 and abs(altitude_mm) <= MAX_ALTITUDE_MM

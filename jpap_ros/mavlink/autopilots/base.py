"""What an autopilot's personality answers: mode names, commands, and how a position target is put on the wire."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any, ClassVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.mavlink.commands import ORDER_ATTEMPTS, Command
from jpap_ros.mavlink.geodesy import degrees_to_e7
from jpap_ros.mavlink.vehicle import Vehicle

#: POSITION_TARGET_TYPEMASK: use the three position axes and nothing else.
POSITION_ONLY = 0x0DF8
#: The same with yaw.
POSITION_AND_YAW = 0x09F8
#: Use the three axes of velocity as well: a moving target.
_VELOCITY_AXES = 0x0038
#: Wait for an answer to ARM before it is sent again [s].
ARM_ANSWER_TIMEOUT_S = 0.4


class Transport(Enum):
    """How a goal reaches the autopilot."""

    #: SET_POSITION_TARGET_GLOBAL_INT, streamed; no acknowledgement, verified by echo and progress.
    SETPOINT = "setpoint"
    #: MAV_CMD_DO_REPOSITION, once, acknowledged.
    REPOSITION = "reposition"


class AltitudeDatum(Enum):
    """What a goal's height is measured from on the wire."""

    RELATIVE = "relative"
    AMSL = "amsl"


class TargetError(ValueError):
    """The target cannot be encoded now; the message says what is missing and what to do."""


@dataclass(frozen=True)
class Target:
    """Where one aircraft should hover, in the earth's coordinates.

    Attributes
    ----------
    latitude, longitude : float
        WGS-84 [deg].
    height_m : float
        Above the vehicle's home [m].
    amsl_m : float
        The same goal above mean sea level by the map origin's altitude [m]. The two describe one point only where
        home and map origin are at one altitude; which of them counts is the vehicle's altitude datum.
    yaw_ned : float or None
        Heading, clockwise from north [rad]; None leaves it to the autopilot.
    velocity_ned_m_s : (north, east, down) or None
        Velocity of a moving target [m/s]; None: it rests.
    """

    latitude: float
    longitude: float
    height_m: float
    amsl_m: float
    yaw_ned: float | None = None
    velocity_ned_m_s: tuple[float, float, float] | None = None

    @property
    def lat_e7(self) -> int:
        """Latitude as it goes on the wire [1e-7 deg]."""
        return degrees_to_e7(self.latitude)

    @property
    def lon_e7(self) -> int:
        """Longitude as it goes on the wire [1e-7 deg]."""
        return degrees_to_e7(self.longitude)


class Autopilot(ABC):
    """One firmware's manners. Stateless: what it needs to know of a vehicle is handed in."""

    #: Name in the fleet file.
    name: ClassVar[str]
    #: MAV_AUTOPILOT in its heartbeat.
    mav_autopilot: ClassVar[int]
    #: Mode numbers by name.
    modes: ClassVar[dict[str, int]]
    #: Mode in which the vehicle takes goals, by transport.
    goal_mode: ClassVar[dict[Transport, str]]
    #: Modes that belong to a take-off asked for by us.
    takeoff_modes: ClassVar[frozenset[str]]
    #: Mode that must be set before arming, or None.
    mode_before_takeoff: ClassVar[str | None]
    #: Mode in which it stays where it is, whoever watches.
    hold_mode: ClassVar[str]
    #: Mode in which it flies home, and in which it lands.
    return_mode: ClassVar[str]
    land_mode: ClassVar[str]
    #: How long position targets must flow before the goal mode is asked for [s].
    stream_lead_s: ClassVar[float]
    #: Least rate of position targets while the goal mode is active [Hz].
    min_stream_hz: ClassVar[float]
    #: For how long at the last target's velocity an aircraft runs on when no more come, braking included [s].
    keeps_velocity_s: ClassVar[float]
    #: What it sends though nobody asked and the bridge does not need it, by message id [Hz].
    unasked_hz: ClassVar[Mapping[int, float]]

    def mode_name(self, custom_mode: int) -> str:
        """Name of a HEARTBEAT.custom_mode; an unknown one is named by its number."""
        for name, number in self.modes.items():
            if number == custom_mode:
                return name
        return f"mode {custom_mode:#x}"

    @abstractmethod
    def set_mode(self, mode: str) -> Command:
        """MAV_CMD_DO_SET_MODE; KeyError if the name is unknown."""

    def arm(self) -> Command:
        """Arm. Not idempotent: a late arm is dangerous, so that there is little time to send it again."""
        return Command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (1.0,), "arm", answer_timeout_s=ARM_ANSWER_TIMEOUT_S)

    def disarm(self) -> Command:
        """Disarm; both autopilots refuse it in the air."""
        return Command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (0.0,), "disarm", True, attempts=ORDER_ATTEMPTS)

    @abstractmethod
    def takeoff(self, vehicle: Vehicle, height_m: float) -> Command:
        """Take off to a height above home [m]. Not idempotent. TargetError if something needed is unknown."""

    def return_home(self) -> Command:
        """Fly home and land there by the autopilot's own settings."""
        return Command(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH, (), "return home", True, attempts=ORDER_ATTEMPTS)

    def land(self) -> Command:
        """Land where it is."""
        # Latitude and longitude NaN: the present position.
        params = (0.0, 0.0, 0.0, math.nan, math.nan, math.nan, 0.0)
        return Command(mavlink.MAV_CMD_NAV_LAND, params, "land", True, attempts=ORDER_ATTEMPTS)

    @abstractmethod
    def frame_and_altitude(self, target: Target, vehicle: Vehicle, datum: AltitudeDatum) -> tuple[int, float]:
        """MAV_FRAME and altitude [m] of a target as this autopilot should get them; TargetError if home is needed."""

    @abstractmethod
    def parting(self, mode: str) -> Command | None:
        """What a vehicle in `mode` is told when the bridge stops in an orderly way; None: it is left as it is."""

    def position_target(
        self, target: Target, vehicle: Vehicle, datum: AltitudeDatum, time_boot_ms: int, component: int = 1
    ) -> Any:
        """SET_POSITION_TARGET_GLOBAL_INT for a target.

        Parameters
        ----------
        target : Target
        vehicle : Vehicle
            Receiver; its home is needed where height above home is turned into height above mean sea level.
        datum : AltitudeDatum
        time_boot_ms : int
            Sender's clock [ms].

        Raises
        ------
        TargetError
        """
        frame, altitude_m = self.frame_and_altitude(target, vehicle, datum)
        mask, yaw = (POSITION_ONLY, 0.0) if target.yaw_ned is None else (POSITION_AND_YAW, target.yaw_ned)
        velocity = target.velocity_ned_m_s
        if velocity is not None:
            mask &= ~_VELOCITY_AXES
        return mavlink.MAVLink_set_position_target_global_int_message(
            time_boot_ms & 0xFFFFFFFF,
            vehicle.sysid,
            component,
            frame,
            mask,
            target.lat_e7,
            target.lon_e7,
            altitude_m,
            *(velocity or (0.0, 0.0, 0.0)),
            *(0.0, 0.0, 0.0),
            yaw,
            0.0,
        )

    def reposition(self, target: Target, vehicle: Vehicle, datum: AltitudeDatum) -> Command:
        """MAV_CMD_DO_REPOSITION for a target: change of mode allowed, default speed."""
        frame, altitude_m = self.frame_and_altitude(target, vehicle, datum)
        yaw = math.nan if target.yaw_ned is None else target.yaw_ned
        change_mode = float(mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE)
        params = (-1.0, change_mode, 0.0, yaw, target.latitude, target.longitude, altitude_m)
        return Command(mavlink.MAV_CMD_DO_REPOSITION, params, "reposition", True, frame, ORDER_ATTEMPTS)


REGISTRY: dict[str, Autopilot] = {}


def register(personality: type[Autopilot]) -> type[Autopilot]:
    """Class decorator: make a personality known by its name."""
    REGISTRY[personality.name] = personality()
    return personality


def by_heartbeat(mav_autopilot: int) -> Autopilot | None:
    """Personality for HEARTBEAT.autopilot; None if there is none."""
    return next((a for a in REGISTRY.values() if a.mav_autopilot == mav_autopilot), None)

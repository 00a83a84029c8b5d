"""What is checked before anything is sent; unclear means hold."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.fleet.fence import Fence
from jpap_ros.mavlink.autopilots.base import AltitudeDatum, Target
from jpap_ros.mavlink.geodesy import LocalFrame, degrees_to_e7, yaw_ned_from_enu
from jpap_ros.mavlink.goals import Goal
from jpap_ros.mavlink.vehicle import Home, TargetEcho, Vehicle

#: No goal is lower above the ground: a planner that leaves the height at 0 must not land an aircraft [m].
MIN_HEIGHT_M = 1.0
#: The autopilot's own idea of its target may be off by this much [m].
ECHO_ALTITUDE_TOLERANCE_M = 5.0
#: A map origin's altitude that differs from home's by more than this puts an AMSL goal at a wrong height [m].
DATUM_TOLERANCE_M = 15.0
#: Where the difference is this close to the geoid's separation, the altitude was given above the ellipsoid [m].
_ELLIPSOID_TOLERANCE_M = 5.0


class GoalRefused(ValueError):
    """A goal that must not be sent; the message says why."""


@dataclass(frozen=True)
class GoalLimits:
    """What a goal must keep to.

    Attributes
    ----------
    fence : Fence or None
    max_jump_m : float
        Most distance from the aircraft to a new goal [m].
    """

    fence: Fence | None = None
    max_jump_m: float = 5_000.0


def target_of(goal: Goal, frame: LocalFrame) -> Target:
    """Convert a goal to the earth's coordinates; GoalRefused for what must never reach the wire.

    That is anything not finite or out of range, and latitude and longitude (0, 0), which stands for "no position" in
    too many programs to be believed.
    """
    for name in ("east_m", "north_m", "up_m"):
        value = getattr(goal, name)
        if not math.isfinite(value):
            raise GoalRefused(f"goal {name} must be finite, got {value!r}")
    if goal.up_m < MIN_HEIGHT_M:
        raise GoalRefused(f"goal up_m must be at least {MIN_HEIGHT_M:g} m above the ground, got {goal.up_m!r}")
    if goal.yaw is not None and not math.isfinite(goal.yaw):
        raise GoalRefused(f"goal yaw must be finite, got {goal.yaw!r}")
    try:
        latitude, longitude = frame.to_geodetic(goal.east_m, goal.north_m)
    except ValueError as error:
        raise GoalRefused(f"goal is off the map: {error}") from None
    if degrees_to_e7(latitude) == 0 and degrees_to_e7(longitude) == 0:
        raise GoalRefused("goal is at latitude 0, longitude 0")
    yaw = None if goal.yaw is None else yaw_ned_from_enu(goal.yaw)
    return Target(latitude, longitude, goal.up_m, frame.origin.altitude_amsl_m + goal.up_m, yaw)


def check_fence(goal: Goal, limits: GoalLimits) -> None:
    """GoalRefused if the goal breaks the fence."""
    if limits.fence and (problem := limits.fence.breach(goal.east_m, goal.north_m, goal.up_m)):
        raise GoalRefused(problem)


def check_jump(distance_m: float, limits: GoalLimits) -> None:
    """GoalRefused if the aircraft is too far from its new goal."""
    if not distance_m <= limits.max_jump_m:
        raise GoalRefused(f"goal is {distance_m:.0f} m away, most {limits.max_jump_m:.0f} m (max_goal_jump_m)")


def datum_problem(vehicle: Vehicle, datum: AltitudeDatum, origin_amsl_m: float) -> str | None:
    """How the map origin's altitude contradicts the vehicle's home where goals are sent as AMSL; None if it does not.

    The most common mistake is a height above the WGS-84 ellipsoid, as GNSS receivers and NavSatFix give it.
    """
    if datum is not AltitudeDatum.AMSL or vehicle.home is None:
        return None
    off_m = origin_amsl_m - vehicle.home.amsl_m
    if abs(off_m) <= DATUM_TOLERANCE_M:
        return None
    separation_m = vehicle.geoid_separation_m
    looks_ellipsoidal = separation_m is not None and abs(off_m - separation_m) <= _ELLIPSOID_TOLERANCE_M
    cause = (
        f"it looks like a height above the ellipsoid ({separation_m:+.1f} m here)"
        if looks_ellipsoidal
        else "goals would be that much too high or too low"
    )
    return (
        f"altitude datum: origin.altitude_amsl_m is {origin_amsl_m:.1f} m but home is at {vehicle.home.amsl_m:.1f} m "
        f"above mean sea level; {cause}; correct it in the fleet file or use altitude_datum relative"
    )


def echo_problem(echo: TargetEcho, altitude_m: float, home: Home | None) -> str | None:
    """How the altitude that the autopilot flies to differs from the one that was meant; None if it does not.

    Parameters
    ----------
    echo : TargetEcho
    altitude_m : float
        What was meant, above mean sea level [m].
    home : Home or None
        Needed where the echo is relative to home.
    """
    if echo.frame in (mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT):
        flown_m = echo.altitude_m
    elif echo.frame in (mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT) and home:
        flown_m = home.amsl_m + echo.altitude_m
    else:
        return None
    if abs(flown_m - altitude_m) <= ECHO_ALTITUDE_TOLERANCE_M:
        return None
    return (
        f"altitude datum: the autopilot flies to {flown_m:.1f} m above mean sea level, {altitude_m:.1f} m is meant; "
        "check its home and the fleet file's altitude_datum and origin.altitude_amsl_m"
    )


class PlanDeadman:
    """Notices that the planner is silent.

    Parameters
    ----------
    timeout_s : float
        Goals are in force for this long after the last sign of the planner, or after the first goal if there never was
        one; 0: for ever.
    """

    def __init__(self, timeout_s: float) -> None:
        self.timeout_s = timeout_s
        self._fed_at: float | None = None

    def start(self, now: float) -> None:
        """There is a goal: from the first one on somebody must be there who answers for it."""
        if self._fed_at is None:
            self._fed_at = now

    def feed(self, now: float) -> None:
        """The planner gave a sign of life."""
        self._fed_at = now

    def silence_s(self, now: float) -> float | None:
        """For how long the planner has been silent, if that is too long; None if it is not."""
        if self.timeout_s == 0.0 or self._fed_at is None:
            return None
        silent_s = now - self._fed_at
        return silent_s if silent_s > self.timeout_s else None

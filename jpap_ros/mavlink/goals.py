"""The life of one aircraft's goal, as far as it can be observed: no setpoint is ever acknowledged."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

from jpap_ros.mavlink.vehicle import TargetEcho

#: An echo this close in latitude and longitude is the target that was sent [1e-7 deg].
ECHO_TOLERANCE_E7 = 2
#: Where the target moves, the autopilot's own idea of it is this close to one that was sent [1e-7 deg], about 5 m.
MOVING_ECHO_TOLERANCE_E7 = 500
#: Targets on the wire for this long without a matching echo or progress: not obeyed [s].
OBEY_TIMEOUT_S = 5.0
#: Closer than at the start by this much: it flies there [m].
PROGRESS_M = 0.5
#: REACHED is left again beyond this many arrival radii: wind alone must not make the state flicker.
DEPARTURE_RADII = 2.0


class GoalState(IntEnum):
    """Numbers as in VehicleState.msg."""

    NONE = 0
    SENT = 1
    ACCEPTED = 2
    EN_ROUTE = 3
    REACHED = 4
    REJECTED = 5
    YIELDED = 6
    LOST = 7


@dataclass(frozen=True)
class Goal:
    """Where one aircraft should hover, in the map frame.

    Attributes
    ----------
    east_m, north_m, up_m : float
        ENU [m]; up is above the map's ground, the vehicle's home with the relative altitude datum.
    yaw : float or None
        Counterclockwise from east [rad]; None leaves it to the autopilot.
    plan_id : int
        Deployment it belongs to; 0: none known.
    """

    east_m: float
    north_m: float
    up_m: float
    yaw: float | None = None
    plan_id: int = 0

    def same_place(self, other: Goal | None) -> bool:
        """Whether two goals ask for the same pose, whatever their plans."""
        return other is not None and (self.east_m, self.north_m, self.up_m, self.yaw) == (
            other.east_m,
            other.north_m,
            other.up_m,
            other.yaw,
        )


class GoalLife:
    """State machine over sent → accepted → en route → reached, and the ways out of it.

    Parameters
    ----------
    arrival_radius_m : float
        Reached within this distance.
    """

    def __init__(self, arrival_radius_m: float = 1.0) -> None:
        self.arrival_radius_m = arrival_radius_m
        self.state = GoalState.NONE
        self.reason = ""
        #: Distance to the goal [m]; NaN: unknown or no goal.
        self.distance_m = math.nan
        self._sent_at = math.inf
        self._obey_from = math.inf
        self._target_e7: tuple[int, int] | None = None
        self._moving = False
        self._distance_when_sent_m = math.nan
        self._other_echo: tuple[int, int] | None = None
        self._answered = False

    @property
    def flying(self) -> bool:
        """True while the aircraft is being sent to the goal or is there."""
        return self.state in (GoalState.SENT, GoalState.ACCEPTED, GoalState.EN_ROUTE, GoalState.REACHED)

    @property
    def unobeyed(self) -> bool:
        """True if targets have been on the wire for long and nothing shows that they were heard."""
        return self.state is GoalState.REJECTED and self._target_e7 is not None

    def set_aside(self, state: GoalState, reason: str) -> None:
        """No target is on the wire: NONE (no goal, or it waits), REJECTED, YIELDED or LOST, and why."""
        if state not in (GoalState.NONE, GoalState.REJECTED, GoalState.YIELDED, GoalState.LOST):
            raise ValueError(f"{state.name} is observed, not set")
        self.state = state
        self.reason = reason
        self._target_e7 = None

    def sent(self, target_e7: tuple[int, int], now: float) -> None:
        """A target is on the wire (latitude, longitude [1e-7 deg]); a repetition changes nothing."""
        if self._target_e7 == target_e7:
            return
        self._target_e7 = target_e7
        self._moving = False
        self._sent_at = self._obey_from = now
        self._distance_when_sent_m = math.nan
        self._other_echo = None
        self._answered = False
        self.state = GoalState.SENT
        self.reason = ""

    def moves(self, target_e7: tuple[int, int]) -> None:
        """The target has moved on along the way to the same goal."""
        self._moving = self._moving or target_e7 != self._target_e7
        self._target_e7 = target_e7

    def follows(self, now: float) -> None:
        """It is where its target is: the time to show obedience begins afresh."""
        if self.state is GoalState.SENT:
            self._obey_from = now

    def resent(self, now: float) -> None:
        """A new height or heading at the same place: observe afresh."""
        target, self._target_e7 = self._target_e7, None
        if target is not None:
            self.sent(target, now)

    def is_target(self, echo: TargetEcho) -> bool:
        """Whether an echo is of the target that is on the wire now, by latitude and longitude."""
        if self._target_e7 is None:
            return False
        off = max(abs(echo.lat_e7 - self._target_e7[0]), abs(echo.lon_e7 - self._target_e7[1]))
        return off <= (MOVING_ECHO_TOLERANCE_E7 if self._moving else ECHO_TOLERANCE_E7)

    def echoed(self, echo: TargetEcho) -> None:
        """The autopilot says where it is going."""
        if self.is_target(echo):
            self._answered = False
            self.acknowledged()
        elif self._target_e7 is not None:
            self._other_echo = echo.lat_e7, echo.lon_e7

    def acknowledged(self) -> None:
        """The autopilot took the goal."""
        if self.state is GoalState.SENT or self.unobeyed:
            self.state = GoalState.ACCEPTED
            self.reason = ""

    def answered(self, now: float) -> None:
        """The autopilot took the goal by COMMAND_ACK: PX4 does so and stays where it is, if its fence forbids it."""
        self.acknowledged()
        self._answered = True
        self._obey_from = now

    def refused(self, reason: str) -> None:
        """The autopilot answered no."""
        if self._target_e7 is not None:
            self.state = GoalState.REJECTED
            self.reason = reason

    def moved(self, distance_m: float) -> None:
        """A new distance to the goal [m], straight line."""
        self.distance_m = distance_m
        if self._target_e7 is None:
            return
        if math.isnan(self._distance_when_sent_m):
            self._distance_when_sent_m = distance_m
        if self.state is GoalState.REACHED:
            if distance_m > DEPARTURE_RADII * self.arrival_radius_m:
                self.state = GoalState.EN_ROUTE
        elif distance_m <= self.arrival_radius_m:
            self.state = GoalState.REACHED
            self.reason = ""
        elif self.state is not GoalState.EN_ROUTE and self._distance_when_sent_m - distance_m > PROGRESS_M:
            self.state = GoalState.EN_ROUTE
            self.reason = ""

    def tick(self, now: float, words: str) -> None:
        """Notice that nothing shows obedience: a goal is neither echoed nor flown, or only answered.

        Parameters
        ----------
        words : str
            The autopilot's own, since the target was sent.
        """
        only_answered = self.state is GoalState.ACCEPTED and self._answered
        if (self.state is not GoalState.SENT and not only_answered) or now - self._obey_from < OBEY_TIMEOUT_S:
            return
        if only_answered:
            reason = f"the goal was accepted but has not been flown for {OBEY_TIMEOUT_S:.0f} s"
        elif self._other_echo is None:
            reason = f"targets are sent but the autopilot has shown no sign of obeying for {OBEY_TIMEOUT_S:.0f} s"
        else:
            lat, lon = (value / 1e7 for value in self._other_echo)
            reason = f"the autopilot keeps another target, latitude {lat:.7f}, longitude {lon:.7f}"
        self.refused(f"{reason}: {words}" if words else reason)

    @property
    def sent_at(self) -> float:
        """When the present target was first sent; inf if none was."""
        return self._sent_at if self._target_e7 is not None else math.inf

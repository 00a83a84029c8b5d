"""The goal that the planner gave to one aircraft, and what of the goal itself forbids to fly it."""

from __future__ import annotations

import math

from jpap_ros.fleet.fence import Fence
from jpap_ros.fleet.traffic import Vector
from jpap_ros.mavlink.autopilots import AltitudeDatum, Autopilot, Target, TargetError
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.mavlink.goals import Goal, GoalLife
from jpap_ros.mavlink.guards import GoalLimits, GoalRefused, check_fence, check_jump, datum_problem, target_of
from jpap_ros.mavlink.vehicle import Vehicle
from jpap_ros.mavlink.whereabouts import Whereabouts


class AssignedGoal:
    """A goal, the target that it makes, and whether it may be begun.

    Parameters
    ----------
    vehicle : Vehicle
    whereabouts : Whereabouts
    life : GoalLife
        Told the distance to the goal.
    frame : LocalFrame
    datum : AltitudeDatum
    """

    def __init__(
        self, vehicle: Vehicle, whereabouts: Whereabouts, life: GoalLife, frame: LocalFrame, datum: AltitudeDatum
    ) -> None:
        #: The goal that the planner last gave, and the target that it makes; None: no goal, or not one for the wire.
        self.goal: Goal | None = None
        self.target: Target | None = None
        #: Why the goal must not be flown, and why there is none; empty: it may be, or nobody said why.
        self.refused = ""
        self.none_because = ""
        #: Its target has been on the wire, and nothing has come in between.
        self.begun = False
        self._vehicle = vehicle
        self._whereabouts = whereabouts
        self._life = life
        self._frame = frame
        self._datum = datum

    @property
    def place(self) -> Vector | None:
        """East, north, up of the goal [m]; None: no goal."""
        return None if self.goal is None else (self.goal.east_m, self.goal.north_m, self.goal.up_m)

    def give(self, goal: Goal, limits: GoalLimits) -> bool:
        """Take a goal; what must not be flown is refused here, before anything is sent.

        Returns
        -------
        bool
            Whether it asks for another pose than the one before.
        """
        if goal.same_place(self.goal):
            self.goal = goal
            return False
        self.goal = goal
        self.target = None
        self.refused = ""
        self.begun = False
        self._life.distance_m = math.nan
        try:
            self.target = target_of(goal, self._frame)
            check_fence(goal, limits)
        except GoalRefused as refusal:
            self.refused = str(refusal)
        return True

    def clear(self, reason: str, refused: bool) -> None:
        """There is no goal any more, or (`refused`) one was given that must not be flown."""
        self.goal = self.target = None
        self.refused = reason if refused else ""
        self.none_because = "" if refused else reason
        self._life.distance_m = math.nan

    def measure(self) -> None:
        """Take the distance from where the aircraft is."""
        here, place = self._whereabouts.enu_m, self.place
        if here is not None and place is not None:
            self._life.moved(math.dist(here, place))

    def problem(self, autopilot: Autopilot | None, limits: GoalLimits, straight: bool) -> str:
        """Why it must not be begun from where the aircraft is; empty if it may be, or is already.

        Parameters
        ----------
        autopilot : Autopilot or None
        limits : GoalLimits
        straight : bool
            The aircraft flies there straight, and not as traffic control wants it.
        """
        if self.begun or self.target is None or autopilot is None:
            return ""
        try:
            if problem := datum_problem(self._vehicle, self._datum, self._frame.origin.altitude_amsl_m):
                raise GoalRefused(problem)
            check_jump(self._life.distance_m, limits)
        except GoalRefused as refusal:
            self.refused = str(refusal)
            return self.refused
        try:
            autopilot.frame_and_altitude(self.target, self._vehicle, self._datum)
        except TargetError as error:
            return str(error)
        if straight and self._straight_way_leaves(limits.fence):
            return "the straight way to the goal leads out of the fence"
        return ""

    def _straight_way_leaves(self, fence: Fence | None) -> bool:
        here, place = self._whereabouts.enu_m, self.place
        if fence is None or place is None or here is None:
            return False
        return not fence.lets_pass(here, place)

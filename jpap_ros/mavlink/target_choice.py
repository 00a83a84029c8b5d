"""Which target one aircraft gets: its goal, the place where traffic control wants it, or the place where it holds."""

from __future__ import annotations

from dataclasses import replace

from jpap_ros.fleet.fence import ROUNDING_M, Fence
from jpap_ros.fleet.traffic import Setpoint, Vector
from jpap_ros.mavlink.assigned_goal import AssignedGoal
from jpap_ros.mavlink.autopilots import AltitudeDatum, Target
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.mavlink.goals import Goal
from jpap_ros.mavlink.guards import GoalRefused, target_of
from jpap_ros.mavlink.target_sender import TargetSender
from jpap_ros.mavlink.vehicle import Vehicle
from jpap_ros.mavlink.whereabouts import Whereabouts

#: One that is outside the fence already may be told a place this much farther out than where it sways to [m].
FENCE_SWAY_M = 1.0


class TargetChoice:
    """Makes targets of places, and remembers where the aircraft holds.

    Parameters
    ----------
    vehicle : Vehicle
    whereabouts : Whereabouts
    assigned : AssignedGoal
    sender : TargetSender
    frame : LocalFrame
    datum : AltitudeDatum
    """

    def __init__(
        self,
        vehicle: Vehicle,
        whereabouts: Whereabouts,
        assigned: AssignedGoal,
        sender: TargetSender,
        frame: LocalFrame,
        datum: AltitudeDatum,
    ) -> None:
        self._vehicle = vehicle
        self._whereabouts = whereabouts
        self._assigned = assigned
        self._sender = sender
        self._frame = frame
        self._datum = datum
        self._hold_target: Target | None = None
        self._rest: tuple[Setpoint, Target] | None = None

    def forget_hold(self) -> None:
        """The next time that it holds, it holds where it is then, not where it held before."""
        self._hold_target = None

    def hold(self, now: float, under_way: bool = False) -> Target | None:
        """Where it is, or, `under_way` until now, was last heard; failing that the last target; None: unknown."""
        position = self._vehicle.position
        known = self._whereabouts.known(now) or (under_way and self._whereabouts.enu_m is not None)
        if self._hold_target is None and position is not None and known:
            self._hold_target = Target(position.latitude, position.longitude, position.relative_m, position.amsl_m)
            self._sender.hurry()
        return self._hold_target or self._sender.sent

    def at(self, setpoint: Setpoint, now: float) -> Target | None:
        """Target for a place that traffic control gives."""
        at_rest = setpoint.velocity == (0.0, 0.0, 0.0)
        if at_rest and setpoint.position == self._assigned.place:
            return self._assigned.target
        if at_rest and self._rest is not None and self._rest[0] == setpoint:
            return self._rest[1]
        try:
            target = target_of(Goal(*setpoint.position), self._frame)
        except GoalRefused:
            # An aircraft nearer to the ground than any goal may be: hold by telemetry.
            return self.hold(now)
        if at_rest:
            self._rest = setpoint, target
            return target
        east, north, up = setpoint.velocity
        return replace(target, velocity_ned_m_s=(north, east, -up))

    def leaves(self, fence: Fence | None, place: Vector) -> bool:
        """Whether a place lies outside the fence, and farther than the aircraft does: it may be led back in."""
        if fence is None or (outside_m := fence.outside_m(place)) <= ROUNDING_M:
            return False
        here = self._whereabouts.enu_m
        here_m = 0.0 if here is None else fence.outside_m(here)
        return here_m == 0.0 or outside_m > here_m + FENCE_SWAY_M

    def datum(self, target: Target) -> AltitudeDatum:
        """Datum in which a target goes out."""
        # Where it holds, both heights are the vehicle's own, and the one above mean sea level needs no home.
        amsl = target is self._hold_target and self._vehicle.home is None
        return AltitudeDatum.AMSL if amsl else self._datum

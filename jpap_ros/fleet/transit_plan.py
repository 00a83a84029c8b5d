"""Where every aircraft is to be at every moment of a transition, and how near they come to each other."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from jpap_ros.fleet.arrays import Floats
from jpap_ros.fleet.fence import Fence
from jpap_ros.fleet.separation_check import polyline_distance, synchronous_distance
from jpap_ros.fleet.time_law import TimeLaw

Vector = tuple[float, float, float]


#: From an aircraft's simulated move to the bridge's knowing, on a machine that is busy [s].
_MACHINE_LAG_S = 0.2


@dataclass(frozen=True)
class TransitLimits:
    """What a transition has to keep to.

    Attributes
    ----------
    min_separation_m : float
        Least distance in space between any two aircraft in the air [m].
    tracking_error_m : float
        Farthest that an aircraft may be from its moving setpoint [m]; twice this is added to the separation.
    reaction_s : float
        Time until an aircraft that drops out of a convoy is noticed [s]. Convoys are flown no faster than that the
        others can then stop before they come nearer than `min_separation_m` to one that stops dead.
    lag_s : float
        How late or early on its way an aircraft may be besides `tracking_error_m` [s]. Not planned for: only for a
        simulation faster than time, where this is the delay of the machine, alike for all, not what an aircraft does.
    speed_m_s, vertical_speed_m_s, acceleration_m_s2 : float
        What every aircraft can do; below what its autopilot is configured for, so that it can follow.
    min_altitude_m, max_altitude_m : float
        Range of the altitude layers that aircraft may be sent through [m], z of the map frame.
    fence : Fence or None
        No way leads out of it; see `within`.
    """

    min_separation_m: float = 10.0
    tracking_error_m: float = 1.0
    reaction_s: float = 1.0
    lag_s: float = 0.0
    speed_m_s: float = 5.0
    vertical_speed_m_s: float = 1.5
    acceleration_m_s2: float = 1.0
    min_altitude_m: float = 20.0
    max_altitude_m: float = 120.0
    fence: Fence | None = None

    def __post_init__(self) -> None:
        for item in fields(self):
            if item.name == "fence":
                continue
            value = getattr(self, item.name)
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
                raise ValueError(f"{item.name} must be a finite number, got {value!r}")
        for name in ("min_separation_m", "tracking_error_m", "reaction_s", "lag_s"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} must be >= 0, got {getattr(self, name)!r}")
        for name in ("speed_m_s", "vertical_speed_m_s", "acceleration_m_s2"):
            if getattr(self, name) <= 0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)!r}")
        if self.max_altitude_m < self.min_altitude_m:
            raise ValueError(f"max_altitude_m is {self.max_altitude_m}, below min_altitude_m {self.min_altitude_m}")

    def within(self, fence: Fence | None) -> TransitLimits:
        """Return the limits with a fence, which the layers keep to as well; ValueError if none is left."""
        if fence is None:
            return self
        lowest_m, highest_m = (
            max(self.min_altitude_m, fence.min_height_m),
            min(self.max_altitude_m, fence.max_height_m),
        )
        if lowest_m > highest_m:
            raise ValueError(
                f"no height is left for ways: the fence allows {fence.min_height_m:g} to {fence.max_height_m:g} m, "
                f"transit_min_height_m and transit_max_height_m {self.min_altitude_m:g} to {self.max_altitude_m:g} m"
            )
        return replace(self, fence=fence, min_altitude_m=lowest_m, max_altitude_m=highest_m)

    def faster(self, rate: float) -> TransitLimits:
        """Return the limits of aircraft that live `rate` times as fast as the clock, as in a simulation."""
        return replace(
            self,
            reaction_s=self.reaction_s / rate,
            lag_s=max(_MACHINE_LAG_S * (1 - 1 / rate), 0.0),
            speed_m_s=self.speed_m_s * rate,
            vertical_speed_m_s=self.vertical_speed_m_s * rate,
            acceleration_m_s2=self.acceleration_m_s2 * rate**2,
        )

    @property
    def planned_separation_m(self) -> float:
        """Distance that setpoints keep, so that aircraft off their setpoints still keep `min_separation_m` [m]."""
        return self.min_separation_m + 2 * self.tracking_error_m


@dataclass(frozen=True)
class Obstacle:
    """What does not obey: an aircraft that fell silent, one that a pilot flies, one of somebody else.

    Attributes
    ----------
    name : str
        For messages.
    position : tuple of float
        (east, north, up) [m], the highest point.
    bottom_m : float
        z down to which the column below `position` is closed too [m]: an aircraft that fell silent may be landing.
    radius_m : float
        How far from there it may be [m].
    way : tuple of (east, north, up)
        Corners of the line that it may have flown on along from `position` [m]: closed as a whole, with columns below.
    """

    name: str
    position: tuple[float, float, float]
    bottom_m: float = 0.0
    radius_m: float = 0.0
    way: tuple[Vector, ...] = ()

    def __post_init__(self) -> None:
        numbers = (*self.position, self.bottom_m, self.radius_m, *(value for corner in self.way for value in corner))
        if len(self.position) != 3 or not all(math.isfinite(value) for value in numbers) or self.radius_m < 0:
            raise ValueError(
                f"obstacle {self.name}: position, bottom_m, radius_m and way must be finite, got {numbers}"
            )

    @cached_property
    def column(self) -> Floats:
        """Polyline that is closed, (k, 3) [m]: from the bottom to the top, and along the way like a comb.

        The columns below the way are no farther apart than the radius, so nothing lies between them unseen.
        """
        corners = [np.array(self.position), *(np.array(corner) for corner in self.way)]
        tops = [corners[0]]
        for start, end in pairwise(corners):
            count = math.ceil(float(np.linalg.norm(end - start)) / max(self.radius_m, 1.0))
            tops += [start + share * (end - start) for share in np.linspace(0.0, 1.0, count + 1)[1:]]
        feet = [np.array([top[0], top[1], min(self.bottom_m, top[2])]) for top in tops]
        line = [feet[0], tops[0]]
        for foot, top in zip(feet[1:], tops[1:], strict=True):
            line += [top, foot, top]
        return np.array(line)

    @cached_property
    def lines(self) -> tuple[Floats, ...]:
        """All that is closed, (k, 3) each [m]: the column, and by themselves the places where it most likely is.

        Whoever is in the column already, such as below one that a pilot has just taken over, may go on in it; but not
        nearer to those places.
        """
        places = self.position, *self.way[-1:]
        return self.column, *(np.array([place]) for place in places)


@dataclass(frozen=True, eq=False)
class Convoy:
    """Aircraft on one clock: at each moment all of them have flown the same share of their present leg.

    Attributes
    ----------
    names : tuple of str
        m aircraft.
    waypoints : (L + 1, m, 3) float
        Ends of the L legs of each [m].
    laws : tuple of TimeLaw
        One for each leg.
    """

    names: tuple[str, ...]
    waypoints: Floats
    laws: tuple[TimeLaw, ...]

    @cached_property
    def duration_s(self) -> float:
        """Time until all of them are at their last waypoint [s]."""
        return sum(law.duration_s for law in self.laws)

    def at(self, time_s: float) -> tuple[Floats, Floats]:
        """Positions [m] and velocities [m/s] of all aircraft, (m, 3) each."""
        leg, elapsed = self._leg(time_s)
        if leg is None:
            return self.waypoints[-1], np.zeros_like(self.waypoints[-1])
        s, speed = self.laws[leg].at(elapsed)
        along = self.waypoints[leg + 1] - self.waypoints[leg]
        return self.waypoints[leg] + s * along, speed * along

    def place(self, index: int, time_s: float) -> tuple[Vector, Vector, float]:
        """Position [m], velocity [m/s] and way to the end of the present leg [m] of one aircraft."""
        leg, elapsed = self._leg(time_s)
        if leg is None:
            east, north, up = self.waypoints[-1, index].tolist()
            return (east, north, up), (0.0, 0.0, 0.0), 0.0
        s, speed = self.laws[leg].at(elapsed)
        (e0, n0, u0), (e1, n1, u1) = self.waypoints[leg : leg + 2, index].tolist()
        along = e1 - e0, n1 - n0, u1 - u0
        velocity = speed * along[0], speed * along[1], speed * along[2]
        return (e0 + s * along[0], n0 + s * along[1], u0 + s * along[2]), velocity, (1.0 - s) * math.hypot(*along)

    def rest(self, time_s: float) -> Convoy:
        """Return what is left of the flight after a time."""
        leg, elapsed = self._leg(time_s)
        if leg is None:
            return Convoy(self.names, self.waypoints[-1:], ())
        s, law = self.laws[leg].rest(elapsed)
        here = self.waypoints[leg] + s * (self.waypoints[leg + 1] - self.waypoints[leg])
        return Convoy(self.names, np.concatenate([here[None], self.waypoints[leg + 1 :]]), (law, *self.laws[leg + 1 :]))

    def stop(self, time_s: float) -> Convoy:
        """Return what is left when all slow down at once: a part of the present leg."""
        leg, elapsed = self._leg(time_s)
        if leg is None:
            return Convoy(self.names, self.waypoints[-1:], ())
        start, end, law = self.laws[leg].braking(elapsed)
        along = self.waypoints[leg + 1] - self.waypoints[leg]
        waypoints = self.waypoints[leg] + np.array([start, end])[:, None, None] * along
        return Convoy(self.names, waypoints[:1], ()) if law is None else Convoy(self.names, waypoints, (law,))

    def _leg(self, time_s: float) -> tuple[int | None, float]:
        elapsed = max(time_s, 0.0)
        for leg, law in enumerate(self.laws):
            if elapsed < law.duration_s:
                return leg, elapsed
            elapsed -= law.duration_s
        return None, 0.0


@dataclass(frozen=True, eq=False)
class TransitPlan:
    """A transition of the whole fleet in the air; made by `plan_transit`, which has checked it.

    Attributes
    ----------
    convoys : tuple of Convoy
        Every aircraft is in exactly one. Aircraft of different convoys need no common clock: their paths stay apart.
    held : mapping of str to str
        Aircraft that stay where they are because no separated path to their goal was found, and why.
    """

    convoys: tuple[Convoy, ...]
    held: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def _places(self) -> dict[str, tuple[Convoy, int]]:
        return {name: (convoy, index) for convoy in self.convoys for index, name in enumerate(convoy.names)}

    @property
    def names(self) -> tuple[str, ...]:
        """Every aircraft of the plan."""
        return tuple(self._places)

    @property
    def duration_s(self) -> float:
        """Time until the last aircraft is where it should be [s]."""
        return max((convoy.duration_s for convoy in self.convoys), default=0.0)

    def arrival_s(self, name: str) -> float:
        """Time until an aircraft's convoy is where it should be [s]."""
        return self._places[name][0].duration_s

    def position(self, name: str, time_s: float) -> Floats:
        """Setpoint of an aircraft at a time since the start, (3,) [m]."""
        convoy, index = self._places[name]
        setpoint: Floats = convoy.at(time_s)[0][index]
        return setpoint

    def velocity(self, name: str, time_s: float) -> Floats:
        """Velocity of that setpoint, (3,) [m/s]."""
        convoy, index = self._places[name]
        velocity: Floats = convoy.at(time_s)[1][index]
        return velocity

    def path(self, name: str) -> Floats:
        """Corners of an aircraft's path, (L + 1, 3) [m]."""
        convoy, index = self._places[name]
        return convoy.waypoints[:, index]

    def stop(self, time_s: float, names: Collection[str] | None = None) -> TransitPlan:
        """Return the plan that brings aircraft to rest from a moment of this one.

        Parameters
        ----------
        time_s : float
            The moment, since the start of this plan [s].
        names : collection of str, optional
            Who has to stop, with their convoys; all others fly on. Default: everyone.

        Notes
        -----
        Nobody leaves the path that has been checked, and within a convoy all slow down on their common clock, so the
        separation of this plan holds for that one.
        """
        return TransitPlan(
            tuple(
                convoy.stop(time_s) if names is None or set(names) & set(convoy.names) else convoy.rest(time_s)
                for convoy in self.convoys
            )
        )


def minimum_separation(plan: TransitPlan, obstacles: Sequence[Obstacle] = ()) -> float:
    """Least distance in space [m] that the plan's setpoints ever have, exactly; infinite for a lone aircraft.

    Within a convoy the common clock counts. Between convoys, and to obstacles (less their radius), it is the distance
    of the paths, so it holds whatever the clocks do.
    """
    least = math.inf
    for convoy in plan.convoys:
        first, second = np.triu_indices(len(convoy.names), k=1)
        for start, end in zip(convoy.waypoints[:-1], convoy.waypoints[1:], strict=True):
            if len(first):
                apart = synchronous_distance(start[first], end[first], start[second], end[second])
                least = min(least, float(apart.min()))
        if len(first):
            still = convoy.waypoints[-1]
            least = min(least, float(np.linalg.norm(still[first] - still[second], axis=1).min()))
    names = plan.names
    for index, name in enumerate(names):
        path = plan.path(name)
        convoy = plan._places[name][0]
        for other in names[index + 1 :]:
            if plan._places[other][0] is not convoy:
                least = min(least, polyline_distance(path, plan.path(other)))
        for obstacle in obstacles:
            least = min(least, polyline_distance(path, obstacle.column) - obstacle.radius_m)
    return least

"""A transition to be planned: who is where, what stands in the way, and which paths come too near to one another.

All distances are exact. What makes them affordable for hundreds of aircraft is that only what lies in neighbouring
boxes is compared, all of it in one go.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jpap_ros.fleet.arrays import Floats, point
from jpap_ros.fleet.separation_check import point_distance, segment_distance
from jpap_ros.fleet.transit_plan import Convoy, Obstacle, TransitLimits

Indices = NDArray[np.intp]
#: What rounding may take from a distance [m].
ROUNDING_M = 1e-7


@dataclass(frozen=True, eq=False)
class Closed:
    """A line, (k, 3), that nobody may come near: an obstacle's column or place, or the path of somebody on the way."""

    name: str
    line: Floats
    radius_m: float


@dataclass(frozen=True, eq=False)
class Legs:
    """Straight pieces of paths: L segments from `start` to `end`, (L, 3) each [m], and whose each is, (L,)."""

    owner: Indices
    start: Floats
    end: Floats

    @staticmethod
    def of(paths: Mapping[int, Floats]) -> Legs:
        """Legs of paths, (k, 3) each, by their owner; a path of one point is a leg without length."""
        starts = [path[:-1] if len(path) > 1 else path for path in paths.values()]
        ends = [path[1:] if len(path) > 1 else path for path in paths.values()]
        owner = np.repeat(np.fromiter(paths, np.intp, len(paths)), [len(start) for start in starts])
        return Legs(owner, np.concatenate([*starts, np.empty((0, 3))]), np.concatenate([*ends, np.empty((0, 3))]))

    def near(self, other: Legs, reach: Floats | float) -> tuple[Indices, Indices]:
        """Pairs of legs (mine, the other's) that may be nearer than the other's `reach`: their boxes are."""
        low, high = np.minimum(self.start, self.end), np.maximum(self.start, self.end)
        margin = np.broadcast_to(reach, len(other.owner))[:, None]
        other_low = np.minimum(other.start, other.end) - margin
        other_high = np.maximum(other.start, other.end) + margin
        together = np.ones((len(self.owner), len(other.owner)), dtype=bool)
        for axis in range(3):
            together &= low[:, None, axis] <= other_high[None, :, axis]
            together &= high[:, None, axis] >= other_low[None, :, axis]
        mine, others = np.nonzero(together)
        return mine, others


@dataclass(frozen=True, eq=False)
class Scene:
    """Aircraft by index, those that rest as well as those that have to go somewhere.

    Attributes
    ----------
    names : tuple of str
    start, goal : (n, 3) float
        [m]; equal for those that stay.
    limits : TransitLimits
    closed : tuple of Closed
    """

    names: tuple[str, ...]
    start: Floats
    goal: Floats
    limits: TransitLimits
    closed: tuple[Closed, ...] = field(default=())

    @staticmethod
    def of(
        starts: Mapping[str, ArrayLike],
        goals: Mapping[str, ArrayLike],
        limits: TransitLimits,
        obstacles: Sequence[Obstacle],
        committed: Sequence[Convoy],
    ) -> Scene:
        """Scene of the arguments of `plan_transit`; ValueError as there."""
        for name in goals:
            if name not in starts:
                raise ValueError(f"goals has {name!r}, which has no start")
        closed = [Closed(obstacle.name, line, obstacle.radius_m) for obstacle in obstacles for line in obstacle.lines]
        closed += [
            Closed(name, convoy.waypoints[:, i], 0.0) for convoy in committed for i, name in enumerate(convoy.names)
        ]
        names = tuple(starts)
        return Scene(
            names, _rows("starts", names, starts), _rows("goals", names, {**starts, **goals}), limits, tuple(closed)
        )

    @cached_property
    def moving(self) -> list[int]:
        """Aircraft that have to go somewhere."""
        return [int(i) for i in np.flatnonzero((self.start != self.goal).any(axis=1))]

    @cached_property
    def _fixed(self) -> Legs:
        """Aircraft that rest, as points, and closed lines; the owner of closed line k is n + k."""
        resting = {int(i): self.start[[i]] for i in np.flatnonzero((self.start == self.goal).all(axis=1))}
        return Legs.of({**resting, **{len(self.names) + k: closed.line for k, closed in enumerate(self.closed)}})

    @cached_property
    def _wanted(self) -> Floats:
        """Distance that setpoints keep from aircraft i, or from closed line k at n + k [m]."""
        radii = np.array([0.0] * len(self.names) + [closed.radius_m for closed in self.closed])
        wanted: Floats = self.limits.planned_separation_m + radii
        return wanted

    def least(self, here: Floats, first: Indices | Sequence[int], second: Indices | Sequence[int]) -> Floats:
        """Distance to keep between aircraft that are at `here` now, pair by pair [m]."""
        ends = np.linalg.norm(self.goal[first] - self.goal[second], axis=-1)
        apart = np.minimum(
            np.linalg.norm(here[first] - here[second], axis=-1), np.maximum(ends, self.limits.min_separation_m)
        )
        least: Floats = np.minimum(apart, self.limits.planned_separation_m) - ROUNDING_M
        return least

    def straight(self, aircraft: Sequence[int]) -> dict[int, Floats]:
        """Straight paths from start to goal, (2, 3) each."""
        return {i: np.array([self.start[i], self.goal[i]]) for i in aircraft}

    def meetings(self, paths: Mapping[int, Floats], others: Mapping[int, Floats]) -> list[tuple[int, int]]:
        """Pairs of aircraft whose paths come too near to each other, whatever their clocks do."""
        mine, theirs = Legs.of(paths), Legs.of(others)
        i, j = mine.near(theirs, self.limits.planned_separation_m)
        differ = mine.owner[i] != theirs.owner[j]
        i, j = i[differ], j[differ]
        apart = segment_distance(mine.start[i], mine.end[i], theirs.start[j], theirs.end[j])
        first, second = mine.owner[i], theirs.owner[j]
        meet = apart < self.least(self.start, first, second)
        pairs = zip(first[meet].tolist(), second[meet].tolist(), strict=True)
        return list(dict.fromkeys(pairs))

    def blockers(
        self, paths: Mapping[int, Floats], here: Floats, still: Sequence[int] = ()
    ) -> dict[int, tuple[int, float]]:
        """What stands in the way of paths of aircraft that are at `here` now.

        Parameters
        ----------
        paths : mapping of int to (k, 3) float
            Paths by aircraft.
        here : (n, 3) float
        still : sequence of int
            Aircraft that stay where they are for now, beside those that rest.

        Returns
        -------
        dict of int to (int, float)
            For each aircraft that cannot go, the worst: an aircraft, or n + k for closed line k, and how near its path
            leads to that [m].
        """
        legs, fixed = Legs.of(paths), self._fixed
        if len(still):
            places = here[list(still)]
            fixed = Legs(
                np.concatenate([fixed.owner, np.array(still, dtype=np.intp)]),
                np.concatenate([fixed.start, places]),
                np.concatenate([fixed.end, places]),
            )
        i, j = legs.near(fixed, self._wanted[fixed.owner])
        if not len(i):
            return {}
        mine, other = legs.owner[i], fixed.owner[j]
        apart = segment_distance(legs.start[i], legs.end[i], fixed.start[j], fixed.end[j])
        # Whoever is too near already may go on, but not nearer: to any leg of the same line.
        line = mine * len(self._wanted) + other
        lines, of_line = np.unique(line, return_inverse=True)
        now = np.full(len(lines), np.inf)
        np.minimum.at(now, of_line, point_distance(here[mine], fixed.start[j], fixed.end[j]))
        least = np.minimum(now[of_line], self._wanted[other]) - ROUNDING_M
        craft = other < len(self.names)
        least[craft] = np.minimum(least[craft], self.least(here, mine[craft], other[craft]))
        worst: dict[int, tuple[int, float]] = {}
        for k in np.argsort(apart - least):
            if apart[k] >= least[k]:
                break
            worst.setdefault(int(mine[k]), (int(other[k]), float(apart[k])))
        return worst

    def leaves_fence(self, path: Floats) -> bool:
        """Whether a path leads out of the fence."""
        fence = self.limits.fence
        if fence is None:
            return False
        corners = [(east, north, up) for east, north, up in path.tolist()]
        return not all(fence.lets_pass(start, end) for start, end in pairwise(corners))

    def near_lines(self, path: Floats) -> list[Closed]:
        """Closed lines nearer to a path than it should be."""
        legs, fixed = Legs.of({0: path}), self._fixed
        i, j = legs.near(fixed, self._wanted[fixed.owner])
        near = segment_distance(legs.start[i], legs.end[i], fixed.start[j], fixed.end[j]) < self._wanted[fixed.owner[j]]
        owners = np.unique(fixed.owner[j[near]])
        return [self.closed[owner - len(self.names)] for owner in owners if owner >= len(self.names)]

    def name(self, owner: int) -> str:
        """Name of an aircraft, or of closed line k at n + k."""
        count = len(self.names)
        return self.names[owner] if owner < count else self.closed[owner - count].name


def _rows(argument: str, names: Sequence[str], places: Mapping[str, ArrayLike]) -> Floats:
    try:
        rows = np.array([places[name] for name in names], dtype=np.float64).reshape(-1, 3)
        if len(rows) == len(names) and np.isfinite(rows).all():
            return rows
    except (TypeError, ValueError):
        pass
    # One of them is no good: find it, to name it.
    return np.array([point(f"{argument}[{name!r}]", places[name], 3) for name in names]).reshape(-1, 3)

"""Transitions in which no two aircraft come nearer than they may: straight lines, altitude layers, sequencing.

The method, and why each of its steps is safe, is derived in docs/replanning.md.

References
----------
M. Turpin, N. Michael, V. Kumar, CAPT: Concurrent assignment and planning of trajectories for multiple robots,
International Journal of Robotics Research 33(1), 2014, doi 10.1177/0278364913515307.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import cdist

from jpap_ros.fleet.arrays import Floats, point
from jpap_ros.fleet.separation_check import polyline_distance, segment_distance, synchronous_distance
from jpap_ros.fleet.time_law import leg_law
from jpap_ros.fleet.transit_plan import Convoy, Obstacle, TransitLimits, TransitPlan

#: What rounding may take from a distance [m].
ROUNDING_M = 1e-7


def plan_transit(
    starts: Mapping[str, ArrayLike],
    goals: Mapping[str, ArrayLike],
    limits: TransitLimits,
    obstacles: Sequence[Obstacle] = (),
    committed: Sequence[Convoy] = (),
) -> TransitPlan:
    """Plan how every aircraft in the air gets to its goal.

    Parameters
    ----------
    starts : mapping of str to (3,) array_like
        Where each aircraft that obeys is, at rest [m], ENU; see `TransitPlan.stop` for one that is moving.
    goals : mapping of str to (3,) array_like
        Where each should go [m]; one without a goal stays.
    limits : TransitLimits
    obstacles : sequence of Obstacle
        Everything else in the air.
    committed : sequence of Convoy
        Aircraft on their way by an earlier plan, which fly on (see `TransitPlan.stop`): others keep clear of all of
        their path, so nothing depends on when they are where. They are in the result as they are here.

    Returns
    -------
    TransitPlan
        Checked in closed form, with two distances for each pair of aircraft: the planned separation, or less where
        they are nearer than that at the start or (down to `min_separation_m`) at their goals. An aircraft for which
        no such path was found holds its start, and is named in `held`.

    Raises
    ------
    ValueError
        On a position that is not three finite numbers, or a goal for an aircraft that has no start.

    Notes
    -----
    CAPT: let the assignment of starts x to goals g minimise the sum of squared distances, and all fly straight, with
    one start, one end and one clock. Then any two have (x_i - x_j) . (g_i - g_j) >= 0, and where starts and goals are
    more than sqrt(2) s apart they never come within s. In the paper s = 2 R and the condition reads 2 sqrt(2) R.

    Examples
    --------
    >>> limits = TransitLimits(min_separation_m=10.0, tracking_error_m=1.0)
    >>> plan = plan_transit({"a": (0, 0, 50), "b": (100, 0, 50)}, {"a": (100, 0, 50), "b": (0, 0, 50)}, limits)
    >>> from jpap_ros.fleet.transit_plan import minimum_separation
    >>> round(minimum_separation(plan), 3)
    12.0
    """
    for name in goals:
        if name not in starts:
            raise ValueError(f"goals has {name!r}, which has no start")
    for convoy in committed:
        for name in convoy.names:
            if name in starts:
                raise ValueError(f"committed has {name!r}, which has a start as well")
    names = tuple(starts)
    start = _by_name("starts", names, starts)
    goal = _by_name("goals", names, {**starts, **goals})
    closed = [_Closed(obstacle.name, obstacle.column, obstacle.radius_m) for obstacle in obstacles]
    closed += [
        _Closed(name, convoy.waypoints[:, i], 0.0) for convoy in committed for i, name in enumerate(convoy.names)
    ]
    scene = _Scene(names, start, goal, limits, closed)
    routes: dict[frozenset[int], _Route] = {}
    groups = _join([frozenset({i}) for i in range(len(names))], scene.crossing(start, goal))
    while True:
        routes = {group: routes.get(group) or _route(scene, sorted(group)) for group in groups}
        meeting = scene.meeting(routes)
        if not meeting:
            break
        groups = _join(groups, meeting)
    held: dict[str, str] = {}
    for route in routes.values():
        held.update(route.held)
    return TransitPlan((*(route.convoy(scene) for route in routes.values()), *committed), held)


def _by_name(argument: str, names: Sequence[str], places: Mapping[str, ArrayLike]) -> Floats:
    return np.array([point(f"{argument}[{name!r}]", places[name], 3) for name in names]).reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class _Closed:
    """A line, (k, 3), that nobody may come near: an obstacle's column, or the path of somebody on the way."""

    name: str
    line: Floats
    radius_m: float


@dataclass(frozen=True, eq=False)
class _Scene:
    """The transition to be planned, with aircraft by index."""

    names: tuple[str, ...]
    start: Floats
    goal: Floats
    limits: TransitLimits
    closed: list[_Closed]

    def least(self, here: Floats, first: Sequence[int], second: Sequence[int]) -> Floats:
        """Distance to keep between aircraft that are at `here` now; (len(first), len(second)) [m]."""
        ends = np.maximum(cdist(self.goal[first], self.goal[second]), self.limits.min_separation_m)
        apart = np.minimum(cdist(here[first], here[second]), ends)
        least: Floats = np.minimum(apart, self.limits.planned_separation_m) - ROUNDING_M
        return least

    def crossing(self, start: Floats, goal: Floats) -> list[tuple[int, int]]:
        """Pairs whose straight lines come too near to each other, whatever the clocks."""
        everyone = range(len(self.names))
        apart = segment_distance(start[:, None], goal[:, None], start[None], goal[None])
        near = apart < self.least(start, everyone, everyone)
        return [(int(i), int(j)) for i, j in np.argwhere(np.triu(near, k=1))]

    def meeting(self, routes: Mapping[frozenset[int], _Route]) -> list[tuple[int, int]]:
        """Pairs of different groups whose paths come too near to each other, whatever the clocks."""
        everyone = range(len(self.names))
        least = self.least(self.start, everyone, everyone)
        paths = {i: route.path(i) for route in routes.values() for i in route.members}
        group_of = {i: group for group in routes for i in group}
        low = np.array([paths[i].min(axis=0) for i in everyone]).reshape(-1, 3)
        high = np.array([paths[i].max(axis=0) for i in everyone]).reshape(-1, 3)
        gap = np.maximum(np.maximum(low[:, None] - high[None], low[None] - high[:, None]), 0.0)
        boxes_near = np.linalg.norm(gap, axis=2) < least
        return [
            (int(i), int(j))
            for i, j in np.argwhere(np.triu(boxes_near, k=1))
            if group_of[int(i)] is not group_of[int(j)]
            and polyline_distance(paths[int(i)], paths[int(j)]) < least[i, j]
        ]

    def blocker(self, aircraft: int, path: Floats, here: Floats, still: Sequence[int]) -> str | None:
        """What stands in the way of a path: an aircraft that stays where it is, or an obstacle; None where clear."""
        if still:
            least = self.least(here, [aircraft], still)[0]
            legs = np.stack([path[:-1], path[1:]], axis=1)
            apart = segment_distance(
                legs[:, None, 0], legs[:, None, 1], here[None, list(still)], here[None, list(still)]
            ).min(axis=0)
            if (apart < least).any():
                nearest = int(np.argmin(apart - least))
                return f"{self.names[still[nearest]]}, {apart[nearest]:.1f} m from its path"
        for closed in self.closed:
            distance = polyline_distance(path, closed.line)
            if distance < self.clearance(here[aircraft], closed):
                return f"{closed.name}, {distance:.1f} m from its path"
        return None

    def clearance(self, here: Floats, closed: _Closed) -> float:
        """Distance that an aircraft which is `here` now has to keep from a closed line [m]."""
        wanted = self.limits.planned_separation_m + closed.radius_m
        return min(polyline_distance(here[None], closed.line), wanted) - ROUNDING_M


@dataclass(eq=False)
class _Route:
    """Legs of a group of aircraft on one clock, as they are found."""

    members: list[int]
    waypoints: list[Floats]
    held: dict[str, str] = field(default_factory=dict)

    def path(self, aircraft: int) -> Floats:
        """Corners of one aircraft's path, (L + 1, 3)."""
        return np.array([corner[self.members.index(aircraft)] for corner in self.waypoints])

    def convoy(self, scene: _Scene) -> Convoy:
        """Return the group with its clock."""
        limits = scene.limits
        waypoints = np.array(self.waypoints)
        laws = tuple(
            leg_law(leg, limits.speed_m_s, limits.vertical_speed_m_s, limits.acceleration_m_s2)
            for leg in np.diff(waypoints, axis=0)
        )
        return Convoy(tuple(scene.names[i] for i in self.members), waypoints, laws)


def _join(groups: Sequence[frozenset[int]], pairs: Sequence[tuple[int, int]]) -> list[frozenset[int]]:
    """Unite groups that have a pair in common."""
    group_of = {i: group for group in groups for i in group}
    for i, j in pairs:
        united = group_of[i] | group_of[j]
        for member in united:
            group_of[member] = united
    return list(dict.fromkeys(group_of[i] for i in sorted(group_of)))


def _route(scene: _Scene, members: list[int]) -> _Route:
    """Find separated paths for a group: all at once and straight, else in waves through layers."""
    here, goal = scene.start[members], scene.goal[members]
    if np.array_equal(here, goal):
        return _Route(members, [here])
    if _straight_together(scene, members):
        return _Route(members, [here, goal])
    return _in_waves(scene, members)


def _straight_together(scene: _Scene, members: list[int]) -> bool:
    here, goal = scene.start[members], scene.goal[members]
    apart = synchronous_distance(here[:, None], goal[:, None], here[None], goal[None])
    near = apart < scene.least(scene.start, members, members)
    return not np.triu(near, k=1).any() and all(
        scene.blocker(i, np.array([scene.start[i], scene.goal[i]]), scene.start, []) is None
        for i in members
        if not np.array_equal(scene.start[i], scene.goal[i])
    )


def _in_waves(scene: _Scene, members: list[int]) -> _Route:
    """Send as many as possible, each on a layer of its own where needed; then the next ones; the rest holds."""
    here = scene.start.copy()
    route = _Route(members, [here[members]])
    waiting = [i for i in members if not np.array_equal(here[i], scene.goal[i])]
    while waiting:
        wave = _wave(scene, members, waiting, here) or _single(scene, members, waiting, here)
        if not wave:
            break
        for corner in range(1, 4):
            following = here.copy()
            for i, path in wave.items():
                following[i] = path[corner]
            if not np.array_equal(following, here):
                route.waypoints.append(following[members])
            here = following
        waiting = [i for i in waiting if i not in wave]
    for i in waiting:
        straight = np.array([here[i], scene.goal[i]])
        others = [j for j in members if j != i]
        why = scene.blocker(i, straight, here, others) or "every path that was tried"
        route.held[scene.names[i]] = f"no separated path to its goal; in the way: {why}"
    return route


def _wave(scene: _Scene, members: list[int], waiting: list[int], here: Floats) -> dict[int, Floats]:
    """Paths of three legs (climb, cross, descend) for as many of the waiting as can go together.

    Those that meet one that stays fall out, the last chosen first, until none does.
    """
    resting = [i for i in members if i not in waiting]
    wave: dict[int, Floats] = {}
    for i in sorted(waiting, key=lambda k: (-float(np.linalg.norm(scene.goal[k] - here[k])), k)):
        if _goal_taken(scene, i, here, resting):
            continue
        for path in _candidates(scene, i, here):
            if scene.blocker(i, path, here, resting) is None and _together(scene, i, path, wave, here):
                wave[i] = path
                break
    while True:
        staying = [i for i in waiting if i not in wave]
        blocked = [i for i, path in wave.items() if staying and scene.blocker(i, path, here, staying) is not None]
        if not blocked:
            return wave
        del wave[blocked[-1]]


def _single(scene: _Scene, members: list[int], waiting: list[int], here: Floats) -> dict[int, Floats]:
    """Path of the first of the waiting that can go while all others stay."""
    for i in waiting:
        others = [j for j in members if j != i]
        if _goal_taken(scene, i, here, others):
            continue
        for path in _candidates(scene, i, here):
            if scene.blocker(i, path, here, others) is None:
                return {i: path}
    return {}


def _goal_taken(scene: _Scene, aircraft: int, here: Floats, still: Sequence[int]) -> bool:
    """Whether no path can help, because the goal itself is too near to somebody who stays."""
    return scene.blocker(aircraft, scene.goal[[aircraft, aircraft]], here, still) is not None


def _candidates(scene: _Scene, aircraft: int, here: Floats) -> Iterator[Floats]:
    """Paths to try, (4, 3) each: straight while others cross; through the layers, nearest first; round an obstacle."""
    start, goal = here[aircraft], scene.goal[aircraft]
    yield np.array([start, start, goal, goal])
    for altitude in _layers(scene.limits, float(goal[2])):
        up, over = start.copy(), goal.copy()
        up[2] = over[2] = altitude
        yield np.array([start, up, over, goal])
    yield from _detours(scene, start, goal)


def _detours(scene: _Scene, start: Floats, goal: Floats) -> Iterator[Floats]:
    """Level paths past each closed line that is near the straight one, on either side of it."""
    along = (goal - start)[:2]
    length = float(np.linalg.norm(along))
    if length == 0:
        return
    along /= length
    across = np.array([-along[1], along[0]])
    for closed in scene.closed:
        wanted = scene.limits.planned_separation_m + closed.radius_m
        if polyline_distance(np.array([start, goal]), closed.line) < wanted:
            offsets = (closed.line[:, :2] - start[:2]) @ np.column_stack([along, across])
            (first, right), (last, left) = offsets.min(axis=0) - wanted, offsets.max(axis=0) + wanted
            for side in sorted((left, right), key=abs):
                corners = [start[:2] + share * along + side * across for share in (first, last)]
                height = np.interp(np.clip([first, last], 0.0, length), [0.0, length], [start[2], goal[2]])
                yield np.array([start, [*corners[0], height[0]], [*corners[1], height[1]], goal])


def _layers(limits: TransitLimits, base_m: float) -> list[float]:
    """Altitudes one planned separation apart, counted from a base, nearest first; above before below."""
    step = max(limits.planned_separation_m, 1.0)
    lowest = math.ceil((limits.min_altitude_m - base_m) / step)
    highest = math.floor((limits.max_altitude_m - base_m) / step)
    return [base_m + k * step for k in sorted(range(lowest, highest + 1), key=lambda k: (abs(k), -k))]


def _together(scene: _Scene, aircraft: int, path: Floats, wave: Mapping[int, Floats], here: Floats) -> bool:
    """Whether a path keeps clear of those of the wave, all on one clock."""
    if not wave:
        return True
    others: NDArray[np.float64] = np.array(list(wave.values()))
    apart = synchronous_distance(path[None, :-1], path[None, 1:], others[:, :-1], others[:, 1:]).min(axis=1)
    return bool((apart >= scene.least(here, [aircraft], list(wave))[0]).all())

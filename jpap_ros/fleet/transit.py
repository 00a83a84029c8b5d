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
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jpap_ros.fleet.arrays import Floats
from jpap_ros.fleet.separation_check import overrun_distance, synchronous_distance
from jpap_ros.fleet.time_law import TimeLaw, leg_law
from jpap_ros.fleet.transit_plan import Convoy, Obstacle, TransitLimits, TransitPlan
from jpap_ros.fleet.transit_scene import ROUNDING_M, Scene

#: Shares of full speed to try; at the last, 1 m/s of 5, stopping takes less than the planned separation has to spare.
SHARES_OF_SPEED = (1.0, 0.85, 0.7, 0.55, 0.4, 0.3, 0.2)


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
    for convoy in committed:
        for name in convoy.names:
            if name in starts:
                raise ValueError(f"committed has {name!r}, which has a start as well")
    scene = Scene.of(starts, goals, limits, obstacles, committed)
    groups = _groups(scene)
    routes = {route.group: route for route in _straight_routes(scene, groups)}
    while True:
        routes = {group: routes.get(group) or _in_waves(scene, group) for group in groups}
        paths = {i: path for route in routes.values() for i, path in route.paths().items()}
        bent = {i: paths[i] for group, route in routes.items() if not route.straight for i in group}
        group_of = {i: group for group in groups for i in group}
        # Straight ones are known to keep clear of one another.
        meeting = [(i, j) for i, j in scene.meetings(bent, paths) if group_of[i] is not group_of[j]]
        if not meeting:
            break
        groups = _join(groups, meeting)
    held: dict[str, str] = {}
    for route in routes.values():
        held.update(route.held)
    resting = [i for i in range(len(scene.names)) if i not in group_of]
    convoys = [route.convoy(scene) for route in routes.values()]
    convoys += [Convoy((scene.names[i],), scene.start[None, [i]], ()) for i in resting]
    return TransitPlan((*convoys, *committed), held)


@dataclass(frozen=True)
class StraightPlan:
    """What `plan_straight` finds.

    Attributes
    ----------
    convoys : tuple of Convoy
        Those that can begin.
    waiting : frozenset of str
        Aircraft that had better wait until others have stopped, to set out together with them.
    """

    convoys: tuple[Convoy, ...]
    waiting: frozenset[str]


def plan_straight(
    starts: Mapping[str, ArrayLike],
    goals: Mapping[str, ArrayLike],
    limits: TransitLimits,
    obstacles: Sequence[Obstacle] = (),
    committed: Sequence[Convoy] = (),
    stopping: Sequence[Convoy] = (),
) -> StraightPlan:
    """Find those that can fly straight to their goals, clear of everybody else.

    A small part of the work of `plan_transit`, and for most changes of a plan in force all that is needed.

    Parameters
    ----------
    starts, goals, limits, obstacles, committed
        As for `plan_transit`, but `goals` may have those of the aircraft that are stopping.
    stopping : sequence of Convoy
        Aircraft that will soon be at rest. They keep what is left of their paths to themselves, as those of
        `committed` do.

    Returns
    -------
    StraightPlan
        Its convoys are checked as those of `plan_transit`, and clear of all other straight ways.
    """
    ends = {name: end for convoy in stopping for name, end in zip(convoy.names, convoy.waypoints[-1], strict=True)}
    scene = Scene.of({**starts, **ends}, goals, limits, obstacles, [*committed, *stopping])
    moving = frozenset(i for i, name in enumerate(scene.names) if name in ends)
    groups = _groups(scene)
    waiting = frozenset(scene.names[i] for group in groups if group & moving for i in group - moving)
    routes = _straight_routes(scene, [group for group in groups if not group & moving])
    return StraightPlan(tuple(route.convoy(scene) for route in routes), waiting)


def is_clear(
    convoy: Convoy,
    resting: Mapping[str, ArrayLike],
    limits: TransitLimits,
    obstacles: Sequence[Obstacle],
    committed: Sequence[Convoy],
) -> bool:
    """Whether a convoy that is about to begin keeps clear of others that it was not planned for."""
    starts = {**dict(zip(convoy.names, convoy.waypoints[0], strict=True)), **resting}
    goals = dict(zip(convoy.names, convoy.waypoints[-1], strict=True))
    scene = Scene.of(starts, goals, limits, obstacles, committed)
    return not scene.blockers({i: convoy.waypoints[:, i] for i in range(len(convoy.names))}, scene.start)


@dataclass(eq=False)
class _Route:
    """Legs of a group of aircraft on one clock, as they are found."""

    group: frozenset[int]
    members: list[int]
    waypoints: list[Floats]
    straight: bool = False
    held: dict[str, str] = field(default_factory=dict)

    def paths(self) -> dict[int, Floats]:
        """Corners of each aircraft's path, (L + 1, 3)."""
        corners = np.array(self.waypoints)
        return {i: corners[:, place] for place, i in enumerate(self.members)}

    def convoy(self, scene: Scene) -> Convoy:
        """Return the group with its clock."""
        waypoints = np.array(self.waypoints)
        laws = tuple(_law(start, end, scene.limits) for start, end in pairwise(waypoints))
        return Convoy(tuple(scene.names[i] for i in self.members), waypoints, laws)


def _law(start: Floats, end: Floats, limits: TransitLimits) -> TimeLaw:
    """Fastest law for a leg at which nobody gets too near to a member that drops out and stops dead."""
    stopped, flying = np.nonzero(~np.eye(len(start), dtype=bool))
    legs = start[stopped], end[stopped], start[flying], end[flying]
    apart = np.minimum(*(np.linalg.norm(places[stopped] - places[flying], axis=1) for places in (start, end)))
    least = np.minimum(apart, limits.min_separation_m) - ROUNDING_M
    for share in SHARES_OF_SPEED:
        law = leg_law(
            end - start, share * limits.speed_m_s, share * limits.vertical_speed_m_s, limits.acceleration_m_s2
        )
        if (overrun_distance(*legs, law.overrun(limits.reaction_s)) >= least).all():
            break
    return law


def _groups(scene: Scene) -> list[frozenset[int]]:
    """Aircraft that have to move, together with those whose straight ways come too near to theirs."""
    straight = scene.straight(scene.moving)
    return _join([frozenset({i}) for i in scene.moving], scene.meetings(straight, straight))


def _join(groups: Sequence[frozenset[int]], pairs: Sequence[tuple[int, int]]) -> list[frozenset[int]]:
    """Unite groups that have a pair in common."""
    group_of = {i: group for group in groups for i in group}
    for i, j in pairs:
        if group_of[i] is not group_of[j]:
            united = group_of[i] | group_of[j]
            for member in united:
                group_of[member] = united
    return list(dict.fromkeys(group_of[i] for i in sorted(group_of)))


def _straight_routes(scene: Scene, groups: Sequence[frozenset[int]]) -> Iterator[_Route]:
    """Routes of the groups that can fly all at once and straight."""
    straight = scene.straight(scene.moving)
    blocked = {i for i, path in straight.items() if scene.leaves_fence(path)}
    blocked |= scene.blockers(straight, scene.start).keys()
    for group in groups:
        if blocked & group:
            continue
        members = sorted(group)
        here, goal = scene.start[members], scene.goal[members]
        first, second = np.triu_indices(len(members), k=1)
        apart = synchronous_distance(here[first], goal[first], here[second], goal[second])
        pairs = np.array(members)[first], np.array(members)[second]
        if (apart >= scene.least(scene.start, *pairs)).all():
            yield _Route(group, members, [here, goal], straight=True)


def _in_waves(scene: Scene, group: frozenset[int]) -> _Route:
    """Send as many as possible, each on a layer of its own where needed; then the next ones; the rest holds."""
    here = scene.start.copy()
    members = sorted(group)
    route = _Route(group, members, [here[members]])
    waiting = members
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
        others = [j for j in members if j != i]
        blocker = scene.blockers({i: np.array([here[i], scene.goal[i]])}, here, others).get(i)
        why = "every path that was tried"
        if scene.leaves_fence(np.array([here[i], scene.goal[i]])):
            why = "the fence"
        elif blocker is not None:
            why = f"{scene.name(blocker[0])}, {blocker[1]:.1f} m from its path"
        route.held[scene.names[i]] = f"no separated path to its goal; in the way: {why}"
    return route


def _wave(scene: Scene, members: list[int], waiting: list[int], here: Floats) -> dict[int, Floats]:
    """Paths of three legs (climb, cross, descend) for as many of the waiting as can go together.

    Those that meet one that stays fall out, the last chosen first, until none does.
    """
    arrived = [i for i in members if i not in waiting]
    wave: dict[int, Floats] = {}
    for i in sorted(waiting, key=lambda k: (-float(np.linalg.norm(scene.goal[k] - here[k])), k)):
        if _goal_taken(scene, i, here, arrived):
            continue
        for path in _candidates(scene, i, here):
            if not scene.blockers({i: path}, here, arrived) and _together(scene, i, path, wave, here):
                wave[i] = path
                break
    staying = [i for i in waiting if i not in wave]
    blocked = set(scene.blockers(wave, here, staying)) if wave and staying else set()
    while blocked:
        last = next(i for i in reversed(wave) if i in blocked)
        del wave[last]
        blocked.discard(last)
        if clear := {i: path for i, path in wave.items() if i not in blocked}:
            blocked |= scene.blockers(clear, here, [last]).keys()
    return wave


def _single(scene: Scene, members: list[int], waiting: list[int], here: Floats) -> dict[int, Floats]:
    """Path of the first of the waiting that can go while all others stay."""
    for i in waiting:
        others = [j for j in members if j != i]
        if _goal_taken(scene, i, here, others):
            continue
        for path in _candidates(scene, i, here):
            if not scene.blockers({i: path}, here, others):
                return {i: path}
    return {}


def _goal_taken(scene: Scene, aircraft: int, here: Floats, still: Sequence[int]) -> bool:
    """Whether no path can help, because the goal itself is too near to somebody who stays."""
    return bool(scene.blockers({aircraft: scene.goal[[aircraft]]}, here, still))


def _candidates(scene: Scene, aircraft: int, here: Floats) -> Iterator[Floats]:
    """Paths to try, (4, 3) each, that keep to the fence."""
    yield from (path for path in _all_candidates(scene, aircraft, here) if not scene.leaves_fence(path))


def _all_candidates(scene: Scene, aircraft: int, here: Floats) -> Iterator[Floats]:
    """Straight while others cross; through the layers, nearest first; round an obstacle."""
    start, goal = here[aircraft], scene.goal[aircraft]
    yield np.array([start, start, goal, goal])
    for altitude in _layers(scene.limits, float(goal[2])):
        up, over = start.copy(), goal.copy()
        up[2] = over[2] = altitude
        yield np.array([start, up, over, goal])
    yield from _detours(scene, start, goal)


def _detours(scene: Scene, start: Floats, goal: Floats) -> Iterator[Floats]:
    """Level paths past each closed line that is near the straight one, on either side of it."""
    along = (goal - start)[:2]
    length = float(np.linalg.norm(along))
    if length == 0:
        return
    along /= length
    across = np.array([-along[1], along[0]])
    for closed in scene.near_lines(np.array([start, goal])):
        if len(closed.line) == 1:
            # A place in a column: the way round that is the way round it.
            continue
        wanted = scene.limits.planned_separation_m + closed.radius_m
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


def _together(scene: Scene, aircraft: int, path: Floats, wave: Mapping[int, Floats], here: Floats) -> bool:
    """Whether a path keeps clear of those of the wave, all on one clock."""
    if not wave:
        return True
    others: NDArray[np.float64] = np.array(list(wave.values()))
    apart = synchronous_distance(path[None, :-1], path[None, 1:], others[:, :-1], others[:, 1:]).min(axis=1)
    return bool((apart >= scene.least(here, [aircraft] * len(wave), list(wave))).all())

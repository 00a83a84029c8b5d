"""Traffic control: moving setpoints that bring every aircraft to its goal without two of them coming close.

The engine of `transit`, run over time. Aircraft that hover at their setpoint rest; those on the way belong to
convoys, each with a clock of its own. Whenever goals, aircraft or obstacles change, those concerned stop, and a new
transition is planned and checked from where they rest, before its first setpoint leaves. All others fly on. Whoever can
fly straight, clear of everybody, begins at once; the rest is planned behind, in a worker.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future, wait
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from jpap_ros.fleet.arrays import Floats
from jpap_ros.fleet.separation_check import polyline_distance
from jpap_ros.fleet.transit import is_clear, plan_straight
from jpap_ros.fleet.transit_plan import Convoy, Obstacle, TransitLimits, TransitPlan
from jpap_ros.fleet.transit_worker import SMALL_FLEET, TransitWorker

Vector = tuple[float, float, float]

#: Two places nearer than this are one [m].
SAME_PLACE_M = 1e-3
#: After so long, a way is looked for again for those that were held [s].
RETRY_S = 1.0
#: Moments at which the way of an aircraft that may be late or early is looked at.
_LAG_STEPS = 17


@dataclass(frozen=True)
class Traveller:
    """One aircraft as it is now.

    Attributes
    ----------
    position : (east, north, up) or None
        [m]; None where unknown.
    obeys : bool
        It flies, and follows the setpoints of this traffic control.
    flies : bool
        It is in the air; one that flies and does not obey is an obstacle.
    goal : (east, north, up) or None
        Where it should be [m]; None: where it is.
    heard_at : float
        When it said where it is, on the clock of `step` [s].
    heard : bool
        Its link is there. One whose link is lost flies on along its way, unseen.
    runs_on_s : float
        For how long it then flies on with its last velocity, braking included [s].
    way : tuple of (east, north, up)
        Corners of the line that it may have flown on along from `position` [m], if somebody else sent it there.
    """

    position: Vector | None
    obeys: bool
    flies: bool
    goal: Vector | None = None
    heard_at: float = -math.inf
    heard: bool = True
    runs_on_s: float = 0.0
    way: tuple[Vector, ...] = ()


@dataclass(frozen=True)
class Setpoint:
    """Where an aircraft should be at a moment.

    Attributes
    ----------
    position : (east, north, up)
        [m].
    velocity : (east, north, up)
        [m/s]; zero at rest.
    ahead_m : float
        Way to where it will rest next, in the direction of its velocity [m].
    """

    position: Vector
    velocity: Vector = (0.0, 0.0, 0.0)
    ahead_m: float = math.inf


@dataclass(eq=False)
class _Flight:
    """A convoy under way."""

    convoy: Convoy
    started: float
    #: What each member wanted when the way was planned; some may end short of it, for want of a free way.
    wanted: Mapping[str, Vector | None]
    braking: bool = False

    def __post_init__(self) -> None:
        self._begun = self.convoy, self.started

    def line(self, name: str, since: float, until: float) -> list[Vector]:
        """Corners of a member's way between two moments [m], as it was begun: one that hears nothing does not brake."""
        convoy, started = self._begun
        index = convoy.names.index(name)
        ends = started + np.cumsum([law.duration_s for law in convoy.laws])
        corners = map(_vector, convoy.waypoints[1:, index][(since < ends) & (ends < until)])
        first, last = (convoy.place(index, moment - started)[0] for moment in (since, until))
        return [first, *corners, last]

    def ended(self, now: float) -> bool:
        return now - self.started >= self.convoy.duration_s

    def rest(self, now: float) -> Convoy:
        return self.convoy.rest(now - self.started)

    def place(self, name: str, now: float) -> tuple[Vector, Vector, float]:
        """Where a member should be [m], its velocity [m/s], and its way to the end of the present leg [m]."""
        return self.convoy.place(self.convoy.names.index(name), now - self.started)

    def brake(self, now: float) -> None:
        self.convoy, self.started, self.braking = self.convoy.stop(now - self.started), now, True


@dataclass(frozen=True)
class _Request:
    """What a transition was planned for."""

    goals: Mapping[str, Vector]
    resting: Mapping[str, Vector]
    obstacles: tuple[Obstacle, ...]
    flights: tuple[_Flight, ...]


class TrafficControl:
    """Moving setpoints for a fleet.

    Parameters
    ----------
    limits : TransitLimits
        May be replaced at any time; transitions under way go on as they were planned.
    obstacle_radius_m : float
        How far an aircraft that does not obey may get from where it is while others react [m].
    on_plan : callable
        Called from another thread when the worker has an answer: time for the next step.
    waits_for_plans : bool
        Whether a step lasts until the worker has answered, as a simulation faster than time needs it.

    Notes
    -----
    Not thread-safe: one thread calls `step` and `setpoint`. Straight flights are planned in the step itself. Finding
    a way round others takes longer than setpoints may wait, so a worker does it; meanwhile everybody goes on as
    before. What has changed until it answers is compared with each convoy of its plan, and only those that are clear
    of it begin.

    A convoy keeps apart only as long as each of its members follows. So when one drops out or lies farther from its
    setpoint than the transition allows for (`TransitLimits.tracking_error_m`), or when an obstacle comes near the way
    that is left, all of its convoy slow down at once on the path that was checked, and rest.
    """

    def __init__(
        self,
        limits: TransitLimits,
        obstacle_radius_m: float = 5.0,
        on_plan: Callable[[], None] = lambda: None,
        waits_for_plans: bool = False,
    ) -> None:
        self.limits = limits
        self._obstacle_radius_m = obstacle_radius_m
        self._on_plan = on_plan
        self._waits_for_plans = waits_for_plans
        self._resting: dict[str, Vector] = {}
        self._flights: list[_Flight] = []
        self._aboard: dict[str, _Flight] = {}
        self._turned: set[str] = set()
        #: Ways that each was given since it last said where it is; the first may be older.
        self._ways: dict[str, list[_Flight]] = {}
        #: Those that fell silent on their way: where they may be, and when they last said where they are.
        self._lost: dict[str, tuple[Obstacle, float]] = {}
        self._columns: dict[str, Obstacle] = {}
        self._released: set[str] = set()
        self._held: dict[str, str] = {}
        self._fleet: Mapping[str, Traveller] = {}
        self._tried: _Request | None = None
        self._tried_at = -math.inf
        self._asked: tuple[_Request, Future[TransitPlan]] | None = None
        self._waiting_since: dict[str, float] = {}
        #: Whether somebody waits for the worker to be free.
        self._unasked = False
        self._worker = TransitWorker()

    def close(self) -> None:
        """End the worker."""
        self._worker.close()

    def step(self, now: float, fleet: Mapping[str, Traveller]) -> set[str]:
        """Take in where everybody is and wants to go; to be called several times a second, and at once on a change.

        Returns
        -------
        set of str
            Aircraft that begin to move, or to stop, in this step.
        """
        self._fleet = fleet
        self._turned = set()
        self._open_columns()
        self._listen()
        self._land(now)
        self._dismiss(now)
        self._admit()
        obstacles = self._obstacles()
        self._brake(now, obstacles)
        self._adopt(now, obstacles)
        self._plan(now, obstacles)
        self._aboard = {name: flight for flight in self._flights for name in flight.convoy.names}
        return self._turned

    def setpoint(self, name: str, now: float) -> Setpoint | None:
        """Where an aircraft should be now; None if it is not under control."""
        if name in self._resting:
            return Setpoint(self._resting[name])
        if name not in self._aboard:
            return None
        return Setpoint(*self._aboard[name].place(name, now))

    def held(self, name: str) -> str:
        """Why an aircraft is not on its way to its goal; empty if it is, or is there."""
        return self._held.get(name, "")

    def lost(self, name: str) -> tuple[Vector, ...]:
        """Corners of the line on which an aircraft is that fell silent on its way [m]; empty if it did not."""
        if name not in self._lost:
            return ()
        obstacle = self._lost[name][0]
        return obstacle.position, *obstacle.way

    @property
    def columns(self) -> Mapping[str, Obstacle]:
        """Columns of air that are closed for one aircraft each, by its name."""
        return self._columns

    def rests_at(self, name: str) -> Vector | None:
        """Where an aircraft under control hovers; None if it is on its way, or not under control."""
        return self._resting.get(name)

    def claim(self, name: str, top: Vector, bottom_m: float, now: float) -> str:
        """Close a column of air to all others, for an aircraft that is about to climb or to land in it by itself.

        It gets no setpoints until `release`. One that flies already may stay as near to another as it is now.

        Returns
        -------
        str
            Who is too near to the column, or the aircraft itself while it moves; empty if the column is closed.
        """
        column = Obstacle(name, top, bottom_m)
        other = name if name in self._aboard else self._beside(column, now)
        if not other:
            self._resting.pop(name, None)
            self._ways.pop(name, None)
            self._released.discard(name)
            self._columns[name] = column
        return other

    def release(self, name: str) -> None:
        """Open an aircraft's column again, as soon as the next step shows what became of it."""
        self._released.add(name)

    def _beside(self, column: Obstacle, now: float) -> str:
        """Who is too near to a column, with all of the path that is left to those on their way; empty if nobody."""
        traveller = self._fleet.get(column.name)
        here = column.column[1:] if traveller is not None and traveller.flies else None
        lines = [(other, np.array([place]), 0.0) for other, place in self._resting.items()]
        for flight in self._flights:
            paths = np.swapaxes(flight.rest(now).waypoints, 0, 1)
            lines += [(other, path, 0.0) for other, path in zip(flight.convoy.names, paths, strict=True)]
        lines += [(each.name, line, each.radius_m) for each in self._obstacles() for line in each.lines]
        for other, line, radius_m in lines:
            wanted = self.limits.planned_separation_m + radius_m
            if here is not None:
                wanted = min(wanted, polyline_distance(here, line))
            if other != column.name and polyline_distance(column.column, line) < wanted - SAME_PLACE_M:
                return other
        return ""

    # One step, part by part

    def _open_columns(self) -> None:
        for name in self._released:
            self._columns.pop(name, None)
        self._released.clear()

    def _listen(self) -> None:
        """Forget what was only guessed about those that have said since where they are."""
        for name, (_, heard_at) in list(self._lost.items()):
            if name not in self._fleet or self._fleet[name].heard_at > heard_at or not self._fleet[name].flies:
                del self._lost[name]
        for name, ways in self._ways.items():
            while len(ways) > 1 and name in self._fleet and ways[1].started <= self._fleet[name].heard_at:
                ways.pop(0)

    def _land(self, now: float) -> None:
        """Those whose convoy is at its end rest there."""
        for flight in [f for f in self._flights if f.ended(now)]:
            self._flights.remove(flight)
            for name, place in zip(flight.convoy.names, flight.convoy.waypoints[-1], strict=True):
                self._resting[name] = _vector(place)

    def _dismiss(self, now: float) -> None:
        """Those who obey no more are obstacles from now on; their convoys stop."""
        for name in [name for name in self._resting if not self._obeys(name)]:
            del self._resting[name]
            self._held.pop(name, None)
            self._lose(name, now)
        for flight in list(self._flights):
            gone = [name for name in flight.convoy.names if not self._obeys(name)]
            if gone:
                for name in gone:
                    self._lose(name, now)
                self._stop(flight, now)
                flight.convoy = _without(flight.convoy, gone)
                if not flight.convoy.names:
                    self._flights.remove(flight)
            elif any(self._strays(name, flight) for name in flight.convoy.names):
                self._stop(flight, now)

    def _lose(self, name: str, now: float) -> None:
        """Close the way of one whose link is lost: from where it was last heard to where it may have got by itself.

        Nobody knows whether it hears what is sent. If it does, it followed until now; if not, it ran on along the way
        that it flew when it was last heard, whatever was decided since.
        """
        ways, traveller = self._ways.pop(name, []), self._fleet.get(name)
        if traveller is None or traveller.heard or not ways:
            return
        until = now + traveller.runs_on_s
        corners = [corner for way in ways for corner in way.line(name, max(traveller.heard_at, way.started), until)]
        line = [corner for corner, before in zip(corners, [None, *corners], strict=False) if corner != before]
        obstacle = Obstacle(name, line[0], radius_m=self._obstacle_radius_m, way=tuple(line[1:]))
        self._lost[name] = obstacle, traveller.heard_at

    def _stop(self, flight: _Flight, now: float) -> None:
        if not flight.braking:
            flight.brake(now)
            self._turned.update(flight.convoy.names)

    def _strays(self, name: str, flight: _Flight) -> bool:
        traveller = self._fleet[name]
        # Compared with where it should have been when it said where it is; from before the start that means nothing.
        if traveller.position is None or traveller.heard_at <= flight.started:
            return False
        moments = np.linspace(-self.limits.lag_s, self.limits.lag_s, _LAG_STEPS) if self.limits.lag_s else (0.0,)
        return all(
            math.dist(traveller.position, flight.place(name, max(traveller.heard_at - late, flight.started))[0])
            > self.limits.tracking_error_m
            for late in moments
        )

    def _obeys(self, name: str) -> bool:
        return name in self._fleet and self._fleet[name].obeys

    def _admit(self) -> None:
        """Whoever obeys from now on rests where it is."""
        flying = {name for flight in self._flights for name in flight.convoy.names}
        for name, traveller in self._fleet.items():
            taken = name in self._resting or name in flying or name in self._columns
            if traveller.obeys and traveller.position is not None and not taken:
                self._resting[name] = traveller.position
        if len(self._resting) > SMALL_FLEET:
            self._worker.prepare()

    def _obstacles(self) -> tuple[Obstacle, ...]:
        strangers = (
            Obstacle(name, _coarse(traveller.position), radius_m=self._obstacle_radius_m, way=traveller.way)
            for name, traveller in self._fleet.items()
            if traveller.flies
            and not traveller.obeys
            and traveller.position is not None
            and name not in self._lost
            and not self._keeps_to_its_column(name, traveller.position)
        )
        return *self._columns.values(), *(obstacle for obstacle, _ in self._lost.values()), *strangers

    def _keeps_to_its_column(self, name: str, position: Vector) -> bool:
        column = self._columns.get(name)
        return column is not None and math.dist(position[:2], column.position[:2]) <= self._obstacle_radius_m

    def _brake(self, now: float, obstacles: tuple[Obstacle, ...]) -> None:
        """Stop the convoys of which a member's goal has changed, or in whose way an obstacle is."""
        for flight in self._flights:
            if flight.braking:
                continue
            changed = any(self._changed(name, flight.wanted[name]) for name in flight.convoy.names)
            if changed or self._blocked(flight, now, obstacles):
                self._stop(flight, now)

    def _changed(self, name: str, wanted: Vector | None) -> bool:
        """Whether an aircraft wants something else than what its way was planned for; without a goal it stops."""
        goal = self._fleet[name].goal
        if goal is None or wanted is None:
            return goal is not wanted
        return not _same(goal, wanted)

    def _blocked(self, flight: _Flight, now: float, obstacles: tuple[Obstacle, ...]) -> bool:
        if not obstacles:
            return False
        rest = flight.rest(now).waypoints
        wanted = self.limits.min_separation_m
        for obstacle in obstacles:
            for line, path in product(obstacle.lines, np.swapaxes(rest, 0, 1)):
                near = polyline_distance(path, line) - obstacle.radius_m
                # One that begins too near may fly on if that leads away.
                if near < min(wanted, polyline_distance(path[:1], line) - obstacle.radius_m) - SAME_PLACE_M:
                    return True
        return False

    def _goal(self, name: str, otherwise: Floats | Vector) -> Vector:
        goal = self._fleet[name].goal
        return _vector(otherwise) if goal is None else goal

    def _plan(self, now: float, obstacles: tuple[Obstacle, ...]) -> None:
        """Begin the straight flights of those who rest elsewhere than at their goals; ask the worker for the others."""
        goals = self._unreached()
        for name in [name for name in self._held if name not in goals]:
            del self._held[name]
        request = self._request(goals, obstacles)
        if not goals or (request == self._tried and now - self._tried_at < RETRY_S):
            return
        plan = plan_straight(
            request.resting,
            goals | self._goals_of_stopping(),
            self.limits,
            obstacles,
            [flight.rest(now) for flight in self._flights if not flight.braking],
            [flight.rest(now) for flight in self._flights if flight.braking],
        )
        self._begin(now, plan.convoys)
        goals = self._unreached()
        self._tried, self._tried_at = self._request(goals, obstacles), now
        goals = self._without_waiting(goals, plan.waiting, now)
        self._unasked = bool(goals) and self._asked is not None
        if not goals or self._unasked:
            return
        committed = [flight.rest(now) for flight in self._flights]
        future = self._worker.submit(self._tried.resting, goals, self.limits, obstacles, committed)
        self._asked = replace(self._tried, goals=goals), future
        future.add_done_callback(lambda _: self._on_plan())
        if self._waits_for_plans:
            wait([future])
            self._adopt(now, obstacles)

    def _unreached(self) -> dict[str, Vector]:
        """Goals of those who rest elsewhere."""
        goals = {name: self._goal(name, place) for name, place in self._resting.items()}
        return {name: goal for name, goal in goals.items() if not _same(goal, self._resting[name])}

    def _goals_of_stopping(self) -> dict[str, Vector]:
        return {
            name: self._goal(name, end)
            for flight in self._flights
            if flight.braking
            for name, end in zip(flight.convoy.names, flight.convoy.waypoints[-1], strict=True)
        }

    def _without_waiting(self, goals: dict[str, Vector], waiting: frozenset[str], now: float) -> dict[str, Vector]:
        """Leave out those that wait for others to stop, but none of them for longer than a stop takes."""
        self._waiting_since = {name: self._waiting_since.get(name, now) for name in waiting & goals.keys()}
        longest_s = self.limits.speed_m_s / self.limits.acceleration_m_s2
        return {
            name: goal for name, goal in goals.items() if now - self._waiting_since.get(name, -math.inf) > longest_s
        }

    def _request(self, goals: Mapping[str, Vector], obstacles: tuple[Obstacle, ...]) -> _Request:
        return _Request(goals, dict(self._resting), obstacles, tuple(self._flights))

    def _adopt(self, now: float, obstacles: tuple[Obstacle, ...]) -> None:
        """Begin what the worker has planned, as far as it still fits."""
        if self._asked is None or not self._asked[1].done():
            return
        (request, future), self._asked = self._asked, None
        if self._unasked:
            self._tried = None
        plan = future.result()
        same = {
            name
            for name, place in self._resting.items()
            if request.resting.get(name) == place and _same(request.goals.get(name, place), self._goal(name, place))
        }
        self._held.update({name: why for name, why in plan.held.items() if name in same})
        newly_resting = {name: place for name, place in self._resting.items() if request.resting.get(name) != place}
        new_obstacles = [obstacle for obstacle in obstacles if obstacle not in request.obstacles]
        under_way = [flight.rest(now) for flight in self._flights if flight not in request.flights]
        convoys = [convoy for convoy in plan.convoys if convoy.duration_s > 0 and same.issuperset(convoy.names)]
        if newly_resting or new_obstacles or under_way:
            convoys = [
                convoy for convoy in convoys if is_clear(convoy, newly_resting, self.limits, new_obstacles, under_way)
            ]
        self._begin(now, convoys)

    def _begin(self, now: float, convoys: Iterable[Convoy]) -> None:
        for convoy in convoys:
            wanted = {name: self._fleet[name].goal for name in convoy.names}
            self._flights.append(_Flight(convoy, now, wanted))
            self._turned.update(convoy.names)
            for name in convoy.names:
                self._ways.setdefault(name, []).append(self._flights[-1])
                del self._resting[name]
                self._held.pop(name, None)


def _vector(values: Floats | Vector) -> Vector:
    east, north, up = (float(value) for value in values)
    return east, north, up


def _same(a: Floats | Vector, b: Floats | Vector) -> bool:
    return math.dist(_vector(a), _vector(b)) < SAME_PLACE_M


def _coarse(position: Vector) -> Vector:
    """Whole metres: an obstacle that sways in the wind is not a new one."""
    east, north, up = (float(round(value)) for value in position)
    return east, north, up


def _without(convoy: Convoy, gone: list[str]) -> Convoy:
    keep = [i for i, name in enumerate(convoy.names) if name not in gone]
    return Convoy(tuple(convoy.names[i] for i in keep), convoy.waypoints[:, keep], convoy.laws)

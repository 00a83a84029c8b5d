"""Traffic control: moving setpoints that bring every aircraft to its goal without two of them coming close.

The engine of `transit`, run over time. Aircraft that hover at their setpoint rest; those on the way belong to
convoys, each with a clock of its own. Whenever goals, aircraft or obstacles change, those concerned stop, and a new
transition is planned and checked from where they rest, before its first setpoint leaves. All others fly on.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from concurrent.futures import Future, wait
from dataclasses import dataclass

import numpy as np

from jpap_ros.fleet.arrays import Floats
from jpap_ros.fleet.separation_check import polyline_distance
from jpap_ros.fleet.transit_plan import Convoy, Obstacle, TransitLimits, TransitPlan
from jpap_ros.fleet.transit_worker import TransitWorker

Vector = tuple[float, float, float]

#: Two places nearer than this are one [m].
SAME_PLACE_M = 1e-3
#: After so long, a way is looked for again for those that were held [s].
RETRY_S = 1.0
#: Usual patience of a step [s].
SHORT_WAIT_S = 0.02


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
    """

    position: Vector | None
    obeys: bool
    flies: bool
    goal: Vector | None = None
    heard_at: float = -math.inf


@dataclass(frozen=True)
class Setpoint:
    """Where an aircraft should be at a moment.

    Attributes
    ----------
    position : (east, north, up)
        [m].
    velocity : (east, north, up)
        [m/s]; zero at rest.
    """

    position: Vector
    velocity: Vector = (0.0, 0.0, 0.0)


@dataclass
class _Flight:
    """A convoy under way."""

    convoy: Convoy
    started: float
    #: What each member wanted when the way was planned; some may end short of it, for want of a free way.
    wanted: Mapping[str, Vector | None]
    braking: bool = False

    def ended(self, now: float) -> bool:
        return now - self.started >= self.convoy.duration_s

    def rest(self, now: float) -> Convoy:
        return self.convoy.rest(now - self.started)

    def brake(self, now: float) -> None:
        if not self.braking:
            self.convoy, self.started, self.braking = self.convoy.stop(now - self.started), now, True


@dataclass(frozen=True)
class _Request:
    """What a transition was asked for; its answer counts only while this still holds."""

    goals: Mapping[str, Vector]
    resting: Mapping[str, Vector]
    obstacles: tuple[Obstacle, ...]
    flights: tuple[int, ...]


class TrafficControl:
    """Moving setpoints for a fleet.

    Parameters
    ----------
    limits : TransitLimits
        May be replaced at any time; transitions under way go on as they were planned.
    obstacle_radius_m : float
        How far an aircraft that does not obey may get from where it is while others react [m].
    patience_s : float or None
        How long a step waits for the worker, so that a small fleet's transition begins at once; None: until it is
        done, as a simulation faster than time needs it [s].

    Notes
    -----
    Not thread-safe: one thread calls `step` and `setpoint`. Transitions are planned in a worker, because that of a
    large fleet takes longer than setpoints may wait; meanwhile everybody goes on as before.

    A convoy keeps apart only as long as each of its members follows. So when one drops out or lies farther from its
    setpoint than the transition allows for (`TransitLimits.tracking_error_m`), or when an obstacle comes near the way
    that is left, all of its convoy slow down at once on the path that was checked, and rest.
    """

    def __init__(
        self, limits: TransitLimits, obstacle_radius_m: float = 5.0, patience_s: float | None = SHORT_WAIT_S
    ) -> None:
        self.limits = limits
        self._obstacle_radius_m = obstacle_radius_m
        self._patience_s = patience_s
        self._resting: dict[str, Vector] = {}
        self._flights: list[_Flight] = []
        self._aboard: dict[str, _Flight] = {}
        self._held: dict[str, str] = {}
        self._fleet: Mapping[str, Traveller] = {}
        self._tried: _Request | None = None
        self._tried_at = -math.inf
        self._asked: tuple[_Request, Future[TransitPlan]] | None = None
        self._worker = TransitWorker()

    def close(self) -> None:
        """End the worker."""
        self._worker.close()

    def step(self, now: float, fleet: Mapping[str, Traveller]) -> None:
        """Take in where everybody is and wants to go; to be called several times a second, and at once on a change."""
        self._fleet = fleet
        self._land(now)
        self._dismiss(now)
        self._admit()
        obstacles = self._obstacles()
        self._brake(now, obstacles)
        self._adopt(now)
        self._ask(now, obstacles)
        self._adopt(now)
        self._aboard = {name: flight for flight in self._flights for name in flight.convoy.names}

    def setpoint(self, name: str, now: float) -> Setpoint | None:
        """Where an aircraft should be now; None if it is not under control."""
        if name in self._resting:
            return Setpoint(self._resting[name])
        if name not in self._aboard:
            return None
        flight = self._aboard[name]
        index = flight.convoy.names.index(name)
        positions, velocities = flight.convoy.at(now - flight.started)
        return Setpoint(_vector(positions[index]), _vector(velocities[index]))

    def held(self, name: str) -> str:
        """Why an aircraft is not on its way to its goal; empty if it is, or is there."""
        return self._held.get(name, "")

    # One step, part by part

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
        for flight in list(self._flights):
            gone = [name for name in flight.convoy.names if not self._obeys(name)]
            if gone:
                flight.brake(now)
                flight.convoy = _without(flight.convoy, gone)
                if not flight.convoy.names:
                    self._flights.remove(flight)
            elif any(self._strays(name, flight) for name in flight.convoy.names):
                flight.brake(now)

    def _strays(self, name: str, flight: _Flight) -> bool:
        traveller = self._fleet[name]
        # Compared with where it should have been when it said where it is; from before the start that means nothing.
        if traveller.position is None or traveller.heard_at <= flight.started:
            return False
        positions, _ = flight.convoy.at(traveller.heard_at - flight.started)
        wanted = positions[flight.convoy.names.index(name)]
        return math.dist(traveller.position, _vector(wanted)) > self.limits.tracking_error_m

    def _obeys(self, name: str) -> bool:
        return name in self._fleet and self._fleet[name].obeys

    def _admit(self) -> None:
        """Whoever obeys from now on rests where it is."""
        flying = {name for flight in self._flights for name in flight.convoy.names}
        for name, traveller in self._fleet.items():
            if traveller.obeys and traveller.position is not None and name not in self._resting and name not in flying:
                self._resting[name] = traveller.position

    def _obstacles(self) -> tuple[Obstacle, ...]:
        return tuple(
            Obstacle(name, _coarse(traveller.position), radius_m=self._obstacle_radius_m)
            for name, traveller in self._fleet.items()
            if traveller.flies and not traveller.obeys and traveller.position is not None
        )

    def _brake(self, now: float, obstacles: tuple[Obstacle, ...]) -> None:
        """Stop the convoys of which a member's goal has changed, or in whose way an obstacle is."""
        for flight in self._flights:
            if flight.braking:
                continue
            changed = any(self._changed(name, flight.wanted[name]) for name in flight.convoy.names)
            if changed or self._blocked(flight, now, obstacles):
                flight.brake(now)

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
            for path in np.swapaxes(rest, 0, 1):
                near = polyline_distance(path, obstacle.column) - obstacle.radius_m
                # One that begins too near may fly on if that leads away.
                if near < min(wanted, polyline_distance(path[:1], obstacle.column) - obstacle.radius_m) - SAME_PLACE_M:
                    return True
        return False

    def _goal(self, name: str, otherwise: Floats | Vector) -> Vector:
        goal = self._fleet[name].goal
        return _vector(otherwise) if goal is None else goal

    def _ask(self, now: float, obstacles: tuple[Obstacle, ...]) -> None:
        """Have a transition planned for those who rest elsewhere than at their goals."""
        goals = {name: self._goal(name, place) for name, place in self._resting.items()}
        goals = {name: goal for name, goal in goals.items() if not _same(goal, self._resting[name])}
        for name in [name for name in self._held if name not in goals]:
            del self._held[name]
        if not goals or self._asked is not None:
            return
        request = _Request(goals, dict(self._resting), obstacles, self._under_way())
        if request == self._tried and now - self._tried_at < RETRY_S:
            return
        self._tried, self._tried_at = request, now
        committed = [flight.rest(now) for flight in self._flights]
        future = self._worker.submit(request.resting, goals, self.limits, obstacles, committed)
        self._asked = request, future
        wait([future], self._patience_s)

    def _under_way(self) -> tuple[int, ...]:
        """What names the flights that a plan has to keep clear of; a brake only shortens their paths."""
        return tuple(sorted(hash(flight.convoy.names) for flight in self._flights))

    def _adopt(self, now: float) -> None:
        """Begin the transition that was asked for, if nothing has changed that it was planned for."""
        if self._asked is None or not self._asked[1].done():
            return
        (request, future), self._asked = self._asked, None
        goals = {name: self._goal(name, place) for name, place in self._resting.items()}
        unchanged = (
            request.resting == self._resting
            and all(_same(request.goals.get(name, self._resting[name]), goal) for name, goal in goals.items())
            and request.obstacles == self._obstacles()
            and set(self._under_way()) <= set(request.flights)
        )
        if not unchanged:
            return
        plan = future.result()
        known = {flight.convoy.names for flight in self._flights}
        self._held = dict(plan.held)
        for convoy in plan.convoys:
            if convoy.names in known or not set(convoy.names) <= self._resting.keys() or convoy.duration_s == 0.0:
                continue
            wanted = {name: self._fleet[name].goal for name in convoy.names}
            self._flights.append(_Flight(convoy, now, wanted))
            for name in convoy.names:
                del self._resting[name]


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

"""Aerodrome control: whose turn it is to take off or land, and where those wait whose turn has not come."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from jpap_ros.fleet.sequencing import landing_waves, takeoff_waves
from jpap_ros.fleet.traffic import TrafficControl, Vector

#: An autopilot ends a climb within this of the height that it was told [m].
CLIMB_TOLERANCE_M = 1.0
#: An aircraft hovers above its home if it is this near to it, horizontally [m].
ABOVE_HOME_M = 2.0


@dataclass(eq=False)
class Turn:
    """One aircraft's place in the order of take-offs or landings.

    Attributes
    ----------
    name : str
    pad : (east, north, up)
        Where it stands, or will land [m].
    altitude_m : float or None
        z that it climbs to, or waits at until it may land [m]; None: no height is left yet.
    after : tuple of Turn
        Neighbours that climb first.
    over : bool
        It has climbed, landed, or given up.
    """

    name: str
    pad: Vector
    altitude_m: float | None
    after: tuple[Turn, ...] = ()
    over: bool = False


@dataclass(frozen=True)
class Hindrance:
    """Why an aircraft may not climb or land yet.

    Attributes
    ----------
    words : str
    passes : bool
        It takes off or lands itself, and that ends by itself; otherwise nobody knows when it goes away.
    """

    words: str
    passes: bool = False


class Tower:
    """Gives out turns, and the column of air that a climb or a landing needs.

    Parameters
    ----------
    traffic : TrafficControl
        Knows who is in the air, and keeps others out of a column that is in use.
    takeoff_height_m : float
        Least height to climb to, above the pad [m].
    top_m : float
        Highest altitude for those that climb first or wait for their landing [m].

    Notes
    -----
    Who waits on the ground closes nothing, a column is taken whole or not at all, and one who waits to land is never in
    the way of one that is lower: so no two wait for each other.
    """

    def __init__(self, traffic: TrafficControl, takeoff_height_m: float, top_m: float) -> None:
        self._traffic = traffic
        self._takeoff_height_m = takeoff_height_m
        self._top_m = top_m
        self._departures: list[Turn] = []
        self._arrivals: list[Turn] = []
        self._landings: list[Turn] = []

    @property
    def _separation_m(self) -> float:
        return self._traffic.limits.planned_separation_m + CLIMB_TOLERANCE_M

    def departures(self, pads: Mapping[str, Vector]) -> dict[str, Turn]:
        """Give turns to aircraft that are to take off together: of those close together the first climbs highest."""
        waves = takeoff_waves(pads, self._takeoff_height_m, self._separation_m, self._top_m)
        given: list[Turn] = []
        # Those for which no height is left come last, as low as may be, when the others have flown away.
        last = {name: pads[name][2] + self._takeoff_height_m for name in waves.held}
        for wave in (*waves.waves, *({name: altitude} for name, altitude in last.items())):
            given += [
                Turn(name, pads[name], altitude, self._before(pads[name], given)) for name, altitude in wave.items()
            ]
        self._departures += given
        return {turn.name: turn for turn in given}

    def climb_m(self, turn: Turn) -> float:
        """How high an aircraft climbs above its pad [m]."""
        return self._takeoff_height_m if turn.altitude_m is None else turn.altitude_m - turn.pad[2]

    def arrivals(self, fleet: Mapping[str, tuple[Vector, Vector]]) -> dict[str, Turn]:
        """Give turns to aircraft that are to come home, each with where it is and its home.

        Where homes are close together the nearest to its home waits lowest. One that hovers above its home, or is
        lower than aircraft usually wait, keeps its height: to climb first it would have to pass the others.
        """
        away_m = {name: math.dist(here[:2], home[:2]) for name, (here, home) in fleet.items()}
        given = {name: Turn(name, fleet[name][1], None) for name in sorted(fleet, key=lambda name: away_m[name])}
        above = {name for name in fleet if away_m[name] <= ABOVE_HOME_M}
        for name in above:
            given[name].altitude_m = fleet[name][0][2]
        for name in sorted(fleet.keys() - above, key=lambda name: fleet[name][0][2]):
            here, home = fleet[name]
            place = (*home[:2], here[2])
            taken = self._waiting_places((*self._arrivals, *given.values())).values()
            low = here[2] < home[2] + self._waiting_height_m
            if low and all(math.dist(place, other) >= self._separation_m for other in taken):
                given[name].altitude_m = here[2]
        self._arrivals += given.values()
        self._stack([turn for turn in given.values() if turn.altitude_m is None])
        return given

    def landing(self, name: str, ground: Vector) -> Turn:
        """Give a turn to an aircraft that is to land where it is, on the ground below it."""
        turn = Turn(name, ground, None)
        self._landings.append(turn)
        return turn

    def waiting_place(self, turn: Turn) -> Vector | None:
        """Where an aircraft that comes home waits until it may land; None: where it is, no height is left."""
        if turn.altitude_m is None:
            self._stack([turn])
        return None if turn.altitude_m is None else (turn.pad[0], turn.pad[1], turn.altitude_m)

    def may_climb(self, turn: Turn, now: float) -> Hindrance | None:
        """Who is in the way of a take-off; None: the column is its own from now on, until it leaves."""
        first = next((other.name for other in turn.after if not other.over), None)
        if first is not None:
            return Hindrance(f"{first} climbs first", passes=True)
        return self._claim(turn.name, (*turn.pad[:2], turn.pad[2] + self.climb_m(turn)), turn.pad[2], now)

    def may_land(self, turn: Turn, here: Vector, now: float) -> Hindrance | None:
        """Who is in the way of a landing from here straight down; None: the column is its own until it leaves."""
        return self._claim(turn.name, here, min(turn.pad[2], here[2]), now)

    def leave(self, turn: Turn) -> None:
        """Take back a turn: it is in the air, or on the ground, or has given up; the next one's turn comes."""
        turn.over = True
        for turns in (self._departures, self._arrivals, self._landings):
            if turn in turns:
                turns.remove(turn)
        if turn.name in self._traffic.columns:
            self._traffic.release(turn.name)

    def _claim(self, name: str, top: Vector, bottom_m: float, now: float) -> Hindrance | None:
        other = self._traffic.claim(name, top, bottom_m, now)
        if not other:
            return None
        passes = other in self._traffic.columns or any(turn.name == other for turn in self._landings)
        return Hindrance("it is not at rest yet" if other == name else f"{other} is in the column", passes)

    def _before(self, pad: Vector, given: list[Turn]) -> tuple[Turn, ...]:
        return tuple(
            other for other in (*self._departures, *given) if math.dist(pad[:2], other.pad[:2]) < self._separation_m
        )

    @property
    def _waiting_height_m(self) -> float:
        """Least height above home at which arrivals wait [m]."""
        return max(self._takeoff_height_m, self._traffic.limits.min_altitude_m)

    def _waiting_places(self, turns: Iterable[Turn]) -> dict[str, Vector]:
        return {turn.name: (*turn.pad[:2], turn.altitude_m) for turn in turns if turn.altitude_m is not None}

    def _stack(self, turns: Sequence[Turn]) -> None:
        """Give waiting heights, as far as there are any, above those that were given before."""
        homes = {turn.name: turn.pad for turn in turns}
        waiting = self._waiting_places(self._arrivals)
        waves = landing_waves(homes, self._waiting_height_m, self._separation_m, self._top_m, waiting)
        for turn in turns:
            turn.altitude_m = waves.altitude_m.get(turn.name)

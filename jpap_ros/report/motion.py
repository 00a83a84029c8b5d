"""How far aircraft flew and how near they came to each other."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from jpap_ros.report.flight import Flight, Floats, Track

#: A step shorter than this is taken for noise of the position, not for flight [m].
LEAST_STEP_M = 1.0


@dataclass(frozen=True)
class Separation:
    """Least distance between any two aircraft in the air.

    Attributes
    ----------
    moments : (T - 1,) ndarray
        Ends of the spans between moments of the grid [s].
    least_m : (T - 1,) ndarray
        Within each span [m]; NaN where fewer than two were in the air.
    ever_m : float
        Least of all [m]; infinite if never two were in the air.
    pair : tuple of str
        Who came so near; empty if nobody did.
    at_s : float
        When [s].
    """

    moments: Floats
    least_m: Floats
    ever_m: float
    pair: tuple[str, ...]
    at_s: float


def steps(track: Track) -> list[tuple[float, float]]:
    """Return when a track went on, and by how many metres: from point to point at least `LEAST_STEP_M` apart."""
    found: list[tuple[float, float]] = []
    last: tuple[float, ...] | None = None
    for at_s, point in zip(track.times, map(tuple, track.places.tolist()), strict=True):
        if last is None:
            last = point
        elif (step := math.dist(last, point)) >= LEAST_STEP_M:
            found.append((at_s, step))
            last = point
    return found


def metres_flown(track: Track) -> float:
    """Length of a track [m]."""
    return sum(step for _, step in steps(track))


def metres_by_plan(flight: Flight) -> list[float]:
    """Return the metres that all aircraft flew while each plan was in force."""
    begins = np.array([plan.at_s for plan in flight.plans])
    totals = np.zeros(len(flight.plans))
    for track in flight.tracks.values():
        for at_s, step in steps(track):
            if (index := int(np.searchsorted(begins, at_s, side="right")) - 1) >= 0:
                totals[index] += step
    return [float(total) for total in totals]


def separation(flight: Flight, grid: Floats) -> Separation:
    """Least distances over the spans of a grid; between its moments aircraft are taken to fly straight on."""
    names = list(flight.tracks)
    places = np.array([flight.tracks[name].positions(grid) for name in names]).reshape(len(names), len(grid), 3)
    flying = np.array([flight.tracks[name].airborne(grid) for name in names]).reshape(len(names), len(grid))
    least = np.full(max(0, len(grid) - 1), math.nan)
    ever_m, when = math.inf, math.nan
    pair: tuple[str, ...] = ()
    for k, (before, after) in enumerate(pairwise(range(len(grid)))):
        here = np.flatnonzero(flying[:, before] & flying[:, after])
        if len(here) < 2:
            continue
        first, second = np.triu_indices(len(here), 1)
        gap = places[here[first], before] - places[here[second], before]
        closing = places[here[first], after] - places[here[second], after] - gap
        # Nearest point of the segment that the difference of the two positions runs along.
        length2 = np.maximum(np.sum(closing**2, axis=1), 1e-12)
        share = np.clip(-np.sum(gap * closing, axis=1) / length2, 0.0, 1.0)
        distance = np.linalg.norm(gap + share[:, None] * closing, axis=1)
        nearest = int(np.argmin(distance))
        least[k] = distance[nearest]
        if distance[nearest] < ever_m:
            ever_m, when = float(distance[nearest]), float(grid[before])
            pair = (names[here[first[nearest]]], names[here[second[nearest]]])
    return Separation(grid[1:], least, ever_m, pair, when)

"""Whose turn it is to take off, and how high it climbs, where homes are close together."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from jpap_ros.fleet.sequencing import takeoff_waves
from jpap_ros.fleet.traffic import TrafficControl

Place = tuple[float, float]


class Departures:
    """The queue of those that were told to take off.

    Parameters
    ----------
    traffic : TrafficControl
        Knows who is in the air and where they are going.
    height_m : float
        Least height to climb to, above home [m].

    Notes
    -----
    Heights are above home; homes so close that it matters stand on about the same ground.
    """

    def __init__(self, traffic: TrafficControl, height_m: float) -> None:
        self._traffic = traffic
        self._height_m = height_m
        self._homes: dict[str, Place] = {}
        self._heights: dict[str, float] = {}

    def enlist(self, homes: Mapping[str, Place]) -> None:
        """Put some into the queue together: of those close together, the first climbs highest."""
        limits = self._traffic.limits
        low, high = min(limits.min_altitude_m, self._height_m), max(limits.max_altitude_m, self._height_m)
        waves = takeoff_waves(homes, self._height_m, replace(limits, min_altitude_m=low, max_altitude_m=high))
        for name, home in homes.items():
            self.leave(name)
            self._homes[name] = home
            self._heights[name] = waves.altitude_m.get(name, self._height_m)

    def leave(self, name: str) -> None:
        """Take one out that is in the air, or has failed; the next one's turn comes."""
        self._homes.pop(name, None)
        self._heights.pop(name, None)

    def height_m(self, name: str) -> float:
        """How high one climbs, above home [m]."""
        return self._heights.get(name, self._height_m)

    def hindrance(self, name: str, home: Place, now: float) -> str:
        """Who has to be in the air, or out of the way, before this one may climb; empty when its turn has come."""
        if name not in self._homes:
            self.enlist({name: home})
        for other, place in self._homes.items():
            if other == name:
                break
            if math.dist(home, place) < self._traffic.limits.planned_separation_m:
                return other
        column = np.array([[*home, 0.0], [*home, self.height_m(name)]])
        return self._traffic.nearby(name, column, now)

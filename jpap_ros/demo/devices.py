"""The shipped real input: users of Melbourne's central business district, with demands drawn from a stated seed."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jpap_ros.mavlink.geodesy import LocalFrame


@dataclass(frozen=True)
class Site:
    """A device as the demo reports it.

    Attributes
    ----------
    id : str
    east_m, north_m : float
        [m], map frame.
    rate_demand : float
        [bit/s] at the planner's default bandwidth of 1 Hz.
    weight : float
        Priority.
    """

    id: str
    east_m: float
    north_m: float
    rate_demand: float
    weight: float = 1.0


class SiteSource:
    """Draws users of the EUA data set, each once.

    Parameters
    ----------
    path : Path
        CSV with the columns Latitude and Longitude.
    frame : LocalFrame
        Where the map lies.
    seed : int
        The same seed gives the same devices.
    """

    def __init__(self, path: Path, frame: LocalFrame, seed: int) -> None:
        with path.open(newline="", encoding="utf-8") as file:
            self._users = [frame.to_map(float(r["Latitude"]), float(r["Longitude"])) for r in csv.DictReader(file)]
        self._rng = np.random.default_rng(seed)
        self._left = list(self._rng.permutation(len(self._users)))

    def draw(self, count: int, demand: tuple[float, float]) -> list[Site]:
        """Take users that are left, with demands uniform between two bounds [bit/s/Hz]; ValueError if too few are."""
        if count > len(self._left):
            raise ValueError(
                f"{count} devices were asked for, of {len(self._users)} users only {len(self._left)} are left"
            )
        chosen, self._left = self._left[:count], self._left[count:]
        demands = self._rng.uniform(*demand, size=count)
        return [
            Site(f"user{index:03d}", *self._users[index], rate_demand=round(float(rate), 3))
            for index, rate in zip(chosen, demands, strict=True)
        ]

"""A larger total rate by re-partitioning a few neighbouring cells at a time, each time to the optimum."""

from __future__ import annotations

import time

import numpy as np

from jpap_ros.planning.link_budget import Floats
from jpap_ros.planning.optimal.enumeration import TooManySets, all_sets
from jpap_ros.planning.optimal.partition import RateProgram
from jpap_ros.planning.optimal.position import Hover
from jpap_ros.planning.optimal.servability import Ints, Servability

_FIRST_GROUP = 6
_MOST_SETS = 4000
_MOST_TIME_S = 2.0
_GAIN = 1e-3


def improve_rate(
    servability: Servability, cells: list[Ints], hover: Hover, power_eta: float, deadline: float, seed: int
) -> tuple[list[Ints], Floats]:
    """Re-partition groups of neighbouring cells into as many cells of a larger total rate.

    Stops at the deadline, or when the group of no cell can be improved.

    Returns
    -------
    cells : list of int arrays
    positions : (N, 2) float
        [m]
    """
    random = np.random.default_rng(seed)
    cells, positions, rates = list(cells), hover.position.copy(), hover.rate.copy()
    size = np.full(len(cells), min(_FIRST_GROUP, len(cells)))
    fresh = np.ones(len(cells), dtype=bool)
    while fresh.any() and time.monotonic() < deadline:
        first = int(random.choice(np.flatnonzero(fresh)))
        fresh[first] = False
        while size[first] >= 2 and time.monotonic() < deadline:
            group = np.argsort(((positions - positions[first]) ** 2).sum(axis=1))[: size[first]]
            devices = np.concatenate([cells[i] for i in group])
            part = servability.subset(devices)
            until = min(deadline, time.monotonic() + _MOST_TIME_S)
            try:
                members, sets = all_sets(part, _MOST_SETS, until)
            except TooManySets:
                size[first] -= 1
                continue
            local = {int(k): i for i, k in enumerate(devices)}
            start = [np.array([local[int(k)] for k in cells[i]]) for i in group]
            better = RateProgram(part, members, sets, power_eta).solve(len(group), start, until)
            if better is not None and better.total_rate > rates[group].sum() + _GAIN:
                for i, cell, position, rate in zip(group, better.cells, better.positions, better.rates, strict=True):
                    cells[i], positions[i], rates[i] = devices[cell], position, rate
                fresh[group] = True
            break
    return cells, positions

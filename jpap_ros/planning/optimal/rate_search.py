"""A larger total rate by re-partitioning a few neighbouring cells at a time.

Where the servable sets of a group can be enumerated it is solved to its optimum; where even two cells have too many,
devices are moved between them, one at a time or one for one.
"""

from __future__ import annotations

import time

import numpy as np

from jpap_ros.planning.optimal.enumeration import TooManySets, all_sets
from jpap_ros.planning.optimal.partition import Partition, RateProgram
from jpap_ros.planning.optimal.position import best_positions
from jpap_ros.planning.optimal.servability import TOLERANCE, Bools, Ints, Servability

_FIRST_GROUP = 6
_MOST_SETS = 4000
_MOST_TIME_S = 2.0
_GAIN = 1e-3
#: Neighbours with which a cell exchanges devices, and moves of the best estimates that are examined.
_PARTNERS = 4
_LOOKED_AT = 6


class RateSearch:
    """Cells, their positions and rates, and the moves that improve them."""

    def __init__(self, servability: Servability, cells: list[Ints], power_eta: float) -> None:
        self.servability, self.power_eta = servability, power_eta
        self.cells = list(cells)
        hover = best_positions(servability, cells, servability.measure_all(cells), power_eta)
        self.positions, self.rates = hover.position, hover.rate

    def run(self, deadline: float, seed: int) -> Partition:
        """Improve until the deadline, or until no group of neighbours can be improved."""
        random = np.random.default_rng(seed)
        count = len(self.cells)
        size = np.full(count, min(_FIRST_GROUP, count))
        fresh: Bools = np.ones(count, dtype=bool)
        while fresh.any() and time.monotonic() < deadline:
            first = int(random.choice(np.flatnonzero(fresh)))
            fresh[first] = False
            near = np.argsort(((self.positions - self.positions[first]) ** 2).sum(axis=1))
            improved: Ints | None = None
            while size[first] >= 2 and time.monotonic() < deadline:
                try:
                    improved = self._optimise(near[: size[first]], deadline)
                    break
                except TooManySets:
                    size[first] -= 1
            if size[first] < 2:
                improved = self._exchange_with_neighbours(near[: _PARTNERS + 1], deadline)
            if improved is not None:
                fresh[improved] = True
        return Partition(self.cells, self.positions, self.rates, np.inf)

    def _optimise(self, group: Ints, deadline: float) -> Ints | None:
        """Re-partition a group to its optimum; the group if that is better."""
        devices = np.concatenate([self.cells[i] for i in group])
        part = self.servability.subset(devices)
        until = min(deadline, time.monotonic() + _MOST_TIME_S)
        members, sets = all_sets(part, _MOST_SETS, until)
        ends = np.cumsum([len(self.cells[i]) for i in group])
        start = np.split(np.arange(len(devices)), ends[:-1])
        better = RateProgram(part, members, sets, self.power_eta).solve(len(group), start, until)
        if better is None or better.total_rate <= self.rates[group].sum() + _GAIN:
            return None
        for i, cell, position, rate in zip(group, better.cells, better.positions, better.rates, strict=True):
            self.cells[i], self.positions[i], self.rates[i] = devices[cell], position, rate
        return group

    def _exchange_with_neighbours(self, near: Ints, deadline: float) -> Ints | None:
        """Best exchanges of the first cell with each of the others, one after the other; the cells that changed."""
        changed: list[int] = []
        for other in near[1:].tolist():
            while time.monotonic() < deadline and self._exchange(int(near[0]), other):
                changed += [int(near[0]), other]
        return np.unique(changed) if changed else None

    def _exchange(self, one: int, two: int) -> bool:
        """The move of one device, or swap of two, between two cells that gains the most; False if none gains."""
        a, b = self.cells[one], self.cells[two]
        pairs = [(np.setdiff1d(a, [k]), np.append(b, k)) for k in a if len(a) > 1]
        pairs += [(np.append(a, k), np.setdiff1d(b, [k])) for k in b if len(b) > 1]
        pairs += [(np.append(np.setdiff1d(a, [i]), j), np.append(np.setdiff1d(b, [j]), i)) for i in a for j in b]
        limit = self.servability.cell_limit
        pairs = [pair for pair in pairs if max(map(len, pair)) <= limit]
        sets = self.servability.measure_all([cell for pair in pairs for cell in pair])
        good = np.flatnonzero((sets.load.reshape(-1, 2) <= 1 + TOLERANCE).all(axis=1))
        if not len(good):
            return False
        flat = [cell for i in good for cell in pairs[i]]
        measures = sets[np.repeat(2 * good, 2) + np.tile([0, 1], len(good))]
        quick = best_positions(self.servability, flat, measures, self.power_eta, rounds=1)
        # The quick estimates only say which moves are worth a closer look.
        likely: Ints = np.argsort(-quick.rate.reshape(-1, 2).sum(axis=1))[:_LOOKED_AT]
        chosen: Ints = (2 * likely[:, None] + np.arange(2)).ravel()
        hover = best_positions(self.servability, [flat[i] for i in chosen], measures[chosen], self.power_eta)
        total = hover.rate.reshape(-1, 2).sum(axis=1)
        best = 2 * int(total.argmax()) + np.arange(2)
        if total.max() <= self.rates[[one, two]].sum() + _GAIN:
            return False
        for i, cell, position, rate in zip(
            (one, two), chosen[best], hover.position[best], hover.rate[best], strict=True
        ):
            self.cells[i], self.positions[i], self.rates[i] = np.sort(flat[cell]), position, rate
        return True

"""Few cells by guided ejection search: a heuristic, for incumbents where enumeration is too much.

After Nagata and Bräysy, "A powerful route minimization heuristic for the vehicle routing problem with time windows",
Operations Research Letters 37 (2009). One cell is dissolved and its devices are put into the others, if need be by
ejecting one or two that were easier to place so far; feasible random moves in between keep the search moving.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from jpap_ros.planning.optimal.servability import Bools, Ints, Servability

#: Loads up to this count as servable in the search: raw moments carry rounding that the exact test does not.
_FULL = 1 - 1e-9
_MOVES_BETWEEN = 4


def fewer_cells(
    servability: Servability, cells: list[Ints], least: int, deadline: float, seed: int
) -> Iterator[list[Ints]]:
    """Yield partitions into ever fewer servable cells.

    Parameters
    ----------
    cells : list of int arrays
        A partition of the devices into servable cells to begin with.
    least : int
        Stop at this many cells: no fewer can serve the devices.
    deadline : float
        `time.monotonic()` by which to stop.
    """
    search = _Search(servability, cells, seed)
    while search.count > least and time.monotonic() < deadline:
        if not search.dissolve_one(deadline):
            return
        yield search.cells()


class _Search:
    def __init__(self, servability: Servability, cells: list[Ints], seed: int) -> None:
        self.random = np.random.default_rng(seed)
        self.limit = servability.cell_limit
        a, u = servability.demand, servability.positions - servability.positions.mean(axis=0)
        #: (K, 4) moments of each device; those of a set are their sum, and give its load.
        self.device = np.column_stack([a, a[:, None] * u, a * ((u**2).sum(axis=1) + servability.height2)])
        self.near = [np.append(row, k) for k, row in enumerate(servability.neighbours())]
        self.cell_of = np.empty(len(a), np.int64)
        for number, cell in enumerate(cells):
            self.cell_of[cell] = number
        self.moments = np.zeros((len(cells), 4))
        np.add.at(self.moments, self.cell_of, self.device)
        self.size = np.bincount(self.cell_of, minlength=len(cells))
        self.hardness = np.ones(len(a))
        self.count = len(cells)

    def cells(self) -> list[Ints]:
        """The partition."""
        order = np.argsort(self.cell_of, kind="stable")
        return np.split(order, np.flatnonzero(np.diff(self.cell_of[order])) + 1)

    def dissolve_one(self, deadline: float) -> bool:
        """Try to do with one cell fewer; False if time ran out, and the partition is then incomplete."""
        victim = int(self.random.choice(np.flatnonzero(self.size == self.size.min())))
        homeless = [int(k) for k in np.flatnonzero(self.cell_of == victim)]
        self._drop_cell(victim)
        while homeless:
            if time.monotonic() > deadline:
                return False
            device = homeless.pop()
            target = self._place_for(device)
            if target >= 0:
                self._add(device, target)
                continue
            self.hardness[device] += 1
            target, ejected = self._ejection_for(device)
            for other in ejected:
                self._remove(other)
            self._add(device, target)
            homeless += ejected
            for _ in range(_MOVES_BETWEEN):
                self._random_move()
        return True

    def _drop_cell(self, victim: int) -> None:
        last = self.count - 1
        self.cell_of[self.cell_of == victim] = -1
        self.cell_of[self.cell_of == last] = victim
        self.moments[victim], self.size[victim] = self.moments[last], self.size[last]
        self.moments, self.size = self.moments[:last], self.size[:last]
        self.count = last

    def _add(self, device: int, cell: int) -> None:
        self.cell_of[device] = cell
        self.moments[cell] += self.device[device]
        self.size[cell] += 1

    def _remove(self, device: int) -> None:
        cell = self.cell_of[device]
        self.cell_of[device] = -1
        self.moments[cell] -= self.device[device]
        self.size[cell] -= 1

    def _open_cells(self, device: int) -> Ints:
        """Cells that a device can join."""
        moments = self.moments + self.device[device]
        good = (_load(moments) <= _FULL) & (self.size < self.limit)
        if self.cell_of[device] >= 0:
            good[self.cell_of[device]] = False
        return np.flatnonzero(good)

    def _place_for(self, device: int) -> int:
        cells = self._open_cells(device)
        return int(self.random.choice(cells)) if len(cells) else -1

    def _ejection_for(self, device: int) -> tuple[int, list[int]]:
        """The cell, and the easiest one or two of its devices (all of them, if need be) to make way for a device."""
        cells = np.unique(self.cell_of[self.near[device]])
        cells = cells[cells >= 0]
        if not len(cells):
            cells = self.random.integers(self.count, size=1)
        inside = np.flatnonzero(np.isin(self.cell_of, cells))
        inside = self.random.permutation(inside)
        with_device = self.moments + self.device[device]
        # One device goes.
        left = with_device[self.cell_of[inside]] - self.device[inside]
        one = np.flatnonzero(_load(left) <= _FULL)
        best: tuple[float, int, list[int]] | None = None
        if len(one):
            k = int(inside[one[self.hardness[inside[one]].argmin()]])
            best = (float(self.hardness[k]), int(self.cell_of[k]), [k])
        # Two devices of one cell go.
        first, second = self._pairs(inside)
        cost = self.hardness[first] + self.hardness[second]
        worth = np.flatnonzero(cost < best[0]) if best else np.arange(len(first))
        first, second, cost = first[worth], second[worth], cost[worth]
        left = with_device[self.cell_of[first]] - self.device[first] - self.device[second]
        two = np.flatnonzero(_load(left) <= _FULL)
        if len(two):
            i = two[cost[two].argmin()]
            best = (float(cost[i]), int(self.cell_of[first[i]]), [int(first[i]), int(second[i])])
        if best is None:
            cell = int(self.random.choice(cells))
            return cell, [int(k) for k in np.flatnonzero(self.cell_of == cell)]
        return best[1], best[2]

    def _pairs(self, devices: Ints) -> tuple[Ints, Ints]:
        """All pairs of devices that share a cell."""
        order = devices[np.argsort(self.cell_of[devices], kind="stable")]
        end = np.searchsorted(self.cell_of[order], self.cell_of[order], side="right")
        counts = end - np.arange(len(order)) - 1
        first = np.repeat(np.arange(len(order)), counts)
        offset = np.arange(len(first)) - np.repeat(np.cumsum(counts) - counts, counts)
        return order[first], order[first + 1 + offset]

    def _random_move(self) -> None:
        """Move a random device to another cell, or swap it with one of another cell, if possible."""
        device = int(self.random.integers(len(self.cell_of)))
        home = self.cell_of[device]
        if home < 0:
            return
        cells = self._open_cells(device)
        if len(cells):
            target = int(self.random.choice(cells))
            self._remove(device)
            self._add(device, target)
            return
        others = self.near[device]
        others = others[(self.cell_of[others] >= 0) & (self.cell_of[others] != home)]
        exchange = self.device[device] - self.device[others]
        good: Bools = (_load(self.moments[home] - exchange) <= _FULL) & (
            _load(self.moments[self.cell_of[others]] + exchange) <= _FULL
        )
        if good.any():
            other = int(self.random.choice(others[good]))
            target = int(self.cell_of[other])
            self._remove(device)
            self._remove(other)
            self._add(device, target)
            self._add(other, int(home))


def _load(moments: np.ndarray) -> np.ndarray:
    """Load at the centroid from moments (..., 4); an empty set has none."""
    weight = np.maximum(moments[..., 0], 1e-300)
    load: np.ndarray = moments[..., 3] - (moments[..., 1] ** 2 + moments[..., 2] ** 2) / weight
    return load

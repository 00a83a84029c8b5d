"""The partition of the devices into a given number of cells that maximises the total rate, with a proven bound."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from jpap_ros.planning.link_budget import Floats
from jpap_ros.planning.optimal.milp import incidence, minimise
from jpap_ros.planning.optimal.position import RATE_TOLERANCE, best_positions
from jpap_ros.planning.optimal.servability import Bools, Ints, Servability, Sets

#: Prices below this count as zero [bit/s/Hz].
_PRICE_TOLERANCE = 1e-6
_REFINED_AT_A_TIME = 500
_FIRST_COLUMNS_PER_DEVICE = 8
#: The rate of a set is known once its bounds are no further apart [bit/s/Hz].
_KNOWN = 1.01 * RATE_TOLERANCE


@dataclass(frozen=True, eq=False)
class Partition:
    """Cells and where their UAVs hover.

    Attributes
    ----------
    cells : list of int arrays
        Device indices.
    positions : (N, 2) float
        [m]
    rates : (N,) float
        Rate of each UAV [bit/s/Hz].
    bound : float
        Proven upper bound on the total rate of this many cells [bit/s/Hz].
    relaxed : float
        Proven upper bound on the linear program's total rate for this many cells [bit/s/Hz]; never below `bound`.
    marginal : float
        Slope of the linear program: k more cells have a total rate of at most `relaxed + k * marginal` [bit/s/Hz].
    """

    cells: list[Ints]
    positions: Floats
    rates: Floats
    bound: float
    relaxed: float = math.inf
    marginal: float = math.inf

    @property
    def total_rate(self) -> float:
        """Sum of the rates of all UAVs [bit/s/Hz]."""
        return float(self.rates.sum())


class RateProgram:
    """Set partitioning over all servable sets: maximise the sum of R_S x_S with each device in one set, N sets.

    The rate of a set is known between two bounds, and known better only where the linear program's prices say that
    the set could matter.
    """

    def __init__(self, servability: Servability, members: list[Ints], sets: Sets, power_eta: float) -> None:
        self.servability, self.members, self.sets, self.power_eta = servability, members, sets, power_eta
        hover = best_positions(servability, members, sets, power_eta, rounds=1)
        self.position, self.rate, self.bound = hover.position, hover.rate, hover.bound
        self.with_count = sparse.csc_array(
            sparse.vstack([incidence(members, len(servability)), np.ones((1, len(members)))])
        )
        self._index = {cell.tobytes(): i for i, cell in enumerate(members)}

    def solve(
        self, uavs: int, start: list[Ints] | None, deadline: float, apart: Ints | None = None
    ) -> Partition | None:
        """Best partition into `uavs` cells found by the deadline.

        Parameters
        ----------
        start : list of int arrays, optional
            One such partition to begin with.
        apart : (n, 2) int, optional
            Pairs of the program's sets that no partition may have both of.

        Returns
        -------
        Partition or None
            None if there is no such partition, or, without a start, if none was found in time.
        """
        pairs = np.empty((0, 2), np.int64) if apart is None else apart
        best = None if start is None else np.array([self._column(cell) for cell in start])
        if best is not None:
            self._refine(best)
        relaxed, prices, marginal = self._relax(uavs, deadline)
        bound = relaxed
        # No set whose price is further below zero than the gap is part of a better partition.
        tried = np.empty(0, np.int64)
        able = tried if prices is None else np.argsort(-prices)[: _FIRST_COLUMNS_PER_DEVICE * len(self.servability)]
        proven = math.inf
        while prices is not None and time.monotonic() < deadline:
            before = self.rate[able]
            self._refine(able)
            prices[able] += self.rate[able] - before
            tried = able if best is None else np.union1d(able, best)
            chosen, proven = self._choose(uavs, tried, best, pairs, deadline)
            if chosen is not None and (best is None or self.rate[chosen].sum() > self.rate[best].sum()):
                best = chosen
            gap = math.inf if best is None else relaxed - self.rate[best].sum()
            able = np.flatnonzero(prices + self.bound - self.rate >= -gap - _PRICE_TOLERANCE)
            if not len(np.setdiff1d(able, tried)):
                bound = min(relaxed, proven + uavs * _KNOWN)
                break
        if best is None:
            return None
        cells = [self.members[i] for i in best]
        return Partition(cells, self.position[best], self.rate[best], bound, relaxed, marginal)

    def _column(self, cell: Ints) -> int:
        return self._index[np.sort(cell).tobytes()]

    def _relax(self, uavs: int, deadline: float) -> tuple[float, Floats | None, float]:
        """Linear program: bound on the total rate, price of every set (at its rate), value of a further UAV."""
        sides = np.append(np.ones(len(self.servability)), uavs)
        while time.monotonic() < deadline:
            relaxed = minimise(-self.rate, self.with_count, sides, sides, integer=False, deadline=deadline)
            if relaxed.duals is None:
                break
            value = -relaxed.duals
            worth = self.with_count.T @ value
            bound_prices = self.bound - worth
            loose = np.flatnonzero((bound_prices > RATE_TOLERANCE) & (self.bound > self.rate + _KNOWN))
            if not len(loose):
                # Every set costs at most `excess` more than its devices and its place are worth.
                excess = max(float(bound_prices.max()), 0.0)
                return float(sides @ value) + uavs * excess, self.rate - worth, float(value[-1]) + excess
            self._refine(loose[np.argsort(-bound_prices[loose])][:_REFINED_AT_A_TIME])
        return math.inf, None, math.inf

    def _choose(
        self, uavs: int, columns: Ints, start: Ints | None, pairs: Ints, deadline: float
    ) -> tuple[Ints | None, float]:
        """Mixed-integer program over some of the sets: the best partition, and its proven bound."""
        matrix = self.with_count[:, columns]
        sides = np.append(np.ones(len(self.servability)), uavs)
        place = np.full(len(self.members), -1)
        place[columns] = np.arange(len(columns))
        both = place[pairs][(place[pairs] >= 0).all(axis=1)]
        rows = np.repeat(np.arange(len(both)), 2)
        forbidden = sparse.csc_array((np.ones(both.size), (rows, both.ravel())), shape=(len(both), len(columns)))
        found = minimise(
            -self.rate[columns],
            sparse.csc_array(sparse.vstack([matrix, forbidden])),
            np.append(sides, np.zeros(len(both))),
            np.append(sides, np.ones(len(both))),
            integer=True,
            start=None if start is None else np.isin(columns, start).astype(float),
            deadline=deadline,
            gap=uavs * (2 * RATE_TOLERANCE - _KNOWN),
        )
        return None if found.x is None else columns[found.x > 0.5], -found.bound

    def _refine(self, which: Ints) -> None:
        loose: Bools = self.bound[which] > self.rate[which] + _KNOWN
        which = which[loose]
        if not len(which):
            return
        hover = best_positions(self.servability, [self.members[i] for i in which], self.sets[which], self.power_eta)
        self.position[which], self.rate[which], self.bound[which] = hover.position, hover.rate, hover.bound

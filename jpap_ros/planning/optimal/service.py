"""Which devices a fleet that is too small should serve: the most weight, then the most demanded rate.

With y_k = 1 where device k is served and x_S = 1 where the servable set S is flown:

    maximise sum w_k y_k,    y_k <= sum over S with k of x_S,    sum x_S <= N.

For any 0 <= pi_k <= w_k, if no servable set is worth more than M then sum (w_k - pi_k) + N M bounds what N UAVs
serve. The linear program over the sets known proposes pi; pricing finds M, and further sets.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from fractions import Fraction

import numpy as np
from scipy import sparse

from jpap_ros.planning.limits import exact_sum
from jpap_ros.planning.link_budget import Floats
from jpap_ros.planning.optimal.cover import without_overlap
from jpap_ros.planning.optimal.milp import incidence, minimise
from jpap_ros.planning.optimal.pricing import price
from jpap_ros.planning.optimal.servability import Ints, Servability

#: Weights smaller than this part of the largest undecided one are told apart by a program of their own.
_TIER = 1e-4
#: Part of the largest weight of its tier that a program's sums may be wrong by.
_ROUNDING = 1e-7
#: Taken for rounding where weights are whole, and so is what is served.
_WHOLE = 1e-6
#: Sets that a mixed-integer program can still do something with.
_MOST_COLUMNS = 60_000
#: New sets that pricing adds at a time.
_NEW_SETS = 300


class Service:
    """The devices and what serving each is worth.

    Parameters
    ----------
    servability : Servability
    weights, rates : (K,) float
        Priorities, and demands that decide between equals.
    uavs : int
        Size of the fleet, at least 1.
    """

    def __init__(self, servability: Servability, weights: Floats, rates: Floats, uavs: int) -> None:
        self.servability, self.weights, self.rates, self.uavs = servability, weights, rates, uavs
        #: No fleet of this size serves more weight.
        self.bound = math.fsum(weights)

    def value(self, cells: list[Ints]) -> tuple[Fraction, Fraction]:
        """Weight served, then demanded rate; exact, so that a small weight counts beside a large one."""
        served = np.concatenate([np.empty(0, np.int64), *cells])
        return exact_sum(self.weights[served]), exact_sum(self.rates[served])

    def best_of(self, cells: list[Ints]) -> list[Ints]:
        """The cells of the fleet that serve the most; of disjoint ones no other choice serves more."""
        return sorted(cells, key=lambda cell: self.value([cell]), reverse=True)[: self.uavs]

    def fill(self, cells: list[Ints]) -> list[Ints]:
        """Take in whoever else can be served, those of the most weight first."""
        cells = list(cells)
        left = np.setdiff1d(np.arange(len(self.weights)), np.concatenate([np.empty(0, np.int64), *cells]))
        for k in left[np.lexsort((self.rates[left], -self.weights[left]))]:
            if len(cells) < self.uavs:
                cells.append(np.array([k]))
                continue
            sets, device = self.servability.measure_all(cells), np.full(len(cells), k)
            room = np.array([len(cell) < self.servability.cell_limit for cell in cells], dtype=bool)
            able = np.flatnonzero(self.servability.fits(sets, device) & room)
            if len(able):
                uav = able[self.servability.joined(sets, device).load[able].argmin()]
                cells[uav] = np.sort(np.append(cells[uav], k))
        return cells

    def greedy(self, deadline: float) -> tuple[list[Ints], list[Ints]]:
        """The set worth most of those that pricing finds, then the next for who is left; and all sets found."""
        left = self.weights.copy()
        cells: list[Ints] = []
        pool: list[Ints] = []
        for _ in range(self.uavs):
            if not left.any() or time.monotonic() > deadline:
                break
            found = price(self.servability, left / left.max(), deadline, exact=False)
            if not cells:
                self._prove(self.uavs * found.bound * float(left.max()))
            pool += found.sets
            best = found.sets[int(found.worth.argmax())]
            cells.append(best)
            left[best] = 0
        return without_overlap(cells, len(left)), pool

    def choose(
        self,
        members: list[Ints],
        start: list[Ints],
        deadline: float,
        apart: Ints | None = None,
        complete: bool = False,
    ) -> list[Ints] | None:
        """At most `uavs` disjoint cells, each part of one of the sets, that serve the most.

        Weights of one size are decided by one program, smaller ones by the next, and last the demanded rate.

        Parameters
        ----------
        members : list of int arrays
            Servable sets.
        start : list of int arrays
            Disjoint cells to begin with; none for no start.
        deadline : float
            `time.monotonic()` by which to return.
        apart : (n, 2) int, optional
            Pairs of the sets of which no fleet may have both; the cells are then whole sets.
        complete : bool
            Whether all maximal sets, with `apart` all sets, are among the members: the program then proves a bound.

        Returns
        -------
        list of int arrays or None
            None where nothing was found in time.
        """
        members = [*members, *start]
        count, sets = len(self.weights), len(members)
        rows, lower, upper = self._limits(members, apart)
        point = None
        if start:
            point = np.zeros(sets + count)
            point[sets - len(start) : sets] = 1
            point[sets + np.concatenate(start)] = 1
        undecided = self.weights.copy()
        first = True
        while True:
            last = not undecided.any()
            wanted = self.rates if last else undecided
            gain = wanted / wanted.max()
            found = minimise(
                np.concatenate([np.zeros(sets), -gain]), rows, lower, upper,
                integer=True, start=point, deadline=deadline,
            )  # fmt: skip
            if complete and first:
                self._prove(-found.bound * float(wanted.max()))
            first = False
            point = point if found.x is None else np.rint(found.x)
            if last or found.x is None or time.monotonic() > deadline:
                break
            tier = gain >= _TIER
            decided = np.concatenate([np.zeros(sets), np.where(tier, gain, 0.0)])
            rows = sparse.csc_array(sparse.vstack([rows, decided[None]]))
            lower, upper = np.append(lower, decided @ point - _ROUNDING), np.append(upper, np.inf)
            undecided[tier] = 0
        if point is None:
            return None
        return without_overlap([members[i] for i in np.flatnonzero(point[:sets] > 0.5)], count)

    def improve(self, best: list[Ints], pool: list[Ints], every: list[Ints] | None, deadline: float) -> list[Ints]:
        """Better cells than these, and a bound, by column generation and a program over the sets that can matter.

        Parameters
        ----------
        best : list of int arrays
            Disjoint cells, as many as there are UAVs.
        pool : list of int arrays
            Servable sets to begin with.
        every : list of int arrays or None
            All maximal ones; None where they are too many.
        """
        began = time.monotonic()
        until = began + 0.6 * (deadline - began)
        if every is None:
            pool, _ = self._generate(pool, lambda value: self._priced(value, until), until)
            return self.choose(pool, best, deadline) or best
        matrix = incidence(every, len(self.weights))

        def all_priced(value: Floats) -> tuple[list[Ints], Floats, float]:
            worth = matrix.T @ value
            order = np.argsort(-worth)[:_NEW_SETS]
            return [every[i] for i in order], worth[order], float(worth.max())

        pool, value = self._generate(pool, all_priced, until)
        # No fleet that serves more than this one has a set that is worth less than the most by the gap.
        worth, scale = matrix.T @ value, float(self.weights.max())
        bound = math.fsum(self.weights / scale - value) + self.uavs * float(worth.max())
        gap = bound - float(self.value(best)[0]) / scale
        able = np.flatnonzero(worth >= worth.max() - gap - _ROUNDING)
        if len(able) > _MOST_COLUMNS:
            return self.choose(pool, best, deadline) or best
        return self.choose([every[i] for i in able], best, deadline, complete=True) or best

    def _priced(self, value: Floats, deadline: float) -> tuple[list[Ints], Floats, float]:
        # Pricing expects sets to be worth about one.
        unit = max(float(value.max()), 1e-9)
        found = price(self.servability, value / unit, deadline, exact=True)
        return found.sets, found.worth * unit, found.bound * unit

    def _generate(
        self, pool: list[Ints], best_sets: Callable[[Floats], tuple[list[Ints], Floats, float]], deadline: float
    ) -> tuple[list[Ints], Floats]:
        """Add sets to the pool, and lower the bound, by column generation.

        Parameters
        ----------
        best_sets : callable
            Of the values of the devices: sets of the largest worth, their worth, and a bound on any set's.

        Returns
        -------
        list of int arrays
            The pool.
        (K,) float
            The values, as parts of the largest weight, that give the best bound.
        """
        count, scale = len(self.weights), float(self.weights.max())
        worth = self.weights / scale
        known = {members.tobytes(): members for members in (np.sort(members) for members in pool)}
        least, at_least = math.inf, np.zeros(count)
        while time.monotonic() < deadline:
            cost = np.concatenate([np.zeros(len(known)), -worth])
            relaxed = minimise(cost, *self._limits(list(known.values())), integer=False, deadline=deadline)
            if relaxed.duals is None:
                break
            value = np.clip(relaxed.duals[:count], 0.0, worth)
            place = max(-float(relaxed.duals[count]), 0.0)
            sets, gain, most = best_sets(value)
            bound = math.fsum(worth - value) + self.uavs * most
            self._prove(bound * scale)
            if bound < least:
                least, at_least = bound, value
            before = len(known)
            fresh = [i for i in np.argsort(-gain)[:_NEW_SETS] if gain[i] > place + _ROUNDING]
            known.update((sets[i].tobytes(), sets[i]) for i in fresh)
            if len(known) == before:
                break
        return list(known.values()), at_least

    def _limits(self, members: list[Ints], apart: Ints | None = None) -> tuple[sparse.csc_array, Floats, Floats]:
        """Rows of the programs, and their limits. Columns: the sets, then the devices."""
        count, sets = len(self.weights), len(members)
        pairs = np.empty((0, 2), np.int64) if apart is None else apart
        row = np.repeat(np.arange(len(pairs)), 2)
        rows = [
            # A device is served only if one of its sets is flown.
            sparse.hstack([incidence(members, count), -sparse.eye_array(count)]),
            np.concatenate([np.ones(sets), np.zeros(count)])[None],
            # However many of its sets are: linear programs have no upper bounds of their own.
            sparse.hstack([sparse.csc_array((count, sets)), sparse.eye_array(count)]),
            sparse.csc_array((np.ones(pairs.size), (row, pairs.ravel())), shape=(len(pairs), sets + count)),
        ]
        free = np.inf if apart is None else 0.0
        lower = np.zeros(2 * count + 1 + len(pairs))
        upper = np.concatenate([np.full(count, free), [self.uavs], np.ones(count + len(pairs))])
        return sparse.csc_array(sparse.vstack(rows)), lower, upper

    def _prove(self, bound: float) -> None:
        bound += _ROUNDING * float(self.weights.max())
        if (self.weights == np.rint(self.weights)).all():
            bound = float(math.floor(bound + _WHOLE)) if math.isfinite(bound) else bound
        self.bound = min(self.bound, bound)

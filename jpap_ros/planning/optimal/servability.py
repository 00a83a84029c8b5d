"""Which sets of devices one UAV can serve: the exact test in closed form, and its O(1) update.

A UAV at v serves the set S if and only if the powers that just meet the demands sum to at most P_T, that is

    f(S, v) = sum over S of a_k (|v - u_k|^2 + H^2) <= 1,    a_k = (2^r_k - 1) / (P_T eta).

f is least at the a-weighted centroid c, so S is servable if and only if f(S, c) <= 1; and then v serves S exactly
within the disc of radius sqrt((1 - f(S, c)) / sum a) around c.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from jpap_ros.planning.link_budget import Floats
from jpap_ros.planning.solver import Problem

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

#: f may exceed 1 by this much: rounding of double precision, a thousandth of what `Deployment.violations` forgives.
TOLERANCE = 1e-12
#: Devices whose neighbours are looked for at a time; bounds the memory.
_BLOCK = 512


@dataclass(frozen=True, eq=False)
class Sets:
    """Many sets of devices, with what the servability test needs of each.

    Attributes
    ----------
    weight : (n,) float
        Sum of a_k [1/m^2].
    centroid : (n, 2) float
        a-weighted centroid [m]: the position that needs the least power.
    load : (n,) float
        f at the centroid: the least share of P_T that serves the set.
    """

    weight: Floats
    centroid: Floats
    load: Floats

    def __getitem__(self, index: Ints | Bools | slice) -> Sets:
        return Sets(self.weight[index], self.centroid[index], self.load[index])

    @property
    def slack_radius(self) -> Floats:
        """Radius of the disc around the centroid from which the set can be served [m], (n,)."""
        radius: Floats = np.sqrt(np.maximum(1 - self.load, 0) / self.weight)
        return radius


@dataclass(frozen=True, eq=False)
class Servability:
    """The devices, scaled so that one UAV's power is 1.

    Attributes
    ----------
    positions : (K, 2) float
        Device positions [m].
    demand : (K,) float
        a_k = (2^r_k - 1) / (P_T eta) [1/m^2].
    height2 : float
        H^2 [m^2].
    cell_limit : int
        Most devices in one cell.
    """

    positions: Floats
    demand: Floats
    height2: float
    cell_limit: int

    @classmethod
    def of(cls, problem: Problem) -> Servability:
        """The servability of a problem's devices."""
        link = problem.link
        return cls(problem.positions, problem.snr_demand / link.power_eta, link.altitude_m**2, problem.cell_limit)

    def subset(self, devices: Ints) -> Servability:
        """The servability of some of the devices, numbered in the order given."""
        return Servability(self.positions[devices], self.demand[devices], self.height2, self.cell_limit)

    def __len__(self) -> int:
        return len(self.demand)

    def singles(self) -> Sets:
        """Every device by itself, (K,)."""
        return Sets(self.demand, self.positions, self.demand * self.height2)

    def joined(self, sets: Sets, device: Ints) -> Sets:
        """Each set with one more device, by the parallel-axis theorem; free of cancellation."""
        a, u = self.demand[device], self.positions[device]
        weight = sets.weight + a
        away = u - sets.centroid
        load = sets.load + a * self.height2 + sets.weight * a / weight * (away**2).sum(axis=-1)
        return Sets(weight, sets.centroid + (a / weight)[..., None] * away, load)

    def fits(self, sets: Sets, device: Ints) -> Bools:
        """Whether each set stays servable when one device joins (cell limit aside)."""
        a = self.demand[device]
        d2 = ((self.positions[device] - sets.centroid) ** 2).sum(axis=-1)
        load = sets.load + a * self.height2 + sets.weight * a / (sets.weight + a) * d2
        good: Bools = load <= 1 + TOLERANCE
        return good

    def measure(self, members: ArrayLike) -> Sets:
        """One set of devices, given by index, as `Sets` of length 1."""
        index = np.asarray(members, dtype=np.int64)
        a, u = self.demand[index], self.positions[index]
        weight = a.sum()
        centre = (a[:, None] * u).sum(axis=0) / weight
        load = (a * (((u - centre) ** 2).sum(axis=1) + self.height2)).sum()
        return Sets(np.array([weight]), centre[None], np.array([load]))

    def measure_all(self, cells: Sequence[ArrayLike]) -> Sets:
        """Each of several sets of devices."""
        parts = [self.measure(cell) for cell in cells]
        return Sets(
            np.array([part.weight[0] for part in parts]),
            np.array([part.centroid[0] for part in parts]).reshape(-1, 2),
            np.array([part.load[0] for part in parts]),
        )

    def servable(self, members: ArrayLike) -> bool:
        """Whether one UAV can serve this set."""
        index = np.asarray(members, dtype=np.int64)
        return len(index) <= self.cell_limit and bool(self.measure(index).load[0] <= 1 + TOLERANCE)

    def neighbours(self) -> list[Ints]:
        """For each device the others that can share a cell with it: a servable set is a clique of this relation."""
        return self._neighbours

    @cached_property
    def _neighbours(self) -> list[Ints]:
        count = len(self)
        if self.cell_limit < 2 or count < 2:
            return [np.empty(0, np.int64)] * count
        first, second = (np.concatenate(part) for part in zip(*self._pairs(), strict=True))
        source, other = np.concatenate([first, second]), np.concatenate([second, first])
        other = other[np.lexsort((other, source))]
        # Shared by all who ask.
        other.flags.writeable = False
        return np.split(other, np.cumsum(np.bincount(source, minlength=count))[:-1])

    def _pairs(self) -> Iterator[tuple[Ints, Ints]]:
        """All pairs that can share a cell, each once, in blocks.

        f of a pair d apart is (a + b) H^2 + a b / (a + b) d^2. For b >= a it grows with b, so the device of less
        demand has all its partners of more within the distance at which f(a, a) = 1.
        """
        a, singles, tree = self.demand, self.singles(), cKDTree(self.positions)
        reach = np.sqrt(np.maximum(1 + 2 * TOLERANCE - 2 * a * self.height2, 0) * 2 / a) * (1 + 1e-9)
        for start in range(0, len(self), _BLOCK):
            rows = np.arange(start, min(start + _BLOCK, len(self)))
            near = tree.query_ball_point(self.positions[rows], reach[rows])
            first = np.repeat(rows, [len(row) for row in near])
            second = np.fromiter(chain.from_iterable(near), np.int64, len(first))
            once = (a[second] > a[first]) | ((a[second] == a[first]) & (second > first))
            first, second = first[once], second[once]
            good = self.fits(singles[first], second)
            yield first[good], second[good]

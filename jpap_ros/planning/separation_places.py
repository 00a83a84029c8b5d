"""Places for UAVs, one after the other: each the nearest to where it wants to be that is free of those before it."""

from __future__ import annotations

import time

import numpy as np

from jpap_ros.planning.link_budget import Floats
from jpap_ros.planning.optimal.servability import TOLERANCE, Ints, Servability, Sets
from jpap_ros.planning.replanning_position import nearest_position
from jpap_ros.planning.solver import Problem

#: UAVs are kept this much inside their discs, and moved apart by this much more than asked; relative.
MARGIN = 1e-7
#: A place is looked for within so many separations first: the search grows with the square of the UAVs near by.
_NEAR = 3.0
#: Most UAVs around a disc that is searched as a whole.
_MOST_AROUND = 200
#: Cells that are tried for a device that has none.
_MOST_TRIED = 8


class Places:
    """UAVs with their cells, pairwise `problem.min_separation_m` apart.

    Attributes
    ----------
    cells : list of int arrays
    positions : (N, 2) float
        [m]
    origin : list of int
        Number that each cell had before; as large as can be where it had none.
    """

    def __init__(self, problem: Problem, servability: Servability, deadline: float) -> None:
        self.problem, self.servability, self.deadline = problem, servability, deadline
        self.cells: list[Ints] = []
        self.positions: Floats = np.empty((0, 2))
        self.origin: list[int] = []
        self._sets = Sets(np.empty(0), np.empty((0, 2)), np.empty(0))

    def take(self, cell: Ints, position: Floats, origin: int) -> None:
        """Fly a cell from a position that is known to be free."""
        self.cells.append(cell)
        self.positions = np.vstack([self.positions, position])
        self.origin.append(origin)
        self._measure(self._sets, self.servability.measure(cell))

    def fly(self, cell: Ints, wanted: Floats, origin: int = np.iinfo(np.int64).max) -> list[int]:
        """Fly as much of a cell as there is a place for; return the devices that are left over.

        The devices of least weight are left over, of equals those that demand most.
        """
        left: list[int] = []
        limit = self.problem.max_uavs
        if limit is not None and len(self.cells) >= limit:
            return [int(k) for k in cell]
        by_worth = cell[np.lexsort((cell, self.problem.rates[cell], -self.problem.weights[cell]))]
        for size in range(len(cell), 0, -1):
            part = np.sort(by_worth[:size])
            position = self._free(self.servability.measure(part), wanted, self.positions)
            if position is not None:
                self.take(part, position, origin)
                return left
            left.append(int(by_worth[size - 1]))
        return left

    def join(self, device: int) -> bool:
        """Put a device into a cell that can serve it too, if need be from another place."""
        grown = self.servability.joined(self._sets, np.full(len(self.cells), device))
        room = np.array([len(cell) < self.problem.cell_limit for cell in self.cells], dtype=bool)
        able = np.flatnonzero((grown.load <= 1 + TOLERANCE) & room)
        away = np.hypot(*(self.positions[able] - grown.centroid[able]).T) - grown.slack_radius[able]
        for uav in able[np.argsort(away)][:_MOST_TRIED].tolist():
            others = np.delete(self.positions, uav, axis=0)
            position = self._free(grown[np.array([uav])], self.positions[uav], others)
            if position is not None:
                self.cells[uav] = np.sort(np.append(self.cells[uav], device))
                self.positions[uav] = position
                self._sets.weight[uav], self._sets.centroid[uav], self._sets.load[uav] = (
                    grown.weight[uav], grown.centroid[uav], grown.load[uav],
                )  # fmt: skip
                return True
        return False

    def _measure(self, before: Sets, one: Sets) -> None:
        self._sets = Sets(
            np.append(before.weight, one.weight),
            np.vstack([before.centroid, one.centroid]),
            np.append(before.load, one.load),
        )

    def _free(self, one: Sets, wanted: Floats, others: Floats) -> Floats | None:
        """The place nearest to the wanted one in the disc of a set and apart from all others; None if none is found."""
        separation = self.problem.min_separation_m
        centre, reach = one.centroid[0], float(one.slack_radius[0]) * (1 - MARGIN)
        away = wanted - centre
        start: Floats = centre + away * min(1.0, reach / max(float(np.hypot(*away)), 1e-300))
        if not (np.hypot(*(others - start).T) < separation).any():
            return start
        if time.monotonic() > self.deadline:
            return None
        around = others[np.hypot(*(others - centre).T) < reach + separation * (1 + MARGIN)]
        disc = (float(centre[0]), float(centre[1]), reach**2)
        vicinity = _NEAR * separation
        if reach > vicinity:
            near = around[np.hypot(*(around - start).T) < vicinity + separation * (1 + MARGIN)]
            discs = [disc, (float(start[0]), float(start[1]), vicinity**2)]
            found = nearest_position(_point(start), discs, [_point(other) for other in near], separation)
            if found is not None or len(around) > _MOST_AROUND:
                return None if found is None else np.array(found)
        found = nearest_position(_point(start), [disc], [_point(other) for other in around], separation)
        return None if found is None else np.array(found)


def _point(place: Floats) -> tuple[float, float]:
    return float(place[0]), float(place[1])

"""The smallest fleet: cells that serve every device, and a proven lower bound on their number."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from jpap_ros.planning.optimal.column_generation import bounds_by_columns
from jpap_ros.planning.optimal.cover import covering_columns, without_overlap
from jpap_ros.planning.optimal.ejection import fewer_cells
from jpap_ros.planning.optimal.enumeration import TooManySets, maximal_sets
from jpap_ros.planning.optimal.milp import incidence, minimise
from jpap_ros.planning.optimal.regrouping import GROUP, fewer_by_groups
from jpap_ros.planning.optimal.servability import Ints, Servability

_MOST_SETS = 800_000
#: Sets that a mixed-integer program can still do something with.
_MOST_COLUMNS = 60_000
_LONGEST_SEARCH_S = 5.0
#: One program does well on its own with fewer cells than so many groups of neighbours.
_MANY_GROUPS = 4
_ROUNDING = 1e-6


@dataclass(frozen=True, eq=False)
class Fleet:
    """Cells that serve every device.

    Attributes
    ----------
    cells : list of int arrays
        Device indices of each cell; every device is in exactly one.
    bound : int
        No fewer UAVs can serve the devices.
    """

    cells: list[Ints]
    bound: int

    @property
    def proven(self) -> bool:
        """Whether no fewer UAVs can serve the devices."""
        return len(self.cells) == self.bound


def smallest_fleet(servability: Servability, start: list[Ints], deadline: float, seed: int) -> Iterator[Fleet]:
    """Yield ever better fleets, until one is proven smallest or the deadline has passed.

    Parameters
    ----------
    start : list of int arrays
        A partition of the devices into servable cells.
    deadline : float
        `time.monotonic()` by which to stop.
    """
    began = time.monotonic()
    left = deadline - began
    fleet = Fleet(start, simple_bound(servability))
    quick = min(0.02 + len(servability) / 5000, 0.05 * left)
    for better in _search(servability, fleet, began + quick, seed):
        fleet = better
        yield fleet
    if fleet.proven:
        return
    try:
        members, _ = maximal_sets(servability, _MOST_SETS, began + 0.2 * left)
    except TooManySets:
        yield from _without_enumeration(servability, fleet, deadline, seed)
    else:
        yield from _with_enumeration(servability, fleet, members, deadline, seed)


def simple_bound(servability: Servability) -> int:
    """A bound that costs nothing: power from straight above, the cell limit, and devices no two of which can share."""
    power = math.ceil(float((servability.demand * servability.height2).sum()) - _ROUNDING)
    apart = 0
    free = np.ones(len(servability), dtype=bool)
    near = servability.neighbours()
    for device in np.argsort([len(row) for row in near]):
        if free[device]:
            apart += 1
            free[near[device]] = False
    return max(1, power, math.ceil(len(servability) / servability.cell_limit), apart)


def first_cells(servability: Servability) -> list[Ints]:
    """A quick partition: from the most demanding device on, take in whichever device adds the least load."""
    free = np.ones(len(servability), dtype=bool)
    near = servability.neighbours()
    cells = []
    for device in np.argsort(-servability.demand):
        if not free[device]:
            continue
        free[device] = False
        cell = [int(device)]
        sets = servability.singles()[np.array([device])]
        while len(cell) < servability.cell_limit:
            others = near[device][free[near[device]]]
            others = others[servability.fits(sets, others)]
            if not len(others):
                break
            # Light devices can join later as well: what counts is how near the next one is.
            other = others[((servability.positions[others] - sets.centroid) ** 2).sum(axis=1).argmin()]
            sets = servability.joined(sets, other[None])
            free[other] = False
            cell.append(int(other))
        cells.append(np.array(sorted(cell)))
    return cells


def _search(servability: Servability, fleet: Fleet, deadline: float, seed: int) -> Iterator[Fleet]:
    yield fleet
    for cells in fewer_cells(servability, fleet.cells, fleet.bound, deadline, seed):
        yield Fleet(cells, fleet.bound)


def _with_enumeration(
    servability: Servability, fleet: Fleet, members: list[Ints], deadline: float, seed: int
) -> Iterator[Fleet]:
    """Set cover over all maximal sets: linear program for a first bound, mixed-integer program for the proof."""
    count = len(servability)
    matrix = incidence(members, count)
    cost, at_least, no_limit = np.ones(len(members)), np.ones(count), np.full(count, np.inf)
    relaxed = minimise(cost, matrix, at_least, no_limit, integer=False, deadline=deadline)
    if relaxed.duals is None:
        yield from _without_enumeration(servability, fleet, deadline, seed)
        return
    value = np.maximum(relaxed.duals, 0)
    worth = matrix.T @ value
    bound = float(value.sum()) / max(float(worth.max()), 1.0)
    fleet = Fleet(fleet.cells, max(fleet.bound, math.ceil(bound - _ROUNDING)))
    yield fleet
    left = deadline - time.monotonic()
    # With many sets the search is the better half; with few the program proves the fleet in no time.
    search = 0.4 * left if len(members) > _MOST_COLUMNS // 2 else min(0.05 + count / 500, 0.1 * left)
    for better in _search(servability, fleet, time.monotonic() + search, seed + 1):
        fleet = better
        yield fleet
    if len(fleet.cells) > _MANY_GROUPS * GROUP:
        groups_until = time.monotonic() + 0.5 * (deadline - time.monotonic())
        for cells in fewer_by_groups(servability, matrix, fleet.cells, fleet.bound, groups_until, seed):
            fleet = Fleet(cells, fleet.bound)
            yield fleet
    # A smaller fleet uses no set whose reduced cost exceeds what is left between the bound and its size.
    able = np.flatnonzero(1 - worth <= len(fleet.cells) - 1 - bound + _ROUNDING)
    if fleet.proven or len(able) > _MOST_COLUMNS:
        yield from _search(servability, fleet, deadline, seed + 2)
        return
    columns = sparse.csc_array(matrix[:, able])
    found = minimise(
        cost[able], columns, at_least, no_limit, integer=True, start=covering_columns(columns, fleet.cells),
        deadline=deadline, gap=1 - 1e-4,
    )  # fmt: skip
    # The program knows only the sets that a smaller fleet could use: it says nothing of fleets as large as this one.
    # Out of time before its first linear program, it says nothing at all (-inf).
    least = math.ceil(min(max(found.bound, fleet.bound), len(fleet.cells)) - _ROUNDING)
    cells = fleet.cells
    if found.x is not None and found.objective < len(cells) - 0.5:
        cells = without_overlap([members[i] for i in able[found.x > 0.5]], count)
    yield Fleet(cells, least)


def _without_enumeration(servability: Servability, fleet: Fleet, deadline: float, seed: int) -> Iterator[Fleet]:
    """Search for a smaller fleet and for a better bound in turn."""
    seen = list(fleet.cells)
    search_until = time.monotonic() + min(_LONGEST_SEARCH_S, 0.3 * (deadline - time.monotonic()))
    for better in _search(servability, fleet, search_until, seed + 1):
        fleet = better
        seen += fleet.cells
        yield fleet
    if fleet.proven:
        return
    for bound, _ in bounds_by_columns(servability, seen, len(fleet.cells), deadline):
        if bound > fleet.bound:
            fleet = Fleet(fleet.cells, min(bound, len(fleet.cells)))
            yield fleet
    if not fleet.proven:
        yield from _search(servability, fleet, deadline, seed + 2)

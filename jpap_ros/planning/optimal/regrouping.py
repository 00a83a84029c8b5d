"""Few cells by sharing out the devices of neighbouring cells anew, each time to the optimum.

For fleets that are too large for one program: a large neighbourhood search whose neighbourhoods are set covers of a
size that HiGHS solves in a fraction of a second.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
from scipy import sparse

from jpap_ros.planning.optimal.cover import covering_columns, without_overlap
from jpap_ros.planning.optimal.milp import minimise
from jpap_ros.planning.optimal.servability import Ints, Servability

#: Cells that are shared out together.
GROUP = 25
#: Longest time for one group [s].
_LONGEST_S = 2.0


def fewer_by_groups(
    servability: Servability, matrix: sparse.csc_array, cells: list[Ints], least: int, deadline: float, seed: int
) -> Iterator[list[Ints]]:
    """Yield partitions into ever fewer servable cells, until no group of neighbours can do with fewer.

    Parameters
    ----------
    matrix : (K, n) sparse array
        Incidence of the devices in all maximal servable sets.
    cells : list of int arrays
        A partition of the devices into servable cells to begin with.
    least : int
        Stop at this many cells: no fewer can serve the devices.
    deadline : float
        `time.monotonic()` by which to stop.
    """
    random = np.random.default_rng(seed)
    rows = matrix.tocsr()
    settled: set[bytes] = set()
    while True:
        found = False
        for first in random.permutation(len(cells)):
            if time.monotonic() > deadline or len(cells) <= max(least, GROUP):
                return
            group = _nearest(servability, cells, int(first))
            devices = np.sort(np.concatenate([cells[i] for i in group]))
            if devices.tobytes() in settled:
                continue
            fewer = _fewest(rows, devices, [cells[i] for i in group], deadline)
            if len(fewer) == len(group):
                settled.add(devices.tobytes())
                continue
            kept = set(range(len(cells))) - set(group.tolist())
            cells = [cells[i] for i in sorted(kept)] + fewer
            yield cells
            found = True
            break
        if not found:
            return


def _nearest(servability: Servability, cells: list[Ints], first: int) -> Ints:
    """Indices of the cells whose centroids are nearest to that of one."""
    centroids = servability.measure_all(cells).centroid
    away = ((centroids - centroids[first]) ** 2).sum(axis=1)
    return np.argsort(away, kind="stable")[:GROUP]


def _fewest(rows: sparse.csr_array, devices: Ints, cells: list[Ints], deadline: float) -> list[Ints]:
    """The fewest cells for some devices that were found; those given if none were fewer."""
    part = rows[devices].tocsc()
    # What is left of many sets is the same.
    columns = {members.tobytes(): i for i, members in enumerate(_sets(part)) if len(members)}
    matrix = sparse.csc_array(part[:, sorted(columns.values())])
    count, sets = len(devices), matrix.shape[1]
    found = minimise(
        np.ones(sets), matrix, np.ones(count), np.full(count, np.inf), integer=True,
        start=covering_columns(matrix, [np.searchsorted(devices, cell) for cell in cells]),
        deadline=min(deadline, time.monotonic() + _LONGEST_S), gap=1 - 1e-4,
    )  # fmt: skip
    if found.x is None or found.objective > len(cells) - 0.5:
        return cells
    chosen = _sets(matrix[:, np.flatnonzero(found.x > 0.5)])
    return [np.sort(devices[cell]) for cell in without_overlap(chosen, count)]


def _sets(matrix: sparse.csc_array) -> list[Ints]:
    """The devices of each column."""
    return np.split(matrix.indices, matrix.indptr[1:-1])

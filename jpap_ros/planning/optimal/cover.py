"""From sets that cover the devices to cells that share them out, and back."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse

from jpap_ros.planning.link_budget import Floats
from jpap_ros.planning.optimal.servability import Ints


def covering_columns(matrix: sparse.csc_array, cells: Sequence[Ints]) -> Floats | None:
    """Return 0/1 for columns of an incidence matrix that contain the cells, one for each; None where one is missing."""
    x = np.zeros(matrix.shape[1])
    rows = matrix.tocsr()
    for cell in cells:
        inside = np.bincount(np.concatenate([rows.indices[rows.indptr[k] : rows.indptr[k + 1]] for k in cell]))
        column = int(inside.argmax()) if len(inside) else 0
        if not len(inside) or inside[column] < len(cell):
            return None
        x[column] = 1
    return x


def without_overlap(sets: Sequence[Ints], count: int) -> list[Ints]:
    """Leave each of `count` devices in one of the sets that cover it; subsets of servable sets are servable."""
    free = np.ones(count, dtype=bool)
    parts = []
    for members in sets:
        part = members[free[members]]
        free[part] = False
        if len(part):
            parts.append(part)
    return parts

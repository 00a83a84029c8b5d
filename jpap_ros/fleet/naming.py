"""Which aircraft flies which cell: stable names first, then the shortest flights."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from jpap_ros.fleet.assignment import OBJECTIVES, assign
from jpap_ros.fleet.cells import Aircraft, FleetCell

#: An aircraft without telemetry counts as this much farther away [m]: beyond any distance on the map.
_SILENT_HANDICAP_M = 1e7


def name_cells(
    cells: Sequence[FleetCell],
    available: Sequence[Aircraft],
    holders: Mapping[int, str],
    objective: str = OBJECTIVES[0],
) -> tuple[FleetCell, ...]:
    """Give each cell an aircraft.

    A cell keeps the aircraft that it has. The others go to the remaining aircraft as the objective says, where an
    aircraft whose telemetry does not arrive is taken only if there are too few whose does.

    Parameters
    ----------
    cells : sequence of FleetCell
        Names in them are not used.
    available : sequence of Aircraft
        If there are fewer than cells, some cells stay without a name.
    holders : mapping of int to str
        Aircraft of each cell in the plan in force, by the cell's id.
    objective : str
        Of `assign`.

    Returns
    -------
    tuple of FleetCell
        In the order of `available`; cells without an aircraft last.
    """
    index = {craft.name: i for i, craft in enumerate(available)}
    keep = [index.get(holders.get(cell.id, ""), -1) for cell in cells]
    given = assign(
        np.array([cell.position for cell in cells], dtype=np.float64).reshape(-1, 2),
        np.array([craft.position for craft in available], dtype=np.float64).reshape(-1, 2),
        objective=objective,
        keep=keep,
        keep_margin_m=math.inf,
        handicap_m=_handicap([craft.connected or i in keep for i, craft in enumerate(available)], len(cells)),
    )
    named = {
        int(uav): replace(cell, uav=available[uav].name) for cell, uav in zip(cells, given, strict=True) if uav >= 0
    }
    nameless = [replace(cell, uav="") for cell, uav in zip(cells, given, strict=True) if uav < 0]
    return (*(named[i] for i in sorted(named)), *nameless)


def _handicap(heard: Sequence[bool], needed: int) -> list[float]:
    """Metres by which each aircraft counts as farther away than it is."""
    if sum(heard) >= needed:
        return [0.0 if ok else math.inf for ok in heard]
    # Alike for all where none is heard, so that squared distances alone decide.
    silent = _SILENT_HANDICAP_M if any(heard) else 0.0
    return [0.0 if ok else silent for ok in heard]

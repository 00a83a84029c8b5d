"""Which UAV flies to which goal."""

from __future__ import annotations

import operator
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import linear_sum_assignment
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching
from scipy.spatial.distance import cdist

from jpap_ros.fleet.arrays import Floats, points, vector

OBJECTIVES = ("distance2", "bottleneck")


def assign(
    goals: ArrayLike,
    positions: ArrayLike,
    *,
    objective: str = "distance2",
    keep: Sequence[int] | NDArray[np.int64] | None = None,
    keep_margin_m: float = 10.0,
    handicap_m: ArrayLike | None = None,
    weights: ArrayLike | None = None,
) -> NDArray[np.int64]:
    """Give every goal a UAV, as far as the UAVs go.

    Parameters
    ----------
    goals : (N, 2) array_like
        Where UAVs should hover [m], ENU.
    positions : (M, 2) array_like
        Where the UAVs are [m].
    objective : str
        `distance2`: least sum of squared distances, the assignment that CAPT needs (see `transit`).
        `bottleneck`: the shortest longest flight, hence the shortest time until every goal is reached; among those
        the least sum of squared distances.
    keep : (N,) sequence of int, optional
        The UAV that each goal has now; -1 for none. See Notes.
    keep_margin_m : float
        What a goal must gain to be given to another UAV than the one it has; infinite: it keeps it in any case.
    handicap_m : (M,) array_like, optional
        Metres by which a UAV counts as farther away than it is: a reserve on the ground, a tired battery. Infinite:
        the UAV is not used.
    weights : (N,) array_like, optional
        Which goals come first where the UAVs are too few; default: all alike.

    Returns
    -------
    (N,) int
        Index of the UAV for each goal; -1 where there is none left for it. No UAV appears twice. min(N, usable UAVs)
        goals have one.

    Raises
    ------
    ValueError
        On bad input; names the argument, the index and the value.

    Notes
    -----
    With d the distance plus the UAV's handicap and m the margin, a pair costs d^2, and d^2 - m^2 where it is kept:
    UAVs change hands only where that saves more than m^2 for each goal concerned. For `bottleneck` a kept flight
    counts as m shorter, so the longest flight is at most m longer than the shortest possible one.

    Where UAVs are too few, no goal goes without while one of less weight has a UAV; among goals of the same weight the
    nearest win. The result depends on the input alone; equal costs are decided by the order of the arguments.

    Examples
    --------
    >>> assign([[0, 0], [100, 0]], [[90, 0], [40, 0], [0, 5]]).tolist()
    [2, 0]
    """
    where, start = points("goals", goals, 2), points("positions", positions, 2)
    if objective not in OBJECTIVES:
        raise ValueError(f"objective must be one of {', '.join(OBJECTIVES)}, got {objective!r}")
    if not keep_margin_m >= 0:
        raise ValueError(f"keep_margin_m must be >= 0, got {keep_margin_m!r}")
    held = _kept(keep, len(where), len(start))
    handicap = np.zeros(len(start)) if handicap_m is None else vector("handicap_m", handicap_m, len(start))
    weight = np.ones(len(where)) if weights is None else vector("weights", weights, len(where))

    result = np.full(len(where), -1, dtype=np.int64)
    usable = np.isfinite(handicap)
    if np.isinf(keep_margin_m) and len(start):
        pinned = np.flatnonzero((held >= 0) & usable[held])
        result[pinned] = held[pinned]
        usable[held[pinned]] = False
    open_goals, uavs = np.flatnonzero(result < 0), np.flatnonzero(usable)
    if not len(open_goals) or not len(uavs):
        return result
    kept = held[open_goals, None] == uavs
    margin = 0.0 if np.isinf(keep_margin_m) else keep_margin_m
    length = cdist(where[open_goals], start[uavs]) + handicap[uavs]
    chosen, must = _by_weight(weight[open_goals], len(uavs))
    open_goals, length, kept = open_goals[chosen], length[chosen], kept[chosen]
    cost = length**2 - margin**2 * kept
    allowed = np.ones_like(kept)
    if objective == "bottleneck":
        reach = np.maximum(length - margin * kept, 0.0)
        allowed = reach <= _least_bottleneck(reach, must)
    rows, columns = _cheapest(cost, allowed, must)
    result[open_goals[rows]] = uavs[columns]
    return result


def _kept(keep: Sequence[int] | NDArray[np.int64] | None, goals: int, uavs: int) -> NDArray[np.int64]:
    if keep is None:
        return np.full(goals, -1, dtype=np.int64)
    if len(keep) != goals:
        raise ValueError(f"keep must have one entry for each of the {goals} goals, got {len(keep)}")
    seen: dict[int, int] = {}
    for goal, value in enumerate(keep):
        uav = operator.index(value)
        if not -1 <= uav < uavs:
            raise ValueError(f"keep[{goal}] must be -1 or the index of one of {uavs} UAVs, got {uav}")
        if uav >= 0 and seen.setdefault(uav, goal) != goal:
            raise ValueError(f"keep[{goal}] is UAV {uav}, which is already that of keep[{seen[uav]}]")
    return np.array(keep, dtype=np.int64)


def _by_weight(weight: Floats, uavs: int) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Goals that may get one of the UAVs (in their order), and which of those must."""
    if len(weight) <= uavs:
        return np.arange(len(weight)), np.ones(len(weight), dtype=np.bool_)
    least = np.sort(weight)[::-1][uavs - 1]
    chosen = np.flatnonzero(weight >= least)
    return chosen, weight[chosen] > least


def _least_bottleneck(reach: Floats, must: NDArray[np.bool_]) -> float:
    """Shortest longest flight of any complete assignment that serves every goal that must be served.

    Goals that can all be matched stay matched when a matching is made larger along augmenting paths, so two sizes of
    maximum matchings decide: that of all goals, and that of those which must be served.
    """
    size = min(reach.shape)
    lengths = np.unique(reach)
    low, high = 0, len(lengths) - 1
    while low < high:
        middle = (low + high) // 2
        near = reach <= lengths[middle]
        if _matching_size(near) == size and _matching_size(near[must]) == int(must.sum()):
            high = middle
        else:
            low = middle + 1
    return float(lengths[low])


def _matching_size(allowed: NDArray[np.bool_]) -> int:
    if not allowed.size:
        return 0
    return int((maximum_bipartite_matching(csr_array(allowed), perm_type="column") >= 0).sum())


def _cheapest(
    cost: Floats, allowed: NDArray[np.bool_], must: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cheapest complete assignment of allowed pairs that serves every goal that must be served."""
    if not must.all():
        spread = float(np.ptp(cost)) * min(cost.shape) + 1.0
        cost = np.where(must[:, None], cost - spread, cost)
    rows, columns = linear_sum_assignment(np.where(allowed, cost, np.inf))
    return np.asarray(rows, dtype=np.int64), np.asarray(columns, dtype=np.int64)

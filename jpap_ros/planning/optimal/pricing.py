"""The pricing problem of column generation: the servable set whose devices are worth the most, and a bound on it.

Every set has its centroid in one square of the plane. Let a square have the centre v0 and the half side h, and let
the centroid c of S lie in it. Then f(S) = sum a_k q_k(v0) - |c - v0|^2 sum a_k, so S is servable only if

    sum over S of a_k (q_k(v0) - 2 h^2) <= 1,    q_k(v) = |v - u_k|^2 + H^2:

a knapsack for each square, whose fractional relaxation bounds the worth of all sets with their centroid there. The
error is of second order in h; squares whose bound matters are halved.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np

from jpap_ros.planning.link_budget import Floats
from jpap_ros.planning.optimal.servability import Bools, Ints, Servability

#: Bounds within this ratio of the best set found are good enough.
RELATIVE_GAP = 0.01
_MOST_SQUARES = 6000
_FINEST_M = 0.5
_CAPACITY_STEPS = 800


@dataclass(frozen=True, eq=False)
class Priced:
    """What pricing found.

    Attributes
    ----------
    sets : list of int arrays
        Servable sets of high worth, all different.
    worth : (n,) float
        Their worth.
    bound : float
        No servable set is worth more.
    """

    sets: list[Ints]
    worth: Floats
    bound: float


def price(servability: Servability, value: Floats, deadline: float, exact: bool) -> Priced:
    """Find servable sets of the largest total value.

    Parameters
    ----------
    value : (K,) float
        Worth of each device, >= 0.
    exact : bool
        Whether to spend time on a tight bound.
    """
    useful = np.flatnonzero(value > 1e-12)
    if not len(useful):
        return Priced([], np.empty(0), 0.0)
    pool: dict[bytes, tuple[Ints, float]] = {}
    u = servability.positions[useful]
    low, span = u.min(axis=0), float(np.ptp(u, axis=0).max())
    side = max(span, 1e-3) / 12
    steps = [np.arange(max(1, math.ceil(s / side))) for s in np.ptp(u, axis=0) + 1e-9]
    centre = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 2) * side + side / 2 + low
    half = side / 2
    settled = 0.0
    while True:
        bound = _knapsack_bound(servability, value, useful, centre, half)
        _collect(servability, value, useful, centre[np.argsort(-bound)[:600]], pool)
        best = max(worth for _, worth in pool.values())
        good_enough = max(best, 1.0) * (1 + RELATIVE_GAP)
        open_squares = bound > good_enough
        settled = max(settled, float(bound[~open_squares].max(initial=0.0)))
        centre, bound = centre[open_squares], bound[open_squares]
        fine = half <= _FINEST_M or 4 * len(centre) > _MOST_SQUARES or time.monotonic() > deadline
        if not len(centre) or fine or (half < 30 and not exact):
            break
        half /= 2
        quarters = np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]]) * half
        centre = (centre[:, None] + quarters).reshape(-1, 2)
    if exact and len(centre):
        bound = _whole_knapsack_bound(servability, value, useful, centre, half, bound, pool, deadline)
        best = max(worth for _, worth in pool.values())
    most = max(settled, float(bound.max(initial=0.0)), best)
    sets = list(pool.values())
    return Priced([members for members, _ in sets], np.array([worth for _, worth in sets]), most)


def _costs(servability: Servability, useful: Ints, centre: Floats, half: float) -> Floats:
    """Least share of the power that each device takes in a set with its centroid in each square, (squares, devices)."""
    away = np.abs(centre[:, None] - servability.positions[useful])
    a = servability.demand[useful]
    cost = a * ((away**2).sum(axis=2) + servability.height2 - 2 * half**2)
    alone = a * ((np.maximum(away - half, 0) ** 2).sum(axis=2) + servability.height2)
    least: Floats = np.where(alone <= 1, np.maximum(cost, 0), np.inf)
    return least


def _knapsack_bound(servability: Servability, value: Floats, useful: Ints, centre: Floats, half: float) -> Floats:
    """Fractional knapsack, and the cell limit, for each square."""
    bounds = [np.empty(0)]
    rows = max(1, 2_000_000 // len(useful))
    for start in range(0, len(centre), rows):
        cost = _costs(servability, useful, centre[start : start + rows], half)
        worth = np.where(np.isfinite(cost), value[useful], 0.0)
        density = worth / np.maximum(cost, 1e-12)
        order = np.argsort(-density, axis=1)
        cost = np.take_along_axis(np.where(np.isfinite(cost), cost, 0.0), order, axis=1)
        ranked = np.take_along_axis(worth, order, axis=1)
        density = np.take_along_axis(density, order, axis=1)
        room = np.maximum(1 - (np.cumsum(cost, axis=1) - cost), 0)
        part = np.where(cost <= room, ranked, np.minimum(room * density, ranked)).sum(axis=1)
        limit = servability.cell_limit
        if limit < len(useful):
            part = np.minimum(part, np.sort(worth, axis=1)[:, -limit:].sum(axis=1))
        bounds.append(part)
    return np.concatenate(bounds)


def _whole_knapsack_bound(
    servability: Servability,
    value: Floats,
    useful: Ints,
    centre: Floats,
    half: float,
    bound: Floats,
    pool: dict[bytes, tuple[Ints, float]],
    deadline: float,
) -> Floats:
    """Knapsack with whole devices by dynamic programming, costs rounded down to steps of the capacity.

    The optimal knapsacks that turn out to be servable sets are added to the pool.
    """
    tight: Floats = bound.copy()
    order = np.argsort(-bound)
    block = max(10, 6_000 // len(useful))
    highest = 0.0
    for start in range(0, len(order), block):
        rows = order[start : start + block]
        if time.monotonic() > deadline or bound[rows[0]] <= highest:
            break
        cost = _costs(servability, useful, centre[rows], half) * _CAPACITY_STEPS
        # Rounded down for the bound; rounded to the nearest for sets, most of which are then servable.
        tight[rows] = np.minimum(tight[rows], _knapsacks(value[useful], np.floor(cost))[0])
        highest = max(highest, float(tight[rows].max()))
        worth, chosen = _knapsacks(value[useful], np.rint(cost))
        for row in np.unique(chosen[worth > 1], axis=0):
            members = useful[row]
            if servability.servable(members):
                pool[members.tobytes()] = (members, float(value[members].sum()))
    return tight


def _knapsacks(value: Floats, cost: Floats) -> tuple[Floats, Bools]:
    """Best worth, and choice of devices (rows, devices), of a knapsack for each row of costs in whole steps."""
    steps = np.minimum(cost, _CAPACITY_STEPS + 1).astype(np.int64)
    items = np.flatnonzero((steps <= _CAPACITY_STEPS).any(axis=0))
    best = np.zeros((len(steps), _CAPACITY_STEPS + 1))
    taken = np.zeros((len(items), *best.shape), dtype=bool)
    capacity = np.arange(_CAPACITY_STEPS + 1)
    for i, k in enumerate(items):
        left = capacity[None] - steps[:, k][:, None]
        with_device = np.take_along_axis(best, np.maximum(left, 0), axis=1) + value[k]
        taken[i] = (left >= 0) & (with_device > best)
        best = np.where(taken[i], with_device, best)
    rows = np.arange(len(steps))
    room = np.full(len(steps), _CAPACITY_STEPS)
    chosen = np.zeros(cost.shape, dtype=bool)
    for i in range(len(items) - 1, -1, -1):
        chosen[:, items[i]] = taken[i, rows, room]
        room = room - np.where(chosen[:, items[i]], steps[:, items[i]], 0)
    worth: Floats = best[:, -1]
    return worth, chosen


def _collect(
    servability: Servability, value: Floats, useful: Ints, centre: Floats, pool: dict[bytes, tuple[Ints, float]]
) -> None:
    """Fill a set greedily from each centre, by worth per power; add what is found to the pool."""
    cost = _costs(servability, useful, centre, 0.0)
    density = np.where(np.isfinite(cost), value[useful] / cost, -1.0)
    order = np.argsort(-density, axis=1)
    rows = np.arange(len(centre))
    first = useful[order[:, 0]]
    sets = servability.singles()[first]
    chosen = np.zeros((len(centre), len(useful)), dtype=bool)
    chosen[rows, order[:, 0]] = True
    size = np.ones(len(centre), dtype=np.int64)
    for rank in range(1, len(useful)):
        device = useful[order[:, rank]]
        good = servability.fits(sets, device) & (size < servability.cell_limit)
        if not good.any():
            continue
        grown = servability.joined(sets[good], device[good])
        sets.weight[good], sets.centroid[good], sets.load[good] = grown.weight, grown.centroid, grown.load
        chosen[rows[good], order[good, rank]] = True
        size[good] += 1
    for row in np.unique(chosen, axis=0):
        members = useful[row]
        pool[members.tobytes()] = (members, float(value[members].sum()))

"""The paper's own algorithms, taken literally: slow, readable, and what the fast ones are checked against.

`lagrange_position` is the Lagrange method of equations (13) to (22): the subgradient method for the multipliers, and
for each of its steps the position where the Lagrange function is least. `outer_rates` is the exhaustive search,
`literal_position` the DRMP algorithm made of both and nothing else, and `reference_jpap` the listing of section IV-C
line by line. `drmp_position` is more than the text: it polishes what the grid found, to compare positions with.

Two decisions where the text needs one. The paper's outer region asks that *every* device be at least H away, so that
positions with some devices within H and others beyond belong to neither region, and the best position is often one of
them. Here the outer region is all of the feasible region that the inner one leaves over. And of positions that are
equally good, as far as the method can tell, the UAV takes the one nearest to where it is.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jpap_ros.planning.allocation import Allocation
from jpap_ros.planning.geometry import common_point, nearest_common_point
from jpap_ros.planning.link_budget import Floats
from jpap_ros.planning.placement import RATE_TOLERANCE
from jpap_ros.planning.solver import Problem

#: Given device positions (n, 2), strengths P_k eta (n,), squared radii (n,), H^2 and the present position (2,),
#: all in metres: the best position (2,).
Placer = Callable[[Floats, Floats, Floats, float, Floats], Floats]

#: What a grid of 1 m may miss of an optimum on the edge of the feasible region [bit/s/Hz], with room to spare.
GRID_TOLERANCE = 0.05
#: The subgradient method has converged, and equations (21) and (22) are solved, when the UAV moves by less than this
#: [m]: the paper gives no tolerance.
CONVERGED_M = 1e-6
LN2 = math.log(2)


def sum_rate(position: Floats, points: Floats, strengths: Floats, height2: float) -> float:
    """The objective (12a) [bit/s/Hz]."""
    q = ((points - position) ** 2).sum(axis=1) + height2
    return float(np.log2(1 + strengths / q).sum())


def tau(snr: Floats) -> Floats:
    """Slope of the bound tau log2 z + beta <= log2(1 + z), which is tight at z = snr."""
    found: Floats = snr / (1 + snr)
    return found


def beta(snr: Floats) -> Floats:
    """Offset of the same bound."""
    found: Floats = np.log2(1 + snr) - tau(snr) * np.log2(snr)
    return found


def pulls(points: Floats, strengths: Floats, height2: float, position: Floats) -> Floats:
    """tau_k / (ln 2 q_k): how strongly each device pulls at the UAV."""
    q = ((points - position) ** 2).sum(axis=1) + height2
    found: Floats = tau(strengths / q) / (LN2 * q)
    return found


def least_lagrangian(
    points: Floats, strengths: Floats, multipliers: Floats, height2: float, start: Floats, solved_m: float
) -> Floats:
    """The position where the Lagrange function is least for these multipliers, as the dual function (19a) asks.

    There, equations (21) and (22) hold: sum_k (pull_k + lambda_k) (v - u_k) = 0. They are solved by fixed point, until
    it moves by less than `solved_m`; the bound (13) is made tight again at each position.
    """
    position = start
    while True:
        weights = pulls(points, strengths, height2, position) + multipliers
        moved: Floats = weights @ points / weights.sum()
        if math.dist(position, moved) < solved_m:
            return moved
        position = moved


def lagrange_multipliers(
    points: Floats,
    strengths: Floats,
    squared_radii: Floats,
    height2: float,
    start: Floats,
    iterations: int = 100_000,
    tolerance_m: float = CONVERGED_M,
    solved_m: float = CONVERGED_M,
    step: float = 0.05,
) -> tuple[Floats, Floats, int]:
    """Problem P4D by the subgradient method (20).

    Parameters
    ----------
    points, strengths, squared_radii, height2, start
        See `Placer`.
    iterations : int
        Most steps of the subgradient method.
    tolerance_m : float
        A step that moves the position by less than this [m] is the last.
    solved_m : float
        See `least_lagrangian`; infinity lets it take one step for each of the subgradient method.
    step : float
        epsilon_lambda of equation (20), relative to the largest pull without multipliers over d^2, which makes it a
        pure number.

    Returns
    -------
    multipliers : (n,) float
        lambda_k.
    position : (2,) float
        The position that belongs to them.
    steps : int
        Steps that were taken.
    """
    multipliers = np.zeros(len(points))
    position = least_lagrangian(points, strengths, multipliers, height2, start, solved_m)
    epsilon = step * pulls(points, strengths, height2, position).max() / np.maximum(squared_radii, height2)
    steps = 0
    for steps in range(1, iterations + 1):  # noqa: B007 (its last value is returned)
        excess = ((points - position) ** 2).sum(axis=1) - squared_radii
        multipliers = np.maximum(multipliers + epsilon * excess, 0)
        before = position
        position = least_lagrangian(points, strengths, multipliers, height2, position, solved_m)
        if math.dist(before, position) < tolerance_m:
            break
    return multipliers, position, steps


def lagrange_position(
    points: Floats, strengths: Floats, squared_radii: Floats, height2: float, start: Floats, **subgradient: Any
) -> Floats:
    """The Lagrange method for problem P4; see `lagrange_multipliers`. The discs must share a point.

    Returns
    -------
    (2,) float
        The feasible position nearest to that of the last multipliers.
    """
    _, position, _ = lagrange_multipliers(points, strengths, squared_radii, height2, start, **subgradient)
    (x, y), (xs, ys) = position.tolist(), points.T.tolist()
    nearest = nearest_common_point(x, y, xs, ys, squared_radii.tolist())
    return _deepest(points, squared_radii) if nearest is None else np.array(nearest)


def outer_rates(
    points: Floats, strengths: Floats, squared_radii: Floats, height2: float, grid_step_m: float = 1.0
) -> tuple[Floats, Floats, Floats]:
    """The exhaustive search of the outer region on a square grid.

    Returns
    -------
    xs, ys : (m,), (n,) float
        Coordinates of the grid [m].
    rate : (m, n) float
        Sum rate at each grid point [bit/s/Hz]; -inf where it is not in the region.
    """
    radii = np.sqrt(squared_radii)[:, None]
    low, high = (points - radii).max(axis=0), (points + radii).min(axis=0)
    xs, ys = (np.arange(low[i], high[i] + grid_step_m, grid_step_m) for i in (0, 1))
    rate = np.zeros((len(xs), len(ys)))
    feasible, inner = np.ones(rate.shape, bool), np.ones(rate.shape, bool)
    for (u, v), strength, r2 in zip(points, strengths, squared_radii, strict=True):
        distance2 = (xs[:, None] - u) ** 2 + (ys - v) ** 2
        rate += np.log2(1 + strength / (distance2 + height2))
        feasible &= distance2 <= r2
        inner &= distance2 < height2
    rate[~feasible | inner] = -np.inf
    return xs, ys, rate


def peaks_of(rate: Floats, tolerance: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Indices of the grid's peaks that are worse than its best point by no more than a tolerance."""
    i, j = np.nonzero(rate >= rate.max() - tolerance)
    around = np.pad(rate, 1, constant_values=-np.inf)
    peak = np.all([rate[i, j] >= around[i + di, j + dj] for di in range(3) for dj in range(3)], axis=0)
    return i[peak], j[peak]


def literal_position(
    points: Floats,
    strengths: Floats,
    squared_radii: Floats,
    height2: float,
    start: Floats,
    grid_tolerance: float = GRID_TOLERANCE,
    **subgradient: Any,
) -> Floats:
    """The DRMP algorithm of section IV-B as it stands; see `Placer`, and `lagrange_multipliers` for its options.

    Two devices more than 2 H apart have two best positions, and which of them is better by a hair a grid cannot tell;
    so, of the peaks of the grid that are worse by no more than `grid_tolerance` [bit/s/Hz], the outer region gives the
    one nearest to the present position. Where no grid point lies in a region that is not empty, its deepest point
    stands for it.
    """
    if squared_radii.max() < height2:
        return lagrange_position(points, strengths, squared_radii, height2, start, **subgradient)
    candidates = []
    inner, mean = np.minimum(squared_radii, height2), points.mean(axis=0)
    if common_point(points, inner) is not None:
        candidates.append(lagrange_position(points, strengths, inner, height2, mean, **subgradient))
    xs, ys, rate = outer_rates(points, strengths, squared_radii, height2)
    if np.isfinite(rate.max()):
        i, j = peaks_of(rate, grid_tolerance)
        peaks = np.column_stack([xs[i], ys[j]])
        candidates.append(peaks[((peaks - start) ** 2).sum(axis=1).argmin()])
    if not candidates:
        return _deepest(points, squared_radii)
    return max(candidates, key=lambda candidate: sum_rate(candidate, points, strengths, height2))


def drmp_position(
    points: Floats,
    strengths: Floats,
    squared_radii: Floats,
    height2: float,
    start: Floats,
    grid_step_m: float = 1.0,
) -> Floats:
    """The DRMP algorithm of section IV-B with a polish, far better than its grid; see `Placer`.

    Beyond the text, the Lagrange method runs over the whole feasible region too, from the present position, from the
    best grid point and from the nearest one within `GRID_TOLERANCE` of it, and of all these positions that differ by
    less than the tolerance of `placement` the nearest is taken. `grid_step_m` is that of the exhaustive search [m].
    """
    polish = partial(lagrange_position, iterations=1000, tolerance_m=0.0, solved_m=math.inf)
    candidates = [polish(points, strengths, squared_radii, height2, start)]
    if squared_radii.max() >= height2:
        inner = np.minimum(squared_radii, height2)
        if common_point(points, inner) is not None:
            candidates.append(polish(points, strengths, inner, height2, points.mean(axis=0)))
        xs, ys, rate = outer_rates(points, strengths, squared_radii, height2, grid_step_m)
        if np.isfinite(rate.max()):
            i, j = np.nonzero(rate >= rate.max() - GRID_TOLERANCE)
            good = np.column_stack([xs[i], ys[j]])
            for point in good[rate[i, j].argmax()], good[((good - start) ** 2).sum(axis=1).argmin()]:
                candidates += [point, polish(points, strengths, squared_radii, height2, point)]
    return nearest_of_the_best(candidates, points, strengths, height2, start)


def _deepest(points: Floats, squared_radii: Floats) -> Floats:
    """The point deepest in discs that share one."""
    deepest = common_point(points, squared_radii)
    if deepest is None:
        raise ValueError("the discs must share a point")
    return deepest


def nearest_of_the_best(
    candidates: list[Floats], points: Floats, strengths: Floats, height2: float, start: Floats
) -> Floats:
    """Of the candidates to which none is better by more than the tolerance, the one nearest to the present position."""
    rates = np.array([sum_rate(candidate, points, strengths, height2) for candidate in candidates])
    good = np.flatnonzero(rates >= rates.max() - RATE_TOLERANCE)
    return min((candidates[i] for i in good), key=lambda candidate: math.dist(candidate, start))


def reference_jpap(
    problem: Problem, allocation: Allocation, placer: Placer = drmp_position
) -> list[tuple[list[int], Floats]]:
    """The listing of section IV-C, its step numbers in the comments: each cell's devices, and its UAV's position.

    Ties and K_max are decided as `jpap` says; whether a cell can be served is decided exactly.
    """
    points, demand, link = problem.positions, problem.snr_demand, problem.link
    height2 = link.altitude_m**2
    area = 2 * np.sqrt(np.maximum(link.power_eta / demand - height2, 0))  # 2 d_k^0
    uncovered = list(range(len(points)))
    cells = []
    while uncovered:  # 1
        a, b = points[uncovered].T
        boundary = [uncovered[i] for i in (a.argmax(), b.argmax(), a.argmin(), b.argmin())]
        near = {k: [i for i in uncovered if i != k and math.dist(points[i], points[k]) <= area[k]] for k in boundary}
        k0 = max(boundary, key=lambda k: (len(near[k]), demand[k]))  # 2
        candidates = near[k0]
        position, covered = points[k0], [k0]  # 3
        while candidates and len(covered) < problem.cell_limit:  # 4
            k1 = min(candidates, key=lambda k: math.dist(points[k], position))  # 5
            candidates.remove(k1)
            trial = [*covered, k1]  # 6
            strengths = allocation.powers(demand[trial], link) * link.eta  # 7
            squared_radii = allocation.squared_radii(demand[trial], link)
            if common_point(points[trial], squared_radii) is None:  # 8
                break  # 9
            covered = trial
            position = placer(points[trial], strengths, squared_radii, height2, position)  # 11
        uncovered = [k for k in uncovered if k not in covered]  # 14
        cells.append((covered, position))
    return cells

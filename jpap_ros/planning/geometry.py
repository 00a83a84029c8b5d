"""Whether discs in the plane share a point, decided exactly.

The discs |v - u_k|^2 <= r_k^2 share a point if and only if the least value over v of max_k (|v - u_k|^2 - r_k^2) is
not positive. That function is strictly convex, and its minimiser is fixed by at most three of the discs (its basis);
for equal radii it is the centre of the smallest enclosing circle. The basis is found by pivoting: as long as a disc
exceeds the value of the basis, the one that exceeds it most enters, and the value grows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from jpap_ros.planning.link_budget import Floats

#: A squared distance may exceed its squared radius by this part of it: rounding of double precision, no more.
#: Ten times finer than the tolerance of `Deployment.violations`, so that what is accepted here holds there.
RELATIVE_TOLERANCE = 1e-10
#: Rounding of a coordinate relative to the extent of the centres: what is left where a radius is 0.
COORDINATE_TOLERANCE = 1e-13

#: Centre (x, y) and squared radius.
Disc = tuple[float, float, float]


def common_point(centres: ArrayLike, squared_radii: ArrayLike) -> Floats | None:
    """A point that all discs share, or None where there is none.

    Parameters
    ----------
    centres : (n, 2) array_like
        Centres of the discs [m]; n >= 1.
    squared_radii : (n,) array_like
        Squared radii [m^2]; a negative one means the empty disc.

    Returns
    -------
    (2,) float or None
        The point deepest in the discs: it minimises max_k (|v - u_k|^2 - r_k^2).
    """
    points = np.asarray(centres, float).reshape(-1, 2)
    radii = np.asarray(squared_radii, float)
    found = deepest_common_point(points[:, 0].tolist(), points[:, 1].tolist(), radii.tolist())
    return None if found is None else np.array(found)


def smallest_enclosing_circle(points: ArrayLike) -> tuple[Floats, float]:
    """Centre (2,) [m] and radius [m] of the smallest circle round points (n, 2) [m]; n >= 1."""
    array = np.asarray(points, float).reshape(-1, 2)
    xs, ys = array[:, 0].tolist(), array[:, 1].tolist()
    x, y = _least_excess(xs, ys, [0.0] * len(xs))
    return np.array([x, y]), max(math.hypot(x - px, y - py) for px, py in zip(xs, ys, strict=True))


def deepest_common_point(
    xs: Sequence[float], ys: Sequence[float], squared_radii: Sequence[float]
) -> tuple[float, float] | None:
    """`common_point` in plain floats, for the inner loop of the schemes."""
    if min(squared_radii) < 0:
        return None
    x, y = _least_excess(xs, ys, squared_radii)
    slack = (COORDINATE_TOLERANCE * (max(xs) - min(xs) + max(ys) - min(ys))) ** 2
    for px, py, r2 in zip(xs, ys, squared_radii, strict=True):
        if (x - px) ** 2 + (y - py) ** 2 > r2 * (1 + RELATIVE_TOLERANCE) + slack:
            return None
    return x, y


def last_is_apart(xs: Sequence[float], ys: Sequence[float], squared_radii: Sequence[float]) -> bool:
    """Whether the last disc shares no point with one of the others; quick, and enough to know that all share none."""
    x, y, r2 = xs[-1], ys[-1], squared_radii[-1]
    if min(squared_radii) < 0:
        return True
    return any(
        (x - u) ** 2 + (y - v) ** 2 > (r2 + s2 + 2 * math.sqrt(r2 * s2)) * (1 + 2 * RELATIVE_TOLERANCE)
        for u, v, s2 in zip(xs, ys, squared_radii, strict=True)
    )


def nearest_common_point(
    x: float, y: float, xs: Sequence[float], ys: Sequence[float], squared_radii: Sequence[float]
) -> tuple[float, float] | None:
    """The point nearest to (x, y) that all discs share, in plain floats.

    Found by pivoting, too: the nearest point is fixed by at most two discs, and as long as another one is missed,
    the one missed by most enters. None where there is no common point, or the region is so small (about a point)
    that rounding hides it.
    """
    if min(squared_radii) < 0:
        return None
    px, py, distance2 = x, y, 0.0
    basis: list[Disc] = []
    while True:
        worst, entering = 0.0, None
        for disc in zip(xs, ys, squared_radii, strict=True):
            u, v, r2 = disc
            excess = (px - u) ** 2 + (py - v) ** 2 - r2
            if excess > worst and excess > RELATIVE_TOLERANCE * r2:
                worst, entering = excess, disc
        if entering is None:
            return px, py
        if not basis:
            px, py = _nearest_on_circle(x, y, entering)
            distance2, basis = (px - x) ** 2 + (py - y) ** 2, [entering]
            continue
        best = math.inf
        candidates: list[tuple[tuple[Disc, ...], tuple[float, float]]] = []
        if (x - entering[0]) ** 2 + (y - entering[1]) ** 2 > entering[2]:
            candidates.append(((), _nearest_on_circle(x, y, entering)))
        for other in basis:
            candidates += [((other,), point) for point in _crossings(entering, other)]
        for others, (cx, cy) in candidates:
            apart2 = (cx - x) ** 2 + (cy - y) ** 2
            if apart2 < best and all(
                (cx - u) ** 2 + (cy - v) ** 2 <= r2 * (1 + RELATIVE_TOLERANCE) for u, v, r2 in basis
            ):
                best, kept, px, py = apart2, others, cx, cy
        if not distance2 < best < math.inf:
            return None
        distance2, basis = best, [*kept, entering]


def _nearest_on_circle(x: float, y: float, disc: Disc) -> tuple[float, float]:
    """The point of a disc's circle nearest to (x, y), which lies outside."""
    u, v, r2 = disc
    scale = math.sqrt(r2 / ((x - u) ** 2 + (y - v) ** 2))
    return u + (x - u) * scale, v + (y - v) * scale


def _crossings(disc: Disc, other: Disc) -> list[tuple[float, float]]:
    """The points where two circles cross; the touching point twice where rounding lets them just miss."""
    ax, ay, offset = _radical_axis(disc, other)
    length2 = ax * ax + ay * ay
    if length2 == 0:
        return []
    fx, fy = offset * ax / length2, offset * ay / length2
    across = math.sqrt(max(disc[2] - (fx * fx + fy * fy), 0.0) / length2)
    return [
        (disc[0] + fx - across * ay, disc[1] + fy + across * ax),
        (disc[0] + fx + across * ay, disc[1] + fy - across * ax),
    ]


def _least_excess(xs: Sequence[float], ys: Sequence[float], squared_radii: Sequence[float]) -> tuple[float, float]:
    """The point that minimises max_k (|v - u_k|^2 - r_k^2)."""
    # Relative to the first centre, so that coordinates far from the origin lose no digits.
    x0, y0 = xs[0], ys[0]
    discs = [(x - x0, y - y0, r2) for x, y, r2 in zip(xs, ys, squared_radii, strict=True)]
    basis = [discs[0]]
    x, y, value = 0.0, 0.0, -discs[0][2]
    while True:
        worst, entering = value, None
        for disc in discs:
            excess = (x - disc[0]) ** 2 + (y - disc[1]) ** 2 - disc[2]
            if excess > worst:
                worst, entering = excess, disc
        if entering is None:
            return x + x0, y + y0
        solution = _extended_basis(basis, entering)
        # The value of the basis grows with every disc that enters; where rounding stops that, it is exact enough.
        if solution is None or solution[2] <= value:
            return x + x0, y + y0
        x, y, value, basis = solution


def _extended_basis(basis: list[Disc], entering: Disc) -> tuple[float, float, float, list[Disc]] | None:
    """Solution (x, y, value, basis) for the discs of a basis and one more, which belongs to the new basis."""
    best = None
    everyone = [*basis, entering]
    for others in range(3):
        for chosen in combinations(basis, others):
            point = _equal_excess(entering, chosen)
            if point is None:
                continue
            x, y = point
            # Products, not powers: where rounding throws the point far away they are infinite, and raise nothing.
            value = max((x - u) * (x - u) + (y - v) * (y - v) - r2 for u, v, r2 in everyone)
            if best is None or value < best[2]:
                best = x, y, value, [*chosen, entering]
    return best


def _equal_excess(disc: Disc, others: tuple[Disc, ...]) -> tuple[float, float] | None:
    """The point nearest to the disc's centre whose excess is the same for the disc and the (at most 2) others."""
    if not others:
        return disc[0], disc[1]
    # |v - u_j|^2 - r_j^2 = |v - u|^2 - r^2 is the line 2 (u_j - u) . (v - u) = |u_j - u|^2 - r_j^2 + r^2.
    (ax, ay, a), *rest = [_radical_axis(disc, other) for other in others]
    if not rest:
        length2 = ax * ax + ay * ay
        return None if length2 == 0 else (disc[0] + a * ax / length2, disc[1] + a * ay / length2)
    bx, by, b = rest[0]
    det = ax * by - ay * bx
    return None if det == 0 else (disc[0] + (a * by - b * ay) / det, disc[1] + (ax * b - bx * a) / det)


def _radical_axis(disc: Disc, other: Disc) -> tuple[float, float, float]:
    """Coefficients (a, b, c) of the line a x + b y = c of equal excess, relative to the disc's centre."""
    dx, dy = other[0] - disc[0], other[1] - disc[1]
    return dx, dy, (dx * dx + dy * dy - other[2] + disc[2]) / 2


def close_pairs(points: NDArray[np.float64], distance: float) -> NDArray[np.int64]:
    """Pairs of points closer than a distance, (n, 2)."""
    if distance <= 0 or len(points) < 2:
        return np.empty((0, 2), np.int64)
    pairs = cKDTree(points).query_pairs(distance, output_type="ndarray")
    apart = np.hypot(*(points[pairs[:, 0]] - points[pairs[:, 1]]).T)
    close: NDArray[np.int64] = pairs[apart < distance].astype(np.int64)
    return close

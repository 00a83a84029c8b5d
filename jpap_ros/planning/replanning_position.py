"""The smallest move of a UAV that lets it serve its devices and keeps it away from the other UAVs."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from jpap_ros.planning.geometry import RELATIVE_TOLERANCE, Disc, deepest_common_point, nearest_common_point
from jpap_ros.planning.link_budget import Floats

Point = tuple[float, float]


def nearest_position(
    here: Point, discs: Sequence[Disc], others: Sequence[Point] = (), separation_m: float = 0.0
) -> Point | None:
    """The point nearest to `here` in all the discs and at least `separation_m` from all others.

    Parameters
    ----------
    here : (x, y)
        Where the UAV is [m].
    discs : sequence of (x, y, squared radius)
        Where it may be [m, m^2]; at least one, none empty.
    others : sequence of (x, y)
        Where the other UAVs hover [m].
    separation_m : float

    Returns
    -------
    (x, y) or None
        None where there is no such point.

    Notes
    -----
    The region is bounded by arcs. Its point nearest to `here` is `here` itself, or the nearest point of one of the
    circles, or a point where two circles cross: these are all tried.
    """
    xs, ys, radii = zip(*discs, strict=True)
    found = nearest_common_point(*here, xs, ys, radii) or deepest_common_point(xs, ys, radii)
    if found is None or separation_m == 0:
        return found
    if all(math.dist(found, other) >= separation_m for other in others):
        return found
    reach = min(math.sqrt(r2) for r2 in radii)
    x, y, _ = min(discs, key=lambda disc: disc[2])
    near = [other for other in others if math.dist(other, (x, y)) < reach + separation_m * (1 + RELATIVE_TOLERANCE)]
    # Just outside, so that rounding does not put the point inside.
    closed = [(u, v, (separation_m * (1 + RELATIVE_TOLERANCE)) ** 2) for u, v in near]
    tried = _corners(np.array(here), np.array([*discs, *closed]))
    inside = np.ones(len(tried), dtype=np.bool_)
    for u, v, r2 in discs:
        inside &= ((tried - (u, v)) ** 2).sum(axis=1) <= r2 * (1 + RELATIVE_TOLERANCE)
    for u, v in near:
        inside &= np.hypot(tried[:, 0] - u, tried[:, 1] - v) >= separation_m
    if not inside.any():
        return None
    allowed = tried[inside]
    best = allowed[((allowed - here) ** 2).sum(axis=1).argmin()]
    return float(best[0]), float(best[1])


def _corners(here: Floats, circles: Floats) -> Floats:
    """Nearest point of each circle (x, y, squared radius), and all points where two of them cross."""
    centre, r2 = circles[:, :2], circles[:, 2]
    away = here - centre
    length = np.linalg.norm(away, axis=1)
    # At the very centre every direction is as good.
    direction = np.where(length[:, None] > 0, away / np.where(length > 0, length, 1.0)[:, None], (1.0, 0.0))
    touching = centre + np.sqrt(r2)[:, None] * direction
    i, j = np.triu_indices(len(circles), k=1)
    axis = centre[j] - centre[i]
    d2 = (axis**2).sum(axis=1)
    safe = np.where(d2 > 0, d2, 1.0)
    along = (d2 + r2[i] - r2[j]) / (2 * safe)
    across2 = r2[i] / safe - along**2
    crossing = (d2 > 0) & (across2 >= 0)
    foot = centre[i] + along[:, None] * axis
    offset = np.sqrt(np.maximum(across2, 0.0))[:, None] * axis[:, ::-1] * (-1.0, 1.0)
    corners: Floats = np.concatenate([touching, (foot + offset)[crossing], (foot - offset)[crossing]])
    return corners

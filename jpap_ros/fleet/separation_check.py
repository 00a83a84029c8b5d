"""Least distance between moving aircraft, in closed form.

Two aircraft on one clock s, each on a straight line, have a relative position that is a straight line in s; its least
distance is that of a point to a segment, whatever s does with time. Two aircraft on different clocks are never closer
than the segments that they fly are.
"""

from __future__ import annotations

import numpy as np

from jpap_ros.fleet.arrays import Floats


def synchronous_distance(a0: Floats, a1: Floats, b0: Floats, b1: Floats) -> Floats:
    """Least distance [m] of a0 + s (a1 - a0) and b0 + s (b1 - b0) for the same s in [0, 1]; shapes (..., 3)."""
    return point_distance(np.zeros(3), a0 - b0, a1 - b1)


def overrun_distance(a0: Floats, a1: Floats, b0: Floats, b1: Floats, overrun: Floats | float) -> Floats:
    """Least distance [m] of two on one clock, where the first stops dead at any moment and the second overruns.

    Parameters
    ----------
    a0, a1, b0, b1 : (..., 3) float
        Ends of the legs of the first and of the second [m].
    overrun : float or (...) float
        Share of its leg, up to 1, that the second flies on at most; not beyond its end.

    Notes
    -----
    The first at share s and the second at s + d are w + s (u - v) - d v apart. With 0 <= d <= overrun and
    0 <= s <= 1 - d that is a flat quadrangle, and its distance to the origin is taken on an edge or inside.
    """
    w, along, across = a0 - b0, (a1 - a0) - (b1 - b0), -(b1 - b0)
    far = np.broadcast_to(np.asarray(overrun, dtype=np.float64)[..., None], w.shape)
    corners = w, w + along, w + (1 - far) * along + far * across, w + far * across
    origin = np.zeros(3)
    edges = [point_distance(origin, corners[k - 1], corners[k]) for k in range(4)]
    distance: Floats = np.minimum.reduce(edges)
    ss, sd, dd = _dot(along, along), _dot(along, across), _dot(across, across)
    ws, wd = _dot(w, along), _dot(w, across)
    area2 = ss * dd - sd * sd
    regular = area2 > 1e-12 * ss * dd
    scale = np.where(regular, area2, 1.0)
    s, d = (sd * wd - dd * ws) / scale, (sd * ws - ss * wd) / scale
    inside = regular & (d > 0) & (d < far[..., 0]) & (s > 0) & (s < 1 - d)
    foot = np.linalg.norm(w + s[..., None] * along + d[..., None] * across, axis=-1)
    return np.where(inside, np.minimum(distance, foot), distance)


def segment_distance(a0: Floats, a1: Floats, b0: Floats, b1: Floats) -> Floats:
    """Least distance [m] of any point of segment a0 a1 to any point of segment b0 b1; shapes (..., 3).

    It is taken either at an end of one of them, or at the feet of the common perpendicular of the two lines.
    """
    ends = np.minimum(
        np.minimum(point_distance(a0, b0, b1), point_distance(a1, b0, b1)),
        np.minimum(point_distance(b0, a0, a1), point_distance(b1, a0, a1)),
    )
    u, v, w = a1 - a0, b1 - b0, a0 - b0
    uu, uv, vv = _dot(u, u), _dot(u, v), _dot(v, v)
    uw, vw = _dot(u, w), _dot(v, w)
    area2 = uu * vv - uv * uv
    regular = area2 > 1e-12 * uu * vv
    scale = np.where(regular, area2, 1.0)
    s, t = (uv * vw - vv * uw) / scale, (uu * vw - uv * uw) / scale
    inside = regular & (s > 0) & (s < 1) & (t > 0) & (t < 1)
    feet = np.linalg.norm(w + s[..., None] * u - t[..., None] * v, axis=-1)
    distance: Floats = np.where(inside, np.minimum(ends, feet), ends)
    return distance


def polyline_distance(path: Floats, other: Floats) -> float:
    """Least distance [m] of two polylines, (k, 3) and (l, 3), each of one point or more."""
    a, b = _legs(path), _legs(other)
    return float(segment_distance(a[:, None, 0], a[:, None, 1], b[None, :, 0], b[None, :, 1]).min())


def _legs(path: Floats) -> Floats:
    closed = path if len(path) > 1 else np.repeat(path, 2, axis=0)
    return np.stack([closed[:-1], closed[1:]], axis=1)


def point_distance(point: Floats, start: Floats, end: Floats) -> Floats:
    """Least distance [m] of a point to a segment; shapes (..., 3)."""
    along = end - start
    length2 = _dot(along, along)
    s = np.clip(_dot(point - start, along) / np.where(length2 > 0, length2, 1.0), 0.0, 1.0)
    distance: Floats = np.linalg.norm(start + s[..., None] * along - point, axis=-1)
    return distance


def _dot(a: Floats, b: Floats) -> Floats:
    product: Floats = (a * b).sum(axis=-1)
    return product

"""The volume that no aircraft may be sent out of."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

Point = tuple[float, float]
Place = tuple[float, float, float]

#: What rounding may add to a way along an edge [m].
ROUNDING_M = 1e-6


@dataclass(frozen=True)
class Fence:
    """A circle or a polygon on the map, between two heights. What is not given does not limit.

    Attributes
    ----------
    center_m, radius_m : (east, north) and float, or None
        Circle [m].
    polygon_m : tuple of (east, north)
        Corners in order, not closed [m]; empty if there is no polygon.
    min_height_m, max_height_m : float
        Above the ground, map z [m].

    Raises
    ------
    ValueError
        If a number is not finite or out of range, both shapes are given, or the polygon has no inside.
    """

    center_m: Point | None = None
    radius_m: float | None = None
    polygon_m: tuple[Point, ...] = ()
    min_height_m: float = 0.0
    max_height_m: float = math.inf

    def __post_init__(self) -> None:
        if (self.center_m is None) != (self.radius_m is None):
            raise ValueError("circle must have both center and radius_m")
        if self.center_m is not None and self.polygon_m:
            raise ValueError("must have a circle or a polygon, not both")
        if self.radius_m is not None and not 0.0 < self.radius_m < math.inf:
            raise ValueError(f"circle.radius_m must be positive and finite, got {self.radius_m!r}")
        for point in (*self.polygon_m, *([self.center_m] if self.center_m else [])):
            if not all(map(math.isfinite, point)):
                raise ValueError(f"points must be finite, got {point!r}")
        if not 0.0 <= self.min_height_m < math.inf:
            raise ValueError(f"min_height_m must be finite and not negative, got {self.min_height_m!r}")
        if not self.max_height_m > self.min_height_m:
            raise ValueError(
                f"max_height_m must be above min_height_m ({self.min_height_m!r}), got {self.max_height_m!r}"
            )
        if self.polygon_m:
            _check_polygon(self.polygon_m)

    def breach(self, east_m: float, north_m: float, height_m: float) -> str | None:
        """Say in words and numbers how a position lies outside, or None if it lies inside or on the edge."""
        if not all(map(math.isfinite, (east_m, north_m, height_m))):
            return f"position ({east_m!r}, {north_m!r}, {height_m!r}) is not finite"
        if height_m < self.min_height_m:
            return f"height {height_m:.1f} m is below the fence's minimum of {self.min_height_m:.1f} m"
        if height_m > self.max_height_m:
            return f"height {height_m:.1f} m is above the fence's maximum of {self.max_height_m:.1f} m"
        if self.center_m is not None and self.radius_m is not None:
            distance = math.dist((east_m, north_m), self.center_m)
            if distance > self.radius_m:
                return f"{distance:.1f} m from the fence's centre is outside its radius of {self.radius_m:.1f} m"
        elif self.polygon_m and not _inside((east_m, north_m), self.polygon_m):
            return f"({east_m:.1f}, {north_m:.1f}) m is outside the fence's polygon"
        return None

    def outside_m(self, place: Place) -> float:
        """How far outside a place is, (east, north, up) [m]: across or in height, whichever is more; 0 inside."""
        return max(self._across_m(place[:2]), self._off_height_m(place[2]))

    def lets_pass(self, start: Place, end: Place) -> bool:
        """Whether a straight leg stays inside; one that begins outside may lead in, but nowhere farther out.

        Notes
        -----
        Exact. Along a straight leg the distance to a convex thing (the heights, the circle, an edge of the polygon) is
        largest at one of its ends. The polygon's edges cut the leg into pieces that are each inside or outside
        as a whole; a piece outside is no farther from the polygon than its ends are from any one of the edges.
        """
        if self._off_height_m(end[2]) > max(self._off_height_m(start[2]), ROUNDING_M):
            return False
        a, b = start[:2], end[:2]
        if not self.polygon_m:
            return self._across_m(b) <= max(self._across_m(a), ROUNDING_M)
        edges = list(pairwise((*self.polygon_m, self.polygon_m[0])))
        cuts = sorted({0.0, 1.0, *(share for c, d in edges for share in _cuts(a, b, c, d))})
        allowed_m = max(self._across_m(a), ROUNDING_M)
        for first, last in pairwise(cuts):
            if _inside(_between(a, b, (first + last) / 2), self.polygon_m):
                allowed_m = ROUNDING_M
                continue
            ends = _between(a, b, first), _between(a, b, last)
            if min(max(_distance(c, d, point) for point in ends) for c, d in edges) > allowed_m:
                return False
        return True

    def _off_height_m(self, height_m: float) -> float:
        return max(self.min_height_m - height_m, height_m - self.max_height_m, 0.0)

    def _across_m(self, point: Point) -> float:
        if self.center_m is not None and self.radius_m is not None:
            return max(math.dist(point, self.center_m) - self.radius_m, 0.0)
        if not self.polygon_m or _inside(point, self.polygon_m):
            return 0.0
        return min(_distance(a, b, point) for a, b in pairwise((*self.polygon_m, self.polygon_m[0])))


def _check_polygon(corners: tuple[Point, ...]) -> None:
    if len(corners) < 3:
        raise ValueError(f"polygon must have at least 3 corners, got {len(corners)}")
    if len(set(corners)) < len(corners):
        raise ValueError("polygon must not have the same corner twice (nor repeat the first at its end)")
    edges = list(pairwise((*corners, corners[0])))
    for i, (a, b) in enumerate(edges):
        for c, d in edges[i + 1 :]:
            # Neighbouring edges share a corner and may only meet there.
            shared = {a, b} & {c, d}
            if not shared and _touch(a, b, c, d):
                raise ValueError(f"polygon must not cross itself, but its edges {a}-{b} and {c}-{d} meet")
            if shared and len(corners) > 2:
                middle = shared.pop()
                start, end = (p for p in (a, b, c, d) if p != middle)
                if _side(middle, start, end) == 0.0 and math.dist(start, end) < max(
                    math.dist(start, middle), math.dist(middle, end)
                ):
                    raise ValueError(f"polygon must not turn back on itself at its corner {middle}")


def _side(a: Point, b: Point, p: Point) -> float:
    """Twice the signed area of the triangle a, b, p: positive if p lies left of the line from a to b."""
    return (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])


def _on_segment(a: Point, b: Point, p: Point) -> bool:
    return (
        _side(a, b, p) == 0.0
        and min(a[0], b[0]) <= p[0] <= max(a[0], b[0])
        and min(a[1], b[1]) <= p[1] <= max(a[1], b[1])
    )


def _touch(a: Point, b: Point, c: Point, d: Point) -> bool:
    if _side(a, b, c) * _side(a, b, d) < 0.0 and _side(c, d, a) * _side(c, d, b) < 0.0:
        return True
    return _on_segment(a, b, c) or _on_segment(a, b, d) or _on_segment(c, d, a) or _on_segment(c, d, b)


def _inside(point: Point, corners: tuple[Point, ...]) -> bool:
    """Even-odd rule: a ray to the east crosses the edges an odd number of times."""
    inside = False
    for a, b in pairwise((*corners, corners[0])):
        if _on_segment(a, b, point):
            return True
        if (a[1] > point[1]) != (b[1] > point[1]):
            crossing_east = a[0] + (point[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
            if point[0] < crossing_east:
                inside = not inside
    return inside


def _between(a: Point, b: Point, share: float) -> Point:
    return a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])


def _cuts(a: Point, b: Point, c: Point, d: Point) -> list[float]:
    """Shares of the leg from a to b at which it may cross the edge c d, or pass one of its ends."""
    start, end = _side(c, d, a), _side(c, d, b)
    if start * end < 0.0:
        return [start / (start - end)]
    along = b[0] - a[0], b[1] - a[1]
    length2 = along[0] ** 2 + along[1] ** 2
    if start == end == 0.0 and length2 > 0.0:
        shares = [((p[0] - a[0]) * along[0] + (p[1] - a[1]) * along[1]) / length2 for p in (c, d)]
        return [share for share in shares if 0.0 < share < 1.0]
    return []


def _distance(a: Point, b: Point, p: Point) -> float:
    """Distance of a point to the edge a b."""
    along = b[0] - a[0], b[1] - a[1]
    length2 = along[0] ** 2 + along[1] ** 2
    share = ((p[0] - a[0]) * along[0] + (p[1] - a[1]) * along[1]) / length2
    return math.dist(p, _between(a, b, min(max(share, 0.0), 1.0)))

"""DRMP: the best position of one UAV, problem P3, equations (12) to (22).

The rate of device k is log2(1 + c_k / q) with q = |v - u_k|^2 + H^2 and c_k = P_k eta. It is convex and decreasing
in s = |v - u_k|^2, and two bounds follow, whose sums over the devices are quadratics in v with equal curvature in all
directions, hence maximised in closed form:

* its tangent in s at the present position is a lower bound, tight there (what the tau/beta bound (13) does for the
  paper). Maximised over the feasible region again and again, it climbs to a local optimum (`_Cell.climb`), from whose
  curvature follows how far round it nothing is better (`_Cell.settled_radius`);
* its chord in s over a box is an upper bound there, and the gap shrinks with the square of the box. Branch and bound
  over the boxes farther off (`_Cell.improve`) therefore proves that nothing better than `RATE_TOLERANCE` is left, or
  finds it.

The paper's cases are the same code here: where d_sv < H the rate is concave and the climb settles most of the region;
where d_sv >= H the branch and bound is what its exhaustive search of the outer region stands for. Two devices have
their optimum in closed form (`placement_of_two`).

The best position lies in the bounding box of the devices: moved to the nearest point of their convex hull, a UAV
comes closer to every one of them.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from jpap_ros.planning.allocation import Allocation
from jpap_ros.planning.geometry import RELATIVE_TOLERANCE, deepest_common_point, nearest_common_point
from jpap_ros.planning.link_budget import Floats, LinkBudget, snr_demand
from jpap_ros.planning.placement_of_two import best_of_two

#: The position found gives at most this much less than the best one [bit/s/Hz].
RATE_TOLERANCE = 9e-4
#: A climb ends when a step is shorter than this part of the altitude: a local optimum to far below RATE_TOLERANCE.
STEP_TOLERANCE = 2e-5
#: Most steps of one climb. It only costs time where a climb ends early: the branch and bound still decides.
MAX_STEPS = 60
#: Radii that are tried to find how far round a local optimum nothing is better.
SETTLING_ATTEMPTS = 3
#: Side of a box, in parts of the altitude, below which the rate hardly varies within it.
SMALL_BOX = 0.25
#: Most circles whose constraint enters the bound of one box.
MAX_MULTIPLIERS = 4
LN2 = math.log(2)

#: West, east, south and north side [m].
Box = tuple[float, float, float, float]
#: weight, (wx, wy) and (hxx, hxy, hyy): the rate's gradient is -2 (wx, wy), its Hessian -2 (weight I - h).
Slopes = tuple[float, float, float, float, float, float]


def best_position(positions: ArrayLike, rates: ArrayLike, allocation: Allocation, link: LinkBudget) -> Floats | None:
    """The best position of one UAV that serves all of these devices, or None where there is none.

    Parameters
    ----------
    positions : (n, 2) array_like
        Device positions [m]; n >= 1.
    rates : (n,) array_like
        Demanded rates [bit/s/Hz].
    allocation : Allocation
        How the UAV splits its power.
    link : LinkBudget
        The channel.

    Returns
    -------
    (2,) float or None
        Position in every device's coverage radius, whose sum rate (12a) is within `RATE_TOLERANCE` of the largest.
    """
    points = np.asarray(positions, float).reshape(-1, 2)
    height2 = link.altitude_m**2
    strengths, radii = allocation.split(snr_demand(rates).tolist(), link.power_eta, height2)
    found = place(points[:, 0].tolist(), points[:, 1].tolist(), strengths, radii, height2)
    return None if found is None else np.array(found)


def place(
    xs: Sequence[float],
    ys: Sequence[float],
    strengths: Sequence[float],
    squared_radii: Sequence[float],
    height2: float,
    start: tuple[float, float] | None = None,
) -> tuple[float, float] | None:
    """`best_position` in plain floats, for the inner loop of the schemes.

    Parameters
    ----------
    xs, ys : sequence of float
        Device positions [m].
    strengths, squared_radii : sequence of float
        c_k = P_k eta and d_k^2 [m^2], see `Allocation.split`.
    height2 : float
        H^2 [m^2].
    start : tuple of float, optional
        Where the UAV is now; the local optimum reached from there is kept unless another position is better by
        more than `RATE_TOLERANCE`. At large SNR two devices have two optima of almost the same rate, one near each;
        this decides between them. Default: the point deepest in the coverage discs.
    """
    feasible = None if start is None else nearest_common_point(*start, xs, ys, squared_radii)
    if feasible is None:
        feasible = deepest_common_point(xs, ys, squared_radii)
    if feasible is None:
        return None
    if len(xs) == 1:
        return xs[0], ys[0]
    if len(xs) == 2:
        found = best_of_two(xs, ys, strengths, squared_radii, height2, feasible, RATE_TOLERANCE * LN2)
        if found is not None:
            return found
    # In a frame along the longest way from the first device, two devices (or any on one line) need boxes in one
    # dimension only; and coordinates far from the origin lose no digits.
    x0, y0 = xs[0], ys[0]
    ways = [(x - x0, y - y0) for x, y in zip(xs, ys, strict=True)]
    length, ex, ey = max([(math.hypot(dx, dy), dx, dy) for dx, dy in ways])
    if length == 0:
        return x0, y0
    ex, ey = ex / length, ey / length
    along = [dx * ex + dy * ey for dx, dy in ways]
    across = [dy * ex - dx * ey for dx, dy in ways]

    px, py = feasible[0] - x0, feasible[1] - y0
    cell = _Cell(along, across, strengths, squared_radii, height2, (px * ex + py * ey, py * ex - px * ey))
    p, q = cell.best()
    return x0 + p * ex - q * ey, y0 + p * ey + q * ex


class _Cell:
    """The devices of one UAV, for which there is a feasible position."""

    def __init__(
        self,
        xs: Sequence[float],
        ys: Sequence[float],
        strengths: Sequence[float],
        squared_radii: Sequence[float],
        height2: float,
        feasible: tuple[float, float],
    ) -> None:
        self.xs, self.ys, self.squared_radii, self.feasible = xs, ys, squared_radii, feasible
        self.height2 = height2
        self.step2 = STEP_TOLERANCE**2 * height2
        self.small_side = SMALL_BOX * math.sqrt(height2)
        self.tolerance = RATE_TOLERANCE * LN2
        self.largest2 = max(squared_radii)
        self.devices = list(zip(xs, ys, strengths, squared_radii, strict=True))

    def best(self) -> tuple[float, float]:
        """The best position."""
        return self.improve(*self.climb(*self.feasible))

    def nearest(self, x: float, y: float) -> tuple[float, float]:
        """The feasible position nearest to (x, y)."""
        return nearest_common_point(x, y, self.xs, self.ys, self.squared_radii) or self.feasible

    def covers(self, x: float, y: float) -> bool:
        """Whether (x, y) lies in every coverage radius."""
        return all((x - u) ** 2 + (y - v) ** 2 <= r2 for u, v, _, r2 in self.devices)

    def value(self, x: float, y: float) -> float:
        """Sum rate (12a) [nat/s/Hz]."""
        product = 1.0
        total = 0.0
        for u, v, c, _ in self.devices:
            product *= 1 + c / ((x - u) ** 2 + (y - v) ** 2 + self.height2)
            if product > 1e200:
                total += math.log(product)
                product = 1.0
        return total + math.log(product)

    def slopes(self, x: float, y: float) -> Slopes:
        """First and second derivatives of the rate at (x, y)."""
        height2 = self.height2
        weight = wx = wy = hxx = hxy = hyy = 0.0
        for u, v, c, _ in self.devices:
            dx, dy = x - u, y - v
            q = dx * dx + dy * dy + height2
            slope = c / (q * (q + c))
            weight += slope
            wx += slope * dx
            wy += slope * dy
            bend = 2 * slope * (1 / q + 1 / (q + c))
            hxx += bend * dx * dx
            hxy += bend * dx * dy
            hyy += bend * dy * dy
        return weight, wx, wy, hxx, hxy, hyy

    def climb(self, x: float, y: float) -> tuple[float, float, float]:
        """The local optimum reached from (x, y), and its `settled_radius`; 0 where the climb ended early."""
        rate = self.value(x, y)
        for _ in range(MAX_STEPS):
            slopes = self.slopes(x, y)
            step = self.newton_step(x, y, rate, slopes) or self.gradient_step(x, y, rate, slopes)
            if step is None:
                break
            tx, ty, rate = step
            step2 = (tx - x) ** 2 + (ty - y) ** 2
            x, y = tx, ty
            if step2 <= self.step2:
                return x, y, self.settled_radius(x, y, slopes)
        return x, y, 0.0

    def newton_step(self, x: float, y: float, rate: float, slopes: Slopes) -> tuple[float, float, float] | None:
        """Newton's step to a position and its rate; None where it is not sure to gain what the tangent bound does."""
        weight, wx, wy, hxx, hxy, hyy = slopes
        a, b = weight - hxx, weight - hyy
        det = a * b - hxy * hxy
        if det <= 0 or a <= 0:
            return None
        x, y = x - (b * wx + hxy * wy) / det, y - (a * wy + hxy * wx) / det
        if not self.covers(x, y):
            return None
        there = self.value(x, y)
        return (x, y, there) if there >= rate + (wx * wx + wy * wy) / weight else None

    def gradient_step(self, x: float, y: float, rate: float, slopes: Slopes) -> tuple[float, float, float] | None:
        """A step to the feasible position, and its rate, where a round parabola tangent to the rate is highest.

        With the rate's own curvature across its slope, it is Newton's step along a circle that the slope pushes
        against. With the curvature of the tangent bound, it always leads higher.
        """
        weight, wx, wy, hxx, hxy, hyy = slopes
        slope2 = wx * wx + wy * wy
        across = weight - (wy * wy * hxx - 2 * wx * wy * hxy + wx * wx * hyy) / slope2 if slope2 > 0 else weight
        for curvature in (across, weight) if across > 0 else (weight,):
            sx, sy = -wx / curvature, -wy / curvature
            feasible = nearest_common_point(x + sx, y + sy, self.xs, self.ys, self.squared_radii)
            if feasible is None:
                continue
            dx, dy = feasible[0] - x, feasible[1] - y
            gain = curvature * (2 * (sx * dx + sy * dy) - dx * dx - dy * dy)
            there = self.value(*feasible)
            if there >= rate + gain / 2 or curvature == weight:
                return *feasible, there
        return None

    def settled_radius(self, x: float, y: float, slopes: Slopes) -> float:
        """A radius round a local optimum in which no feasible position is better.

        Up to a distance R, a way d changes the rate by at most g . d - curvature |d|^2 / 2 + G |d|^3 / 6:

        * The gradient g is a sum of m_k (v - u_k) over the circles on which v lies, with m_k >= 0. A feasible d has
          2 (v - u_k) . d <= -|d|^2 for each of them, and no |v - u_k| exceeds the largest radius r; hence
          g . d <= -|g| |d|^2 / (2 r). As |g . d| <= |g| R, also g . d <= -(g . d)^2 / (|g| R). Half of each is taken:
          the first adds |g| / (2 r) to the curvature in all directions, the second |g| / R to that along g.
        * The third derivative of log(|v - u|^2 + h^2) in any direction is at most 4 / (|v - u|^2 + h^2)^1.5. G sums
          that up: 7/8 of its bound within R / 2, as much as the nearer half counts, and 1/8 of that within R.

        With the least curvature c of all directions, nothing is better up to 3 c / G.
        """
        weight, wx, wy, hxx, hxy, hyy = slopes
        slope = math.sqrt(wx * wx + wy * wy)
        nx, ny = (wx / slope, wy / slope) if slope > 0 else (0.0, 0.0)
        bent = weight + (slope / (2 * math.sqrt(self.largest2)) if self.largest2 > 0 else 0.0)
        radius, settled = math.sqrt(self.height2), 0.0
        for _ in range(SETTLING_ATTEMPTS):
            inward = slope / radius
            a, b, mixed = bent - hxx + inward * nx * nx, bent - hyy + inward * ny * ny, inward * nx * ny - hxy
            curvature = a + b - math.sqrt((a - b) ** 2 + 4 * mixed * mixed)
            growth = 7 / 8 * self.largest_growth(x, y, radius / 2) + self.largest_growth(x, y, radius) / 8
            settled = max(settled, min(radius, 3 * curvature / growth))
            if settled == radius:
                break
            radius = (radius + settled) / 2
        return settled

    def largest_growth(self, x: float, y: float, radius: float) -> float:
        """Bound of the third derivative of the rate, in any direction, within a radius of (x, y)."""
        height2 = self.height2
        growth = 0.0
        for u, v, c, _ in self.devices:
            apart = math.sqrt((x - u) ** 2 + (y - v) ** 2) - radius
            q = apart * apart + height2 if apart > 0 else height2
            growth += 4 / (q * math.sqrt(q)) + 4 / ((q + c) * math.sqrt(q + c))
        return growth

    def improve(self, x: float, y: float, radius: float) -> tuple[float, float]:
        """Branch and bound: a position to which none is better by more than the tolerance."""
        target = self.value(x, y) + self.tolerance
        cx, cy, settled2 = x, y, radius * radius
        west, east, south, north = min(self.xs), max(self.xs), min(self.ys), max(self.ys)
        for u, v, _, r2 in self.devices:
            r = math.sqrt(r2)
            west, east, south, north = max(west, u - r), min(east, u + r), max(south, v - r), min(north, v + r)
        boxes: list[tuple[float, float, float, float, float, float, float]] = []
        # Cut out at once, what is settled leaves larger boxes than halving does that closes in on it.
        fresh = _cut_out((west, east, south, north), x, y, radius * math.sqrt(0.5))
        while True:
            for box in fresh:
                west, east, south, north = box
                dx, dy = max(cx - west, east - cx), max(cy - south, north - cy)
                if dx * dx + dy * dy <= settled2:
                    continue
                bound, px, py = self.bound(*box, target)
                if bound > target:
                    heapq.heappush(boxes, (-bound, px, py, *box))
            if not boxes:
                return x, y
            bound, px, py, west, east, south, north = heapq.heappop(boxes)
            if -bound <= target:
                return x, y
            # A position is tried where it may lift the target above the bound, or where the box is so small that the
            # bound is near what its positions give. Without the second, a box better than the target by far would be
            # split for ever.
            if -bound - target <= self.tolerance or max(east - west, north - south) <= self.small_side:
                px, py = self.nearest(px, py)
                if self.value(px, py) > target:
                    x, y, _ = self.climb(px, py)
                    target = self.value(x, y) + self.tolerance
            if east - west >= north - south:
                middle = (west + east) / 2
                fresh = [(west, middle, south, north), (middle, east, south, north)]
            else:
                middle = (south + north) / 2
                fresh = [(west, east, south, middle), (west, east, middle, north)]

    def bound(self, west: float, east: float, south: float, north: float, target: float) -> tuple[float, float, float]:
        """Upper bound of the sum rate in a box [nat/s/Hz], and the point of the box that attains the bound.

        The bound is made no tighter than `target`.
        """
        height2 = self.height2
        log = math.log
        top = weight = wx = wy = ww = 0.0
        for u, v, c, r2 in self.devices:
            dw, de, ds, dn = west - u, u - east, south - v, v - north
            dx = dw if dw > 0 else de if de > 0 else 0.0
            dy = ds if ds > 0 else dn if dn > 0 else 0.0
            low = dx * dx + dy * dy
            if low > r2 * (1 + RELATIVE_TOLERANCE):
                return -math.inf, west, south
            dx = dw if dw < de else de
            dy = ds if ds < dn else dn
            high = dx * dx + dy * dy
            if high > r2:
                high = r2
            q = low + height2
            rate = log(1 + c / q)
            if high - low > 1e-6 * q:
                slope = (rate - log(1 + c / (high + height2))) / (high - low)
            else:
                slope = c / (q * (q + c))
            top += rate + slope * low
            weight += slope
            # Relative to the box: where H is small, the squares of large coordinates would leave nothing of `top`.
            wx -= slope * dw
            wy -= slope * ds
            ww += slope * (dw * dw + ds * ds)
        # The sum of the chords is top - weight |p - centre|^2.
        x, y = wx / weight, wy / weight
        top -= ww - weight * (x * x + y * y)
        x, y = west + x, south + y
        for _ in range(MAX_MULTIPLIERS):
            px = west if x < west else east if x > east else x
            py = south if y < south else north if y > north else y
            bound = top - weight * ((px - x) ** 2 + (py - y) ** 2)
            if bound <= target:
                return bound, px, py
            worst = 0.0
            for u, v, _, r2 in self.devices:
                excess = (px - u) ** 2 + (py - v) ** 2 - r2
                if excess > worst and excess > RELATIVE_TOLERANCE * r2:
                    worst, wu, wv, wr2 = excess, u, v, r2
            if worst == 0:
                return bound, px, py
            # The point lies in no feasible position: add multiplier * (r^2 - |p - u|^2), which is not negative in
            # any, with the multiplier that puts the centre on that circle (the paper's Lagrange function, with the
            # multiplier in closed form).
            away2 = (x - wu) ** 2 + (y - wv) ** 2
            if away2 <= wr2 * (1 + RELATIVE_TOLERANCE) or wr2 == 0:
                break
            ratio = math.sqrt(away2 / wr2)
            top -= weight * away2 * (1 - 1 / ratio) ** 2
            x, y = wu + (x - wu) / ratio, wv + (y - wv) / ratio
            weight *= ratio
        return bound, px, py


def _cut_out(box: Box, x: float, y: float, half: float) -> list[Box]:
    """What is left of a box without the square of half a side `half` round (x, y), in at most four boxes."""
    if half == 0:
        return [box]
    west, east, south, north = box
    left, right = max(x - half, west), min(x + half, east)
    rest = []
    if west < left:
        rest.append((west, left, south, north))
    if right < east:
        rest.append((right, east, south, north))
    if south < y - half:
        rest.append((left, right, south, y - half))
    if y + half < north:
        rest.append((left, right, y + half, north))
    return rest

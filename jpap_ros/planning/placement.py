"""DRMP: the best position of one UAV, problem P3, equations (12) to (22).

The rate of device k is log2(1 + c_k / q) with q = |v - u_k|^2 + H^2 and c_k = P_k eta. It is convex and decreasing
in s = |v - u_k|^2, and two bounds follow, whose sums over the devices are quadratics in v with equal curvature in all
directions, hence maximised in closed form:

* its tangent in s at the present position is a lower bound, tight there (what the tau/beta bound (13) does for the
  paper). Maximised over the feasible region again and again, it climbs to a local optimum (`_climb`);
* its chord in s over a box is an upper bound there, and the gap shrinks with the square of the box. Branch and bound
  over boxes (`_improve`) therefore proves that nothing better than `RATE_TOLERANCE` is left, or finds it.

The paper's cases are the same code here: where d_sv < H the region is convex and the first bound decides quickly;
where d_sv >= H the branch and bound is what its exhaustive search of the outer region stands for.

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

#: The position found gives at most this much less than the best one [bit/s/Hz].
RATE_TOLERANCE = 9e-4
#: A climb ends when a step is shorter than this part of the altitude: a local optimum to far below RATE_TOLERANCE.
STEP_TOLERANCE = 2e-7
#: Most steps of one climb. It only costs time where a climb ends early: the branch and bound still decides.
MAX_STEPS = 60
#: Side of a box, in parts of the altitude, below which the rate hardly varies within it.
SMALL_BOX = 0.25
#: Most circles whose constraint enters the bound of one box.
MAX_MULTIPLIERS = 4


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
    # In a frame along the longest way from the first device, two devices (or any on one line) need boxes in one
    # dimension only; and coordinates far from the origin lose no digits.
    x0, y0 = xs[0], ys[0]
    far2, ex, ey = max(((x - x0) ** 2 + (y - y0) ** 2, x - x0, y - y0) for x, y in zip(xs, ys, strict=True))
    if far2 == 0:
        return x0, y0
    length = math.sqrt(far2)
    ex, ey = ex / length, ey / length
    along = [(x - x0) * ex + (y - y0) * ey for x, y in zip(xs, ys, strict=True)]
    across = [(y - y0) * ex - (x - x0) * ey for x, y in zip(xs, ys, strict=True)]

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

    def climb(self, x: float, y: float) -> tuple[float, float, float]:
        """The local optimum reached from (x, y), and a radius round it in which the rate is concave.

        A local optimum of a concave function over a convex region is its optimum there: within that radius no
        feasible position is better. 0 where the climb ended early or the rate is not concave at its end.
        """
        height2 = self.height2
        for _ in range(MAX_STEPS):
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
            # Maximum of the tangent bound; its gradient is -2 (wx, wy), its curvature -2 weight.
            sx, sy = -wx / weight, -wy / weight
            tx, ty = self.nearest(x + sx, y + sy)
            if (tx, ty) == (x + sx, y + sy):
                # Away from the circles: Newton's step, where the rate is concave and the step in proportion.
                a, b = weight - hxx, weight - hyy
                det = a * b - hxy * hxy
                if det > 0 and a > 0:
                    nx, ny = -(b * wx + hxy * wy) / det, -(a * wy + hxy * wx) / det
                    if nx * nx + ny * ny <= 9 * (sx * sx + sy * sy) and self.covers(x + nx, y + ny):
                        tx, ty = x + nx, y + ny
            step2 = (tx - x) ** 2 + (ty - y) ** 2
            x, y = tx, ty
            if step2 <= self.step2:
                mean, half = weight - (hxx + hyy) / 2, (hxx - hyy) / 2
                return x, y, self.concave_radius(x, y, 2 * (mean - math.sqrt(half * half + hxy * hxy)))
        return x, y, 0.0

    def concave_radius(self, x: float, y: float, curvature: float) -> float:
        """A radius round (x, y) in which the rate is concave, where its Hessian is at most -curvature at (x, y).

        The third derivative of log(|v - u|^2 + h^2) in any direction is at most 4 / (|v - u|^2 + h^2)^1.5; the largest
        eigenvalue of the Hessian grows by no more than the sum of these with the distance.
        """
        height2 = self.height2
        radius = math.sqrt(height2)
        for _attempt in range(6):
            growth = 0.0
            for u, v, c, _ in self.devices:
                apart = math.sqrt((x - u) ** 2 + (y - v) ** 2) - radius
                q = apart * apart + height2 if apart > 0 else height2
                growth += 4 / (q * math.sqrt(q)) + 4 / ((q + c) * math.sqrt(q + c))
            if radius * growth <= 0.999 * curvature:
                return radius
            radius *= 0.7
        return 0.0

    def improve(self, x: float, y: float, radius: float) -> tuple[float, float]:
        """Branch and bound: a position to which none is better by more than the tolerance."""
        tolerance = RATE_TOLERANCE * math.log(2)
        target = self.value(x, y) + tolerance
        cx, cy, settled2 = x, y, radius * radius
        roots = [math.sqrt(r2) for r2 in self.squared_radii]
        west = max(min(self.xs), max(u - r for u, r in zip(self.xs, roots, strict=True)))
        east = min(max(self.xs), min(u + r for u, r in zip(self.xs, roots, strict=True)))
        if len(self.devices) == 2 and (pair := self.best_of_two(west, east)) is not None:
            px, bound = pair
            if bound <= target:
                return x, y
            if self.covers(px, 0.0):
                # Newton's steps may lead astray.
                return max((px, 0.0), self.climb(px, 0.0)[:2], key=lambda place: self.value(*place))
        south = max(min(self.ys), max(v - r for v, r in zip(self.ys, roots, strict=True)))
        north = min(max(self.ys), min(v + r for v, r in zip(self.ys, roots, strict=True)))
        boxes: list[tuple[float, float, float, float, float, float, float]] = []
        fresh = [(west, east, south, north)]
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
            if -bound - target <= tolerance or max(east - west, north - south) <= self.small_side:
                px, py = self.nearest(px, py)
                found = self.value(px, py)
                if found > target:
                    x, y, _ = self.climb(px, py)
                    value = self.value(x, y)
                    if value < found:  # Newton's steps may lead astray.
                        x, y, value = px, py, found
                    target = value + tolerance
            if east - west >= north - south:
                middle = (west + east) / 2
                fresh = [(west, middle, south, north), (middle, east, south, north)]
            else:
                middle = (south + north) / 2
                fresh = [(west, east, south, middle), (west, east, middle, north)]

    def best_of_two(self, west: float, east: float) -> tuple[float, float] | None:
        """The best position between two devices, and a bound on every rate there [nat/s/Hz]; None at low SNR.

        The rate of two devices is the sum of log(q_k + c_k) - log(q_k). Where c_k is so large that the first hardly
        varies, the second decides, and the product q_1 q_2 is a quartic along the line of the two: least in its middle
        where they are nearer than 2 H, else at two places as far from both ends.
        """
        (u1, _, c1, _), (u2, _, c2, _) = self.devices
        height2 = self.height2
        span2 = (east - west) ** 2 + (u2 - u1) ** 2
        # By how much log(q_1 + c_1) + log(q_2 + c_2) can vary over the feasible interval.
        slack = span2 / c1 + span2 / c2
        if slack > RATE_TOLERANCE / 8:
            return None
        middle, quarter = (u1 + u2) / 2, (u2 - u1) ** 2 / 4 - height2
        off = math.sqrt(quarter) if quarter > 0 else 0.0
        places = (min(max(middle - off, west), east), min(max(middle + off, west), east))
        best, value = max(((place, self.value(place, 0.0)) for place in places), key=lambda pair: pair[1])
        return best, value + slack

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
            wx += slope * u
            wy += slope * v
            ww += slope * (u * u + v * v)
        # The sum of the chords is top - weight |p - centre|^2.
        x, y = wx / weight, wy / weight
        top -= ww - weight * (x * x + y * y)
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

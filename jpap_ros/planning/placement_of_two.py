"""DRMP for two devices, more than half of all placements at the paper's density, in closed form."""

from __future__ import annotations

import math
from collections.abc import Sequence


def best_of_two(
    xs: Sequence[float],
    ys: Sequence[float],
    strengths: Sequence[float],
    squared_radii: Sequence[float],
    height2: float,
    present: tuple[float, float],
    tolerance: float,
) -> tuple[float, float] | None:
    """The best position of two devices; None at low SNR, where the closed form is not good enough.

    The rate of two devices is the sum of log(q_k + c_k) - log(q_k). Where c_k is so large that the first hardly
    varies, the second decides, and the product q_1 q_2 is a quartic along the line of the two: least in its middle
    where they are nearer than 2 H, else at two places as far from both ends. Of these, the one on the side of
    the present position is the local optimum reached from there.

    Parameters
    ----------
    xs, ys, strengths, squared_radii, height2
        See `placement.place`; the coverage discs share a point.
    present : tuple of float
        A feasible position.
    tolerance : float
        The present side is kept unless the other is better by more than this [nat/s/Hz].
    """
    (x1, x2), (y1, y2), (c1, c2) = xs, ys, strengths
    ex, ey = x2 - x1, y2 - y1
    span2 = ex * ex + ey * ey
    if span2 == 0:
        return x1, y1
    span = math.sqrt(span2)
    # Places along the line, from the first device; both are feasible between these two.
    low, high = max(0.0, span - math.sqrt(squared_radii[1])), min(span, math.sqrt(squared_radii[0]))
    # Between the devices, neither log(q_k + c_k) varies by more than span2 / c_k.
    slack = 2 * span2 / min(c1, c2)
    if low > high or slack > tolerance / 4:
        return None

    def rate(place: float) -> float:
        q1, q2 = place * place + height2, (span - place) ** 2 + height2
        return math.log(1 + c1 / q1) + math.log(1 + c2 / q2)

    middle, quarter = span / 2, span2 / 4 - height2
    off = math.sqrt(quarter) if quarter > 0 else 0.0
    if (present[0] - x1) * ex + (present[1] - y1) * ey > span2 / 2:
        off = -off
    here, there = min(max(middle - off, low), high), min(max(middle + off, low), high)
    if rate(there) > rate(here) + tolerance - slack:
        here = there
    return x1 + here / span * ex, y1 + here / span * ey

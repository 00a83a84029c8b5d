"""Straight legs and the fence.

Oracle: points along each leg, asked one by one of matplotlib's own test for a point in a polygon, and their distances
to the polygon's edges by `segment_distance`; circles and heights by hand.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.path import Path

from jpap_ros.fleet.fence import Fence
from jpap_ros.fleet.separation_check import polyline_distance

#: A square with a notch from the north, 20 m wide and 80 m deep.
U = ((0.0, 0.0), (100.0, 0.0), (100.0, 100.0), (60.0, 100.0), (60.0, 20.0), (40.0, 20.0), (40.0, 100.0), (0.0, 100.0))


def star(rng: np.random.Generator, corners: int) -> tuple[tuple[float, float], ...]:
    """Corners round the origin, at whole metres now and then, so that legs meet them exactly."""
    angles = np.sort(rng.uniform(0, 2 * math.pi, corners))
    radii = rng.uniform(20.0, 100.0, corners)
    places = np.column_stack([radii * np.cos(angles), radii * np.sin(angles)])
    return tuple((float(east), float(north)) for east, north in (places.round() if rng.random() < 0.5 else places))


def outside(polygon: tuple[tuple[float, float], ...], points: np.ndarray) -> np.ndarray:
    """How far outside each point is [m]."""
    edges = np.array([(*corner, 0.0) for corner in (*polygon, polygon[0])])
    away = np.array([polyline_distance(np.array([[*point, 0.0]]), edges) for point in points])
    return np.where(Path(polygon).contains_points(points), 0.0, away)


@settings(max_examples=300, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), corners=st.integers(3, 9), whole=st.booleans(), on_corner=st.booleans())
def test_a_leg_that_may_be_flown_leads_nowhere_farther_out(
    seed: int, corners: int, whole: bool, on_corner: bool
) -> None:
    rng = np.random.default_rng(seed)
    try:
        fence = Fence(polygon_m=star(rng, corners))
    except ValueError:
        return
    start, end = rng.uniform(-80.0, 80.0, (2, 2))
    if whole:
        start, end = start.round(), end.round()
    if on_corner:
        start, end = np.array(fence.polygon_m)[rng.integers(0, corners, 2)]
    depth = outside(fence.polygon_m, start + np.linspace(0.0, 1.0, 201)[:, None] * (end - start))
    if fence.lets_pass((*start.tolist(), 50.0), (*end.tolist(), 50.0)):
        assert depth.max() <= depth[0] + 1e-5
        was_in = np.maximum.accumulate(depth < 1e-9)
        assert depth[was_in].max(initial=0.0) <= 1e-5, "once inside, it stays inside"
    elif depth[0] == 0.0:
        # Refused from inside: it does come out, though perhaps between two points, which are so near to an edge then.
        step = math.dist(start, end) / 200
        edges = np.array([(*corner, 0.0) for corner in (*fence.polygon_m, fence.polygon_m[0])])
        leg = np.array([[*start, 0.0], [*end, 0.0]])
        assert depth.max() > 0.0 or polyline_distance(leg, edges) <= step


@pytest.mark.parametrize(
    ("start", "end", "passes"),
    [
        ((20.0, 80.0), (80.0, 80.0), False),  # across the notch
        ((20.0, 10.0), (80.0, 10.0), True),  # below it
        ((20.0, 20.0), (80.0, 20.0), True),  # along its bottom edge
        ((0.0, 0.0), (0.0, 100.0), True),  # along an edge
        ((40.0, 100.0), (60.0, 100.0), False),  # from one tip to the other
        ((45.0, 50.0), (30.0, 50.0), True),  # out in the notch: back by the nearest edge
        ((45.0, 50.0), (70.0, 50.0), False),  # by the other edge, first farther out
        ((-5.0, 50.0), (-5.0, 60.0), True),  # no farther out than it is
        ((-5.0, 50.0), (-9.0, 50.0), False),
        ((-5.0, 50.0), (20.0, 50.0), True),
        ((-5.0, 50.0), (80.0, 50.0), False),  # in, and then across the notch
    ],
)
def test_legs_by_hand(start: tuple[float, float], end: tuple[float, float], passes: bool) -> None:
    for polygon in (U, U[::-1], U[3:] + U[:3]):
        assert Fence(polygon_m=polygon).lets_pass((*start, 50.0), (*end, 50.0)) == passes


def test_circle_and_heights() -> None:
    fence = Fence(center_m=(0.0, 0.0), radius_m=50.0, min_height_m=10.0, max_height_m=40.0)
    assert fence.lets_pass((-50.0, 0.0, 10.0), (50.0, 0.0, 40.0))
    assert not fence.lets_pass((0.0, 0.0, 30.0), (50.1, 0.0, 30.0))
    assert not fence.lets_pass((0.0, 0.0, 30.0), (0.0, 0.0, 40.1))
    # From below the least height, as after a take-off, it may climb.
    assert fence.lets_pass((0.0, 0.0, 5.0), (0.0, 0.0, 30.0))
    assert not fence.lets_pass((0.0, 0.0, 30.0), (0.0, 0.0, 9.0))
    assert fence.outside_m((30.0, 40.0, 44.0)) == pytest.approx(4.0)
    assert fence.outside_m((60.0, 0.0, 30.0)) == pytest.approx(10.0)
    assert fence.outside_m((0.0, 0.0, 30.0)) == 0.0

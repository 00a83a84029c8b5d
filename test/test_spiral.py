"""Spiral baseline, worked by hand.

With P_T eta = 10^4 m^2, H = 50 m and demands of w = 2^r - 1 = 1, n devices in a cell have, under QDPA and EPA alike,
the squared radius 10^4 / n - 2500 m^2: 86.6 m for one device, 50 m for two, 28.9 m for three, 0 for four.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from jpap_ros.planning import Deployment, LinkBudget, solve
from jpap_ros.planning.spiral import convex_hull

LINK = LinkBudget(transmit_power_dbm=0, noise_power_dbm=-70, reference_gain_db=-30, altitude_m=50)
SCHEMES = ("spiral_qdpa", "spiral_epa")


def cells(deployment: Deployment) -> list[set[int]]:
    """Cells as sets of devices, in the order of placement."""
    return [set(deployment.cell(n).tolist()) for n in range(len(deployment.uav_positions))]


@pytest.mark.parametrize("scheme", SCHEMES)
def test_three_uavs_round_a_field_of_five(scheme: str) -> None:
    """Oracle by hand, step by step.

    1. The mean is (128, 62); device 3 is the corner farthest from it (35428 m^2). No other is within 2 x 50 m.
    2. Counter-clockwise follows device 0. Device 4, once inner, is now a corner: 44.7 m < 50 m away, it is covered
       from over device 0; the UAV then moves to the centre of the two.
    3. Device 1 follows; device 2 is 90 m away, so not covered from over device 1, but from the middle, 45 m < 50 m.
    """
    positions = [[0, 0], [300, 0], [300, 90], [0, 200], [40, 20]]
    deployment = solve(positions, [1] * 5, scheme, LINK)
    assert cells(deployment) == [{3}, {0, 4}, {1, 2}]
    assert deployment.uav_positions == pytest.approx(np.array([[0, 200], [20, 10], [300, 45]]))
    snr = np.array([5000 / (500 + 2500), 5000 / (45**2 + 2500), 5000 / (45**2 + 2500), 4, 5000 / (500 + 2500)])
    assert deployment.rate == pytest.approx(np.log2(1 + snr))


@pytest.mark.parametrize("scheme", SCHEMES)
def test_boundary_devices_come_before_nearer_inner_ones(scheme: str) -> None:
    """Oracle by hand: from corner 0, corner 1 (90.1 m) is taken in before device 2 (56.4 m), for which no room is left.

    A third device has radius 28.9 m, and corners 0 and 1 alone are 45 m from the centre of their circle. Device 5, on
    an edge, is no corner; it is left out of the cell of 3 and 4 for the same reason.
    """
    positions = [[-4, 0], [0, 90], [30, 45], [250, 0], [250, 90], [250, 45]]
    deployment = solve(positions, [1] * 6, scheme, LINK)
    assert cells(deployment) == [{0, 1}, {3, 4}, {2}, {5}]
    assert deployment.uav_positions == pytest.approx(np.array([[-2, 45], [250, 45], [30, 45], [250, 45]]))


def test_the_allocation_decides_who_joins() -> None:
    """Oracle by hand: w = 1 and 0.5, 120 m apart.

    QDPA: both radii 64.5 m, so they share the middle. EPA: radii 50 m and 86.6 m; the deepest point of the two discs
    has x^2 - 50^2 = (120 - x)^2 - 86.6^2, x = 39.2 m.
    """
    positions, rates = [[0, 0], [120, 0]], [1, math.log2(1.5)]
    assert solve(positions, rates, "spiral_qdpa", LINK).uav_positions == pytest.approx(np.array([[60, 0]]))
    x = (120**2 - 7500 + 2500) / 240
    assert solve(positions, rates, "spiral_epa", LINK).uav_positions == pytest.approx(np.array([[x, 0]]))


def test_a_full_cell_takes_no_more() -> None:
    """Oracle by hand: three devices within 1 m share a UAV, but with two a cell the third gets its own."""
    positions = [[0, 0], [1, 0], [0, 1]]
    assert len(solve(positions, [1] * 3, "spiral_qdpa", LINK).uav_positions) == 1
    assert [len(cell) for cell in cells(solve(positions, [1] * 3, "spiral_qdpa", LINK, max_devices_per_uav=2))] == [
        2,
        1,
    ]


def brute_force_corners(points: np.ndarray) -> set[tuple[int, int]]:
    """Corners of the hull of integer points: those that are in no segment and no triangle of other points."""
    distinct = sorted({(int(x), int(y)) for x, y in points})

    def turn(a: tuple[int, int], b: tuple[int, int], c: tuple[int, int]) -> int:
        return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])

    def inside(p: tuple[int, int]) -> bool:
        others = [q for q in distinct if q != p]
        for a in others:
            for b in others:
                dot = (a[0] - p[0]) * (b[0] - p[0]) + (a[1] - p[1]) * (b[1] - p[1])
                if turn(a, p, b) == 0 and dot < 0:
                    return True
                if any(turn(a, b, p) > 0 and turn(b, c, p) > 0 and turn(c, a, p) > 0 for c in others):
                    return True
        return False

    return {p for p in distinct if not inside(p)}


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 4), st.integers(0, 4)), min_size=1, max_size=8))
def test_convex_hull_of_small_grids(points: list[tuple[int, int]]) -> None:
    """Oracle: the definition of a corner, in integers; a 5 x 5 grid is full of lines and coincident points."""
    array = np.array(points, float)
    hull = convex_hull(array, np.arange(len(points)))
    assert {points[k] for k in hull} == brute_force_corners(array)
    assert len(hull) == len({points[k] for k in hull})
    assert all(points[k] not in points[:k] for k in hull)


def test_convex_hull_of_a_cloud_agrees_with_qhull() -> None:
    """Oracle: SciPy's Qhull, which also lists the corners of a plane hull counter-clockwise."""
    points = np.random.default_rng(1).normal(size=(500, 2))
    ours, theirs = convex_hull(points, np.arange(500)), ConvexHull(points).vertices.tolist()
    at = theirs.index(ours[0])
    assert ours == theirs[at:] + theirs[:at]

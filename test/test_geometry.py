"""Whether discs share a point. Oracles: textbook figures; SciPy's generic minimiser; a dense grid."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from jpap_ros.planning.geometry import common_point, last_is_apart, nearest_common_point, smallest_enclosing_circle

coordinate = st.floats(-500, 500).map(lambda x: round(x, 3))
points = st.lists(st.tuples(coordinate, coordinate), min_size=1, max_size=9)


@pytest.mark.parametrize(
    ("corners", "centre", "radius"),
    [
        ([(3, 4)], (3, 4), 0),
        ([(3, 4), (3, 4)], (3, 4), 0),
        ([(0, 0), (6, 8)], (3, 4), 5),
        ([(0, 0), (4, 0), (1, 0)], (2, 0), 2),
        # Equilateral triangle of side 2: circumradius 2 / sqrt(3). Obtuse triangle: half its longest side.
        ([(0, 0), (2, 0), (1, math.sqrt(3))], (1, 1 / math.sqrt(3)), 2 / math.sqrt(3)),
        ([(0, 0), (10, 0), (5, 1)], (5, 0), 5),
        ([(1e6, 2e6), (1e6 + 1, 2e6), (1e6, 2e6 + 1), (1e6 + 1, 2e6 + 1)], (1e6 + 0.5, 2e6 + 0.5), math.sqrt(0.5)),
    ],
)
def test_smallest_enclosing_circle(corners: list[tuple[float, float]], centre: tuple, radius: float) -> None:
    found, size = smallest_enclosing_circle(corners)
    assert found == pytest.approx(centre, abs=1e-9)
    assert size == pytest.approx(radius, abs=1e-9)


def test_equal_discs_that_touch_share_a_point_and_a_hair_less_do_not() -> None:
    # The circumradius of this triangle is exactly 2 / sqrt(3).
    corners = [(0, 0), (2, 0), (1, math.sqrt(3))]
    assert common_point(corners, [4 / 3] * 3) == pytest.approx([1, 1 / math.sqrt(3)], abs=1e-8)
    assert common_point(corners, [4 / 3 * (1 - 1e-8)] * 3) is None


def test_different_discs() -> None:
    # On a line: [-3, 3] and [2, 6] overlap, [-1.9, 1.9] and [2, 6] do not; a disc within another is found, too.
    assert common_point([(0, 0), (4, 0)], [9, 4]) is not None
    assert common_point([(0, 0), (4, 0)], [3.61, 4]) is None
    assert common_point([(0, 0), (4, 0)], [100, 0]) == pytest.approx([4, 0], abs=1e-12)
    assert common_point([(0, 0)], [-1e-6]) is None


@settings(max_examples=60, deadline=None)
@given(points, st.data())
def test_against_a_generic_minimiser(corners: list[tuple[float, float]], data: st.DataObject) -> None:
    """The least value of max_k (|v - u_k|^2 - r_k^2), as a quadratic programme solved by SLSQP, has the same sign."""
    centres = np.array(corners)
    radii = np.array([data.draw(st.floats(0, 400)) for _ in corners]) ** 2
    scale = 1e5
    result = minimize(
        lambda z: z[2],
        [*centres.mean(axis=0), 10.0],
        method="SLSQP",
        constraints={"type": "ineq", "fun": lambda z: z[2] - (((centres - z[:2]) ** 2).sum(axis=1) - radii) / scale},
        options={"ftol": 1e-14, "maxiter": 500},
    )
    excess = (((centres - result.x[:2]) ** 2).sum(axis=1) - radii).max() / scale
    found = common_point(centres, radii)
    if excess < -1e-6:
        assert found is not None
    if found is not None:
        assert (((centres - found) ** 2).sum(axis=1) <= radii * (1 + 1e-9) + 1e-18).all()
    elif result.success:
        assert excess > -1e-6


@pytest.mark.parametrize(
    ("last", "r", "apart"),
    [
        # From (0, 0) with radius 10 and (30, 0) with radius 5: by the distance of the centres.
        ((12, 0), 1.0, True),
        ((12, 0), 2.0, True),  # reaches the first, not the second
        ((12, 0), 13.0, False),
        ((0, 0), 25.0, False),
        ((0, 0), 24.99, True),
        ((12, 0), None, True),  # the empty disc
    ],
)
def test_a_disc_apart_from_one_of_the_others(last: tuple[float, float], r: float | None, apart: bool) -> None:
    squared_radii = [100.0, 25.0, -1.0 if r is None else r * r]
    assert last_is_apart([0.0, 30.0, last[0]], [0.0, 0.0, last[1]], squared_radii) == apart


@given(points, st.lists(st.floats(0.0, 400.0), min_size=9, max_size=9))
def test_discs_of_which_the_last_is_apart_share_no_point(
    corners: list[tuple[float, float]], radii: list[float]
) -> None:
    centres, squared_radii = np.array(corners), np.square(radii[: len(corners)])
    apart = last_is_apart(*centres.T.tolist(), squared_radii.tolist())
    assert not apart or common_point(centres, squared_radii) is None
    if len(corners) == 2:
        assert apart == (common_point(centres, squared_radii) is None)


@settings(max_examples=60, deadline=None)
@given(points, st.tuples(coordinate, coordinate), st.floats(1.0, 1.5))
def test_nearest_common_point(corners: list[tuple[float, float]], away: tuple[float, float], margin: float) -> None:
    """Nearest in a convex region: no feasible point lies on the query's side (variational inequality)."""
    centres = np.array(corners)
    _, radius = smallest_enclosing_circle(centres)
    squared = np.full(len(centres), (radius * margin + 1) ** 2)
    found = nearest_common_point(*away, *centres.T.tolist(), squared.tolist())
    assert found is not None
    assert (((centres - found) ** 2).sum(axis=1) <= squared * (1 + 1e-9)).all()
    draw = np.random.default_rng(0)
    samples = centres.mean(axis=0) + draw.uniform(-1, 1, (4000, 2)) * (2 * radius + 2)
    inside = samples[(((samples[:, None] - centres) ** 2).sum(axis=2) <= squared).all(axis=1)]
    towards = (inside - found) @ (np.array(away) - found)
    assert (towards <= 1e-4 * (1 + np.hypot(*(np.array(away) - found)))).all()


@pytest.mark.parametrize("radius", [150.0, 288.0, 289.0, 400.0])
def test_centres_in_a_line_but_for_rounding(radius: float) -> None:
    """Three centres 1e-190 m off a line: the point equally far from all is beyond any number, and not the answer.

    Oracle: the discs share a point as soon as those of the two ends do, 577 m apart.
    """
    for order in itertools.permutations([(0.0, 0.0), (0.0, 374.0), (9.61916386e-191, 577.0)]):
        centres = np.array(order)
        found = common_point(centres, np.full(3, radius**2))
        assert (found is not None) == (radius >= 577 / 2)
        if found is not None:
            assert (((centres - found) ** 2).sum(axis=1) <= radius**2 * (1 + 1e-9)).all()

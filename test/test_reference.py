"""The paper's own iteration and listing agree with the fast ones, each being the other's oracle."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jpap_ros.planning import LinkBudget, solve
from jpap_ros.planning.allocation import EPA, EPA_COMMON, QDPA, Allocation
from jpap_ros.planning.geometry import smallest_enclosing_circle
from jpap_ros.planning.link_budget import snr_demand
from jpap_ros.planning.placement import best_position, place
from jpap_ros.planning.reference import (
    Placer,
    beta,
    drmp_position,
    lagrange_multipliers,
    lagrange_position,
    literal_position,
    pulls,
    reference_jpap,
    sum_rate,
    tau,
)
from jpap_ros.planning.solver import validate

LINK = LinkBudget()
H2 = LINK.altitude_m**2


@given(tight=st.floats(0.01, 1e7), other=st.floats(0.01, 1e7))
def test_the_bound_is_below_the_rate_and_tight(tight: float, other: float) -> None:
    slope, offset = tau(np.array(tight)), beta(np.array(tight))
    assert slope * math.log2(tight) + offset == pytest.approx(math.log2(1 + tight), rel=1e-9)
    assert slope * math.log2(other) + offset <= math.log2(1 + other) + 1e-9


@pytest.mark.parametrize("direction", [0.0, 0.7, 2.5])
@pytest.mark.parametrize("distance", [0.0, 30.0, 49.0, 50.0, 51.0, 120.0])
def test_a_term_of_p4_is_convex_within_h_and_not_beyond(distance: float, direction: float) -> None:
    """Equations (15) to (17). Oracle: finite differences of the code's rate, which is constant - J where c is huge."""
    x, y = distance * math.cos(direction), distance * math.sin(direction)
    device, strength, h = np.zeros((1, 2)), np.array([1e18]), 0.05

    def j(dx: float, dy: float) -> float:
        return -sum_rate(np.array([x + dx, y + dy]), device, strength, H2)

    t1 = (j(h, 0) - 2 * j(0, 0) + j(-h, 0)) / h**2
    t4 = (j(0, h) - 2 * j(0, 0) + j(0, -h)) / h**2
    t2 = (j(h, h) - j(h, -h) - j(-h, h) + j(-h, -h)) / (4 * h**2)
    d4 = (x * x + y * y + H2) ** 2
    scale = 2 / (math.log(2) * H2)
    assert t1 == pytest.approx(2 * (-x * x + y * y + H2) / (math.log(2) * d4), abs=1e-4 * scale)
    determinant = 4 * (H2**2 - (x * x + y * y) ** 2) / (math.log(2) ** 2 * d4**2)
    assert t1 * t4 - t2 * t2 == pytest.approx(determinant, abs=1e-4 * scale**2)
    # Positive definite within H; one negative eigenvalue beyond.
    assert np.sign(round((t1 * t4 - t2 * t2) / scale**2, 4)) == np.sign(LINK.altitude_m - distance)
    assert distance >= LINK.altitude_m or t1 > 0


@pytest.mark.parametrize("placer", [literal_position, drmp_position])
def test_the_two_cases_of_drmp(placer: Placer) -> None:
    """Two devices 2 s apart, with so much power that J decides: J_1 + J_2 is log2 of a quartic in the place between.

    Oracle by hand: with s = 45 m < H, it is convex and least in the middle. With s = 55 m > H, the middle is a local
    maximum and the least is at sqrt(s^2 - H^2) = 22.9 m from it, on the side where the UAV is now. With r = 19.95,
    (11): d_sv = 49.4 m < H; with r = 16 it is 271.6 m.
    """
    for rate, s, expected, tolerance in ((19.95, 45.0, 0.0, 1e-3), (16.0, 45.0, 0.0, 1e-3), (16.0, 55.0, -22.913, 1.0)):
        points, demand = np.array([[-s, 0.0], [s, 0.0]]), snr_demand([rate, rate])
        radii2 = QDPA.squared_radii(demand, LINK)
        assert (radii2[0] < H2) == (rate > 19)
        found = placer(points, QDPA.powers(demand, LINK) * LINK.eta, radii2, H2, points[0])
        assert found == pytest.approx([expected, 0.0], abs=tolerance)


@pytest.mark.parametrize("seed", range(6))
def test_case_1_lagrange_method_finds_the_best_position(seed: int) -> None:
    # d_sv < H: 1e10 / (sum w) < 5000 needs sum w > 2e6: four devices with r in [19, 20].
    draw = np.random.default_rng(seed)
    points, rates = draw.uniform(-15, 15, (4, 2)), draw.uniform(19.0, 19.4, 4)
    demand = snr_demand(rates)
    radii2 = QDPA.squared_radii(demand, LINK)
    assert 0 < radii2[0] < H2
    strengths = QDPA.powers(demand, LINK) * LINK.eta
    found = lagrange_position(points, strengths, radii2, H2, points[0])
    best = best_position(points, rates, QDPA, LINK)
    assert best is not None
    assert found == pytest.approx(best, abs=0.1)


@pytest.mark.parametrize("seed", range(12))
def test_the_subgradient_method_converges_to_the_multipliers(seed: int) -> None:
    """Oracle: the exact position, and the multipliers with which equations (21) and (22) hold there."""
    draw = np.random.default_rng(seed)
    points, power = draw.uniform(0, 70, (4, 2)), draw.uniform(1, 3, 4)
    strengths = power * LINK.eta
    radii2 = np.full(4, 1.1 * (smallest_enclosing_circle(points)[1]) ** 2)
    assert radii2[0] < H2  # convex
    start = points.mean(axis=0)
    multipliers, position, steps = lagrange_multipliers(points, strengths, radii2, H2, start)
    best = place(*points.T.tolist(), strengths.tolist(), radii2.tolist(), H2, (float(start[0]), float(start[1])))
    ways = np.array(best) - points
    binding = (ways**2).sum(axis=1) > radii2 * (1 - 1e-6)
    expected = np.zeros(4)
    expected[binding] = -pulls(points, strengths, H2, np.array(best)) @ ways @ np.linalg.pinv(ways[binding])
    assert position == pytest.approx(best, abs=1e-3)
    assert multipliers == pytest.approx(expected, abs=1e-3 * max(expected.max(), 1e-4))
    assert steps < 100_000


@pytest.mark.parametrize("rule", [QDPA, EPA], ids=lambda rule: rule.name)
@pytest.mark.parametrize("seed", range(4))
def test_case_2_both_find_the_same_rate(rule: Allocation, seed: int) -> None:
    draw = np.random.default_rng(seed)
    points, rates = draw.uniform(0, 110, (3, 2)), draw.uniform(15.0, 17.0, 3)
    demand = snr_demand(rates)
    radii2 = rule.squared_radii(demand, LINK)
    assert radii2.max() >= H2
    strengths = rule.powers(demand, LINK) * LINK.eta
    best = best_position(points, rates, rule, LINK)
    assert best is not None
    found = drmp_position(points, strengths, radii2, H2, points[0])
    # Each is within its tolerance of the best: the exhaustive search of its grid's, the fast one of 9e-4.
    assert sum_rate(found, points, strengths, H2) == pytest.approx(sum_rate(best, points, strengths, H2), abs=2e-3)


@pytest.mark.parametrize(("scheme", "rule"), [("jpap", QDPA), ("jpap_epa", EPA), ("jpap_epa_common", EPA_COMMON)])
@pytest.mark.parametrize("placer", [literal_position, drmp_position])
@pytest.mark.parametrize("seed", range(3))
def test_the_listing_taken_literally_gives_the_same_cells(
    seed: int, placer: Placer, scheme: str, rule: Allocation
) -> None:
    draw = np.random.default_rng(seed)
    positions, rates = draw.uniform(0, 670, (20, 2)), draw.uniform(15, 20, 20)
    expected = reference_jpap(validate(positions, rates, LINK, None, None, None, 0.0, None, 0), rule, placer)
    found = solve(positions, rates, scheme)
    assert [found.cell(uav).tolist() for uav in range(len(found.uav_positions))] == [sorted(c) for c, _ in expected]

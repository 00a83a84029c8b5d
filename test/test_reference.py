"""The paper's own iteration and listing agree with the fast ones, each being the other's oracle."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jpap_ros.planning import LinkBudget, solve
from jpap_ros.planning.allocation import EPA, EPA_COMMON, QDPA, Allocation
from jpap_ros.planning.link_budget import snr_demand
from jpap_ros.planning.placement import best_position
from jpap_ros.planning.reference import drmp_position, lagrange_position, reference_jpap, sum_rate, tight_bound
from jpap_ros.planning.solver import validate

LINK = LinkBudget()
H2 = LINK.altitude_m**2


@given(tight=st.floats(0.01, 1e7), other=st.floats(0.01, 1e7))
def test_the_bound_is_below_the_rate_and_tight(tight: float, other: float) -> None:
    tau, beta = tight_bound(np.array(tight))
    assert tau * math.log2(tight) + beta == pytest.approx(math.log2(1 + tight), rel=1e-9)
    assert tau * math.log2(other) + beta <= math.log2(1 + other) + 1e-9


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
@pytest.mark.parametrize("seed", range(3))
def test_the_listing_taken_literally_gives_the_same_cells(seed: int, scheme: str, rule: Allocation) -> None:
    draw = np.random.default_rng(seed)
    positions, rates = draw.uniform(0, 670, (20, 2)), draw.uniform(15, 20, 20)
    expected = reference_jpap(validate(positions, rates, LINK, None, None, None, 0.0, None, 0), rule)
    found = solve(positions, rates, scheme)
    assert [found.cell(uav).tolist() for uav in range(len(found.uav_positions))] == [sorted(c) for c, _ in expected]

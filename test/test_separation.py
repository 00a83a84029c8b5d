"""Hovering UAVs at least so far apart, with every demand met.

Oracles: `Deployment.violations`, which computes demands and distances afresh; hand-made instances whose answer is
plain geometry; and brute force over all servable partitions where the fleet has to grow.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jpap_ros.planning import SCHEMES, LinkBudget, solve

LINK = LinkBudget()


@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 10**6),
    st.integers(2, 12),
    st.sampled_from([20.0, 100.0, 400.0]),
    st.sampled_from([5.0, 30.0, 90.0]),
    st.sampled_from(list(SCHEMES)),
    st.sampled_from([None, 3]),
)
def test_no_scheme_hovers_too_close(seed, count, side, separation, scheme, uavs):
    random = np.random.default_rng(seed)
    positions, rates = random.uniform(0, side, (count, 2)), random.uniform(17, 21.5, count)
    found = solve(positions, rates, scheme, min_separation_m=separation, max_uavs=uavs)
    assert found.violations(positions, rates, LINK, max_uavs=uavs, min_separation_m=separation) == []


def solo_demand(radius_m):
    """Demand of a device that takes all the power of a UAV that far away: equation (3) turned round."""
    return math.log2(1 + LINK.power_eta / (radius_m**2 + LINK.altitude_m**2))


def test_two_uavs_above_one_place_move_apart_at_no_cost():
    # Each device needs a UAV of its own within 40 m; 80 m apart is the most there is.
    rates = [solo_demand(40.0)] * 2
    for separation in (10.0, 79.0):
        found = solve(np.zeros((2, 2)), rates, "optimal", min_separation_m=separation)
        assert not found.unserved
        assert len(found.uav_positions) == 2
        assert found.proven_optimal
        assert math.dist(*found.uav_positions) >= separation
    found = solve(np.zeros((2, 2)), rates, "optimal", min_separation_m=81.0)
    assert len(found.unserved) == 1
    (why,) = found.unserved.values()
    assert "closer than 81 m" in why
    assert found.violations(np.zeros((2, 2)), rates, LINK, min_separation_m=81.0) == []


def test_four_uavs_above_one_place_find_the_corners():
    # Discs of radius 50 m hold four points 70 m apart (a square of diagonal 100 m), not four points 72 m apart.
    rates = [solo_demand(50.0)] * 4
    found = solve(np.zeros((4, 2)), rates, "optimal", min_separation_m=68.0)
    assert not found.unserved
    assert found.violations(np.zeros((4, 2)), rates, LINK, min_separation_m=68.0) == []


def two_cells_can_hover_apart(positions, rates, separation):
    """Whether some partition into two servable cells has discs with points so far apart: exact for two discs."""
    count, discs = len(rates), {}
    for mask in range(1, 2**count - 1):
        cell = [k for k in range(count) if mask >> k & 1]
        w, u = 2.0 ** rates[cell] - 1, positions[cell]
        centre = w @ u / w.sum()
        slack = LINK.power_eta - w @ (((u - centre) ** 2).sum(axis=1) + LINK.altitude_m**2)
        if slack >= 0:
            discs[mask] = centre, math.sqrt(slack / w.sum())
    whole = 2**count - 1
    return any(
        math.dist(discs[a][0], discs[whole - a][0]) + discs[a][1] + discs[whole - a][1] >= separation
        for a in discs
        if whole - a in discs
    )


@pytest.mark.parametrize("seed", range(4))
def test_other_cells_are_chosen_before_another_uav_is_flown(seed):
    """Two UAVs suffice for as long as any partition into two cells allows the separation, and no longer."""
    random = np.random.default_rng(seed)
    positions, rates = random.uniform(0, 150, (6, 2)), random.uniform(18.1, 18.8, 6)
    assert len(solve(positions, rates, "optimal").uav_positions) == 2
    for separation in (20.0, 80.0, 110.0, 140.0, 170.0, 200.0, 260.0):
        found = solve(positions, rates, "optimal", min_separation_m=separation)
        assert found.violations(positions, rates, LINK, min_separation_m=separation) == []
        possible = two_cells_can_hover_apart(positions, rates, separation)
        assert (len(found.uav_positions) == 2 and not found.unserved) == possible
        if possible:
            assert found.proven_optimal


def test_uavs_far_apart_stay_where_they_are():
    random = np.random.default_rng(2)
    positions, rates = random.uniform(0, 1500, (20, 2)), random.uniform(15, 20, 20)
    for scheme in SCHEMES:
        free = solve(positions, rates, scheme)
        gaps = np.hypot(*(free.uav_positions[:, None] - free.uav_positions[None]).transpose(2, 0, 1))
        nearest = gaps[~np.eye(len(gaps), dtype=bool)].min()
        held = solve(positions, rates, scheme, min_separation_m=0.99 * nearest)
        np.testing.assert_array_equal(free.uav_positions, held.uav_positions)
        np.testing.assert_array_equal(free.power_w, held.power_w)


def test_moving_costs_little_rate():
    """Two UAVs 1 m apart that must be 20 m apart: nobody moves farther than that, so the rate hardly falls."""
    positions = np.array([[0.0, 0.0], [1.0, 0.0]])
    rates = np.full(2, solo_demand(60.0))
    free, held = (solve(positions, rates, "optimal", min_separation_m=s) for s in (0.0, 20.0))
    moved = np.hypot(*(np.sort(held.uav_positions, axis=0) - np.sort(free.uav_positions, axis=0)).T)
    assert moved.max() <= 20.0
    lost = math.log2((20.0**2 + LINK.altitude_m**2) / LINK.altitude_m**2)
    assert free.average_uav_rate - held.average_uav_rate <= lost + 1e-9


@pytest.mark.parametrize("seed", range(3))
def test_a_separated_fleet_is_no_larger_than_one_device_each(seed):
    random = np.random.default_rng(seed)
    positions, rates = random.uniform(0, 200, (8, 2)), random.uniform(18, 20, 8)
    found = solve(positions, rates, "optimal", min_separation_m=60.0)
    assert found.violations(positions, rates, LINK, min_separation_m=60.0) == []
    assert found.min_uavs_bound <= len(found.uav_positions) + len(found.unserved)
    assert found.proven_optimal == (found.min_uavs_bound == found.uavs_needed)

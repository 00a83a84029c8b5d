"""Hovering UAVs at least so far apart, with every demand met.

Oracles: `Deployment.violations`, which computes demands and distances afresh; hand-made instances whose answer is
plain geometry; and brute force over all servable partitions where the fleet has to grow.
"""

from __future__ import annotations

import itertools
import math
import time

import numpy as np
import optimum_oracle as oracle
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jpap_ros.planning import SCHEMES, LinkBudget, solve
from jpap_ros.planning.separation import keep_apart
from jpap_ros.planning.solver import validate

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


def discs_of(positions, rates):
    """Centre and radius of the disc from which each servable set can be served; from equation (3) alone."""
    discs = {}
    for members in oracle.servable_sets(positions, rates, LINK, len(rates)):
        w, u = 2.0 ** rates[list(members)] - 1, positions[list(members)]
        centre = w @ u / w.sum()
        slack = LINK.power_eta - w @ (((u - centre) ** 2).sum(axis=1) + LINK.altitude_m**2)
        discs[members] = centre, math.sqrt(max(slack, 0.0) / w.sum())
    return discs


def most_weight_of_two(positions, rates, weights, separation):
    """Most weight that one or two UAVs so far apart can serve: over all pairs of disjoint servable sets."""
    discs = discs_of(positions, rates)
    best = max(weights[list(cell)].sum() for cell in discs)
    for a, b in itertools.combinations(discs, 2):
        if set(a).isdisjoint(b) and math.dist(discs[a][0], discs[b][0]) + discs[a][1] + discs[b][1] >= separation:
            best = max(best, weights[[*a, *b]].sum())
    return float(best)


@pytest.mark.parametrize("seed", range(6))
def test_two_uavs_serve_the_most_weight_that_the_separation_allows(seed):
    random = np.random.default_rng(seed)
    positions, rates = random.uniform(0, 150, (7, 2)), random.uniform(18.3, 19.8, 7)
    weights = random.integers(1, 6, 7).astype(float)
    for separation in (60.0, 130.0, 190.0):
        found = solve(positions, rates, "optimal", max_uavs=2, weights=weights, min_separation_m=separation)
        assert found.violations(positions, rates, LINK, max_uavs=2, min_separation_m=separation) == []
        best = most_weight_of_two(positions, rates, weights, separation)
        assert weights[found.serving_uav >= 0].sum() == best
        assert found.served_weight_bound is None or found.served_weight_bound == best


def test_the_fleet_that_the_separation_asks_for_is_named_and_proven():
    """With two UAVs one device is left out; that three serve all is proven by the run without a limit."""
    random = np.random.default_rng(0)
    positions, rates = random.uniform(0, 150, (6, 2)), random.uniform(18.1, 18.8, 6)
    assert not two_cells_can_hover_apart(positions, rates, 260.0)
    free = solve(positions, rates, "optimal", min_separation_m=260.0)
    held = solve(positions, rates, "optimal", min_separation_m=260.0, max_uavs=2)
    for found in (free, held):
        assert (found.uavs_needed, found.min_uavs_bound, found.proven_optimal) == (3, 3, True)
    assert not free.unserved
    assert held.unserved
    assert all("1 more UAV would serve every device" in why for why in held.unserved.values())


@pytest.mark.parametrize("scheme", list(SCHEMES))
@pytest.mark.parametrize("uavs", [None, 1, 2])
def test_no_number_is_promised_where_no_fleet_keeps_apart(scheme, uavs):
    """Within 5 m of one place there is room for one UAV if they are to be 20 m apart, however many there are."""
    rates = [solo_demand(5.0)] * 3
    found = solve(np.zeros((3, 2)), rates, scheme, min_separation_m=20.0, max_uavs=uavs)
    assert found.violations(np.zeros((3, 2)), rates, LINK, max_uavs=uavs, min_separation_m=20.0) == []
    assert len(found.uav_positions) == 1
    assert not found.proven_optimal
    assert not any("would serve every device" in why for why in found.unserved.values())


@pytest.mark.parametrize("scheme", list(SCHEMES))
@pytest.mark.parametrize("weights", [[100.0, 1.0], [1.0, 100.0]])
def test_the_device_of_less_weight_gives_way(scheme, weights):
    rates = [solo_demand(5.0), solo_demand(5.5)]
    found = solve(np.zeros((2, 2)), rates, scheme, min_separation_m=20.0, weights=weights)
    assert list(found.unserved) == [int(np.argmin(weights))]


def test_a_device_that_gives_way_goes_to_another_cell_that_can_serve_it():
    """Two UAVs at one place, each of which could serve both devices, that can never be 2 km apart: one serves both."""
    positions, rates = np.zeros((2, 2)), np.full(2, solo_demand(5.0) - 1.5)  # 2^1.5 > 2: power for both
    alone = solve(positions, rates, "jpap", max_devices_per_uav=1)
    assert len(alone.uav_positions) == 2
    found = keep_apart(validate(positions, rates, LINK, None, None, None, 2000.0, None, 0), alone)
    assert found.serving_uav.tolist() == [0, 0]
    assert found.violations(positions, rates, LINK, min_separation_m=2000.0) == []
    assert (found.uavs_needed, dict(found.unserved)) == (1, {})
    full = keep_apart(validate(positions, rates, LINK, 1, None, None, 2000.0, None, 0), alone)
    assert len(full.unserved) == 1


@pytest.mark.parametrize("scheme", ["jpap", "optimal"])
@pytest.mark.parametrize(
    ("positions", "demand", "separation"),
    [
        (np.zeros((40, 2)), 20.0, 25.0),
        (np.random.default_rng(0).uniform(0, 1500, (100, 2)), 17.5, 300.0),
        (np.random.default_rng(0).uniform(0, 30, (60, 2)), 21.0, 15.0),
    ],
)
def test_crowds_are_kept_apart_within_the_time(scheme, positions, demand, separation):
    """Each of these once took more than twenty seconds; the limit is one."""
    rates = np.full(len(positions), demand)
    started = time.monotonic()
    found = solve(positions, rates, scheme, min_separation_m=separation, time_limit_s=1.0)
    assert time.monotonic() - started < 20
    assert found.violations(positions, rates, LINK, min_separation_m=separation) == []


@pytest.mark.parametrize("uavs", [None, 20])
def test_optimal_serves_no_less_than_jpap_where_not_all_can_be_kept_apart(uavs):
    random = np.random.default_rng(0)
    positions, rates = random.uniform(0, 1500, (100, 2)), random.uniform(15, 20, 100)
    served = [
        (solve(positions, rates, scheme, max_uavs=uavs, min_separation_m=300.0, time_limit_s=limit).serving_uav >= 0)
        for scheme, limit in (("jpap", None), ("optimal", 4.0))
    ]
    assert served[0].sum() <= served[1].sum()


def test_many_small_discs_are_filled_as_well_as_one_device_at_a_time_did():
    """60 devices in 30 m x 30 m, UAVs 15 m apart. Leaving out one device at a time kept 50 of them, in 15 s of CPU."""
    positions = np.random.default_rng(0).uniform(0, 30, (60, 2))
    found = solve(positions, np.full(60, 21.0), "jpap", min_separation_m=15.0)
    assert len(found.uav_positions) >= 48

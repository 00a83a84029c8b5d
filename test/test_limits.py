"""A fleet that is too small: what it serves, and what it says of the rest.

Oracles: brute force over all choices of servable cells (`optimum_oracle`) for `optimal`; over the scheme's own cells
for the others. A reason's promise of more power or more UAVs is tried out.
"""

from __future__ import annotations

import itertools
import re
import time
from dataclasses import replace

import numpy as np
import optimum_oracle as oracle
import pytest
from scipy import optimize

from jpap_ros.planning import SCHEMES, LinkBudget, solve
from jpap_ros.planning.optimal.pricing import price
from jpap_ros.planning.optimal.servability import Servability
from jpap_ros.planning.optimal.service import Service
from jpap_ros.planning.solver import validate

LINK = LinkBudget()


def draw(seed, count, side=900.0):
    random = np.random.default_rng(seed)
    return (
        random.uniform(0, side, (count, 2)),
        random.uniform(15, 20, count),
        random.integers(1, 4, count).astype(float),
    )


def served_value(found, weights, rates):
    served = found.serving_uav >= 0
    return float(weights[served].sum()), float(rates[served].sum())


@pytest.mark.parametrize("scheme", list(SCHEMES))
@pytest.mark.parametrize("uavs", [0, 1, 3])
def test_every_scheme_keeps_to_the_fleet_and_names_who_is_left_out(scheme, uavs):
    positions, rates, weights = draw(1, 14)
    found = solve(positions, rates, scheme, max_uavs=uavs, weights=weights)
    assert found.violations(positions, rates, LINK, max_uavs=uavs) == []
    assert len(found.uav_positions) == uavs
    assert found.uavs_needed > uavs
    left = set(np.flatnonzero(found.serving_uav < 0).tolist())
    assert set(found.unserved) == left
    more = found.uavs_needed - uavs
    assert all(f"{more} more UAV" in why for why in found.unserved.values())


@pytest.mark.parametrize("scheme", [name for name in SCHEMES if name != "optimal"])
def test_a_scheme_flies_its_cells_of_the_most_weight(scheme):
    positions, rates, weights = draw(2, 12)
    whole = solve(positions, rates, scheme, weights=weights)
    found = solve(positions, rates, scheme, weights=weights, max_uavs=3)
    cells = [whole.cell(uav) for uav in range(len(whole.uav_positions))]
    best = max(
        (sum(weights[c].sum() for c in some), sum(rates[c].sum() for c in some))
        for some in itertools.combinations(cells, 3)
    )
    assert served_value(found, weights, rates) == pytest.approx(best)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("uavs", [1, 2])
def test_optimal_serves_the_most_weight_then_the_most_demand(seed, uavs):
    positions, rates, weights = draw(seed, 9, 500.0)
    sets = oracle.servable_sets(positions, rates, LINK, 9)
    best = (0.0, 0.0)
    for some in itertools.combinations(sets, uavs):
        covered = sorted(set(itertools.chain(*some)))
        best = max(best, (float(weights[covered].sum()), float(rates[covered].sum())))
    found = solve(positions, rates, "optimal", max_uavs=uavs, weights=weights)
    assert found.violations(positions, rates, LINK, max_uavs=uavs) == []
    assert served_value(found, weights, rates) == pytest.approx(best)


def test_a_device_of_great_weight_is_served_before_many_others():
    positions = [[0, 0], [10, 0], [20, 0], [5000, 0]]
    rates = [16.0, 16.0, 16.0, 16.0]
    assert solve(positions, rates, "optimal", max_uavs=1).serving_uav[3] == -1
    found = solve(positions, rates, "optimal", max_uavs=1, weights=[1, 1, 1, 10])
    assert found.serving_uav.tolist() == [-1, -1, -1, 0]


@pytest.mark.parametrize("seed", range(4))
def test_the_power_and_the_uavs_that_a_reason_asks_for_are_enough(seed):
    positions, rates, _ = draw(seed, 12, 700.0)
    found = solve(positions, rates, "optimal", max_uavs=2)
    promises = 0
    for k, why in found.unserved.items():
        more = int(re.search(r"(\d+) more UAV", why).group(1))
        enough = solve(positions, rates, "optimal", max_uavs=2 + more)
        assert not enough.unserved
        match = re.search(r"([\d.]+) dB more transmit power would let UAV (\d+) serve it", why)
        promises += match is not None
        if match:
            members = [*found.cell(int(match.group(2))).tolist(), k]
            decibels = float(match.group(1))
            stronger = replace(LINK, transmit_power_dbm=LINK.transmit_power_dbm + decibels)
            weaker = replace(LINK, transmit_power_dbm=LINK.transmit_power_dbm + decibels - 0.02)
            assert oracle.servable(positions, rates, stronger, members)
            assert not oracle.servable(positions, rates, weaker, members)
    assert promises


def test_a_full_uav_is_not_offered_more_power():
    found = solve([[0, 0], [1, 0], [2, 0]], [10, 10, 10], "optimal", max_uavs=1, max_devices_per_uav=2)
    assert len(found.unserved) == 1
    (why,) = found.unserved.values()
    assert "dB" not in why
    assert "1 more UAV would serve every device" in why


def test_a_fleet_that_is_large_enough_changes_nothing():
    positions, rates, _ = draw(3, 12)
    for scheme in SCHEMES:
        free = solve(positions, rates, scheme)
        held = solve(positions, rates, scheme, max_uavs=len(free.uav_positions))
        np.testing.assert_array_equal(free.serving_uav, held.serving_uav)
        assert not held.unserved


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("uavs", [1, 2, 3])
def test_the_bound_on_the_weight_served_is_reached_where_all_sets_are_known(seed, uavs):
    positions, rates, weights = draw(seed, 9, 500.0)
    sets = oracle.servable_sets(positions, rates, LINK, 9)
    best = max(float(weights[sorted(set(itertools.chain(*some)))].sum()) for some in itertools.combinations(sets, uavs))
    found = solve(positions, rates, "optimal", max_uavs=uavs, weights=weights)
    assert found.served_weight_bound == (best if found.unserved else None)


@pytest.mark.parametrize("seed", range(4))
def test_bounds_by_pricing_hold_without_enumeration(seed):
    """Oracle: the program over all servable sets, with scipy's solver."""
    positions, rates, weights = draw(seed, 14, 500.0)
    problem = validate(positions, rates, LINK, [None, 3][seed % 2], 2, weights, 0.0, None, 0)
    service = Service(Servability.of(problem), weights, rates, 2)
    cells, pool = service.greedy(time.monotonic() + 60)
    cells = service.fill(cells)
    found = service.improve(cells, [*pool, *cells], None, time.monotonic() + 60)
    best = most_served_by_milp(positions, rates, weights, 2, [14, 3][seed % 2])
    assert service.value(cells)[0] <= service.value(found)[0] <= best <= service.bound
    assert float(service.value(found)[0]) >= 0.9 * best


def most_served_by_milp(positions, rates, weights, uavs, most):
    sets = oracle.servable_sets(positions, rates, LINK, most)
    covers = np.zeros((len(rates), len(sets)))
    for column, members in enumerate(sets):
        covers[list(members), column] = 1
    found = optimize.milp(
        -(weights @ covers),
        constraints=[optimize.LinearConstraint(covers, ub=1), optimize.LinearConstraint(np.ones(len(sets)), ub=uavs)],
        integrality=np.ones(len(sets)),
        bounds=optimize.Bounds(0, 1),
    )
    return round(-found.fun)


@pytest.mark.parametrize("weights", [[1.0, 2.0, 1e8], [1e-9, 2e-9, 1e9], [3.0, 1e-9, 1e9], [1.0, 1.0 + 1e-7, 1e9]])
@pytest.mark.parametrize("order", list(itertools.permutations(range(3))))
def test_small_weights_count_beside_great_ones(weights, order):
    """Three devices far apart and two UAVs: the lightest is left out, however light the others are."""
    weights = np.array(weights)[list(order)]
    for scheme in ("optimal", "jpap"):
        found = solve([[0, 0], [3000, 0], [6000, 0]], [18.0] * 3, scheme, max_uavs=2, weights=weights)
        assert list(found.unserved) == [int(weights.argmin())]


@pytest.mark.parametrize("seed", range(4))
def test_weights_of_eighteen_decades_are_served_in_order(seed):
    """Each device far from the others, each weight more than all smaller ones: the heaviest are served."""
    random = np.random.default_rng(seed)
    weights = 10.0 ** random.permutation(np.arange(-9, 10))
    positions = np.column_stack([3000.0 * np.arange(19), np.zeros(19)])
    found = solve(positions, [18.0] * 19, "optimal", max_uavs=7, weights=weights)
    assert set(np.flatnonzero(found.serving_uav >= 0)) == set(np.argsort(-weights)[:7])


@pytest.mark.parametrize(("low", "high", "uavs"), [(13, 18, 5), (10, 15, 2)])
def test_a_dense_crowd_is_served_at_least_as_well_as_set_by_set(low, high, uavs):
    """Oracle: the set of most devices that pricing finds, then the next for who is left."""
    random = np.random.default_rng(1)
    positions, rates = random.uniform(0, 1500, (100, 2)), random.uniform(low, high, 100)
    servability = Servability.of(validate(positions, rates, LINK, None, uavs, None, 0.0, None, 0))
    left, greedy = np.ones(100), 0
    for _ in range(uavs):
        priced = price(servability, left, time.monotonic() + 60, exact=False)
        best = priced.sets[int(priced.worth.argmax())]
        greedy += int(left[best].sum())
        left[best] = 0
    found = solve(positions, rates, "optimal", max_uavs=uavs, time_limit_s=4.0)
    assert found.violations(positions, rates, LINK, max_uavs=uavs) == []
    assert greedy <= (found.serving_uav >= 0).sum() <= found.served_weight_bound

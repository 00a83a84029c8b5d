"""The scheme `optimal`: smallest fleet, largest rate, bounds, limits of time.

Oracles: `optimum_oracle`, written from the paper's equations without the product's code: brute force over all
partitions for K <= 9, depth-first enumeration and scipy's MILP for K <= 30; and the other schemes, which must never do
better.
"""

from __future__ import annotations

import math
import time

import numpy as np
import optimum_oracle as oracle
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jpap_ros.planning import SCHEMES, LinkBudget, solve
from jpap_ros.planning.optimal import improve
from jpap_ros.planning.optimal.column_generation import bounds_by_columns
from jpap_ros.planning.optimal.ejection import fewer_cells
from jpap_ros.planning.optimal.enumeration import all_sets, maximal_sets
from jpap_ros.planning.optimal.fleet import first_cells, simple_bound, smallest_fleet
from jpap_ros.planning.optimal.milp import incidence
from jpap_ros.planning.optimal.partition import RateProgram
from jpap_ros.planning.optimal.pricing import price
from jpap_ros.planning.optimal.regrouping import GROUP, fewer_by_groups
from jpap_ros.planning.optimal.servability import Servability
from jpap_ros.planning.solver import validate

LINK = LinkBudget()


def problem_of(positions, rates, most=None, seconds=None, **limits):
    return validate(
        positions, rates, LINK, most, limits.get("max_uavs"), limits.get("weights"),
        limits.get("min_separation_m", 0.0), seconds, 0,
    )  # fmt: skip


def draw(seed, count, side, low=15.0, high=20.0):
    random = np.random.default_rng(seed)
    return random.uniform(0, side, (count, 2)), random.uniform(low, high, count)


def is_partition(cells, count):
    return sorted(k for cell in cells for k in cell) == list(range(count))


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("most", [None, 2])
def test_smallest_fleet_agrees_with_brute_force_over_partitions(seed, most):
    positions, rates = draw(seed, 5 + seed % 4, [100, 300, 600][seed % 3], 14, 19)
    found = solve(positions, rates, "optimal", max_devices_per_uav=most)
    assert len(found.uav_positions) == oracle.fewest_by_partitions(positions, rates, LINK, most or len(rates))
    assert found.proven_optimal
    assert found.min_uavs_bound == len(found.uav_positions)
    assert found.violations(positions, rates, LINK, most) == []


@pytest.mark.parametrize(("seed", "count", "side"), [(0, 20, 500), (1, 30, 900), (2, 30, 1500), (3, 25, 600)])
def test_smallest_fleet_agrees_with_plain_milp(seed, count, side):
    positions, rates = draw(seed, count, side)
    found = solve(positions, rates, "optimal")
    assert found.proven_optimal
    assert len(found.uav_positions) == oracle.fewest_by_milp(positions, rates, LINK, count)


@pytest.mark.parametrize("seed", range(3))
def test_largest_rate_agrees_with_brute_force_over_partitions(seed):
    positions, rates = draw(seed, 6, [150, 300, 500][seed], 14, 18)
    found = solve(positions, rates, "optimal")
    fewest, value, best = len(found.uav_positions), {}, -math.inf
    for partition in oracle.partitions(list(range(len(rates)))):
        if len(partition) != fewest:
            continue
        for cell in partition:
            key = tuple(sorted(cell))
            if key not in value:
                good = oracle.servable(positions, rates, LINK, list(key))
                value[key] = oracle.best_rate(positions, rates, LINK, key) if good else -math.inf
        best = max(best, sum(value[tuple(sorted(cell))] for cell in partition) / fewest)
    assert found.average_uav_rate == pytest.approx(best, abs=1e-3)
    assert found.average_uav_rate_bound >= best - 1e-4
    assert found.average_uav_rate_bound - found.average_uav_rate <= 2e-3


@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 10**6), st.integers(1, 14), st.sampled_from([50.0, 250.0, 700.0, 1500.0]),
    st.sampled_from([(10.0, 15.0), (15.0, 20.0), (19.0, 21.9)]), st.sampled_from([None, 1, 3]),
)  # fmt: skip
def test_never_worse_than_any_other_scheme(seed, count, side, demands, most):
    positions, rates = draw(seed, count, side, *demands)
    best = solve(positions, rates, "optimal", max_devices_per_uav=most)
    assert best.violations(positions, rates, LINK, most) == []
    for name in SCHEMES:
        other = solve(positions, rates, name, max_devices_per_uav=most)
        assert len(best.uav_positions) <= len(other.uav_positions), name
        if len(best.uav_positions) == len(other.uav_positions):
            assert best.average_uav_rate >= other.average_uav_rate - 1e-3, name


@pytest.mark.parametrize("seed", range(6))
def test_no_bound_exceeds_the_optimum(seed):
    """Every bound on its own, against scipy's MILP over all servable sets."""
    positions, rates = draw(seed, 24, [800, 1000, 1300][seed % 3], 15, 19)
    most = [None, 3][seed % 2]
    optimum = oracle.fewest_by_milp(positions, rates, LINK, most or 24)
    servability = Servability.of(problem_of(positions, rates, most))
    assert simple_bound(servability) <= optimum
    start = first_cells(servability)
    for bound, sets in bounds_by_columns(servability, start, len(start), time.monotonic() + 3):
        assert bound <= optimum
        assert all(servability.servable(members) for members in sets)
    for fleet in smallest_fleet(servability, start, time.monotonic() + 60, 0):
        assert fleet.bound <= optimum <= len(fleet.cells)
        assert is_partition(fleet.cells, 24)
        assert all(servability.servable(cell) for cell in fleet.cells)
    assert fleet.proven


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("exact", [False, True])
def test_pricing_bound_holds_for_every_servable_set(seed, exact):
    """Oracle: the worth of every servable set, enumerated."""
    positions, rates = draw(seed, 18, 500, 13, 18)
    servability = Servability.of(problem_of(positions, rates, [None, 4][seed % 2]))
    value = np.random.default_rng(seed).uniform(0, 0.5, 18)
    best = max(value[members].sum() for members in all_sets(servability)[0])
    found = price(servability, value, time.monotonic() + 20, exact)
    assert found.bound >= best - 1e-9
    assert found.worth.max() <= best + 1e-9
    if exact:
        assert found.bound <= best * 1.05


@pytest.mark.parametrize("seed", range(4))
def test_ejection_search_yields_valid_partitions_of_fewer_cells(seed):
    positions, rates = draw(seed, 40, 800, 14, 19)
    servability = Servability.of(problem_of(positions, rates, [None, 3][seed % 2]))
    size = 40
    for cells in fewer_cells(servability, [np.array([k]) for k in range(40)], 1, time.monotonic() + 0.5, seed):
        assert is_partition(cells, 40)
        assert all(servability.servable(cell) for cell in cells)
        assert len(cells) < size
        size = len(cells)
    assert size <= len(first_cells(servability))


def test_regrouping_neighbours_gives_ever_fewer_servable_cells():
    """At the density of K = 100; the fewest of a group of neighbours cannot be more than they were."""
    positions, rates = draw(3, 300, 2600)
    servability = Servability.of(problem_of(positions, rates))
    members, _ = maximal_sets(servability)
    start = first_cells(servability)
    size = len(start)
    assert size > GROUP
    for cells in fewer_by_groups(servability, incidence(members, 300), start, 1, time.monotonic() + 20, 0):
        assert is_partition(cells, 300)
        assert all(servability.servable(cell) for cell in cells)
        assert len(cells) < size
        size = len(cells)
        if size < len(start) - 3:
            break
    assert size < len(start)


@pytest.mark.parametrize("milliseconds", range(2, 120, 9))
def test_a_search_that_is_cut_short_anywhere_gives_a_fleet_and_a_bound(milliseconds: int):
    positions, rates = draw(0, 200, 2100)
    servability = Servability.of(problem_of(positions, rates))
    *_, fleet = smallest_fleet(servability, first_cells(servability), time.monotonic() + milliseconds / 1e3, 0)
    assert is_partition(fleet.cells, 200)
    assert all(servability.servable(cell) for cell in fleet.cells)
    assert 1 <= fleet.bound <= len(fleet.cells)


def assert_bounds_more_uavs(program: RateProgram, fewest: int, most: int) -> None:
    later = time.monotonic() + 60
    first = program.solve(fewest, None, later)
    for more in range(1, most - fewest + 1):
        found = program.solve(fewest + more, None, later)
        assert found.total_rate <= first.relaxed + more * first.marginal + 1e-6


def test_rate_program_bounds_more_uavs_as_well():
    """`relaxed` and `marginal` together bound the best total rate of every larger number of UAVs."""
    positions, rates = draw(4, 12, 700)
    servability = Servability.of(problem_of(positions, rates))
    members, sets = all_sets(servability)
    fewest = len(solve(positions, rates, "optimal").uav_positions)
    assert_bounds_more_uavs(RateProgram(servability, members, sets, LINK.power_eta), fewest, 12)


def test_the_bound_on_more_uavs_holds_where_the_linear_program_is_not_whole():
    """Triangles of which any two devices can share a UAV, but not all three: the linear program takes halves."""
    random = np.random.default_rng(5)
    corners = np.array([[0.0, 0.0], [20.0, 0.0], [10.0, 17.0]])
    positions = np.concatenate([corners + np.array([5000.0 * k, 0.0]) for k in range(6)])
    servability = Servability.of(problem_of(positions, random.uniform(15, 16.5, 18), 2))
    members, sets = all_sets(servability)
    assert max(map(len, members)) == 2
    assert_bounds_more_uavs(RateProgram(servability, members, sets, LINK.power_eta), 12, 18)


def test_dense_instance_without_enumeration_is_bounded_within_the_time():
    positions, rates = draw(0, 60, 1500, 10, 15)
    started = time.monotonic()
    found = solve(positions, rates, "optimal", time_limit_s=6)
    assert time.monotonic() - started < 12  # twice the limit: a noisy machine
    assert found.violations(positions, rates, LINK) == []
    assert len(found.uav_positions) <= len(solve(positions, rates, "jpap").uav_positions)
    assert 1 <= found.min_uavs_bound <= len(found.uav_positions)
    assert found.proven_optimal == (found.min_uavs_bound == len(found.uav_positions))
    assert found.average_uav_rate <= found.average_uav_rate_bound


def test_deployments_get_better_until_proven():
    positions, rates = draw(1, 50, 1500)
    seen = list(improve(problem_of(positions, rates)))
    counts = [len(d.uav_positions) for d in seen]
    assert counts == sorted(counts, reverse=True)
    assert all(d.violations(positions, rates, LINK) == [] for d in seen)
    assert counts[0] <= len(solve(positions, rates, "jpap").uav_positions)
    bounds = [d.min_uavs_bound for d in seen]
    assert bounds == sorted(bounds)
    assert seen[-1].proven_optimal


@pytest.mark.parametrize("seconds", [0.01, 0.2])
def test_shortest_time_limits_still_give_a_whole_deployment(seconds):
    positions, rates = draw(2, 80, 1500, 12, 18)
    found = solve(positions, rates, "optimal", time_limit_s=seconds)
    assert found.violations(positions, rates, LINK) == []
    assert len(found.uav_positions) <= len(solve(positions, rates, "jpap").uav_positions)


def test_no_devices_one_device_and_devices_in_one_place():
    nothing = solve(np.empty((0, 2)), [], "optimal")
    assert len(nothing.uav_positions) == 0
    assert nothing.proven_optimal
    one = solve([[3.0, 4.0]], [LINK.max_rate], "optimal")
    np.testing.assert_allclose(one.uav_positions, [[3.0, 4.0]])
    same = solve(np.zeros((6, 2)), np.full(6, LINK.max_rate - 1.5), "optimal")
    # 2^1.5 = 2.83: two such demands fit one UAV, three do not.
    assert len(same.uav_positions) == 3
    assert same.proven_optimal


def test_a_device_that_no_uav_can_serve_is_reported_and_the_rest_is_proven():
    found = solve([[0, 0], [50, 0], [90, 0]], [16, 25, 16], "optimal")
    assert list(found.unserved) == [1]
    assert found.proven_optimal
    assert len(found.uav_positions) == 1


def test_maximal_sets_cover_as_well_as_all_sets():
    positions, rates = draw(6, 25, 900)
    servability = Servability.of(problem_of(positions, rates))
    covered = np.unique(np.concatenate(maximal_sets(servability)[0]))
    np.testing.assert_array_equal(covered, np.arange(25))


def test_cells_come_in_the_order_of_their_first_devices() -> None:
    """Oracle: the definition; so the same cells have the same numbers however the search came to them."""
    draw = np.random.default_rng(5)
    found = solve(draw.uniform(0, 1500, (25, 2)), draw.uniform(15, 20, 25), "optimal")
    first = [int(found.cell(uav).min()) for uav in range(len(found.uav_positions))]
    assert len(first) > 5 and first == sorted(first)

"""K-means baseline, worked by hand.

With P_T eta = 10^4 m^2, H = 50 m and demands of w = 2^r - 1 = 1, n devices in a cell have, under QDPA and EPA alike,
the squared radius 10^4 / n - 2500 m^2: 86.6 m for one device, 50 m for two, 28.9 m for three, 0 for four.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.cluster.vq import kmeans2

from jpap_ros.planning import Deployment, LinkBudget, solve
from jpap_ros.planning.kmeans import _k_means_plus_plus

LINK = LinkBudget(transmit_power_dbm=0, noise_power_dbm=-70, reference_gain_db=-30, altitude_m=50)
SCHEMES = ("kmeans_qdpa", "kmeans_epa")


def cells(deployment: Deployment) -> list[set[int]]:
    """Cells as sets of devices, by their least device."""
    found = (set(deployment.cell(n).tolist()) for n in range(len(deployment.uav_positions)))
    return sorted(found, key=min)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_two_pairs_of_which_one_is_too_far_apart(scheme: str) -> None:
    """Oracle by hand: one cluster has radius 0; of the two natural pairs one has its devices 60 m > 50 m out."""
    positions = [[0, 0], [80, 0], [300, 0], [300, 120]]
    deployment = solve(positions, [1, 1, 1, 1], scheme, LINK)
    assert cells(deployment) == [{0, 1}, {2}, {3}]
    by_device = deployment.uav_positions[deployment.serving_uav]
    assert by_device == pytest.approx(np.array([[40, 0], [40, 0], [300, 0], [300, 120]]))
    # P_T = 1 mW, halved for the pair; SNR 5000 / (40^2 + 50^2) for the pair and 10^4 / 50^2 = 4 alone.
    assert deployment.power_w == pytest.approx([0.5e-3, 0.5e-3, 1e-3, 1e-3])
    assert deployment.rate == pytest.approx([math.log2(1 + 5000 / 4100)] * 2 + [math.log2(5)] * 2)


def test_qdpa_reaches_where_epa_does_not() -> None:
    """Oracle by hand: w = 1 and 0.5, each 60 m from the centroid.

    QDPA: 10^4 / 1.5 - 2500 = 4166.7 = 64.5^2, so one UAV. EPA: 10^4 / 2 - 2500 = 50^2 for w = 1, so two.
    """
    positions, rates = [[0, 0], [120, 0]], [1, math.log2(1.5)]
    together = solve(positions, rates, "kmeans_qdpa", LINK)
    assert together.uav_positions == pytest.approx(np.array([[60, 0]]))
    assert together.coverage_radius_m == pytest.approx([math.sqrt(1e4 / 1.5 - 2500)])
    assert together.power_w == pytest.approx([2e-3 / 3, 1e-3 / 3])
    assert cells(solve(positions, rates, "kmeans_epa", LINK)) == [{0}, {1}]


@pytest.mark.parametrize("scheme", SCHEMES)
def test_devices_at_one_place_are_packed(scheme: str) -> None:
    """Oracle by hand: straight above, four devices of w = 1 take 4 x 2500 = 10^4 m^2, all there is; so 9 need 3."""
    positions = [[7, 7]] * 9 + [[500, 500]]
    deployment = solve(positions, [1] * 10, scheme, LINK)
    assert sorted(len(cell) for cell in cells(deployment)) == [1, 1, 4, 4]
    assert {9} in cells(deployment)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_cell_limit_is_met_at_the_least_number_of_clusters(scheme: str) -> None:
    """Oracle by hand: two groups of three, 1 m wide and far apart; with two a cell each group needs two UAVs."""
    positions = [[0, 0], [1, 0], [0, 1], [900, 0], [901, 0], [900, 1]]
    assert len(solve(positions, [1] * 6, scheme, LINK).uav_positions) == 2
    limited = solve(positions, [1] * 6, scheme, LINK, max_devices_per_uav=2)
    assert sorted(len(cell) for cell in cells(limited)) == [1, 1, 2, 2]


@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_seed_alone_decides(scheme: str) -> None:
    """Same seed, same deployment; among some seeds there are different ones (so the seed is used)."""
    rng = np.random.default_rng(5)
    positions, rates = rng.uniform(0, 1500, (40, 2)), rng.uniform(15, 20, 40)
    first = solve(positions, rates, scheme, seed=3)
    again = solve(positions, rates, scheme, seed=3)
    assert np.array_equal(first.uav_positions, again.uav_positions)
    others = {tuple(solve(positions, rates, scheme, seed=seed).serving_uav.tolist()) for seed in range(4)}
    assert len(others) > 1


@pytest.mark.parametrize("scheme", SCHEMES)
def test_an_expired_time_limit_still_gives_a_deployment(scheme: str) -> None:
    """Oracle: P1's constraints, and the smallest number of clusters, which the full search finds in a moment here."""
    rng = np.random.default_rng(6)
    positions, rates = rng.uniform(0, 1500, (60, 2)), rng.uniform(15, 20, 60)
    hasty, full = solve(positions, rates, scheme, time_limit_s=1e-9), solve(positions, rates, scheme)
    assert hasty.violations(positions, rates, LinkBudget()) == []
    assert not hasty.unserved
    assert len(hasty.uav_positions) <= 1.1 * len(full.uav_positions)


@pytest.mark.timeout(60)
def test_a_thousand_devices_within_the_planners_time_limit() -> None:
    rng = np.random.default_rng(7)
    side = 1500 * math.sqrt(10)
    positions, rates = rng.uniform(0, side, (1000, 2)), rng.uniform(15, 20, 1000)
    deployment = solve(positions, rates, "kmeans_qdpa", time_limit_s=2)
    assert deployment.violations(positions, rates, LinkBudget()) == []
    # At this density the paper's field of 100 devices takes about 60 UAVs (docs/reproduction.md).
    assert len(deployment.uav_positions) < 700


def test_the_draws_are_those_of_scipy() -> None:
    # Oracle: SciPy's k-means++; with a centroid in every place, its Lloyd iteration moves none.
    points = np.random.default_rng(8).uniform(0, 1500, (50, 2))
    theirs = kmeans2(points, 50, iter=1, minit="++", rng=np.random.default_rng(9))[0]
    assert np.array_equal(_k_means_plus_plus(points, 50, np.random.default_rng(9)), theirs)


def test_points_too_close_for_double_precision_end() -> None:
    """Squared distances that underflow to 0 leave k-means++ nothing to weigh by; the search ends all the same."""
    positions = [[k * 1e-170, 0] for k in range(20)]
    deployment = solve(positions, [1] * 20, "kmeans_qdpa", LINK, max_devices_per_uav=3)
    assert (deployment.serving_uav >= 0).all()
    assert max(len(cell) for cell in cells(deployment)) <= 3

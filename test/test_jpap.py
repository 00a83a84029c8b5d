"""The JPAP scheme. Oracles: instances worked by hand from the listing and equations (1) to (11); P1's constraints."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jpap_ros.planning import LinkBudget, solve
from jpap_ros.planning.allocation import QDPA
from jpap_ros.planning.jpap import jpap_with
from jpap_ros.planning.reference import reference_jpap
from jpap_ros.planning.solver import Problem, validate

LINK = LinkBudget()
SCHEMES = ["jpap", "jpap_epa", "jpap_epa_common"]


def problem(positions, rates, max_devices_per_uav: int | None = None) -> Problem:
    return validate(positions, rates, LINK, max_devices_per_uav, None, None, 0.0, None, 0)


def draw_devices(count: int, seed: int, low: float = 15.0, high: float = 20.0) -> tuple[np.ndarray, np.ndarray]:
    draw = np.random.default_rng(seed)
    side = 150.0 * math.sqrt(max(count, 1))  # the density of the paper's K = 100
    return draw.uniform(0, side, (count, 2)), draw.uniform(low, high, count)


def cells(deployment) -> list[list[int]]:
    return [deployment.cell(uav).tolist() for uav in range(len(deployment.uav_positions))]


def test_hand_worked_instance() -> None:
    """Four devices on a line, a = 0, 60, 700, 1600, r = 17, 16, 16, 18; P_T eta = 1e10, H^2 = 2500.

    w = 131071, 65535, 65535, 262143. Radii with all the power, (5): sqrt(1e10 / w - 2500) = 271.69, 387.42, 387.42,
    188.85 m; 2 d^0 = 543.4, 774.8, 774.8, 377.7 m. Boundary devices: 3 (largest a), 0 (smallest a); all have b = 0,
    so device 0 (lowest index) is also extreme in b. Within 2 d^0: device 0 has device 1 (60 m); device 3 has none.
    So k_0 = 0, K_0 = {1}. Both: sum w = 196606, (11): d_sv^2 = 1e10 / 196606 - 2500 = 48363.5, d_sv = 219.9 m,
    larger than 60 m: served. (10): P = 10 * 131071 / 196606 = 6.66668, 3.33332 W. D = 60 < 2 H: best near the middle.
    Left: 2 and 3, 900 m apart: one UAV each, first 3 (demands most at equal density), with all the power.
    """
    positions, rates = [[0, 0], [60, 0], [700, 0], [1600, 0]], [17.0, 16.0, 16.0, 18.0]
    found = solve(positions, rates)
    assert [found.cell(uav).tolist() for uav in range(3)] == [[0, 1], [3], [2]]
    assert found.power_w == pytest.approx([10 * 131071 / 196606, 10 * 65535 / 196606, 10, 10], rel=1e-12)
    assert found.coverage_radius_m == pytest.approx(
        [math.sqrt(1e10 / w - 2500) for w in (196606, 262143, 65535)], rel=1e-9
    )
    assert found.uav_positions == pytest.approx(np.array([[30, 0], [1600, 0], [700, 0]]), abs=0.5)
    # (1), (3): 30 m aside, 50 m below; from straight above log2(1 + 1e10 / 2500).
    q = 30**2 + 2500
    both = sum(math.log2(1 + 1e9 * p / q) for p in found.power_w[:2])
    assert found.uav_rate == pytest.approx([both, LINK.max_rate, LINK.max_rate], abs=1e-3)
    assert found.average_uav_rate == pytest.approx((both + 2 * LINK.max_rate) / 3, abs=1e-3)


def test_hand_worked_instance_of_both_readings_of_epa() -> None:
    """Two devices 110 m apart, w = 2^r - 1 = 1 and 1/2, P_T eta = 1e4 m^2, H^2 = 2500 m^2, P_T = 1 mW.

    d^0, (5): sqrt(1e4 - 2500) = 86.6 m and sqrt(2e4 - 2500) = 132.3 m, so each is in the 2 d^0 of the other; device 0
    demands more, so k_0 = 0. Both, with half the power each, (5): d_0 = sqrt(5000 - 2500) = 50 m and
    d_1 = sqrt(1e4 - 2500) = 86.6 m. With own radii 50 + 86.6 >= 110: one UAV, from 23.4 to 50 m from device 0. With
    the smaller for both, 50 + 50 < 110: two UAVs. QDPA, (10), (11): P = 2/3 and 1/3 mW, d_sv = sqrt(1e4 / 1.5 - 2500)
    = 64.5 m, and 2 * 64.5 >= 110: one UAV, from 45.5 to 64.5 m from device 0.
    """
    link = LinkBudget(transmit_power_dbm=0, noise_power_dbm=-70)
    positions, rates = [[0, 0], [0, 110]], [1.0, math.log2(1.5)]
    own, common, qdpa = (solve(positions, rates, scheme, link) for scheme in ("jpap_epa", "jpap_epa_common", "jpap"))
    assert [cells(found) for found in (own, common, qdpa)] == [[[0, 1]], [[0], [1]], [[0, 1]]]
    assert own.power_w == pytest.approx([0.5e-3, 0.5e-3])
    assert common.power_w == pytest.approx([1e-3, 1e-3])
    assert qdpa.power_w == pytest.approx([2e-3 / 3, 1e-3 / 3])
    assert own.coverage_radius_m is None
    assert common.coverage_radius_m == pytest.approx([math.sqrt(7500), math.sqrt(17500)])
    assert qdpa.coverage_radius_m == pytest.approx([math.sqrt(1e4 / 1.5 - 2500)])
    assert 110 - math.sqrt(7500) <= own.uav_positions[0, 1] <= 50
    assert 110 - 64.6 <= qdpa.uav_positions[0, 1] <= 64.6
    # (1), (3): each rate from where the UAV hovers.
    for found in (own, qdpa):
        q = np.array([found.uav_positions[0, 1], 110 - found.uav_positions[0, 1]]) ** 2 + 2500
        assert found.rate == pytest.approx(np.log2(1 + found.power_w * 1e7 / q))
    assert common.rate == pytest.approx([math.log2(1 + 1e4 / 2500)] * 2)


def test_the_dense_boundary_device_goes_first() -> None:
    # Device 0 is the one with the largest a and alone; device 3, with the smallest a, has two neighbours.
    found = solve([[1000, 0], [-980, 10], [-980, -10], [-1000, 0]], [16.0] * 4)
    assert found.cell(0).tolist() == [1, 2, 3]


def test_it_stops_at_the_first_infeasible_device_unless_told_to_go_on() -> None:
    """Devices on a line at 0, 130 and 150 m, r = 19, 20, 15; w = 524287, 1048575, 32767.

    Boundary: 0 and 2, both with two neighbours in their 2 d^0 (257 m; 1100 m); 0 demands more, so k_0 = 0. Nearest
    is 1: 1e10 / 1572862 - 2500 = 3857.9, d_sv = 62.1 m, less than half of 130 m: infeasible, and the listing stops.
    Device 2 would do: 1e10 / 557054 - 2500 = 15451.6, d_sv = 124.3 m, more than half of 150 m. The rest, 1 and 2, are
    20 m apart: 1e10 / 1081342 - 2500 = 6747.8, d_sv = 82.1 m: one UAV.
    """
    line = problem([[0, 0], [130, 0], [150, 0]], [19.0, 20.0, 15.0])
    assert cells(jpap_with("jpap", line, QDPA)) == [[0], [1, 2]]
    assert cells(jpap_with("jpap", line, QDPA, skip_infeasible=True)) == [[0, 2], [1]]


def test_the_next_device_is_the_nearest_to_where_the_uav_is_by_then() -> None:
    """Listing, step 5, worked by hand. Devices 0 to 3 at (0, 0), (-60, 0), (-1, 65), (-90, 0) m, all with r = 19.

    w = 524287; (5): d^0 = sqrt(1e10 / w - 2500) = 128.7 m, so each is in the 2 d^0 = 257.5 m of all others; the first
    of the paper's order, the one with the largest a, is 0. From v* = (0, 0), the nearest is 1 (60 m; 2: 65.0, 3: 90 m).
    (11): d_sv = sqrt(1e10 / 2 w - 2500) = 83.9 m >= 30 m. 60 m < 2 H, so the best is the middle, v* = (-30, 0).
    From there 3 is at 60 m and 2 at sqrt(29^2 + 65^2) = 71.2 m: 3 is next, though 2 is nearer to k_0.
    With 3, d_sv = 62.1 m >= 45 m. On the line, sum (x - a_k) / ((x - a_k)^2 + 2500) = 0 at x = -57.98:
    -0.009891 + 0.000808 + 0.009083. With 2 as well, d_sv = 47.6 m, less than half of the 110.2 m from 2 to 3: stop.
    Had 2 been taken before 3, the cells would be {0, 1, 2} and {3}: from (-30, 30) all three are within 46 m < 62.1 m.
    """
    positions, rates = [[0, 0], [-60, 0], [-1, 65], [-90, 0]], [19.0] * 4
    found = solve(positions, rates)
    assert cells(found) == [[0, 1, 3], [2]]
    assert found.uav_positions == pytest.approx(np.array([[-57.977, 0], [-1, 65]]), abs=0.05)
    assert found.coverage_radius_m == pytest.approx([62.1115, 128.7382], abs=1e-4)
    assert found.power_w == pytest.approx([10 / 3, 10 / 3, 10, 10 / 3])
    # (1), (3): q = 57.977^2, 2.023^2 and 32.023^2, each + 2500, and c = 1e10 / 3; from straight above 21.9316.
    assert found.rate == pytest.approx([19.11732, 20.34425, 21.93157, 19.85071], abs=1e-3)
    order = [covered for covered, _ in reference_jpap(problem(positions, rates), QDPA)]
    assert order == [[0, 1, 3], [2]]


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("limit", [1, 2, 3])
def test_k_max_holds(scheme: str, limit: int) -> None:
    # Ten devices within 20 m with small demands: nothing but K_max keeps them from one UAV.
    positions = np.random.default_rng(0).uniform(0, 20, (10, 2))
    found = solve(positions, np.full(10, 5.0), scheme, max_devices_per_uav=limit)
    assert len(found.uav_positions) == math.ceil(10 / limit)
    assert found.violations(positions, np.full(10, 5.0), LINK, max_devices_per_uav=limit) == []


@pytest.mark.parametrize("scheme", SCHEMES)
@settings(max_examples=20, deadline=None)
@given(
    count=st.integers(0, 40),
    seed=st.integers(0, 10**6),
    demand=st.sampled_from([(15.0, 20.0), (0.01, 0.02), (18.0, 21.5)]),
    limit=st.sampled_from([None, 1, 3]),
)
def test_every_constraint_holds(scheme: str, count: int, seed: int, demand, limit: int | None) -> None:
    positions, rates = draw_devices(count, seed, *demand)
    found = solve(positions, rates, scheme, max_devices_per_uav=limit)
    assert found.violations(positions, rates, LINK, max_devices_per_uav=limit) == []
    assert not found.unserved


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6), quarter=st.integers(0, 3), east=st.floats(-1e4, 1e4), north=st.floats(-1e4, 1e4))
def test_invariance_under_shifts_quarter_turns_and_order(seed: int, quarter: int, east: float, north: float) -> None:
    """The boundary rule knows the axes: the scheme follows shifts and turns by 90 degrees, and no other turn.

    Only exact ties in the number of neighbours could break a quarter turn; the larger demand decides those.
    """
    positions, rates = draw_devices(25, seed)
    turn = [np.eye(2), [[0, 1], [-1, 0]], [[-1, 0], [0, -1]], [[0, -1], [1, 0]]][quarter]
    moved = positions @ np.array(turn) + [east, north]
    order = np.random.default_rng(seed).permutation(25)
    here, there = solve(positions, rates), solve(moved[order], rates[order])
    assert cells(here) == [sorted(order[cell].tolist()) for cell in cells(there)]
    assert there.average_uav_rate == pytest.approx(here.average_uav_rate, abs=1e-3)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_scaling_power_and_noise_together_changes_nothing(scheme: str) -> None:
    positions, rates = draw_devices(30, 5)
    here = solve(positions, rates, scheme)
    louder = LinkBudget(transmit_power_dbm=47.0, noise_power_dbm=-83.0)
    there = solve(positions, rates, scheme, link=louder)
    assert cells(here) == cells(there)
    assert there.uav_positions == pytest.approx(here.uav_positions, abs=1e-3)
    assert there.power_w == pytest.approx(here.power_w * 10**0.7, rel=1e-9)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_degenerate_instances(scheme: str) -> None:
    assert len(solve([], [], scheme).uav_positions) == 0
    one = solve([[5.0, 6.0]], [18.0], scheme)
    assert one.uav_positions == pytest.approx(np.array([[5.0, 6.0]]))
    assert one.power_w == pytest.approx([10.0])
    # All on one point: w = 2^16 - 1, P_T eta / H^2 = 4e6: 61 fit (61 * 65535 <= 4e6), 62 do not.
    stacked = solve(np.zeros((62, 2)), np.full(62, 16.0), scheme)
    assert sorted(len(cell) for cell in cells(stacked)) == [1, 61]
    line = np.column_stack([np.linspace(0, 900, 12), np.linspace(0, 300, 12)])
    assert solve(line, np.full(12, 17.0), scheme).violations(line, np.full(12, 17.0), LINK) == []

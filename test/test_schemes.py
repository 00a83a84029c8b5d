"""What holds for every scheme, on fields of devices made to be awkward as well as on the paper's."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from jpap_ros.planning import SCHEMES, Deployment, LinkBudget, solve

LINK = LinkBudget()
#: Schemes whose result does not depend on the direction of the axes. JPAP looks for boundary devices along the axes, so
#: that it withstands right turns only.
ROTATION = [name for name in SCHEMES if not name.startswith("jpap")]
#: Schemes whose result does not depend on the order of the devices. K-means draws its initialisations by index.
ORDER = [name for name in SCHEMES if not name.startswith("kmeans")]

each_scheme = pytest.mark.parametrize("scheme", list(SCHEMES))
quick = settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.too_slow])
#: For whole random fields, of which `optimal` solves two in most of a second.
few = settings(max_examples=5, deadline=None, suppress_health_check=[HealthCheck.too_slow])
field_seeds = st.integers(0, 10**6)
whole_metres = st.integers(-20_000, 20_000)


class Field(NamedTuple):
    """Devices, and the limit of devices a UAV."""

    positions: np.ndarray
    rates: np.ndarray
    max_devices_per_uav: int | None


@st.composite
def fields(draw: st.DrawFn) -> Field:
    """Fields of all kinds: spread out or crowded, or on a coarse grid, where devices coincide and lie on lines.

    The demands range from little to just more than one UAV can give (21.93 bit/s/Hz).
    """
    devices = draw(st.integers(1, 12))
    coordinate = draw(
        st.sampled_from([st.floats(0, 1500), st.floats(-60, 60), st.integers(0, 3).map(lambda step: 80.0 * step)])
    )
    demand = draw(st.sampled_from([st.floats(15, 20), st.floats(0.1, 22.5), st.just(18.0)]))
    positions = draw(st.lists(st.tuples(coordinate, coordinate), min_size=devices, max_size=devices))
    rates = draw(st.lists(demand, min_size=devices, max_size=devices))
    return Field(np.array(positions, float), np.array(rates), draw(st.sampled_from([None, None, 1, 2, 5])))


def random_field(seed: int, devices: int = 25) -> tuple[np.ndarray, np.ndarray]:
    """A field like the paper's, on a lattice of 1/1024 m: shifts by whole metres and right turns are then exact."""
    rng = np.random.default_rng(seed)
    return np.round(rng.uniform(0, 1200, (devices, 2)) * 1024) / 1024, rng.uniform(15, 20, devices)


def cells(deployment: Deployment) -> set[frozenset[int]]:
    """The cells as sets of devices."""
    return {frozenset(deployment.cell(n).tolist()) for n in range(len(deployment.uav_positions))}


@each_scheme
@quick
@given(field=fields())
def test_every_constraint_holds(scheme: str, field: Field) -> None:
    """Oracle: P1's constraints, computed afresh; and equation (3) at zero distance for who cannot be served."""
    deployment = solve(
        field.positions, field.rates, scheme, max_devices_per_uav=field.max_devices_per_uav, time_limit_s=5
    )
    assert deployment.violations(field.positions, field.rates, LINK, field.max_devices_per_uav) == []
    assert deployment.scheme == scheme
    possible = np.log2(1 + LINK.transmit_power_w * LINK.eta / LINK.altitude_m**2)
    sure = field.rates[np.abs(field.rates - possible) > 1e-9]
    unserved = set(deployment.unserved)
    assert unserved == set(np.flatnonzero(deployment.serving_uav < 0).tolist())
    assert {float(field.rates[k]) for k in unserved} >= {float(rate) for rate in sure if rate > possible}
    assert not {float(field.rates[k]) for k in unserved} & {float(rate) for rate in sure if rate < possible}


@pytest.mark.parametrize("scheme", [name for name in SCHEMES if name != "optimal"])
@quick
@given(field=fields())
def test_no_scheme_beats_the_optimum(scheme: str, field: Field) -> None:
    """Oracle: the proven minimum of the scheme `optimal`, found by an unrelated method."""
    limit = field.max_devices_per_uav
    deployment = solve(field.positions, field.rates, scheme, max_devices_per_uav=limit, time_limit_s=5)
    # The proof is a matter of milliseconds at this size; the time limit cuts the search for the best rates short.
    best = solve(field.positions, field.rates, "optimal", max_devices_per_uav=limit, time_limit_s=5)
    assert best.proven_optimal
    assert len(best.uav_positions) <= len(deployment.uav_positions)
    if deployment.min_uavs_bound is not None:
        assert deployment.min_uavs_bound <= len(best.uav_positions)


def assert_equally_good(one: Deployment, other: Deployment) -> None:
    """What two answers of the scheme `optimal` to the same problem have in common, however much time each had.

    The least number of UAVs, proven; and neither has more rate than the other proved possible.
    """
    assert one.proven_optimal and other.proven_optimal
    assert len(one.uav_positions) == len(other.uav_positions)
    assert one.average_uav_rate_bound is not None and other.average_uav_rate_bound is not None
    assert one.average_uav_rate <= other.average_uav_rate_bound + 1e-6
    assert other.average_uav_rate <= one.average_uav_rate_bound + 1e-6


@each_scheme
@pytest.mark.parametrize("seed", range(3))
def test_the_same_call_gives_the_same_deployment(scheme: str, seed: int) -> None:
    positions, rates = random_field(seed)
    first, second = (solve(positions, rates, scheme, seed=seed) for _ in range(2))
    if scheme == "optimal":
        assert_equally_good(first, second)
        return
    assert np.array_equal(first.uav_positions, second.uav_positions)
    assert np.array_equal(first.serving_uav, second.serving_uav)
    assert np.array_equal(first.power_w, second.power_w)


def assert_moved(before: Deployment, after: Deployment, moved: np.ndarray) -> None:
    """The same cells, each UAV moved with the devices."""
    if before.scheme == "optimal":
        assert_equally_good(before, after)
        return
    assert cells(after) == cells(before)
    at = before.serving_uav, after.serving_uav
    assert after.uav_positions[at[1]] == pytest.approx(moved[at[0]], abs=1e-4)
    assert after.rate == pytest.approx(before.rate, abs=1e-6)


@each_scheme
@few
@given(seed=field_seeds, east=whole_metres, north=whole_metres)
def test_translation_moves_everything_along(scheme: str, seed: int, east: int, north: int) -> None:
    """Oracle: P1 depends on differences of positions only."""
    positions, rates = random_field(seed)
    shift = np.array([east, north], float)
    before, after = solve(positions, rates, scheme), solve(positions + shift, rates, scheme)
    assert_moved(before, after, before.uav_positions + shift)


@each_scheme
@few
@given(seed=field_seeds, turns=st.integers(1, 3))
def test_right_turns_turn_everything_along(scheme: str, seed: int, turns: int) -> None:
    """Oracle: P1 depends on distances only. With right turns the coordinates stay exact."""
    positions, rates = random_field(seed)
    turn = np.linalg.matrix_power(np.array([[0.0, 1.0], [-1.0, 0.0]]), turns)
    before, after = solve(positions, rates, scheme), solve(positions @ turn, rates, scheme)
    assert_moved(before, after, before.uav_positions @ turn)


@pytest.mark.parametrize("scheme", ROTATION)
@few
@given(seed=field_seeds, angle=st.floats(0, 2 * math.pi))
def test_any_rotation_turns_everything_along(scheme: str, seed: int, angle: float) -> None:
    """Oracle: P1 depends on distances only; a random field has no ties that rounding could decide otherwise."""
    positions, rates = random_field(seed)
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    before, after = solve(positions, rates, scheme), solve(positions @ turn, rates, scheme)
    assert_moved(before, after, before.uav_positions @ turn)


@pytest.mark.parametrize("scheme", ORDER)
@few
@given(seed=field_seeds)
def test_the_order_of_devices_does_not_matter(scheme: str, seed: int) -> None:
    positions, rates = random_field(seed)
    order = np.random.default_rng(seed).permutation(len(rates))
    before, after = solve(positions, rates, scheme), solve(positions[order], rates[order], scheme)
    if scheme == "optimal":
        assert_equally_good(before, after)
        return
    assert {frozenset(order[list(cell)].tolist()) for cell in cells(after)} == cells(before)
    assert after.rate == pytest.approx(before.rate[order], abs=1e-6)


@each_scheme
@few
@given(seed=field_seeds, shift_db=st.floats(-30, 30))
def test_power_and_noise_scale_together(scheme: str, seed: int, shift_db: float) -> None:
    """Oracle: P1 depends on the ratio of power and noise only; powers scale, all else stays."""
    positions, rates = random_field(seed)
    link = replace(
        LINK,
        transmit_power_dbm=LINK.transmit_power_dbm + shift_db,
        noise_power_dbm=LINK.noise_power_dbm + shift_db,
    )
    before, after = solve(positions, rates, scheme), solve(positions, rates, scheme, link)
    if scheme == "optimal":
        assert_equally_good(before, after)
        return
    assert cells(after) == cells(before)
    assert after.rate == pytest.approx(before.rate, abs=1e-6)
    assert after.power_w == pytest.approx(before.power_w * 10 ** (shift_db / 10), rel=1e-9)


@each_scheme
@quick
@given(field=fields(), gain_db=st.floats(0.1, 12))
def test_a_servable_set_stays_servable_with_more_link_budget(scheme: str, field: Field, gain_db: float) -> None:
    """Oracle: every coverage radius (5) grows with the power, so nothing that was feasible is lost.

    Cell by cell: what one UAV served as a set of its own, it still serves.
    """
    more = replace(LINK, transmit_power_dbm=LINK.transmit_power_dbm + gain_db)

    def served(members: list[int], link: LinkBudget, limit: int | None = None) -> Deployment:
        where, demands = field.positions[members], field.rates[members]
        return solve(where, demands, scheme, link, max_devices_per_uav=limit, time_limit_s=2)

    everyone = list(range(len(field.rates)))
    before = served(everyone, LINK, field.max_devices_per_uav)
    assert set(served(everyone, more, field.max_devices_per_uav).unserved) <= set(before.unserved)
    for cell in map(sorted, cells(before)):
        if len(served(cell, LINK).uav_positions) == 1:
            assert len(served(cell, more).uav_positions) == 1


@each_scheme
def test_no_devices(scheme: str) -> None:
    deployment = solve(np.empty((0, 2)), [], scheme)
    assert deployment.uav_positions.shape == (0, 2)
    assert math.isnan(deployment.average_uav_rate)
    assert deployment.violations(np.empty((0, 2)), [], LINK) == []


@each_scheme
def test_one_device(scheme: str) -> None:
    """Oracle: the listing's step 3: straight above, with all the power, the rate is log2(1 + P_T eta / H^2)."""
    deployment = solve([[12.5, -7]], [16.0], scheme)
    assert deployment.uav_positions == pytest.approx(np.array([[12.5, -7.0]]))
    assert deployment.power_w == pytest.approx([10.0])
    assert deployment.rate == pytest.approx([math.log2(1 + 1e10 / 2500)])


@each_scheme
@pytest.mark.parametrize(("devices", "uavs"), [(15, 1), (16, 2), (30, 2), (31, 3)])
def test_all_devices_at_one_place_with_equal_demands(scheme: str, devices: int, uavs: int) -> None:
    """Oracle: by hand. n (2^18 - 1) 50^2 <= 10^10 up to n = 15, so ceil(K / 15) UAVs, straight above."""
    positions = np.full((devices, 2), 321.0)
    deployment = solve(positions, np.full(devices, 18.0), scheme)
    assert len(deployment.uav_positions) == uavs
    assert deployment.uav_positions == pytest.approx(np.full((uavs, 2), 321.0))


@each_scheme
def test_devices_on_one_line(scheme: str) -> None:
    """Oracle: by hand. 100 m apart, a third device never fits: for n = 3 the radius is 101.1 m, for 4 it is 83.9 m.

    Three in a row (100 m from the middle one) do fit, four (150 m) do not; so 9 devices need 3 UAVs at least, and
    every UAV is on the line.
    """
    positions = np.column_stack([100.0 * np.arange(9), 50.0 * np.ones(9)])
    deployment = solve(positions, np.full(9, 18.0), scheme)
    assert deployment.violations(positions, np.full(9, 18.0), LINK) == []
    assert deployment.uav_positions[:, 1] == pytest.approx(50.0, abs=1e-6)
    assert 3 <= len(deployment.uav_positions) <= 5
    assert max(map(len, cells(deployment))) <= 3


@each_scheme
def test_an_impossible_demand_is_named_and_the_rest_is_served(scheme: str) -> None:
    positions, rates = random_field(2, devices=8)
    rates[3] = 25.0
    deployment = solve(positions, rates, scheme)
    assert set(deployment.unserved) == {3}
    assert "25" in deployment.unserved[3]
    assert "21.93" in deployment.unserved[3]
    rest = np.delete(np.arange(8), 3)
    assert {
        frozenset(rest[list(cell)].tolist()) for cell in cells(solve(positions[rest], rates[rest], scheme))
    } == cells(deployment)


@each_scheme
@pytest.mark.parametrize("coincident", [False, True])
def test_one_device_a_uav(scheme: str, coincident: bool) -> None:
    """Oracle: with K_max = 1 there are as many UAVs as devices, each straight above its own."""
    positions, rates = random_field(4, devices=9)
    if coincident:
        positions[:] = positions[0]
    deployment = solve(positions, rates, scheme, max_devices_per_uav=1)
    assert sorted(deployment.serving_uav.tolist()) == list(range(9))
    assert deployment.uav_positions[deployment.serving_uav] == pytest.approx(positions)

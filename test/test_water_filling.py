"""Power allocation above the floors, for a given position; and the position that makes the most of it.

Oracles: scipy's SLSQP on the problem as stated, the Karush-Kuhn-Tucker conditions, and a fine grid of positions.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize

from jpap_ros.planning import LinkBudget
from jpap_ros.planning.optimal.enumeration import all_sets
from jpap_ros.planning.optimal.position import RATE_TOLERANCE, best_positions
from jpap_ros.planning.optimal.servability import Servability
from jpap_ros.planning.solver import validate
from jpap_ros.planning.water_filling import water_fill


@st.composite
def channels(draw):
    count = draw(st.integers(1, 6))
    random = np.random.default_rng(draw(st.integers(0, 2**31)))
    total = float(10 ** random.uniform(-2, 2))
    noise = total * 10 ** random.uniform(-3, 1, count)
    floor = total * random.dirichlet(np.ones(count)) * random.uniform(0, 1)
    return noise, floor, total


@settings(max_examples=40, deadline=None)
@given(channels())
def test_no_less_than_slsqp(channel):
    noise, floor, total = channel
    power = water_fill(noise, floor, total)
    scale = noise / total  # SLSQP likes numbers near one
    found = optimize.minimize(
        lambda p: -np.log2(1 + p / scale).sum(),
        (floor + (total - floor.sum()) / len(floor)) / total,
        bounds=[(f / total, 1) for f in floor],
        constraints={"type": "eq", "fun": lambda p: p.sum() - 1},
        method="SLSQP",
        options={"maxiter": 500, "ftol": 1e-12},
    )
    mine = np.log2(1 + power / noise).sum()
    assert mine >= -found.fun - 1e-7
    if found.success:
        assert mine == pytest.approx(-found.fun, abs=1e-4)


@settings(max_examples=200, deadline=None)
@given(channels())
def test_spends_the_total_keeps_the_floors_and_levels_the_water(channel):
    """The KKT conditions, which are sufficient as the problem is concave."""
    noise, floor, total = channel
    power = water_fill(noise, floor, total)
    assert power.sum() == pytest.approx(total, rel=1e-12)
    assert (power >= floor * (1 - 1e-12)).all()
    level = noise + power
    wet = power > floor * (1 + 1e-9)
    if wet.any():
        assert np.ptp(level[wet]) <= 1e-9 * level[wet].max()
        assert (level[~wet] >= level[wet].max() * (1 - 1e-9)).all()


def test_many_at_once_and_empty_places():
    noise = np.array([[1.0, 2.0, np.inf], [4.0, np.inf, np.inf]])
    floor = np.array([[0.5, 0.0, 0.0], [1.0, 0.0, 0.0]])
    np.testing.assert_allclose(water_fill(noise, floor, np.array([3.0, 2.0])), [[2.0, 1.0, 0.0], [2.0, 0.0, 0.0]])


def test_floors_that_take_everything():
    np.testing.assert_allclose(water_fill([1.0, 1.0], [2.0, 3.0], 5.0), [2.0, 3.0])


def rate_at(link, positions, rates, v):
    """Largest sum rate from position v, -inf where the demands cannot be met."""
    noise = 10 ** (link.noise_power_dbm / 10 - 3) / link.channel_gain(((positions - v) ** 2).sum(axis=1))
    floor = (2.0**rates - 1) * noise
    if floor.sum() > link.transmit_power_w:
        return -np.inf
    return np.log2(1 + water_fill(noise, floor, link.transmit_power_w) / noise).sum()


@pytest.mark.parametrize("seed", range(4))
def test_no_position_of_a_fine_grid_is_better_and_the_bound_holds(seed):
    random = np.random.default_rng(seed)
    link = LinkBudget()
    positions, rates = random.uniform(0, 400, (6, 2)), random.uniform(13, 18, 6)
    servability = Servability.of(validate(positions, rates, link, None, None, None, 0.0, None, 0))
    members, sets = all_sets(servability)
    hover = best_positions(servability, members, sets, link.power_eta)
    assert (hover.bound - hover.rate <= RATE_TOLERANCE * (1 + 1e-9)).all()
    for i in random.choice(len(members), min(8, len(members)), replace=False):
        at, radius = sets.centroid[i], sets.slack_radius[i]
        where = rate_at(link, positions[members[i]], rates[members[i]], hover.position[i])
        assert where == pytest.approx(hover.rate[i], abs=1e-6)
        for x in np.linspace(-radius, radius, 41):
            for y in np.linspace(-radius, radius, 41):
                better = rate_at(link, positions[members[i]], rates[members[i]], at + np.array([x, y]))
                assert better <= hover.bound[i] + 1e-9


@pytest.mark.parametrize("rounds", [1, 2, 3, 5])
def test_quick_bounds_are_bounds(rounds):
    random = np.random.default_rng(9)
    link = LinkBudget()
    positions, rates = random.uniform(0, 500, (9, 2)), random.uniform(13, 18, 9)
    servability = Servability.of(validate(positions, rates, link, None, None, None, 0.0, None, 0))
    members, sets = all_sets(servability)
    exact = best_positions(servability, members, sets, link.power_eta)
    quick = best_positions(servability, members, sets, link.power_eta, rounds)
    assert (quick.rate <= exact.bound + 1e-9).all()
    assert (quick.bound >= exact.rate - 1e-9).all()

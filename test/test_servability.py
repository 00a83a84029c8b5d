"""The exact servability test, the enumeration of servable sets and of the maximal ones.

Oracle: the definition itself. A set is servable if some position gives every device its demand with powers that sum
to P_T; the least total power over positions is found here with scipy's minimiser, started from several places.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize

from jpap_ros.planning import LinkBudget
from jpap_ros.planning.optimal.enumeration import TooManySets, all_sets, maximal_sets
from jpap_ros.planning.optimal.servability import Servability
from jpap_ros.planning.solver import validate


def servability_of(positions, rates, most=None, link=LinkBudget()):  # noqa: B008 (frozen)
    return Servability.of(validate(positions, rates, link, most, None, None, 0.0, None, 0))


def least_power(positions, rates, link):
    """Least power [W] that meets the demands, over all positions; from equation (3) alone."""

    def needed(v):
        gain = link.channel_gain(((positions - v) ** 2).sum(axis=1))
        return ((2.0**rates - 1) * 10 ** (link.noise_power_dbm / 10 - 3) / gain).sum()

    starts = [*positions, positions.mean(axis=0)]
    return min(optimize.minimize(needed, v, method="Nelder-Mead", options={"xatol": 1e-7}).fun for v in starts)


@st.composite
def instances(draw, most=6):
    seed, count = draw(st.integers(0, 2**31)), draw(st.integers(1, most))
    random = np.random.default_rng(seed)
    side = draw(st.sampled_from([30.0, 200.0, 500.0, 900.0]))
    return random.uniform(0, side, (count, 2)), random.uniform(13, 20, count)


@settings(max_examples=40, deadline=None)
@given(instances())
def test_closed_form_agrees_with_a_search_for_the_least_power(instance):
    positions, rates = instance
    link = LinkBudget()
    servability = servability_of(positions, rates)
    load = servability.measure(np.arange(len(rates))).load[0]
    assert load == pytest.approx(least_power(positions, rates, link) / link.transmit_power_w, rel=1e-6)
    assert servability.servable(np.arange(len(rates))) == (load <= 1)


@settings(max_examples=60, deadline=None)
@given(instances())
def test_update_by_one_device_agrees_with_measuring_afresh(instance):
    positions, rates = instance
    servability = servability_of(positions, rates)
    sets = servability.singles()[:1]
    for k in range(1, len(rates)):
        sets = servability.joined(sets, np.array([k]))
    fresh = servability.measure(np.arange(len(rates)))
    for name in ("weight", "centroid", "load"):
        np.testing.assert_allclose(getattr(sets, name), getattr(fresh, name), rtol=1e-10)


def test_update_is_exact_far_from_the_origin_of_the_map():
    """A shift of the map changes no load; raw second moments would lose every digit here."""
    random = np.random.default_rng(3)
    positions, rates = random.uniform(0, 300, (5, 2)), random.uniform(13, 15, 5)
    loads = []
    for shift in (0.0, 1e7):
        servability = servability_of(positions + shift, rates)
        sets = servability.singles()[:1]
        for k in range(1, 5):
            sets = servability.joined(sets, np.array([k]))
        loads.append(sets.load[0])
    assert loads[1] == pytest.approx(loads[0], rel=1e-9)


def test_slack_disc_is_exactly_where_the_set_can_be_served_from():
    random = np.random.default_rng(0)
    positions, rates = random.uniform(0, 150, (3, 2)), random.uniform(15, 17, 3)
    link = LinkBudget()
    sets = servability_of(positions, rates).measure([0, 1, 2])
    for angle in np.linspace(0, 6, 7):
        for part, inside in ((0.999, True), (1.001, False)):
            v = sets.centroid[0] + part * sets.slack_radius[0] * np.array([np.cos(angle), np.sin(angle)])
            gain = link.channel_gain(((positions - v) ** 2).sum(axis=1))
            needed = ((2.0**rates - 1) * 10 ** (link.noise_power_dbm / 10 - 3) / gain).sum()
            assert (needed <= link.transmit_power_w) == inside


@settings(max_examples=25, deadline=None)
@given(instances(most=8), st.sampled_from([None, 1, 2, 3]))
def test_enumeration_finds_every_servable_set_and_every_maximal_one(instance, most):
    """Oracle: all 2^K subsets, each measured by itself."""
    positions, rates = instance
    servability = servability_of(positions, rates, most)
    count = len(rates)
    subsets = [c for m in range(1, count + 1) for c in itertools.combinations(range(count), m)]
    servable = {c for c in subsets if servability.servable(c)}
    found, measures = all_sets(servability)
    assert {tuple(s) for s in found} == servable
    assert len(found) == len(servable)
    for members, load in zip(found, measures.load, strict=True):
        assert load == pytest.approx(servability.measure(members).load[0], rel=1e-10)
    maximal = {c for c in servable if not any(set(c) < set(d) for d in servable)}
    assert {tuple(s) for s in maximal_sets(servability)[0]} == maximal


@settings(max_examples=25, deadline=None)
@given(instances(most=7))
def test_subsets_of_servable_sets_are_servable(instance):
    positions, rates = instance
    servability = servability_of(positions, rates)
    for members in all_sets(servability)[0]:
        for k in range(len(members)):
            rest = np.delete(members, k)
            assert not len(rest) or servability.servable(rest)


def test_enumeration_gives_up_when_there_are_too_many():
    random = np.random.default_rng(0)
    servability = servability_of(random.uniform(0, 100, (30, 2)), np.full(30, 8.0))
    with pytest.raises(TooManySets):
        all_sets(servability, most=1000)
    with pytest.raises(TooManySets):
        maximal_sets(servability, deadline=0.0)


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 10**6),
    st.integers(1, 40),
    st.sampled_from([0.0, 100.0, 600.0, 3000.0]),
    st.sampled_from([(1e-3, 20.9), (13, 20), (20.8, 20.95), (18, 18)]),
    st.sampled_from([0.0, 1e8]),
    st.sampled_from([None, 1, 2]),
)
def test_neighbours_are_the_pairs_that_are_servable(seed, count, side, demands, shift, most):
    """Oracle: every pair, tested by itself."""
    random = np.random.default_rng(seed)
    positions, rates = random.uniform(0, side, (count, 2)) + shift, random.uniform(*demands, count)
    servability = servability_of(positions, rates, most)
    everyone, singles = np.arange(count), servability.singles()
    near = servability.neighbours()
    assert len(near) == count
    for k in range(count):
        good = servability.fits(singles[np.full(count, k)], everyone) & (everyone != k) & (most != 1)
        np.testing.assert_array_equal(near[k], np.flatnonzero(good))


def test_neighbours_are_looked_for_once():
    random = np.random.default_rng(0)
    servability = servability_of(random.uniform(0, 1500, (50, 2)), random.uniform(15, 20, 50))
    assert servability.neighbours() is servability.neighbours()

"""Take-offs and landings, one wave after the other.

Oracle: the climbs and descents are acted out in small steps with every order of speeds within a wave, and distances
are measured; nothing of the product's grouping is used. Small cases are worked out by hand.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jpap_ros.fleet.sequencing import landing_waves, takeoff_waves

SEPARATION_M = 12.0
TOP_M = 90.0


def acted_out(waves, pads, speeds, landing):
    """Least distance between any two in the air, with aircraft of a wave at speeds of their own."""
    final = waves.altitude_m
    height = {name: final[name] if landing else pads[name][2] for name in final}
    least = math.inf
    for wave in waves.waves:
        share = 0.0
        while share < 1.0:
            share = min(share + 0.02, 1.0)
            for name, altitude in wave.items():
                done = min(share * speeds[name] / min(speeds[other] for other in wave), 1.0)
                up = 1 - done if landing else done
                height[name] = pads[name][2] + up * (altitude - pads[name][2])
            flying = [name for name in final if height[name] > pads[name][2]]
            for a, b in itertools.combinations(flying, 2):
                least = min(least, math.dist((*pads[a][:2], height[a]), (*pads[b][:2], height[b])))
    return least


@settings(max_examples=80, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(1, 10),
    side=st.sampled_from([8.0, 30.0, 100.0]),
    landing=st.booleans(),
)
def test_nobody_in_the_air_comes_near(seed, count, side, landing):
    rng = np.random.default_rng(seed)
    pads = {f"uav{i}": (*rng.uniform(0, side, 2), rng.uniform(0, 3)) for i in range(count)}
    plan = (landing_waves if landing else takeoff_waves)(pads, 30.0, SEPARATION_M, TOP_M)
    assert set(plan.altitude_m) | set(plan.held) == set(pads)
    assert not set(plan.altitude_m) & set(plan.held)
    assert all(pads[name][2] + 30.0 <= altitude <= TOP_M for name, altitude in plan.altitude_m.items())
    speeds = {name: rng.uniform(1, 3) for name in pads}
    assert acted_out(plan, pads, speeds, landing) >= SEPARATION_M - 1e-9


def test_far_apart_all_go_at_once_each_to_the_height_asked_for_above_its_own_ground():
    plan = takeoff_waves({"a": (0, 0, 0), "b": (12, 0, 5), "c": (0, 30, -2)}, 40.0, SEPARATION_M, TOP_M)
    assert plan.waves == ({"a": 40.0, "b": 45.0, "c": 38.0},)


def test_close_pads_by_hand():
    # b is near a and c, which are 20 m apart: a and c together, then b, 12 m lower.
    pads = {"a": (0, 0, 0), "b": (10, 0, 0), "c": (20, 0, 0)}
    assert takeoff_waves(pads, 40.0, SEPARATION_M, TOP_M).waves == ({"a": 52.0, "c": 52.0}, {"b": 40.0})
    assert landing_waves(pads, 40.0, SEPARATION_M, TOP_M).waves == ({"a": 40.0, "c": 40.0}, {"b": 52.0})


def test_more_neighbours_than_layers_wait_and_say_for_whom():
    # From 40 m to 90 m there are layers at 40, 52, 64, 76 and 88 m.
    pads = {f"uav{i}": (i, 0, 0) for i in range(7)}
    plan = takeoff_waves(pads, 40.0, SEPARATION_M, TOP_M)
    assert [list(wave) for wave in plan.waves] == [[f"uav{i}"] for i in range(5)]
    assert plan.altitude_m["uav0"] == 88.0
    assert set(plan.held) == {"uav5", "uav6"}
    assert "waits for uav4" in plan.held["uav5"]


def test_those_who_come_later_wait_above_those_who_came_before():
    # x waits at 45 m above a place 5 m from a's home: 40 m and 52 m are too near to it, 64 m is not. b is far from it.
    homes = {"a": (0, 0, 0), "b": (0, 60, 0)}
    plan = landing_waves(homes, 40.0, SEPARATION_M, TOP_M, waiting={"x": (5, 0, 45)})
    assert plan.altitude_m == {"a": 64.0, "b": 40.0}
    full = landing_waves(homes, 40.0, SEPARATION_M, TOP_M, waiting={"x": (5, 0, 80)})
    assert full.held == {"a": "waits for x: no height is left above its home"}


def test_nobody_at_all():
    assert takeoff_waves({}, 40.0, SEPARATION_M, TOP_M).waves == ()


@pytest.mark.parametrize(
    ("pads", "height", "separation", "message"),
    [
        ({"a": (0, math.inf, 0)}, 10.0, 12.0, r"pads\['a'\]\[1\] must be finite, got inf"),
        ({}, 0.0, 12.0, "height_m must be finite and > 0, got 0.0"),
        ({}, 10.0, math.nan, "separation_m must be finite and > 0, got nan"),
    ],
)
def test_bad_input_is_named(pads, height, separation, message):
    with pytest.raises(ValueError, match=message):
        takeoff_waves(pads, height, separation, TOP_M)

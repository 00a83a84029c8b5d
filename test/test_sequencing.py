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
from jpap_ros.fleet.transit_plan import Obstacle, TransitLimits

LIMITS = TransitLimits(min_separation_m=10.0, tracking_error_m=1.0, min_altitude_m=20.0, max_altitude_m=90.0)


def acted_out(waves, homes, speeds, landing):
    """Least distance between any two in the air, with aircraft of a wave at speeds of their own."""
    final = waves.altitude_m
    height = {name: final[name] if landing else 0.0 for name in final}
    least = math.inf
    for wave in waves.waves:
        share = 0.0
        while share < 1.0:
            share = min(share + 0.02, 1.0)
            for name, altitude in wave.items():
                done = min(share * speeds[name] / min(speeds[other] for other in wave), 1.0)
                height[name] = altitude * (1 - done) if landing else altitude * done
            flying = [name for name in final if height[name] > 0]
            for a, b in itertools.combinations(flying, 2):
                least = min(least, math.dist((*homes[a], height[a]), (*homes[b], height[b])))
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
    homes = {f"uav{i}": tuple(rng.uniform(0, side, 2)) for i in range(count)}
    plan = (landing_waves if landing else takeoff_waves)(homes, 30.0, LIMITS)
    assert set(plan.altitude_m) | set(plan.held) == set(homes)
    assert not set(plan.altitude_m) & set(plan.held)
    assert all(30.0 <= altitude <= LIMITS.max_altitude_m for altitude in plan.altitude_m.values())
    speeds = {name: rng.uniform(1, 3) for name in homes}
    assert acted_out(plan, homes, speeds, landing) >= LIMITS.planned_separation_m - 1e-9


def test_far_apart_all_go_at_once_to_the_altitude_asked_for():
    plan = takeoff_waves({"a": (0, 0), "b": (12, 0), "c": (0, 30)}, 40.0, LIMITS)
    assert plan.waves == ({"a": 40.0, "b": 40.0, "c": 40.0},)


def test_close_homes_by_hand():
    # b is near a and c, which are 20 m apart: a and c together, then b, 12 m lower.
    homes = {"a": (0, 0), "b": (10, 0), "c": (20, 0)}
    assert takeoff_waves(homes, 40.0, LIMITS).waves == ({"a": 52.0, "c": 52.0}, {"b": 40.0})
    assert landing_waves(homes, 40.0, LIMITS).waves == ({"a": 40.0, "c": 40.0}, {"b": 52.0})


def test_more_neighbours_than_layers_wait_and_say_for_whom():
    # From 40 m to 90 m there are layers at 40, 52, 64, 76 and 88 m.
    homes = {f"uav{i}": (i, 0) for i in range(7)}
    plan = takeoff_waves(homes, 40.0, LIMITS)
    assert [list(wave) for wave in plan.waves] == [[f"uav{i}"] for i in range(5)]
    assert plan.altitude_m["uav0"] == 88.0
    assert set(plan.held) == {"uav5", "uav6"}
    assert "waits for uav4" in plan.held["uav5"]


def test_nobody_climbs_into_another_aircraft_or_across_its_path():
    path = [(-50, 5, 60), (50, 5, 60)]
    plan = takeoff_waves({"a": (0, 0), "b": (0, 60)}, 40.0, LIMITS, airborne={"x": path})
    assert plan.held == {"a": "x is above its home"}
    assert plan.waves == ({"b": 40.0},)
    silent = Obstacle("y", (0.0, 70.0, 50.0), radius_m=5.0)
    assert takeoff_waves({"b": (0, 60)}, 40.0, LIMITS, obstacles=[silent]).held == {"b": "y is above its home"}


def test_nobody_at_all():
    assert takeoff_waves({}, 40.0, LIMITS).waves == ()


@pytest.mark.parametrize(
    ("homes", "altitude", "message"),
    [
        ({"a": (0, math.inf)}, 40.0, r"homes\['a'\]\[1\] must be finite, got inf"),
        ({}, 10.0, "altitude_m must be from 20 to 90, got 10.0"),
        ({}, math.nan, "altitude_m must be from 20 to 90, got nan"),
    ],
)
def test_bad_input_is_named(homes, altitude, message):
    with pytest.raises(ValueError, match=message):
        takeoff_waves(homes, altitude, LIMITS)

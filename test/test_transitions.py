"""Ten thousand random transitions keep aircraft apart.

Oracles: setpoints at moments spread over each transition, which know nothing of closed forms, convoys or layers; and
between those moments `minimum_separation`, which test_transit.py holds against dense sampling. Two to seven aircraft,
and not up to fifteen at five moments a second as in `scripts/bench replanning`, which fails just as this does: so that
all ten thousand fit into a minute.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from jpap_ros.fleet.assignment import assign
from jpap_ros.fleet.transit import plan_transit
from jpap_ros.fleet.transit_plan import Obstacle, TransitLimits, TransitPlan, minimum_separation

LIMITS = TransitLimits(min_separation_m=10.0, tracking_error_m=1.0)
MOMENTS = 20


def sampled_separation(plan: TransitPlan, shares: np.ndarray, obstacles: list[Obstacle]) -> float:
    """Least distance at some shares of the plan's duration; the obstacles are columns down to the ground."""
    track = np.array(
        [np.concatenate([convoy.at(share * plan.duration_s)[0] for convoy in plan.convoys]) for share in shares]
    )
    first, second = np.triu_indices(track.shape[1], k=1)
    least = float(np.linalg.norm(track[:, first] - track[:, second], axis=2).min())
    for obstacle in obstacles:
        east, north, top = obstacle.position
        off = np.stack([track[..., 0] - east, track[..., 1] - north, np.maximum(track[..., 2] - top, 0.0)])
        least = min(least, float(np.linalg.norm(off, axis=0).min()) - obstacle.radius_m)
    return least


@pytest.mark.parametrize("seed", range(20))
def test_no_transition_comes_nearer_than_the_limit_or_than_it_began(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(500):
        size = int(rng.integers(2, 8))
        side = float(rng.choice([60.0, 150.0, 400.0, 1500.0]))
        starts, goals = rng.uniform(0, side, (2, size, 3)) * (1, 1, 0) + (0, 0, 50)
        starts[:, 2] += rng.choice([0.0, 20.0]) * rng.uniform(-1, 1, size)
        if rng.random() < 0.5:
            goals = goals[assign(starts[:, :2], goals[:, :2])]
        places = rng.uniform(0, side, (int(rng.integers(0, 3)), 2))
        obstacles = [Obstacle(f"silent{i}", (*place, 50.0), radius_m=2.0) for i, place in enumerate(places)]
        names = [f"uav{i}" for i in range(size)]
        plan = plan_transit(
            dict(zip(names, starts, strict=True)), dict(zip(names, goals, strict=True)), LIMITS, obstacles
        )
        began = sampled_separation(plan, np.zeros(1), obstacles)
        seen = sampled_separation(plan, np.sort(rng.random(MOMENTS)), obstacles)
        allowed = min(LIMITS.min_separation_m, began) - 1e-6
        assert min(seen, minimum_separation(plan, obstacles)) >= allowed, (names, starts, goals, obstacles)
        assert math.isfinite(seen)


@pytest.mark.parametrize("seed", range(5))
def test_nobody_who_is_in_the_column_of_an_obstacle_comes_nearer_to_it(seed: int) -> None:
    """As below one that a pilot has just taken over. Oracle: setpoints at many moments, and where it was last seen."""
    rng = np.random.default_rng(seed)
    for _ in range(200):
        places = rng.uniform((0, 0, 25), (60, 60, 90), (int(rng.integers(1, 3)), 3))
        obstacles = [Obstacle(f"pilot{i}", tuple(place), radius_m=5.0) for i, place in enumerate(places)]
        near = places[rng.integers(len(places))] + rng.uniform((-10, -10, -20), (10, 10, 20))
        starts = {"near": near, "far": rng.uniform((0, 0, 30), (60, 60, 70))}
        goals = {name: rng.uniform((0, 0, 30), (90, 90, 110)) for name in starts}
        plan = plan_transit(starts, goals, LIMITS, obstacles)
        for name, place in ((name, place) for name in starts for place in places):
            track = np.array([plan.position(name, moment) for moment in np.linspace(0.0, plan.duration_s, 200)])
            seen = np.linalg.norm(track - place, axis=1)
            assert seen.min() >= min(seen[0], LIMITS.min_separation_m + 5.0) - 1e-6, (starts, goals, places)

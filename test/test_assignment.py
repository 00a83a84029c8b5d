"""Which UAV flies to which goal.

Oracle: every injective assignment of a small instance, enumerated with itertools and scored by the definitions in the
docstring of `assign`; nothing of the product's matching code is used.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jpap_ros.fleet.assignment import assign

coordinate = st.integers(-20, 20).map(float)
point = st.tuples(coordinate, coordinate)


def every_assignment(goals: int, uavs: int):
    """Every way to give min(goals, uavs) goals a UAV each, as tuples with -1 where a goal has none."""
    served = min(goals, uavs)
    for chosen in itertools.combinations(range(goals), served):
        for crew in itertools.permutations(range(uavs), served):
            result = [-1] * goals
            for goal, uav in zip(chosen, crew, strict=True):
                result[goal] = uav
            yield tuple(result)


def lengths(result, goals, positions, handicap):
    return [math.dist(goals[goal], positions[uav]) + handicap[uav] for goal, uav in enumerate(result) if uav >= 0]


def served_weights(result, weights):
    return sorted((weights[goal] for goal, uav in enumerate(result) if uav >= 0), reverse=True)


@st.composite
def instances(draw):
    goals = draw(st.lists(point, min_size=1, max_size=5))
    positions = draw(st.lists(point, min_size=1, max_size=5))
    handicap = draw(st.lists(st.sampled_from([0.0, 0.0, 7.0]), min_size=len(positions), max_size=len(positions)))
    weights = draw(st.lists(st.sampled_from([1.0, 2.0]), min_size=len(goals), max_size=len(goals)))
    crew = draw(st.permutations([*range(len(positions)), *[-1] * len(goals)]))[: len(goals)]
    return goals, positions, handicap, weights, crew, draw(st.sampled_from([0.0, 3.0, 12.0]))


@settings(max_examples=150, deadline=None)
@given(instances())
def test_squared_distance_is_least_of_all_assignments(instance):
    goals, positions, handicap, weights, keep, margin = instance
    result = assign(goals, positions, keep=keep, keep_margin_m=margin, handicap_m=handicap, weights=weights)

    def cost(candidate):
        return sum(
            (math.dist(goals[g], positions[u]) + handicap[u]) ** 2 - (margin**2 if keep[g] == u else 0.0)
            for g, u in enumerate(candidate)
            if u >= 0
        )

    candidates = list(every_assignment(len(goals), len(positions)))
    best_weights = max(served_weights(c, weights) for c in candidates)
    assert served_weights(result, weights) == best_weights
    best = min(cost(c) for c in candidates if served_weights(c, weights) == best_weights)
    assert cost(result) == pytest.approx(best, abs=1e-6)


@settings(max_examples=150, deadline=None)
@given(instances())
def test_bottleneck_is_least_then_squared_distance(instance):
    goals, positions, handicap, weights, _, _ = instance
    result = assign(goals, positions, objective="bottleneck", handicap_m=handicap, weights=weights)
    candidates = list(every_assignment(len(goals), len(positions)))
    best_weights = max(served_weights(c, weights) for c in candidates)
    scored = [
        (max(flown), sum(d * d for d in flown))
        for c in candidates
        if served_weights(c, weights) == best_weights
        for flown in [lengths(c, goals, positions, handicap)]
    ]
    longest = min(score[0] for score in scored)
    total = min(score[1] for score in scored if score[0] <= longest + 1e-9)
    flown = lengths(result, goals, positions, handicap)
    assert max(flown) == pytest.approx(longest)
    assert sum(d * d for d in flown) == pytest.approx(total)


@settings(max_examples=60, deadline=None)
@given(st.integers(6, 7), st.integers(0, 10_000))
def test_seven_by_seven_against_all_permutations(count, seed):
    rng = np.random.default_rng(seed)
    goals, positions = rng.uniform(0, 1000, (count, 2)), rng.uniform(0, 1000, (count, 2))
    distance = np.sqrt(((goals[:, None] - positions) ** 2).sum(axis=2))
    orders = np.array(list(itertools.permutations(range(count))))
    flown = distance[np.arange(count), orders]
    assert np.array_equal(assign(goals, positions), orders[(flown**2).sum(axis=1).argmin()])
    longest = distance[np.arange(count), assign(goals, positions, objective="bottleneck")].max()
    assert longest == pytest.approx(flown.max(axis=1).min())


def test_a_negligible_gain_swaps_nobody_and_a_large_one_does():
    # By hand: crossing over saves (50^2 + 50^2) - (49^2 + 49^2) = 198 m^2; the margin holds 2 * 10^2 against it.
    goals, positions = [[0, 0], [99, 0]], [[50, 0], [49, 0]]
    assert assign(goals, positions, keep_margin_m=10).tolist() == [1, 0]
    assert assign(goals, positions, keep=[0, 1], keep_margin_m=10).tolist() == [0, 1]
    assert assign(goals, positions, keep=[0, 1], keep_margin_m=9).tolist() == [1, 0]


def test_an_infinite_margin_pins_and_the_rest_is_assigned():
    goals, positions = [[0, 0], [10, 0], [20, 0]], [[20, 0], [0, 0], [11, 0]]
    assert assign(goals, positions, keep=[0, -1, -1], keep_margin_m=math.inf).tolist() == [0, 1, 2]


def test_bottleneck_margin_is_stated_in_metres():
    goals, positions = [[0, 0], [100, 0]], [[60, 0], [0, 0]]
    # 60 m and 100 m where kept, 0 m and 40 m where swapped: 60 m shorter, which a margin of 59 m does not hold.
    assert assign(goals, positions, objective="bottleneck", keep=[0, 1], keep_margin_m=59).tolist() == [1, 0]
    assert assign(goals, positions, objective="bottleneck", keep=[0, 1], keep_margin_m=61).tolist() == [0, 1]


def test_a_reserve_flies_only_where_it_is_much_nearer():
    goals = [[0, 0]]
    assert assign(goals, [[5, 0], [30, 0]], handicap_m=[50, 0]).tolist() == [1]
    assert assign(goals, [[5, 0], [80, 0]], handicap_m=[50, 0]).tolist() == [0]
    assert assign(goals, [[5, 0]], handicap_m=[math.inf]).tolist() == [-1]


def test_nothing_to_assign():
    assert assign([], []).tolist() == []
    assert assign([[1, 2]], []).tolist() == [-1]
    assert assign([[1, 2]], [], keep=[-1], keep_margin_m=math.inf).tolist() == [-1]
    assert assign([], [[1, 2]], objective="bottleneck").tolist() == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"goals": [[0, math.nan]], "positions": [[0, 0]]}, r"goals\[0, 1\] must be finite, got nan"),
        ({"goals": [[0, 0]], "positions": [[0, 0, 0]]}, r"positions must have shape \(n, 2\), got \(1, 3\)"),
        ({"goals": [["a", 0]], "positions": []}, "goals must be an array of numbers"),
        (
            {"goals": [], "positions": [], "objective": "time"},
            "objective must be one of distance2, bottleneck, got 'time'",
        ),
        ({"goals": [], "positions": [], "keep_margin_m": math.nan}, "keep_margin_m must be >= 0, got nan"),
        (
            {"goals": [[0, 0]], "positions": [[0, 0]], "keep": []},
            "keep must have one entry for each of the 1 goals, got 0",
        ),
        (
            {"goals": [[0, 0]], "positions": [[0, 0]], "keep": [1]},
            r"keep\[0\] must be -1 or the index of one of 1 UAVs",
        ),
        (
            {"goals": [[0, 0]] * 2, "positions": [[0, 0]], "keep": [0, 0]},
            r"keep\[1\] is UAV 0, which is already that of",
        ),
        ({"goals": [], "positions": [[0, 0]], "handicap_m": [-1]}, r"handicap_m\[0\] must be >= 0, got -1.0"),
        ({"goals": [[0, 0]], "positions": [], "weights": [math.nan]}, r"weights\[0\] must be >= 0, got nan"),
    ],
)
def test_bad_input_is_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        assign(**arguments)

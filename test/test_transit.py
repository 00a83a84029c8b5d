"""Transitions keep aircraft apart.

Oracles: dense sampling in time of the setpoints that would be streamed, which knows nothing of closed forms, convoys
or layers; finite differences of the same samples for speed and acceleration; CAPT's theorem for whether straight lines
are enough; distances worked out by hand.
"""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jpap_ros.fleet.assignment import assign
from jpap_ros.fleet.fence import Fence
from jpap_ros.fleet.separation_check import overrun_distance, polyline_distance, segment_distance
from jpap_ros.fleet.time_law import TimeLaw
from jpap_ros.fleet.transit import is_clear, plan_straight, plan_transit
from jpap_ros.fleet.transit_plan import Convoy, Obstacle, TransitLimits, TransitPlan, minimum_separation

LIMITS = TransitLimits(min_separation_m=10.0, tracking_error_m=1.0)


def spaced(rng, count, side, spacing):
    """Points in a square, at 50 m, none nearer than `spacing` to another."""
    found = []
    while len(found) < count:
        candidate = rng.uniform(0, side, 2)
        if all(math.dist(candidate, other) >= spacing for other in found):
            found.append(candidate)
    return np.column_stack([np.array(found), np.full(count, 50.0)])


def by_name(rows):
    return {f"uav{i}": row for i, row in enumerate(rows)}


def sampled(plan, step_s=0.1):
    """Setpoints (T, n, 3) on a dense grid of times."""
    times = np.arange(0.0, plan.duration_s + 2 * step_s, step_s)
    return np.array([[plan.position(name, t) for name in plan.names] for t in times])


def sampled_separation(track, obstacles=()):
    least = math.inf
    first, second = np.triu_indices(track.shape[1], k=1)
    if len(first):
        least = float(np.linalg.norm(track[:, first] - track[:, second], axis=2).min())
    for obstacle in obstacles:
        east, north, top = obstacle.position
        height = np.clip(track[..., 2], obstacle.bottom_m, top)
        apart = np.hypot(np.hypot(track[..., 0] - east, track[..., 1] - north), track[..., 2] - height)
        least = min(least, float(apart.min()) - obstacle.radius_m)
    return least


@settings(max_examples=120, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(1, 9),
    side=st.sampled_from([40.0, 90.0, 250.0]),
    obstacle_count=st.integers(0, 2),
    spread_m=st.sampled_from([0.0, 25.0]),
)
def test_no_transition_comes_nearer_than_the_limit_or_than_it_began(seed, count, side, obstacle_count, spread_m):
    rng = np.random.default_rng(seed)
    starts, goals = rng.uniform(0, side, (2, count, 3)) * (1, 1, 0) + (0, 0, 50)
    starts[:, 2] += rng.uniform(-spread_m, spread_m, count)
    goals = np.where(rng.random((count, 1)) < 0.2, starts, goals)
    obstacles = [
        Obstacle(f"silent{i}", (*rng.uniform(0, side, 2), 50.0), bottom_m=rng.choice([0.0, 50.0]), radius_m=2.0)
        for i in range(obstacle_count)
    ]
    plan = plan_transit(by_name(starts), by_name(goals), LIMITS, obstacles)
    track = sampled(plan, 0.2)
    began = sampled_separation(track[:1], obstacles)
    seen = sampled_separation(track, obstacles)
    assert seen >= min(LIMITS.min_separation_m, began) - 1e-6
    assert minimum_separation(plan, obstacles) <= seen + 1e-9
    assert minimum_separation(plan, obstacles) >= min(LIMITS.min_separation_m, began) - 1e-6
    for index, name in enumerate(plan.names):
        start, goal = by_name(starts)[name], by_name(goals)[name]
        assert np.array_equal(track[0, index], start)
        assert np.array_equal(track[-1, index], start if name in plan.held else goal)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(2, 14), side=st.sampled_from([110.0, 300.0]))
def test_capt_needs_one_straight_leg_each(seed, count, side):
    rng = np.random.default_rng(seed)
    spacing = math.sqrt(2) * LIMITS.planned_separation_m
    starts, goals = spaced(rng, count, side, spacing), spaced(rng, count, side, spacing)
    goals = goals[assign(starts[:, :2], goals[:, :2])]
    plan = plan_transit(by_name(starts), by_name(goals), LIMITS)
    assert not plan.held
    assert all(len(convoy.laws) == 1 for convoy in plan.convoys)
    assert sampled_separation(sampled(plan)) >= LIMITS.planned_separation_m - 1e-6


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(2, 12))
def test_any_permutation_of_spaced_places_is_flown(seed, count):
    """Theorem 2 of docs/replanning.md: where columns are clear and there are layers enough, nobody is held."""
    rng = np.random.default_rng(seed)
    starts = spaced(rng, count, 150.0, LIMITS.planned_separation_m)
    plan = plan_transit(
        by_name(starts), by_name(starts[rng.permutation(count)]), TransitLimits(10.0, 1.0, max_altitude_m=200.0)
    )
    assert not plan.held
    assert sampled_separation(sampled(plan)) >= LIMITS.planned_separation_m - 1e-6


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.0, 1.0))
def test_speed_and_acceleration_are_bounded_also_when_stopped_on_the_way(seed, share):
    rng = np.random.default_rng(seed)
    starts, goals = spaced(rng, 5, 200.0, 12.0), spaced(rng, 5, 200.0, 12.0)
    plan = plan_transit(by_name(starts), by_name(goals), LIMITS)
    moment = share * plan.duration_s
    stopping = plan.stop(moment)
    streamed = [*np.arange(0.0, moment, 0.02)]
    track = np.array(
        [[plan.position(name, t) for name in plan.names] for t in streamed]
        + [[stopping.position(name, t) for name in plan.names] for t in np.arange(0.0, stopping.duration_s + 0.1, 0.02)]
    )
    joint = len(streamed)  # the sample before the stop lies less than a step earlier
    for part in (track[:joint], track[joint:]):
        if len(part) < 3:
            continue
        velocity = np.diff(part, axis=0) / 0.02
        acceleration = np.diff(velocity, axis=0) / 0.02
        assert np.linalg.norm(velocity[..., :2], axis=2).max() <= LIMITS.speed_m_s + 1e-6
        assert np.abs(velocity[..., 2]).max() <= LIMITS.vertical_speed_m_s + 1e-6
        assert np.linalg.norm(acceleration, axis=2).max() <= LIMITS.acceleration_m_s2 * 1.01 + 1e-6
    if joint:
        assert np.linalg.norm(track[joint] - track[joint - 1], axis=1).max() <= LIMITS.speed_m_s * 0.0201
    assert np.allclose([stopping.velocity(name, 0.0) for name in plan.names], _velocity(plan, moment), atol=1e-6)
    assert sampled_separation(track) >= LIMITS.planned_separation_m - 1e-6


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.0, 1.0), changed_count=st.integers(0, 4))
def test_a_new_plan_on_the_way_stops_only_those_it_concerns(seed, share, changed_count):
    rng = np.random.default_rng(seed)
    starts, goals = spaced(rng, 8, 250.0, 12.0), spaced(rng, 12, 250.0, 12.0)
    plan = plan_transit(by_name(starts), by_name(goals[:8]), LIMITS)
    moment = share * plan.duration_s
    changed = {f"uav{i}": goals[8 + i] for i in range(changed_count)}
    stopping = plan.stop(moment, changed)
    staying = [c for c in stopping.convoys if not set(c.names) & set(changed)]
    for convoy in staying:  # they fly as if nothing had happened
        for t in np.linspace(0, plan.duration_s, 12):
            for name in convoy.names:
                assert stopping.position(name, t) == pytest.approx(plan.position(name, moment + t), abs=1e-6)
                assert stopping.velocity(name, t) == pytest.approx(plan.velocity(name, moment + t), abs=1e-4)
    at_rest = max((c.duration_s for c in stopping.convoys if set(c.names) & set(changed)), default=0.0)
    stopped = {name: stopping.position(name, at_rest) for c in stopping.convoys if c not in staying for name in c.names}
    onward = plan_transit(
        stopped,
        {name: changed.get(name, plan.path(name)[-1]) for name in stopped},
        LIMITS,
        committed=[convoy.rest(at_rest) for convoy in staying],
    )
    least = LIMITS.planned_separation_m - 1e-6
    assert sampled_separation(sampled(stopping)) >= least
    assert sampled_separation(sampled(onward)) >= least
    assert minimum_separation(onward) >= least
    assert set(onward.names) == set(plan.names)
    for name in onward.names:
        goal = stopped[name] if name in onward.held else changed.get(name, plan.path(name)[-1])
        assert onward.position(name, 1e9) == pytest.approx(goal, abs=1e-9)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), moving_count=st.integers(1, 12), share=st.floats(0.0, 1.0))
def test_who_flies_straight_keeps_clear_of_all_others(seed, moving_count, share):
    """Some rest, some are on their way, some are stopping; oracle: the closed form for all, which knows no groups."""
    rng = np.random.default_rng(seed)
    places = spaced(rng, 24, 250.0, 12.0)
    rest = {f"uav{i}": places[i] for i in [*range(6, 12), *range(18, 24)]}
    early = plan_transit(by_name(places[:6]) | rest, {f"uav{i}": places[12 + i] for i in range(6)}, LIMITS)
    moment = share * early.duration_s
    under_way = early.stop(moment, ["uav0", "uav1"])
    stopping = [c for c in under_way.convoys if {"uav0", "uav1"} & set(c.names)]
    committed = [c for c in under_way.convoys if c not in stopping and c.names[0] not in rest]
    moving = list(rest)[:moving_count]
    goals = dict(zip(moving, spaced(rng, moving_count, 250.0, 12.0), strict=True))
    later = {name: places[12] for c in stopping for name in c.names[:1]}
    plan = plan_straight(rest, goals | later, LIMITS, (), committed, stopping)
    flown = {name for convoy in plan.convoys for name in convoy.names}
    assert flown <= set(moving)
    assert not flown & plan.waiting
    for convoy in plan.convoys:
        assert len(convoy.laws) == 1
        for index, name in enumerate(convoy.names):
            assert np.array_equal(convoy.waypoints[:, index], [rest[name], goals[name]])
    resting = tuple(Convoy((name,), place[None, None], ()) for name, place in rest.items() if name not in flown)
    everybody = TransitPlan((*plan.convoys, *resting, *committed, *stopping))
    began = [everybody.path(name)[0] for name in everybody.names]
    nearest = min(math.dist(a, b) for a, b in combinations(began, 2))
    assert minimum_separation(everybody) >= min(LIMITS.min_separation_m, nearest) - 1e-6


def test_who_crosses_one_that_is_stopping_waits_for_it():
    # b stops on its way and then wants to go back along its line, which that of a crosses.
    flying = plan_transit({"b": (0, 0, 50)}, {"b": (200, 0, 50)}, LIMITS).stop(20.0).convoys
    starts, goals = {"a": (60, -80, 50), "c": (500, 0, 50)}, {"a": (60, 80, 50), "b": (0, 0, 50), "c": (500, 90, 50)}
    plan = plan_straight(starts, goals, LIMITS, (), (), flying)
    assert plan.waiting == {"a"}
    assert [convoy.names for convoy in plan.convoys] == [("c",)]


def test_a_convoy_is_compared_with_what_it_was_not_planned_for():
    (convoy,) = plan_transit({"a": (0, 0, 50)}, {"a": (100, 0, 50)}, LIMITS).convoys
    assert is_clear(convoy, {}, LIMITS, (), ())
    assert is_clear(convoy, {"b": (50, 12.1, 50)}, LIMITS, (), ())
    assert not is_clear(convoy, {"b": (50, 11.9, 50)}, LIMITS, (), ())
    assert not is_clear(convoy, {}, LIMITS, [Obstacle("x", (50, 16, 60), radius_m=5.0)], ())
    (across,) = plan_transit({"b": (50, -90, 50)}, {"b": (50, 90, 50)}, LIMITS).convoys
    assert not is_clear(convoy, {}, LIMITS, (), [across])
    assert is_clear(convoy, {}, LIMITS, (), [across.stop(10.0)])


def test_a_column_up_to_the_ceiling_is_passed_at_its_side():
    high = Obstacle("uav9", (50.0, 1.0, 120.0), radius_m=3.0)
    plan = plan_transit({"a": (0, 0, 50)}, {"a": (100, 0, 50)}, LIMITS, [high])
    assert not plan.held
    assert minimum_separation(plan, [high]) == pytest.approx(12.0, abs=1e-6)
    assert plan.path("a")[:, 1].min() == pytest.approx(-14.0)  # 1 - 12 - 3


def _velocity(plan, moment):
    return [plan.velocity(name, moment) for name in plan.names]


def test_who_has_hardly_begun_stops_where_it_is():
    # At 1e-160 of full speed, 1e-320 of the leg: the law to stop within that would be faster than any number.
    assert TimeLaw(1.0, 1.0).braking(1e-160) == (pytest.approx(0.0), pytest.approx(0.0), None)


def test_duration_by_hand():
    # 100 m at 5 m/s with 1 m/s^2: 5 s and 12.5 m to get up to speed, the same to stop, 75 m in 15 s between.
    plan = plan_transit({"a": (0, 0, 50)}, {"a": (100, 0, 50)}, LIMITS)
    assert plan.duration_s == pytest.approx(25.0)
    assert plan.position("a", 5.0) == pytest.approx((12.5, 0, 50))
    assert plan.velocity("a", 10.0) == pytest.approx((5, 0, 0))
    # 9 m is too short to get up to speed: 3 s up to 3 m/s and 3 s down.
    assert plan_transit({"a": (0, 0, 50)}, {"a": (9, 0, 50)}, LIMITS).duration_s == pytest.approx(6.0)


def test_two_that_swap_places_pass_on_layers():
    starts = {"a": (0, 0, 50), "b": (100, 0, 50)}
    plan = plan_transit(starts, {"a": (100, 0, 50), "b": (0, 0, 50)}, LIMITS)
    assert not plan.held
    assert minimum_separation(plan) == pytest.approx(12.0, abs=1e-6)


def test_one_hovering_in_the_way_is_passed_above():
    plan = plan_transit({"a": (0, 0, 50), "b": (50, 0, 50)}, {"a": (100, 0, 50)}, LIMITS)
    assert plan.path("a")[:, 2].max() == pytest.approx(62.0)
    assert (plan.path("b") == (50, 0, 50)).all()


def test_aircraft_far_apart_do_not_wait_for_one_another():
    plan = plan_transit({"a": (0, 0, 50), "b": (0, 500, 50)}, {"a": (20, 0, 50), "b": (2000, 500, 50)}, LIMITS)
    assert plan.arrival_s("a") < 15 < 400 < plan.arrival_s("b")


def test_too_near_at_the_start_may_only_part():
    starts = {"a": (0, 0, 50), "b": (4, 0, 50)}
    apart = plan_transit(starts, {"a": (-50, 0, 50), "b": (50, 0, 50)}, LIMITS)
    assert not apart.held
    assert minimum_separation(apart) == pytest.approx(4.0, abs=1e-6)
    across = plan_transit(starts, {"a": (50, 0, 50), "b": (-50, 0, 50)}, LIMITS)
    assert minimum_separation(across) == pytest.approx(4.0, abs=1e-6)


def test_a_silent_aircraft_at_the_goal_makes_the_other_hold_and_says_so():
    silent = Obstacle("uav9", (100.0, 3.0, 50.0))
    plan = plan_transit({"a": (0, 0, 50)}, {"a": (100, 0, 50)}, LIMITS, [silent])
    assert "uav9" in plan.held["a"]
    assert (plan.position("a", 1e3) == (0, 0, 50)).all()


def test_goals_nearer_than_the_limit_make_one_hold():
    plan = plan_transit({"a": (0, 0, 50), "b": (100, 0, 50)}, {"a": (48, 0, 50), "b": (52, 0, 50)}, LIMITS)
    assert len(plan.held) == 1


def test_column_below_a_silent_aircraft_is_closed_and_the_air_above_is_not():
    silent = Obstacle("uav9", (50.0, 0.0, 50.0), bottom_m=0.0)
    plan = plan_transit({"a": (0, 0, 30)}, {"a": (100, 0, 30)}, LIMITS, [silent])
    assert not plan.held
    assert plan.path("a")[:, 2].max() >= 62.0


def test_distances_by_hand():
    a = np.array([[0.0, 0, 0], [10, 0, 0]])
    assert polyline_distance(a, np.array([[5.0, -5, 3], [5, 5, 3]])) == pytest.approx(3.0)  # skew lines
    assert polyline_distance(a, np.array([[12.0, 2, 1]])) == pytest.approx(3.0)  # past the end
    assert polyline_distance(a, np.array([[-5.0, 4, 0], [20, 4, 0]])) == pytest.approx(4.0)  # parallel
    assert polyline_distance(a, np.array([[13.0, 4, 0], [20, 4, 0]])) == pytest.approx(5.0)  # parallel, apart


@settings(max_examples=100, deadline=None)
@given(st.lists(st.integers(-6, 6).map(float), min_size=12, max_size=12))
def test_segment_distance_against_a_dense_grid(numbers):
    a0, a1, b0, b1 = np.array(numbers).reshape(4, 3)
    share = np.linspace(0, 1, 81)[:, None]
    grid = np.linalg.norm((a0 + share * (a1 - a0))[:, None] - (b0 + share * (b1 - b0))[None], axis=2).min()
    exact = float(segment_distance(a0, a1, b0, b1))
    spacing = (np.linalg.norm(a1 - a0) + np.linalg.norm(b1 - b0)) / 160
    assert grid - spacing - 1e-9 <= exact <= grid + 1e-9


@settings(max_examples=60, deadline=None)
@given(st.lists(st.integers(-6, 6).map(float), min_size=12, max_size=12), st.floats(0.0, 1.0))
def test_overrun_distance_against_a_dense_grid(numbers, overrun):
    a0, a1, b0, b1 = np.array(numbers).reshape(4, 3)
    stopped, farther = np.meshgrid(np.linspace(0, 1, 81), overrun * np.linspace(0, 1, 81))
    flying = np.minimum(stopped + farther, 1.0)
    places = a0 + stopped[..., None] * (a1 - a0), b0 + flying[..., None] * (b1 - b0)
    grid = np.linalg.norm(places[0] - places[1], axis=2).min()
    exact = float(overrun_distance(a0, a1, b0, b1, overrun))
    spacing = (np.linalg.norm(a1 - a0) + 2 * np.linalg.norm(b1 - b0)) / 160
    assert grid - spacing - 1e-9 <= exact <= grid + 1e-9


def test_those_that_follow_closely_fly_slowly_enough_to_stop():
    # 20 m apart in one line, 10 m to spare: v + v^2 / 2 <= 10 m for a reaction of 1 s and 1 m/s^2, so 3.5 m/s of the
    # shares of 5 m/s (3.58 m/s would do). 200 m, 3.5 s and 6.125 m each to get up to speed and down from it.
    starts = {"a": (0, 0, 50), "b": (20, 0, 50)}
    plan = plan_transit(starts, {"a": (200, 0, 50), "b": (220, 0, 50)}, LIMITS)
    assert plan.duration_s == pytest.approx(2 * 3.5 + (200 - 2 * 6.125) / 3.5)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: plan_transit({"a": (0, 0, math.nan)}, {}, LIMITS), r"starts\['a'\]\[2\] must be finite, got nan"),
        (lambda: plan_transit({"a": (0, 0)}, {}, LIMITS), r"starts\['a'\] must have shape \(3,\), got \(2,\)"),
        (lambda: plan_transit({}, {"a": (0, 0, 0)}, LIMITS), "goals has 'a', which has no start"),
        (
            lambda: plan_transit(
                {"a": (0, 0, 9)}, {}, LIMITS, committed=plan_transit({"a": (0, 0, 0)}, {}, LIMITS).convoys
            ),
            "committed has 'a', which has a start as well",
        ),
        (lambda: TransitLimits(min_separation_m=-1), "min_separation_m must be >= 0, got -1"),
        (lambda: TransitLimits(speed_m_s=0), "speed_m_s must be > 0, got 0"),
        (lambda: TransitLimits(max_altitude_m=10), "max_altitude_m is 10, below min_altitude_m 20.0"),
        (lambda: TransitLimits(tracking_error_m=math.inf), "tracking_error_m must be a finite number, got inf"),
        (lambda: Obstacle("x", (0, 0, math.inf)), "obstacle x: position, bottom_m, radius_m and way must be finite"),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()


#: A square with a notch from the north, 20 m wide and 80 m deep.
NOTCHED = Fence(
    polygon_m=((0, 0), (100, 0), (100, 100), (60, 100), (60, 20), (40, 20), (40, 100), (0, 100)), max_height_m=80.0
)


@settings(max_examples=80, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 7))
def test_no_way_leads_out_of_the_fence(seed, count):
    """Oracle: the fence's own word for each sampled setpoint; that a leg may touch an edge costs rounding only."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(0, 100, (40 * count, 2))
    places = [place for place in places if NOTCHED.breach(*place, 50.0) is None][: 2 * count]
    starts, goals = (np.column_stack([rows, np.full(count, 50.0)]) for rows in (places[:count], places[count:]))
    limits = TransitLimits(10.0, 1.0).within(NOTCHED)
    plan = plan_transit(by_name(starts), by_name(goals), limits)
    for setpoint in sampled(plan, 0.3).reshape(-1, 3):
        assert NOTCHED.outside_m(tuple(setpoint)) <= 1e-5
    direct = plan_straight(by_name(starts), by_name(goals), limits)
    for convoy in direct.convoys:
        for setpoint in np.linspace(convoy.waypoints[0], convoy.waypoints[-1], 100).reshape(-1, 3):
            assert NOTCHED.outside_m(tuple(setpoint)) <= 1e-5


def test_who_would_have_to_leave_the_fence_holds_and_says_so():
    limits = TransitLimits(10.0, 1.0).within(NOTCHED)
    plan = plan_transit({"a": (20, 80, 50)}, {"a": (80, 80, 50)}, limits)
    assert plan.held == {"a": "no separated path to its goal; in the way: the fence"}


def test_layers_keep_to_the_fence():
    # Exchanging places at 30 m takes a layer 12 m away: 42 m is too high, 18 m is free only with the lower limit.
    swap = {"a": (0, 0, 30), "b": (100, 0, 30)}, {"a": (100, 0, 30), "b": (0, 0, 30)}
    for lowest_m, held in ((10.0, 0), (20.0, 2)):
        limits = TransitLimits(10.0, 1.0, min_altitude_m=lowest_m).within(Fence(max_height_m=40.0))
        plan = plan_transit(*swap, limits)
        assert len(plan.held) == held
        assert sampled(plan)[..., 2].max() <= 40.0
    with pytest.raises(ValueError, match=r"the fence allows 0 to 15 m, transit_min_height_m"):
        TransitLimits().within(Fence(max_height_m=15.0))


def test_a_line_on_which_somebody_may_be_is_closed_with_the_air_below_it():
    silent = Obstacle("silent", (0, 0, 50), radius_m=5.0, way=((40, 0, 50), (40, 30, 60)))
    # By hand: 20 m beside the first leg and 30 m below it; above the middle of the second, 55 m high there.
    for place, distance in (((20, -20, 20), 20.0), ((60, 15, 30), 20.0), ((40, 30, 75), 15.0)):
        assert polyline_distance(np.array([place], float), silent.column) == pytest.approx(distance, abs=0.5)
    # Columns below the line are no farther apart than the radius: from between two of them it is half of that.
    assert polyline_distance(np.array([[22.5, 0.0, 20.0]]), silent.column) == pytest.approx(2.5)
    plan = plan_transit({"a": (20, -40, 45)}, {"a": (20, 40, 45)}, LIMITS, [silent])
    assert minimum_separation(plan, [silent]) >= LIMITS.min_separation_m


def test_a_tired_aircraft_does_not_climb_into_its_relief_that_a_pilot_has_taken_over():
    """The relief is 12 m straight above; home is beyond it, so that the way up would be the shortest."""
    pilot = Obstacle("relief", (0, 0, 62), radius_m=5.0)
    plan = plan_transit({"tired": (0, 0, 50)}, {"tired": (-300, -300, 74)}, LIMITS, [pilot])
    assert not plan.held
    track = np.array([plan.position("tired", moment) for moment in np.linspace(0.0, plan.duration_s, 500)])
    assert np.linalg.norm(track - (0, 0, 62), axis=1).min() >= 12.0 - 1e-6

"""Motion of the simulated multirotor against the kinematics of a trapezoidal velocity profile."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jpap_ros.sim.dynamics import MAX_STEP_S, MotionLimits, PointMass

LIMITS = MotionLimits(speed=10.0, acceleration=2.5, climb=2.5, descent=1.5, vertical_acceleration=1.0)


def fly(body: PointMass, goal: tuple[float, float, float], dt: float, limit_s: float = 200.0) -> float:
    """Fly until there; return the time. Checks every step against the limits."""
    limits, elapsed = body.limits, 0.0
    while body.position != goal or body.speed or body.vz:
        before = (body.x, body.y, body.z, body.vx, body.vy, body.vz)
        body.fly_to(goal, dt)
        elapsed += dt
        assert elapsed < limit_s, f"not at {goal} within {limit_s:g} s but at {body.position}"
        # Limits hold in every step: the definition of MotionLimits.
        change = math.hypot(body.vx - before[3], body.vy - before[4])
        assert change <= limits.acceleration * dt * (1 + 1e-9)
        assert abs(body.vz - before[5]) <= limits.vertical_acceleration * dt * (1 + 1e-9)
        assert body.speed <= limits.speed * (1 + 1e-9)
        assert -limits.descent * (1 + 1e-9) <= body.vz <= limits.climb * (1 + 1e-9)
        # Positions follow from velocities: nothing jumps.
        moved = math.hypot(body.x - before[0], body.y - before[1])
        assert moved <= limits.speed * dt * (1 + 1e-9)
    return elapsed


@pytest.mark.parametrize("dt", [0.005, 0.02, MAX_STEP_S])
@pytest.mark.parametrize("distance", [60.0, 200.0, 1000.0])
def test_a_long_leg_takes_distance_over_speed_plus_speed_over_acceleration(distance: float, dt: float) -> None:
    """Oracle: trapezoidal profile, t = d/v + v/a, for d ≥ v²/a = 40 m. One step of slack at each of three corners."""
    took = fly(PointMass(0.0, 0.0, 0.0, LIMITS), (0.6 * distance, 0.8 * distance, 0.0), dt)
    assert took == pytest.approx(distance / 10.0 + 10.0 / 2.5, abs=3 * dt)


@pytest.mark.parametrize("distance", [0.5, 5.0, 39.0])
def test_a_short_leg_takes_twice_the_root_of_distance_over_acceleration(distance: float) -> None:
    """Oracle: triangular profile, t = 2·sqrt(d/a), for d < v²/a."""
    took = fly(PointMass(5.0, -3.0, 0.0, LIMITS), (5.0, -3.0 - distance, 0.0), 0.02)
    assert took == pytest.approx(2.0 * math.sqrt(distance / 2.5), abs=0.06)


def test_climb_and_descent_have_their_own_speeds() -> None:
    """Oracle: the same profile along the vertical, 30/2.5 + 2.5/1 = 14.5 s up and 30/1.5 + 1.5/1 = 21.5 s down."""
    body = PointMass(0.0, 0.0, 0.0, LIMITS)
    assert fly(body, (0.0, 0.0, 30.0), 0.02) == pytest.approx(14.5, abs=0.06)
    assert fly(body, (0.0, 0.0, 0.0), 0.02) == pytest.approx(21.5, abs=0.06)


def test_from_rest_it_flies_straight_and_never_past_the_goal() -> None:
    """Oracle: geometry. Progress along the line only grows and ends at the goal; the distance from the line is 0."""
    body, goal = PointMass(0.0, 0.0, 0.0, LIMITS), (300.0, 400.0, 0.0)
    progress = 0.0
    while body.position != goal:
        body.fly_to(goal, 0.02)
        along, across = 0.6 * body.x + 0.8 * body.y, 0.8 * body.x - 0.6 * body.y
        assert progress <= along <= 500.0 + 1e-9
        assert abs(across) < 1e-6
        progress = along


def test_it_brakes_to_the_stopping_point() -> None:
    """Oracle: v²/(2a) = 100/5 = 20 m ahead at 10 m/s, reached after v/a = 4 s."""
    body = PointMass(0.0, 0.0, 50.0, LIMITS)
    while body.speed < 10.0:
        body.fly_to((1000.0, 0.0, 50.0), 0.02)
    began = body.x
    assert body.stopping_point() == pytest.approx((began + 20.0, 0.0, 50.0))
    assert fly(body, body.stopping_point(), 0.02) == pytest.approx(4.0, abs=0.06)


def test_it_turns_the_shorter_way() -> None:
    """Oracle: from 170° to -170° are 20°, through 180°; at 90°/s that is 0.222 s."""
    body = PointMass(0.0, 0.0, 0.0, LIMITS)
    body.yaw = math.radians(170.0)
    for _ in range(5):
        body.turn_to(math.radians(-170.0), 0.02)
    assert math.degrees(body.yaw) == pytest.approx(179.0)
    for _ in range(7):
        body.turn_to(math.radians(-170.0), 0.02)
    assert math.degrees(body.yaw) == pytest.approx(-170.0)


def test_without_thrust_it_falls_freely() -> None:
    """Oracle: 20 m of free fall take sqrt(2·20/9.80665) = 2.02 s."""
    body, elapsed = PointMass(0.0, 0.0, 20.0, LIMITS), 0.0
    while body.z > 0.0:
        body.fall(0.01)
        elapsed += 0.01
    assert elapsed == pytest.approx(math.sqrt(2 * 20 / 9.80665), abs=0.02)
    assert (body.z, body.vz) == (0.0, 0.0)


coordinate = st.floats(-300.0, 300.0)
point = st.tuples(coordinate, coordinate, st.floats(0.0, 100.0))


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(point, st.floats(0.0, 20.0)), min_size=1, max_size=4), st.sampled_from([0.007, 0.02, 0.05]))
def test_goals_that_change_in_flight_are_reached_within_the_limits(
    legs: list[tuple[tuple[float, float, float], float]], dt: float
) -> None:
    """Oracle: the limits themselves, checked in every step by `fly`; and that it comes to rest exactly at the goal."""
    body = PointMass(0.0, 0.0, 0.0, LIMITS)
    for goal, patience in legs:
        for _ in range(int(patience / dt)):
            speed, climb = (body.vx, body.vy), body.vz
            body.fly_to(goal, dt)
            assert math.hypot(body.vx - speed[0], body.vy - speed[1]) <= LIMITS.acceleration * dt * (1 + 1e-9)
            assert abs(body.vz - climb) <= LIMITS.vertical_acceleration * dt * (1 + 1e-9)
    fly(body, legs[-1][0], dt)
    assert body.position == legs[-1][0]


@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf])
def test_a_limit_that_is_no_limit_is_refused(bad: float) -> None:
    with pytest.raises(ValueError, match="acceleration must be a positive number"):
        MotionLimits(acceleration=bad)

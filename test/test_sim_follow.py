"""A position target with a velocity: the simulated aircraft keeps up with a moving point.

Oracle: the point's own motion, worked out here from kinematics.
"""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from jpap_ros.sim.dynamics import MotionLimits, PointMass
from jpap_ros.sim.flight import Follow

DT = 0.02
SPEED, ACCELERATION = 5.0, 1.0


def moving_point(time_s: float) -> tuple[float, float]:
    """East [m] and speed [m/s] of a point that speeds up evenly and then cruises."""
    speeding_up = SPEED / ACCELERATION
    if time_s < speeding_up:
        return ACCELERATION * time_s**2 / 2, ACCELERATION * time_s
    return SPEED * (time_s - speeding_up / 2), SPEED


@pytest.mark.parametrize("speedup", [1.0, 5.0])
def test_it_keeps_up_with_setpoints_at_5_hz(speedup: float) -> None:
    vehicle = SimpleNamespace(body=PointMass(0.0, 0.0, 50.0, MotionLimits()), now=0.0, on_ground=False, speedup=speedup)
    worst = 0.0
    for step in range(1000):
        simulated = step * DT
        vehicle.now = simulated / speedup
        if step % 10 == 0:
            # On the wire everything is in seconds of the wall clock.
            east, speed = moving_point(simulated)
            manoeuvre = Follow((east, 0.0, 50.0), (speed * speedup, 0.0, 0.0), None, vehicle.now + 3.0)
        manoeuvre.step(vehicle, DT)  # type: ignore[arg-type]
        worst = max(worst, math.dist(vehicle.body.position, (moving_point(simulated + DT)[0], 0.0, 50.0)))
    # Without the velocity it would trail by the way it takes to stop, 5 m and more.
    assert worst < 1.0


def test_it_stops_when_the_setpoints_do() -> None:
    vehicle = SimpleNamespace(body=PointMass(0.0, 0.0, 50.0, MotionLimits()), now=0.0, on_ground=False, speedup=1.0)
    manoeuvre = Follow((0.0, 0.0, 50.0), (SPEED, 0.0, 0.0), None, 3.0)
    for step in range(1000):
        vehicle.now = step * DT
        manoeuvre.step(vehicle, DT)  # type: ignore[arg-type]
    assert vehicle.body.speed == 0.0
    # Three seconds with at most the point's speed and the gain's excess, and the way to stop.
    assert 5.0 < vehicle.body.x < 25.0

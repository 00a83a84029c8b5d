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
            manoeuvre = Follow((east, 0.0, 50.0), (speed * speedup, 0.0, 0.0), None, 3.0)
        manoeuvre.step(vehicle, DT)  # type: ignore[arg-type]
        worst = max(worst, math.dist(vehicle.body.position, (moving_point(simulated + DT)[0], 0.0, 50.0)))
    # Without the velocity it would trail by the way it takes to stop, 5 m and more.
    assert worst < 1.0


@pytest.mark.parametrize("speedup", [1.0, 4.0])
def test_it_rests_where_the_point_was_when_its_time_was_over(speedup: float) -> None:
    """Oracle: ArduCopter moves the target on with its velocity for GUID_TIMEOUT (3 s), and then leaves it there."""
    vehicle = SimpleNamespace(body=PointMass(0.0, 0.0, 50.0, MotionLimits()), now=0.0, on_ground=False, speedup=speedup)
    vehicle.body.x, vehicle.body.vx = 2.0, SPEED
    manoeuvre = Follow((2.0, 0.0, 50.0), (SPEED * speedup, 0.0, 0.0), None, 3.0)
    farthest = 0.0
    for step in range(1000):
        vehicle.now = step * DT / speedup
        manoeuvre.step(vehicle, DT)  # type: ignore[arg-type]
        farthest = max(farthest, vehicle.body.x)
    assert vehicle.body.speed == 0.0
    assert vehicle.body.x == pytest.approx(2.0 + 3.0 * SPEED, abs=1e-6)
    # On the way it goes as far as it takes to brake, 5 m, and comes back.
    assert farthest == pytest.approx(2.0 + 3.0 * SPEED + SPEED**2 / (2 * MotionLimits().acceleration), abs=0.2)

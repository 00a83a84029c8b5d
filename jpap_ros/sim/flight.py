"""What an aircraft is doing: one small class a manoeuvre, stepped with simulated time."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jpap_ros.sim.vehicle import SimVehicle

Point = tuple[float, float, float]

#: Nearer than this a turn towards the goal would only make the aircraft spin [m].
FACE_GOAL_FROM_M = 2.0


class Manoeuvre(ABC):
    """One thing to do, until something else is asked for."""

    #: Where it is going, (east, north, up) [m]; None where it goes nowhere.
    goal: Point | None = None

    @abstractmethod
    def step(self, vehicle: SimVehicle, dt: float) -> None:
        """Move the aircraft for `dt` seconds."""


class Rest(Manoeuvre):
    """Stand on the ground."""

    def step(self, vehicle: SimVehicle, dt: float) -> None:
        """Stay."""


class FlyTo(Manoeuvre):
    """Fly to a point and stay there.

    Parameters
    ----------
    goal : tuple of float
    yaw : float or None
        Heading to hold [rad]; None: as `face_goal` says.
    face_goal : bool
        Without a yaw, look where it flies.
    """

    def __init__(self, goal: Point, yaw: float | None = None, face_goal: bool = False) -> None:
        self.goal: Point = goal
        self.yaw = yaw
        self.face_goal = face_goal

    def step(self, vehicle: SimVehicle, dt: float) -> None:
        """Move towards the goal."""
        body = vehicle.body
        if vehicle.on_ground:
            return
        body.fly_to(self.goal, dt)
        yaw = self.yaw
        if yaw is None and self.face_goal:
            dx, dy = self.goal[0] - body.x, self.goal[1] - body.y
            if math.hypot(dx, dy) > FACE_GOAL_FROM_M:
                yaw = math.atan2(dx, dy)
        if yaw is not None and yaw != body.yaw:
            body.turn_to(yaw, dt)
        if body.z <= 0.0 and self.goal[2] <= 0.0:
            vehicle.touch_down()


class FlyAt(Manoeuvre):
    """Fly with a velocity (east, north, up) [m/s] for `lasts_s` of simulated time, then stop."""

    def __init__(self, velocity: Point, yaw: float | None, lasts_s: float) -> None:
        self.velocity = velocity
        self.yaw = yaw
        self._left_s = lasts_s

    def step(self, vehicle: SimVehicle, dt: float) -> None:
        """Keep the velocity."""
        if vehicle.on_ground:
            return
        vehicle.body.fly_at(self.velocity if self._left_s > 0.0 else (0.0, 0.0, 0.0), dt)
        self._left_s -= dt
        if self.yaw is not None:
            vehicle.body.turn_to(self.yaw, dt)
        if vehicle.body.z <= 0.0:
            vehicle.touch_down()


class Follow(Manoeuvre):
    """Keep up with a moving point: a position target with a velocity. The point moves for a while, and rests then.

    Parameters
    ----------
    goal : tuple of float
        Where the point is at first [m].
    velocity : tuple of float
        Its velocity (east, north, up) [m/s].
    yaw : float or None
    lasts_s : float
        How long the point moves, simulated time [s].
    """

    #: The error in position is made good at this rate, on top of the point's own velocity [1/s].
    GAIN = 2.0

    def __init__(self, goal: Point, velocity: Point, yaw: float | None, lasts_s: float) -> None:
        self.goal: Point = goal
        self.velocity = velocity
        self.yaw = yaw
        self.lasts_s = lasts_s
        self._age_s = 0.0

    def step(self, vehicle: SimVehicle, dt: float) -> None:
        """Fly with the point's velocity and close in on it."""
        body = vehicle.body
        if vehicle.on_ground:
            return
        # On the wire everything is in seconds of the wall clock, the aircraft flies in simulated time.
        east, north, up = (v / vehicle.speedup for v in self.velocity)
        self._age_s += dt
        moved_s = min(self._age_s, self.lasts_s)
        place = self.goal[0] + east * moved_s, self.goal[1] + north * moved_s, self.goal[2] + up * moved_s
        if self._age_s >= self.lasts_s:
            body.fly_to(place, dt)
        else:
            error = [p - b for p, b in zip(place, body.position, strict=True)]
            wanted = [v + self.GAIN * e for v, e in zip((east, north, up), error, strict=True)]
            body.fly_at((wanted[0], wanted[1], wanted[2]), dt)
        if self.yaw is not None:
            body.turn_to(self.yaw, dt)
        if body.z <= 0.0:
            vehicle.touch_down()


class TakeOff(Manoeuvre):
    """Spin up, climb straight to a height, and tell the vehicle when it is there."""

    SPOOL_UP_S = 1.0

    def __init__(self, goal: Point) -> None:
        self.goal: Point = goal
        self._spool_up = self.SPOOL_UP_S

    def step(self, vehicle: SimVehicle, dt: float) -> None:
        """Climb."""
        if self._spool_up > 0.0:
            self._spool_up -= dt
            return
        vehicle.on_ground = False
        vehicle.body.fly_to(self.goal, dt)
        if vehicle.body.rests_at(self.goal):
            vehicle.take_off_finished()


class Land(Manoeuvre):
    """Come down where it is, slowly near the ground, and disarm there."""

    SLOW_BELOW_M = 10.0

    def __init__(self, at: Point, speed: float, disarm_after_s: float) -> None:
        self.goal: Point = (at[0], at[1], 0.0)
        self._speed = speed
        self._disarm_in = disarm_after_s

    def step(self, vehicle: SimVehicle, dt: float) -> None:
        """Descend; once down, count to the disarming."""
        body = vehicle.body
        if vehicle.on_ground:
            self._disarm_in -= dt
            if self._disarm_in <= 0.0 and vehicle.armed:
                vehicle.disarm("landed")
            return
        fast = body.limits.descent
        body.fly_to(self.goal, dt, descent=fast if body.z > self.SLOW_BELOW_M else min(fast, self._speed))
        if body.z <= 0.0:
            vehicle.touch_down()


class ReturnHome(Manoeuvre):
    """Climb to a height, fly home, wait, descend, land.

    Parameters
    ----------
    start, home : tuple of float
    height : float
        Up coordinate to fly home at [m].
    wait_s : float
        Hovering time above home [s].
    land : Land
        What follows, above home.
    """

    def __init__(self, start: Point, home: Point, height: float, wait_s: float, land: Land) -> None:
        self._legs: list[Point] = [(start[0], start[1], height), (home[0], home[1], height)]
        self._wait = wait_s
        self._land = land
        self.goal: Point = self._legs[0]

    def step(self, vehicle: SimVehicle, dt: float) -> None:
        """Fly the next leg."""
        if vehicle.on_ground or not self._legs:
            self.goal = (self.goal[0], self.goal[1], 0.0)
            self._land.step(vehicle, dt)
            return
        self.goal = self._legs[0]
        vehicle.body.fly_to(self.goal, dt)
        if not vehicle.body.rests_at(self.goal):
            return
        if len(self._legs) == 1 and self._wait > 0.0:
            self._wait -= dt
            return
        del self._legs[0]


class Fall(Manoeuvre):
    """Drop without thrust."""

    def step(self, vehicle: SimVehicle, dt: float) -> None:
        """Fall to the ground."""
        if vehicle.on_ground:
            return
        vehicle.body.fall(dt)
        if vehicle.body.z <= 0.0:
            vehicle.touch_down()

"""How a simulated multirotor moves: a point mass with limits on speed and acceleration that arrives exactly."""

from __future__ import annotations

import math
from dataclasses import dataclass

#: Longest time that one call of `PointMass.fly_to` may span [s].
MAX_STEP_S = 0.05
GRAVITY = 9.80665
#: Nearer than this is there [m].
_THERE_M = 1e-9


@dataclass(frozen=True)
class MotionLimits:
    """What the aircraft can do; the defaults are ArduCopter's (WPNAV_SPEED and its neighbours).

    Attributes
    ----------
    speed, acceleration : float
        Horizontal [m/s], [m/s²].
    climb, descent : float
        Vertical speeds [m/s].
    vertical_acceleration : float
        [m/s²].
    yaw_rate : float
        [rad/s].
    """

    speed: float = 10.0
    acceleration: float = 2.5
    climb: float = 2.5
    descent: float = 1.5
    vertical_acceleration: float = 1.0
    yaw_rate: float = math.radians(90.0)

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} must be a positive number, got {value!r}")


def closing_speed(distance: float, speed: float, limit: float, acceleration: float, dt: float) -> float:
    """Greatest speed after one step from which the remaining distance still suffices to stop.

    The step covers (speed + result)/2·dt, and the rest must be at least result²/(2·acceleration): a quadratic in
    the result. Braking therefore follows v² = 2·a·d exactly at the sampling instants and never overshoots.

    Parameters
    ----------
    distance : float
        To the goal [m], not negative.
    speed : float
        Present speed towards the goal [m/s]; negative when moving away.
    limit, acceleration, dt : float
        [m/s], [m/s²], [s].
    """
    room = 2.0 * distance - speed * dt
    if room <= 0.0:
        return 0.0
    half = 0.5 * acceleration * dt
    # The stable form of the root: sqrt(half² + a·room) − half cancels for a tiny distance.
    return min(limit, acceleration * room / (half + math.sqrt(half * half + acceleration * room)))


class PointMass:
    """Position, velocity and heading of one aircraft.

    Attributes
    ----------
    x, y, z : float
        East, north, up in the map frame [m].
    vx, vy, vz : float
        Velocity [m/s].
    ax, ay : float
        Horizontal acceleration of the last step [m/s²]; a multirotor tilts by it.
    yaw : float
        Heading, clockwise from north, in (−π, π] [rad].
    """

    __slots__ = ("ax", "ay", "limits", "vx", "vy", "vz", "x", "y", "yaw", "z")

    def __init__(self, x: float, y: float, z: float, limits: MotionLimits) -> None:
        self.x, self.y, self.z = x, y, z
        self.vx = self.vy = self.vz = 0.0
        self.ax = self.ay = 0.0
        self.yaw = 0.0
        self.limits = limits

    @property
    def position(self) -> tuple[float, float, float]:
        """East, north, up [m]."""
        return self.x, self.y, self.z

    @property
    def speed(self) -> float:
        """Horizontal speed [m/s]."""
        return math.hypot(self.vx, self.vy)

    def rests_at(self, goal: tuple[float, float, float]) -> bool:
        """Whether it is exactly there and does not move."""
        return self.position == goal and self.vx == self.vy == self.vz == 0.0

    def stopping_point(self) -> tuple[float, float, float]:
        """Where it comes to rest when it brakes now [m]."""
        reach = self.speed / (2.0 * self.limits.acceleration)
        rise = abs(self.vz) / (2.0 * self.limits.vertical_acceleration)
        return self.x + self.vx * reach, self.y + self.vy * reach, self.z + self.vz * rise

    def halt(self) -> None:
        """Take away all motion at once, as the ground does."""
        self.vx = self.vy = self.vz = self.ax = self.ay = 0.0

    def fly_to(
        self, goal: tuple[float, float, float], dt: float, *, climb: float | None = None, descent: float | None = None
    ) -> None:
        """Move for one step towards a goal, to stop there.

        Parameters
        ----------
        goal : tuple of float
            East, north, up [m].
        dt : float
            Time step [s], at most `MAX_STEP_S`.
        climb, descent : float, optional
            Vertical speeds [m/s] in place of the limits'.
        """
        self._horizontal(goal[0] - self.x, goal[1] - self.y, dt, goal)
        up = self.limits.climb if climb is None else climb
        down = self.limits.descent if descent is None else descent
        self._vertical(goal[2], dt, up, down)

    def fly_at(self, velocity: tuple[float, float, float], dt: float) -> None:
        """Move for one step with a wanted velocity (east, north, up) [m/s], within the limits."""
        limits = self.limits
        vx, vy, vz = velocity
        scale = min(1.0, limits.speed / max(math.hypot(vx, vy), 1e-9))
        old_vx, old_vy, old_vz = self.vx, self.vy, self.vz
        self._change_velocity(vx * scale, vy * scale, dt)
        step = limits.vertical_acceleration * dt
        wanted = min(max(vz, -limits.descent), limits.climb)
        self.vz = min(max(wanted, old_vz - step), old_vz + step)
        self.x += 0.5 * (old_vx + self.vx) * dt
        self.y += 0.5 * (old_vy + self.vy) * dt
        self.z += 0.5 * (old_vz + self.vz) * dt

    def fall(self, dt: float) -> None:
        """Drop for one step without thrust, down to the ground at z = 0."""
        old = self.vz
        self.vz -= GRAVITY * dt
        self.z += 0.5 * (old + self.vz) * dt
        self.x += self.vx * dt
        self.y += self.vy * dt
        if self.z <= 0.0:
            self.z = 0.0
            self.halt()

    def turn_to(self, yaw: float, dt: float) -> None:
        """Turn for one step towards a heading [rad], the shorter way."""
        error = math.remainder(yaw - self.yaw, math.tau)
        step = self.limits.yaw_rate * dt
        self.yaw = math.remainder(self.yaw + min(max(error, -step), step), math.tau)

    def _horizontal(self, dx: float, dy: float, dt: float, goal: tuple[float, float, float]) -> None:
        distance = math.hypot(dx, dy)
        old_vx, old_vy = self.vx, self.vy
        speed = math.hypot(old_vx, old_vy)
        if distance == 0.0 and speed == 0.0:
            self.ax = self.ay = 0.0
            return
        limits = self.limits
        closing = (old_vx * dx + old_vy * dy) / distance if distance > 0.0 else 0.0
        wanted = closing_speed(distance, closing, limits.speed, limits.acceleration, dt)
        if speed <= limits.acceleration * dt and (distance <= _THERE_M or (wanted == 0.0 and distance <= speed * dt)):
            # The rest of the stop fits into this step.
            self.x, self.y = goal[0], goal[1]
            self.vx = self.vy = self.ax = self.ay = 0.0
            return
        if distance > 0.0:
            self._change_velocity(wanted * dx / distance, wanted * dy / distance, dt)
        else:
            self._change_velocity(0.0, 0.0, dt)
        self.x += 0.5 * (old_vx + self.vx) * dt
        self.y += 0.5 * (old_vy + self.vy) * dt

    def _change_velocity(self, vx: float, vy: float, dt: float) -> None:
        dvx, dvy = vx - self.vx, vy - self.vy
        change, most = math.hypot(dvx, dvy), self.limits.acceleration * dt
        if change > most:
            dvx *= most / change
            dvy *= most / change
        self.vx += dvx
        self.vy += dvy
        self.ax, self.ay = dvx / dt, dvy / dt

    def _vertical(self, goal: float, dt: float, climb: float, descent: float) -> None:
        rise = goal - self.z
        old = self.vz
        if rise == 0.0 and old == 0.0:
            return
        sign = 1.0 if rise >= 0.0 else -1.0
        acceleration = self.limits.vertical_acceleration
        wanted = closing_speed(abs(rise), sign * old, climb if rise > 0.0 else descent, acceleration, dt)
        step = acceleration * dt
        if abs(old) <= step and (abs(rise) <= _THERE_M or (wanted == 0.0 and abs(rise) <= abs(old) * dt)):
            self.z, self.vz = goal, 0.0
            return
        self.vz = min(max(sign * wanted, old - step), old + step)
        self.z += 0.5 * (old + self.vz) * dt

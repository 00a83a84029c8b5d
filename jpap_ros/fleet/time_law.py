"""How far along a straight leg an aircraft is at which time: bounded speed and acceleration, at rest at the end."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from jpap_ros.fleet.arrays import Floats

#: Who would stop within this share of a leg rests: smaller ones have no square that is a number.
_AT_REST = 1e-30


@dataclass(frozen=True)
class TimeLaw:
    """Progress s from 0 to 1: speed up, cruise, slow down to rest at s = 1.

    Attributes
    ----------
    speed : float
        Largest ds/dt [1/s].
    acceleration : float
        Size of the second derivative while speeding up and slowing down [1/s^2].
    initial_speed : float
        ds/dt at the start [1/s]; at most sqrt(2 acceleration), from which it can still come to rest at s = 1.
    """

    speed: float
    acceleration: float
    initial_speed: float = 0.0

    @cached_property
    def _phases(self) -> tuple[float, float, float]:
        """Greatest ds/dt reached, duration of speeding up, duration of the cruise."""
        a, v0 = self.acceleration, self.initial_speed
        peak = max(v0, min(self.speed, math.sqrt(a + v0**2 / 2)))
        cruise = max(1.0 - (2 * peak**2 - v0**2) / (2 * a), 0.0) / peak
        return peak, (peak - v0) / a, cruise

    @property
    def duration_s(self) -> float:
        """Time from s = 0 to s = 1 [s]."""
        peak, speeding_up, cruise = self._phases
        return speeding_up + cruise + peak / self.acceleration

    def at(self, time_s: float) -> tuple[float, float]:
        """Progress s in [0, 1] and ds/dt [1/s] at a time since the start."""
        a, v0 = self.acceleration, self.initial_speed
        peak, speeding_up, _ = self._phases
        left = self.duration_s - time_s
        if left <= 0:
            return 1.0, 0.0
        if left <= peak / a:
            return 1.0 - a * left**2 / 2, a * left
        elapsed = max(time_s, 0.0)
        if elapsed < speeding_up:
            return v0 * elapsed + a * elapsed**2 / 2, v0 + a * elapsed
        return (peak**2 - v0**2) / (2 * a) + peak * (elapsed - speeding_up), peak

    def overrun(self, reaction_s: float) -> float:
        """Most progress from any moment until it is at rest, where slowing down begins so much later."""
        peak = self._phases[0]
        return min(peak * reaction_s + peak**2 / (2 * self.acceleration), 1.0)

    def rest(self, time_s: float) -> tuple[float, TimeLaw]:
        """What is left after a time before the end: from which s, and the law from there to s = 1."""
        s, speed = self.at(time_s)
        left = max(1.0 - s, 1e-12)
        acceleration = self.acceleration / left
        initial = min(speed / left, math.sqrt(2 * acceleration))
        return s, TimeLaw(self.speed / left, acceleration, initial)

    def braking(self, time_s: float) -> tuple[float, float, TimeLaw | None]:
        """Where slowing down at once leads: from s, to s, and the law between the two; None where already at rest."""
        s, speed = self.at(time_s)
        end = min(s + speed**2 / (2 * self.acceleration), 1.0)
        if end - s < _AT_REST:
            return s, s, None
        initial = speed / (end - s)
        return s, end, TimeLaw(initial, initial**2 / 2, initial)


def leg_law(displacements: Floats, speed: float, vertical_speed: float, acceleration: float) -> TimeLaw:
    """Fastest law for a leg whose aircraft share one clock, (m, 3) displacements [m]; the slowest sets the pace."""
    across, up = np.linalg.norm(displacements[:, :2], axis=1).max(), np.abs(displacements[:, 2]).max()
    length = float(np.linalg.norm(displacements, axis=1).max())
    pace = max(float(across) / speed, float(up) / vertical_speed)
    return TimeLaw(1.0 / pace, acceleration / length)

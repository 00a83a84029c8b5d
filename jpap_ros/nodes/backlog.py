"""When a publisher that was just found has repeated what it said before."""

from __future__ import annotations

import math

#: What it repeats comes at once; it is over when nothing came for so long [s].
_QUIET_S = 0.1
#: At the latest so long after the publisher was found, whatever comes [s].
_LONGEST_S = 1.0


class Backlog:
    """Reports that a publisher keeps for late readers, and which only all together tell what is so now.

    Whoever answers them one by one answers for places where devices were long ago. Times are monotonic [s].
    """

    def __init__(self) -> None:
        self._over_s = self._latest_s = -math.inf

    def found(self, now_s: float) -> None:
        """Take note of a publisher that was just found."""
        self._over_s, self._latest_s = now_s + _QUIET_S, now_s + _LONGEST_S

    def heard(self, now_s: float) -> None:
        """Take note of a report."""
        if now_s < self._over_s:
            self._over_s = min(now_s + _QUIET_S, self._latest_s)

    def left_s(self, now_s: float) -> float:
        """How long to wait at least before it may be over; 0 once it is [s]."""
        return max(self._over_s - now_s, 0.0)

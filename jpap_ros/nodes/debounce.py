"""Waiting for a burst of events to end, but not for ever."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node


class Debounce:
    """Calls back once events have stopped coming, or when the first of them has waited for long enough.

    On steady time: neither a simulated clock that stands still nor a jump of the system's may hold an event up.

    Parameters
    ----------
    node : Node
    fire : callable
    """

    def __init__(self, node: Node, fire: Callable[[], None]) -> None:
        self._node = node
        self._fire = fire
        self._timer = node.create_timer(
            1.0, self._on_timer, clock=Clock(clock_type=ClockType.STEADY_TIME), autostart=False
        )

    def touch(self, first_event_s: float, quiet_s: float, longest_s: float) -> None:
        """Take note of an event.

        Parameters
        ----------
        first_event_s : float
            When the first of the events that wait happened, monotonic [s].
        quiet_s : float
            Call back when there was no event for so long [s]; 0: at once.
        longest_s : float
            Call back at the latest so long after the first event [s].
        """
        wait_s = min(quiet_s, first_event_s + longest_s - time.monotonic())
        if wait_s <= 0:
            self._on_timer()
            return
        self._timer.timer_period_ns = int(wait_s * 1e9)
        self._timer.reset()

    def cancel(self) -> None:
        """Do not call back for the events so far."""
        self._timer.cancel()

    def close(self) -> None:
        """Destroy the timer."""
        self._node.destroy_timer(self._timer)

    def _on_timer(self) -> None:
        self._timer.cancel()
        self._fire()

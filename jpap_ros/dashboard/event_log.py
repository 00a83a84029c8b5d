"""The log that the page shows: what happened, newest last, never more than a number of entries."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

#: Entries kept; older ones are dropped.
CAPACITY = 500
#: Longest text of one entry.
MAX_TEXT = 600

INFO, WARNING, ERROR = "info", "warning", "error"


@dataclass(frozen=True)
class Event:
    """One thing that happened.

    Attributes
    ----------
    number : int
        Counts up from 1; a reader knows by it what is new.
    time_s : float
        Unix time [s].
    level : str
        `info`, `warning` or `error`.
    kind : str
        `plan`, `aircraft`, `devices`, `node` or `action`.
    text : str
    """

    number: int
    time_s: float
    level: str
    kind: str
    text: str


class EventLog:
    """The newest events.

    Parameters
    ----------
    clock : callable
        Unix time [s].
    """

    def __init__(self, clock: Callable[[], float] = time.time) -> None:
        self._clock = clock
        self._events: deque[Event] = deque(maxlen=CAPACITY)
        self._number = 0

    def add(self, level: str, kind: str, text: str) -> None:
        """Note that something happened."""
        self._number += 1
        text = text if len(text) <= MAX_TEXT else f"{text[: MAX_TEXT - 1]}…"
        self._events.append(Event(self._number, self._clock(), level, kind, text))

    def since(self, number: int) -> list[Event]:
        """Events after the one with this number, oldest first."""
        return [event for event in self._events if event.number > number]

    @property
    def last(self) -> int:
        """Number of the newest event; 0 before the first."""
        return self._number

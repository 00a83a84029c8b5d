"""From the thread that hears the graph to the one that serves pages."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable

#: Most messages that wait; the oldest go first. Only a server that hangs lets so many gather.
CAPACITY = 20_000

Call = Callable[[], None]


class Inbox:
    """Calls put in by one thread and made by another."""

    def __init__(self) -> None:
        self._calls: deque[Call] = deque(maxlen=CAPACITY)
        self._newest: dict[Hashable, Call] = {}

    def put(self, call: Call) -> None:
        """Have this called."""
        self._calls.append(call)

    def put_newest(self, key: Hashable, call: Call) -> None:
        """Have this called instead of what waits under the same key."""
        self._newest[key] = call

    def drain(self) -> None:
        """Make every call that waits now."""
        # Not "while there is one": whoever puts faster than this takes must not keep it here for ever.
        for _ in range(len(self._calls)):
            self._calls.popleft()()
        for _ in range(len(self._newest)):
            self._newest.popitem()[1]()

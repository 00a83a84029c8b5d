"""What reached a simulated aircraft, for tests to look at."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, overload

#: A fleet of 200 with streams of 10 Hz must not fill the memory.
COMMANDS_KEPT, SETPOINTS_KEPT = 5000, 200

_SETPOINTS = ("SET_POSITION_TARGET_GLOBAL_INT", "SET_POSITION_TARGET_LOCAL_NED")
_COMMANDS = ("COMMAND_LONG", "COMMAND_INT", "SET_MODE", "REQUEST_DATA_STREAM", "PARAM_SET")


@dataclass(frozen=True)
class Received:
    """A command, setpoint or request that reached the aircraft, obeyed or not.

    Attributes
    ----------
    time : float
        Monotonic [s].
    kind : str
        Message name.
    source : tuple of int
        System and component id of the sender.
    message : object
        The pymavlink message.
    """

    time: float
    kind: str
    source: tuple[int, int]
    message: Any


class ReceivedLog(Sequence[Received]):
    """The last `COMMANDS_KEPT` commands and requests and the last `SETPOINTS_KEPT` setpoints, oldest first."""

    def __init__(self) -> None:
        commands: deque[Received] = deque(maxlen=COMMANDS_KEPT)
        setpoints: deque[Received] = deque(maxlen=SETPOINTS_KEPT)
        self._parts = (commands, setpoints)
        self._by_kind = {**dict.fromkeys(_COMMANDS, commands), **dict.fromkeys(_SETPOINTS, setpoints)}

    def note(self, message: Any, now: float) -> None:
        """Keep a message if it is of a kind that is kept."""
        kind = message.get_type()
        part = self._by_kind.get(kind)
        if part is not None:
            part.append(Received(now, kind, (message.get_srcSystem(), message.get_srcComponent()), message))

    def clear(self) -> None:
        """Forget everything."""
        for part in self._parts:
            part.clear()

    def __len__(self) -> int:
        return sum(len(part) for part in self._parts)

    @overload
    def __getitem__(self, index: int) -> Received: ...
    @overload
    def __getitem__(self, index: slice) -> list[Received]: ...
    def __getitem__(self, index: int | slice) -> Received | list[Received]:
        # A copy of a deque is atomic under the interpreter's lock; iterating one while it grows is not.
        entries = [entry for part in self._parts for entry in part.copy()]
        return sorted(entries, key=lambda entry: entry.time)[index]

    def __iter__(self) -> Iterator[Received]:
        return iter(self[:])

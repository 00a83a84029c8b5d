"""Who commands one aircraft. Pilot first: what the bridge did not ask for is somebody else's decision."""

from __future__ import annotations

import math
from collections.abc import Iterable
from enum import Enum

#: A heartbeat from before a change of mode may still arrive this long after the change was confirmed [s].
LATE_HEARTBEAT_S = 1.0


class Holder(Enum):
    """Who has the aircraft."""

    NOBODY = "nobody"
    BRIDGE = "bridge"
    OTHERS = "others"


class Authority:
    """The right to command, gained by an operator's service call and lost to pilot, ground station or failsafe.

    Notes
    -----
    Once `OTHERS` have the aircraft, only `take` gives it back to the bridge, and only an operator's call (launch,
    hold, return home, land) leads to `take`.
    """

    def __init__(self) -> None:
        self.holder = Holder.NOBODY
        #: Why the bridge does not have the aircraft.
        self.reason = "waiting for bridge/launch"
        self._modes: frozenset[str] = frozenset()
        self._modes_before: frozenset[str] = frozenset()
        self._before_until = -math.inf
        self._was_armed = False

    @property
    def ours(self) -> bool:
        """True while the bridge may command."""
        return self.holder is Holder.BRIDGE

    def take(self, modes: Iterable[str], now: float) -> None:
        """The bridge has it, and the aircraft is expected to be in one of these modes."""
        if not self.ours:
            self._modes = frozenset()
            self._was_armed = False
        self.holder = Holder.BRIDGE
        self.reason = ""
        self.expect(modes, now)

    def expects(self, mode: str) -> bool:
        """Whether this mode is no sign of a pilot, even if it lasts: not only one from before a change."""
        return mode in self._modes

    def expect(self, modes: Iterable[str], now: float) -> None:
        """Modes that the bridge asked for and that are therefore no sign of a pilot."""
        self._modes_before = self._modes
        self._before_until = now + LATE_HEARTBEAT_S
        self._modes = frozenset(modes)

    def release(self, reason: str) -> None:
        """Nobody needs to have it: it flies home, lands, stands, or forgot everything in a reboot."""
        self.holder = Holder.NOBODY
        self.reason = reason

    def observe(self, mode: str, armed: bool, now: float) -> bool:
        """Look at a heartbeat.

        Returns
        -------
        bool
            True if it shows that others took the aircraft over just now.
        """
        if not self.ours:
            return False
        late = now <= self._before_until and mode in self._modes_before
        if mode not in self._modes and not late:
            return self.lose(f"mode became {mode} without the bridge asking")
        if self._was_armed and not armed:
            return self.lose("disarmed without the bridge asking")
        self._was_armed = armed
        return False

    def lose(self, reason: str) -> bool:
        """Others have it, whatever the bridge was about to do."""
        self.holder = Holder.OTHERS
        self.reason = f"{reason}; bridge/launch or bridge/hold takes it back"
        return True

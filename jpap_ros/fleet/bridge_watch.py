"""Whether anybody still says how the aircraft are."""

from __future__ import annotations

#: The bridge repeats every state each second; after so long without any it is silent [s].
SILENT_AFTER_S = 5.0


class BridgeWatch:
    """Notices that no state of any aircraft comes any more, and keeps the clock of the fleet's life.

    That clock stands still while the bridge is silent: what nobody reports makes no aircraft lost.

    Parameters
    ----------
    now_s : float
        Time on a clock that never goes back [s].
    """

    def __init__(self, now_s: float) -> None:
        self._heard_s = now_s
        self._stood_still_s = 0.0

    def hear(self, now_s: float) -> None:
        """Take note of a state."""
        self._stood_still_s += max(now_s - self._heard_s - SILENT_AFTER_S, 0.0)
        self._heard_s = now_s

    def silent_s(self, now_s: float) -> float:
        """How long the bridge has been silent [s]; 0 if that is not worth a word."""
        silence_s = now_s - self._heard_s
        return silence_s if silence_s >= SILENT_AFTER_S else 0.0

    def clock(self, now_s: float) -> float:
        """Time for the fleet's life [s]."""
        return min(now_s, self._heard_s + SILENT_AFTER_S) - self._stood_still_s

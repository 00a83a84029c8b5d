"""One MAVLink channel of one vehicle: its message rates, its sequence numbers, its signature."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

#: Signing timestamps count 10 µs from 2015-01-01 UTC (MAVLink guide, message signing).
_SIGNING_EPOCH_S = 1420070400


def signing_timestamp() -> int:
    """Now, as a MAVLink signing timestamp."""
    return int((time.time() - _SIGNING_EPOCH_S) * 1e5)


class Channel:
    """What one vehicle sends on one link.

    Parameters
    ----------
    sysid : int
    rates_hz : mapping of int to float
        Messages sent without being asked for, by id.
    signing_key : bytes or None
    phase : float
        0 to 1: spreads the fleet's messages over their periods.
    link_id : int
        For signing.
    """

    def __init__(
        self, sysid: int, rates_hz: Mapping[int, float], signing_key: bytes | None, phase: float, link_id: int
    ) -> None:
        self._mav = mavlink.MAVLink(None, srcSystem=sysid, srcComponent=mavlink.MAV_COMP_ID_AUTOPILOT1)
        if signing_key is not None:
            signing = self._mav.signing
            signing.secret_key, signing.sign_outgoing = signing_key, True
            signing.link_id, signing.timestamp = link_id, signing_timestamp()
        self._defaults = dict(rates_hz)
        self._phase = phase
        self.frames: list[bytes] = []
        self.sent = 0
        self._due: dict[int, float] = {}
        self._interval: dict[int, float] = {}
        self._next = 0.0
        self.reset(0.0)

    def reset(self, now: float) -> None:
        """Back to the rates that hold after boot."""
        self._interval = {message: 1.0 / rate for message, rate in self._defaults.items()}
        self._due = {message: now + interval * self._phase for message, interval in self._interval.items()}
        self._next = now

    def interval(self, message: int) -> float | None:
        """Seconds between two messages of a kind; None where they are not sent."""
        return self._interval.get(message)

    def set_interval(self, message: int, interval: float | None, now: float) -> None:
        """Send a kind of message every so many seconds; None: never."""
        if interval is None:
            self._interval.pop(message, None)
            self._due.pop(message, None)
            return
        if self._interval.get(message) != interval:
            self._interval[message] = interval
            self._due[message] = now + interval * self._phase
            self._next = now

    def restore(self, message: int, now: float) -> None:
        """Send a kind of message at the rate that holds after boot."""
        rate = self._defaults.get(message)
        self.set_interval(message, 1.0 / rate if rate else None, now)

    def due(self, now: float) -> list[int]:
        """Kinds of message to send now; counts them as sent."""
        if now < self._next:
            return []
        ready = []
        for message, due in self._due.items():
            if due <= now:
                ready.append(message)
                following = due + self._interval[message]
                # After a pause start afresh, without a burst.
                self._due[message] = following if following > now else now + self._interval[message]
        self._next = min(self._due.values(), default=float("inf"))
        return ready

    def put(self, message: Any) -> None:
        """Pack a message for sending."""
        self.frames.append(message.pack(self._mav))
        # pymavlink counts only in its own send().
        self._mav.seq = (self._mav.seq + 1) % 256
        self.sent += 1

    def take(self) -> list[bytes]:
        """The frames packed since the last call."""
        frames, self.frames = self.frames, []
        return frames

"""Fits message streams into what a slow link carries."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

from pymavlink.dialects.v20 import ardupilotmega as dialect

from jpap_ros.mavlink.frame import MAVLINK2_OVERHEAD_BYTES, SIGNATURE_BLOCK_BYTES


def frame_size(message_id: int, signed: bool = False) -> int:
    """Most bytes that a MAVLink 2 frame of a message takes; zeros at its end make the real one shorter.

    Raises
    ------
    ValueError
        If the dialect has no such message.
    """
    message = dialect.mavlink_map.get(message_id)
    if message is None:
        raise ValueError(f"message_id must be one of the dialect's, got {message_id!r}")
    return int(message.unpacker.size) + MAVLINK2_OVERHEAD_BYTES + (SIGNATURE_BLOCK_BYTES if signed else 0)


@dataclass(frozen=True)
class Stream:
    """One message sent again and again over a link, in either direction.

    Attributes
    ----------
    message_id : int
    rate_hz : float
        Wanted rate.
    size_bytes : int
        Of one frame; see `frame_size`.
    priority : int
        0: never slowed (setpoints, commands, heartbeats). Larger numbers give way first.
    min_rate_hz : float
        Kept, for all streams, before any gets more than its own.
    """

    message_id: int
    rate_hz: float
    size_bytes: int
    priority: int
    min_rate_hz: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.min_rate_hz <= self.rate_hz < float("inf"):
            raise ValueError(
                f"rates must be finite with 0 <= min_rate_hz <= rate_hz, got {self.min_rate_hz!r}, {self.rate_hz!r}"
            )
        if self.size_bytes <= 0 or self.priority < 0:
            raise ValueError(f"size_bytes must be positive and priority not negative, got {self!r}")


@dataclass(frozen=True)
class Allocation:
    """Rates that fit.

    Attributes
    ----------
    rates_hz : tuple of float
        In the order of the streams; 0 where there is no room.
    bytes_per_s : float
        Their cost together.
    overloaded : bool
        Whether even the streams that are never slowed exceed the capacity.
    """

    rates_hz: tuple[float, ...]
    bytes_per_s: float
    overloaded: bool


@dataclass(frozen=True)
class Budget:
    """What a link carries in both directions together.

    Attributes
    ----------
    max_bytes_per_s : float or None
        None: as much as is wanted.
    """

    max_bytes_per_s: float | None = None

    def allocate(self, streams: Sequence[Stream]) -> Allocation:
        """Slow streams down until they fit.

        Streams of priority 0 get their whole rate, whatever the capacity. Of what is left, first all least rates are
        served, then all wanted ones, each time from the most important priority on; where it does not reach,
        streams of that priority are slowed by the same factor.

        Examples
        --------
        >>> setpoint = Stream(86, rate_hz=10, size_bytes=65, priority=0)
        >>> position = Stream(33, rate_hz=5, size_bytes=40, priority=1, min_rate_hz=1)
        >>> Budget(750).allocate([setpoint, position]).rates_hz
        (10.0, 2.5)
        """
        if self.max_bytes_per_s is None:
            rates = [float(stream.rate_hz) for stream in streams]
            return Allocation(tuple(rates), _cost(streams, rates), overloaded=False)
        rates = [float(stream.rate_hz) if stream.priority == 0 else 0.0 for stream in streams]
        left = self.max_bytes_per_s - _cost(streams, rates)
        overloaded = left < 0.0
        slowable = sorted((i for i, s in enumerate(streams) if s.priority > 0), key=lambda i: streams[i].priority)
        for targets in ([stream.min_rate_hz for stream in streams], [stream.rate_hz for stream in streams]):
            for _, group in groupby(slowable, key=lambda i: streams[i].priority):
                members = list(group)
                wanted = sum((targets[i] - rates[i]) * streams[i].size_bytes for i in members)
                share = 1.0 if wanted <= max(0.0, left) else max(0.0, left) / wanted
                for i in members:
                    rates[i] += share * (targets[i] - rates[i])
                left -= share * wanted
        return Allocation(tuple(rates), _cost(streams, rates), overloaded)


def _cost(streams: Sequence[Stream], rates: Sequence[float]) -> float:
    return sum(rate * stream.size_bytes for stream, rate in zip(streams, rates, strict=True))


class TokenBucket:
    """Limits bytes sent to a rate, with a burst of one second."""

    def __init__(self, bytes_per_s: float, now: float) -> None:
        self._bytes_per_s = bytes_per_s
        self._level = bytes_per_s
        self._filled_at = now

    def has(self, size: int, now: float) -> bool:
        """Whether `size` bytes are within the rate now."""
        self._level = min(self._bytes_per_s, self._level + (now - self._filled_at) * self._bytes_per_s)
        self._filled_at = now
        return self._level >= size

    def spend(self, size: int) -> None:
        """Account for bytes sent; what may not wait can overdraw by up to a second."""
        self._level = max(self._level - size, -self._bytes_per_s)

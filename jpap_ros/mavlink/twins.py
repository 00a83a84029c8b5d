"""Whether what comes from several addresses under one system id can be one vehicle."""

from __future__ import annotations

import math
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

Address = TypeVar("Address", bound=Hashable)

#: Only what was told this recently is compared [s].
FRESH_S = 2.0
#: Links delay by less than this; two addresses that contradict one another for longer are two vehicles [s].
DELAY_S = 5.0
#: One vehicle's position, told twice, differs by less than this beside what it flew meanwhile [m].
SAME_PLACE_M = 5.0
_METRES_PER_E7 = 0.0111319


@dataclass(frozen=True)
class _State:
    """What a HEARTBEAT tells."""

    heard_at: float
    autopilot: int
    armed: bool
    custom_mode: int

    def agrees(self, other: _State) -> bool:
        return (self.autopilot, self.armed, self.custom_mode) == (other.autopilot, other.armed, other.custom_mode)


@dataclass(frozen=True)
class _Place:
    """What a GLOBAL_POSITION_INT tells, with the pace of its sender's clock."""

    heard_at: float
    boot_s: float
    lat_e7: int
    lon_e7: int
    alt_m: float
    speed_m_s: float
    first: tuple[float, float]

    @property
    def pace(self) -> float:
        """Seconds of the sender's clock in one of ours: more than 1 in a simulation that is sped up."""
        elapsed_s = self.heard_at - self.first[0]
        return max(1.0, (self.boot_s - self.first[1]) / elapsed_s) if elapsed_s > FRESH_S else math.inf

    def agrees(self, other: _Place) -> bool:
        apart_s = abs(self.boot_s - other.boot_s)
        if apart_s > (DELAY_S + FRESH_S) * max(self.pace, other.pace):
            return False
        north_m = (self.lat_e7 - other.lat_e7) * _METRES_PER_E7
        east_m = (self.lon_e7 - other.lon_e7) * _METRES_PER_E7 * math.cos(math.radians(self.lat_e7 / 1e7))
        flown_m = 2.0 * (max(self.speed_m_s, other.speed_m_s) + 1.0) * apart_s
        return math.hypot(north_m, east_m, self.alt_m - other.alt_m) <= SAME_PLACE_M + flown_m


class Twins(Generic[Address]):
    """Compares what the addresses of one system id tell of mode, arming, clock and place.

    Notes
    -----
    One vehicle tells the same on all its links, but for delay and loss. So two addresses are two vehicles once all
    that they told for `DELAY_S` contradicted one another: another autopilot, mode or arming in their heartbeats, clocks
    (time_boot_ms) further apart than links delay, or places that one vehicle could not have got to meanwhile. Two that
    were switched on together, stand together and do the same cannot be told apart.
    """

    def __init__(self) -> None:
        self._told: dict[Address, dict[type, Any]] = {}
        #: Since when, and until when, two addresses have contradicted one another in a kind of message.
        self._contradictions: dict[tuple[type, frozenset[Address]], tuple[float, float]] = {}

    def heard(self, address: Address, message: Any, now: float) -> None:
        """Take a message of an autopilot; all but HEARTBEAT and GLOBAL_POSITION_INT are passed over."""
        told = self._told.get(address, {})
        fact: _State | _Place
        if message.get_type() == "HEARTBEAT":
            armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            fact = _State(now, message.autopilot, armed, message.custom_mode)
        elif message.get_type() == "GLOBAL_POSITION_INT" and (message.lat or message.lon):
            boot_s = message.time_boot_ms / 1e3
            before: _Place | None = told.get(_Place)
            first = now, boot_s
            if before is not None and before.boot_s <= boot_s and now - before.heard_at <= FRESH_S:
                first = before.first
            speed_m_s = math.hypot(message.vx, message.vy, message.vz) / 100
            fact = _Place(now, boot_s, message.lat, message.lon, message.alt / 1e3, speed_m_s, first)
        else:
            return
        if address not in self._told:
            self._told = {a: t for a, t in self._told.items() if any(now - f.heard_at <= FRESH_S for f in t.values())}
            self._told[address] = told
        told[type(fact)] = fact
        for other, elsewhere in self._told.items():
            reply = elsewhere.get(type(fact))
            if other != address and reply is not None and now - reply.heard_at <= FRESH_S:
                self._compare((type(fact), frozenset((address, other))), fact.agrees(reply), now)

    def _compare(self, pair: tuple[type, frozenset[Address]], agree: bool, now: float) -> None:
        since, until = self._contradictions.get(pair, (now, now))
        if agree:
            self._contradictions.pop(pair, None)
        else:
            self._contradictions[pair] = (since if now - until <= FRESH_S else now), now

    def addresses(self, now: float) -> tuple[Address, ...]:
        """Addresses that cannot be one vehicle; empty in good order."""
        if not self._contradictions:
            return ()
        self._contradictions = {p: c for p, c in self._contradictions.items() if now - c[1] <= DELAY_S}
        pairs = [pair for (_, pair), (since, until) in self._contradictions.items() if until - since >= DELAY_S]
        return tuple(dict.fromkeys(address for pair in pairs for address in sorted(pair, key=str)))

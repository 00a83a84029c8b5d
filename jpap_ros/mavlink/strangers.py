"""Vehicles of the fleet that beat where others are expected."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Generic, TypeVar

Address = TypeVar("Address", bound=Hashable)

#: Heartbeats that make a stranger: the first ones of a stream that carries several vehicles come in any order.
BEATS = 3
#: An address silent for so long is forgotten [s].
FORGET_S = 60.0


class Strangers(Generic[Address]):
    """Addresses of vehicle links from which a system id of the fleet beats whose links these are not.

    Parameters
    ----------
    silent_after_s : float
        A stranger without a heartbeat for so long is gone.

    Notes
    -----
    Two vehicles that both came with system id 1 show like this: each beats on its own link, and one of them is not who
    is expected there. An address that has spoken for a vehicle of its link as well is a radio mesh, a router, or an
    autopilot that passes on what it hears. What it passes on is no sign of a second vehicle: it `relays`.
    """

    def __init__(self, silent_after_s: float = 4.0) -> None:
        self.silent_after_s = silent_after_s
        self._seen: dict[Address, float] = {}
        self._relays: set[Address] = set()
        self._beats: dict[int, dict[Address, tuple[int, float]]] = {}

    def heard(self, sysid: int, address: Address, expected: bool, now: float) -> None:
        """Take the heartbeat of an autopilot of the fleet; `expected`: on a link of its own."""
        if address not in self._seen:
            self._forget(now)
        self._seen[address] = now
        if expected:
            self._relays.add(address)
            return
        beats = self._beats.setdefault(sysid, {})
        count, last = beats.get(address, (0, now))
        beats[address] = (count + 1 if now - last <= self.silent_after_s else 1), now

    def addresses(self, sysid: int, now: float) -> tuple[Address, ...]:
        """Where a system id beats though it is not expected there."""
        beats = self._beats.get(sysid, {})
        return tuple(a for a, (n, last) in beats.items() if n >= BEATS and now - last <= self.silent_after_s)

    def relays(self, address: Address) -> bool:
        """Whether an address has spoken for a vehicle that is expected there."""
        return address in self._relays

    def rivals(self, sysid: int, now: float) -> tuple[Address, ...]:
        """Where another vehicle with a system id must be: addresses that relay nothing."""
        return tuple(address for address in self.addresses(sysid, now) if not self.relays(address))

    @property
    def sysids(self) -> tuple[int, ...]:
        """System ids that were strangers somewhere within the last minute."""
        return tuple(self._beats)

    def _forget(self, now: float) -> None:
        for address in [known for known, at in self._seen.items() if now - at > FORGET_S]:
            del self._seen[address]
            self._relays.discard(address)
            for beats in self._beats.values():
                beats.pop(address, None)
        self._beats = {sysid: beats for sysid, beats in self._beats.items() if beats}

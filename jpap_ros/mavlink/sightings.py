"""Where one system id is heard: its route, and whether two vehicles share the id."""

from __future__ import annotations

import math
from collections.abc import Hashable
from typing import Generic, TypeVar

Address = TypeVar("Address", bound=Hashable)

#: A link that was silent for so long is doubtful: what may not have gaps goes over the others too [s]. With the time
#: between two targets it stays below the second after which PX4 leaves OFFBOARD.
DOUBT_S = 0.5


class Sightings(Generic[Address]):
    """Addresses from which one system id beats, most preferred link first.

    Parameters
    ----------
    silent_after_s : float
        An address without a heartbeat for so long is forgotten.

    Notes
    -----
    One vehicle may have several links, but on one link it has one address at a time. A vehicle that comes back under
    another address (a simulator started again, a new DHCP lease) falls silent at the old one; two vehicles with one
    id beat on in turn. So a second address on a link counts as a duplicate as soon as the first beats again after
    it, and until then as not yet served.
    """

    def __init__(self, silent_after_s: float = 4.0) -> None:
        self.silent_after_s = silent_after_s
        self._heard: dict[int, dict[Address, float]] = {}
        self._contested: set[int] = set()
        self._last: dict[Address, float] = {}
        #: Nothing can fall silent before.
        self._expire_after = math.inf

    def alive(self, address: Address, now: float) -> None:
        """Take any message from an address that beats."""
        if address in self._last:
            self._last[address] = now

    def heard(self, link: int, address: Address, now: float) -> None:
        """Take a heartbeat from an address on a link (a number; the lowest is preferred)."""
        self._expire(now)
        on_link = self._heard.setdefault(link, {})
        if address in on_link and next(reversed(on_link)) != address:
            self._contested.add(link)
        on_link.pop(address, None)
        on_link[address] = self._last[address] = now
        self._expire_after = min(self._expire_after, now + self.silent_after_s)

    def duplicates(self, now: float) -> tuple[Address, ...]:
        """Addresses that share the id on one link; empty in good order."""
        self._expire(now)
        return tuple(address for link in sorted(self._contested) for address in self._heard[link])

    def route(self, now: float) -> Address | None:
        """Where to send to: the address on the most preferred link that is heard; None if nowhere or contested."""
        self._expire(now)
        if self._contested or not self._heard:
            return None
        # The oldest address on the link: a newcomer is served once the former has fallen silent.
        return next(iter(self._heard[min(self._heard)]))

    def stand_ins(self, now: float) -> tuple[Address, ...]:
        """Addresses on the other links, to be sent to as well while the route is doubtful; else none."""
        route = self.route(now)
        if route is None or now - self._last[route] <= DOUBT_S:
            return ()
        places = (next(iter(self._heard[link])) for link in sorted(self._heard))
        return tuple(place for place in places if place != route)

    def forget(self) -> None:
        """Start again, after a reboot."""
        self._heard.clear()
        self._contested.clear()
        self._last.clear()

    def _expire(self, now: float) -> None:
        if now <= self._expire_after:
            return
        for link, on_link in list(self._heard.items()):
            for address, at in list(on_link.items()):
                if now - at > self.silent_after_s:
                    del on_link[address]
                    self._last.pop(address, None)
            if len(on_link) < 2:
                self._contested.discard(link)
            if not on_link:
                del self._heard[link]
        oldest = min((at for on_link in self._heard.values() for at in on_link.values()), default=math.inf)
        self._expire_after = oldest + self.silent_after_s

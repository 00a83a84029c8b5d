"""Where one system id is heard: its route, and whether two vehicles share the id."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Generic, TypeVar

Address = TypeVar("Address", bound=Hashable)


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

    def heard(self, link: int, address: Address, now: float) -> None:
        """Take a heartbeat from an address on a link (a number; the lowest is preferred)."""
        self._expire(now)
        on_link = self._heard.setdefault(link, {})
        if address in on_link and next(reversed(on_link)) != address:
            self._contested.add(link)
        on_link.pop(address, None)
        on_link[address] = now

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

    def forget(self) -> None:
        """Start again, after a reboot."""
        self._heard.clear()
        self._contested.clear()

    def _expire(self, now: float) -> None:
        for link, on_link in list(self._heard.items()):
            for address, at in list(on_link.items()):
                if now - at > self.silent_after_s:
                    del on_link[address]
            if len(on_link) < 2:
                self._contested.discard(link)
            if not on_link:
                del self._heard[link]

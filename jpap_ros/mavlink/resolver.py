"""Host names to addresses without holding up the thread that talks to the aircraft."""

from __future__ import annotations

import ipaddress
import socket
import threading
from collections.abc import Callable

_RETRY_S = 5.0

Address = tuple[int, tuple[str, int]]


class Resolver:
    """Looks names up in a thread of their own, one at a time for each name.

    Parameters
    ----------
    found : callable
        Called from that thread when an answer is there.
    """

    def __init__(self, found: Callable[[], None]) -> None:
        self._found = found
        self._answers: dict[tuple[str, int], Address | None] = {}
        self._next_try: dict[tuple[str, int], float] = {}

    def find(self, host: str, port: int, now: float) -> Address | None:
        """Address family and socket address, or None while it is not known. Never blocks."""
        try:
            ipaddress.ip_address(host)
        except ValueError:
            pass
        else:
            return _look_up(host, port)
        key = (host, port)
        answer = self._answers.get(key)
        if answer is None and now >= self._next_try.get(key, float("-inf")):
            self._next_try[key] = now + _RETRY_S
            threading.Thread(target=self._work, args=key, name=f"resolve {host}", daemon=True).start()
        return answer

    def _work(self, host: str, port: int) -> None:
        self._answers[host, port] = _look_up(host, port)
        self._found()


def _look_up(host: str, port: int) -> Address | None:
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    except (OSError, UnicodeError):
        return None
    return family, address  # type: ignore[return-value]

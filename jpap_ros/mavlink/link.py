"""What every kind of link has: remote peers with a stream each, states, counters."""

from __future__ import annotations

import selectors
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from jpap_ros.fleet.config import LinkUrl
from jpap_ros.mavlink.channel import Channel
from jpap_ros.mavlink.signing import Signer
from jpap_ros.mavlink.statistics import LinkStatistics


@dataclass(frozen=True)
class LinkOptions:
    """How a link is run.

    Attributes
    ----------
    signer : Signer or None
        Signs what is sent and checks what comes; None for an unsigned link. Links with one key share one signer.
    max_bytes_per_s : float or None
        Limit of what is sent [byte/s]; None for no limit. Frames forwarded for others give way to our own.
    max_peers : int
        Of a `udpin` link: senders remembered at a time; others are not heard until one falls silent.
    forget_peer_s : float
        Of a `udpin` link: a sender silent for so long is forgotten [s].
    connect_timeout_s : float
        Of a `tcp` link: how long one attempt may take [s].
    unanswered_s : float
        Of a `tcp` link: bytes not taken by the other side for so long end the connection, and with it what waits
        in the buffers: a command delivered late is worse than none [s].
    first_retry_s, max_retry_s : float
        Of a `tcp` or `serial` link: pause after the first failed attempt, doubled up to the second value [s].
    max_pending_bytes : int
        Of a `tcp` or `serial` link: bytes kept while the system takes none; further frames are dropped whole. A
        serial link keeps no more than a quarter of a second's worth.
    """

    signer: Signer | None = None
    max_bytes_per_s: float | None = None
    max_peers: int = 512
    forget_peer_s: float = 60.0
    connect_timeout_s: float = 5.0
    unanswered_s: float = 3.0
    first_retry_s: float = 0.25
    max_retry_s: float = 5.0
    max_pending_bytes: int = 4096


class Peer:
    """One remote end of a link, with the state of the stream in each direction.

    Attributes
    ----------
    address : tuple or None
        Its UDP or TCP socket address, beginning with host and port; None on a serial link.
    channel : Channel
        Parser of what comes from it.
    sequence : int
        Of the next message of ours to it. Counted per remote end, so that it sees no gaps.
    first_heard, last_heard : float
        Monotonic time [s] of its first bytes and of its last good message; minus infinity if none came.
    """

    __slots__ = ("_name", "address", "channel", "first_heard", "last_heard", "sequence")

    def __init__(self, name: str, address: tuple[Any, ...] | None, statistics: LinkStatistics) -> None:
        self._name = name
        self.address = address
        self.channel = Channel(statistics)
        self.sequence = 0
        self.first_heard = float("-inf")
        self.last_heard = float("-inf")

    @property
    def trusted(self) -> bool:
        """Whether a good message came from it, correctly signed where the link asks for that."""
        return self.last_heard > float("-inf")

    def __str__(self) -> str:
        return self._name

    def __repr__(self) -> str:
        return f"Peer({self._name})"


class Link(ABC):
    """One socket or serial port. All methods are for the hub's thread.

    Attributes
    ----------
    url : LinkUrl
    options : LinkOptions
    index : int
        Number of the link within its hub, from 0.
    statistics : LinkStatistics
    reconnects : int
        Connections made after the first.
    problem : str
        Why the link is down; empty while it is up.
    """

    def __init__(self, url: LinkUrl, options: LinkOptions, index: int, selector: selectors.BaseSelector) -> None:
        self.url = url
        self.options = options
        self.index = index
        self.statistics = LinkStatistics()
        self.reconnects = 0
        self.problem = ""
        self._selector = selector

    @property
    @abstractmethod
    def up(self) -> bool:
        """Whether bytes can be sent."""

    @property
    @abstractmethod
    def peers(self) -> tuple[Peer, ...]:
        """Remote ends that messages for all go to."""

    @abstractmethod
    def service(self, now: float) -> float:
        """Do what time asks for (connect, give up, forget); return the time to be called again."""

    @abstractmethod
    def read(self, now: float) -> Iterator[tuple[Peer, memoryview]]:
        """Read what is ready, a bounded amount; each view is valid until the next one is asked for."""

    @abstractmethod
    def write_ready(self, now: float) -> None:
        """The socket can take bytes again."""

    @abstractmethod
    def transmit(self, data: bytes, peer: Peer) -> bool:
        """Send one whole frame; False if it was dropped whole."""

    @abstractmethod
    def close(self) -> None:
        """Release the socket or port."""

    def __str__(self) -> str:
        return str(self.url)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.url})"

"""UDP links: listening for many senders, or talking to one address."""

from __future__ import annotations

import contextlib
import selectors
import socket
from collections.abc import Iterator
from typing import Any

from jpap_ros.fleet.config import LinkUrl
from jpap_ros.mavlink.link import Link, LinkOptions, Peer
from jpap_ros.mavlink.resolver import Resolver

_DATAGRAMS_PER_READ = 128
_RECEIVE_BUFFER_BYTES = 4 << 20
_receive_buffer = memoryview(bytearray(65_536))


class UdpLink(Link):
    """A UDP socket; which remote ends it has is for the subclasses."""

    _socket: socket.socket | None = None

    def _open(self, family: int) -> socket.socket:
        sock = socket.socket(family, socket.SOCK_DGRAM)
        sock.setblocking(False)
        # 200 vehicles that answer at once must not overflow the buffer; the kernel takes what it allows.
        with contextlib.suppress(OSError):
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
        return sock

    def _start(self, sock: socket.socket) -> None:
        self._socket = sock
        self._selector.register(sock, selectors.EVENT_READ, self)

    @property
    def up(self) -> bool:
        """Whether the socket is open."""
        return self._socket is not None

    @property
    def local_address(self) -> tuple[str, int] | None:
        """Address and port of our side."""
        return None if self._socket is None else self._socket.getsockname()[:2]

    def write_ready(self, now: float) -> None:
        """Nothing waits: a datagram is sent at once or dropped."""

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._selector.unregister(self._socket)
            self._socket.close()
            self._socket = None


class UdpListener(UdpLink):
    """`udpin`: remote ends are those that sent something lately, known by their source address.

    Raises
    ------
    OSError
        If the port cannot be listened on; the message names the url.
    """

    def __init__(self, url: LinkUrl, options: LinkOptions, index: int, selector: selectors.BaseSelector) -> None:
        super().__init__(url, options, index, selector)
        self.refused_datagrams = 0
        self._peers: dict[tuple[Any, ...], Peer] = {}
        sock = None
        try:
            family, _, _, _, address = socket.getaddrinfo(url.host, url.port, type=socket.SOCK_DGRAM)[0]
            sock = self._open(family)
            sock.bind(address)
        except (OSError, UnicodeError) as error:
            if sock is not None:
                sock.close()
            reason = error.strerror if isinstance(error, OSError) else f"{url.host!r} is not a host name"
            raise OSError(f"{url}: cannot listen: {reason}") from None
        self._start(sock)

    @property
    def peers(self) -> tuple[Peer, ...]:
        """Senders of good messages; nothing is sent to an address for having sent us noise."""
        return tuple(peer for peer in self._peers.values() if peer.trusted)

    def service(self, now: float) -> float:
        """Forget silent senders."""
        limit = now - self.options.forget_peer_s
        for address, peer in list(self._peers.items()):
            if max(peer.first_heard, peer.last_heard) < limit:
                del self._peers[address]
        return now + self.options.forget_peer_s / 4.0

    def read(self, now: float) -> Iterator[tuple[Peer, memoryview]]:
        """Datagrams with their senders."""
        for _ in range(_DATAGRAMS_PER_READ):
            if self._socket is None:
                return
            try:
                count, address = self._socket.recvfrom_into(_receive_buffer)
            except BlockingIOError:
                return
            except OSError:
                # An ICMP error for something sent earlier; the socket itself is sound.
                continue
            peer = self._peers.get(address) or self._learn(address, now)
            if peer is None:
                self.refused_datagrams += 1
                continue
            yield peer, _receive_buffer[:count]

    def _learn(self, address: tuple[Any, ...], now: float) -> Peer | None:
        if len(self._peers) >= self.options.max_peers:
            oldest = min(self._peers, key=lambda key: (self._peers[key].last_heard, self._peers[key].first_heard))
            if self._peers[oldest].trusted:
                return None
            # Noise from many addresses must not keep a vehicle out.
            del self._peers[oldest]
        peer = Peer(f"{address[0]}:{address[1]}", address, self.statistics)
        peer.first_heard = now
        self._peers[address] = peer
        return peer

    def transmit(self, data: bytes, peer: Peer) -> bool:
        """Send one datagram to a sender heard before."""
        if self._socket is None or peer.address is None:
            return False
        try:
            self._socket.sendto(data, peer.address)
        except OSError:
            return False
        return True


class UdpSender(UdpLink):
    """`udpout`: one remote end at a fixed address; datagrams from elsewhere are not heard."""

    def __init__(
        self, url: LinkUrl, options: LinkOptions, index: int, selector: selectors.BaseSelector, resolver: Resolver
    ) -> None:
        super().__init__(url, options, index, selector)
        self._resolver = resolver
        self._peer = Peer(str(url), (url.host, url.port), self.statistics)
        self.problem = "not open yet"

    @property
    def peers(self) -> tuple[Peer, ...]:
        """The one remote end."""
        return (self._peer,)

    def service(self, now: float) -> float:
        """Open the socket once the address is known."""
        if self._socket is not None:
            return float("inf")
        found = self._resolver.find(self.url.host, self.url.port, now)
        if found is None:
            self.problem = f"the address of {self.url.host!r} is not known yet"
            return now + self.options.max_retry_s
        family, address = found
        sock = None
        try:
            sock = self._open(family)
            # The kernel then drops datagrams from any other address.
            sock.connect(address)
        except OSError as error:
            if sock is not None:
                sock.close()
            self.problem = error.strerror or str(error)
            return now + self.options.max_retry_s
        self._start(sock)
        self.problem = ""
        return float("inf")

    def read(self, now: float) -> Iterator[tuple[Peer, memoryview]]:
        """Datagrams from the remote end."""
        for _ in range(_DATAGRAMS_PER_READ):
            if self._socket is None:
                return
            try:
                count = self._socket.recv_into(_receive_buffer)
            except BlockingIOError:
                return
            except OSError:
                # Connection refused: nobody listens there yet. Later datagrams may arrive.
                continue
            yield self._peer, _receive_buffer[:count]

    def transmit(self, data: bytes, peer: Peer) -> bool:
        """Send one datagram."""
        if self._socket is None:
            return False
        # Twice: "connection refused" is the error of an earlier datagram, and then this one was not sent.
        for _ in range(2):
            try:
                self._socket.send(data)
            except ConnectionRefusedError:
                continue
            except OSError:
                return False
            return True
        return False

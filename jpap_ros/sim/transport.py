"""Sockets of the simulated vehicles: the opposite ends of the fleet file's urls."""

from __future__ import annotations

import contextlib
import selectors
import socket
from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Any, ClassVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.fleet.config import LinkUrl

_DATAGRAM = 65_535
_DATAGRAMS_PER_READ = 64
_STREAM_READ = 65_536
#: A stream that the peer does not read loses frames beyond this, as a full serial buffer does [bytes].
_STREAM_BACKLOG = 262_144
_SOCKET_BUFFER = 1 << 20
_ANY_HOST = ("0.0.0.0", "*")


class SimError(Exception):
    """The simulated vehicles cannot run as asked; one line."""


class Inbox:
    """Parser of what one peer sends.

    Parameters
    ----------
    signing_key : bytes or None
        With a key, frames without a good signature are dropped and counted.
    datagrams : bool
        Data comes in datagrams of whole frames; what is left of a broken one does not swallow the next.
    """

    def __init__(self, signing_key: bytes | None, datagrams: bool) -> None:
        self._datagrams = datagrams
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self._parser.signing.secret_key = signing_key
        self.rejected = 0

    def messages(self, data: bytes) -> list[Any]:
        """Whole messages in the data, with what earlier data left."""
        if self._datagrams and self._parser.buf_len() > 0:
            self._parser.buf, self._parser.buf_index = bytearray(), 0
            self._parser.expected_length = mavlink.HEADER_LEN_V1 + 2
            self.rejected += 1
        messages = []
        for message in self._parser.parse_buffer(data) or ():
            if message.get_type() == "BAD_DATA":
                self.rejected += 1
            else:
                messages.append(message)
        return messages


class Port(ABC):
    """One socket, or one listening socket with its connections."""

    _DATAGRAMS: ClassVar[bool]

    def __init__(self, signing_key: bytes | None) -> None:
        self.signing_key = signing_key
        self._inboxes: dict[Any, Inbox] = {}
        self._gone = 0

    @property
    def rejected(self) -> int:
        """Frames dropped for a bad checksum or signature."""
        return self._gone + sum(inbox.rejected for inbox in self._inboxes.values())

    @abstractmethod
    def register(self, selector: selectors.BaseSelector) -> None:
        """Have incoming data announced; the key's data is a function that reads it."""

    @abstractmethod
    def send(self, data: bytes) -> None:
        """Send whole frames to every peer."""

    @abstractmethod
    def close(self) -> None:
        """Close all sockets."""

    def _inbox(self, peer: Any) -> Inbox:
        inbox = self._inboxes.get(peer)
        if inbox is None:
            inbox = self._inboxes[peer] = Inbox(self.signing_key, self._DATAGRAMS)
        return inbox


class UdpPort(Port):
    """A UDP socket.

    Parameters
    ----------
    url : LinkUrl
        The bridge's end. `udpin`: frames go to its address, from a port of our own. `udpout`: its address is ours,
        and everyone who speaks to it gets the frames.
    signing_key : bytes or None
    """

    _DATAGRAMS = True

    def __init__(self, url: LinkUrl, signing_key: bytes | None) -> None:
        super().__init__(signing_key)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _SOCKET_BUFFER)
        self._selector: selectors.BaseSelector | None = None
        self._peers: dict[Any, None] = {}
        try:
            if url.kind == "udpin":
                host = "127.0.0.1" if url.host in _ANY_HOST else socket.gethostbyname(url.host)
                self._socket.bind(("127.0.0.1" if host.startswith("127.") else "0.0.0.0", 0))
                self._peers[(host, url.port)] = None
            else:
                self._socket.bind((url.host, url.port))
        except OSError as error:
            self._socket.close()
            raise SimError(f"{url}: {error.strerror or error}") from None
        self._listens = url.kind == "udpout"

    def register(self, selector: selectors.BaseSelector) -> None:
        """Announce datagrams."""
        self._selector = selector
        selector.register(self._socket, selectors.EVENT_READ, (self, self._read))

    def _read(self) -> Iterator[Any]:
        for _ in range(_DATAGRAMS_PER_READ):
            try:
                data, peer = self._socket.recvfrom(_DATAGRAM)
            except OSError:
                return
            if self._listens:
                self._peers[peer] = None
            yield from self._inbox(peer).messages(data)

    def send(self, data: bytes) -> None:
        """Send one datagram to each peer."""
        for peer in self._peers:
            # A full buffer or a route that is gone loses datagrams, as radio does.
            with contextlib.suppress(OSError):
                self._socket.sendto(data, peer)

    def close(self) -> None:
        """Close the socket."""
        if self._selector is not None:
            self._selector.unregister(self._socket)
        self._socket.close()


class TcpPort(Port):
    """A TCP server, as a simulator's serial port is; every connection gets every frame."""

    _DATAGRAMS = False

    def __init__(self, url: LinkUrl, signing_key: bytes | None) -> None:
        super().__init__(signing_key)
        self._server = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._server.setblocking(False)
        self._backlog: dict[socket.socket, bytearray] = {}
        self._selector: selectors.BaseSelector | None = None
        try:
            self._server.bind((url.host, url.port))
            self._server.listen()
        except OSError as error:
            self._server.close()
            raise SimError(f"{url}: {error.strerror or error}") from None

    def register(self, selector: selectors.BaseSelector) -> None:
        """Announce connections and data."""
        self._selector = selector
        selector.register(self._server, selectors.EVENT_READ, (self, self._accept))

    def _accept(self) -> Iterator[Any]:
        try:
            connection, _ = self._server.accept()
        except OSError:
            return iter(())
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._backlog[connection] = bytearray()
        if self._selector is not None:
            self._selector.register(connection, selectors.EVENT_READ, (self, lambda: self._read(connection)))
        return iter(())

    def _read(self, connection: socket.socket) -> Iterator[Any]:
        try:
            data = connection.recv(_STREAM_READ)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop(connection)
            return
        yield from self._inbox(connection).messages(data)

    def send(self, data: bytes) -> None:
        """Append to each connection's stream, whole frames only."""
        for connection, backlog in list(self._backlog.items()):
            if len(backlog) + len(data) <= _STREAM_BACKLOG:
                backlog += data
            try:
                del backlog[: connection.send(backlog)]
            except BlockingIOError:
                continue
            except OSError:
                self._drop(connection)

    def disconnect(self) -> None:
        """Break all connections, as a link that goes down does."""
        for connection in list(self._backlog):
            self._drop(connection)

    def _drop(self, connection: socket.socket) -> None:
        if self._selector is not None:
            self._selector.unregister(connection)
        self._backlog.pop(connection, None)
        inbox = self._inboxes.pop(connection, None)
        self._gone += inbox.rejected if inbox is not None else 0
        connection.close()

    def close(self) -> None:
        """Close the server and all connections."""
        self.disconnect()
        if self._selector is not None:
            self._selector.unregister(self._server)
        self._server.close()


def open_port(url: LinkUrl, signing_key: bytes | None) -> Port:
    """Open the vehicles' end of a url; SimError if it cannot be had."""
    if url.kind == "serial":
        raise SimError(f"{url}: a simulated vehicle has no serial port; give it a udp or tcp url")
    return TcpPort(url, signing_key) if url.kind == "tcp" else UdpPort(url, signing_key)

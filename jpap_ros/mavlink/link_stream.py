"""Byte-stream links, TCP client and serial port: reconnected with a growing pause, never blocking."""

from __future__ import annotations

import errno
import os
import selectors
import socket
import termios
from abc import abstractmethod
from collections.abc import Iterator

import serial

from jpap_ros.fleet.config import LinkUrl
from jpap_ros.mavlink.frame import MAX_BYTES
from jpap_ros.mavlink.link import Link, LinkOptions, Peer
from jpap_ros.mavlink.resolver import Resolver

_CHUNK_BYTES = 65_536
_SEND_BUFFER_BYTES = 32_768
_BITS_A_BYTE = 10
_SERIAL_BACKLOG_S = 0.25


class StreamLink(Link):
    """A stream to one remote end that is opened again whenever it breaks."""

    def __init__(self, url: LinkUrl, options: LinkOptions, index: int, selector: selectors.BaseSelector) -> None:
        super().__init__(url, options, index, selector)
        self.problem = "not connected yet"
        self._peer = Peer(str(url), None if url.kind == "serial" else (url.host, url.port), self.statistics)
        self._fd: int | None = None
        self._open = False
        self._opened_before = False
        self._pending = bytearray()
        self._max_pending = options.max_pending_bytes
        self._retry_at = float("-inf")
        self._pause_s = options.first_retry_s

    @property
    def up(self) -> bool:
        """Whether the stream is connected."""
        return self._open

    @property
    def peers(self) -> tuple[Peer, ...]:
        """The one remote end."""
        return (self._peer,)

    @abstractmethod
    def _release(self) -> None:
        """Close what was opened, if anything was."""

    def read(self, now: float) -> Iterator[tuple[Peer, memoryview]]:
        """One chunk of bytes."""
        if self._fd is None or not self._open:
            return
        try:
            data = os.read(self._fd, _CHUNK_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            self._break(now, error.strerror or str(error))
            return
        if not data:
            self._break(now, "closed by the other side")
            return
        yield self._peer, memoryview(data)

    def transmit(self, data: bytes, peer: Peer) -> bool:
        """Send one frame now, or keep what the system does not take yet."""
        if self._fd is None or not self._open or len(self._pending) + len(data) > self._max_pending:
            return False
        if self._pending:
            self._pending += data
            return True
        try:
            written = os.write(self._fd, data)
        except BlockingIOError:
            written = 0
        except OSError:
            # The next read reports why.
            return False
        if written < len(data):
            self._pending += data[written:]
            self._watch(selectors.EVENT_READ | selectors.EVENT_WRITE)
        return True

    def write_ready(self, now: float) -> None:
        """Send what was kept."""
        if self._fd is None or not self._open:
            return
        try:
            del self._pending[: os.write(self._fd, self._pending)]
        except BlockingIOError:
            return
        except OSError as error:
            self._break(now, error.strerror or str(error))
            return
        if not self._pending:
            self._watch(selectors.EVENT_READ)

    def close(self) -> None:
        """Close the stream."""
        if self._fd is not None:
            self._selector.unregister(self._fd)
            self._fd = None
        self._release()
        self._open = False
        self._pending.clear()

    def _register(self, fd: int, events: int) -> None:
        self._fd = fd
        self._selector.register(fd, events, self)

    def _watch(self, events: int) -> None:
        if self._fd is not None:
            self._selector.modify(self._fd, events, self)

    def _connected(self) -> None:
        self._open = True
        self._pause_s = self.options.first_retry_s
        self.problem = ""
        self._peer.channel.reset()
        self.reconnects += self._opened_before
        self._opened_before = True

    def _break(self, now: float, problem: str) -> None:
        self.close()
        self.problem = problem
        self._retry_at = now + self._pause_s
        self._pause_s = min(2.0 * self._pause_s, self.options.max_retry_s)


class TcpClient(StreamLink):
    """`tcp`: connects to a listening vehicle or ground station."""

    def __init__(
        self, url: LinkUrl, options: LinkOptions, index: int, selector: selectors.BaseSelector, resolver: Resolver
    ) -> None:
        super().__init__(url, options, index, selector)
        self._resolver = resolver
        self._socket: socket.socket | None = None
        self._give_up_at = 0.0

    def service(self, now: float) -> float:
        """Connect, or give a slow attempt up."""
        if self._open:
            return float("inf")
        if self._socket is not None:
            if now < self._give_up_at:
                return self._give_up_at
            self._break(now, "connecting timed out")
        if now < self._retry_at:
            return self._retry_at
        found = self._resolver.find(self.url.host, self.url.port, now)
        if found is None:
            self._break(now, f"the address of {self.url.host!r} is not known yet")
            return self._retry_at
        family, address = found
        try:
            self._connect(family, address, now)
        except OSError as error:
            self._break(now, error.strerror or str(error))
            return self._retry_at
        return self._give_up_at

    def _connect(self, family: int, address: tuple[str, int], now: float) -> None:
        self._socket = socket.socket(family, socket.SOCK_STREAM)
        self._socket.setblocking(False)
        # A setpoint must not wait for the acknowledgement of the one before.
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, int(1000 * self.options.unanswered_s))
        self._register(self._socket.fileno(), selectors.EVENT_WRITE)
        self._give_up_at = now + self.options.connect_timeout_s
        code = self._socket.connect_ex(address)
        if code not in (0, errno.EINPROGRESS):
            raise OSError(code, os.strerror(code))

    def write_ready(self, now: float) -> None:
        """Learn how connecting ended, or send what was kept."""
        if self._open or self._socket is None:
            super().write_ready(now)
            return
        code = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if code:
            self._break(now, os.strerror(code))
            return
        self._connected()
        self._watch(selectors.EVENT_READ)

    def _release(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None


class SerialPort(StreamLink):
    """`serial`: a telemetry radio or a cable; opened again after it was unplugged."""

    def __init__(self, url: LinkUrl, options: LinkOptions, index: int, selector: selectors.BaseSelector) -> None:
        super().__init__(url, options, index, selector)
        self._port: serial.Serial | None = None
        self._max_pending = min(options.max_pending_bytes, int(_SERIAL_BACKLOG_S * url.port / _BITS_A_BYTE) + MAX_BYTES)

    def service(self, now: float) -> float:
        """Open the port if it is there."""
        if self._open:
            return float("inf")
        if now < self._retry_at:
            return self._retry_at
        try:
            # Two programs on one port would each get half of every frame.
            self._port = serial.Serial(
                self.url.host, self.url.port, timeout=0, write_timeout=0, exclusive=True, rtscts=False
            )
            self._register(self._port.fileno(), selectors.EVENT_READ)
        except (OSError, ValueError, termios.error) as error:
            self._break(now, str(error))
            return self._retry_at
        self._connected()
        return float("inf")

    def _release(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None

"""All links of one process, read and written by one thread.

>>> hub = LinkHub(sysid=245)
>>> link = hub.open(LinkUrl.parse("udpin:127.0.0.1:14550"))
>>> packets = hub.poll(timeout_s=0.1)
"""

from __future__ import annotations

import contextlib
import selectors
import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as dialect

from jpap_ros.fleet.config import LinkUrl
from jpap_ros.mavlink.budget import TokenBucket
from jpap_ros.mavlink.link import Link, LinkOptions, Peer
from jpap_ros.mavlink.link_stream import SerialPort, TcpClient
from jpap_ros.mavlink.link_udp import UdpListener, UdpSender
from jpap_ros.mavlink.resolver import Resolver
from jpap_ros.mavlink.signing import Verdict

__all__ = ["Link", "LinkHub", "LinkOptions", "Packet", "Peer"]

RADIO_STATUS = dialect.MAVLINK_MSG_ID_RADIO_STATUS
COMPONENT_ID = dialect.MAV_COMP_ID_ONBOARD_COMPUTER


@dataclass(frozen=True, slots=True)
class Packet:
    """One message received.

    Attributes
    ----------
    link : Link
    peer : Peer
        Remote end of the link it came from.
    message : MAVLink_message
        Its `get_msgbuf()` holds the frame's raw bytes.
    received_at : float
        Monotonic time [s].
    """

    link: Link
    peer: Peer
    message: dialect.MAVLink_message
    received_at: float


class LinkHub:
    """Opens links, sends and receives MAVLink 2 on them. Everything but `wake` is for one thread.

    Parameters
    ----------
    sysid, component : int
        Our own MAVLink identity.
    clock : callable
        Monotonic time [s].
    on_frame : callable, optional
        Called with the link's url and the raw bytes of every frame sent, or received and believed; must return at once.
    """

    def __init__(
        self,
        sysid: int,
        component: int = COMPONENT_ID,
        clock: Callable[[], float] = time.monotonic,
        on_frame: Callable[[LinkUrl, bytes | bytearray], None] | None = None,
    ) -> None:
        self._clock = clock
        self._on_frame = on_frame
        self._selector = selectors.DefaultSelector()
        self._links: list[Link] = []
        self._service_at: dict[Link, float] = {}
        self._next_service = float("inf")
        self._buckets: dict[Link, TokenBucket] = {}
        self._packer = dialect.MAVLink(None, srcSystem=sysid, srcComponent=component)
        self._wake_receiver, self._wake_sender = socket.socketpair()
        self._wake_receiver.setblocking(False)
        self._wake_sender.setblocking(False)
        self._selector.register(self._wake_receiver, selectors.EVENT_READ, None)
        self._resolver = Resolver(self.wake)

    @property
    def links(self) -> tuple[Link, ...]:
        """All open links, in the order of opening."""
        return tuple(self._links)

    def open(self, url: LinkUrl, options: LinkOptions = LinkOptions()) -> Link:  # noqa: B008 (immutable)
        """Open a link.

        Raises
        ------
        OSError
            If the port of a `udpin` url cannot be listened on. Anything else that is not there yet is tried again,
            by `poll`, until it is.
        """
        index = len(self._links)
        link: Link
        if url.kind == "udpin":
            link = UdpListener(url, options, index, self._selector)
        elif url.kind == "udpout":
            link = UdpSender(url, options, index, self._selector, self._resolver)
        elif url.kind == "tcp":
            link = TcpClient(url, options, index, self._selector, self._resolver)
        else:
            link = SerialPort(url, options, index, self._selector)
        self._links.append(link)
        self._service_at[link] = link.service(self._clock())
        self._next_service = min(self._next_service, self._service_at[link])
        if options.max_bytes_per_s is not None:
            self._buckets[link] = TokenBucket(options.max_bytes_per_s, self._clock())
        return link

    def poll(self, timeout_s: float) -> list[Packet]:
        """Wait until something happens, at most `timeout_s`, and return all messages that came.

        Also connects, reconnects, sends what could not be sent before, and forgets silent remote ends.
        """
        wait_s = max(0.0, min(timeout_s, self._next_service - self._clock()))
        packets: list[Packet] = []
        for key, events in self._selector.select(wait_s):
            link = key.data
            if link is None:
                self._drain_wakes()
                continue
            now = self._clock()
            if events & selectors.EVENT_READ:
                packets.extend(self._receive(link, now))
            if events & selectors.EVENT_WRITE:
                link.write_ready(now)
            if not link.up:
                self._service_soon(link)
        now = self._clock()
        if now >= self._next_service:
            for link, due in self._service_at.items():
                if due <= now:
                    self._service_at[link] = link.service(now)
            self._next_service = min(self._service_at.values(), default=float("inf"))
        return packets

    def _service_soon(self, link: Link) -> None:
        self._service_at[link] = self._next_service = float("-inf")

    def _receive(self, link: Link, now: float) -> Iterator[Packet]:
        statistics = link.statistics
        signer = link.options.signer
        for peer, data in link.read(now):
            for message in peer.channel.receive(data):
                frame = message.get_msgbuf()
                if signer is None:
                    peer.last_heard = now
                else:
                    verdict = signer.check(frame)
                    if verdict is Verdict.GOOD:
                        peer.last_heard = now
                    # A telemetry radio adds its own reports and has no key; they do not make a sender trusted.
                    elif verdict is not Verdict.UNSIGNED or message.get_msgId() != RADIO_STATUS:
                        statistics.count_refused(verdict, len(frame), now)
                        continue
                source = (message.get_srcSystem(), message.get_srcComponent())
                statistics.count_received(source, message.get_seq(), len(frame), now)
                if self._on_frame is not None:
                    self._on_frame(link.url, frame)
                yield Packet(link, peer, message, now)

    def send(self, link: Link, message: dialect.MAVLink_message, peer: Peer | None = None) -> bool:
        """Pack a message with our identity, sign it if the link has a key, and send it at once.

        Parameters
        ----------
        peer : Peer, optional
            One remote end of the link; all of them if None.

        Returns
        -------
        bool
            False if it went to nobody: the link is down, knows no remote end, or its buffer is full.

        Raises
        ------
        struct.error
            If a field's value does not fit its type.
        """
        sent = False
        packer, signer = self._packer, link.options.signer
        for remote in link.peers if peer is None else (peer,):
            packer.seq = remote.sequence
            if signer is not None:
                signer.sign(packer, link.index)
            else:
                packer.signing.sign_outgoing = False
            if self._transmit(link, message.pack(packer), remote):
                remote.sequence = (remote.sequence + 1) % 256
                sent = True
        link.statistics.dropped += not sent
        return sent

    def forward(self, link: Link, frame: bytes, peer: Peer | None = None, urgent: bool = False) -> bool:
        """Send the raw bytes of another system's frame, unchanged.

        Parameters
        ----------
        peer : Peer, optional
            One remote end of the link; all of them if None.
        urgent : bool
            Not held back by the link's byte budget.

        Returns
        -------
        bool
            False if it went to nobody, as in `send`, or the budget has no room for it now.
        """
        sent = False
        bucket = self._buckets.get(link)
        for remote in link.peers if peer is None else (peer,):
            if bucket is not None and not urgent and not bucket.has(len(frame), self._clock()):
                link.statistics.over_budget += 1
                continue
            sent |= self._transmit(link, frame, remote)
        return sent

    def _transmit(self, link: Link, frame: bytes, peer: Peer) -> bool:
        if not link.transmit(frame, peer):
            return False
        if self._on_frame is not None:
            self._on_frame(link.url, frame)
        link.statistics.sent.add(len(frame), self._clock())
        bucket = self._buckets.get(link)
        if bucket is not None:
            bucket.spend(len(frame))
        return True

    def wake(self) -> None:
        """Make `poll` return soon. For any thread."""
        # Full: a wake-up is under way already. Closed: nobody polls any more.
        with contextlib.suppress(BlockingIOError, OSError):
            self._wake_sender.send(b"w")

    def _drain_wakes(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while self._wake_receiver.recv(4096):
                pass
        # Perhaps it was the resolver, and a link can be opened now.
        for link in self._links:
            if not link.up:
                self._service_soon(link)

    def close(self) -> None:
        """Close all links."""
        for link in self._links:
            link.close()
            if link.options.signer is not None:
                link.options.signer.close()
        self._links.clear()
        self._service_at.clear()
        self._buckets.clear()
        self._selector.close()
        self._wake_receiver.close()
        self._wake_sender.close()

    def __enter__(self) -> LinkHub:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

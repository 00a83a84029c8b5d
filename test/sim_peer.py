"""A MAVLink peer of simulated vehicles over a plain socket, made of pymavlink's parser alone."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.fleet.config import FleetConfig, parse_fleet

#: Only a failing test waits so long [s].
PATIENCE_S = 30.0


def fleet_of(*uavs: str) -> FleetConfig:
    """A fleet from the lines of its UAVs, e.g. `{name: uav1, sysid: 1, url: "tcp:127.0.0.1:5760"}`."""
    lines = ["version: 1", "origin: {latitude: -37.8136, longitude: 144.9631, altitude_amsl_m: 20}", "uavs:"]
    return parse_fleet("\n".join([*lines, *(f"  - {uav}" for uav in uavs)]))


class Peer:
    """One end of a link.

    Parameters
    ----------
    sock : socket
        Bound UDP or connected TCP socket.
    to : tuple or None
        Where to send datagrams; None: to where the first one came from.
    signing_key : bytes or None
    """

    def __init__(
        self, sock: socket.socket, to: tuple[str, int] | None = None, signing_key: bytes | None = None
    ) -> None:
        self.socket, self.to = sock, to
        self.mav = mavlink.MAVLink(None, 245, 191)
        if signing_key is not None:
            self.mav.signing.secret_key, self.mav.signing.sign_outgoing = signing_key, True
            self.mav.signing.timestamp = int((time.time() - 1_420_070_400) * 1e5)
        self.parser = mavlink.MAVLink(None)
        self.parser.robust_parsing = True
        self.heard: list[Any] = []

    @classmethod
    def udp(cls, port: int = 0, to: tuple[str, int] | None = None, **options: Any) -> Peer:
        """A peer on a UDP port; 0 for any."""
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.bind(("127.0.0.1", port))
        return cls(sock, to, **options)

    @classmethod
    def tcp(cls, port: int) -> Peer:
        """A peer connected to a TCP port."""
        return cls(socket.create_connection(("127.0.0.1", port), PATIENCE_S))

    @property
    def port(self) -> int:
        """Its own port."""
        return int(self.socket.getsockname()[1])

    def __enter__(self) -> Peer:
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    def send(self, message: Any) -> None:
        """Send a message."""
        self.send_bytes(message.pack(self.mav))
        self.mav.seq = (self.mav.seq + 1) % 256

    def send_bytes(self, data: bytes) -> None:
        """Send bytes as they are."""
        if self.socket.type == socket.SOCK_STREAM:
            self.socket.sendall(data)
            return
        if self.to is None:
            self.wait(lambda m: True)
        assert self.to is not None
        self.socket.sendto(data, self.to)

    def hear(self, timeout_s: float) -> list[Any]:
        """Messages of the next datagram or piece of stream; empty if none comes in time."""
        self.socket.settimeout(max(timeout_s, 0.001))
        try:
            data, address = self.socket.recvfrom(65_535)
        except TimeoutError:
            return []
        if self.socket.type == socket.SOCK_DGRAM and self.to is None:
            self.to = address
        messages = self.parser.parse_buffer(data) or []
        self.heard += messages
        return messages

    def wait(self, wanted: Callable[[Any], bool], timeout_s: float = PATIENCE_S) -> Any:
        """The next message that is wanted."""
        deadline = time.monotonic() + timeout_s
        while (left := deadline - time.monotonic()) > 0.0:
            for message in self.hear(left):
                if wanted(message):
                    return message
        raise AssertionError(f"the message did not come within {timeout_s:g} s")

    def wait_for(self, kind: str, sysid: int | None = None, timeout_s: float = PATIENCE_S) -> Any:
        """The next message of a kind, from one system or from any."""
        return self.wait(lambda m: m.get_type() == kind and sysid in (None, m.get_srcSystem()), timeout_s)

    def command(self, sysid: int, command: int, *params: float) -> int:
        """Send a COMMAND_LONG once; return the result of its COMMAND_ACK."""
        padded = (*params, *(0.0,) * (7 - len(params)))
        self.send(mavlink.MAVLink_command_long_message(sysid, 1, command, 0, *padded))
        ack = self.wait(lambda m: m.get_type() == "COMMAND_ACK" and m.command == command and m.get_srcSystem() == sysid)
        return int(ack.result)

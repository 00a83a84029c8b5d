"""Two hosts on one machine: network namespaces joined by a wire in user space that loses and delays frames.

Needs the rights over an own network namespace, which `unshare --user --map-root-user --net` gives to anyone.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import heapq
import os
import random
import select
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import TracebackType

_CLONE_NEWNET = 0x40000000
_SIOCETHTOOL = 0x8946
_ETHTOOL_STXCSUM = 0x17
_ETH_P_ALL = 3
_libc = ctypes.CDLL(None, use_errno=True)


def _ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True)


class Host:
    """A network namespace with one interface on the wire, kept alive by a process that sleeps."""

    def __init__(self, name: str, address: str) -> None:
        self.name, self.address = name, address
        self._holder = subprocess.Popen(["unshare", "--net", "sleep", "infinity"])
        theirs = Path(f"/proc/{self._holder.pid}/ns/net")
        while theirs.readlink() == Path("/proc/self/ns/net").readlink():
            time.sleep(0.005)
        _ip("link", "add", f"wire-{name}", "type", "veth", "peer", "name", f"end-{name}")
        _ip("link", "set", f"end-{name}", "netns", str(self._holder.pid))
        _ip("link", "set", f"wire-{name}", "up")
        with self.inside():
            _ip("link", "set", "lo", "up")
            _without_checksum_offload(f"end-{name}")
            _ip("addr", "add", f"{address}/24", "dev", f"end-{name}")
            _ip("link", "set", f"end-{name}", "up")
            _ip("route", "add", "224.0.0.0/4", "dev", f"end-{name}")

    @contextlib.contextmanager
    def inside(self) -> Iterator[None]:
        """Let this thread, and what it starts meanwhile, live on the host."""
        own = os.open("/proc/self/ns/net", os.O_RDONLY)
        other = os.open(f"/proc/{self._holder.pid}/ns/net", os.O_RDONLY)
        try:
            _setns(other)
            yield
        finally:
            _setns(own)
            os.close(own)
            os.close(other)

    def close(self) -> None:
        """Give the namespace back."""
        self._holder.kill()
        self._holder.wait()


class Wire:
    """The wire between two hosts, as a process of its own; `broken` stops everything."""

    def __init__(self, hosts: Sequence[Host], loss: float, delay_s: float, seed: int = 0) -> None:
        interfaces = [f"wire-{host.name}" for host in hosts]
        self._process = subprocess.Popen([sys.executable, __file__, *interfaces, str(loss), str(delay_s), str(seed)])

    @contextlib.contextmanager
    def broken(self) -> Iterator[None]:
        """Cut the wire: what was on its way and what is sent meanwhile is lost."""
        self._process.send_signal(signal.SIGUSR1)
        try:
            yield
        finally:
            self._process.send_signal(signal.SIGUSR2)

    def __enter__(self) -> Wire:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self._process.terminate()
        self._process.wait()


def _setns(descriptor: int) -> None:
    if _libc.setns(descriptor, _CLONE_NEWNET) != 0:
        raise OSError(ctypes.get_errno(), "setns")


def _without_checksum_offload(interface: str) -> None:
    # A veth leaves checksums to hardware that is not there; frames carried by hand need them.
    value = ctypes.create_string_buffer(struct.pack("II", _ETHTOOL_STXCSUM, 0))
    request = struct.pack("16sP", interface.encode(), ctypes.addressof(value))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        fcntl.ioctl(sock, _SIOCETHTOOL, request)


def _carry(first: str, second: str, loss: float, delay_s: float, seed: int) -> None:
    """Carry frames between two interfaces until terminated."""
    rng = random.Random(seed)
    ends = []
    for interface in (first, second):
        end = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(_ETH_P_ALL))
        end.bind((interface, 0))
        end.setblocking(False)
        ends.append(end)
    whole = [True]
    signal.signal(signal.SIGUSR1, lambda *_: whole.__setitem__(0, False))
    signal.signal(signal.SIGUSR2, lambda *_: whole.__setitem__(0, True))
    under_way: list[tuple[float, int, socket.socket, bytes]] = []
    number = 0
    while True:
        wait = max(0.0, under_way[0][0] - time.monotonic()) if under_way else 1.0
        ready, _, _ = select.select(ends, [], [], wait)
        for end in ready:
            frame, (_, _, kind, *_) = end.recvfrom(70_000)
            if kind == socket.PACKET_OUTGOING:
                continue
            if whole[0] and rng.random() >= loss:
                number += 1
                other = ends[1] if end is ends[0] else ends[0]
                heapq.heappush(under_way, (time.monotonic() + delay_s, number, other, frame))
        while under_way and under_way[0][0] <= time.monotonic():
            _, _, end, frame = heapq.heappop(under_way)
            if whole[0]:
                end.send(frame)


if __name__ == "__main__":
    _carry(sys.argv[1], sys.argv[2], float(sys.argv[3]), float(sys.argv[4]), int(sys.argv[5]))

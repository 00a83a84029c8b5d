"""Plain sockets between a simulated vehicle and the bridge: what passes can be looked at, kept back or added to."""

from __future__ import annotations

import selectors
import socket
import threading
from contextlib import suppress

from typing_extensions import Self


class UdpWire:
    """Two UDP sockets that pass on what comes; a context manager.

    Parameters
    ----------
    vehicle_sends_to, bridge_listens_on : int
        Ports on loopback.
    """

    def __init__(self, vehicle_sends_to: int, bridge_listens_on: int) -> None:
        self._vehicle_end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._vehicle_end.bind(("127.0.0.1", vehicle_sends_to))
        self._bridge_end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._bridge_end.connect(("127.0.0.1", bridge_listens_on))
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._vehicle_end.close()
        self._bridge_end.close()

    def from_vehicle(self, data: bytes) -> bool:
        """Take note of a datagram; return whether it goes on to the bridge."""
        return True

    def from_bridge(self, data: bytes, heard: bool) -> bool:
        """Take note of a datagram; `heard`: the vehicle has spoken before. Return whether it goes on to it."""
        return True

    def _run(self) -> None:
        vehicle = None
        with selectors.DefaultSelector() as ready:
            for end in (self._vehicle_end, self._bridge_end):
                ready.register(end, selectors.EVENT_READ)
            while not self._stop.is_set():
                for key, _ in ready.select(0.1):
                    # The other side may not be there yet, or any more.
                    with suppress(ConnectionError):
                        if key.fileobj is self._vehicle_end:
                            data, vehicle = self._vehicle_end.recvfrom(2048)
                            if self.from_vehicle(data):
                                self._bridge_end.send(data)
                        else:
                            data = self._bridge_end.recv(2048)
                            if self.from_bridge(data, vehicle is not None) and vehicle is not None:
                                self._vehicle_end.sendto(data, vehicle)

"""Telemetry rates follow the measured load of a link with a budget, over a real socket.

Oracle: the intervals that the simulated vehicles were asked for, and the bytes counted at a plain socket.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace

import pytest
from fleet_rig import Rig, until
from mavlink_frames import frame_v2
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from sim_peer import Peer

from jpap_ros.fleet.config import LinkUrl
from jpap_ros.mavlink.streams import WANTED
from jpap_ros.sim import SimVehicle

POSITION, ATTITUDE = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, mavlink.MAVLINK_MSG_ID_ATTITUDE
BUDGET = 1300.0


@pytest.fixture
def rig(free_ports: Callable[[int], list[int]]) -> Iterator[Rig]:
    with ExitStack() as stack:
        yield Rig(stack, free_ports)


def rate_hz(vehicle: SimVehicle, message_id: int) -> float:
    with vehicle.lock:
        interval = vehicle.channels[0].interval(message_id)
    return 0.0 if interval is None else 1.0 / interval


class Stranger:
    """Somebody else on the link, whose messages nobody here reads."""

    def __init__(self, port: int, bytes_per_s: float) -> None:
        self._peer = Peer.udp(to=("127.0.0.1", port))
        # TUNNEL (385): target, payload type, length, 128 bytes that are not zero at the end.
        payload = bytes([0, 0, 0, 0, 128]) + b"\xff" * 128
        self._frame = frame_v2(385, 147, payload, sysid=1, component=100)
        self._pause_s = len(self._frame) / bytes_per_s
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Stranger:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._peer.socket.close()

    def _run(self) -> None:
        while not self._stop.wait(self._pause_s):
            self._peer.send_bytes(self._frame)


def test_rates_fall_under_load_and_rise_again(rig: Rig) -> None:
    two = rig.mixed(a={"autopilot": "ardupilot"}, p={"autopilot": "px4"})
    url = LinkUrl("udpin", "127.0.0.1", *rig.ports(1))
    fleet = replace(two, uavs=tuple(replace(uav, urls=(url,), max_bytes_per_s=BUDGET) for uav in two.uavs))
    sim = rig.fly(fleet)
    controller = rig.control(fleet)

    def load() -> float:
        (report,) = controller.link_reports
        return report.received_bytes_per_s + report.sent_bytes_per_s

    # Alone they fit, with less of what PX4 sends unasked than the 15 attitudes a second (600 byte/s) after its boot.
    wanted_hz = WANTED[POSITION].rate_hz
    until(lambda: all(rate_hz(v, POSITION) == pytest.approx(wanted_hz, rel=0.01) for v in sim), "all that is wanted")
    until(lambda: 0.0 < rate_hz(sim["p"], ATTITUDE) < 15.0, "less of what nobody asked for")

    with Stranger(url.port, 900.0):
        until(lambda: all(rate_hz(v, POSITION) < 0.8 * wanted_hz for v in sim), "less telemetry")
        assert rate_hz(sim["p"], ATTITUDE) == 0.0, "what nobody asked for went first"
        until(lambda: load() < 1.05 * BUDGET, "the load is within the budget, the stranger's included")
        assert load() > 900.0
        assert all(rate_hz(v, POSITION) >= 0.99 * WANTED[POSITION].min_rate_hz for v in sim)
    until(lambda: all(rate_hz(v, POSITION) == pytest.approx(wanted_hz, rel=0.1) for v in sim), "telemetry is back")
    until(lambda: rate_hz(sim["p"], ATTITUDE) > 0.0, "and what nobody asked for")


def test_a_budget_that_cannot_do_is_told_before_anybody_is_heard(rig: Rig) -> None:
    """Oracle: two targets (65 bytes) and two heartbeats (21 bytes) a second are 172 byte/s."""
    fleet = rig.mixed(a={"autopilot": "ardupilot", "max_bytes_per_s": 150.0})
    rig.control(fleet)
    told = rig.watch.until("a", lambda s: bool(s.problems))
    assert "carries 150 byte/s, too little" in told.problems[0] and "lower setpoint_rate_hz" in told.problems[0]

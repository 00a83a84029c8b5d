"""The whole bridge side (controller, links, parsers) against forged and fuzzed frames over real sockets.

Oracle: frames made without our own code (mavlink_frames), and what arrives at plain sockets that stand for vehicles. An
exception in the controller's thread fails the test, since pytest turns unhandled thread exceptions into errors.
"""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hostile_air import Attacker, attack, hostile_air
from mavlink_frames import command_long, frame_v2, heartbeat, signature_block
from pymavlink.dialects.v20 import ardupilotmega as dialect

from jpap_ros.fleet.config import FleetConfig, parse_fleet
from jpap_ros.mavlink.fleet_controller import ControllerSettings, FleetController
from jpap_ros.mavlink.snapshot import AircraftSnapshot

PATIENCE_S = 60.0
EPOCH_UNIX_S = 1_420_070_400
KEY, OTHER_KEY = bytes(range(32)), bytes(32)
FLEET = """
version: 1
origin: {{latitude: -37.8136, longitude: 144.9631, altitude_amsl_m: 20}}
{2}
uavs:
  - {{name: a, sysid: 1, url: "udpin:127.0.0.1:{0}", autopilot: ardupilot}}
  - {{name: b, sysid: 2, url: "udpin:127.0.0.1:{1}", autopilot: px4}}
"""


class Vehicle:
    """A plain socket that sends what it is told and keeps what it gets."""

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(("127.0.0.1", port))
        self._parser = dialect.MAVLink(None)

    def send(self, frame: bytes) -> None:
        self._socket.send(frame)

    def received(self) -> list[dialect.MAVLink_message]:
        """Messages that came since the last call."""
        messages = []
        while select.select([self._socket], [], [], 0.0)[0]:
            messages += self._parser.parse_buffer(self._socket.recv(1000)) or []
        return messages

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def snapshots() -> dict[str, AircraftSnapshot]:
    return {}


@pytest.fixture
def vehicles() -> Iterator[list[Vehicle]]:
    made: list[Vehicle] = []
    yield made
    for vehicle in made:
        vehicle.close()


def wait(condition: Callable[[], object], what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, f"waited in vain for {what}"
        time.sleep(0.02)


def start(fleet: FleetConfig, snapshots: dict[str, AircraftSnapshot], vehicles: list[Vehicle]) -> FleetController:
    vehicles += [Vehicle(uav.urls[0].port) for uav in fleet.uavs]
    return FleetController(fleet, ControllerSettings(), lambda s: snapshots.update({s.name: s}))


def test_fuzzed_frames_move_nobody_in_the_air(free_ports: Callable[[int], list[int]], tmp_path: Path) -> None:
    """6,000 hostile frames to aircraft that fly; a million are sent by `scripts/bench fuzz`."""
    with hostile_air(free_ports, tmp_path) as air:
        attack(air, 6000)


def test_forged_frames_are_counted_and_change_nothing(
    free_ports: Callable[[int], list[int]],
    snapshots: dict[str, AircraftSnapshot],
    vehicles: list[Vehicle],
    tmp_path: Path,
) -> None:
    (tmp_path / "fleet.key").write_text(KEY.hex())
    (tmp_path / "fleet.key").chmod(0o600)
    (port,) = free_ports(1)
    text = FLEET.format(*free_ports(2), f'signing_key_file: fleet.key\ngcs_urls: ["udpin:127.0.0.1:{port}"]')
    guided, loiter = 4, 5

    def now() -> int:
        return int((time.time() - EPOCH_UNIX_S) * 100_000)

    with start(parse_fleet(text, folder=tmp_path), snapshots, vehicles) as controller:
        vehicle, station, stranger = vehicles[0], Vehicle(port), Vehicle(parse_fleet(text).uavs[0].urls[0].port)
        vehicles += [station, stranger]
        genuine = heartbeat(1, custom_mode=guided, key=KEY, timestamp=now())
        vehicle.send(genuine)
        wait(lambda: "a" in snapshots and snapshots["a"].mode == "GUIDED", "the signed heartbeat")
        vehicle.received()
        # A takeover that no pilot made: unsigned, with another key, replayed; from the vehicle's address and from
        # another one; and an order from a ground station without the key.
        forged = [
            heartbeat(1, custom_mode=loiter),
            heartbeat(1, custom_mode=loiter, key=OTHER_KEY, timestamp=now() + 10_000_000),
            heartbeat(1, custom_mode=loiter, key=KEY, timestamp=1000),
            genuine,
        ]
        for frame in forged:
            vehicle.send(frame)
            stranger.send(frame)
        order = command_long(255, 190, (1, 1), dialect.MAV_CMD_NAV_LAND)
        unsigned_bit = frame_v2(76, 152, order[10:-2], 255, 190, 0, flags=1)
        station.send(order)
        station.send(unsigned_bit + signature_block(unsigned_bit, OTHER_KEY, 0, now()))

        def refused(link: int) -> tuple[int, int, int]:
            report = controller.link_reports[link]
            return report.unsigned, report.badly_signed, report.replayed

        wait(lambda: refused(0) == (2, 2, 4), "the count of the frames to vehicle a's link")
        report = controller.link_reports[0]
        assert report.peers == 1, "the stranger's address is not sent to"
        wait(lambda: refused(-1) == (1, 1, 0), "the count of the station's frames")
        assert snapshots["a"].mode == "GUIDED"
        assert station.received() == stranger.received() == []
        for message in vehicle.received():
            assert message.get_msgbuf()[2] & 1, "everything to the vehicle is signed"
            assert message.get_srcSystem() != 255, "and nothing comes from the station"
        # The vehicle itself is still heard.
        vehicle.send(heartbeat(1, custom_mode=loiter, key=KEY, timestamp=now()))
        wait(lambda: snapshots["a"].mode == "LOITER", "the vehicle's own word")


def test_the_fuzz_would_be_seen_to_work() -> None:
    """By pymavlink: the messages are decoded, and it refuses every damaged frame."""
    attacker, parser = Attacker(7), dialect.MAVLink(None)
    parser.robust_parsing = True
    for _ in range(300):
        (message,) = dialect.MAVLink(None).parse_buffer(attacker.any_message(1, 1))
        assert message.get_srcSystem() == 1 and message.get_type() != "BAD_DATA"
        damaged = attacker.damaged(heartbeat(1))
        assert {m.get_type() for m in parser.parse_buffer(damaged) or ()} <= {"BAD_DATA"}

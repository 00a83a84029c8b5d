"""Forwarding between ground stations and vehicles, over real UDP sockets.

Oracle: the rules of https://mavlink.io/en/guide/routing.html, restated case by case as who must receive a frame; frames
come from mavlink_frames and must arrive byte for byte.
"""

from __future__ import annotations

import select
import socket
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest
from mavlink_frames import command_long, frame_v2, heartbeat, signature_block
from pymavlink.dialects.v20 import ardupilotmega as dialect

from jpap_ros.fleet.config import LinkUrl
from jpap_ros.mavlink.links import Link, LinkHub, LinkOptions
from jpap_ros.mavlink.routing import Forwarder, target_of
from jpap_ros.mavlink.signing import Signer, SigningKey

OWN = (245, 191)
KEY, OTHER_KEY = bytes(range(32)), bytes(32)
QGC, MAVPROXY = (255, 190), (254, 230)
FLEET = (1, 2)


class Node:
    """A plain UDP socket in the place of a vehicle or a ground station."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(10.0)
        self.to: tuple[str, int] = ("", 0)

    @property
    def url(self) -> LinkUrl:
        return LinkUrl("udpout", *self.socket.getsockname())

    def send(self, frame: bytes) -> None:
        self.socket.sendto(frame, self.to)

    def waiting(self) -> Iterator[bytes]:
        """All frames that have arrived."""
        while select.select([self.socket], [], [], 0.0)[0]:
            yield self.socket.recv(1000)


class Network:
    """A hub and forwarder with nodes round it."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.hub = LinkHub(*OWN, clock=lambda: self.now)
        self.nodes: list[Node] = []
        self.forwarder: Forwarder | None = None

    def node(self, options: LinkOptions = LinkOptions()) -> tuple[Node, Link]:  # noqa: B008
        """A node on a link of its own."""
        node = Node()
        self.nodes.append(node)
        link = self.hub.open(node.url, options)
        node.to = link.local_address
        return node, link

    def guest(self, link: Link) -> Node:
        """A node that sends to a link that listens."""
        node = Node()
        self.nodes.append(node)
        node.to = link.local_address
        return node

    def says(self, node: Node, *frames: bytes) -> dict[int, list[bytes]]:
        """Let a node send frames; what each node received in consequence, by the node's number."""
        for frame in frames:
            node.send(frame)
            seen = sum(link.statistics.received.messages + refused(link) for link in self.hub.links)
            while sum(link.statistics.received.messages + refused(link) for link in self.hub.links) == seen:
                for packet in self.hub.poll(10.0):
                    self.forwarder.on_packet(packet)
        # Loopback delivers before sendto returns, so what is not there now does not come.
        return {i: frames for i, other in enumerate(self.nodes) if (frames := list(other.waiting()))}

    def close(self) -> None:
        self.hub.close()
        for node in self.nodes:
            node.socket.close()


def refused(link: Link) -> int:
    return sum(link.statistics.refused.values())


@pytest.fixture
def network() -> Iterator[Network]:
    network = Network()
    yield network
    network.close()


class TestRules:
    """Nodes: vehicles 0 and 1 with sysids 1 and 2, ground stations 2 (QGroundControl) and 3 (MAVProxy)."""

    @pytest.fixture
    def four(self, network: Network) -> Network:
        pairs = [network.node() for _ in range(4)]
        network.forwarder = Forwarder(network.hub, OWN, [link for _, link in pairs[2:]], FLEET)
        for i, source in enumerate([(1, 1), (2, 1), QGC, MAVPROXY]):
            network.says(network.nodes[i], heartbeat(*source))
        return network

    def test_a_vehicles_broadcast_goes_to_ground_stations_only(self, four: Network) -> None:
        frame = heartbeat(1, sequence=1)
        assert four.says(four.nodes[0], frame) == {2: [frame], 3: [frame]}

    def test_a_stations_broadcast_goes_to_all_others(self, four: Network) -> None:
        frame = heartbeat(*QGC, sequence=1)
        assert four.says(four.nodes[2], frame) == {0: [frame], 1: [frame], 3: [frame]}

    @pytest.mark.parametrize("target", [(2, 1), (2, 0)])
    def test_a_command_goes_to_its_vehicle_only(self, four: Network, target: tuple[int, int]) -> None:
        frame = command_long(*QGC, target, 400)
        assert four.says(four.nodes[2], frame) == {1: [frame]}

    def test_an_answer_goes_to_the_station_that_asked(self, four: Network) -> None:
        # COMMAND_ACK: command, result, and as extensions progress, result_param2, target_system, target_component.
        frame = frame_v2(77, 143, struct.pack("<HBBiBB", 400, 0, 0, 0, *QGC), 2, 1)
        assert four.says(four.nodes[1], frame) == {2: [frame]}

    @pytest.mark.parametrize("target", [(9, 1), (2, 77)])
    def test_nothing_goes_to_a_target_never_heard(self, four: Network, target: tuple[int, int]) -> None:
        assert four.says(four.nodes[2], command_long(*QGC, target, 400)) == {}
        assert four.forwarder.unroutable == 1

    def test_nothing_goes_back_to_where_it_came_from(self, four: Network) -> None:
        # The station's own system is the target: it lies behind the link the frame came from.
        assert four.says(four.nodes[2], command_long(*QGC, QGC, 400)) == {}

    @pytest.mark.parametrize("target", [OWN, (OWN[0], 0)])
    def test_what_is_for_the_bridge_stays_there(self, four: Network, target: tuple[int, int]) -> None:
        assert four.says(four.nodes[2], command_long(*QGC, target, 400)) == {}
        assert four.forwarder.unroutable == 0

    def test_a_component_behind_a_vehicle_is_reached(self, four: Network) -> None:
        four.says(four.nodes[0], heartbeat(1, 154))
        gimbal, system = command_long(*QGC, (1, 154), 1000), command_long(*QGC, (1, 0), 1000)
        assert four.says(four.nodes[2], gimbal, system) == {0: [gimbal, system]}

    def test_a_key_is_never_forwarded(self, four: Network) -> None:
        # SETUP_SIGNING: initial_timestamp, target_system, target_component, secret_key.
        payload = struct.pack("<QBB32s", 1, 1, 1, KEY)
        frame = frame_v2(256, dialect.MAVLink_setup_signing_message.crc_extra, payload, *QGC)
        assert four.says(four.nodes[2], frame) == {}

    def test_messages_that_the_dialect_lacks_pass(self, four: Network) -> None:
        frame = frame_v2(60_000, 9, b"something new", 1, 1)
        assert four.says(four.nodes[0], frame) == {2: [frame], 3: [frame]}

    @pytest.mark.parametrize("source", [(1, 1), (1, 191), QGC])
    def test_nothing_goes_from_vehicle_to_vehicle(self, four: Network, source: tuple[int, int]) -> None:
        assert four.says(four.nodes[0], command_long(*source, (2, 1), 400), command_long(*source, (2, 0), 400)) == {}

    def test_a_loop_is_cut(self, four: Network) -> None:
        # A ground station with a link of its own to vehicle 1 passes that vehicle's frames on to us as well.
        assert four.says(four.nodes[2], heartbeat(1, sequence=1)) == {}
        assert four.says(four.nodes[2], heartbeat(*OWN)) == {}
        assert four.forwarder.looped == 2
        # And has not become the way to that vehicle.
        frame = command_long(*MAVPROXY, (1, 1), 400)
        assert four.says(four.nodes[3], frame) == {0: [frame]}

    def test_a_stations_echo_from_a_vehicle_shuts_nobody_out(self, four: Network) -> None:
        # An autopilot passes broadcasts on from one port to the others: vehicle 2 returns what QGroundControl says.
        echo, land = heartbeat(*QGC, sequence=1), command_long(*QGC, (1, 1), dialect.MAV_CMD_NAV_LAND)
        assert four.says(four.nodes[1], echo) == {}
        assert four.forwarder.looped == 1
        assert four.says(four.nodes[2], land) == {0: [land]}
        # And has not become the way to that station.
        answer = frame_v2(77, 143, struct.pack("<HBBiBB", 21, 0, 0, 0, *QGC), 1, 1)
        assert four.says(four.nodes[0], answer) == {2: [answer]}
        # Nor does an echo that is all that is left of a station stay in its way.
        four.now += 61.0
        four.says(four.nodes[1], echo)
        four.says(four.nodes[0], heartbeat(1, sequence=1))
        assert four.says(four.nodes[2], land) == {0: [land]}

    def test_a_vehicle_heard_by_way_of_a_station_first_is_heard_itself(self, network: Network) -> None:
        # The station has a link of its own to vehicle 1, and ours comes up later.
        (vehicle, _), (station, link) = network.node(), network.node()
        network.forwarder = Forwarder(network.hub, OWN, [link], FLEET)
        network.says(station, heartbeat(*QGC), heartbeat(1))
        own = heartbeat(1, sequence=1)
        assert network.says(vehicle, own) == {1: [own]}
        assert network.says(station, heartbeat(1, sequence=2)) == {}
        assert network.forwarder.looped == 1
        command = command_long(*QGC, (1, 1), 400)
        assert network.says(station, command) == {0: [command]}

    def test_joystick_frames_go_to_the_vehicle_they_name(self, four: Network) -> None:
        # MANUAL_CONTROL names its target in a field called target, not target_system.
        payload = struct.pack("<hhhhHB", 0, 0, 500, 0, 0, 2)
        frame = frame_v2(69, dialect.MAVLink_manual_control_message.crc_extra, payload, *QGC)
        assert four.says(four.nodes[2], frame) == {1: [frame]}


def test_two_stations_on_one_listening_link_hear_each_other_and_the_vehicle(network: Network) -> None:
    vehicle, _ = network.node()
    probe = Node()
    port = probe.socket.getsockname()[1]
    probe.socket.close()
    listening = network.hub.open(LinkUrl("udpin", "127.0.0.1", port))
    network.forwarder = Forwarder(network.hub, OWN, [listening], FLEET)
    first, second = network.guest(listening), network.guest(listening)
    network.says(first, heartbeat(*QGC))
    network.says(vehicle, heartbeat(1))
    frame = heartbeat(*MAVPROXY)
    assert network.says(second, frame) == {0: [frame], 1: [frame]}
    frame = heartbeat(1, sequence=1)
    assert network.says(vehicle, frame) == {1: [frame], 2: [frame]}


def test_a_vehicle_with_two_links_is_sent_everything_once(network: Network) -> None:
    wifi, _ = network.node()
    radio, _ = network.node()
    station, link = network.node()
    network.forwarder = Forwarder(network.hub, OWN, [link], FLEET)
    network.says(station, heartbeat(*QGC))
    network.says(wifi, heartbeat(1))
    # The same broadcast comes by both links; the station gets it once.
    frame = heartbeat(1, sequence=1)
    assert network.says(wifi, frame) == {2: [frame]}
    assert network.says(radio, frame) == {}
    command = command_long(*QGC, (1, 1), 400)
    assert network.says(station, command) == {0: [command]}
    # The first link falls silent, and the second takes over.
    network.now += 4.0
    assert network.says(radio, frame) == {2: [frame]}
    assert network.says(station, command) == {1: [command]}


class TestSigned:
    """Nodes: vehicle 0 with a key, vehicle 1 without, station 2 with that key, 3 without, 4 with another."""

    @pytest.fixture
    def five(self, network: Network, tmp_path: Path) -> Network:
        signers = [
            Signer(SigningKey(key), tmp_path / f"state{i}", clock=lambda: 1_420_070_400.0)
            for i, key in enumerate((KEY, OTHER_KEY))
        ]
        options = [LinkOptions(signer=s) for s in (signers[0], None, signers[0], None, signers[1])]
        links = [network.node(option)[1] for option in options]
        network.forwarder = Forwarder(network.hub, OWN, links[2:], FLEET)
        for i, (sysid, key) in enumerate([(1, KEY), (2, None), (255, KEY), (254, None), (253, OTHER_KEY)]):
            network.says(network.nodes[i], heartbeat(sysid, 190 if sysid > 250 else 1, key=key, timestamp=1))
        return network

    @staticmethod
    def signed(frame: bytes, key: bytes, timestamp: int) -> bytes:
        """The same COMMAND_LONG, signed."""
        payload = frame[10:-2]
        unsigned = frame_v2(76, 152, payload, frame[5], frame[6], frame[4], flags=1)
        return unsigned + signature_block(unsigned, key, 0, timestamp)

    def test_the_right_key_commands_and_is_passed_on_unchanged(self, five: Network) -> None:
        frame = self.signed(command_long(255, 190, (1, 1), 400), KEY, 5)
        assert five.says(five.nodes[2], frame) == {0: [frame]}

    def test_no_key_and_a_wrong_key_command_no_signed_vehicle(self, five: Network) -> None:
        before = five.forwarder.refused_for_signing
        assert five.says(five.nodes[3], command_long(254, 190, (1, 1), 400)) == {}
        wrong = self.signed(command_long(253, 190, (1, 1), 400), OTHER_KEY, 5)
        assert five.says(five.nodes[4], wrong) == {}
        assert five.forwarder.refused_for_signing == before + 2
        forged = self.signed(command_long(255, 190, (1, 1), 400), OTHER_KEY, 5)
        assert five.says(five.nodes[2], forged) == {}
        assert refused(five.hub.links[2]) == 1

    def test_an_unsigned_radio_report_leads_nobody_astray(self, five: Network) -> None:
        # RADIO_STATUS in the name of a vehicle that is not there.
        radio = frame_v2(109, dialect.MAVLink_radio_status_message.crc_extra, bytes([1] * 9), 9, 1)
        five.says(five.nodes[0], radio)
        assert five.says(five.nodes[2], self.signed(command_long(255, 190, (9, 1), 400), KEY, 5)) == {}
        assert five.forwarder.unroutable == 1

    def test_an_unsigned_vehicle_is_commanded_by_all(self, five: Network) -> None:
        for node, frame in [
            (2, self.signed(command_long(255, 190, (2, 1), 400), KEY, 6)),
            (3, command_long(254, 190, (2, 1), 400)),
        ]:
            assert five.says(five.nodes[node], frame) == {1: [frame]}


@pytest.mark.parametrize(
    ("message", "target"),
    [
        (dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), (0, 0)),
        (dialect.MAVLink_set_mode_message(7, 1, 4), (7, 0)),
        (dialect.MAVLink_param_request_list_message(7, 1), (7, 1)),
        (dialect.MAVLink_unknown(60_000, b"x"), (0, 0)),
    ],
)
def test_targets(message: dialect.MAVLink_message, target: tuple[int, int]) -> None:
    assert target_of(message) == target

"""Links over real loopback sockets and a pseudo-terminal; frames from mavlink_frames, not from our own sender."""

from __future__ import annotations

import os
import random
import socket
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from mavlink_frames import command_long, heartbeat
from pymavlink.dialects.v20 import ardupilotmega as dialect

from jpap_ros.fleet.config import LinkUrl
from jpap_ros.mavlink.link_report import LinkReport
from jpap_ros.mavlink.links import Link, LinkHub, LinkOptions, Packet

BEAT = dialect.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
QUICK = LinkOptions(first_retry_s=0.02, max_retry_s=0.1)
DEADLINE_S = 20.0


@pytest.fixture
def hub() -> Iterator[LinkHub]:
    with LinkHub(245) as hub:
        yield hub


@pytest.fixture
def vehicle() -> Iterator[socket.socket]:
    """A plain UDP socket in the place of a vehicle."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(DEADLINE_S)
        yield sock


def until(hub: LinkHub, condition: Callable[[], object]) -> list[Packet]:
    """Poll until a condition holds; all packets that came meanwhile."""
    packets = []
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline, "gave up waiting"
        packets += hub.poll(0.05)
    return packets


def receive(hub: LinkHub, count: int) -> list[Packet]:
    """Poll until `count` packets came."""
    packets: list[Packet] = []
    deadline = time.monotonic() + DEADLINE_S
    while len(packets) < count:
        assert time.monotonic() < deadline, f"only {len(packets)} of {count} packets came"
        packets += hub.poll(0.05)
    return packets


def listen(hub: LinkHub, options: LinkOptions = QUICK) -> tuple[Link, tuple[str, int]]:
    """A udpin link on a free port, and its address."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    return hub.open(LinkUrl("udpin", "127.0.0.1", port), options), ("127.0.0.1", port)


def fill(hub: LinkHub, link: Link) -> None:
    """Forward commands until one is dropped."""
    while hub.forward(link, command_long(255, 190, (1, 1), 22)):
        pass


def sources(packets: list[Packet]) -> list[tuple[int, int]]:
    return [(packet.message.get_srcSystem(), packet.message.get_seq()) for packet in packets]


class TestUdp:
    def test_a_listener_answers_where_a_vehicle_sent_from(self, hub: LinkHub, vehicle: socket.socket) -> None:
        link, address = listen(hub)
        assert not hub.send(link, BEAT), "nobody is there yet"
        vehicle.sendto(heartbeat(7, sequence=3), address)
        (packet,) = receive(hub, 1)
        assert packet.link is link
        assert packet.peer.address[:2] == vehicle.getsockname()
        assert sources([packet]) == [(7, 3)]
        assert bytes(packet.message.get_msgbuf()) == heartbeat(7, sequence=3)
        assert hub.send(link, BEAT, packet.peer)
        assert vehicle.recv(1000)[5:7] == bytes([245, 191])

    def test_each_remote_end_has_sequence_numbers_without_gaps(self, hub: LinkHub) -> None:
        link, address = listen(hub)
        vehicles = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(3)]
        try:
            for i, sock in enumerate(vehicles):
                sock.settimeout(DEADLINE_S)
                sock.sendto(heartbeat(i + 1), address)
            peers = {p.message.get_srcSystem(): p.peer for p in receive(hub, 3)}
            for _ in range(3):
                assert hub.send(link, BEAT, peers[2])
            assert hub.send(link, BEAT)
            assert [vehicles[1].recv(1000)[4] for _ in range(4)] == [0, 1, 2, 3]
            assert vehicles[0].recv(1000)[4] == vehicles[2].recv(1000)[4] == 0
        finally:
            for sock in vehicles:
                sock.close()

    def test_a_port_in_use_is_a_clear_error(self, hub: LinkHub, vehicle: socket.socket) -> None:
        port = vehicle.getsockname()[1]
        with pytest.raises(OSError, match=rf"udpin:127\.0\.0\.1:{port}: cannot listen: Address already in use"):
            hub.open(LinkUrl("udpin", "127.0.0.1", port))
        with pytest.raises(OSError, match=r"udpin:no\.such\.host\.invalid:14550: cannot listen"):
            hub.open(LinkUrl("udpin", "no.such.host.invalid", 14550))

    def test_a_sender_is_heard_only_from_its_address(self, hub: LinkHub, vehicle: socket.socket) -> None:
        link = hub.open(LinkUrl("udpout", "127.0.0.1", vehicle.getsockname()[1]))
        assert hub.send(link, BEAT)
        _, ours = vehicle.recvfrom(1000)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.sendto(heartbeat(66), ours)
        vehicle.sendto(heartbeat(7), ours)
        assert sources(receive(hub, 1)) == [(7, 0)]

    def test_a_host_name_is_looked_up_without_blocking(self, hub: LinkHub, vehicle: socket.socket) -> None:
        link = hub.open(LinkUrl("udpout", "localhost", vehicle.getsockname()[1]))
        until(hub, lambda: link.up)
        assert hub.send(link, BEAT)
        assert len(vehicle.recv(1000)) == 21

    def test_sending_to_a_vehicle_that_is_not_there_yet(self, hub: LinkHub, vehicle: socket.socket) -> None:
        address = vehicle.getsockname()
        vehicle.close()
        link = hub.open(LinkUrl("udpout", *address))
        for _ in range(5):
            hub.send(link, BEAT)
            hub.poll(0.01)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as late:
            late.bind(address)
            late.settimeout(DEADLINE_S)
            assert hub.send(link, BEAT)
            data, ours = late.recvfrom(1000)
            assert len(data) == 21
            late.sendto(heartbeat(7), ours)
            assert sources(receive(hub, 1)) == [(7, 0)]

    def test_noise_from_many_addresses_does_not_keep_a_vehicle_out(self, hub: LinkHub, vehicle: socket.socket) -> None:
        link, address = listen(hub, LinkOptions(max_peers=4))
        vehicle.sendto(heartbeat(7), address)
        receive(hub, 1)
        strangers = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(10)]
        try:
            for sock in strangers:
                sock.sendto(b"noise", address)
            until(hub, lambda: link.statistics.skipped_bytes == 50)
            assert [str(peer.address[1]) for peer in link.peers] == [str(vehicle.getsockname()[1])]
            strangers[0].sendto(heartbeat(8), address)
            assert sources(receive(hub, 1)) == [(8, 0)]
            assert len(link.peers) == 2
        finally:
            for sock in strangers:
                sock.close()

    def test_no_more_remote_ends_than_allowed(self, hub: LinkHub) -> None:
        link, address = listen(hub, LinkOptions(max_peers=2))
        vehicles = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(4)]
        try:
            for i, sock in enumerate(vehicles):
                sock.sendto(heartbeat(i + 1), address)
            until(hub, lambda: link.refused_datagrams == 2)
            assert len(link.peers) == 2
        finally:
            for sock in vehicles:
                sock.close()

    def test_silent_remote_ends_are_forgotten(self, vehicle: socket.socket) -> None:
        now = [1000.0]
        with LinkHub(245, clock=lambda: now[0]) as hub:
            link, address = listen(hub, LinkOptions(forget_peer_s=60.0))
            vehicle.sendto(heartbeat(7), address)
            receive(hub, 1)
            now[0] += 59.0
            hub.poll(0.0)
            assert len(link.peers) == 1
            now[0] += 20.0
            hub.poll(0.0)
            assert link.peers == ()
            vehicle.sendto(heartbeat(7), address)
            assert sources(receive(hub, 1)) == [(7, 0)]

    def test_two_hundred_vehicles_that_speak_at_once(self, hub: LinkHub) -> None:
        link, address = listen(hub)
        vehicles = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(200)]
        try:
            for i, sock in enumerate(vehicles):
                sock.sendto(heartbeat(i + 1) + heartbeat(i + 1, sequence=1), address)
            packets = receive(hub, 400)
        finally:
            for sock in vehicles:
                sock.close()
        assert sorted(sources(packets)) == sorted((i + 1, s) for i in range(200) for s in (0, 1))
        assert len({packet.peer for packet in packets}) == len(link.peers) == 200


class TestTcp:
    @staticmethod
    def server(port: int = 0) -> socket.socket:
        sock = socket.create_server(("127.0.0.1", port))
        sock.settimeout(DEADLINE_S)
        return sock

    def test_late_start_close_and_reconnect(self, hub: LinkHub, free_ports: Callable[[int], list[int]]) -> None:
        (port,) = free_ports(1)
        link = hub.open(LinkUrl("tcp", "127.0.0.1", port), QUICK)
        until(hub, lambda: "refused" in link.problem)
        assert not link.up
        assert not hub.send(link, BEAT)
        with self.server(port) as server:
            until(hub, lambda: link.up)
            assert link.problem == ""
            assert link.reconnects == 0
            first, _ = server.accept()
            # Half a frame is left behind when the connection breaks, and must not spoil the next one.
            first.sendall(heartbeat(1)[:9])
            first.close()
            until(hub, lambda: link.reconnects == 1)
            second, _ = server.accept()
            with second:
                second.sendall(heartbeat(2))
                assert sources(receive(hub, 1)) == [(2, 0)]
                assert hub.send(link, BEAT)
                second.settimeout(DEADLINE_S)
                assert second.recv(1000)[5:7] == bytes([245, 191])
                assert link.statistics.skipped_bytes == 0

    def test_bytes_that_come_one_at_a_time(self, hub: LinkHub) -> None:
        with self.server() as server:
            link = hub.open(LinkUrl("tcp", *server.getsockname()), QUICK)
            until(hub, lambda: link.up)
            connection, _ = server.accept()
            with connection:
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                packets = []
                for byte in b"".join(heartbeat(5, sequence=i) for i in range(10)):
                    connection.send(bytes([byte]))
                    packets += hub.poll(0.01)
                packets += receive(hub, 10 - len(packets))
                assert sources(packets) == [(5, i) for i in range(10)]

    def test_a_reader_that_stalls_gets_whole_frames_only(self, hub: LinkHub) -> None:
        with self.server() as server:
            link = hub.open(LinkUrl("tcp", *server.getsockname()), QUICK)
            until(hub, lambda: link.up)
            connection, _ = server.accept()
            with connection:
                frame = command_long(255, 190, (1, 1), 400)
                accepted = 0
                while hub.forward(link, frame):
                    accepted += 1
                    assert accepted < 100_000, "nothing is ever dropped"
                # Now it reads again: what was accepted arrives complete and in order, and nothing else.
                received = bytearray()
                connection.settimeout(0.2)
                deadline = time.monotonic() + DEADLINE_S
                while len(received) < accepted * len(frame):
                    assert time.monotonic() < deadline
                    hub.poll(0.0)
                    try:
                        received += connection.recv(1 << 20)
                    except TimeoutError:
                        continue
                assert received == frame * accepted
                assert hub.forward(link, frame)

    def test_what_is_not_taken_in_time_is_never_delivered(self, hub: LinkHub) -> None:
        with self.server() as server:
            link = hub.open(
                LinkUrl("tcp", *server.getsockname()),
                LinkOptions(unanswered_s=0.5, first_retry_s=0.02, max_retry_s=0.1),
            )
            until(hub, lambda: link.up)
            stalled, _ = server.accept()
            with stalled:
                # A pause of the kernel can make the link look full; it is when nothing is taken for half a second.
                until(hub, lambda: link.reconnects == 1 or fill(hub, link))
                fresh, _ = server.accept()
                with fresh:
                    assert hub.send(link, BEAT)
                    fresh.settimeout(DEADLINE_S)
                    assert fresh.recv(1000)[7:10] == b"\0\0\0", "a heartbeat, and no command of before"

    def test_a_host_that_does_not_answer_is_given_up_and_tried_again(self) -> None:
        # A listener whose backlog is full leaves further connections waiting, as a host behind a dead radio does.
        now = [0.0]
        with LinkHub(245, clock=lambda: now[0]) as hub, socket.socket() as server:
            server.bind(("127.0.0.1", 0))
            server.listen(0)
            fillers = []
            for _ in range(4):
                filler = socket.socket()
                filler.setblocking(False)
                filler.connect_ex(server.getsockname())
                fillers.append(filler)
            link = hub.open(LinkUrl("tcp", *server.getsockname()), LinkOptions(connect_timeout_s=5.0))
            hub.poll(0.0)
            assert not link.up
            now[0] = 5.1
            hub.poll(0.0)
            assert link.problem == "connecting timed out"
            for filler in fillers:
                filler.close()


class TestSerial:
    @staticmethod
    def terminal() -> tuple[int, str]:
        master, slave = os.openpty()
        tty.setraw(slave)
        name = os.ttyname(slave)
        os.close(slave)
        return master, name

    def test_plugged_in_late_unplugged_and_plugged_in_again(self, hub: LinkHub, tmp_path: Path) -> None:
        device = tmp_path / "ttyRadio"
        link = hub.open(LinkUrl("serial", str(device), 57600), QUICK)
        until(hub, lambda: "No such file" in link.problem)
        for attempt in range(2):
            master, name = self.terminal()
            device.symlink_to(name)
            until(hub, lambda: link.up)
            os.write(master, heartbeat(9, sequence=attempt))
            assert sources(receive(hub, 1)) == [(9, attempt)]
            assert hub.send(link, BEAT)
            # Whatever the first connection did, the sequence goes on.
            assert os.read(master, 1000)[4] == attempt
            device.unlink()
            os.close(master)
            until(hub, lambda: not link.up)
        assert link.reconnects == 1

    def test_many_vehicles_behind_one_radio(self, hub: LinkHub) -> None:
        master, name = self.terminal()
        link = hub.open(LinkUrl("serial", name, 57600), QUICK)
        until(hub, lambda: link.up)
        for start in range(0, 60, 10):
            os.write(master, b"".join(heartbeat(i + 1) for i in range(start, start + 10)))
            hub_packets = receive(hub, 10)
            assert sources(hub_packets) == [(i + 1, 0) for i in range(start, start + 10)]
        assert len(link.peers) == 1
        assert len(link.statistics.sources) == 60
        os.close(master)


class TestHub:
    def test_waking_ends_a_wait_from_another_thread(self, hub: LinkHub) -> None:
        timer = threading.Timer(0.1, hub.wake)
        timer.start()
        start = time.monotonic()
        assert hub.poll(DEADLINE_S) == []
        assert time.monotonic() - start < DEADLINE_S / 2
        timer.join()

    def test_wakes_never_block_and_are_harmless_after_close(self) -> None:
        hub = LinkHub(245)
        for _ in range(100_000):
            hub.wake()
        assert hub.poll(DEADLINE_S) == []
        hub.close()
        hub.wake()

    def test_rates_and_losses_are_counted(self, vehicle: socket.socket) -> None:
        now = [1000.0]
        with LinkHub(245, clock=lambda: now[0]) as hub:
            link, address = listen(hub)
            # Ten messages a second for five seconds; of each ten, the fourth and fifth are lost, the last two are
            # swapped, and one is doubled.
            sequence = 250
            for _ in range(5):
                order = [0, 1, 2, 5, 5, 6, 7, 9, 8]
                for step in order:
                    vehicle.sendto(heartbeat(7, sequence=(sequence + step) % 256), address)
                sequence += 10
                receive(hub, len(order))
                now[0] += 1.0
            source = link.statistics.sources[7, 1]
            assert source.lost == 10
            assert source.duplicates == 5
            assert source.loss == pytest.approx(10 / 50)
            assert link.statistics.loss == pytest.approx(10 / 50)
            assert source.traffic.messages == 45
            assert link.statistics.received.rates(now[0]) == pytest.approx((9.0, 9.0 * 21))
            hub.send(link, BEAT)
            assert link.statistics.sent.messages == 1
            assert link.statistics.sent.bytes == 21
            assert link.statistics.received.rates(now[0] + 60.0) == (0.0, 0.0)

    def test_a_report_says_how_a_link_is_doing(self, vehicle: socket.socket) -> None:
        now = [1000.0]
        with LinkHub(245, clock=lambda: now[0]) as hub:
            link, address = listen(hub, LinkOptions(max_bytes_per_s=4000.0))
            for sequence in (0, 1, 3):
                vehicle.sendto(heartbeat(7, sequence=sequence) + b"??", address)
            receive(hub, 3)
            hub.send(link, BEAT)
            now[0] += 1.0
            report = LinkReport.of(link, now[0])
            assert (report.up, report.problem, report.signed, report.peers) == (True, "", False, 1)
            # Three heartbeats of 21 bytes came within the last five seconds, and one went out.
            assert report.received_per_s == pytest.approx(3 / 5)
            assert report.received_bytes_per_s == pytest.approx(63 / 5)
            assert report.sent_bytes_per_s == pytest.approx(21 / 5)
            assert report.loss == 0.0, "no ten seconds have passed"
            assert report.source_loss == ((7, 1, pytest.approx(1 / 4)),)
            assert report.skipped_bytes == 6
            assert report.max_bytes_per_s == 4000.0
            # Of the four messages after the first up to the tenth second one is lost (2), and then none.
            for seconds, sequence, loss in ((9.0, 4, 1 / 4), (9.0, 5, 1 / 4), (1.0, 6, 0.0)):
                now[0] += seconds
                vehicle.sendto(heartbeat(7, sequence=sequence), address)
                receive(hub, 1)
                assert LinkReport.of(link, now[0]).loss == pytest.approx(loss)

    def test_a_gap_over_an_outage_is_not_called_loss(self, vehicle: socket.socket) -> None:
        now = [1000.0]
        with LinkHub(245, clock=lambda: now[0]) as hub:
            link, address = listen(hub)
            vehicle.sendto(heartbeat(7, sequence=10), address)
            receive(hub, 1)
            now[0] += 6.0
            vehicle.sendto(heartbeat(7, sequence=100), address)
            receive(hub, 1)
            assert link.statistics.loss == 0.0

    def test_forwarded_frames_keep_within_the_byte_budget_and_urgent_ones_do_not_wait(
        self, vehicle: socket.socket
    ) -> None:
        now = [1000.0]
        frame = heartbeat(255)
        with LinkHub(245, clock=lambda: now[0]) as hub:
            link = hub.open(
                LinkUrl("udpout", "127.0.0.1", vehicle.getsockname()[1]), LinkOptions(max_bytes_per_s=210.0)
            )
            # A burst of one second, 10 frames of 21 bytes; then half a second's worth.
            assert [hub.forward(link, frame) for _ in range(12)] == [True] * 10 + [False] * 2
            now[0] += 0.5
            assert [hub.forward(link, frame) for _ in range(6)] == [True] * 5 + [False]
            assert link.statistics.over_budget == 3
            assert hub.forward(link, frame, urgent=True)
            assert hub.send(link, BEAT)
            # Both overdrew the budget: a tenth of a second each is missing from the next half.
            now[0] += 0.5
            assert [hub.forward(link, frame) for _ in range(4)] == [True] * 3 + [False]

    def test_noise_of_all_kinds_on_a_link_is_survived(self, hub: LinkHub, vehicle: socket.socket) -> None:
        link, address = listen(hub)
        generator = random.Random(3)
        for i in range(500):
            vehicle.sendto(generator.randbytes(generator.randrange(600)), address)
            if i % 20 == 0:
                hub.poll(0.0)
        # Whatever a false start made the parser wait for ends within the longest frame, 280 bytes.
        vehicle.sendto(heartbeat(7) * 20, address)
        packets = until(hub, lambda: (7, 1) in link.statistics.sources)
        assert packets[-1].message.get_type() == "HEARTBEAT"

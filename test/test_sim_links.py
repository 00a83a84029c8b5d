"""Simulated vehicles on real sockets: every kind of url, shared ones, bad links, signing, and bad input."""

from __future__ import annotations

import random
import socket
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from sim_peer import PATIENCE_S, Peer, fleet_of

from jpap_ros.sim import LinkFaults, SimError, SimFleet, VehicleOptions

pytest_plugins = ["jpap_ros.sim.pytest_plugin"]

ARM, SET_MODE, TAKEOFF = mavlink.MAV_CMD_COMPONENT_ARM_DISARM, mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_CMD_NAV_TAKEOFF
REQUEST, INTERVAL = mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
VERSION, POSITION = mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION, mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
ACCEPTED = 0

StartFleet = Callable[..., SimFleet]
FreePorts = Callable[[int], list[int]]


def uav(number: int, url: str) -> str:
    return f'{{name: uav{number}, sysid: {number}, url: "{url}"}}'


def test_udpin_vehicles_speak_first_and_each_from_its_own_address(sim_fleet: StartFleet) -> None:
    """Oracle: the peer's own socket: who spoke from where."""
    with Peer.udp() as peer:
        url = f"udpin:127.0.0.1:{peer.port}"
        sim_fleet(fleet_of(uav(1, url), uav(2, url)))
        addresses: dict[int, object] = {}
        while len(addresses) < 2:
            data, address = peer.socket.recvfrom(2048)
            for message in peer.parser.parse_buffer(data) or []:
                addresses[message.get_srcSystem()] = address
        assert addresses[1] != addresses[2]
        for sysid, address in addresses.items():
            peer.to = address  # type: ignore[assignment]
            assert peer.command(sysid, ARM, 1) == ACCEPTED


def test_udpout_and_tcp_vehicles_with_one_url_share_its_port(sim_fleet: StartFleet, free_ports: FreePorts) -> None:
    udp, tcp = free_ports(2)
    urls = (f"udpout:127.0.0.1:{udp}", f"tcp:127.0.0.1:{tcp}")
    fleet = sim_fleet(fleet_of(*(uav(i, urls[i > 2]) for i in (1, 2, 3, 4))))
    with Peer.udp(to=("127.0.0.1", udp)) as on_udp, Peer.tcp(tcp) as on_tcp:
        on_udp.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 0, 3))
        for peer, sysids in ((on_udp, (1, 2)), (on_tcp, (3, 4))):
            for sysid in sysids:
                assert peer.wait_for("HEARTBEAT", sysid).autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
            assert peer.command(sysids[1], ARM, 1) == ACCEPTED
            assert {m.get_srcSystem() for m in peer.heard} == set(sysids)
    assert [vehicle.armed for vehicle in fleet] == [False, True, False, True]


def test_a_vehicle_with_two_links_is_the_same_on_both(sim_fleet: StartFleet, free_ports: FreePorts) -> None:
    udp, tcp = free_ports(2)
    fleet = sim_fleet(fleet_of(f'{{name: uav1, sysid: 1, url: ["udpout:127.0.0.1:{udp}", "tcp:127.0.0.1:{tcp}"]}}'))
    with Peer.udp(to=("127.0.0.1", udp)) as one, Peer.tcp(tcp) as other:
        assert one.command(1, ARM, 1) == ACCEPTED
        assert other.wait(lambda m: m.get_type() == "HEARTBEAT" and m.base_mode & 128)
        # Each link has message rates of its own, as an autopilot's serial ports do.
        assert other.command(1, INTERVAL, POSITION, 100_000) == ACCEPTED
        other.wait_for("GLOBAL_POSITION_INT")
        one.wait_for("HEARTBEAT")
        assert all(m.get_type() != "GLOBAL_POSITION_INT" for m in one.heard)
    assert fleet["uav1"].armed


def test_a_tcp_peer_that_goes_may_come_back(sim_fleet: StartFleet, free_ports: FreePorts) -> None:
    (port,) = free_ports(1)
    sim_fleet(fleet_of(uav(1, f"tcp:127.0.0.1:{port}")))
    for _ in range(3):
        with Peer.tcp(port) as peer:
            peer.wait_for("HEARTBEAT", 1)


def test_what_cannot_be_served_is_said_in_one_line(free_ports: FreePorts) -> None:
    (port,) = free_ports(1)
    for kind, transport in (("udpout", socket.SOCK_DGRAM), ("tcp", socket.SOCK_STREAM)):
        with socket.socket(socket.AF_INET, transport) as occupant:
            occupant.bind(("127.0.0.1", port))
            with pytest.raises(SimError, match=rf"^uav1: {kind}:127\.0\.0\.1:{port}: Address already in use$"):
                SimFleet(fleet_of(uav(1, f"{kind}:127.0.0.1:{port}")))
    with pytest.raises(SimError, match=r"^uav1: serial:/dev/ttyUSB0:57600: a simulated vehicle has no serial port"):
        SimFleet(fleet_of(uav(1, "serial:/dev/ttyUSB0:57600")))
    # Everything was closed again: the port is free.
    SimFleet(fleet_of(uav(1, f"tcp:127.0.0.1:{port}"))).close()


def test_a_flight_over_a_bad_link(sim_fleet: StartFleet) -> None:
    """Oracle: ground truth. 30 % loss, duplicates, reordering, 50 ms delay; the peer repeats until it is answered."""
    faults = LinkFaults(loss=0.3, duplicate=0.2, reorder=0.2, delay_s=0.05, jitter_s=0.05)
    with Peer.udp() as peer:
        config = fleet_of(uav(1, f"udpin:127.0.0.1:{peer.port}"))
        fleet = sim_fleet(config, speedup=10.0, seed=5, options=VehicleOptions(link_faults=faults))
        vehicle = fleet["uav1"]

        def insist(message: object, done: Callable[[], bool]) -> None:
            deadline = time.monotonic() + PATIENCE_S
            while not done():
                assert time.monotonic() < deadline
                peer.send(message)
                peer.hear(0.1)

        def long(command: int, *params: float) -> object:
            return mavlink.MAVLink_command_long_message(1, 1, command, 0, *params, *(0.0,) * (7 - len(params)))

        insist(long(SET_MODE, 1, 4), lambda: vehicle.mode == "GUIDED")
        insist(long(ARM, 1), lambda: vehicle.armed)
        insist(long(TAKEOFF, 0, 0, 0, 0, 0, 0, 20), lambda: vehicle.position[2] > 19.9)
        lat, lon = vehicle.geodetic_e7(30.0, 40.0)
        target = mavlink.MAVLink_set_position_target_global_int_message(0, 1, 1, 6, 3576, lat, lon, 30.0, *(0.0,) * 8)
        insist(target, lambda: vehicle.position == pytest.approx((30.0, 40.0, 30.0), abs=0.05))


def test_lost_frames_show_as_gaps_in_the_sequence(sim_fleet: StartFleet) -> None:
    """Oracle: MAVLink's own loss count from sequence numbers; 25 % ± five standard deviations over 400 frames."""
    with Peer.udp() as peer:
        options = VehicleOptions(link_faults=LinkFaults(loss=0.25))
        sim_fleet(fleet_of(uav(1, f"udpin:127.0.0.1:{peer.port}")), options=options)
        peer.wait_for("HEARTBEAT")
        for kind in ("GLOBAL_POSITION_INT", "ATTITUDE", "SYS_STATUS", "VFR_HUD"):
            number = getattr(mavlink, f"MAVLINK_MSG_ID_{kind}")
            while kind not in {m.get_type() for m in peer.heard}:
                peer.send(mavlink.MAVLink_command_long_message(1, 1, INTERVAL, 0, number, 40_000, 0, 0, 0, 0, 0))
                peer.hear(0.2)
        peer.heard.clear()
        sent = 0
        last: int | None = None
        while sent < 400:
            for message in peer.hear(1.0):
                sent += 0 if last is None else (message.get_seq() - last) % 256
                last = message.get_seq()
        assert 1 - (len(peer.heard) - 1) / sent == pytest.approx(0.25, abs=0.11)


# Signing


KEY = bytes(range(32))


def test_with_a_key_frames_are_signed_and_only_signed_ones_obeyed(sim_fleet: StartFleet) -> None:
    """Oracle: pymavlink's signing on the peer's side, and ground truth of who was armed."""
    with Peer.udp(signing_key=KEY) as friend, Peer.udp() as stranger, Peer.udp(signing_key=KEY[::-1]) as forger:
        config = fleet_of(uav(1, f"udpin:127.0.0.1:{friend.port}"))
        fleet = sim_fleet(config, options=VehicleOptions(signing_key=KEY))
        beat = friend.wait_for("HEARTBEAT")
        assert beat.get_msgbuf()[2] & mavlink.MAVLINK_IFLAG_SIGNED
        assert len(beat.get_msgbuf()) == 10 + beat.get_msgbuf()[1] + 2 + 13
        for bad in (stranger, forger):
            bad.to = friend.to
            bad.send(mavlink.MAVLink_command_long_message(1, 1, ARM, 0, 1, 0, 0, 0, 0, 0, 0))
        deadline = time.monotonic() + PATIENCE_S
        while fleet.rejected < 2:
            assert time.monotonic() < deadline
            friend.hear(0.05)
        assert not fleet["uav1"].received
        assert friend.command(1, ARM, 1) == ACCEPTED
        assert fleet["uav1"].armed


def test_the_key_of_the_fleet_file_is_used(sim_fleet: StartFleet, tmp_path: Path) -> None:
    """Oracle: a peer with the same 64 hexadecimal digits is obeyed."""
    key_file = tmp_path / "key"
    key_file.touch(mode=0o600)
    key_file.write_text(KEY.hex())
    with Peer.udp(signing_key=KEY) as friend:
        url = f"udpin:127.0.0.1:{friend.port}"
        sim_fleet(fleet_of(f'{{name: uav1, sysid: 1, url: "{url}", signing_key_file: {key_file}}}'))
        assert friend.wait_for("HEARTBEAT").get_msgbuf()[2] & mavlink.MAVLINK_IFLAG_SIGNED
        assert friend.command(1, ARM, 1) == ACCEPTED


# Bad input


def test_random_and_mutated_frames_do_no_harm(sim_fleet: StartFleet, free_ports: FreePorts) -> None:
    """Oracle: after 20,000 of them the vehicle answers as before. Frames with a bad checksum command nothing."""
    (port,) = free_ports(1)
    fleet = sim_fleet(fleet_of(uav(1, f"udpout:127.0.0.1:{port}")))
    rng = random.Random(11)
    arm = mavlink.MAVLink_command_long_message(1, 1, ARM, 0, 1, 0, 0, 0, 0, 0, 0)
    with Peer.udp(to=("127.0.0.1", port)) as peer:
        for i in range(20_000):
            if i % 2:
                data = bytearray(arm.pack(peer.mav))
                # Anything but the sequence number, which the checksum covers too, but whose change is harmless.
                data[rng.randrange(5, len(data))] ^= 1 << rng.randrange(8)
            else:
                data = bytearray(b"\xfd" + rng.randbytes(rng.randrange(1, 60)))
            peer.send_bytes(bytes(data))
            if i % 500 == 0:
                # Keep pace, so that the socket's buffer loses none of them.
                assert peer.command(1, REQUEST, VERSION) == ACCEPTED
        assert not fleet["uav1"].armed
        assert fleet.rejected > 1000
        assert peer.command(1, ARM, 1) == ACCEPTED


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1e30, 3e38])
def test_no_number_in_a_command_is_taken_on_trust(sim_fleet: StartFleet, free_ports: FreePorts, value: float) -> None:
    """Oracle: for every command with nonsense in every parameter there is an answer, and the vehicle lives on."""
    (port,) = free_ports(1)
    lines = [
        f'{{name: {kind}, sysid: {i}, url: "udpout:127.0.0.1:{port}", autopilot: {kind}}}'
        for i, kind in enumerate(("ardupilot", "px4"), 1)
    ]
    sim_fleet(fleet_of(*lines))
    with Peer.udp(to=("127.0.0.1", port)) as peer:
        for sysid in (1, 2):
            assert peer.command(sysid, ARM, 1) == ACCEPTED
            for command in (16, TAKEOFF, SET_MODE, ARM, 192, 246, 511, 510, REQUEST, 21, 20):
                peer.command(sysid, command, *(value,) * 7)
            for frame in range(13):
                peer.send(
                    mavlink.MAVLink_set_position_target_global_int_message(
                        0, sysid, 1, frame, 0, 2**31 - 1, -(2**31), *(value,) * 9
                    )
                )
                peer.send(mavlink.MAVLink_set_position_target_local_ned_message(0, sysid, 1, frame, 0, *(value,) * 11))
            assert peer.command(sysid, REQUEST, VERSION) == ACCEPTED


@pytest.mark.parametrize("speedup", [0.0, -1.0, float("nan"), 1000.0])
def test_a_speedup_out_of_range_is_refused(speedup: float) -> None:
    with pytest.raises(ValueError, match="speedup must be above 0 and at most 100"):
        SimFleet(fleet_of(uav(1, "udpin:127.0.0.1:14550")), speedup=speedup)


def test_options_for_nobody_are_refused() -> None:
    with pytest.raises(ValueError, match="options name 'uav9', which is not in the fleet: uav1"):
        SimFleet(fleet_of(uav(1, "udpin:127.0.0.1:14550")), options={"uav9": VehicleOptions()})


def test_speedup_hastens_the_flight_and_not_the_messages(sim_fleet: StartFleet) -> None:
    """Oracle: while the vehicle's clock runs 60 s at 20 times real time, a 10 Hz stream sends about 30 and not 600."""
    with Peer.udp() as peer:
        fleet = sim_fleet(fleet_of(uav(1, f"udpin:127.0.0.1:{peer.port}")), speedup=20.0)
        assert peer.command(1, INTERVAL, POSITION, 100_000) == ACCEPTED
        began = peer.wait_for("GLOBAL_POSITION_INT").time_boot_ms
        count = 0
        while peer.wait_for("GLOBAL_POSITION_INT").time_boot_ms < began + 60_000:
            count += 1
        assert 5 <= count <= 40
        assert fleet["uav1"].clock_s >= 60.0

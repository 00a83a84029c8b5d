"""What the MAVLink links cost: frames parsed and packed a second, and the CPU time of serving 200 UDP vehicles.

Ratios within one run are what counts; the figures beside them are this machine's.
"""

from __future__ import annotations

import argparse
import contextlib
import socket
import time
from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as dialect

from jpap_ros.fleet.config import LinkUrl, MapOrigin
from jpap_ros.mavlink.channel import Channel
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.mavlink.links import LinkHub
from jpap_ros.mavlink.statistics import LinkStatistics

POSITION = dialect.MAVLink_global_position_int_message(
    123_456, -378_136_000, 1_449_631_000, 70_000, 50_000, 12, -7, 1, 9000
)
TARGET = dialect.MAVLink_set_position_target_global_int_message(
    123_456, 1, 1, 6, 0x0DF8, -378_136_000, 1_449_631_000, 50.0, *[0.0] * 8
)


def per_second(work: Callable[[], int], least_s: float = 1.0) -> float:
    """Pieces of work a second of CPU time; `work` returns how many it did."""
    done, start = 0, time.process_time()
    while time.process_time() - start < least_s:
        done += work()
    return done / (time.process_time() - start)


def parsing(chunk_bytes: int) -> tuple[float, float]:
    """Frames/s of our channel, and of pymavlink's own parser, from the same chunks."""
    packer = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    stream = b"".join(POSITION.pack(packer) for _ in range(2000))
    chunks = [stream[at : at + chunk_bytes] for at in range(0, len(stream), chunk_bytes)]
    channel = Channel(LinkStatistics())
    parser = dialect.MAVLink(None)
    parser.robust_parsing = True
    return (
        per_second(lambda: sum(len(channel.receive(chunk)) for chunk in chunks)),
        per_second(lambda: sum(len(parser.parse_buffer(chunk) or ()) for chunk in chunks)),
    )


def sending() -> float:
    """Position targets packed and sent over UDP a second."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle, LinkHub(245) as hub:
        vehicle.bind(("127.0.0.1", 0))
        link = hub.open(LinkUrl("udpout", *vehicle.getsockname()))

        def work() -> int:
            for _ in range(100):
                hub.send(link, TARGET)
            return 100

        return per_second(work)


def polling(vehicles: int, links: int, rate_hz: float, seconds: float) -> tuple[float, float, int]:
    """Serve vehicles that each send at a rate and are each sent a target at half of it.

    Returns
    -------
    tuple
        Share of one core used by the hub alone, microseconds a message received, messages received.
    """
    packer = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    frame = POSITION.pack(packer)
    with LinkHub(245) as hub:
        # All held at once, or the system may give one port twice.
        probes = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(links)]
        for probe in probes:
            probe.bind(("127.0.0.1", 0))
        urls = [LinkUrl("udpin", *probe.getsockname()) for probe in probes]
        for probe in probes:
            probe.close()
        for url in urls:
            hub.open(url)
        sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(vehicles)]
        for i, sock in enumerate(sockets):
            sock.connect((urls[i % links].host, urls[i % links].port))
            sock.setblocking(False)
        busy, received = 0.0, 0
        steps = int(rate_hz * seconds)
        start = time.monotonic()
        for step in range(steps):
            # A tenth of the vehicles at a time, as they would come.
            for part in range(10):
                for sock in sockets[part::10]:
                    sock.send(frame)
                before = time.process_time()
                for packet in hub.poll(0.0):
                    received += 1
                    if step % 2:
                        hub.send(packet.link, TARGET, packet.peer)
                busy += time.process_time() - before
                for sock in sockets[part::10]:
                    with contextlib.suppress(BlockingIOError):
                        while sock.recv(300):
                            pass
            time.sleep(max(0.0, start + (step + 1) / rate_hz - time.monotonic()))
        elapsed = time.monotonic() - start
        for sock in sockets:
            sock.close()
    return busy / elapsed, 1e6 * busy / max(received, 1), received


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="scripts/bench links", description=__doc__.split("\n\n")[0])
    parser.add_argument("--seconds", type=float, default=5.0, help="how long to serve the 200 vehicles [s]")
    args = parser.parse_args()
    for chunk in (40, 280, 4096):
        ours, theirs = parsing(chunk)
        print(
            f"parse, {chunk:4d} B a read: {ours:9,.0f} frames/s  (pymavlink's parser {theirs:9,.0f}, "
            f"ratio {ours / theirs:.2f})"
        )
    print(f"pack and send:         {sending():9,.0f} targets/s")
    for links in (1, 200):
        share, each_us, count = polling(200, links, 20.0, args.seconds)
        print(
            f"200 vehicles on {links:3d} link(s), 20 messages/s from and 10 targets/s to each: "
            f"{100 * share:.1f} % of a core, {each_us:.0f} us a message ({count} received)"
        )
    frame = LocalFrame(MapOrigin(-37.8136, 144.9631))
    print(
        f"geodesy: {per_second(lambda: len(frame.to_map(-37.81, 144.97)) // 2):9,.0f} to_map/s, "
        f"{per_second(lambda: len(frame.to_geodetic(900.0, -700.0)) // 2):9,.0f} to_geodetic/s"
    )


if __name__ == "__main__":
    main()

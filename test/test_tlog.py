"""Telemetry logs, read back by pymavlink's own log reader and by the format's definition, also after a full disk."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from fleet_rig import until
from graph import Graph, NodeProcess
from jpap_msgs.msg import VehicleState
from mavlink_frames import frame_v2, heartbeat
from pymavlink import mavutil
from small_disk import fill, small_disk

from jpap_ros.fleet.config import LinkUrl, load_fleet
from jpap_ros.mavlink.tlog import TlogFolder
from jpap_ros.nodes.qos import LATCHED
from jpap_ros.sim import SimFleet

ONE, OTHER = LinkUrl("udpin", "127.0.0.1", 14550), LinkUrl("serial", "/dev/ttyUSB0", 57600)
SETUP_SIGNING, SETUP_SIGNING_EXTRA = 256, 71


def records(path: Path) -> list[tuple[int, bytes]]:
    """Split a log by the format's definition: time [us] as `>Q`, then a MAVLink 2 frame, whose length is in it."""
    data, found = path.read_bytes(), []
    while data:
        (stamp,) = struct.unpack_from(">Q", data)
        assert data[8] == 0xFD
        end = 8 + 12 + data[9] + (13 if data[10] & 1 else 0)
        assert end <= len(data), "the last record is cut off"
        found.append((stamp, data[8:end]))
        data = data[end:]
    return found


def played_back(path: Path) -> list[Any]:
    """Messages of a log, by pymavlink's reader, which shares no code with ours."""
    log = mavutil.mavlink_connection(str(path))
    messages = []
    while (message := log.recv_match()) is not None:
        messages.append(message)
    log.close()
    return messages


def test_each_link_has_a_log_of_its_frames_in_order(tmp_path: Path) -> None:
    before_us = time.time_ns() // 1000
    log = TlogFolder(tmp_path / "new" / "logs", pytest.fail)
    frames = [heartbeat(sequence=i) for i in range(200)]
    for frame in frames:
        log.keep(ONE, frame)
    log.keep(OTHER, bytearray(heartbeat(sysid=9)))
    log.close()
    after_us = time.time_ns() // 1000

    one, other = sorted((tmp_path / "new" / "logs").iterdir(), key=lambda path: "udpin" not in path.name)
    assert "udpin_127.0.0.1_14550" in one.name and "serial_dev_ttyUSB0_57600" in other.name
    assert [frame for _, frame in records(one)] == frames
    stamps = [stamp for stamp, _ in records(one)]
    # The two lowest bits are a link number, 0.
    assert before_us - 3 <= stamps[0] and stamps == sorted(stamps) and stamps[-1] <= after_us
    assert {stamp % 4 for stamp in stamps} == {0}
    assert [m.get_srcSystem() for m in played_back(other)] == [9]


def test_keys_are_never_logged(tmp_path: Path) -> None:
    secret = bytes(range(32))
    setup = frame_v2(SETUP_SIGNING, SETUP_SIGNING_EXTRA, bytes(10) + secret, 255, 190)
    log = TlogFolder(tmp_path, pytest.fail)
    log.keep(ONE, setup)
    log.keep(ONE, heartbeat())
    log.close()
    (path,) = tmp_path.iterdir()
    assert secret not in path.read_bytes()
    assert [frame for _, frame in records(path)] == [heartbeat()]


def test_a_full_disk_is_told_once_and_logging_goes_on_when_there_is_room(tmp_path: Path) -> None:
    told: list[str] = []
    with small_disk(tmp_path / "disk", 256) as disk:
        log = TlogFolder(disk, told.append, period_s=0.02, room_bytes=64 << 10)
        log.keep(ONE, heartbeat(sequence=1))
        until(lambda: any(path.stat().st_size for path in disk.iterdir()), "the first frame is written")
        ballast = fill(disk)

        def add_until(condition: Callable[[], bool], what: str) -> None:
            def tick() -> bool:
                # More than a block: what fits into the last one begun would still be written.
                for _ in range(300):
                    log.keep(ONE, heartbeat(sequence=2))
                return condition()

            until(tick, what)

        add_until(lambda: log.lost > 2000, "several writes have failed")
        assert log.problem.endswith("No space left on device")
        assert len(told) == 1 and "No space left on device" in told[0]
        ballast.unlink()
        add_until(lambda: log.problem == "", "frames are written again")
        log.keep(ONE, heartbeat(sequence=3))
        log.close()
        (path,) = disk.iterdir()
        sequences = [frame[4] for _, frame in records(path)]
    assert len(told) == 2 and f"{log.lost} frames" in told[1]
    assert sequences[0] == 1 and sequences[-1] == 3


def test_a_slow_disk_costs_frames_but_no_memory(tmp_path: Path) -> None:
    log = TlogFolder(tmp_path, pytest.fail, period_s=3600.0, max_pending_bytes=1000)
    for _ in range(1000):
        log.keep(ONE, heartbeat())
    log.close()
    (path,) = tmp_path.iterdir()
    kept = len(records(path))
    assert kept + log.lost == 1000
    assert 1000 < path.stat().st_size < 1000 + 2 * (8 + len(heartbeat()))


def test_a_folder_that_cannot_be_made_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file"):
        TlogFolder(tmp_path / "file" / "logs", pytest.fail)


def test_the_bridge_logs_both_directions_of_every_link(
    graph: Graph, start_node: Callable[..., NodeProcess], free_ports: Callable[[int], list[int]], tmp_path: Path
) -> None:
    """Oracle: what the simulated vehicles say they received, and who they are."""
    uavs = [
        {"name": f"uav{i}", "sysid": i, "url": f"udpin:127.0.0.1:{port}"} for i, port in enumerate(free_ports(2), 1)
    ]
    fleet_file, logs = tmp_path / "fleet.yaml", tmp_path / "logs"
    fleet_file.write_text(
        yaml.safe_dump({"version": 1, "origin": {"latitude": -37.8136, "longitude": 144.9631}, "uavs": uavs})
    )
    states = {uav["name"]: graph.collect(VehicleState, f"{uav['name']}/state", LATCHED) for uav in uavs}
    with SimFleet(load_fleet(fleet_file)) as sim:
        bridge = start_node("bridge", {"fleet_file": str(fleet_file), "tlog_dir": str(logs)})
        graph.wait(
            lambda: all(heard and heard[-1].position_valid for heard in states.values()), "both vehicles are heard"
        )

        def beats() -> int:
            kinds = [{(m.get_type(), m.get_srcSystem()) for m in played_back(path)} for path in logs.glob("*.tlog")]
            return sum(("HEARTBEAT", 245) in found for found in kinds)

        # The bridge's heartbeat goes out once a second, and a log begins with its first frames.
        graph.wait(lambda: beats() == len(uavs), "the bridge's heartbeat in each log")
        assert bridge.stop() == 0
        received = {}
        for vehicle in sim:
            with vehicle.lock:
                received[vehicle.name] = [r.kind for r in vehicle.received]
    for uav in uavs:
        port = uav["url"].rpartition(":")[2]
        (path,) = logs.glob(f"*_{port}.tlog")
        messages = played_back(path)
        assert {message.get_srcSystem() for message in messages} == {uav["sysid"], 245}
        sent = [message.get_type() for message in messages if message.get_srcSystem() == 245]
        # The vehicles keep commands and setpoints, not heartbeats.
        assert "HEARTBEAT" in sent
        orders = [kind for kind in sent if kind in received[uav["name"]]]
        assert orders[: len(received[uav["name"]])] == received[uav["name"]] != []
        assert "GLOBAL_POSITION_INT" in {m.get_type() for m in messages if m.get_srcSystem() == uav["sysid"]}
        stamps = [message._timestamp for message in messages]
        assert stamps == sorted(stamps) and abs(stamps[-1] - time.time()) < 3600.0


def test_the_bridge_refuses_a_log_folder_that_it_cannot_write(
    start_node: Callable[..., NodeProcess], tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("")
    bridge = start_node("bridge", {"tlog_dir": str(tmp_path / "file" / "logs")})
    assert bridge.wait() == 1
    assert "cannot start:" in bridge.output and "file" in bridge.output

"""Bytes on the wire against frames worked out by hand from the message definitions (see mavlink_frames)."""

from __future__ import annotations

import math
import socket
import struct
from dataclasses import replace

import pytest
from mavlink_frames import (
    COMMAND_INT,
    COMMAND_INT_EXTRA,
    COMMAND_LONG,
    COMMAND_LONG_EXTRA,
    HEARTBEAT,
    HEARTBEAT_EXTRA,
    SET_POSITION_TARGET_GLOBAL_INT,
    SET_POSITION_TARGET_GLOBAL_INT_EXTRA,
    crc16_mcrf4xx,
    frame_v1,
    frame_v2,
)
from pymavlink.dialects.v20 import ardupilotmega as dialect

from jpap_ros.fleet.config import LinkUrl
from jpap_ros.mavlink.autopilots import REGISTRY, AltitudeDatum, Target
from jpap_ros.mavlink.budget import frame_size
from jpap_ros.mavlink.commands import Command
from jpap_ros.mavlink.geodesy import degrees_to_e7
from jpap_ros.mavlink.links import LinkHub
from jpap_ros.mavlink.vehicle import Home, Vehicle

POSITION_AND_YAW = 0b1001_1111_1000


def sent(message: dialect.MAVLink_message, count: int = 1, sysid: int = 245, component: int = 191) -> list[bytes]:
    """What a hub puts on the wire: datagrams caught by a plain socket."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle, LinkHub(sysid, component) as hub:
        vehicle.bind(("127.0.0.1", 0))
        vehicle.settimeout(10.0)
        link = hub.open(LinkUrl("udpout", "127.0.0.1", vehicle.getsockname()[1]))
        frames = []
        for _ in range(count):
            assert hub.send(link, message)
            frames.append(vehicle.recv(1000))
        return frames


def test_the_checksum_of_the_oracle_is_the_published_one() -> None:
    # The check value of CRC-16/MCRF4XX in the catalogue of parametrised CRC algorithms.
    assert crc16_mcrf4xx(b"123456789") == 0x6F91


def test_set_position_target_global_int() -> None:
    latitude, longitude, height, yaw = -37.81361234, 144.96309876, 52.25, math.pi / 2
    message = dialect.MAVLink_set_position_target_global_int_message(
        123456,
        7,
        1,
        dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
        POSITION_AND_YAW,
        degrees_to_e7(latitude),
        degrees_to_e7(longitude),
        height,
        *[0.0] * 6,
        yaw,
        0.0,
    )
    # Fields by size, largest first, in the order of the definition within a size: time_boot_ms, lat_int, lon_int, alt,
    # vx, vy, vz, afx, afy, afz, yaw, yaw_rate (4 bytes each), type_mask (2), target_system, target_component,
    # coordinate_frame (1).
    payload = struct.pack(
        "<Iii9fHBBB", 123456, -378136123, 1449630988, height, 0, 0, 0, 0, 0, 0, yaw, 0, 0x09F8, 7, 1, 6
    )
    assert len(payload) == 53
    frames = sent(message, count=2)
    for sequence, frame in enumerate(frames):
        assert frame == frame_v2(
            SET_POSITION_TARGET_GLOBAL_INT, SET_POSITION_TARGET_GLOBAL_INT_EXTRA, payload, 245, 191, sequence
        )
    assert len(frames[0]) == frame_size(SET_POSITION_TARGET_GLOBAL_INT)


#: Home at 33 m above mean sea level; a goal 50 m above home, which the map's origin at 20 m puts at 70 m.
VEHICLE = Vehicle(7)
VEHICLE.home = Home(-37.8136, 144.9631, 33.0)
TARGET = Target(-37.81361234, 144.96309876, height_m=50.0, amsl_m=70.0)
MOVING = replace(TARGET, velocity_ned_m_s=(3.0, -4.0, 0.5))
TURNED = replace(TARGET, yaw_ned=1.25)


@pytest.mark.parametrize(
    ("autopilot", "datum", "target", "mask", "frame", "altitude"),
    [
        ("ardupilot", AltitudeDatum.RELATIVE, TARGET, 0x0DF8, 6, 50.0),
        ("ardupilot", AltitudeDatum.AMSL, TARGET, 0x0DF8, 5, 70.0),
        ("px4", AltitudeDatum.RELATIVE, TARGET, 0x0DF8, 5, 83.0),
        ("px4", AltitudeDatum.AMSL, TARGET, 0x0DF8, 5, 70.0),
        # Velocity counts too: 0x0DF8 without VX 8, VY 16, VZ 32.
        ("ardupilot", AltitudeDatum.RELATIVE, MOVING, 0x0DC0, 6, 50.0),
        ("px4", AltitudeDatum.RELATIVE, MOVING, 0x0DC0, 5, 83.0),
        # Yaw counts too: 0x0DF8 without YAW 1024.
        ("ardupilot", AltitudeDatum.RELATIVE, TURNED, 0x09F8, 6, 50.0),
        ("px4", AltitudeDatum.RELATIVE, TURNED, 0x09F8, 5, 83.0),
    ],
)
def test_every_setpoint(
    autopilot: str, datum: AltitudeDatum, target: Target, mask: int, frame: int, altitude: float
) -> None:
    message = REGISTRY[autopilot].position_target(target, VEHICLE, datum, 123456)
    north, east, down = target.velocity_ned_m_s or (0.0, 0.0, 0.0)
    yaw = target.yaw_ned or 0.0
    # As above; the last three bytes are target system, target component and frame.
    payload = struct.pack(
        "<Iii9fHBBB",
        *(123456, -378136123, 1449630988, altitude),
        *(north, east, down, 0, 0, 0, yaw, 0),
        *(mask, 7, 1, frame),
    )
    assert sent(message) == [
        frame_v2(SET_POSITION_TARGET_GLOBAL_INT, SET_POSITION_TARGET_GLOBAL_INT_EXTRA, payload, 245, 191)
    ]


@pytest.mark.parametrize(("autopilot", "frame", "altitude"), [("ardupilot", 6, 50.0), ("px4", 5, 83.0)])
def test_every_reposition(autopilot: str, frame: int, altitude: float) -> None:
    command = REGISTRY[autopilot].reposition(TARGET, VEHICLE, AltitudeDatum.RELATIVE)
    # COMMAND_INT: params 1 to 4 (default speed -1, change of mode 1, no radius, yaw as it is), x, y, z, command 192
    # (2 bytes), target system, target component, frame, current, autocontinue (1 byte).
    payload = struct.pack(
        "<4fiifHBBBBB", -1.0, 1.0, 0.0, math.nan, -378136123, 1449630988, altitude, 192, 7, 1, frame, 0, 0
    )
    assert len(payload) == 35
    assert sent(command.message(7, 1, as_int=True, confirmation=0)) == [
        frame_v2(COMMAND_INT, COMMAND_INT_EXTRA, payload, 245, 191)
    ]


@pytest.mark.parametrize(
    ("command", "params"),
    [
        (REGISTRY["ardupilot"].set_mode("GUIDED"), (1, 4, 0, 0, 0, 0, 0)),
        (REGISTRY["px4"].set_mode("OFFBOARD"), (1, 6, 0, 0, 0, 0, 0)),
        (REGISTRY["px4"].set_mode("AUTO.LOITER"), (1, 4, 3, 0, 0, 0, 0)),
        (REGISTRY["px4"].arm(), (1, 0, 0, 0, 0, 0, 0)),
        (REGISTRY["ardupilot"].takeoff(VEHICLE, 10.0), (0, 0, 0, 0, 0, 0, 10.0)),
        (REGISTRY["px4"].takeoff(VEHICLE, 10.0), (0, 0, 0, math.nan, math.nan, math.nan, 43.0)),
        (REGISTRY["ardupilot"].return_home(), (0, 0, 0, 0, 0, 0, 0)),
        (REGISTRY["px4"].land(), (0, 0, 0, math.nan, math.nan, math.nan, 0)),
    ],
)
def test_every_order(command: Command, params: tuple[float, ...]) -> None:
    # COMMAND_LONG: params 1 to 7, command (2 bytes), target system, target component, confirmation (1 byte).
    payload = struct.pack("<7fHBBB", *params, command.id, 7, 1, 2)
    assert sent(command.message(7, 1, as_int=False, confirmation=2)) == [
        frame_v2(COMMAND_LONG, COMMAND_LONG_EXTRA, payload, 245, 191)
    ]


def test_heartbeat_of_the_bridge() -> None:
    # Onboard controller (18), no autopilot (8), active (4), MAVLink version 3.
    message = dialect.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
    payload = struct.pack("<IBBBBB", 0, 18, 8, 0, 4, 3)
    assert sent(message) == [frame_v2(HEARTBEAT, HEARTBEAT_EXTRA, payload, 245, 191)]


def test_trailing_zeros_are_cut() -> None:
    # COMMAND_LONG with confirmation 0, target component 0 and target system 0 ends in three zero bytes, preceded by
    # the high byte of a small command number: four bytes fewer than the full 33 + 12.
    message = dialect.MAVLink_command_long_message(0, 0, 22, 0, *[0.0] * 6, 30.0)
    (frame,) = sent(message)
    payload = struct.pack("<7fHBBB", *[0.0] * 6, 30.0, 22, 0, 0, 0)
    assert frame == frame_v2(COMMAND_LONG, COMMAND_LONG_EXTRA, payload, 245, 191)
    assert frame[1] == 29
    assert len(frame) == 41 == frame_size(COMMAND_LONG) - 4


def test_sequence_numbers_wrap_after_255() -> None:
    frames = sent(dialect.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3), count=258)
    assert [frame[4] for frame in frames] == [*range(256), 0, 1]


def test_both_protocol_versions_are_understood() -> None:
    payload = struct.pack("<IBBBBB", 5, 2, 3, 81, 4, 3)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle, LinkHub(245) as hub:
        vehicle.bind(("127.0.0.1", 0))
        link = hub.open(LinkUrl("udpout", "127.0.0.1", vehicle.getsockname()[1]))
        to = link.local_address
        vehicle.sendto(frame_v1(HEARTBEAT, HEARTBEAT_EXTRA, payload, 3, 1, 200), to)
        vehicle.sendto(frame_v2(HEARTBEAT, HEARTBEAT_EXTRA, payload, 4, 1, 201), to)
        packets = []
        while len(packets) < 2:
            packets += hub.poll(10.0)
        assert [p.message.get_srcSystem() for p in packets] == [3, 4]
        assert [p.message.get_seq() for p in packets] == [200, 201]
        assert {(p.message.custom_mode, p.message.base_mode, p.message.mavlink_version) for p in packets} == {
            (5, 81, 3)
        }


def test_frame_size_of_an_unknown_message_is_an_error() -> None:
    with pytest.raises(ValueError, match=r"message_id .* 99999"):
        frame_size(99999)

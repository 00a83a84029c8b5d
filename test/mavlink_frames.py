"""MAVLink frames put together from the published definition with struct alone: an oracle that is not pymavlink.

Sources: https://mavlink.io/en/guide/serialization.html (frame layout, CRC-16/MCRF4XX over everything after the start
byte with CRC_EXTRA at the end) and https://mavlink.io/en/guide/message_signing.html.
"""

from __future__ import annotations

import hashlib
import struct

HEARTBEAT, HEARTBEAT_EXTRA = 0, 50
SET_POSITION_TARGET_GLOBAL_INT, SET_POSITION_TARGET_GLOBAL_INT_EXTRA = 86, 5
COMMAND_INT, COMMAND_INT_EXTRA = 75, 158
COMMAND_LONG, COMMAND_LONG_EXTRA = 76, 152


def crc16_mcrf4xx(data: bytes, crc: int = 0xFFFF) -> int:
    """Bit by bit: reflected polynomial 0x8408, start value 0xFFFF, no final inversion."""
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x8408 if crc & 1 else 0)
    return crc


def frame_v2(
    message_id: int, extra: int, payload: bytes, sysid: int, component: int, sequence: int = 0, flags: int = 0
) -> bytes:
    """MAVLink 2 frame without a signature; trailing zeros of the payload are cut, but not its first byte."""
    payload = payload.rstrip(b"\0") or payload[:1]
    header = bytes([len(payload), flags, 0, sequence, sysid, component]) + message_id.to_bytes(3, "little")
    return b"\xfd" + header + payload + struct.pack("<H", crc16_mcrf4xx(header + payload + bytes([extra])))


def frame_v1(message_id: int, extra: int, payload: bytes, sysid: int, component: int, sequence: int = 0) -> bytes:
    """MAVLink 1 frame."""
    body = bytes([len(payload), sequence, sysid, component, message_id]) + payload
    return b"\xfe" + body + struct.pack("<H", crc16_mcrf4xx(body + bytes([extra])))


def signature_block(unsigned: bytes, key: bytes, link_id: int, timestamp: int) -> bytes:
    """Link id, 48-bit timestamp, first 48 bits of the SHA-256 over key and everything before."""
    stamp = bytes([link_id]) + timestamp.to_bytes(6, "little")
    return stamp + hashlib.sha256(key + unsigned + stamp).digest()[:6]


def heartbeat(
    sysid: int = 1,
    component: int = 1,
    sequence: int = 0,
    custom_mode: int = 4,
    key: bytes | None = None,
    timestamp: int = 0,
    link_id: int = 0,
) -> bytes:
    """HEARTBEAT of an ArduPilot quadrotor in MAVLink 2, signed if a key is given."""
    payload = struct.pack("<IBBBBB", custom_mode, 2, 3, 81, 4, 3)
    flags = 0 if key is None else 1
    frame = frame_v2(HEARTBEAT, HEARTBEAT_EXTRA, payload, sysid, component, sequence, flags)
    return frame if key is None else frame + signature_block(frame, key, link_id, timestamp)


def command_long(sysid: int, component: int, target: tuple[int, int], command: int, sequence: int = 0) -> bytes:
    """COMMAND_LONG with all parameters zero."""
    payload = struct.pack("<7fHBBB", *[0.0] * 7, command, *target, 0)
    return frame_v2(COMMAND_LONG, COMMAND_LONG_EXTRA, payload, sysid, component, sequence)

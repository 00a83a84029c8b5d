"""Streams of frames that come in pieces, damaged, or as noise."""

from __future__ import annotations

import random
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mavlink_frames import HEARTBEAT, HEARTBEAT_EXTRA, command_long, crc16_mcrf4xx, frame_v1, frame_v2, heartbeat
from pymavlink.dialects.v20 import ardupilotmega as dialect

from jpap_ros.mavlink.channel import Channel
from jpap_ros.mavlink.statistics import LinkStatistics

PAYLOAD = struct.pack("<IBBBBB", 4, 2, 3, 81, 4, 3)


def stream_of(count: int) -> bytes:
    """Frames of both versions, told apart by their sequence numbers."""
    frames = [
        frame_v2(HEARTBEAT, HEARTBEAT_EXTRA, PAYLOAD, 1, 1, i)
        if i % 3
        else frame_v1(HEARTBEAT, HEARTBEAT_EXTRA, PAYLOAD, 1, 1, i)
        for i in range(count)
    ]
    return b"".join(frames)


@given(st.lists(st.integers(1, 400), min_size=1, max_size=60))
@settings(deadline=None)
def test_the_cuts_between_reads_do_not_matter(sizes: list[int]) -> None:
    stream = stream_of(40)
    statistics = LinkStatistics()
    channel = Channel(statistics)
    sequence, at = [], 0
    for size in [*sizes, len(stream)]:
        sequence += [m.get_seq() for m in channel.receive(stream[at : at + size])]
        at += size
    assert sequence == list(range(40))
    assert statistics.skipped_bytes == statistics.bad_frames == 0


@given(st.binary(max_size=300).map(lambda noise: noise.replace(b"\xfd", b"").replace(b"\xfe", b"")))
@settings(deadline=None)
def test_noise_between_frames_is_skipped_and_counted(noise: bytes) -> None:
    statistics = LinkStatistics()
    messages = Channel(statistics).receive(noise + heartbeat() + noise + heartbeat(sequence=1))
    assert [m.get_seq() for m in messages] == [0, 1]
    assert statistics.skipped_bytes == 2 * len(noise)


def test_a_false_start_does_not_swallow_the_frames_after_it() -> None:
    # A start byte that announces a payload of 255 bytes, as noise on a radio can; 14 good frames lie in that span.
    statistics = LinkStatistics()
    good = b"".join(heartbeat(sequence=i) for i in range(14))
    messages = Channel(statistics).receive(b"\xfd\xff\x00" + good)
    assert [m.get_seq() for m in messages] == list(range(14))
    assert statistics.skipped_bytes == 3


@given(st.integers(0, 20), st.integers(1, 255))
@settings(deadline=None)
def test_a_damaged_frame_is_not_delivered(position: int, change: int) -> None:
    # A CRC of 16 bits finds every change of a single byte. Only a frame whose id becomes one that the dialect lacks
    # cannot be checked; it comes marked as such.
    frame = bytearray(heartbeat())
    frame[position] ^= change
    messages = Channel(LinkStatistics()).receive(bytes(frame) + heartbeat(sequence=9) * 20)
    known = [m for m in messages if not isinstance(m, dialect.MAVLink_unknown)]
    assert [m.get_seq() for m in known] == [9] * 20
    assert len(messages) == 20 or position in (7, 8, 9)


@pytest.mark.parametrize("flags", [0x02, 0x80, 0x03])
def test_unknown_incompatibility_flags_make_a_frame_unreadable(flags: int) -> None:
    frame = frame_v2(HEARTBEAT, HEARTBEAT_EXTRA, PAYLOAD, 1, 1, 0, flags)
    assert [m.get_seq() for m in Channel(LinkStatistics()).receive(frame + heartbeat(sequence=7))] == [7]


def test_a_message_that_the_dialect_lacks_comes_whole() -> None:
    statistics = LinkStatistics()
    frame = frame_v2(60_000, 77, b"something new", 8, 15, 33)
    messages = Channel(statistics).receive(frame + heartbeat())
    assert isinstance(messages[0], dialect.MAVLink_unknown)
    assert bytes(messages[0].get_msgbuf()) == frame
    header = messages[0].get_header()
    assert (header.msgId, header.seq, header.srcSystem, header.srcComponent) == (60_000, 33, 8, 15)
    assert len(messages) == 2
    assert statistics.unknown_frames == 1


def test_what_is_kept_of_an_endless_stream_is_less_than_a_frame() -> None:
    # The stream never pauses at a frame's end, which lets pymavlink's own parser grow without bound.
    stream = heartbeat() * 3000
    channel, count = Channel(LinkStatistics()), 0
    for at in range(0, len(stream), 1000):
        count += len(channel.receive(stream[at : at + 1000]))
        assert len(channel._buffer) < 280
    assert count == 3000


def test_after_a_reset_half_a_frame_is_forgotten() -> None:
    channel = Channel(LinkStatistics())
    assert channel.receive(heartbeat()[:10]) == []
    channel.reset()
    assert len(channel.receive(heartbeat())) == 1


def test_fuzzed_streams_raise_nothing_and_deliver_only_checked_frames() -> None:
    """120,000 random and mutated frames; every message that comes out has a checksum right by our own CRC."""
    generator = random.Random(20)
    seeds = [heartbeat(), command_long(255, 190, (1, 1), 400), heartbeat(key=bytes(32)), stream_of(2)]
    extras = {message_id: message.crc_extra for message_id, message in dialect.mavlink_map.items()}
    statistics = LinkStatistics()
    channel = Channel(statistics)
    delivered = 0
    for batch in range(1200):
        pieces = []
        for _ in range(100):
            kind = generator.random()
            if kind < 0.3:
                pieces.append(generator.randbytes(generator.randrange(40)))
            elif kind < 0.5:
                # Random bytes behind a plausible header.
                pieces.append(bytes([0xFD, generator.randrange(60), 0]) + generator.randbytes(generator.randrange(60)))
            else:
                frame = bytearray(generator.choice(seeds))
                for _ in range(generator.randrange(3)):
                    frame[generator.randrange(len(frame))] = generator.randrange(256)
                pieces.append(bytes(frame[: generator.randrange(len(frame) + 1)] if kind > 0.9 else frame))
        for message in channel.receive(b"".join(pieces)):
            if isinstance(message, dialect.MAVLink_unknown):
                continue
            delivered += 1
            if batch % 20 == 0:
                frame = bytes(message.get_msgbuf())
                end = len(frame) - (13 if frame[0] == 0xFD and frame[2] & 1 else 0) - 2
                crc = crc16_mcrf4xx(frame[1:end] + bytes([extras[message.get_msgId()]]))
                assert struct.unpack_from("<H", frame, end)[0] == crc
    assert delivered > 5_000
    assert statistics.bad_frames > 5_000
    assert statistics.skipped_bytes > 100_000

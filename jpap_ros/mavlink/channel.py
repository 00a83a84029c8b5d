"""One remote MAVLink stream: bytes in, checked messages out, bad bytes counted."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as dialect

from jpap_ros.mavlink.frame import (
    MAVLINK1_MAGIC,
    MAVLINK1_OVERHEAD_BYTES,
    MAVLINK2_MAGIC,
    MAVLINK2_OVERHEAD_BYTES,
    MAX_BYTES,
    SIGNATURE_BLOCK_BYTES,
    SIGNED_FLAG,
)
from jpap_ros.mavlink.statistics import LinkStatistics

# A debugging switch that pymavlink takes from the environment would let damaged frames through to the aircraft.
dialect.MAVLINK_IGNORE_CRC = 0

# Decodes one whole frame at a time and keeps no state, so all streams share it.
_decoder = dialect.MAVLink(None)


class Channel:
    """Finds frames in a byte stream and decodes them.

    pymavlink decodes and checks each frame. Finding the frames is done here for two reasons: after a false start byte
    pymavlink's parser throws away everything up to that frame's supposed end, good frames included, while this one
    looks again from the next byte; and its buffer grows for as long as the stream never pauses at a frame's end.

    Parameters
    ----------
    statistics : LinkStatistics
        Where bytes and frames that are no good are counted.
    """

    __slots__ = ("_buffer", "_statistics")

    def __init__(self, statistics: LinkStatistics) -> None:
        self._statistics = statistics
        self._buffer = bytearray()

    def reset(self) -> None:
        """Forget a half-received frame: what follows belongs to a new connection."""
        self._buffer.clear()

    def receive(self, data: bytes | memoryview) -> list[dialect.MAVLink_message]:
        """Messages completed by `data`, in order. Never raises, whatever the bytes.

        A MAVLink 2 message that the dialect does not know comes as `MAVLink_unknown`. Its checksum cannot be
        verified, so it is taken for a frame only if another one, or nothing, follows.
        """
        buffer = self._buffer
        buffer += data
        messages: list[dialect.MAVLink_message] = []
        start, end = 0, len(buffer)
        while start < end:
            length = _frame_length(buffer, start, end)
            if length > end - start:
                break
            message = self._decode(buffer, start, start + length) if length else None
            if message is None:
                start += 1
                self._statistics.skipped_bytes += 1
            else:
                messages.append(message)
                start += length
        del buffer[:start]
        return messages

    def _decode(self, buffer: bytearray, start: int, stop: int) -> dialect.MAVLink_message | None:
        try:
            message = _decoder.decode(buffer[start:stop])
        except dialect.MAVError:
            self._statistics.bad_frames += 1
            return None
        if isinstance(message, dialect.MAVLink_unknown):
            if stop < len(buffer) and buffer[stop] not in (MAVLINK1_MAGIC, MAVLINK2_MAGIC):
                return None
            self._statistics.unknown_frames += 1
            _fill_header(message)
        return message


def _frame_length(buffer: bytearray, start: int, end: int) -> int:
    """Length of the frame at `start`: 0 if there is none, more than is there if that cannot be told yet."""
    available = end - start
    magic = buffer[start]
    if magic == MAVLINK2_MAGIC:
        if available < 3:
            return MAX_BYTES
        flags = buffer[start + 2]
        # A frame with an incompatibility flag that is not understood must be dropped.
        if flags & ~SIGNED_FLAG:
            return 0
        return buffer[start + 1] + MAVLINK2_OVERHEAD_BYTES + (SIGNATURE_BLOCK_BYTES if flags & SIGNED_FLAG else 0)
    if magic == MAVLINK1_MAGIC:
        if available < 6:
            return MAX_BYTES
        message = dialect.mavlink_map.get(buffer[start + 5])
        # MAVLink 1 has no extension fields and no unknown lengths.
        return (
            buffer[start + 1] + MAVLINK1_OVERHEAD_BYTES if message and buffer[start + 1] <= message.unpacker.size else 0
        )
    return 0


def _fill_header(message: dialect.MAVLink_unknown) -> None:
    """Give a message of unknown id the header that pymavlink leaves empty."""
    frame = message.get_msgbuf()
    header = message.get_header()
    header.mlen, header.incompat_flags, header.compat_flags, header.seq = frame[1:5]
    header.srcSystem, header.srcComponent = frame[5:7]
    header.msgId = int.from_bytes(frame[7:10], "little")

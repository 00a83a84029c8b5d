"""One remote MAVLink stream: bytes in, checked messages out, bad bytes counted."""

from __future__ import annotations

from dataclasses import dataclass, field

from pymavlink.dialects.v20 import ardupilotmega as dialect

MAVLINK1_MAGIC = 0xFE
MAVLINK2_MAGIC = 0xFD
SIGNED_FLAG = 0x01
_MAX_FRAME_BYTES = 280

_decoder = dialect.MAVLink(None)


@dataclass
class ChannelCounts:
    """What a stream brought besides good messages.

    Attributes
    ----------
    skipped_bytes : int
        Bytes that belonged to no frame.
    bad_frames : int
        Frames with a wrong checksum or a payload that could not be decoded.
    """

    skipped_bytes: int = 0
    bad_frames: int = 0


@dataclass
class Channel:
    """Finds frames in a byte stream and decodes them.

    pymavlink decodes and checks each frame. Finding the frames is done here for three reasons: after a false start
    byte pymavlink's parser throws away everything up to that frame's supposed end, good frames included, while this
    one looks again from the next byte; its buffer grows for as long as the stream never pauses at a frame's end; and
    it hands out frames of unknown ids without any check of their signature.
    """

    counts: ChannelCounts = field(default_factory=ChannelCounts)
    _buffer: bytearray = field(default_factory=bytearray)

    def reset(self) -> None:
        """Forget a half-received frame: what follows belongs to a new connection."""
        self._buffer.clear()

    def receive(self, data: bytes | memoryview) -> list[dialect.MAVLink_message]:
        """Messages completed by `data`, in order. Never raises, whatever the bytes."""
        buffer = self._buffer
        buffer += data
        messages = []
        start, end = 0, len(buffer)
        while start < end:
            magic = buffer[start]
            if magic != MAVLINK2_MAGIC and magic != MAVLINK1_MAGIC:
                start += 1
                self.counts.skipped_bytes += 1
                continue
            length = _frame_length(buffer, start, end)
            if length > end - start:
                break
            message = self._decode(buffer[start : start + length]) if length else None
            if message is None:
                start += 1
                self.counts.skipped_bytes += 1
                continue
            messages.append(message)
            start += length
        del buffer[:start]
        return messages

    def _decode(self, frame: bytearray) -> dialect.MAVLink_message | None:
        try:
            message = _decoder.decode(frame)
        except dialect.MAVError:
            self.counts.bad_frames += 1
            return None
        if isinstance(message, dialect.MAVLink_unknown):
            # Its checksum cannot be verified: the seed comes from the definition, which this dialect lacks.
            self.counts.bad_frames += 1
            return None
        return message


def _frame_length(buffer: bytearray, start: int, end: int) -> int:
    """Length of the frame at `start`: 0 if there is none, more than is there if that cannot be told yet."""
    available = end - start
    if buffer[start] == MAVLINK1_MAGIC:
        if available < 6:
            return _MAX_FRAME_BYTES
        return buffer[start + 1] + 8 if buffer[start + 5] in dialect.mavlink_map else 0
    if available < 3:
        return _MAX_FRAME_BYTES
    flags = buffer[start + 2]
    # A frame with an incompatibility flag that is not understood must be dropped.
    if flags & ~SIGNED_FLAG:
        return 0
    if available >= 10:
        message_id = buffer[start + 7] | buffer[start + 8] << 8 | buffer[start + 9] << 16
        if message_id not in dialect.mavlink_map:
            return 0
    return buffer[start + 1] + 12 + (13 if flags & SIGNED_FLAG else 0)

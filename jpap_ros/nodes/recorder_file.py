"""One MCAP file with ROS 2 messages, as rosbag2 and Foxglove read them, that stays readable however it ends."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from mcap.well_known import MessageEncoding, Profile, SchemaEncoding
from mcap.writer import CompressionType, Writer

#: Names of the compressions that a parameter offers.
COMPRESSIONS = {kind.name.lower(): kind for kind in CompressionType}

_LIBRARY = "jpap_ros recorder"


@dataclass(frozen=True)
class Channel:
    """A topic as it is recorded.

    Attributes
    ----------
    topic : str
    type_name : str
        E.g. `geometry_msgs/msg/PoseStamped`.
    definition : str
        See `recorder_definitions.full_definition`.
    offered_qos_profiles : str
        Of its publishers, as YAML, as rosbag2 writes them.
    type_hash : str
    """

    topic: str
    type_name: str
    definition: str
    offered_qos_profiles: str
    type_hash: str


@dataclass(frozen=True, slots=True)
class Entry:
    """One message as it came: times in ns since 1970, and its CDR bytes."""

    channel: Channel
    log_ns: int
    publish_ns: int
    data: bytes


class RecordingFile:
    """An open recording.

    Messages are gathered in a compressed chunk; `flush` ends the chunk and hands it to the system, so that from then on
    it survives the end of the process. When the disk is full, the file is cut back to its last whole chunk.

    Parameters
    ----------
    path : Path
        Must not exist.
    compression : str
        A key of `COMPRESSIONS`.
    chunk_bytes : int
        A chunk of this size, uncompressed, is ended at once.
    attachments : mapping of str to bytes
        Files to carry, by name.

    Raises
    ------
    OSError
        By every method, when the file cannot be written; only `abandon` is of use then.
    """

    def __init__(self, path: Path, compression: str, chunk_bytes: int, attachments: Mapping[str, bytes]) -> None:
        self.path = path
        self._sink = _Sink(path)
        self._whole = 0
        self._channels: dict[Channel, int] = {}
        self._schemas: dict[str, int] = {}
        self._writer = Writer(self._sink, chunk_size=chunk_bytes, compression=COMPRESSIONS[compression])
        try:
            self._writer.start(profile=Profile.ROS2, library=_LIBRARY)
            for name, data in attachments.items():
                self._writer.add_attachment(0, 0, name, "application/yaml", data)
            self.flush()
        except OSError:
            self._sink.close()
            path.unlink(missing_ok=True)
            raise

    @property
    def size(self) -> int:
        """Bytes handed to the system."""
        return self._sink.size

    def write(self, entry: Entry) -> None:
        """Add a message."""
        channel = self._channels.get(entry.channel)
        if channel is None:
            channel = self._channels[entry.channel] = self._register(entry.channel)
        self._writer.add_message(channel, entry.log_ns, entry.data, entry.publish_ns)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a named table of strings."""
        self._writer.add_metadata(name, dict(values))

    def flush(self) -> None:
        """End the chunk."""
        self._writer.flush()
        self._whole = self._sink.size

    def close(self) -> None:
        """End the file with its summary and index."""
        self._writer.finish()
        self._sink.close()

    def abandon(self) -> None:
        """Close a file that cannot be written any more; what is whole stays."""
        with contextlib.suppress(OSError):
            self._sink.cut(self._whole)
        self._sink.close()

    def _register(self, channel: Channel) -> int:
        if channel.type_name not in self._schemas:
            self._schemas[channel.type_name] = self._writer.register_schema(
                channel.type_name, SchemaEncoding.ROS2, channel.definition.encode()
            )
        return self._writer.register_channel(
            channel.topic,
            MessageEncoding.CDR,
            self._schemas[channel.type_name],
            {"offered_qos_profiles": channel.offered_qos_profiles, "topic_type_hash": channel.type_hash},
        )


class _Sink:
    """What the MCAP writer needs of a file, without a buffer: bytes that were not written must not come up later."""

    def __init__(self, path: Path) -> None:
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        self.size = 0

    def write(self, data: bytes) -> int:
        left = memoryview(data)
        while left:
            left = left[os.write(self._fd, left) :]
        self.size += len(data)
        return len(data)

    def tell(self) -> int:
        return self.size

    def flush(self) -> None:
        """Nothing is kept back."""

    def cut(self, size: int) -> None:
        os.ftruncate(self._fd, size)

    def close(self) -> None:
        os.close(self._fd)

"""What a recording holds, whichever way it ended: messages, the fleet file, the planner's parameters."""

from __future__ import annotations

import contextlib
import json
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import zstandard
from mcap.exceptions import EndOfFile, InvalidMagic, McapError
from mcap.records import Attachment, Channel, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.well_known import MessageEncoding
from mcap_ros2.decoder import DecoderFactory

#: What a damaged file makes the reader raise.
_DAMAGE = (McapError, zstandard.ZstdError, struct.error, ValueError, RuntimeError)
_PARAMETERS_OF = "parameters of "
_MAGIC_BYTES = 8


class RecordingError(Exception):
    """A file is no recording that can be used; the message is the one line that the user sees."""


@dataclass(frozen=True, slots=True)
class Told:
    """One message of a recording.

    Attributes
    ----------
    topic, type_name : str
    heard_s : float
        When the recorder got it [s since 1970].
    sent_s : float
        When it was published [s since 1970].
    data : bytes
        As it was on the wire.
    message : object
        Decoded; fields as in its definition.
    """

    topic: str
    type_name: str
    heard_s: float
    sent_s: float
    data: bytes
    message: Any


@dataclass(frozen=True)
class Recording:
    """Messages of one or more files, in the order in which they were heard.

    Attributes
    ----------
    paths : tuple of Path
    told : tuple of Told
    notes : tuple of str
        What is wrong with the files, in words.
    """

    paths: tuple[Path, ...]
    told: tuple[Told, ...]
    notes: tuple[str, ...] = ()


class RecordingReader:
    """Reads recordings that belong together message by message, file by file, so that they need not fit into memory.

    Parameters
    ----------
    paths : sequence of Path
        In any order.
    wants : callable
        Told a topic and its type; messages of others are not decoded.
    progress : callable
        Told the bytes read so far, of all files together.

    Attributes
    ----------
    fleet_text : str or None
        The fleet file that was flown with; known at the end, as are the others.
    parameters : mapping of str to mapping
        Values of parameters by name, by the full name of the node.
    notes : list of str
        What is wrong with the files, in words.
    """

    def __init__(
        self,
        paths: Sequence[Path],
        wants: Callable[[str, str], bool],
        progress: Callable[[int], object] = lambda read_bytes: None,
    ) -> None:
        self.paths = tuple(paths)
        self.fleet_text: str | None = None
        self.parameters: dict[str, dict[str, Any]] = {}
        self.notes: list[str] = []
        self._wants = wants
        self._progress = progress

    def __iter__(self) -> Iterator[Told]:
        """Yield all messages that are wanted.

        Raises
        ------
        RecordingError
            If a file cannot be read or is no MCAP file, or there are no messages that are wanted.
        """
        before, count = 0, 0
        files = [_FileReader(path, self._wants, self._progress) for path in self.paths]
        for reader in sorted(files, key=_FileReader.began_ns) if len(files) > 1 else files:
            for told in reader.told(before):
                count += 1
                yield told
            self.notes += reader.notes
            self.parameters |= reader.parameters
            self.fleet_text = reader.fleet_text or self.fleet_text
            before += reader.size
        if not count:
            names = ", ".join(str(path) for path in self.paths)
            raise RecordingError("; ".join([f"{names}: no message of a flight in it", *self.notes]))


def read_recording(paths: Sequence[Path], wants: Callable[[str, str], bool]) -> Recording:
    """Read recordings that belong together as a whole; RecordingError as by `RecordingReader`."""
    reader = RecordingReader(paths, wants)
    # One file after the other, and within a file in the order in which the recorder looked at its topics.
    told = sorted(reader, key=lambda item: item.heard_s)
    return Recording(reader.paths, tuple(told), tuple(reader.notes))


class _FileReader:
    """Reads one file from its beginning, as far as it is whole; an index at its end is not needed."""

    def __init__(self, path: Path, wants: Callable[[str, str], bool], progress: Callable[[int], object]) -> None:
        self._path = path
        self._wants = wants
        self._progress = progress
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._decoders = DecoderFactory()
        self._messages = 0
        self.notes: list[str] = []
        self.parameters: dict[str, dict[str, Any]] = {}
        self.fleet_text: str | None = None

    @property
    def size(self) -> int:
        """Bytes of the file."""
        return self._path.stat().st_size

    def began_ns(self) -> int:
        """When its first message was heard; 0 if it has none."""
        with self._opened() as file, contextlib.suppress(*_DAMAGE):
            for record in StreamReader(file).records:
                if isinstance(record, Message):
                    return record.log_time
        return 0

    def told(self, before: int) -> Iterator[Told]:
        """Yield its messages; `before` is how many bytes other files had before it."""
        with self._opened() as file:
            for record in self._records(file):
                if not isinstance(record, Message):
                    self._note(record)
                    continue
                self._messages += 1
                if self._messages % 1000 == 0:
                    self._progress(before + file.tell())
                if (message := self._decoded(record)) is not None:
                    yield message

    @contextlib.contextmanager
    def _opened(self) -> Iterator[BinaryIO]:
        try:
            with self._path.open("rb") as file:
                yield file
        except OSError as error:
            raise RecordingError(f"{self._path}: cannot be read: {error.strerror or error}") from None

    def _records(self, file: BinaryIO) -> Iterator[McapRecord]:
        try:
            yield from StreamReader(file, validate_crcs=True).records
        except EndOfFile:
            if file.tell() < _MAGIC_BYTES:
                raise RecordingError(f"{self._path}: not a recording: it is empty") from None
            self._note_torn()
        except InvalidMagic:
            if self._messages == 0:
                raise RecordingError(f"{self._path}: not a recording: it is no MCAP file") from None
            self.notes.append(f"{self._path.name} is damaged at its end")
        except _DAMAGE as error:
            if file.read(1):
                why = " ".join(str(error).split())
                self.notes.append(f"{self._path.name} is damaged in the middle, read up to there: {why}")
            else:
                self._note_torn()

    def _note_torn(self) -> None:
        self.notes.append(f"{self._path.name} was not ended, or is damaged: read as far as it goes")

    def _note(self, record: McapRecord) -> None:
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            self._channels[record.id] = record
        elif isinstance(record, Attachment) and record.name == "fleet.yaml":
            self.fleet_text = record.data.decode(errors="replace")
        elif isinstance(record, Metadata) and record.name.startswith(_PARAMETERS_OF):
            try:
                values = {name: json.loads(text) for name, text in record.metadata.items()}
            except ValueError:
                self.notes.append(f"{self._path.name}: {record.name} cannot be read")
            else:
                self.parameters[record.name.removeprefix(_PARAMETERS_OF)] = values

    def _decoded(self, record: Message) -> Told | None:
        channel = self._channels.get(record.channel_id)
        schema = None if channel is None else self._schemas.get(channel.schema_id)
        if channel is None or schema is None or channel.message_encoding != MessageEncoding.CDR:
            return None
        if not self._wants(channel.topic, schema.name):
            return None
        try:
            decoder = self._decoders.decoder_for(channel.message_encoding, schema)
            message = None if decoder is None else decoder(record.data)
        except _DAMAGE:
            note = f"{self._path.name}: messages on {channel.topic} do not fit their definition"
            self.notes += [] if note in self.notes else [note]
            return None
        if message is None:
            return None
        sent_ns = record.publish_time or record.log_time
        return Told(channel.topic, schema.name, 1e-9 * record.log_time, 1e-9 * sent_ns, record.data, message)

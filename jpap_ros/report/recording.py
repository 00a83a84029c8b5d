"""What a recording holds, whichever way it ended: messages, the fleet file, the planner's parameters."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

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
    fleet_text : str or None
        The fleet file that was flown with.
    parameters : mapping of str to mapping
        Values of parameters by name, by the full name of the node.
    notes : tuple of str
        What is wrong with the files, in words.
    """

    paths: tuple[Path, ...]
    told: tuple[Told, ...]
    fleet_text: str | None = None
    parameters: dict[str, dict[str, Any]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def read_recording(
    paths: Sequence[Path],
    wants: Callable[[str, str], bool] = lambda topic, type_name: True,
    progress: Callable[[int], object] = lambda read_bytes: None,
) -> Recording:
    """Read recordings that belong together.

    Parameters
    ----------
    paths : sequence of Path
    wants : callable
        Told a topic and its type; messages of others are not decoded.
    progress : callable
        Told the bytes read so far, of all files together.

    Raises
    ------
    RecordingError
        If a file cannot be read or is no MCAP file, or there are no messages that are wanted.
    """
    told: list[Told] = []
    notes: list[str] = []
    parameters: dict[str, dict[str, Any]] = {}
    fleet_text: str | None = None
    before = 0
    for path in paths:
        reader = _FileReader(path, wants, lambda read, before=before: progress(before + read))  # type: ignore[misc]
        told += reader.told()
        notes += reader.notes
        parameters |= reader.parameters
        fleet_text = reader.fleet_text or fleet_text
        before += path.stat().st_size
    if not told:
        names = ", ".join(str(path) for path in paths)
        raise RecordingError("; ".join([f"{names}: no message of a flight in it", *notes]))
    # Times of one recorder, but of several threads of the DDS library.
    told.sort(key=lambda item: item.heard_s)
    return Recording(tuple(paths), tuple(told), fleet_text, parameters, tuple(notes))


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

    def told(self) -> list[Told]:
        found: list[Told] = []
        try:
            with self._path.open("rb") as file:
                for record in self._records(file):
                    if not isinstance(record, Message):
                        self._note(record)
                        continue
                    self._messages += 1
                    if self._messages % 1000 == 0:
                        self._progress(file.tell())
                    if (message := self._decoded(record)) is not None:
                        found.append(message)
        except OSError as error:
            raise RecordingError(f"{self._path}: cannot be read: {error.strerror or error}") from None
        return found

    def _records(self, file: Any) -> Iterator[McapRecord]:
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
            self.fleet_text = record.data.decode()
        elif isinstance(record, Metadata) and record.name.startswith(_PARAMETERS_OF):
            values = {name: json.loads(text) for name, text in record.metadata.items()}
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

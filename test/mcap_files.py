"""Recordings read and written by the public MCAP libraries alone: an oracle that shares no code with ours."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory


class Recorded(NamedTuple):
    """One message of a recording."""

    topic: str
    type_name: str
    log_ns: int
    publish_ns: int
    data: bytes
    decoded: Any


def whole(path: Path) -> list[Recorded]:
    """Messages of a file that was ended as it should be: by its index, with every checksum verified."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        found = [
            Recorded(channel.topic, schema.name, message.log_time, message.publish_time, message.data, decoded)
            for schema, channel, message, decoded in reader.iter_decoded_messages()
            if schema is not None
        ]
        assert len(found) == summary.statistics.message_count
    return found


def torn(path: Path) -> list[Recorded]:
    """Messages of a file without its end, as far as there are any; an error where anything before the end is wrong."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    found, factory = [], DecoderFactory()
    try:
        for record in StreamReader(str(path), validate_crcs=True).records:
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message):
                channel = channels[record.channel_id]
                schema = schemas[channel.schema_id]
                decoder = factory.decoder_for(channel.message_encoding, schema)
                assert decoder is not None
                decoded = decoder(record.data)
                found.append(
                    Recorded(channel.topic, schema.name, record.log_time, record.publish_time, record.data, decoded)
                )
    except EndOfFile:
        return found
    raise AssertionError(f"{path} has its end")


def of_topic(messages: Iterable[Recorded], topic: str) -> list[Any]:
    """What was recorded of one topic, decoded."""
    return [message.decoded for message in messages if message.topic == topic]

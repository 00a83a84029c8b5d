"""The recorder's parameters, and the writer's settings that follow from them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from jpap_ros.nodes.parameters import Param, fleet_file
from jpap_ros.nodes.recorder_file import COMPRESSIONS
from jpap_ros.nodes.recorder_writer import WriterSettings

#: Everything that tells a flight.
TOPICS = [
    "devices",
    "geo_devices",
    "deployment*",
    "markers*",
    "<uav>/*",
    "sim/fault",
    "/diagnostics",
    "/rosout",
    "/parameter_events",
]

_KIB, _MIB = 1 << 10, 1 << 20


def recorder_parameters() -> tuple[Param, ...]:
    """Return every parameter of the recorder."""
    return (
        fleet_file(),
        Param("folder", "recordings", "Where recordings go, named by date and time (UTC)", fixed=True),
        Param("topics", TOPICS, "What to record; `*`: anything, `<uav>`: each UAV", check=_topics, fixed=True),
        Param("compression", "zstd", "Of each chunk", choices=tuple(COMPRESSIONS), fixed=True),
        Param("chunk_kb", 1024, "Uncompressed size at which a chunk ends [KiB]", 16, 65_536, fixed=True),
        Param("flush_s", 1.0, "Longest time that a message waits to be written [s]", 0.05, 60.0, fixed=True),
        # With 100 aircraft an hour's index takes as much memory as the recorder itself.
        Param("max_size_mb", 64, "Size at which another file follows; 0: no limit [MiB]", 0, 1_000_000, fixed=True),
        Param(
            "min_free_mb", 64, "Recording stops while the disk has less free than this [MiB]", 0, 1_000_000, fixed=True
        ),
        Param("queue_mb", 64, "Memory for messages that a slow disk keeps waiting [MiB]", 1, 4096, fixed=True),
        Param("retry_s", 5.0, "Between attempts to go on after a full disk [s]", 0.1, 3600.0, fixed=True),
    )


def writer_settings(values: dict[str, Any]) -> WriterSettings:
    """Writer settings of parameter values by name; the recording carries the fleet file."""
    fleet = Path(values["fleet_file"])
    return WriterSettings(
        folder=Path(values["folder"]).expanduser(),
        compression=values["compression"],
        chunk_bytes=values["chunk_kb"] * _KIB,
        flush_s=values["flush_s"],
        max_bytes=values["max_size_mb"] * _MIB,
        min_free_bytes=values["min_free_mb"] * _MIB,
        max_pending_bytes=values["queue_mb"] * _MIB,
        retry_s=values["retry_s"],
        attachments={"fleet.yaml": fleet.read_bytes()},
    )


def _topics(value: list[str]) -> str | None:
    return None if value and all(value) else f"must name at least one topic and none that is empty, got {value!r}"

"""Writes recordings from a thread of its own: splits them, and outlives a disk that is full."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from jpap_ros.nodes.recorder_file import Entry, RecordingFile

_MIB = 1 << 20


@dataclass(frozen=True)
class WriterSettings:
    """Where and how to write.

    Attributes
    ----------
    folder : Path
        Made if it is not there.
    compression : str
        `zstd`, `lz4` or `none`.
    chunk_bytes : int
        Of uncompressed messages.
    flush_s : float
        Longest time that a message waits in memory [s].
    max_bytes : int
        A file of this size is followed by another; 0: no limit.
    min_free_bytes : int
        Recording stops while the disk has less left: others need it more.
    max_pending_bytes : int
        Kept while the disk is slow; further messages are left out.
    retry_s : float
        Between attempts to go on after a failure [s].
    attachments : mapping of str to bytes
        Files that each recording carries, by name.
    """

    folder: Path
    compression: str = "zstd"
    chunk_bytes: int = _MIB
    flush_s: float = 1.0
    max_bytes: int = 64 * _MIB
    min_free_bytes: int = 64 * _MIB
    max_pending_bytes: int = 64 * _MIB
    retry_s: float = 5.0
    attachments: Mapping[str, bytes] = field(default_factory=dict)


@dataclass(frozen=True)
class WriterReport:
    """How recording goes.

    Attributes
    ----------
    path : Path or None
        The file being written; None while recording has stopped.
    problem : str
        Why recording has stopped; empty while it goes on.
    messages, bytes : int
        Written so far, in all files.
    dropped : int
        Messages left out because the disk was slow.
    lost : int
        Messages left out because nothing could be written.
    pending_bytes : int
        Waiting in memory.
    """

    path: Path | None = None
    problem: str = ""
    messages: int = 0
    bytes: int = 0
    dropped: int = 0
    lost: int = 0
    pending_bytes: int = 0


class RecordingWriter:
    """Takes messages from any thread without ever waiting, and writes them in its own.

    Parameters
    ----------
    settings : WriterSettings
    tell, warn : callable
        Called on the writing thread with one line: when a file is begun and when recording goes on; when it stops.

    Raises
    ------
    OSError
        If no recording can be begun.
    """

    def __init__(self, settings: WriterSettings, tell: Callable[[str], object], warn: Callable[[str], object]) -> None:
        self._settings = settings
        self._tell = tell
        self._warn = warn
        self._lock = threading.Lock()
        self._pending: list[Entry] = []
        self._report = WriterReport()
        self._fresh_metadata: dict[str, Mapping[str, str]] = {}
        self._metadata: dict[str, Mapping[str, str]] = {}
        self._unflushed = 0
        self._flushed_at = time.monotonic()
        self._retry_at = 0.0
        self._bytes_before = 0
        settings.folder.mkdir(parents=True, exist_ok=True)
        if problem := self._lacking_room():
            raise OSError(problem)
        self._file: RecordingFile | None = self._begin()
        self._stopping = threading.Event()
        # Not a daemon: what was heard is written even if nobody closes this before the interpreter ends.
        self._thread = threading.Thread(target=self._run, name="recording")
        self._thread.start()

    @property
    def report(self) -> WriterReport:
        """How recording goes now."""
        return self._report

    @property
    def running(self) -> bool:
        """Whether the thread lives; if not, its traceback says why."""
        return self._thread.is_alive()

    def put(self, entries: Iterable[Entry]) -> None:
        """Have messages written; those that memory has no room for are dropped and counted."""
        with self._lock:
            size, dropped = self._report.pending_bytes, self._report.dropped
            for entry in entries:
                if size + len(entry.data) > self._settings.max_pending_bytes:
                    dropped += 1
                    continue
                size += len(entry.data)
                self._pending.append(entry)
            self._report = replace(self._report, pending_bytes=size, dropped=dropped)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Have a named table written, into every file that follows as well."""
        with self._lock:
            self._fresh_metadata[name] = values

    def close(self) -> None:
        """Write what waits and end the file."""
        self._stopping.set()
        self._thread.join()

    # On the writing thread

    def _run(self) -> None:
        period_s = min(0.2, self._settings.flush_s)
        while not self._stopping.wait(period_s):
            self._step()
        self._step()
        self._guarded(self._end)

    def _step(self) -> None:
        with self._lock:
            entries, self._pending = self._pending, []
            fresh, self._fresh_metadata = self._fresh_metadata, {}
            self._report = replace(self._report, pending_bytes=0)
        self._metadata |= fresh
        if self._file is None and time.monotonic() >= self._retry_at:
            self._resume()
            fresh = {}
        if self._file is None:
            self._count(lost=len(entries))
            return
        self._guarded(lambda: self._write(entries, fresh))

    def _guarded(self, action: Callable[[], None]) -> None:
        """Do something with the file; on an error, recording stops until there is room again."""
        try:
            action()
        except OSError as error:
            self._stop(f"{self._settings.folder}: {error.strerror or error}", lost=self._unflushed)

    def _write(self, entries: list[Entry], metadata: Mapping[str, Mapping[str, str]]) -> None:
        assert self._file is not None
        # Counted before they are written: an error on the way loses them all.
        self._unflushed += len(entries)
        for name, values in metadata.items():
            self._file.add_metadata(name, values)
        for entry in entries:
            self._file.write(entry)
        now = time.monotonic()
        if now - self._flushed_at < self._settings.flush_s:
            return
        self._flushed_at = now
        self._flush()
        if self._settings.max_bytes and self._file.size >= self._settings.max_bytes:
            self._end()
            self._file = self._begin()
        elif problem := self._lacking_room():
            self._end()
            self._stop(problem, lost=0)

    def _flush(self) -> None:
        assert self._file is not None
        self._file.flush()
        written, self._unflushed = self._unflushed, 0
        self._count(messages=written)

    def _begin(self) -> RecordingFile:
        settings = self._settings
        file = RecordingFile(
            _free_name(settings.folder), settings.compression, settings.chunk_bytes, settings.attachments
        )
        try:
            for name, values in self._metadata.items():
                file.add_metadata(name, values)
        except OSError:
            file.abandon()
            raise
        with self._lock:
            self._report = replace(self._report, path=file.path, problem="")
        self._tell(f"recording to {file.path}")
        return file

    def _end(self) -> None:
        if self._file is None:
            return
        self._flush()
        self._file.close()
        self._bytes_before += self._file.size
        self._file = None
        self._count()

    def _stop(self, problem: str, lost: int) -> None:
        if self._file is not None:
            self._file.abandon()
            self._bytes_before += self._file.size
            self._file = None
        self._unflushed = 0
        self._retry_at = time.monotonic() + self._settings.retry_s
        self._count(lost=lost)
        with self._lock:
            self._report = replace(self._report, path=None, problem=problem)
        self._warn(f"recording stopped: {problem}; what was recorded stays readable; goes on when there is room")

    def _resume(self) -> None:
        self._retry_at = time.monotonic() + self._settings.retry_s
        try:
            # With room for a chunk, lest it stops again at once.
            if self._lacking_room(self._settings.chunk_bytes):
                return
            self._file = self._begin()
        except OSError:
            # Told already, and nothing has changed.
            return
        self._tell(f"recording goes on; {self._report.lost} messages were left out")

    def _lacking_room(self, more: int = 0) -> str:
        disk = os.statvfs(self._settings.folder)
        free, needed = disk.f_bavail * disk.f_frsize, self._settings.min_free_bytes + more
        if free >= needed:
            return ""
        return f"{self._settings.folder}: {free / _MIB:.1f} MiB free, {needed / _MIB:.1f} MiB must stay free"

    def _count(self, messages: int = 0, lost: int = 0) -> None:
        size = self._bytes_before + (0 if self._file is None else self._file.size)
        with self._lock:
            report = self._report
            self._report = replace(report, messages=report.messages + messages, lost=report.lost + lost, bytes=size)


def _free_name(folder: Path) -> Path:
    """Return a name by the time of day (UTC) that no file has yet; names sort as the recordings do."""
    stem = time.strftime("%Y-%m-%dT%H-%M-%SZ", time.gmtime())
    path, number = folder / f"{stem}.mcap", 1
    while path.exists():
        number += 1
        path = folder / f"{stem}_{number:03d}.mcap"
    return path

"""Telemetry logs: every frame of a link with the time it passed, in the format that ground stations read.

A `.tlog` file is a run of records: microseconds since 1970 as eight bytes, most significant first, then one raw MAVLink
frame. QGroundControl, MAVProxy and pymavlink play it back.
"""

from __future__ import annotations

import os
import re
import struct
import threading
import time
from collections.abc import Callable
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as dialect

from jpap_ros.fleet.config import LinkUrl
from jpap_ros.mavlink.frame import MAVLINK2_MAGIC

_STAMP = struct.Struct(">Q")
#: MAVProxy keeps the number of a link in the two lowest bits of the time; each of our links has a file of its own.
_LINK_BITS = 3
_SETUP_SIGNING = dialect.MAVLINK_MSG_ID_SETUP_SIGNING.to_bytes(3, "little")


class TlogFolder:
    """Writes what passes over each link into a file of its own, from a thread of its own.

    `keep` is for the thread that owns the links: it copies the frame into a buffer and returns. When the disk is full,
    that is told once, frames are left out, and the same file goes on when there is room again.

    Parameters
    ----------
    folder : Path
        Made if it is not there.
    tell : callable
        Called on the writing thread with one line, when writing fails and when it goes on.
    period_s : float
        Between two writes [s].
    max_pending_bytes : int
        Kept for one link while the disk is slow; further frames are left out.
    room_bytes : int
        After a failure, writing goes on when the disk has so much free: the last block would be full again at once.

    Attributes
    ----------
    problem : str
        Why nothing is written now; empty while all is well.
    lost : int
        Frames left out so far.

    Raises
    ------
    OSError
        If the folder cannot be made or written to.
    """

    def __init__(
        self,
        folder: Path,
        tell: Callable[[str], object],
        period_s: float = 0.5,
        max_pending_bytes: int = 4 << 20,
        room_bytes: int = 1 << 20,
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError(f"{folder}: cannot be written to")
        self.folder = folder
        self.problem = ""
        self.lost = 0
        self._tell = tell
        self._period_s = period_s
        self._max_pending = max_pending_bytes
        self._room_bytes = room_bytes
        self._began = time.strftime("%Y-%m-%dT%H-%M-%SZ", time.gmtime())
        self._pending: dict[LinkUrl, _Pending] = {}
        self._files: dict[LinkUrl, _LogFile] = {}
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="tlog", daemon=True)
        self._thread.start()

    def keep(self, url: LinkUrl, frame: bytes | bytearray) -> None:
        """Keep a frame that was sent or received on a link just now."""
        if frame[0] == MAVLINK2_MAGIC and frame[7:10] == _SETUP_SIGNING:
            # It carries the key.
            return
        stamp = _STAMP.pack((time.time_ns() // 1000) & ~_LINK_BITS)
        with self._lock:
            pending = self._pending.get(url)
            if pending is None:
                pending = self._pending[url] = _Pending()
            if len(pending.data) > self._max_pending:
                self.lost += 1
                return
            pending.data += stamp
            pending.data += frame
            pending.frames += 1

    def close(self) -> None:
        """Write what is kept and close the files."""
        self._stopping.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stopping.wait(self._period_s):
            self._write()
        self._write()
        for file in self._files.values():
            file.close()

    def _write(self) -> None:
        with self._lock:
            pending, self._pending = self._pending, {}
        if not pending:
            return
        if self.problem and not self._has_room():
            with self._lock:
                self.lost += sum(fresh.frames for fresh in pending.values())
            return
        problems = [problem for url, fresh in pending.items() if (problem := self._append(url, fresh))]
        if problems and not self.problem:
            self._tell(f"telemetry log: {problems[0]}; frames are left out until it can be written again")
        elif self.problem and not problems:
            self._tell(f"telemetry log: written again; {self.lost} frames were left out")
        self.problem = problems[0] if problems else ""

    def _has_room(self) -> bool:
        try:
            disk = os.statvfs(self.folder)
        except OSError:
            return False
        return disk.f_bavail * disk.f_frsize >= self._room_bytes

    def _append(self, url: LinkUrl, fresh: _Pending) -> str:
        """Write what waits for one link; return what went wrong."""
        try:
            if url not in self._files:
                self._files[url] = _LogFile(self.folder / f"{self._began}_{_file_name(url)}.tlog")
            self._files[url].append(fresh.data)
        except OSError as error:
            with self._lock:
                self.lost += fresh.frames
            return f"{self.folder}: {error.strerror or error}"
        return ""


class _Pending:
    """Records of one link that wait to be written."""

    __slots__ = ("data", "frames")

    def __init__(self) -> None:
        self.data = bytearray()
        self.frames = 0


class _LogFile:
    """A file that only ever ends with a whole record."""

    def __init__(self, path: Path) -> None:
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        self._size = os.fstat(self._fd).st_size

    def append(self, records: bytearray) -> None:
        """Write all of it or, with OSError, nothing."""
        try:
            left = memoryview(records)
            while left:
                left = left[os.write(self._fd, left) :]
        except OSError:
            os.ftruncate(self._fd, self._size)
            raise
        self._size += len(records)

    def close(self) -> None:
        os.close(self._fd)


def _file_name(url: LinkUrl) -> str:
    return re.sub(r"[^A-Za-z0-9.]+", "_", str(url)).strip("_")

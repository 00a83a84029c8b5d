"""A real file system of a few kilobytes, so that a test can fill it: a tmpfs in a mount namespace of its own.

`unshare --user --map-root-user --mount` gives the rights for that to anyone; from outside the namespace it is reached
through /proc.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def small_disk(mount_point: Path, size_kib: int) -> Iterator[Path]:
    """Yield a folder on a disk of so many KiB."""
    mount_point.mkdir()
    script = 'mount -t tmpfs -o size="$1"k none "$2" && echo mounted && exec sleep infinity'
    command = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", script, "sh"]
    holder = subprocess.Popen([*command, str(size_kib), str(mount_point)], stdout=subprocess.PIPE, text=True)
    try:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "mounted\n"
        yield Path(f"/proc/{holder.pid}/root{mount_point}")
    finally:
        holder.kill()
        holder.wait()
        if holder.stdout is not None:
            holder.stdout.close()


def fill(folder: Path) -> Path:
    """Take all space that is left on a folder's disk; return the file that has it."""
    ballast = folder / "ballast"
    with ballast.open("wb", buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(bytes(4096))
    assert os.statvfs(folder).f_bavail == 0
    return ballast

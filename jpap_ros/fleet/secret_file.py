"""Reading a secret from a file that nobody but its owner may read."""

from __future__ import annotations

import os
import stat
from pathlib import Path

MAX_BYTES = 4096


def read_secret(path: Path) -> bytes:
    """Return what a secret file holds, without an editor's newline at its end; `b""` if it is empty or too long.

    Raises
    ------
    ValueError
        If the file cannot be read, or can be read by others than its owner. The message does not name the file.
    """
    try:
        # The permissions are those of the file that is read, whatever happens to the name meanwhile.
        with path.open("rb") as file:
            mode = os.fstat(file.fileno()).st_mode
            text = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise ValueError(f"cannot be read: {error.strerror}") from None
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise ValueError(f"its mode {stat.S_IMODE(mode):04o} lets others than its owner at it; chmod 600 it")
    return b"" if len(text) > MAX_BYTES else text.rstrip(b"\r\n")

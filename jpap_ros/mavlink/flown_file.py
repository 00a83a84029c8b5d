"""Which aircraft a bridge flies, in a file, so that the one after it goes on with them if it was killed."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterable
from pathlib import Path

VERSION = 1

#: Who was dead for longer takes nothing back by itself: the aircraft may be on another flight, of somebody else [s].
SUCCESSION_S = 60.0
#: So often the file says that its writer still lives [s].
REFRESH_S = 10.0
#: Clocks of two processes on one machine may be set against each other by this much [s].
_CLOCK_SET_S = 5.0


class FlownFileError(ValueError):
    """The file cannot be used; the message names it and says why."""


class FlownFile:
    """Names of the aircraft in a bridge's hands.

    Parameters
    ----------
    path : Path
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._written: tuple[str, ...] | None = None
        self._written_at = -float("inf")

    def read(self) -> tuple[str, ...]:
        """Return what a predecessor that was killed just now has left; nothing if there is none.

        Raises
        ------
        FlownFileError
            If the file cannot be read, does not hold together, or is too old.
        """
        try:
            content = json.loads(self._path.read_text())
        except FileNotFoundError:
            return ()
        except (OSError, ValueError) as error:
            raise FlownFileError(f"{self._path}: cannot be read: {error}") from None
        try:
            version, names, written_at = content["version"], content["flown"], float(content["written_at"])
            if version != VERSION:
                raise ValueError(f"version must be {VERSION}, got {version!r}")
            if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
                raise ValueError(f"flown must be a list of names, got {names!r}")
        except (KeyError, TypeError, ValueError) as error:
            raise FlownFileError(f"{self._path}: does not say which aircraft were flown: {error!r}") from None
        age_s = time.time() - written_at
        if names and not -_CLOCK_SET_S <= age_s <= SUCCESSION_S:
            raise FlownFileError(
                f"{self._path}: written {age_s:.0f} s ago, only {SUCCESSION_S:.0f} s are believed: "
                f"call bridge/launch for {', '.join(names)}"
            )
        return tuple(names)

    def write(self, names: Iterable[str]) -> None:
        """Say who is flown; the file is touched only where that has changed, or now and then as a sign of life.

        Raises
        ------
        FlownFileError
            If the file cannot be written.
        """
        flown = tuple(sorted(names))
        now = time.monotonic()
        if flown == self._written and now - self._written_at < REFRESH_S:
            return
        # Also after a failure: a full disk is not asked again and again.
        self._written, self._written_at = flown, now
        content = {"version": VERSION, "written_at": time.time(), "flown": flown}
        draft = self._path.with_name(f".{self._path.name}.{os.getpid()}")
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            draft.write_text(json.dumps(content))
            draft.replace(self._path)
        except OSError as error:
            raise FlownFileError(f"{self._path}: cannot be written: {error}") from None

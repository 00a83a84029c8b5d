"""Which aircraft a bridge flies and where they are, in a file for the one after it if it was killed."""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

Place = tuple[float, float, float]

VERSION = 2

#: Who was dead for longer takes nothing back by itself: the aircraft may be on another flight, of somebody else [s].
SUCCESSION_S = 60.0
#: So often the file says that its writer still lives [s].
REFRESH_S = 10.0
#: Where aircraft are is written no more often than this while they move [s].
PLACES_EVERY_S = 1.0
#: Who moved less has not moved [m].
MOVED_M = 1.0
#: Clocks of two processes on one machine may be set against each other by this much [s].
_CLOCK_SET_S = 5.0


class FlownFileError(ValueError):
    """The file cannot be used; the message names it and says why."""


@dataclass(frozen=True)
class Left:
    """What a bridge leaves to its successor.

    Attributes
    ----------
    flown : tuple of str
        Aircraft that it flew.
    in_air : mapping of str to tuple of (east, north, up)
        Corners of the line on which each aircraft was in the air, flown or not, as `AircraftSnapshot.line_m` [m].
    """

    flown: tuple[str, ...] = ()
    in_air: Mapping[str, tuple[Place, ...]] = field(default_factory=dict)


class FlownFile:
    """The aircraft in a bridge's hands, and where those in the air are.

    Parameters
    ----------
    path : Path
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._written: Left | None = None
        self._written_at = -float("inf")

    def read(self) -> Left:
        """Return what a predecessor that was killed just now has left; nothing if there is none.

        Raises
        ------
        FlownFileError
            If the file cannot be read, does not hold together, or is too old.
        """
        try:
            content = json.loads(self._path.read_text())
        except FileNotFoundError:
            return Left()
        except (OSError, ValueError) as error:
            raise FlownFileError(f"{self._path}: cannot be read: {error}") from None
        try:
            version, names, written_at = content["version"], content["flown"], float(content["written_at"])
            if version != VERSION:
                raise ValueError(f"version must be {VERSION}, got {version!r}")
            if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
                raise ValueError(f"flown must be a list of names, got {names!r}")
            in_air = {name: _line(name, corners) for name, corners in content["in_air"].items()}
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise FlownFileError(f"{self._path}: does not say which aircraft were flown: {error!r}") from None
        age_s = time.time() - written_at
        if -_CLOCK_SET_S <= age_s <= SUCCESSION_S:
            return Left(tuple(names), in_air)
        if names:
            raise FlownFileError(
                f"{self._path}: written {age_s:.0f} s ago, only {SUCCESSION_S:.0f} s are believed: "
                f"call bridge/launch for {', '.join(names)}"
            )
        return Left()

    def write(self, names: Iterable[str], in_air: Mapping[str, tuple[Place, ...]]) -> None:
        """Say who is flown, and where those in the air are.

        The file is touched at once only where it changes who is flown, in the air, or on the way; once a second at
        most while they move; and now and then as a sign of life.

        Raises
        ------
        FlownFileError
            If the file cannot be written.
        """
        left, now = Left(tuple(sorted(names)), in_air), time.monotonic()
        age_s = now - self._written_at
        if not self._changed(left) and (age_s < PLACES_EVERY_S or (age_s < REFRESH_S and not self._moved(left))):
            return
        # Also after a failure: a full disk is not asked again and again.
        self._written, self._written_at = left, now
        content = {"version": VERSION, "written_at": time.time(), "flown": left.flown, "in_air": in_air}
        draft = self._path.with_name(f".{self._path.name}.{os.getpid()}")
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            draft.write_text(json.dumps(content))
            draft.replace(self._path)
        except OSError as error:
            raise FlownFileError(f"{self._path}: cannot be written: {error}") from None

    def _changed(self, left: Left) -> bool:
        """Whether somebody else is flown or in the air than was written, or somebody has set out or come to rest."""
        before = self._written
        if before is None or left.flown != before.flown or left.in_air.keys() != before.in_air.keys():
            return True
        return any(len(line) != len(before.in_air[name]) for name, line in left.in_air.items())

    def _moved(self, left: Left) -> bool:
        before = {} if self._written is None else self._written.in_air
        return any(
            math.dist(corner, old) > MOVED_M
            for name, line in left.in_air.items()
            for corner, old in zip(line, before[name], strict=True)
        )


def _line(name: str, corners: object) -> tuple[Place, ...]:
    """Corners as they were read; ValueError if they are none."""
    try:
        line = tuple((float(east), float(north), float(up)) for east, north, up in corners)  # type: ignore[attr-defined]
    except (TypeError, ValueError):
        line = ()
    if not line or not all(math.isfinite(value) for corner in line for value in corner):
        raise ValueError(f"in_air of {name} must be places of three finite numbers, got {corners!r}")
    return line

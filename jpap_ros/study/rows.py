"""The study's results as a tidy CSV file: one row a trial, appended as trials finish."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import NamedTuple


class Trial(NamedTuple):
    """One run of one scheme on one field of devices; the key of a row."""

    devices: int
    draw: int
    gain_db: float
    scheme: str


@dataclass(frozen=True)
class Row:
    """One finished trial.

    Attributes
    ----------
    devices, draw, gain_db, scheme
        The trial: number of devices K, index of the random field, link budget above the stated one [dB], scheme.
    uavs : int
        Number of UAVs N.
    average_uav_rate : float
        The objective (6a) [bit/s/Hz].
    min_uavs_bound : int or None
        Proven lower bound on N that the scheme reports.
    proven_optimal : bool
        Whether N is proven to be the least possible.
    unserved : int
        Devices not served.
    violations : int
        Broken constraints of P1; 0 unless the scheme is wrong.
    runtime_s : float
        Time to solve [s]; the one column that differs between two runs.
    """

    devices: int
    draw: int
    gain_db: float
    scheme: str
    uavs: int
    average_uav_rate: float
    min_uavs_bound: int | None
    proven_optimal: bool
    unserved: int
    violations: int
    runtime_s: float

    @property
    def trial(self) -> Trial:
        """The trial that this row reports."""
        return Trial(self.devices, self.draw, self.gain_db, self.scheme)


COLUMNS = tuple(column.name for column in fields(Row))


def read_rows(path: Path) -> list[Row]:
    """Read every complete row; empty where there is no file.

    A last line without a line end was torn by an interrupted run: it is cut off the file, so that its trial runs again.

    Raises
    ------
    ValueError
        If a complete line is not a row of the study; names file and line.
    """
    if not path.exists():
        return []
    content = path.read_bytes()
    whole = content[: content.rfind(b"\n") + 1]
    if len(whole) < len(content):
        with path.open("r+b") as file:
            file.truncate(len(whole))
    lines = whole.decode().splitlines()
    if not lines:
        return []
    if lines[0] != ",".join(COLUMNS):
        raise ValueError(f"{path}, line 1: expected the columns {','.join(COLUMNS)}, got {lines[0]!r}")
    return [_parse(path, number, cells) for number, cells in enumerate(csv.reader(lines[1:]), start=2)]


class RowWriter:
    """Appends rows to a CSV file, each flushed at once, so that an interrupted run loses no finished trial."""

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("a", newline="")
        self._csv = csv.writer(self._file, lineterminator="\n")
        if self._file.tell() == 0:
            self._csv.writerow(COLUMNS)

    def __enter__(self) -> RowWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def write(self, row: Row) -> None:
        """Append one row."""
        self._csv.writerow(_cells(row))
        self._file.flush()


def write_rows(path: Path, rows: Iterable[Row]) -> None:
    """Replace the file by the rows, at once or not at all."""
    draft = path.with_suffix(".tmp")
    with draft.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(_cells(row) for row in rows)
    draft.replace(path)


def _cells(row: Row) -> list[str]:
    values = (getattr(row, name) for name in COLUMNS)
    return ["" if value is None else repr(value) if isinstance(value, float) else str(value) for value in values]


def _parse(path: Path, number: int, cells: list[str]) -> Row:
    try:
        text = dict(zip(COLUMNS, cells, strict=True))
        return Row(
            devices=int(text["devices"]),
            draw=int(text["draw"]),
            gain_db=float(text["gain_db"]),
            scheme=text["scheme"],
            uavs=int(text["uavs"]),
            average_uav_rate=float(text["average_uav_rate"]),
            min_uavs_bound=int(text["min_uavs_bound"]) if text["min_uavs_bound"] else None,
            proven_optimal={"True": True, "False": False}[text["proven_optimal"]],
            unserved=int(text["unserved"]),
            violations=int(text["violations"]),
            runtime_s=float(text["runtime_s"]),
        )
    except (ValueError, KeyError) as error:
        raise ValueError(f"{path}, line {number}: not a row of the study: {error}") from None

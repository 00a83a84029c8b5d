"""Devices from a file: CSV with metres or degrees, or GeoJSON points."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

from jpap_ros.fleet.config import MapOrigin
from jpap_ros.mavlink.geodesy import LocalFrame, check_geodetic
from jpap_ros.planning.devices import Device, find_fault

METRES, DEGREES = ("x", "y"), ("latitude", "longitude")
GEOJSON_SUFFIXES = (".geojson", ".json")


class DeviceFileError(ValueError):
    """The file of devices is wrong; the message names the file, the line or feature, the column and the value."""


@dataclass(frozen=True)
class DeviceEntry:
    """One device as the file has it.

    Attributes
    ----------
    where : str
        File and line, or file and feature, for messages.
    id : str
    place : (float, float)
        x (east) and y (north) [m], or latitude and longitude [deg].
    rate_demand : float
        [bit/s/Hz].
    weight : float
        Priority.
    """

    where: str
    id: str
    place: tuple[float, float]
    rate_demand: float
    weight: float


@dataclass(frozen=True)
class DeviceFile:
    """What a file says.

    Attributes
    ----------
    entries : tuple of DeviceEntry
        At least one; ids are unique.
    geodetic : bool
        Whether places are degrees rather than metres.
    ignored : tuple of str
        Columns that mean nothing here.
    """

    entries: tuple[DeviceEntry, ...]
    geodetic: bool
    ignored: tuple[str, ...] = ()

    def centroid(self) -> MapOrigin:
        """Middle of the devices of a geodetic file, also across the 180th meridian."""
        angles = [tuple(map(math.radians, entry.place)) for entry in self.entries]
        east, north, up = (
            math.fsum(part)
            for part in zip(
                *[(math.cos(a) * math.cos(o), math.cos(a) * math.sin(o), math.sin(a)) for a, o in angles], strict=True
            )
        )
        return MapOrigin(math.degrees(math.atan2(up, math.hypot(east, north))), math.degrees(math.atan2(north, east)))

    def devices(self, frame: LocalFrame | None) -> tuple[Device, ...]:
        """Return the devices on the map.

        Parameters
        ----------
        frame : LocalFrame or None
            Where the map lies; needed where places are degrees.

        Raises
        ------
        DeviceFileError
            If a device is off the map, or a number is out of range.
        """
        return tuple(_device(entry, frame if self.geodetic else None) for entry in self.entries)


def read_devices(path: Path) -> DeviceFile:
    """Read a file of devices; its suffix decides between GeoJSON and CSV.

    Raises
    ------
    DeviceFileError
        If it cannot be read or anything in it is wrong.
    """
    try:
        # A byte order mark is what spreadsheets begin a UTF-8 file with.
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise DeviceFileError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise DeviceFileError(f"{path}:{line}: not UTF-8: byte {error.object[error.start]:#04x}") from None
    read = _read_geojson if path.suffix.lower() in GEOJSON_SUFFIXES else _read_csv
    found = read(str(path), text)
    seen: dict[str, str] = {}
    for entry in found.entries:
        if entry.id in seen:
            raise DeviceFileError(f"{entry.where}: id: {entry.id!r} is already that of {seen[entry.id]}")
        seen[entry.id] = entry.where
    if not found.entries:
        raise DeviceFileError(f"{path}: has no devices")
    return found


def _device(entry: DeviceEntry, frame: LocalFrame | None) -> Device:
    try:
        place = frame.to_map(*entry.place) if frame else entry.place
    except ValueError as error:
        raise DeviceFileError(f"{entry.where}: {error}") from None
    device = Device(entry.id, place, entry.rate_demand, entry.weight)
    if fault := find_fault(device):
        raise DeviceFileError(f"{entry.where}: {fault.field.removeprefix('position.')} {fault.problem}")
    return device


# CSV


def _read_csv(path: str, text: str) -> DeviceFile:
    reader = csv.reader(StringIO(text, newline=""), strict=True)
    rows: list[tuple[int, list[str]]] = []
    try:
        rows.extend((reader.line_num, [cell.strip() for cell in row]) for row in reader if any(map(str.strip, row)))
    except csv.Error as error:
        raise DeviceFileError(f"{path}:{reader.line_num}: not valid CSV: {error}") from None
    if not rows:
        raise DeviceFileError(f"{path}: is empty; the first line must name the columns: {_layouts()}")
    (line, header), *body = rows
    columns = [name.lower() for name in header]
    axes = _axes(f"{path}:{line}", columns)
    wanted = ("id", *axes, "rate_demand", "weight")
    entries = tuple(_csv_entry(f"{path}:{number}", columns, axes, row) for number, row in body)
    return DeviceFile(entries, axes == DEGREES, tuple(name for name in columns if name not in wanted))


def _layouts() -> str:
    return " or ".join(f"id,{','.join(axes)},rate_demand[,weight]" for axes in (METRES, DEGREES))


def _axes(where: str, columns: Sequence[str]) -> tuple[str, str]:
    twice = next((name for i, name in enumerate(columns) if name in columns[:i]), None)
    if twice is not None:
        raise DeviceFileError(f"{where}: column {twice!r} stands twice")
    found = [axes for axes in (METRES, DEGREES) if any(name in columns for name in axes)]
    if len(found) > 1:
        raise DeviceFileError(f"{where}: has x or y and latitude or longitude; it must be {_layouts()}")
    axes = found[0] if found else METRES
    for name in ("id", *axes, "rate_demand"):
        if name not in columns:
            raise DeviceFileError(
                f"{where}: lacks the column {name!r}, got {','.join(columns)!r}; it must be {_layouts()}"
            )
    return axes


def _csv_entry(where: str, columns: Sequence[str], axes: tuple[str, str], row: Sequence[str]) -> DeviceEntry:
    if len(row) != len(columns):
        raise DeviceFileError(f"{where}: has {len(row)} columns, the first line {len(columns)}, got {','.join(row)!r}")
    cells = dict(zip(columns, row, strict=True))
    weight = cells.get("weight", "")
    first, second = (_csv_number(where, name, cells[name]) for name in axes)
    return DeviceEntry(
        where,
        cells["id"],
        (first, second),
        _csv_number(where, "rate_demand", cells["rate_demand"]),
        _csv_number(where, "weight", weight) if weight else 1.0,
    )


def _csv_number(where: str, column: str, text: str) -> float:
    try:
        # Python's own digit groups, 1_000, are no numbers to anybody else.
        value = math.nan if "_" in text else float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise DeviceFileError(f"{where}: column {column}: must be a number, got {text!r}")
    return value


# GeoJSON


def _read_geojson(path: str, text: str) -> DeviceFile:
    try:
        data = json.loads(text)
    except json.JSONDecodeError as error:
        raise DeviceFileError(f"{path}:{error.lineno}:{error.colno}: not valid JSON: {error.msg}") from None
    except (ValueError, RecursionError) as error:
        raise DeviceFileError(f"{path}: not valid JSON: {error}") from None
    if not isinstance(data, dict) or data.get("type") != "FeatureCollection":
        got = data.get("type") if isinstance(data, dict) else type(data).__name__
        raise DeviceFileError(f"{path}: type must be 'FeatureCollection', got {got!r}")
    features = data.get("features")
    if not isinstance(features, list):
        raise DeviceFileError(f"{path}: features must be a list, got {_shown(features)}")
    entries = tuple(_geojson_entry(f"{path}: features[{i}]", feature) for i, feature in enumerate(features))
    return DeviceFile(entries, geodetic=True)


def _geojson_entry(where: str, feature: Any) -> DeviceEntry:
    if not isinstance(feature, dict) or feature.get("type") != "Feature":
        raise DeviceFileError(f"{where}: must be a Feature, got {_shown(feature)}")
    geometry, properties = feature.get("geometry"), feature.get("properties")
    if not isinstance(geometry, dict) or geometry.get("type") != "Point":
        raise DeviceFileError(f"{where}.geometry: must be a Point, got {_shown(geometry)}")
    if not isinstance(properties, dict):
        raise DeviceFileError(f"{where}.properties: must be an object, got {_shown(properties)}")
    coordinates = geometry.get("coordinates")
    if not isinstance(coordinates, list) or len(coordinates) < 2:
        raise DeviceFileError(f"{where}.geometry.coordinates: must be [longitude, latitude], got {_shown(coordinates)}")
    longitude, latitude = (
        _json_number(f"{where}.geometry.coordinates[{i}]", value) for i, value in enumerate(coordinates[:2])
    )
    try:
        check_geodetic(latitude, longitude)
    except ValueError as error:
        raise DeviceFileError(f"{where}.geometry.coordinates: {error}") from None
    return DeviceEntry(
        where,
        _geojson_id(where, feature, properties),
        (latitude, longitude),
        _json_number(f"{where}.properties.rate_demand", properties.get("rate_demand")),
        _json_number(f"{where}.properties.weight", properties.get("weight", 1.0)),
    )


def _geojson_id(where: str, feature: Mapping[str, Any], properties: Mapping[str, Any]) -> str:
    """Return `properties.id`, or else the feature's own id."""
    place, value = (
        (f"{where}.properties.id", properties["id"]) if "id" in properties else (f"{where}.id", feature.get("id"))
    )
    if isinstance(value, bool) or not isinstance(value, (str, int)):
        raise DeviceFileError(f"{place}: must be text or a whole number, got {_shown(value)}")
    return str(value)


def _json_number(where: str, value: object) -> float:
    number = math.nan
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        with suppress(OverflowError):
            number = float(value)
    if not math.isfinite(number):
        raise DeviceFileError(f"{where}: must be a number, got {_shown(value)}")
    return number


def _shown(value: object, limit: int = 60) -> str:
    """A value in one short line."""
    text = repr(value)
    return text if len(text) <= limit else text[: limit - 3] + "..."

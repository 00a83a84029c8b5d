"""The fleet file: one YAML, the same for planner, bridge and simulated vehicles."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from jpap_ros.fleet.checks import MAX_MAP_M, check_choice, check_mapping, check_number, check_point
from jpap_ros.fleet.fence import Fence
from jpap_ros.fleet.strict_yaml import load_yaml

VERSION = 1
AUTOPILOTS = ("auto", "ardupilot", "px4")
ALTITUDE_DATUMS = ("relative", "amsl")
LINK_KINDS = ("udpin", "udpout", "tcp", "serial")
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_OWN_SYSID_RANGE = range(1, 255)
_MIN_BYTES_PER_S = 100.0


class FleetFileError(ValueError):
    """The fleet file is wrong; the message names the file, the key and the value."""


@dataclass(frozen=True)
class MapOrigin:
    """Geodetic position of the map frame's origin.

    Attributes
    ----------
    latitude, longitude : float
        WGS-84 [deg].
    altitude_amsl_m : float
        Height of the ground, z = 0 of the map frame, above mean sea level [m].
    """

    latitude: float
    longitude: float
    altitude_amsl_m: float = 0.0


@dataclass(frozen=True)
class LinkUrl:
    """Where a vehicle is reached.

    Attributes
    ----------
    kind : str
        `udpin` (listen), `udpout` (send to), `tcp` (connect to) or `serial`.
    host : str
        Address to listen on or to reach; the device's path for `serial`.
    port : int
        UDP or TCP port; baud rate for `serial`.
    """

    kind: str
    host: str
    port: int

    @classmethod
    def parse(cls, text: object) -> LinkUrl:
        """Read `kind:host:port`, e.g. `udpin:0.0.0.0:14550` or `serial:/dev/ttyUSB0:57600`; ValueError if wrong."""
        shape = "<kind>:<host>:<port> with kind one of " + ", ".join(LINK_KINDS)
        kind, _, rest = str(text).partition(":")
        host, _, port = rest.rpartition(":")
        if (
            kind not in LINK_KINDS
            or not host.strip()
            or not host.isprintable()
            or not port.isascii()
            or not port.isdigit()
        ):
            raise ValueError(f"must be {shape}, got {text!r}")
        limit = 10_000_000 if kind == "serial" else 65_535
        if not 0 < int(port) <= limit:
            raise ValueError(
                f"must have a {'baud rate' if kind == 'serial' else 'port'} from 1 to {limit}, got {text!r}"
            )
        return cls(kind, host, int(port))

    def __str__(self) -> str:
        return f"{self.kind}:{self.host}:{self.port}"


@dataclass(frozen=True)
class UavConfig:
    """One aircraft of the fleet.

    Attributes
    ----------
    name : str
        Name in topics and services: letters, digits and underscores, starting with a letter.
    sysid : int
        MAVLink system id, 1 to 254.
    urls : tuple of LinkUrl
        Where it is reached; more than one where it has several links. The first is the preferred one.
    autopilot : str
        `auto` (decided from its heartbeat), `ardupilot` or `px4`.
    altitude_datum : str
        `relative`: a goal's height is sent as height above the vehicle's home; `amsl`: as height above mean sea
        level, from the map origin's altitude.
    home_m : tuple of float or None
        Where it stands on the ground, (east, north) [m]; the simulated vehicle starts there.
    max_bytes_per_s : float or None
        What its links can carry, both directions together [byte/s]; None for links that need no care.
    signing_key_file : Path or None
        Key that frames on its links are signed with and must be signed with; None for unsigned links.
    """

    name: str
    sysid: int
    urls: tuple[LinkUrl, ...]
    autopilot: str = "auto"
    altitude_datum: str = "relative"
    home_m: tuple[float, float] | None = None
    max_bytes_per_s: float | None = None
    signing_key_file: Path | None = None


@dataclass(frozen=True)
class LinkConfig:
    """One link of the bridge and what is behind it.

    Attributes
    ----------
    url : LinkUrl
    uavs : tuple of str
        Names of the UAVs reached by it, in the order of the file; empty for a link to ground stations.
    max_bytes_per_s : float or None
        See `UavConfig`.
    signing_key_file : Path or None
        See `UavConfig`.
    """

    url: LinkUrl
    uavs: tuple[str, ...]
    max_bytes_per_s: float | None = None
    signing_key_file: Path | None = None


@dataclass(frozen=True)
class FleetConfig:
    """The whole fleet.

    Attributes
    ----------
    origin : MapOrigin
        Where the map frame lies on the earth.
    uavs : tuple of UavConfig
        In the order of the file.
    fence : Fence or None
        No aircraft is sent out of it.
    gcs_urls : tuple of LinkUrl
        Where ground stations reach the bridge, or are reached by it, to see and command the same vehicles.
    signing_key_file : Path or None
        Key of the links to ground stations, and of those UAVs that do not name another.
    """

    origin: MapOrigin
    uavs: tuple[UavConfig, ...]
    fence: Fence | None = None
    gcs_urls: tuple[LinkUrl, ...] = ()
    signing_key_file: Path | None = None

    def __getitem__(self, name: str) -> UavConfig:
        for uav in self.uavs:
            if uav.name == name:
                return uav
        raise KeyError(name)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all UAVs, in the order of the file."""
        return tuple(uav.name for uav in self.uavs)

    @property
    def vehicle_links(self) -> tuple[LinkConfig, ...]:
        """Every url of the UAVs once, in the order of the file."""
        users: dict[LinkUrl, list[UavConfig]] = {}
        for uav in self.uavs:
            for url in uav.urls:
                users.setdefault(url, []).append(uav)
        return tuple(
            LinkConfig(url, tuple(uav.name for uav in uavs), uavs[0].max_bytes_per_s, uavs[0].signing_key_file)
            for url, uavs in users.items()
        )

    @property
    def gcs_links(self) -> tuple[LinkConfig, ...]:
        """The links to ground stations."""
        return tuple(LinkConfig(url, (), None, self.signing_key_file) for url in self.gcs_urls)


def load_fleet(path: str | Path) -> FleetConfig:
    """Read a fleet file.

    Raises
    ------
    FleetFileError
        If the file cannot be read or anything in it is wrong: unknown or missing keys, duplicate names or system
        ids, a bad url. The message names the file, the key and the value.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise FleetFileError(f"{path}: cannot be read: {error}") from None
    return parse_fleet(text, source=str(path), folder=Path(path).parent)


def parse_fleet(text: str, source: str = "fleet file", folder: Path = Path()) -> FleetConfig:
    """Read a fleet from YAML text.

    Parameters
    ----------
    text : str
    source : str
        Names the text in errors.
    folder : Path
        What relative file names in it are relative to.

    Raises
    ------
    FleetFileError
        See `load_fleet`.
    """
    try:
        return _fleet(load_yaml(text), folder)
    except ValueError as error:
        raise FleetFileError(f"{source}: {error}") from None


def _fleet(data: object, folder: Path) -> FleetConfig:
    top = check_mapping(
        "the file",
        data,
        required=("version", "origin", "uavs"),
        optional=("defaults", "fence", "gcs_urls", "signing_key_file"),
    )
    if type(top["version"]) is not int or top["version"] != VERSION:
        raise ValueError(f"version must be {VERSION}, got {top['version']!r}")
    key_file = _key_file("signing_key_file", top.get("signing_key_file"), folder)
    shared = {
        "signing_key_file": top.get("signing_key_file"),
        **check_mapping(
            "defaults", top.get("defaults") or {}, optional=("autopilot", "altitude_datum", "max_bytes_per_s")
        ),
    }
    entries = top["uavs"]
    if not isinstance(entries, list) or not entries:
        raise ValueError(f"uavs must be a list with at least one entry, got {entries!r}")
    uavs = tuple(_uav(f"uavs[{i}]", entry, shared, folder) for i, entry in enumerate(entries))
    for attribute in ("name", "sysid"):
        seen: dict[object, int] = {}
        for i, uav in enumerate(uavs):
            value = getattr(uav, attribute)
            if value in seen:
                raise ValueError(f"uavs[{i}].{attribute}: {value!r} is already that of uavs[{seen[value]}]")
            seen[value] = i
    _check_shared_links(uavs)
    gcs_urls = _gcs_urls(top.get("gcs_urls"), {url: i for i, uav in enumerate(uavs) for url in uav.urls})
    return FleetConfig(_origin(top["origin"]), uavs, _fence(top.get("fence")), gcs_urls, key_file)


def _check_shared_links(uavs: tuple[UavConfig, ...]) -> None:
    first: dict[LinkUrl, int] = {}
    for i, uav in enumerate(uavs):
        for url in uav.urls:
            other = first.setdefault(url, i)
            for attribute in ("max_bytes_per_s", "signing_key_file"):
                here, there = getattr(uav, attribute), getattr(uavs[other], attribute)
                if here != there:
                    raise ValueError(
                        f"uavs[{i}].{attribute}: {_plain(here)!r} differs from {_plain(there)!r} of uavs[{other}], "
                        f"which shares the link {url}"
                    )


def _plain(value: object) -> object:
    return str(value) if isinstance(value, Path) else value


def _origin(data: object) -> MapOrigin:
    entry = check_mapping("origin", data, required=("latitude", "longitude"), optional=("altitude_amsl_m",))
    return MapOrigin(
        check_number("origin.latitude", entry["latitude"], 89.0),
        check_number("origin.longitude", entry["longitude"], 180.0),
        check_number("origin.altitude_amsl_m", entry.get("altitude_amsl_m", 0.0), 9000.0),
    )


def _fence(data: object) -> Fence | None:
    if data is None:
        return None
    entry = check_mapping("fence", data, optional=("circle", "polygon", "min_height_m", "max_height_m"))
    if not entry:
        raise ValueError("fence must have a circle, a polygon or a height limit, got {}")
    limits: dict[str, Any] = {
        key: check_number(f"fence.{key}", entry[key], MAX_MAP_M)
        for key in ("min_height_m", "max_height_m")
        if key in entry
    }
    if "circle" in entry:
        circle = check_mapping("fence.circle", entry["circle"], required=("center", "radius_m"))
        limits["center_m"] = check_point("fence.circle.center", circle["center"])
        limits["radius_m"] = check_number("fence.circle.radius_m", circle["radius_m"], MAX_MAP_M)
    if "polygon" in entry:
        corners = entry["polygon"]
        if not isinstance(corners, list) or not corners:
            raise ValueError(f"fence.polygon must be a list of [east, north] in metres, got {corners!r}")
        limits["polygon_m"] = tuple(check_point(f"fence.polygon[{i}]", corner) for i, corner in enumerate(corners))
    try:
        return Fence(**limits)
    except ValueError as error:
        raise ValueError(f"fence: {error}") from None


def _gcs_urls(value: object, taken: Mapping[LinkUrl, int]) -> tuple[LinkUrl, ...]:
    if value is None or value == []:
        return ()
    urls = _urls("gcs_urls", value)
    for url in urls:
        if url in taken:
            raise ValueError(f"gcs_urls: {str(url)!r} is already a url of uavs[{taken[url]}]")
    return urls


def _key_file(where: str, value: object, folder: Path) -> Path | None:
    if value is None:
        return None
    if not isinstance(value, str) or not value.strip():
        raise ValueError(f"{where} must be the name of a file, got {value!r}")
    try:
        return folder / Path(value).expanduser()
    except RuntimeError:
        raise ValueError(f"{where} names an unknown home folder, got {value!r}") from None


def _uav(where: str, data: object, shared: Mapping[str, Any], folder: Path) -> UavConfig:
    optional = tuple(f.name for f in fields(UavConfig) if f.name not in ("name", "sysid", "urls"))
    entry = {**shared, **check_mapping(where, data, required=("name", "sysid", "url"), optional=optional)}
    name = entry["name"]
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise ValueError(f"{where}.name must be letters, digits and underscores, starting with a letter, got {name!r}")
    sysid = entry["sysid"]
    if type(sysid) is not int or sysid not in _OWN_SYSID_RANGE:
        raise ValueError(f"{where}.sysid must be a whole number from 1 to 254, got {sysid!r}")
    return UavConfig(
        name,
        sysid,
        _urls(f"{where}.url", entry["url"]),
        check_choice(f"{where}.autopilot", entry.get("autopilot", "auto"), AUTOPILOTS),
        check_choice(f"{where}.altitude_datum", entry.get("altitude_datum", "relative"), ALTITUDE_DATUMS),
        None if entry.get("home_m") is None else check_point(f"{where}.home_m", entry["home_m"]),
        _byte_rate(f"{where}.max_bytes_per_s", entry.get("max_bytes_per_s")),
        _key_file(f"{where}.signing_key_file", entry.get("signing_key_file"), folder),
    )


def _urls(where: str, value: object) -> tuple[LinkUrl, ...]:
    if value == []:
        raise ValueError(f"{where} must be a url or a list of urls, got {value!r}")
    try:
        urls = tuple(LinkUrl.parse(text) for text in (value if isinstance(value, list) else [value]))
    except ValueError as error:
        raise ValueError(f"{where} {error}") from None
    if len(set(urls)) < len(urls):
        raise ValueError(f"{where} must not name a url twice, got {value!r}")
    return urls


def _byte_rate(where: str, value: object) -> float | None:
    if value is None:
        return None
    rate = check_number(where, value, 1e9)
    if rate < _MIN_BYTES_PER_S:
        raise ValueError(
            f"{where} must be at least {_MIN_BYTES_PER_S:g} (heartbeats both ways and one setpoint a second), "
            f"got {value!r}"
        )
    return rate

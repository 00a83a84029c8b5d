"""A fleet file for the demo: as many aircraft as asked for, on UDP ports that are free now."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import yaml

_PORTS = range(61_000, 65_536)
_DOMAINS = 102
_PORTS_EACH = len(_PORTS) // _DOMAINS


def write_fleet(path: Path, origin: tuple[float, float, float], count: int) -> None:
    """Write a fleet of `count` ArduPilot multirotors that stand in rows around the map origin.

    Parameters
    ----------
    path : Path
        File to write.
    origin : (float, float, float)
        Latitude [deg], longitude [deg] and ground height above mean sea level [m] of the map origin.
    count : int
        Number of aircraft.
    """
    latitude, longitude, altitude = origin
    columns, spacing_m = 5, 20.0
    uavs = [
        {
            "name": f"uav{i + 1}",
            "sysid": i + 1,
            "url": f"udpin:127.0.0.1:{port}",
            "home_m": [spacing_m * (i % columns), spacing_m * (i // columns)],
        }
        for i, port in enumerate(free_ports(count))
    ]
    fleet = {
        "version": 1,
        "origin": {"latitude": latitude, "longitude": longitude, "altitude_amsl_m": altitude},
        "defaults": {"autopilot": "auto"},
        "uavs": uavs,
    }
    path.write_text(yaml.safe_dump(fleet, sort_keys=False), encoding="utf-8")


def free_ports(count: int) -> list[int]:
    """UDP ports that are free now, and that nobody is given by chance: above those Linux hands out to clients."""
    # Another demo has another domain, and so begins elsewhere.
    start = _PORTS_EACH * (int(os.environ.get("ROS_DOMAIN_ID", "0")) % _DOMAINS)
    found: list[int] = []
    for offset in range(len(_PORTS)):
        port = _PORTS[(start + offset) % len(_PORTS)]
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            try:
                sock.bind(("127.0.0.1", port))
            except OSError:
                continue
        found.append(port)
        if len(found) == count:
            return found
    raise OSError(f"fewer than {count} UDP ports from {_PORTS[0]} to {_PORTS[-1]} are free")

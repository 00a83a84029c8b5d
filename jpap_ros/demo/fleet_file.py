"""A fleet file for the demo: as many aircraft as asked for, on UDP ports that are free now."""

from __future__ import annotations

import socket
from pathlib import Path

import yaml


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
    columns, spacing_m = 5, 10.0
    uavs = [
        {
            "name": f"uav{i + 1}",
            "sysid": i + 1,
            "url": f"udpin:127.0.0.1:{port}",
            "home_m": [spacing_m * (i % columns), spacing_m * (i // columns)],
        }
        for i, port in enumerate(_free_ports(count))
    ]
    fleet = {
        "version": 1,
        "origin": {"latitude": latitude, "longitude": longitude, "altitude_amsl_m": altitude},
        "defaults": {"autopilot": "auto"},
        "uavs": uavs,
    }
    path.write_text(yaml.safe_dump(fleet, sort_keys=False), encoding="utf-8")


def _free_ports(count: int) -> list[int]:
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    try:
        for sock in sockets:
            sock.bind(("127.0.0.1", 0))
        return [sock.getsockname()[1] for sock in sockets]
    finally:
        for sock in sockets:
            sock.close()

"""Checks of values read from a file; a ValueError names the place and the value."""

from __future__ import annotations

from typing import Any

MAX_MAP_M = 100_000.0
"""How far from its origin the map reaches: there its plane lies 800 m above the curved ground [m]."""


def check_mapping(
    where: str, data: object, required: tuple[str, ...] = (), optional: tuple[str, ...] = ()
) -> dict[str, Any]:
    """Return the mapping, if it has all required keys and none but those named."""
    if not isinstance(data, dict):
        raise ValueError(f"{where} must be a mapping, got {data!r}")
    for key in data:
        if key not in required + optional:
            raise ValueError(f"{where} has the unknown key {key!r}; known are {', '.join(required + optional)}")
    for key in required:
        if key not in data:
            raise ValueError(f"{where} lacks the key {key!r}")
    return data


def check_number(where: str, value: object, limit: float) -> float:
    """Return the number, if it is finite and not larger than the limit in size."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= limit:
        raise ValueError(f"{where} must be a number from {-limit:g} to {limit:g}, got {value!r}")
    return float(value)


def check_choice(where: str, value: object, choices: tuple[str, ...]) -> str:
    """Return the value, if it is one of the choices."""
    if value not in choices:
        raise ValueError(f"{where} must be one of {', '.join(choices)}, got {value!r}")
    return str(value)


def check_point(where: str, value: object) -> tuple[float, float]:
    """Return [east, north] in metres, if it is a point of the map."""
    if not isinstance(value, list) or len(value) != 2:
        raise ValueError(f"{where} must be [east, north] in metres, got {value!r}")
    return check_number(f"{where}[0]", value[0], MAX_MAP_M), check_number(f"{where}[1]", value[1], MAX_MAP_M)

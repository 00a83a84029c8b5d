"""Scenario files: a fleet, and what happens to it step by step."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

VERSION = 1

#: Longest that a step of each kind may take by default [s].
PATIENCE_S = 120.0


class ScenarioError(ValueError):
    """The scenario file is wrong; the message names the file, the step and the value."""


@dataclass(frozen=True)
class Step:
    """One thing that happens, or is waited for.

    Attributes
    ----------
    kind : str
        A key of STEPS.
    options : mapping of str to object
        Checked and complete.
    """

    kind: str
    options: Mapping[str, Any]


@dataclass(frozen=True)
class Scenario:
    """What a demo runs.

    Attributes
    ----------
    title : str
    uavs : int
        Size of the fleet.
    speedup : float
        Simulated seconds a second.
    seed : int
        Draws positions and demands of devices that the file does not place.
    planner, bridge, sim : mapping of str to object
        Parameters of the nodes.
    steps : tuple of Step
    """

    title: str
    uavs: int
    speedup: float
    seed: int
    steps: tuple[Step, ...]
    planner: Mapping[str, Any] = field(default_factory=dict)
    bridge: Mapping[str, Any] = field(default_factory=dict)
    sim: Mapping[str, Any] = field(default_factory=dict)


def load_scenario(path: Path) -> Scenario:
    """Read a scenario file; ScenarioError if it cannot be read or anything in it is wrong."""
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ScenarioError(f"{path}: cannot be read: {' '.join(str(error).split())}") from None
    try:
        return _scenario(data)
    except ValueError as error:
        raise ScenarioError(f"{path}: {error}") from None


def _scenario(data: object) -> Scenario:
    top = _mapping("the file", data, ("version", "title", "uavs", "steps"), ("speedup", "seed", *_NODES))
    if top["version"] != VERSION:
        raise ValueError(f"version must be {VERSION}, got {top['version']!r}")
    if not isinstance(top["steps"], list) or not top["steps"]:
        raise ValueError(f"steps must be a list with at least one entry, got {top['steps']!r}")
    return Scenario(
        title=_text("title", top["title"]),
        uavs=_whole("uavs", top["uavs"], 1, 200),
        speedup=_number("speedup", top.get("speedup", 5.0), 0.01, 50.0),
        seed=_whole("seed", top.get("seed", 1), 0, 2**31 - 1),
        steps=tuple(_step(f"steps[{i}]", entry) for i, entry in enumerate(top["steps"])),
        **{node: _mapping(node, top.get(node) or {}, (), None) for node in _NODES},
    )


_NODES = ("planner", "bridge", "sim")


def _step(where: str, data: object) -> Step:
    entry = _mapping(where, data, (), tuple(STEPS))
    if len(entry) != 1:
        raise ValueError(f"{where} must have exactly one key, the kind of step, got {sorted(entry)}")
    ((kind, options),) = entry.items()
    return Step(kind, STEPS[kind](f"{where}.{kind}", {} if options is None else options))


def _join(where: str, data: object) -> dict[str, Any]:
    entry = _mapping(where, data, (), ("count", "demand", "devices"))
    if ("count" in entry) == ("devices" in entry):
        raise ValueError(f"{where} must have either count (devices drawn from the city's) or devices (a list)")
    if "count" in entry:
        low, high = _pair(f"{where}.demand", entry.get("demand", [12.0, 17.0]), 1e-3, 60.0)
        return {"count": _whole(f"{where}.count", entry["count"], 1, 816), "demand": (low, high)}
    if not isinstance(entry["devices"], list):
        raise ValueError(f"{where}.devices must be a list, got {entry['devices']!r}")
    return {"devices": [_device(f"{where}.devices[{i}]", item) for i, item in enumerate(entry["devices"])]}


def _device(where: str, data: object) -> dict[str, Any]:
    entry = _mapping(where, data, ("id", "at_m", "demand"), ("weight",))
    return {
        "id": _text(f"{where}.id", entry["id"]),
        "at_m": _pair(f"{where}.at_m", entry["at_m"], -1e4, 1e4),
        "demand": _number(f"{where}.demand", entry["demand"], 1e-3, 60.0),
        "weight": _number(f"{where}.weight", entry.get("weight", 1.0), 1e-6, 1e6),
    }


def _leave(where: str, data: object) -> dict[str, Any]:
    entry = _mapping(where, data, (), ("count", "ids"))
    if ("count" in entry) == ("ids" in entry):
        raise ValueError(f"{where} must have either count (the oldest) or ids")
    if "count" in entry:
        return {"count": _whole(f"{where}.count", entry["count"], 1, 816)}
    return {"ids": _names(f"{where}.ids", entry["ids"])}


def _move(where: str, data: object) -> dict[str, Any]:
    entry = _mapping(where, data, ("by_m", "over_s"), ("ids",))
    return {
        "ids": _names(f"{where}.ids", entry["ids"]) if "ids" in entry else None,
        "by_m": _pair(f"{where}.by_m", entry["by_m"], -1e4, 1e4),
        "over_s": _number(f"{where}.over_s", entry["over_s"], 1.0, 600.0),
    }


def _demand(where: str, data: object) -> dict[str, Any]:
    entry = _mapping(where, data, ("ids", "demand"))
    return {
        "ids": _names(f"{where}.ids", entry["ids"]),
        "demand": _number(f"{where}.demand", entry["demand"], 1e-3, 60.0),
    }


def _fault(where: str, data: object) -> dict[str, Any]:
    entry = _mapping(where, data, ("uav", "fault"), ("argument",))
    return {
        "uav": _text(f"{where}.uav", entry["uav"]),
        "fault": _text(f"{where}.fault", entry["fault"]),
        "argument": str(entry.get("argument", "")),
    }


def _launch(where: str, data: object) -> dict[str, Any]:
    if data in ("needed", "all", {}):
        return {"uavs": data or "needed"}
    return {"uavs": _names(where, data)}


def _wait(where: str, data: object) -> dict[str, Any]:
    entry = _mapping(where, data, ("for",), ("timeout_s",))
    if entry["for"] not in WAITS:
        raise ValueError(f"{where}.for must be one of {', '.join(WAITS)}, got {entry['for']!r}")
    return {
        "for": entry["for"],
        "timeout_s": _number(f"{where}.timeout_s", entry.get("timeout_s", PATIENCE_S), 1.0, 3600.0),
    }


def _pause(where: str, data: object) -> dict[str, Any]:
    return {"seconds": _number(where, data, 0.1, 600.0)}


def _expect(where: str, data: object) -> dict[str, Any]:
    figures = ("served_at_least", "unserved_at_least", "uavs_at_most", "separation_at_least_m")
    entry = _mapping(where, data, (), (*figures, "served"))
    checked: dict[str, Any] = {key: _number(f"{where}.{key}", entry[key], 0.0, 1e4) for key in figures if key in entry}
    if "served" in entry:
        checked["served"] = _names(f"{where}.served", entry["served"])
    return checked


#: Each kind of step and what checks its options.
STEPS: Mapping[str, Callable[[str, Any], dict[str, Any]]] = {
    "join": _join,
    "leave": _leave,
    "move": _move,
    "demand": _demand,
    "fault": _fault,
    "launch": _launch,
    "wait": _wait,
    "pause": _pause,
    "expect": _expect,
}

#: What a `wait` step can wait for.
WAITS = ("served", "planned", "replanned", "relieved", "reached", "served_and_reached")


def _mapping(
    where: str, data: object, required: tuple[str, ...], optional: tuple[str, ...] | None = ()
) -> dict[str, Any]:
    if not isinstance(data, dict):
        raise ValueError(f"{where} must be a mapping, got {data!r}")
    for key in data:
        if optional is not None and key not in required + optional:
            raise ValueError(f"{where} has the unknown key {key!r}; known are {', '.join(required + optional)}")
    for key in required:
        if key not in data:
            raise ValueError(f"{where} lacks the key {key!r}")
    return data


def _text(where: str, value: object) -> str:
    if not isinstance(value, str) or not value:
        raise ValueError(f"{where} must be a text, got {value!r}")
    return value


def _names(where: str, value: object) -> list[str]:
    if not isinstance(value, list):
        raise ValueError(f"{where} must be a list of names, got {value!r}")
    return [_text(f"{where}[{i}]", item) for i, item in enumerate(value)]


def _number(where: str, value: object, low: float, high: float) -> float:
    good = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    if not good or not low <= value <= high:  # type: ignore[operator]
        raise ValueError(f"{where} must be a number from {low:g} to {high:g}, got {value!r}")
    return float(value)  # type: ignore[arg-type]


def _whole(where: str, value: object, low: int, high: int) -> int:
    if type(value) is not int or not low <= value <= high:
        raise ValueError(f"{where} must be a whole number from {low} to {high}, got {value!r}")
    return value


def _pair(where: str, value: object, low: float, high: float) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2:
        raise ValueError(f"{where} must be a list of two numbers, got {value!r}")
    return _number(f"{where}[0]", value[0], low, high), _number(f"{where}[1]", value[1], low, high)

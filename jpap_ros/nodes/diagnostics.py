"""What all diagnostic statuses have in common."""

from __future__ import annotations

from pathlib import Path


def status_name(node: str, item: str) -> str:
    """Name of a status, e.g. `/team_a/bridge: uav1`, from a node's full name and what of it is told."""
    return f"/{node.lstrip('/')}: {item}"


def hardware_of(fleet_file: str) -> str:
    """Hardware that a status of a whole fleet is about: the fleet file's name, or `none` without one."""
    return Path(fleet_file).name or "none"

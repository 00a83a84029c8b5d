"""The plan in force in a file, so that a planner that was killed goes on where it was."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from jpap_ros.fleet.cells import Aircraft, FleetCell, FleetPlan
from jpap_ros.fleet.config import MapOrigin
from jpap_ros.fleet.plan import named_plan
from jpap_ros.fleet.plan_settings import PlanSettings
from jpap_ros.planning import LinkBudget
from jpap_ros.planning.devices import Device, DeviceTable
from jpap_ros.planning.replanning_state import LiveCell, LivePlan

VERSION = 1


class PlanStoreError(ValueError):
    """The file cannot be used; the message names it and says why."""


@dataclass(frozen=True, eq=False)
class StoredPlan:
    """What a planner has to know to go on.

    Attributes
    ----------
    plan_id : int
    devices : tuple of Device
        Those that the plan was made for.
    settings : PlanSettings
        With which it was made.
    live : LivePlan
    names : mapping of int to str
        Aircraft of each cell.
    stamps : mapping of str to int
        Stamp of the newest report of each device [ns]; 0 where that had none.
    sent_home : frozenset of str
        Aircraft that the planner, and nobody else, has sent home since they were launched.
    told : tuple of FleetCell
        Cells of the plan whose aircraft go on as they were told before, or with other powers for now.
    """

    plan_id: int
    devices: tuple[Device, ...]
    settings: PlanSettings
    live: LivePlan
    names: Mapping[int, str]
    stamps: Mapping[str, int] = field(default_factory=dict)
    sent_home: frozenset[str] = frozenset()
    told: tuple[FleetCell, ...] = ()

    def plan(self, aircraft: Sequence[Aircraft]) -> FleetPlan:
        """Return the plan for a fleet; a cell whose aircraft is not in it any more has none."""
        known = {craft.name for craft in aircraft}
        wanted = {cell.id for cell in self.live.cells}
        # Whoever only goes on until others serve is not to be given a cell that has nobody.
        holders = {cell: name for cell, name in self.names.items() if name in known and cell in wanted}
        held = [craft for craft in aircraft if craft.name in holders.values()]
        plan = named_plan(self.live, self.settings, held, holders)
        told = {cell.id: cell for cell in self.told if cell.uav in known}
        left = [cell for cell in told.values() if cell.id not in {wanted.id for wanted in plan.target}]
        return replace(plan, cells=(*(told.get(cell.id, cell) for cell in plan.target), *left))

    def renamed(self, aircraft: Sequence[Aircraft]) -> FleetPlan:
        """Return the same cells for whoever is nearest: where the names may be out of date."""
        return named_plan(self.live, self.settings, [craft for craft in aircraft if craft.available], {})


def save_plan(
    path: Path,
    origin: MapOrigin,
    plan_id: int,
    devices: Sequence[Device],
    settings: PlanSettings,
    plan: FleetPlan,
    stamps: Mapping[str, int] | None = None,
    sent_home: Iterable[str] = (),
) -> None:
    """Replace the file at once, so that a kill at any moment leaves the old one or the new one.

    Parameters are those of `StoredPlan`.

    Raises
    ------
    PlanStoreError
        If the file cannot be written.
    """
    content = {
        "version": VERSION,
        "origin": asdict(origin),
        "plan_id": plan_id,
        "settings": asdict(settings),
        "devices": [asdict(device) for device in devices],
        "cells": [asdict(cell) for cell in plan.live.cells],
        "names": {str(cell): name for cell, name in plan.names.items()},
        "told": [_written(cell) for cell in plan.cells if cell not in plan.target],
        "unserved": dict(plan.live.unserved),
        "next_id": plan.live.next_id,
        "uavs_needed": plan.uavs_needed,
        "stamps": dict(stamps or {}),
        "sent_home": sorted(sent_home),
    }
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        draft.write_text(json.dumps(content))
        draft.replace(path)
    except OSError as error:
        raise PlanStoreError(f"{path}: cannot be written: {error}") from None


def load_plan(path: Path, origin: MapOrigin) -> StoredPlan | None:
    """Read the file; None if there is none.

    Parameters
    ----------
    path : Path
    origin : MapOrigin
        Of the fleet file now: positions in another map mean nothing.

    Raises
    ------
    PlanStoreError
        If it cannot be read, or does not hold together.
    """
    try:
        content = json.loads(path.read_text())
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise PlanStoreError(f"{path}: cannot be read: {error}") from None
    try:
        return _stored(content, origin)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise PlanStoreError(f"{path}: is not a stored plan: {error!r}") from None


def _stored(content: Mapping[str, Any], origin: MapOrigin) -> StoredPlan:
    if content["version"] != VERSION:
        raise ValueError(f"version must be {VERSION}, got {content['version']!r}")
    if content["origin"] != asdict(origin):
        raise ValueError(f"the map origin was {content['origin']}, it is {asdict(origin)}")
    link = LinkBudget(**content["settings"].pop("link"))
    settings = PlanSettings(link=link, **content["settings"])
    table = DeviceTable()
    reported = [Device(**{**entry, "position": tuple(entry["position"])}) for entry in content["devices"]]
    if faults := table.apply(reported).faults:
        raise ValueError(str(faults[0]))
    cells = tuple(
        LiveCell(
            int(cell["id"]),
            (float(cell["position"][0]), float(cell["position"][1])),
            tuple(cell["device_ids"]),
            tuple(map(float, cell["power_w"])),
        )
        for cell in content["cells"]
    )
    demands = settings.demands(table.devices)
    live = LivePlan(cells, demands, content["unserved"], int(content["next_id"]), int(content["uavs_needed"]))
    limits = settings.limits(len(cells))
    if broken := live.deployment(limits).violations(
        demands.positions, demands.rates, settings.link, settings.max_devices_per_uav, None, settings.min_separation_m
    ):
        raise ValueError(broken[0])
    names = {int(cell): str(name) for cell, name in content["names"].items()}
    # Files of before these were kept are read as well.
    stamps = {str(name): int(stamp) for name, stamp in content.get("stamps", {}).items()}
    sent_home = frozenset(map(str, content.get("sent_home", ())))
    told = tuple(_read(entry) for entry in content.get("told", ()))
    return StoredPlan(int(content["plan_id"]), table.devices, settings, live, names, stamps, sent_home, told)


def _written(cell: FleetCell) -> dict[str, Any]:
    radius_m = None if math.isnan(cell.coverage_radius_m) else cell.coverage_radius_m
    return asdict(cell) | {"coverage_radius_m": radius_m, "elsewhere": sorted(cell.elsewhere)}


def _read(entry: Mapping[str, Any]) -> FleetCell:
    radius_m = entry["coverage_radius_m"]
    return FleetCell(
        id=int(entry["id"]),
        uav=str(entry["uav"]),
        position=(float(entry["position"][0]), float(entry["position"][1])),
        device_ids=tuple(map(str, entry["device_ids"])),
        power_w=tuple(map(float, entry["power_w"])),
        rate=tuple(map(float, entry["rate"])),
        coverage_radius_m=math.nan if radius_m is None else float(radius_m),
        apply_within_m=float(entry["apply_within_m"]),
        power_until_w=tuple((str(name), float(power)) for name, power in entry["power_until_w"]),
        elsewhere=frozenset(map(str, entry["elsewhere"])),
        waits_for=tuple(map(str, entry["waits_for"])),
    )

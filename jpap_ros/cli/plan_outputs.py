"""A plan written as files, each in the format that its suffix names."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable, Sequence
from io import StringIO
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from jpap_ros.cli.named_plan import NamedPlan
from jpap_ros.cli.proof import proof_line
from jpap_ros.planning import Deployment
from jpap_ros.planning.devices import Device
from jpap_ros.study.deployment_map import draw_deployments
from jpap_ros.study.style import METADATA, figure_style, write

#: Formats of a picture.
PICTURES = tuple(METADATA)
#: With more UAVs than these a picture names none: names would hide one another.
MAX_NAMES = 60


def write_plan(path: Path, plan: NamedPlan) -> None:
    """Write a plan.

    Parameters
    ----------
    path : Path
        Its suffix is one of `PLAN_SUFFIXES`.
    plan : NamedPlan

    Raises
    ------
    OSError
        If the file cannot be written.
    ValueError
        If the format needs a place on the earth and the plan has none.
    """
    suffix = path.suffix.lower()
    if suffix in PICTURES:
        names = plan.uavs if len(plan.uavs) <= MAX_NAMES else ()
        _draw(path, plan.devices, [plan.deployment], names, proof_line(plan.deployment))
    else:
        _write_text(path, _TEXTS[suffix](plan))


def write_comparison(path: Path, devices: Sequence[Device], deployments: Sequence[Deployment]) -> None:
    """Write several deployments of the same devices, as maps side by side or as CSV with a row a scheme.

    Parameters
    ----------
    path : Path
        Its suffix is one of `COMPARISON_SUFFIXES`.
    devices : sequence of Device
    deployments : sequence of Deployment

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    if path.suffix.lower() in PICTURES:
        _draw(path, devices, deployments)
        return
    rows = [
        {
            "scheme": each.scheme,
            "uavs": len(each.uav_positions),
            "uavs_needed": each.uavs_needed,
            "min_uavs_bound": _blank(each.min_uavs_bound),
            "proven_optimal": str(each.proven_optimal).lower(),
            "served": int((each.serving_uav >= 0).sum()),
            "average_uav_rate": _blank(each.average_uav_rate),
            "average_uav_rate_bound": _blank(each.average_uav_rate_bound),
            "runtime_s": each.runtime_s,
        }
        for each in deployments
    ]
    _write_text(path, _csv(rows))


def _draw(
    path: Path,
    devices: Sequence[Device],
    deployments: Sequence[Deployment],
    names: Sequence[str] = (),
    proof: str = "",
) -> None:
    positions = np.array([device.position for device in devices])
    rates = np.array([device.rate_demand for device in devices])
    with figure_style():
        figure = draw_deployments(positions, rates, deployments, names, proof)
        write(figure, path)
        plt.close(figure)


def _write_text(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    # csv ends its lines itself.
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(text)


def _plan_csv(plan: NamedPlan) -> str:
    """One row a device: what it demands, who serves it from where, and what it gets; blank where unserved."""
    deployment = plan.deployment
    rows = []
    for k, device in enumerate(plan.devices):
        uav, name = int(deployment.serving_uav[k]), plan.serving(k)
        goal = deployment.uav_positions[uav].tolist() if name else ["", ""]
        row: dict[str, Any] = {"id": device.id, "x": device.position[0], "y": device.position[1]}
        if plan.frame:
            row["latitude"], row["longitude"] = _degrees(plan, *device.position)
        row |= {
            "rate_demand": device.rate_demand,
            "weight": device.weight,
            "uav": name or "",
            "uav_x": goal[0],
            "uav_y": goal[1],
        }
        if plan.frame:
            row["uav_latitude"], row["uav_longitude"] = _degrees(plan, *goal) if name else ("", "")
        row |= {
            "uav_height_m": plan.altitude_m if name else "",
            "power_w": float(deployment.power_w[k]) if name else "",
            "rate": float(deployment.rate[k]) if name else "",
            "unserved_because": plan.unserved.get(k, ""),
        }
        rows.append(row)
    return _csv(rows)


def _degrees(plan: NamedPlan, east: float, north: float) -> tuple[float, float]:
    assert plan.frame is not None
    latitude, longitude = plan.frame.to_geodetic(east, north)
    # A tenth of a millimetre.
    return round(latitude, 9), round(longitude, 9)


def _csv(rows: Sequence[dict[str, Any]]) -> str:
    sink = StringIO()
    writer = csv.DictWriter(sink, list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)
    return sink.getvalue()


def _blank(value: float | None) -> float | str:
    return "" if value is None or math.isnan(value) else value


def _qgc_plan(plan: NamedPlan) -> dict[str, Any]:
    px4 = plan.fleet is not None and all(uav.autopilot == "px4" for uav in plan.fleet.uavs)
    return plan.picture().to_qgc_plan("px4" if px4 else "ardupilot")


def _json(data: dict[str, Any]) -> str:
    return json.dumps(data, indent=1, allow_nan=False) + "\n"


_TEXTS: dict[str, Callable[[NamedPlan], str]] = {
    ".csv": _plan_csv,
    ".geojson": lambda plan: _json(plan.picture().to_geojson()),
    ".kml": lambda plan: plan.picture().to_kml(),
    ".plan": lambda plan: _json(_qgc_plan(plan)),
}

#: Formats of a plan, of a comparison, and those that need a place on the earth.
PLAN_SUFFIXES = (*PICTURES, *_TEXTS)
COMPARISON_SUFFIXES = (*PICTURES, ".csv")
GEODETIC_SUFFIXES = (".geojson", ".kml", ".plan")

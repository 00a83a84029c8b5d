"""Keeps the plan in force as files in a folder, for ground stations and map programs."""

from __future__ import annotations

import json
import os
from pathlib import Path

from jpap_ros.mavlink.plan_files import PlanPicture

#: File names by format.
GEOJSON, KML, QGC_PLAN = "plan.geojson", "plan.kml", "plan.plan"


def write_plan(folder: Path, picture: PlanPicture, autopilot: str) -> None:
    """Write the plan in all three formats, replacing those of the plan before.

    Each file is replaced as a whole, so that whoever opens one meanwhile never reads half of it.

    Parameters
    ----------
    folder : Path
        Made if it does not exist.
    picture : PlanPicture
    autopilot : str
        `ardupilot` or `px4`: what the QGroundControl plan is for.

    Raises
    ------
    OSError
        If a file cannot be written.
    ValueError
        If a goal is not on the map.
    """
    texts = {
        GEOJSON: json.dumps(picture.to_geojson(), indent=1, allow_nan=False),
        KML: picture.to_kml(),
        QGC_PLAN: json.dumps(picture.to_qgc_plan(autopilot), indent=1, allow_nan=False),
    }
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        draft = folder / f".{name}.{os.getpid()}"
        draft.write_text(text, encoding="utf-8")
        draft.replace(folder / name)

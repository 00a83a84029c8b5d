"""The deployment as GeoJSON with the styles that Foxglove's Map panel and other Leaflet maps draw."""

from __future__ import annotations

import json
from typing import Any

from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.mavlink.plan_files import DeviceMark, PlanPicture
from jpap_ros.nodes.bridge_conversions import goal_marks
from jpap_ros.nodes.markers_conversions import Scene

# Leaflet's path options; colours as in the markers.
_STYLES = {
    "uav": {"color": "#0072B2", "weight": 4},
    "served": {"color": "#009E73", "weight": 2},
    "unserved": {"color": "#D55E00", "weight": 4},
    "link": {"color": "#8A8A8A", "weight": 1},
    "fence": {"color": "#D55E00", "weight": 2, "dashArray": "6 6", "fillOpacity": 0.0},
}


def deployment_geojson(scene: Scene, frame: LocalFrame) -> str:
    """Return a FeatureCollection (RFC 7946) of the plan in force and all known devices.

    Raises
    ------
    ValueError
        If a goal is not on the map.
    """
    plan = scene.plan
    serving = {name: cell.uav for cell in plan.cells for name in cell.device_ids} if plan is not None else {}
    goals = goal_marks(plan, scene.uavs) if plan is not None else []
    devices = [
        DeviceMark(device.id, device.position, device.rate_demand, serving.get(device.id) or None)
        for device in scene.devices
    ]
    picture = PlanPicture(frame, goals, devices, scene.fence).to_geojson()
    for feature in picture["features"]:
        feature["properties"]["style"] = _STYLES[_style(feature["properties"])]
    return json.dumps(picture, allow_nan=False)


def _style(properties: dict[str, Any]) -> str:
    if properties["kind"] != "device":
        return str(properties["kind"])
    return "unserved" if properties["uav"] is None else "served"

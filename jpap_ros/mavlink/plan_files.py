"""A plan as files that ground stations and map programs open: GeoJSON, KML and QGroundControl's `.plan`."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from jpap_ros.fleet.fence import Fence, Point
from jpap_ros.mavlink.geodesy import LocalFrame

#: Corners of the polygon that stands for a circle where a format has none; it lies 0.05 % of the radius inside.
CIRCLE_CORNERS = 100

_MAV_CMD_NAV_WAYPOINT = 16
_MAV_FRAME_GLOBAL_RELATIVE_ALT = 3
_MAV_AUTOPILOT = {"ardupilot": 3, "px4": 12}
_MAV_TYPE_QUADROTOR = 2
_QGC_ALTITUDE_RELATIVE = 1


@dataclass(frozen=True)
class GoalMark:
    """Where one UAV hovers.

    Attributes
    ----------
    uav : str
        Name.
    position_m : (east, north)
        [m], map frame.
    height_m : float
        Above the ground [m].
    """

    uav: str
    position_m: Point
    height_m: float


@dataclass(frozen=True)
class DeviceMark:
    """A device and its UAV.

    Attributes
    ----------
    id : str
    position_m : (east, north)
        [m], map frame.
    rate_demand : float
        [bit/s/Hz].
    uav : str or None
        Name of the UAV that serves it; None where unserved.
    """

    id: str
    position_m: Point
    rate_demand: float
    uav: str | None


@dataclass(frozen=True)
class PlanPicture:
    """Everything that a plan file shows.

    Attributes
    ----------
    frame : LocalFrame
        Where the map lies on the earth.
    goals : sequence of GoalMark
    devices : sequence of DeviceMark
    fence : Fence or None
    """

    frame: LocalFrame
    goals: Sequence[GoalMark]
    devices: Sequence[DeviceMark] = ()
    fence: Fence | None = None

    def to_geojson(self) -> dict[str, Any]:
        """Return a FeatureCollection (RFC 7946): points for UAVs and devices, a line for each link, the fence."""
        features = [
            _feature("Point", self._lonlat(g.position_m, g.height_m), kind="uav", name=g.uav, height_m=g.height_m)
            for g in self.goals
        ]
        features += [
            _feature(
                "Point", self._lonlat(d.position_m), kind="device", name=d.id, rate_demand=d.rate_demand, uav=d.uav
            )
            for d in self.devices
        ]
        goals = {g.uav: g for g in self.goals}
        features += [
            _feature(
                "LineString",
                [self._lonlat(goals[d.uav].position_m), self._lonlat(d.position_m)],
                kind="link",
                name=f"{d.uav} to {d.id}",
            )
            for d in self.devices
            if d.uav in goals
        ]
        if ring := self._fence_ring():
            features.append(_feature("Polygon", [[self._lonlat(p) for p in ring]], kind="fence", name="fence"))
        return {"type": "FeatureCollection", "features": features}

    def to_kml(self) -> str:
        """Return a KML 2.2 document: a folder each for UAVs, devices and the fence."""
        root = ElementTree.Element("kml", xmlns="http://www.opengis.net/kml/2.2")
        document = ElementTree.SubElement(root, "Document")
        ElementTree.SubElement(document, "name").text = "UAV deployment"
        uavs = _folder(document, "UAVs")
        for goal in self.goals:
            point = ElementTree.SubElement(_placemark(uavs, goal.uav, f"{goal.height_m:g} m above ground"), "Point")
            ElementTree.SubElement(point, "altitudeMode").text = "relativeToGround"
            ElementTree.SubElement(point, "coordinates").text = _kml([*self._lonlat(goal.position_m), goal.height_m])
        devices = _folder(document, "Devices")
        for device in self.devices:
            served = f"served by {device.uav}" if device.uav else "unserved"
            mark = _placemark(devices, device.id, f"demands {device.rate_demand:g} bit/s/Hz, {served}")
            point = ElementTree.SubElement(mark, "Point")
            ElementTree.SubElement(point, "coordinates").text = _kml(self._lonlat(device.position_m))
        if ring := self._fence_ring():
            polygon = ElementTree.SubElement(_placemark(_folder(document, "Fence"), "fence", ""), "Polygon")
            outer = ElementTree.SubElement(ElementTree.SubElement(polygon, "outerBoundaryIs"), "LinearRing")
            ElementTree.SubElement(outer, "coordinates").text = " ".join(_kml(self._lonlat(p)) for p in ring)
        ElementTree.indent(root)
        return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"

    def to_qgc_plan(self, autopilot: str = "ardupilot") -> dict[str, Any]:
        """Return a QGroundControl plan: every goal as a waypoint, for looking at, and the fence, for uploading.

        Parameters
        ----------
        autopilot : str
            `ardupilot` or `px4`.
        """
        items = []
        for number, goal in enumerate(self.goals, 1):
            latitude, longitude = self.frame.to_geodetic(*goal.position_m)
            items.append(
                {
                    "type": "SimpleItem",
                    "command": _MAV_CMD_NAV_WAYPOINT,
                    "frame": _MAV_FRAME_GLOBAL_RELATIVE_ALT,
                    "doJumpId": number,
                    "autoContinue": True,
                    "Altitude": goal.height_m,
                    "AltitudeMode": _QGC_ALTITUDE_RELATIVE,
                    "AMSLAltAboveTerrain": None,
                    "params": [0, 0, 0, None, latitude, longitude, goal.height_m],
                }
            )
        origin = self.frame.origin
        fence: dict[str, Any] = {"version": 2, "circles": [], "polygons": []}
        if self.fence and self.fence.center_m:
            circle = {"center": self.frame.to_geodetic(*self.fence.center_m), "radius": self.fence.radius_m}
            fence["circles"].append({"version": 1, "inclusion": True, "circle": circle})
        if self.fence and self.fence.polygon_m:
            corners = [self.frame.to_geodetic(*p) for p in self.fence.polygon_m]
            fence["polygons"].append({"version": 1, "inclusion": True, "polygon": corners})
        return {
            "fileType": "Plan",
            "version": 1,
            "groundStation": "QGroundControl",
            "mission": {
                "version": 2,
                "firmwareType": _MAV_AUTOPILOT[autopilot],
                "vehicleType": _MAV_TYPE_QUADROTOR,
                "globalPlanAltitudeMode": _QGC_ALTITUDE_RELATIVE,
                "cruiseSpeed": 15,
                "hoverSpeed": 5,
                "plannedHomePosition": [origin.latitude, origin.longitude, origin.altitude_amsl_m],
                "items": items,
            },
            "geoFence": fence,
            "rallyPoints": {"version": 2, "points": []},
        }

    def _lonlat(self, point: Point, height_m: float | None = None) -> list[float]:
        latitude, longitude = self.frame.to_geodetic(*point)
        # 1e-7 degrees is a centimetre, MAVLink's own unit.
        position = [round(longitude, 7), round(latitude, 7)]
        return position if height_m is None else [*position, self.frame.origin.altitude_amsl_m + height_m]

    def _fence_ring(self) -> list[Point]:
        """Closed ring, counter-clockwise as RFC 7946 asks; empty without a fence on the ground."""
        if self.fence is None:
            return []
        if self.fence.center_m is not None and self.fence.radius_m is not None:
            (east, north), radius = self.fence.center_m, self.fence.radius_m
            angles = [2 * math.pi * i / CIRCLE_CORNERS for i in range(CIRCLE_CORNERS)]
            ring = [(east + radius * math.cos(a), north + radius * math.sin(a)) for a in angles]
        else:
            ring = list(self.fence.polygon_m)
        if not ring:
            return []
        area = sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(ring, ring[1:] + ring[:1], strict=True))
        if area < 0:
            ring.reverse()
        return [*ring, ring[0]]


def _feature(geometry: str, coordinates: list[Any], **properties: Any) -> dict[str, Any]:
    return {"type": "Feature", "geometry": {"type": geometry, "coordinates": coordinates}, "properties": properties}


def _folder(parent: ElementTree.Element, name: str) -> ElementTree.Element:
    folder = ElementTree.SubElement(parent, "Folder")
    ElementTree.SubElement(folder, "name").text = name
    return folder


def _placemark(parent: ElementTree.Element, name: str, description: str) -> ElementTree.Element:
    mark = ElementTree.SubElement(parent, "Placemark")
    ElementTree.SubElement(mark, "name").text = name
    if description:
        ElementTree.SubElement(mark, "description").text = description
    return mark


def _kml(position: list[float]) -> str:
    return ",".join(f"{value:.7f}" for value in position)

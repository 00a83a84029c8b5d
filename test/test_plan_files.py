"""Plan files. Oracles: the formats' published rules, and positions worked out on WGS-84 by hand."""

from __future__ import annotations

import itertools
import json
import math
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from jpap_ros.fleet.config import MapOrigin
from jpap_ros.fleet.fence import Fence
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.mavlink.plan_files import CIRCLE_CORNERS, DeviceMark, GoalMark, PlanPicture
from jpap_ros.mavlink.plan_folder import write_plan

ORIGIN = MapOrigin(-37.8, 145.0, 20.0)
GOALS = [GoalMark("uav1", (0.0, 0.0), 50.0), GoalMark("uav2", (0.0, 1000.0), 60.0)]
DEVICES = [DeviceMark("a", (10.0, 0.0), 16.0, "uav1"), DeviceMark("b", (500.0, 500.0), 21.0, None)]
# One kilometre north at latitude -37.8 deg: the meridional radius there is a(1-e^2)/(1-e^2 sin^2)^1.5 = 6,359,413 m.
KILOMETRE_NORTH_DEG = math.degrees(1000.0 / 6_359_413.0)


def picture(fence: Fence | None = None) -> PlanPicture:
    return PlanPicture(LocalFrame(ORIGIN), GOALS, DEVICES, fence)


def test_geojson_has_longitude_first_and_a_line_for_each_link() -> None:
    data = json.loads(json.dumps(picture().to_geojson(), allow_nan=False))
    by_kind: dict[str, list[dict]] = {}
    for feature in data["features"]:
        assert feature["type"] == "Feature"
        by_kind.setdefault(feature["properties"]["kind"], []).append(feature)
    assert [f["properties"]["name"] for f in by_kind["uav"]] == ["uav1", "uav2"]
    assert by_kind["uav"][0]["geometry"]["coordinates"] == [145.0, -37.8, 70.0]
    longitude, latitude, altitude = by_kind["uav"][1]["geometry"]["coordinates"]
    assert latitude == pytest.approx(-37.8 + KILOMETRE_NORTH_DEG, abs=2e-7)
    assert (longitude, altitude) == (145.0, 80.0)
    assert [f["properties"]["uav"] for f in by_kind["device"]] == ["uav1", None]
    assert len(by_kind["link"]) == 1, "the unserved device has no link"
    assert "fence" not in by_kind


@pytest.mark.parametrize(
    ("fence", "corners"),
    [
        (Fence(center_m=(0.0, 0.0), radius_m=800.0), CIRCLE_CORNERS),
        (Fence(polygon_m=((0.0, 0.0), (0.0, 100.0), (100.0, 0.0))), 3),  # given clockwise
    ],
)
def test_geojson_rings_are_closed_and_counter_clockwise(fence: Fence, corners: int) -> None:
    # RFC 7946, section 3.1.6.
    (ring,) = picture(fence).to_geojson()["features"][-1]["geometry"]["coordinates"]
    assert ring[0] == ring[-1]
    assert len(ring) == corners + 1
    doubled_area = sum(a[0] * b[1] - b[0] * a[1] for a, b in itertools.pairwise(ring))
    assert doubled_area > 0


def test_kml_gives_heights_above_ground() -> None:
    # KML 2.2: coordinates are longitude,latitude[,altitude]; with relativeToGround the altitude is above the ground.
    space = {"k": "http://www.opengis.net/kml/2.2"}
    root = ElementTree.fromstring(picture(Fence(center_m=(0.0, 0.0), radius_m=10.0)).to_kml().encode())
    folders = root.findall("k:Document/k:Folder", space)
    assert [f.findtext("k:name", namespaces=space) for f in folders] == ["UAVs", "Devices", "Fence"]
    point = folders[0].find("k:Placemark/k:Point", space)
    assert point is not None
    assert point.findtext("k:altitudeMode", namespaces=space) == "relativeToGround"
    text = point.findtext("k:coordinates", namespaces=space)
    assert text is not None
    assert [float(part) for part in text.split(",")] == [145.0, -37.8, 50.0]
    assert len(folders[1].findall("k:Placemark", space)) == len(DEVICES)


def test_qgc_plan_has_waypoints_and_fence() -> None:
    # QGroundControl developer guide, "Plan File Format".
    plan = json.loads(json.dumps(picture(Fence(center_m=(0.0, 1000.0), radius_m=800.0)).to_qgc_plan("px4")))
    assert (plan["fileType"], plan["version"]) == ("Plan", 1)
    assert plan["mission"]["firmwareType"] == 12
    second = plan["mission"]["items"][1]
    assert (second["doJumpId"], second["command"], second["frame"]) == (2, 16, 3)
    assert second["params"][4:] == [pytest.approx(-37.8 + KILOMETRE_NORTH_DEG, abs=2e-7), pytest.approx(145.0), 60.0]
    (circle,) = plan["geoFence"]["circles"]
    assert circle["inclusion"]
    assert circle["circle"]["radius"] == 800.0
    assert circle["circle"]["center"] == [pytest.approx(-37.8 + KILOMETRE_NORTH_DEG, abs=2e-7), pytest.approx(145.0)]
    assert plan["geoFence"]["polygons"] == []


def test_a_folder_keeps_the_newest_plan_whole_in_every_format(tmp_path: Path) -> None:
    # Oracle: the files read back by the formats' own parsers, and the names of the goals put in.
    folder = tmp_path / "made" / "plans"
    write_plan(folder, PlanPicture(LocalFrame(ORIGIN), GOALS[:1]), "ardupilot")
    write_plan(folder, picture(), "px4")
    # Nothing but the three files: no draft is left behind.
    assert sorted(path.name for path in folder.iterdir()) == ["plan.geojson", "plan.kml", "plan.plan"]
    features = json.loads((folder / "plan.geojson").read_text())["features"]
    assert [f["properties"]["name"] for f in features if f["properties"]["kind"] == "uav"] == ["uav1", "uav2"]
    assert "uav2" in ElementTree.tostring(ElementTree.parse(folder / "plan.kml").getroot(), encoding="unicode")
    mission = json.loads((folder / "plan.plan").read_text())["mission"]
    assert (len(mission["items"]), mission["firmwareType"]) == (2, 12)


def test_a_plan_that_cannot_be_shown_leaves_the_files_of_the_one_before(tmp_path: Path) -> None:
    write_plan(tmp_path, picture(), "px4")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    lost = PlanPicture(LocalFrame(ORIGIN), [GoalMark("uav1", (math.nan, 0.0), 50.0)])
    with pytest.raises(ValueError, match="nan"):
        write_plan(tmp_path, lost, "px4")
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before

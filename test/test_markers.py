"""What viewers draw. One graph of the real nodes; the conversions alone where a graph cannot show a case.

Oracles: the definition of visualization_msgs/Marker and what RViz refuses (a pair of namespace and id twice, scale or
alpha 0, quaternions that are not of length 1, colours that are not as many as points); the plan that the planner
publishes; the positions that the test reports; a schema written from RFC 7946.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import jsonschema
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from graph import Graph, NodeProcess
from jpap_msgs.msg import Cell, Deployment, DeviceUpdate, UnservedDevice, VehicleState
from jpap_msgs.msg import Device as DeviceMessage
from jpap_msgs.srv import FleetCommand
from sensor_msgs.msg import NavSatFix
from std_msgs.msg import ColorRGBA, Header, String
from visualization_msgs.msg import Marker, MarkerArray

from jpap_ros.fleet.config import MapOrigin, load_fleet
from jpap_ros.fleet.fence import Fence
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.nodes.markers_conversions import MAX_LABELS, MarkerBook, Scene, draw_fleet, draw_plan
from jpap_ros.nodes.markers_geojson import deployment_geojson
from jpap_ros.nodes.qos import DEVICES, LATCHED, SENSOR_DATA
from jpap_ros.planning.devices import Device

ROOT = Path(__file__).parent.parent
SCHEMA = json.loads((Path(__file__).parent / "geojson.schema.json").read_text())
LISTS = (Marker.SPHERE_LIST, Marker.CUBE_LIST, Marker.LINE_LIST, Marker.LINE_STRIP)
SHAPES = (*LISTS, Marker.CUBE, Marker.CYLINDER, Marker.TEXT_VIEW_FACING)


def check(markers: Iterable[Marker], frame: str = "map") -> None:
    """Assert that every marker can be drawn."""
    listed = list(markers)
    assert max(Counter((m.ns, m.id) for m in listed).values(), default=1) == 1, "a pair of namespace and id twice"
    for marker in listed:
        assert marker.header.frame_id == frame
        assert marker.ns
        assert marker.action in (Marker.ADD, Marker.DELETE)
        q = marker.pose.orientation
        assert math.hypot(q.x, q.y, q.z, q.w) == pytest.approx(1.0)
        assert all(math.isfinite(v) for p in (marker.pose.position, *marker.points) for v in (p.x, p.y, p.z))
        if marker.action == Marker.DELETE:
            continue
        assert marker.type in SHAPES
        assert min(marker.scale.x, marker.scale.y, marker.scale.z) > 0
        for colour in (marker.color, *marker.colors):
            assert colour.a > 0 and all(0 <= c <= 1 for c in (colour.r, colour.g, colour.b, colour.a))
        if marker.type in LISTS:
            assert len(marker.points) >= (1 if marker.type in (Marker.SPHERE_LIST, Marker.CUBE_LIST) else 2)
            assert len(marker.colors) in (0, len(marker.points))
            assert marker.type != Marker.LINE_LIST or len(marker.points) % 2 == 0
        assert marker.type != Marker.TEXT_VIEW_FACING or marker.text


def by_namespace(markers: Iterable[Marker], action: int = Marker.ADD) -> dict[str, list[Marker]]:
    found: dict[str, list[Marker]] = {}
    for marker in markers:
        if marker.action == action:
            found.setdefault(marker.ns, []).append(marker)
    return found


# The real graph


FLEET = """
version: 1
origin: {latitude: -37.8136, longitude: 144.9631, altitude_amsl_m: 20}
defaults: {autopilot: ardupilot}
fence: {circle: {center: [0, 0], radius_m: 900}}
uavs:
"""


def test_a_deployment_from_first_report_to_departure(
    graph: Graph,
    start_node: Callable[..., NodeProcess],
    free_ports: Callable[[int], list[int]],
    tmp_path: Path,
) -> None:
    """Devices join, aircraft fly out, a device leaves: pictures and GeoJSON follow, and what is gone is deleted."""
    path = tmp_path / "fleet.yaml"
    entries = [
        f"  - {{name: uav{i}, sysid: {i}, url: 'udpin:127.0.0.1:{port}', home_m: [{20 * i}, 0]}}\n"
        for i, port in enumerate(free_ports(2), 1)
    ]
    path.write_text(FLEET + "".join(entries))
    fleet = load_fleet(path)
    parameters = {"fleet_file": str(path)}
    pictures = graph.collect(MarkerArray, "markers", LATCHED)
    geojson = graph.collect(String, "deployment_geojson", LATCHED)
    plans = graph.collect(Deployment, "deployment", LATCHED)
    fixes = graph.collect(NavSatFix, "uav1/fix", SENSOR_DATA)
    diagnostics = graph.collect(DiagnosticArray, "/diagnostics", 10)
    for executable, more in (
        ("sim", {"speedup": 10.0}),
        ("bridge", {"simulated_clock": True}),
        ("planner", {}),
        ("markers", {"rate_hz": 20.0}),
    ):
        start_node(executable, parameters | more)
    devices = graph.publisher(DeviceUpdate, "devices", DEVICES, readers=2)

    def shown() -> dict[str, list[Marker]]:
        return by_namespace(pictures[-1].markers) if pictures else {}

    places = {"near": (100.0, 50.0), "beside": (160.0, 60.0), "far": (-300.0, -200.0), "greedy": (0.0, 200.0)}
    demands = {"near": 16.0, "beside": 15.0, "far": 17.0, "greedy": 40.0}
    devices.publish(
        DeviceUpdate(
            header=Header(frame_id="map"),
            devices=[
                DeviceMessage(id=name, position=Point(x=x, y=y, z=0.0), rate_demand=demands[name])
                for name, (x, y) in places.items()
            ],
        )
    )
    graph.wait(lambda: "devices_served" in shown() and "devices_unserved" in shown(), "served and unserved devices")
    served = {(p.x, p.y) for p in shown()["devices_served"][0].points}
    assert served == {places["near"], places["beside"], places["far"]}
    assert [(p.x, p.y) for p in shown()["devices_unserved"][0].points] == [places["greedy"]]
    assert "greedy" in shown()["device_names"][0].text
    assert len(shown()["fence"]) == 1

    answer = graph.call(FleetCommand, "bridge/launch")
    assert answer.success, answer.message
    graph.wait(lambda: len(shown().get("uavs", [])) == 2, "both aircraft")
    graph.wait(lambda: shown().get("transits"), "an aircraft on its way")
    # At their goals there is no way left to draw.
    graph.wait(lambda: not shown().get("transits") and len(shown().get("links", [])) == 2, "aircraft at their goals")
    goals = {(c.goal_pose.position.x, c.goal_pose.position.y) for c in plans[-1].cells}
    assert {(m.pose.position.x, m.pose.position.y) for m in shown()["goals"]} == goals
    for marker in shown()["uavs"]:
        here = marker.pose.position
        assert min(math.dist((here.x, here.y), goal) for goal in goals) < 3.0
    # Straight above a single device there is no radius to draw.
    (circle,) = shown()["coverage"]
    assert circle.id == [c.uav for c in sorted(plans[-1].cells, key=lambda c: c.uav)].index(
        next(c.uav for c in plans[-1].cells if len(c.device_ids) == 2)
    )
    assert {m.text for m in shown()["uav_names"]} == {"uav1", "uav2"}

    # A viewer that comes now gets the whole picture at once.
    late = graph.collect(MarkerArray, "markers", LATCHED)
    graph.wait(lambda: late, "the latched picture")
    assert {"uavs", "goals", "devices_served", "fence"} <= by_namespace(late[0].markers).keys()

    features = json.loads(geojson[-1].data)["features"]
    kinds = Counter(feature["properties"]["kind"] for feature in features)
    assert kinds == {"uav": 2, "device": 4, "link": 3, "fence": 1}
    frame = LocalFrame(fleet.origin)
    for feature in features:
        if feature["properties"]["kind"] == "device":
            longitude, latitude = feature["geometry"]["coordinates"]
            place = places[feature["properties"]["name"]]
            assert frame.to_map(latitude, longitude) == pytest.approx(place, abs=0.02)

    # The same aircraft in degrees and in metres.
    graph.wait(lambda: fixes and math.isfinite(fixes[-1].altitude), "a fix with its height above the ellipsoid")
    fix = fixes[-1]
    goal = next(c.goal_pose.position for c in plans[-1].cells if c.uav == "uav1")
    assert math.dist(frame.to_map(fix.latitude, fix.longitude), (goal.x, goal.y)) < 3.0
    assert fix.position_covariance_type == NavSatFix.COVARIANCE_TYPE_UNKNOWN

    # One that leaves takes its cell with it.
    devices.publish(DeviceUpdate(header=Header(frame_id="map"), departed=["far", "greedy"]))
    graph.wait(lambda: len(shown().get("links", [])) == 1 and "devices_unserved" not in shown(), "the device to go")
    gone = [by_namespace(picture.markers, Marker.DELETE) for picture in pictures]
    deleted = {(ns, m.id) for picture in gone for ns, markers in picture.items() for m in markers}
    assert {("devices_unserved", 0), ("device_names", 0), ("transits", 0)} <= deleted
    graph.wait(lambda: geojson[-1].data.count('"kind": "device"') == 2, "GeoJSON without it")

    for picture in pictures:
        check(picture.markers)
    for message in geojson:
        jsonschema.validate(json.loads(message.data), SCHEMA)
    names = {status.name: status for array in diagnostics for status in array.status}
    assert names["/markers: picture"].level == DiagnosticStatus.OK
    assert {"/markers: picture", "/planner: deployment", "/bridge: uav1", "/bridge: uav2"} <= names.keys()


# Conversions


ORIGIN = MapOrigin(-37.8136, 144.9631, 20.0)


def pose(x: float, y: float, z: float, second: int = 5) -> PoseStamped:
    message = PoseStamped(header=Header(frame_id="map"))
    message.header.stamp.sec = second
    message.pose.position = Point(x=x, y=y, z=z)
    return message


@pytest.fixture
def scene() -> Scene:
    """Two UAVs of three have cells, one cell has no aircraft, one device is unserved, one unknown to the plan."""
    plan = Deployment(header=Header(frame_id="map"))
    plan.header.stamp.sec = 5
    plan.cells = [
        Cell(uav="b", goal_pose=pose(0.0, 0.0, 50.0).pose, device_ids=["d1", "d2"], coverage_radius_m=80.0),
        Cell(uav="c", goal_pose=pose(300.0, 0.0, 50.0).pose, device_ids=["d3"], coverage_radius_m=math.nan),
        Cell(uav="", goal_pose=pose(0.0, 300.0, 50.0).pose, device_ids=["d4"], coverage_radius_m=math.nan),
    ]
    plan.unserved = [UnservedDevice(id="d5", reason="too far")]
    devices = [Device(f"d{i}", (100.0 * i, 40.0), 15.0 + i) for i in range(1, 7)]
    found = Scene(("a", "b", "c"), Fence(polygon_m=((0.0, 0.0), (900.0, 0.0), (0.0, 900.0))), 20.0, devices, plan)
    found.poses = {"a": pose(-50.0, 0.0, 0.0), "b": pose(0.0, 0.0, 50.0), "c": pose(200.0, 10.0, 50.0)}
    found.goals = {"a": pose(9.0, 9.0, 50.0, second=4), "b": pose(0.0, 0.0, 50.0), "c": pose(300.0, 0.0, 50.0)}
    found.states = {
        "b": VehicleState(link=VehicleState.LINK_CONNECTED, goal_state=VehicleState.GOAL_REACHED, position_valid=True),
        "c": VehicleState(link=VehicleState.LINK_LOST, goal_state=VehicleState.GOAL_LOST),
    }
    return found


def drawn(scene: Scene) -> dict[str, list[Marker]]:
    markers = draw_plan(scene) + draw_fleet(scene)
    for marker in markers:
        marker.header.frame_id = "map"
    check(markers)
    return by_namespace(markers)


def test_everything_of_a_scene_is_where_it_belongs(scene: Scene) -> None:
    shown = drawn(scene)
    assert [(p.x, p.y) for p in shown["devices_served"][0].points] == [(100.0, 40.0), (200.0, 40.0), (300.0, 40.0)]
    # d4's cell has no aircraft: nobody serves it.
    assert [p.x for p in shown["devices_unserved"][0].points] == [400.0, 500.0]
    assert [p.x for p in shown["devices_waiting"][0].points] == [600.0]
    assert [m.text for m in shown["device_names"]] == ["d4: 19 not served", "d5: 20 not served"]
    assert [(m.id, m.pose.position.x) for m in shown["uavs"]] == [(0, -50.0), (1, 0.0), (2, 200.0)]
    # a's goal belongs to the plan before.
    assert [(m.id, m.pose.position.x) for m in shown["goals"]] == [(1, 0.0), (2, 300.0)]
    assert [m.pose.position.y for m in shown["open_cells"]] == [300.0]
    # b is at its goal, so only c has a way to go.
    (way,) = shown["transits"]
    assert way.id == 2
    assert [(p.x, p.y) for p in way.points] == [(200.0, 10.0), (300.0, 0.0)]
    links = {m.id: [(p.x, p.y) for p in m.points] for m in shown["links"]}
    assert links[1] == [(0.0, 0.0), (100.0, 40.0), (0.0, 0.0), (200.0, 40.0)]
    # Common radius where there is one; else as far as the farthest device: d3 is 40 m from c's goal.
    radii = {
        m.id: max(math.hypot(p.x - x, p.y) for p in m.points) for m, x in zip(shown["coverage"], (0, 300), strict=True)
    }
    assert radii == {1: pytest.approx(80.0), 2: pytest.approx(40.0)}
    assert [m.text for m in shown["uav_names"]] == ["a", "b", "c: lost"]
    assert shown["uavs"][2].color.a < shown["uavs"][1].color.a == 1.0, "where a lost one was last seen is faint"
    assert shown["uavs"][1].color != shown["uavs"][2].color
    ring = [(p.x, p.y) for p in shown["fence"][0].points]
    assert ring == [(0.0, 0.0), (900.0, 0.0), (0.0, 900.0), (0.0, 0.0)]


def test_demand_is_told_by_colour(scene: Scene) -> None:
    # viridis grows lighter from end to end.
    def luminance(colour: ColorRGBA) -> float:
        return 0.2126 * colour.r + 0.7152 * colour.g + 0.0722 * colour.b

    brightness = [luminance(colour) for colour in drawn(scene)["devices_served"][0].colors]
    assert brightness == sorted(brightness)
    # The least and the middle demand of six.
    assert brightness[-1] > brightness[0] + 0.1
    scene.devices = [replace(device, rate_demand=16.0) for device in scene.devices]
    assert len({(c.r, c.g, c.b) for c in drawn(scene)["devices_served"][0].colors}) == 1, "all alike, and no division"


def test_a_scene_of_nothing_and_one_of_nonsense(scene: Scene) -> None:
    assert drawn(Scene(("a",), None, 20.0)) == {}
    assert json.loads(deployment_geojson(Scene(("a",), None, 20.0), LocalFrame(ORIGIN)))["features"] == []
    scene.poses["b"] = pose(math.nan, 0.0, 0.0)
    scene.goals["c"] = pose(0.0, math.inf, 0.0)
    scene.plan.cells[1].goal_pose = Pose(position=Point(x=math.nan), orientation=Quaternion(w=1.0))
    scene.plan.cells[0].device_ids = ["d1", "never reported"]
    shown = drawn(scene)
    assert [m.id for m in shown["uavs"]] == [0, 2]
    assert [m.id for m in shown["goals"]] == [1]
    with pytest.raises(ValueError, match="nan"):
        deployment_geojson(scene, LocalFrame(ORIGIN))


def test_names_of_unserved_devices_are_not_endless(scene: Scene) -> None:
    scene.plan = Deployment(unserved=[UnservedDevice(id=f"d{i}", reason="") for i in range(1000)])
    scene.devices = [Device(f"d{i}", (float(i), 0.0), 16.0) for i in range(1000)]
    shown = drawn(scene)
    assert len(shown["devices_unserved"][0].points) == 1000
    assert len(shown["device_names"]) == MAX_LABELS


def test_geojson_has_styles_and_validates(scene: Scene) -> None:
    data = json.loads(deployment_geojson(scene, LocalFrame(ORIGIN)))
    jsonschema.validate(data, SCHEMA)
    colours = {f["properties"]["name"]: f["properties"]["style"]["color"] for f in data["features"]}
    assert colours["d1"] != colours["d4"] == colours["d5"], "unserved ones stand out"
    with pytest.raises(jsonschema.ValidationError):
        # The schema can say no: latitude first is wrong here.
        next(f for f in data["features"] if f["properties"]["kind"] == "device")["geometry"]["coordinates"].reverse()
        jsonschema.validate(data, SCHEMA)


def test_deletions_come_several_times_and_stop_when_the_marker_is_back() -> None:
    def marker(index: int) -> Marker:
        return Marker(ns="uavs", id=index)

    def deleted(markers: list[Marker]) -> list[int]:
        return [m.id for m in markers if m.action == Marker.DELETE]

    book = MarkerBook(repeats=3)
    assert deleted(book.with_deletions([marker(0), marker(1)])) == []
    assert not book.unfinished
    assert deleted(book.with_deletions([marker(0)])) == [1]
    assert book.unfinished
    assert deleted(book.with_deletions([marker(0), marker(1)])) == [], "it is back"
    assert [deleted(book.with_deletions([marker(0)])) for _ in range(4)] == [[1], [1], [1], []]
    assert not book.unfinished


# Files for viewers


def test_rviz_configuration_shows_the_markers_from_above() -> None:
    # Oracle: what rviz2 itself writes for these displays.
    data = yaml.safe_load((ROOT / "config" / "rviz" / "jpap.rviz").read_text())
    manager = data["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == "map"
    assert manager["Views"]["Current"]["Class"] == "rviz_default_plugins/TopDownOrtho"
    displays = {display["Class"].rpartition("/")[2]: display for display in manager["Displays"]}
    assert displays.keys() == {"Grid", "MarkerArray"}
    topic = displays["MarkerArray"]["Topic"]
    assert topic["Value"] == "markers"
    # A volatile reader would not get the latched picture.
    assert (topic["Durability Policy"], topic["Reliability Policy"]) == ("Transient Local", "Reliable")


def test_rviz_configuration_knows_every_namespace(scene: Scene) -> None:
    data = yaml.safe_load((ROOT / "config" / "rviz" / "jpap.rviz").read_text())
    (known,) = [d["Namespaces"] for d in data["Visualization Manager"]["Displays"] if "Namespaces" in d]
    assert drawn(scene).keys() == known.keys()


def panels(layout: str | dict) -> Iterator[str]:
    if isinstance(layout, str):
        yield layout
    else:
        yield from panels(layout["first"])
        yield from panels(layout["second"])


def test_foxglove_layout_names_panels_and_topics_that_exist() -> None:
    layout = json.loads((ROOT / "config" / "foxglove" / "jpap.json").read_text())
    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])
    assert {panel.partition("!")[0] for panel in layout["configById"]} >= {
        "map",
        "3D",
        "DiagnosticSummary",
        "Table",
        "Plot",
    }
    (script,) = layout["userNodes"].values()
    assert 'inputs = ["/deployment_geojson"]' in script["sourceCode"]
    # Every path into the deployment names a field of the message.
    fields = Deployment.get_fields_and_field_types()
    configs = layout["configById"].values()
    paths = [c["topicPath"] for c in configs if "topicPath" in c] + [
        p["value"] for c in configs for p in c.get("paths", [])
    ]
    assert paths
    for path in paths:
        topic, _, field = path.partition(".")
        assert topic == "/deployment"
        assert field in fields


# Wrong starts


@pytest.mark.parametrize(
    ("parameters", "words"),
    [({"fleet_file": "/nowhere.yaml"}, "/nowhere.yaml"), ({"rate_hz": 0.0}, "rate_hz"), ({"size_m": -1.0}, "size_m")],
)
def test_a_wrong_start_says_why_in_one_line(
    start_node: Callable[..., NodeProcess], parameters: dict[str, object], words: str
) -> None:
    process = start_node("markers", parameters)
    assert process.wait() == 1
    (line,) = [line for line in process.output.splitlines() if line.startswith("cannot start:")]
    assert words in line

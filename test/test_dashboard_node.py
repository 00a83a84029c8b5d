"""The dashboard as a process: what stops its start, what it makes of messages, and whose fleet it shows.

Oracle: exit status and the one line that a user sees; what a WebSocket of the test's own hears, against the messages
that the test published.
"""

from __future__ import annotations

import asyncio
import json
import math
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import aiohttp
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from graph import PATIENCE_S, Graph, NodeProcess
from jpap_msgs.msg import (
    Cell,
    Deployment,
    Device,
    DeviceUpdate,
    FleetCommandResult,
    GeoDevice,
    GeoDeviceUpdate,
    UnservedDevice,
    VehicleState,
)
from jpap_msgs.srv import FleetCommand
from std_msgs.msg import Header

from jpap_ros.nodes.dashboard_conversions import pose_of, vehicle_of
from jpap_ros.nodes.qos import DEVICES, LATCHED, SENSOR_DATA

UAVS = ["uav1", "uav2"]


@pytest.fixture(scope="module")
def fleet_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("fleet") / "fleet.yaml"
    uavs = [{"name": name, "sysid": i + 1, "url": f"udpin:127.0.0.1:{61_000 + i}"} for i, name in enumerate(UAVS)]
    origin = {"latitude": -37.8136, "longitude": 144.9631}
    fence = {"circle": {"center": [0, 0], "radius_m": 3000}}
    path.write_text(yaml.safe_dump({"version": 1, "origin": origin, "fence": fence, "uavs": uavs}))
    return path


class PageReader:
    """A page without a browser, in a thread: keeps the newest of everything, merged."""

    def __init__(self, port: int) -> None:
        self.document: dict[str, Any] = {}
        self.answers: list[dict[str, Any]] = []
        self._port = port
        self._requests: list[dict[str, Any]] = []
        self._stop = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._read()), daemon=True)
        self._thread.start()

    def ask(self, **fields: Any) -> None:
        self._requests.append({"type": "request", "id": len(self._requests), **fields})

    def close(self) -> None:
        self._stop.set()
        self._thread.join()

    async def _read(self) -> None:
        origin = f"http://127.0.0.1:{self._port}"
        asked = 0
        async with (
            aiohttp.ClientSession() as session,
            session.ws_connect(f"{origin}/ws", headers={"Origin": origin}) as page,
        ):
            await page.send_json({"type": "hello"})
            while not self._stop.is_set():
                self._take(await page.receive_json(timeout=60))
                for request in self._requests[asked:]:
                    await page.send_json(request)
                    asked += 1

    def _take(self, message: dict[str, Any]) -> None:
        if message["type"] == "answer":
            self.answers.append(message)
        elif message["type"] == "snapshot":
            self.document = message
        else:
            for key in ("uavs", "devices"):
                for name, fields in message.get(key, {}).items():
                    self.document[key][name] = {**self.document[key].get(name, {}), **(fields or {})}
                    if fields is None:
                        del self.document[key][name]
            self.document["events"] += message.get("events", [])
            self.document.update({key: message[key] for key in ("plan", "health") if key in message})


class Rig:
    def __init__(self, graph: Graph, node: NodeProcess, page: PageReader) -> None:
        self.graph, self.node, self.page = graph, node, page

    def shows(self, condition, what: str) -> None:
        def holds() -> bool:
            try:
                return condition(self.page.document)
            except (KeyError, TypeError):
                return False

        self.graph.wait(holds, f"the page to show {what}")


@pytest.fixture(scope="module")
def rig(
    ros_domain: int, free_ports: Callable[[int], list[int]], fleet_file: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Rig]:
    (port,) = free_ports(1)
    graph = Graph("bridge", namespace="/east")
    log = tmp_path_factory.mktemp("node") / "dashboard.log"
    parameters = {"fleet_file": str(fleet_file), "port": port, "update_rate_hz": 10.0}
    node = NodeProcess("dashboard", log, parameters, namespace="/east")
    try:
        graph.wait(lambda: "open http://" in node.output, "the dashboard to listen")
        page = PageReader(port)
        graph.wait(lambda: page.document, "the snapshot")
        yield Rig(graph, node, page)
        page.close()
    finally:
        node.kill()
        graph.close()


def header(frame: str = "map") -> Header:
    return Header(frame_id=frame)


def test_devices_in_metres_and_degrees_and_wrong_ones(rig: Rig) -> None:
    metres = rig.graph.publisher(DeviceUpdate, "devices", DEVICES)
    degrees = rig.graph.publisher(GeoDeviceUpdate, "geo_devices", DEVICES)
    good = Device(id="a", position=Point(x=30.0, y=-40.0), rate_demand=12.0, weight=2.0)
    wrong = Device(id="b", position=Point(x=math.nan), rate_demand=12.0, weight=1.0)
    metres.publish(DeviceUpdate(header=header(), devices=[good, wrong]))
    # The map's origin itself.
    there = GeoDevice(id="g", latitude=-37.8136, longitude=144.9631, rate_demand=5.0, weight=1.0)
    degrees.publish(GeoDeviceUpdate(devices=[there]))
    rig.shows(lambda d: d["devices"].keys() == {"a", "g"}, "both devices")
    devices = rig.page.document["devices"]
    assert devices["a"] == {
        "x": 30.0, "y": -40.0, "demand": 12.0, "weight": 2.0, "cell": None, "rate": None, "reason": ""
    }  # fmt: skip
    assert (devices["g"]["x"], devices["g"]["y"]) == (0.0, 0.0)
    rig.shows(lambda d: any("device 'b': position.x" in e["text"] for e in d["events"]), "what is wrong with b")
    metres.publish(DeviceUpdate(header=header(), departed=["g"]))
    rig.shows(lambda d: d["devices"].keys() == {"a"}, "that g has left")


def test_plan_goal_state_and_pose(rig: Rig) -> None:
    plans = rig.graph.publisher(Deployment, "deployment", LATCHED)
    states = rig.graph.publisher(VehicleState, "uav1/state", LATCHED)
    poses = rig.graph.publisher(PoseStamped, "uav1/pose", SENSOR_DATA)
    goal = Pose(position=Point(x=1.0, y=2.0, z=50.0))
    cell = Cell(
        uav="uav1", goal_pose=goal, device_ids=["a"], power_w=[10.0], rate=[13.5], uav_rate=13.5,
        coverage_radius_m=math.nan,
    )  # fmt: skip
    plans.publish(
        Deployment(
            plan_id=7, reason="1 device joined", scheme="optimal", cells=[cell], uavs_needed=1, min_uavs_bound=1,
            proven_optimal=True, unserved=[UnservedDevice(id="z", reason="too far")], average_uav_rate=13.5,
            average_uav_rate_bound=math.nan,
        )
    )  # fmt: skip
    rig.shows(lambda d: d["plan"]["id"] == 7, "the plan")
    plan = rig.page.document["plan"]
    assert (plan["proof"], plan["unserved"], plan["average_rate_bound"]) == (
        "1 UAV, proven minimum", {"z": "too far"}, None
    )  # fmt: skip
    assert plan["cells"] == [{"uav": "uav1", "at": [1.0, 2.0, 50.0], "rate": 13.5, "radius": None, "devices": 1}]
    states.publish(
        VehicleState(
            uav="uav1", link=VehicleState.LINK_CONNECTED, mode="GUIDED", landed_state=VehicleState.LANDED_IN_AIR,
            battery_remaining=math.nan, goal_state=VehicleState.GOAL_YIELDED, goal_reason="mode became LOITER",
            goal_distance_m=math.nan,
        )
    )  # fmt: skip
    rig.shows(lambda d: d["uavs"]["uav1"]["taken_over"], "that uav1 was taken over")
    uav = rig.page.document["uavs"]["uav1"]
    assert (uav["battery"], uav["distance"], uav["goal_at"]) == (None, None, [1.0, 2.0, 50.0])
    # Half of a right angle to the left of east is north-east: 45 degrees.
    turn = Quaternion(z=math.sin(math.pi / 8), w=math.cos(math.pi / 8))
    poses.publish(PoseStamped(pose=Pose(position=Point(x=5.0, y=6.0, z=7.0), orientation=turn)))
    rig.shows(lambda d: d["uavs"]["uav1"]["heading"] == 45, "the pose")
    assert rig.page.document["uavs"]["uav1"]["x"] == 5.0


def test_only_diagnostics_of_its_own_fleet_are_shown(rig: Rig) -> None:
    out = rig.graph.publisher(DiagnosticArray, "/diagnostics")

    def status(name: str, message: str, **values: str) -> DiagnosticStatus:
        pairs = [KeyValue(key=key.replace("_", " "), value=value) for key, value in values.items()]
        return DiagnosticStatus(name=name, level=DiagnosticStatus.ERROR, message=message, values=pairs)

    message = DiagnosticArray(
        status=[
            status("/west/bridge: link x", "of another fleet"),
            status("/east/bridge: link x", "7 frames/s refused"),
            status("/east/other: disk", "the disk is full"),
        ]
    )

    # Once it knows that this test's node plays the bridge.
    def known(document: dict[str, Any]) -> bool:
        out.publish(message)
        return "refused" in document["health"]["bridge"]["message"]

    rig.shows(known, "the link's trouble")
    rig.shows(lambda d: [o["message"] for o in d["health"]["others"]] == ["the disk is full"], "the other node's")
    assert "another fleet" not in json.dumps(rig.page.document)


def test_orders_reach_the_bridge_and_its_absence_is_said(rig: Rig) -> None:
    asked: list[list[str]] = []

    def hold(request: FleetCommand.Request, response: FleetCommand.Response) -> FleetCommand.Response:
        asked.append(list(request.uavs))
        response.results = [FleetCommandResult(uav=name, success=True, message="holds") for name in request.uavs]
        response.success, response.message = True, "2 of 2 UAVs"
        return response

    rig.page.ask(action="land", uavs=["uav1"])
    rig.graph.wait(lambda: len(rig.page.answers) == 1, "an answer")
    assert rig.page.answers[0]["message"] == "/east/bridge/land is not there: is its node running?"
    rig.graph.node.create_service(FleetCommand, "bridge/hold", hold)

    def held() -> bool:
        if not asked:
            rig.page.ask(action="hold", uavs=UAVS)
            rig.graph.spin(0.3)
        return bool(asked) and rig.page.answers[-1]["ok"]

    rig.graph.wait(held, "the order to arrive")
    assert asked[0] == UAVS
    assert rig.page.answers[-1]["results"][0] == {"uav": "uav1", "ok": True, "message": "holds"}
    # Off unless it is switched on.
    count = len(rig.page.answers)
    rig.page.ask(action="remove_device", device="a")
    rig.graph.wait(lambda: len(rig.page.answers) > count, "an answer")
    assert "exercise:=true" in rig.page.answers[-1]["message"]
    assert rig.node.process.poll() is None


@pytest.mark.parametrize(
    ("parameters", "says"),
    [
        ({"host": "0.0.0.0"}, "parameter host '0.0.0.0' can be reached from other machines: set token_file"),
        ({"host": "fleet.example"}, "parameter host must be an IP address or localhost, got 'fleet.example'"),
        ({"token_file": "/nowhere/token"}, "parameter token_file /nowhere/token: cannot be read: No such file"),
        ({"tile_url": "tiles/{z}"}, "parameter tile_url: must be an http or https address with {z}, {x} and {y}"),
        ({"tile_url": "http://a/{z}/{x}/{y}; script-src *"}, "parameter tile_url: must be an http"),
        ({"update_rate_hz": 50.0}, "update_rate_hz"),
        ({"fleet_file": "/nowhere.yaml"}, "/nowhere.yaml: cannot be read"),
        ({"port": "taken"}, "cannot listen on 127.0.0.1 port"),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, dict) else "",
)
def test_a_wrong_parameter_stops_the_start_in_one_line(start_node, fleet_file, parameters, says) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        if "port" in parameters:
            parameters = {"port": taken.getsockname()[1]}
        node = start_node("dashboard", {"fleet_file": str(fleet_file), "port": 0, **parameters})
        assert node.wait() == 1
    lines = [line for line in node.output.splitlines() if line]
    assert len(lines) == 1 and lines[0].startswith("cannot start: ") and says in lines[0]


def test_the_demo_serves_the_page_while_it_runs(ros_domain: int, free_ports, tmp_path: Path) -> None:
    (port,) = free_ports(1)
    command = [sys.executable, "-m", "jpap_ros.demo", "--dashboard", str(port), "--out", str(tmp_path)]
    demo = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)
    try:
        assert demo.stdout is not None
        told = next(line for line in demo.stdout if "dashboard" in line)
        assert told == f"dashboard: http://127.0.0.1:{port}/\n"
        deadline = time.monotonic() + PATIENCE_S
        while b"jpap_ros dashboard" not in fetched(port):
            assert time.monotonic() < deadline and demo.poll() is None
            time.sleep(0.1)
        demo.send_signal(signal.SIGINT)
        assert demo.wait(PATIENCE_S) == 130
        assert fetched(port) == b""
    finally:
        if demo.poll() is None:
            os.killpg(demo.pid, signal.SIGKILL)
        demo.wait()


def fetched(port: int) -> bytes:
    """What the server answers, or nothing while none listens."""
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=5) as answer:
            return answer.read()
    except OSError:
        return b""


@pytest.mark.parametrize(
    ("remaining", "charge_state", "low"), [(0.03, 1, True), (0.31, 1, False), (0.31, 2, True), (math.nan, 0, False)]
)
def test_a_battery_is_low_by_its_charge_or_by_the_autopilots_word(
    remaining: float, charge_state: int, low: bool
) -> None:
    # Oracle: the planner's low_battery, 30 %.
    state = VehicleState(battery_remaining=remaining, battery_charge_state=charge_state)
    assert vehicle_of(state).battery_low is low


def test_numbers_of_a_newer_bridge_read_as_unknown() -> None:
    vehicle = vehicle_of(VehicleState(link=77, landed_state=77, goal_state=77))
    assert (vehicle.link, vehicle.landed, vehicle.goal) == ("never seen", "undefined", "none")


@pytest.mark.parametrize(("yaw_deg", "heading_deg"), [(0.0, 90.0), (90.0, 0.0), (180.0, 270.0), (-90.0, 180.0)])
def test_headings(yaw_deg: float, heading_deg: float) -> None:
    # Oracle: REP 103, yaw counterclockwise from east; a compass counts clockwise from north.
    half = math.radians(yaw_deg) / 2
    pose = PoseStamped(pose=Pose(orientation=Quaternion(z=math.sin(half), w=math.cos(half))))
    assert pose_of(pose).heading_deg % 360 == pytest.approx(heading_deg)

"""The bridge as a process, on real DDS and real MAVLink to simulated vehicles.

Oracle: the simulated vehicles' own record, which reaches the test without the bridge.
"""

from __future__ import annotations

import json
import math
import signal
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from graph import Graph, NodeProcess
from jpap_msgs.msg import Cell, Deployment, VehicleState
from jpap_msgs.srv import FleetCommand
from rclpy.publisher import Publisher
from sim_peer import Peer

from jpap_ros.fleet.config import FleetConfig, load_fleet
from jpap_ros.nodes.qos import LATCHED, SENSOR_DATA
from jpap_ros.sim import SimFleet, VehicleOptions

SERVICES = ("launch", "hold", "return_home", "land")


@pytest.fixture
def fleet_file(tmp_path: Path, free_ports: Callable[[int], list[int]]) -> Path:
    uavs = [
        {"name": f"uav{i}", "sysid": i, "url": f"udpin:127.0.0.1:{port}", "home_m": [20.0 * (i - 1), 0.0]}
        for i, port in enumerate(free_ports(2), 1)
    ]
    path = tmp_path / "fleet.yaml"
    origin = {"latitude": -37.8136, "longitude": 144.9631, "altitude_amsl_m": 20.0}
    fence = {"circle": {"center": [0, 0], "radius_m": 5000}, "max_height_m": 120}
    path.write_text(yaml.safe_dump({"version": 1, "origin": origin, "fence": fence, "uavs": uavs}))
    return path


@pytest.fixture
def fleet(fleet_file: Path) -> FleetConfig:
    return load_fleet(fleet_file)


@pytest.fixture
def sim(fleet: FleetConfig) -> Iterator[SimFleet]:
    with SimFleet(fleet, speedup=10.0, options={"uav2": VehicleOptions(refuse_arming=True)}) as vehicles:
        yield vehicles


class Ears:
    """What the test hears of the bridge."""

    def __init__(self, graph: Graph, names: tuple[str, ...]) -> None:
        self.graph = graph
        self.states = {n: graph.collect(VehicleState, f"{n}/state", LATCHED) for n in names}
        self.poses = {n: graph.collect(PoseStamped, f"{n}/pose", SENSOR_DATA) for n in names}
        self.diagnostics = graph.collect(DiagnosticArray, "/diagnostics")

    def until(self, uav: str, condition: Callable[[VehicleState], bool], what: str) -> VehicleState:
        self.graph.wait(lambda: bool(self.states[uav]) and condition(self.states[uav][-1]), f"{uav}: {what}")
        return self.states[uav][-1]


def goal(graph: Graph, east: float, north: float, up: float, frame: str = "map", **orientation: float) -> PoseStamped:
    message = PoseStamped(pose=Pose(position=Point(x=east, y=north, z=up), orientation=Quaternion(**orientation)))
    message.header.frame_id = frame
    message.header.stamp = graph.node.get_clock().now().to_msg()
    return message


def plan(stamp: Any, plan_id: int, *uavs: str) -> Deployment:
    message = Deployment(plan_id=plan_id, cells=[Cell(uav=uav) for uav in uavs])
    message.header.stamp = stamp
    message.header.frame_id = "map"
    return message


def publisher(graph: Graph, kind: type, topic: str) -> Publisher:
    return graph.publisher(kind, topic, LATCHED)


def test_from_goal_to_hover_and_back_to_hold(
    graph: Graph, start_node: Callable[..., NodeProcess], fleet_file: Path, fleet: FleetConfig, sim: SimFleet
) -> None:
    ears = Ears(graph, fleet.names)
    bridge = start_node("bridge", {"fleet_file": str(fleet_file), "simulated_clock": True, "plan_timeout_s": 0.0})
    goals, plans = publisher(graph, PoseStamped, "uav1/goal_pose"), publisher(graph, Deployment, "deployment")

    first = goal(graph, 30.0, 40.0, 50.0)
    goals.publish(first)
    plans.publish(plan(first.header.stamp, 7, "uav1"))
    # Between the first heartbeat and the next look at the aircraft the reason is still that there was none.
    waiting = ears.until(
        "uav1",
        lambda s: s.goal_plan_id == 7 and bool(s.autopilot) and "bridge/launch" in s.goal_reason,
        "launch awaited",
    )
    assert (waiting.goal_state, waiting.armed) == (VehicleState.GOAL_NONE, False)
    assert not sim["uav1"].armed, "nobody asked for a launch"

    answer = graph.call(FleetCommand, "bridge/launch")
    results = {result.uav: result for result in answer.results}
    assert list(results) == ["uav1", "uav2"] and not answer.success
    assert results["uav1"].success, results
    # The autopilot's own words reach the operator.
    assert not results["uav2"].success and "Arming disabled" in results["uav2"].message
    assert "uav2" in answer.message

    reached = ears.until("uav1", lambda s: s.goal_state == VehicleState.GOAL_REACHED, "reached")
    assert (reached.goal_plan_id, reached.mode, reached.autopilot, reached.armed) == (7, "GUIDED", "ardupilot", True)
    assert reached.link == VehicleState.LINK_CONNECTED and reached.landed_state == VehicleState.LANDED_IN_AIR
    assert reached.goal_distance_m <= 1.0 and reached.header.frame_id == "map"
    assert math.dist(sim["uav1"].position, (30.0, 40.0, 50.0)) < 1.5
    assert reached.altitude_amsl_m == pytest.approx(70.0, abs=1.5)
    assert reached.relative_altitude_m == pytest.approx(50.0, abs=1.5)

    def pose_is_true() -> bool:
        here = ears.poses["uav1"][-1].pose.position
        return math.dist((here.x, here.y, here.z), sim["uav1"].position) < 0.1

    graph.wait(pose_is_true, "a pose where the aircraft is")
    assert ears.poses["uav1"][-1].header.frame_id == "map"

    # A newer plan without this aircraft: it holds where it is.
    plans.publish(plan(graph.node.get_clock().now().to_msg(), 8, "uav2"))
    held = ears.until("uav1", lambda s: s.goal_state == VehicleState.GOAL_NONE, "no goal")
    assert held.goal_reason == "no cell in plan 8" and math.isnan(held.goal_distance_m)

    # A goal in another frame is refused and not flown.
    goals.publish(goal(graph, 500.0, 0.0, 50.0, frame="odom"))
    refused = ears.until("uav1", lambda s: s.goal_state == VehicleState.GOAL_REJECTED, "rejected")
    assert "'map'" in refused.goal_reason and "'odom'" in refused.goal_reason
    assert math.dist(sim["uav1"].position, (30.0, 40.0, 50.0)) < 3.0

    status = graph.wait(
        lambda: next(
            (s for d in ears.diagnostics for s in d.status if s.name == "/bridge: uav1" and "frame_id" in s.message),
            None,
        ),
        "a diagnostic of the refused goal",
    )
    assert status.level == DiagnosticStatus.WARN and status.hardware_id == "MAVLink system 1"

    assert graph.call(FleetCommand, "bridge/land", FleetCommand.Request(uavs=["uav1"])).success
    ears.until("uav1", lambda s: not s.armed, "landed")
    assert bridge.stop() == 0
    assert "Traceback" not in bridge.output
    assert "takes off only on bridge/launch" in bridge.output


def test_a_pilot_keeps_the_aircraft_until_an_operator_asks(
    graph: Graph, start_node: Callable[..., NodeProcess], fleet_file: Path, fleet: FleetConfig, sim: SimFleet
) -> None:
    ears = Ears(graph, fleet.names)
    goals = graph.node.create_publisher(PoseStamped, "uav1/goal_pose", LATCHED)
    # Latched before there is a bridge: a late one gets it.
    goals.publish(goal(graph, 2000.0, 0.0, 50.0))
    # Goals by hand: no planner is to be missed.
    bridge = start_node("bridge", {"fleet_file": str(fleet_file), "plan_timeout_s": 0.0})
    assert graph.call(FleetCommand, "bridge/launch", FleetCommand.Request(uavs=["uav1"])).success
    ears.until("uav1", lambda s: s.goal_state == VehicleState.GOAL_EN_ROUTE, "en route")
    sim["uav1"].pilot_takes("LOITER")
    yielded = ears.until("uav1", lambda s: s.goal_state == VehicleState.GOAL_YIELDED, "yielded")
    assert yielded.mode == "LOITER" and "LOITER" in yielded.goal_reason
    with sim["uav1"].lock:
        sim["uav1"].received.clear()
    goals.publish(goal(graph, 0.0, 100.0, 50.0))
    graph.spin(2.0)
    with sim["uav1"].lock:
        kinds = {r.kind for r in sim["uav1"].received}
    assert kinds <= {"HEARTBEAT"}, "nothing but heartbeats for the pilot's aircraft"
    assert graph.call(FleetCommand, "bridge/launch", FleetCommand.Request(uavs=["uav1"])).success
    ears.until("uav1", lambda s: s.goal_state == VehicleState.GOAL_REACHED, "reached")
    assert math.dist(sim["uav1"].position, (0.0, 100.0, 50.0)) < 1.5
    assert bridge.stop(signal.SIGTERM) == 0


def test_a_planner_that_falls_silent_means_hold(
    graph: Graph, start_node: Callable[..., NodeProcess], fleet_file: Path, fleet: FleetConfig, sim: SimFleet
) -> None:
    """The test plays the planner: it publishes the deployment, and diagnostics under its own node's name."""
    ears = Ears(graph, fleet.names)
    start_node("bridge", {"fleet_file": str(fleet_file), "simulated_clock": True, "plan_timeout_s": 3.0})
    goals, plans = publisher(graph, PoseStamped, "uav1/goal_pose"), publisher(graph, Deployment, "deployment")
    diagnostics = graph.publisher(DiagnosticArray, "/diagnostics", readers=2)
    alive = DiagnosticArray(status=[DiagnosticStatus(name=f"{graph.node.get_fully_qualified_name()}: deployment")])
    heartbeat = graph.node.create_timer(0.2, lambda: diagnostics.publish(alive))
    far = goal(graph, 4500.0, 0.0, 50.0)
    goals.publish(far)
    plans.publish(plan(far.header.stamp, 7, "uav1"))
    assert graph.call(FleetCommand, "bridge/launch", FleetCommand.Request(uavs=["uav1"])).success
    ears.until("uav1", lambda s: s.goal_state == VehicleState.GOAL_EN_ROUTE, "en route")
    graph.spin(4.0)
    assert ears.states["uav1"][-1].goal_state == VehicleState.GOAL_EN_ROUTE, "longer than the time-out, but alive"
    heartbeat.cancel()
    held = ears.until("uav1", lambda s: s.goal_state == VehicleState.GOAL_NONE, "holds")
    assert "planner silent" in held.goal_reason and held.goal_plan_id == 7


def test_goals_that_nobody_answers_for_mean_hold(
    graph: Graph, start_node: Callable[..., NodeProcess], fleet_file: Path, fleet: FleetConfig, sim: SimFleet
) -> None:
    """A goal whose deployment does not come; then a latched deployment with an old stamp, as a hung planner leaves it.

    Oracle: `plan_timeout_s` after the first goal, which is the only sign of life here until another goal comes.
    """
    ears = Ears(graph, fleet.names)
    start_node("bridge", {"fleet_file": str(fleet_file), "simulated_clock": True, "plan_timeout_s": 3.0})
    goals, plans = publisher(graph, PoseStamped, "uav1/goal_pose"), publisher(graph, Deployment, "deployment")
    far = goal(graph, 4500.0, 0.0, 50.0)
    far.header.stamp.sec -= 3600
    goals.publish(far)
    assert graph.call(FleetCommand, "bridge/launch", FleetCommand.Request(uavs=["uav1"])).success
    ears.until("uav1", lambda s: "planner silent" in s.goal_reason, "holds")
    plans.publish(plan(far.header.stamp, 7, "uav1"))
    held = ears.until("uav1", lambda s: s.goal_plan_id == 7, "the deployment is known")
    graph.spin(1.5)
    assert "planner silent" in held.goal_reason and "planner silent" in ears.states["uav1"][-1].goal_reason
    # Who sends goals by hand answers for them each time.
    goals.publish(goal(graph, 4500.0, 10.0, 50.0))
    ears.until("uav1", lambda s: s.goal_state == VehicleState.GOAL_EN_ROUTE, "flies on")


def test_unknown_names_and_vehicles_never_heard(
    graph: Graph, start_node: Callable[..., NodeProcess], fleet_file: Path, fleet: FleetConfig
) -> None:
    ears = Ears(graph, fleet.names)
    bridge = start_node("bridge", {"fleet_file": str(fleet_file), "ready_timeout_s": 0.5})
    for service in SERVICES:
        answer = graph.call(FleetCommand, f"bridge/{service}", FleetCommand.Request(uavs=["nobody", "uav1"]))
        messages = {result.uav: result.message for result in answer.results}
        assert not answer.success
        assert "no UAV named 'nobody'" in messages["nobody"] and "uav1, uav2" in messages["nobody"]
        assert "never heard" in messages["uav1"]
    never = ears.until("uav1", lambda s: True, "a state")
    assert never.link == VehicleState.LINK_NEVER_SEEN
    assert not never.position_valid and never.autopilot == "" and math.isnan(never.battery_remaining)
    assert bridge.stop() == 0


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"sysid": 1}, "sysid 1 is that of uav1"),
        ({"sysid": 255}, "sysid"),
        ({"transport": "pigeon"}, "transport must be one of setpoint, reposition, got 'pigeon'"),
        ({"arrival_radius_m": -1.0}, "arrival_radius_m"),
        ({"fleet_file": "/nonexistent.yaml"}, "/nonexistent.yaml"),
    ],
)
def test_a_wrong_start_says_why_in_one_line(
    start_node: Callable[..., NodeProcess], fleet_file: Path, parameters: dict[str, Any], words: str
) -> None:
    bridge = start_node("bridge", {"fleet_file": str(fleet_file), **parameters})
    assert bridge.wait() == 1
    line = bridge.output.strip().splitlines()[-1]
    assert line.startswith("cannot start: ") and words in line
    assert "Traceback" not in bridge.output


def test_a_port_in_use_is_named(start_node: Callable[..., NodeProcess], fleet_file: Path, fleet: FleetConfig) -> None:
    url = fleet.uavs[0].urls[0]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind((url.host, url.port))
        bridge = start_node("bridge", {"fleet_file": str(fleet_file)})
        assert bridge.wait() == 1
    assert str(url.port) in bridge.output.strip().splitlines()[-1]


@pytest.fixture
def station(fleet_file: Path, free_ports: Callable[[int], list[int]]) -> Iterator[Peer]:
    """Return a ground station's socket, which the fleet file now names."""
    with Peer.udp(*free_ports(1)) as peer:
        fleet = yaml.safe_load(fleet_file.read_text())
        fleet_file.write_text(yaml.safe_dump({**fleet, "gcs_urls": [f"udpout:127.0.0.1:{peer.port}"]}))
        yield peer


def test_each_plan_is_told_and_kept_as_files_and_trouble_with_them_is_told_once(
    graph: Graph, start_node: Callable[..., NodeProcess], fleet_file: Path, tmp_path: Path, station: Peer
) -> None:
    """Oracle: positions of the goals that the test publishes; 111.2 km to a degree of latitude, within 1 %."""
    folder = tmp_path / "plans"
    bridge = start_node("bridge", {"fleet_file": str(fleet_file), "plan_dir": str(folder)})
    plans = publisher(graph, Deployment, "deployment")

    def publish(plan_id: int) -> None:
        message = plan(graph.node.get_clock().now().to_msg(), plan_id, "uav1", "")
        message.cells[0].goal_pose = Pose(position=Point(x=0.0, y=1000.0, z=60.0))
        plans.publish(message)

    publish(1)
    shown = graph.wait(lambda: (folder / "plan.plan").exists() and json.loads((folder / "plan.plan").read_text()), "it")
    (item,) = shown["mission"]["items"]
    assert item["params"][4] == pytest.approx(-37.8136 + 1.0 / 111.2, abs=1e-4)
    assert (item["params"][5], item["Altitude"]) == (pytest.approx(144.9631, abs=1e-7), 60.0)
    (circle,) = shown["geoFence"]["circles"]
    assert circle["circle"]["radius"] == 5000
    kinds = [f["properties"]["kind"] for f in json.loads((folder / "plan.geojson").read_text())["features"]]
    assert kinds == ["uav", "fence"], "a cell without an aircraft is not shown"

    # From now on the folder's place is taken by a file.
    for path in folder.iterdir():
        path.unlink()
    folder.rmdir()
    folder.write_text("")
    states = graph.collect(VehicleState, "uav1/state", LATCHED)
    goals = publisher(graph, PoseStamped, "uav1/goal_pose")
    publish(2)
    goals.publish(goal(graph, 0.0, 1000.0, 62.0))
    graph.wait(lambda: "plan_dir: plan 2 cannot be written" in bridge.output, "the trouble in the log")
    publish(3)
    station.wait(lambda m: m.get_type() == "STATUSTEXT" and m.text.startswith("Plan 3"))
    publish(3)
    goals.publish(goal(graph, 0.0, 1000.0, 63.0))
    # The bridge goes on: a plan that leaves the aircraft out still reaches it, after the plans before.
    plans.publish(plan(graph.node.get_clock().now().to_msg(), 4))
    graph.wait(lambda: bool(states) and states[-1].goal_reason == "no cell in plan 4", "the newest plan")
    assert bridge.stop() == 0
    assert bridge.output.count("cannot be written") == 1
    while station.hear(0.1):
        pass
    told = [message.text for message in station.heard if message.get_type() == "STATUSTEXT"]
    assert told == [f"Plan {plan_id}: 0 devices, 0 E 1000 N 60 m up" for plan_id in (1, 2, 3)], "each change once"

"""A recorded planner's inputs, told to a fresh planner: the same plans, by the test's own comparison."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Point
from graph import Graph, NodeProcess
from jpap_msgs.msg import Deployment, Device, DeviceUpdate, GeoDevice, GeoDeviceUpdate, VehicleState
from mcap_files import of_topic, whole
from rcl_interfaces.srv import GetParameters
from rclpy.qos import QoSProfile

from jpap_ros.nodes.qos import DEVICES, LATCHED
from jpap_ros.nodes.replay_steps import differences, state_rounds, steps_of
from jpap_ros.report.flight_reader import DEPLOYMENT, STATE
from jpap_ros.report.flight_reader import DEVICES as DEVICES_TYPE
from jpap_ros.report.recording import Recording, Told

UAVS = ("uav1", "uav2", "uav3", "uav4")
#: Deterministic: with a plan from scratch behind every change, what comes about depends on when the next event comes.
PLANNER = {"scheme": "optimal", "reoptimise": False, "debounce_s": 0.3, "debounce_max_s": 60.0}
#: All plans, also where they come faster than a busy test takes them.
PLANS = QoSProfile(depth=1000, reliability=LATCHED.reliability, durability=LATCHED.durability)


@pytest.fixture
def fleet_file(tmp_path: Path) -> Path:
    path = tmp_path / "fleet.yaml"
    uavs = [{"name": name, "sysid": i, "url": f"udpin:127.0.0.1:{14550 + i}"} for i, name in enumerate(UAVS, 1)]
    path.write_text(
        yaml.safe_dump({"version": 1, "origin": {"latitude": -37.8136, "longitude": 144.9631}, "uavs": uavs})
    )
    return path


def device(name: str, east: float, north: float, demand: float = 16.0) -> Device:
    return Device(id=name, position=Point(x=east, y=north), rate_demand=demand)


def joined(*devices: Device, departed: tuple[str, ...] = ()) -> DeviceUpdate:
    update = DeviceUpdate(devices=list(devices), departed=list(departed))
    update.header.frame_id = "map"
    return update


def state(uav: str, east: float, north: float, **fields: Any) -> VehicleState:
    return VehicleState(
        uav=uav,
        link=VehicleState.LINK_CONNECTED,
        landed_state=VehicleState.LANDED_IN_AIR,
        position_valid=True,
        position=Point(x=east, y=north, z=50.0),
        **fields,
    )


def cells(plan: Any) -> dict[frozenset[str], tuple[str, tuple[float, float, float]]]:
    """A plan for comparison: which devices together, by whom, from where."""
    return {
        frozenset(cell.device_ids): (
            cell.uav,
            (cell.goal_pose.position.x, cell.goal_pose.position.y, cell.goal_pose.position.z),
        )
        for cell in plan.cells
    }


def devices_of(plan: Deployment) -> set[str]:
    return {name for cell in plan.cells for name in cell.device_ids} | {entry.id for entry in plan.unserved}


def assert_same(recorded: list[Any], made: list[Any]) -> None:
    assert len(made) == len(recorded)
    for one, other in zip(map(cells, recorded), map(cells, made), strict=True):
        assert one.keys() == other.keys()
        for devices in one:
            assert one[devices][0] == other[devices][0]
            assert math.dist(one[devices][1], other[devices][1]) <= 1e-6


def parameters(graph: Graph, node: str, *names: str) -> list[Any]:
    client = graph.node.create_client(GetParameters, f"{node}/get_parameters")
    graph.wait(client.service_is_ready, "the planner's parameters")
    answer = client.call_async(GetParameters.Request(names=list(names)))
    graph.wait(answer.done, "the planner's parameters")
    return [value.double_value for value in answer.result().values]


def fly_and_record(graph: Graph, start_node: Callable[..., NodeProcess], fleet_file: Path, folder: Path) -> Path:
    """Let a planner answer joins, moves, a change of demand, a leave and the loss of an aircraft, while recording."""
    recorder = start_node("recorder", {"fleet_file": str(fleet_file), "folder": str(folder)})
    planner = start_node("planner", {"fleet_file": str(fleet_file), **PLANNER})
    # Planner and recorder, both.
    devices = graph.publisher(DeviceUpdate, "devices", DEVICES, readers=2)
    geo_devices = graph.publisher(GeoDeviceUpdate, "geo_devices", DEVICES, readers=2)
    states = {uav: graph.publisher(VehicleState, f"{uav}/state", LATCHED, readers=2) for uav in UAVS}
    plans = graph.collect(Deployment, "deployment", PLANS)
    for i, uav in enumerate(UAVS):
        states[uav].publish(state(uav, 200.0 * i, -50.0))
    graph.spin(0.5)

    def answered(devices: str, what: str) -> None:
        """Wait for a plan for exactly these devices, then until no other comes."""
        before = len(plans)
        graph.wait(lambda: any(devices_of(plan) == set(devices) for plan in plans[before:]), what)
        graph.spin(0.5)

    devices.publish(joined(device("a", 0.0, 0.0), device("b", 60.0, 20.0, 15.5), device("c", 700.0, -40.0, 17.0)))
    answered("abc", "a plan for the first devices")
    states["uav1"].publish(state("uav1", 30.0, 10.0))
    # Two reports at once, which may be one plan.
    devices.publish(joined(device("d", 330.0, 0.0, 15.0)))
    devices.publish(joined(device("e", -200.0, 250.0, 18.0)))
    answered("abcde", "a plan for two more")
    geo_devices.publish(
        GeoDeviceUpdate(devices=[GeoDevice(id="g", latitude=-37.8130, longitude=144.9640, rate_demand=15.0)])
    )
    answered("abcdeg", "a plan for the device reported in degrees")
    devices.publish(joined(device("a", 20.0, -30.0), device("c", 700.0, -40.0, 16.5)))
    answered("abcdeg", "a plan for what moved and changed its demand")
    holder = next(cell.uav for cell in plans[-1].cells if "c" in cell.device_ids)
    lost = state(holder, 700.0, -40.0)
    lost.link = VehicleState.LINK_LOST
    states[holder].publish(lost)
    answered("abcdeg", "a plan without the aircraft that was lost")
    devices.publish(joined(departed=("b", "e")))
    answered("acdg", "a plan for those who stay")
    assert planner.stop() == 0 and recorder.stop() == 0
    (path,) = folder.glob("*.mcap")
    return path


@pytest.mark.timeout(500)
def test_a_planner_told_the_same_plans_the_same(
    graph: Graph, start_node: Callable[..., NodeProcess], fleet_file: Path, tmp_path: Path
) -> None:
    path = fly_and_record(graph, start_node, fleet_file, tmp_path / "recordings")
    recorded = of_topic(whole(path), "/deployment")
    count = len(recorded)
    assert count >= 6 and len({frozenset(cells(plan)) for plan in recorded}) > 3, "plans must differ"

    # As fast as the planner answers; in a namespace of its own, since the test's reports are still latched here.
    again = Graph("again", namespace="/again")
    plans = again.collect(Deployment, "deployment", PLANS)
    planner = start_node("planner", {"fleet_file": str(fleet_file), **PLANNER}, namespace="/again")
    replay = start_node("replay", {"recording": [str(path)]}, namespace="/again")
    again.wait(lambda: replay.process.poll() is not None, "the replay ends by itself")
    assert replay.wait() == 0, replay.output
    assert f"{count} of {count} plans are the same" in replay.output
    again.wait(lambda: len(plans) == count, "the test has heard every plan")
    assert_same(recorded, plans)
    # The replay leaves the planner as it was.
    assert parameters(again, "/again/planner", "debounce_s", "debounce_max_s") == [0.3, 60.0]
    assert planner.stop() == 0
    again.close()

    # At the recorded times, which are those of the test's waits between plans.
    start_node("planner", {"fleet_file": str(fleet_file), **PLANNER}, namespace="/in_time")
    began = time.monotonic()
    replay = start_node("replay", {"recording": [str(path)], "rate": 1.0}, namespace="/in_time")
    graph.wait(lambda: replay.process.poll() is not None, "the replay ends by itself")
    reports = [m.publish_ns for m in whole(path) if m.topic in ("/devices", "/geo_devices")]
    assert time.monotonic() - began > (max(reports) - min(reports)) * 1e-9
    assert replay.wait() == 0, replay.output

    # To a planner of another scheme, which is told apart.
    told = graph.collect(DiagnosticArray, "/diagnostics")
    start_node("planner", {"fleet_file": str(fleet_file), **PLANNER, "scheme": "kmeans_epa"}, namespace="/other")
    other = start_node("replay", {"recording": [str(path)], "patience_s": 5.0}, namespace="/other")
    graph.wait(lambda: other.process.poll() is not None, "the other replay ends by itself")
    assert other.wait() == 3, other.output
    assert "another:" in other.output and f"{count} of {count}" not in other.output
    replays = [status for array in told for status in array.status if status.name == "/other/replay: replay"]
    assert replays[-1].level == DiagnosticStatus.WARN and replays[-1].hardware_id == "none"


@pytest.mark.parametrize(
    ("content", "said"),
    [(None, "No such file"), (b"", "it is empty"), (b"no mcap, but long enough for one", "no MCAP file")],
)
def test_what_is_no_recording_is_refused_in_one_line(
    start_node: Callable[..., NodeProcess], tmp_path: Path, content: bytes | None, said: str
) -> None:
    path = tmp_path / "flight.mcap"
    if content is not None:
        path.write_bytes(content)
    replay = start_node("replay", {"recording": [str(path)]})
    assert replay.wait() == 1
    (line,) = [line for line in replay.output.splitlines() if "cannot start" in line]
    assert said in line


# Cutting into steps, worked out by hand


def told(sent_s: float, type_name: str, message: Any, topic: str = "/devices") -> Told:
    return Told(topic, type_name, sent_s, sent_s, b"", message)


def plan_of(sent_s: float, planning_s: float, *devices: str, plan_id: int = 1) -> Told:
    whole_s = math.floor(planning_s)
    message = SimpleNamespace(
        plan_id=plan_id,
        cells=[SimpleNamespace(device_ids=list(devices))],
        unserved=[],
        planning_time=SimpleNamespace(sec=whole_s, nanosec=round((planning_s - whole_s) * 1e9)),
    )
    return told(sent_s, DEPLOYMENT, message, "/deployment")


def report(sent_s: float, *names: str, departed: tuple[str, ...] = ()) -> Told:
    message = SimpleNamespace(devices=[SimpleNamespace(id=name) for name in names], departed=list(departed))
    return told(sent_s, DEVICES_TYPE, message)


def test_a_report_belongs_to_the_plan_that_began_after_it() -> None:
    first, during, late, rest = report(1.0, "a"), report(1.5, "b"), report(3.9999, "c"), report(9.0, "d")
    one = plan_of(2.0, 0.8, "a")
    two = plan_of(4.5, 0.5, "a", "b")
    three = plan_of(6.0, 0.1, "a", "b", "c")
    recording = Recording((), (first, during, one, late, two, three, rest))
    steps = steps_of(recording)
    # `during` was sent while the first plan was being made; `late` before the second began, which does not know it.
    assert [step.inputs for step in steps] == [(first,), (during,), (late,), (rest,)]
    assert [step.plan for step in steps] == [one.message, two.message, three.message, None]


def test_a_device_that_came_and_went_between_two_plans_is_told() -> None:
    came, went = report(1.0, "a", "x"), report(1.1, departed=("x",))
    steps = steps_of(Recording((), (came, went, plan_of(2.0, 0.5, "a"))))
    assert steps[0].inputs == (came, went)


def test_of_each_aircraft_the_last_state_counts_and_what_became_of_its_link() -> None:
    lost, connected = VehicleState.LINK_LOST, VehicleState.LINK_CONNECTED

    def states(*seen: tuple[str, int]) -> list[Told]:
        return [told(t, STATE, VehicleState(link=link), f"/{uav}/state") for t, (uav, link) in enumerate(seen, start=1)]

    calm = states(("uav1", connected), ("uav2", connected), ("uav1", connected))
    assert state_rounds([*calm, report(4.0, "a")]) == [[calm[2], calm[1]]]
    # Lost and back in one step: both are told, one after the other.
    back = states(("uav1", lost), ("uav2", connected), ("uav1", lost), ("uav1", connected), ("uav1", connected))
    assert state_rounds(back) == [[back[2], back[1]], [back[4]]]
    assert state_rounds([]) == []


def test_differences_are_told_in_words() -> None:
    def made(uav: str = "uav1", x: float = 0.0, power: float = 10.0, **more: Any) -> Any:
        goal = SimpleNamespace(position=SimpleNamespace(x=x, y=0.0, z=50.0))
        cell = SimpleNamespace(uav=uav, goal_pose=goal, device_ids=["a"], power_w=[power])
        return SimpleNamespace(**{"cells": [cell], "unserved": [], **more})

    assert differences(made(), made(x=1e-7)) == []
    assert differences(made(), made(x=0.5)) == ["the cell of a is 0.5 m away"]
    assert differences(made(), made(power=9.0)) == ["the cell of a has other powers"]
    assert differences(made(), made(uav="uav2")) == ["the cell of a is flown by uav2 instead of uav1"]
    assert differences(made(), made(cells=[], unserved=[SimpleNamespace(id="a")])) == [
        "has no more cell of a",
        "served in one of them only: a",
    ]

"""Planner, bridge and simulated aircraft as three processes: devices join, aircraft fly, the plan changes."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import Point, PoseStamped
from graph import Graph, NodeProcess
from jpap_msgs.msg import Deployment, Device, DeviceUpdate, PowerAllocation, VehicleState
from jpap_msgs.srv import FleetCommand

from jpap_ros.nodes.qos import DEVICES, LATCHED, SENSOR_DATA

# The paper's parameters, in SI units and written out apart from the product's LinkBudget:
# P_T = 40 dBm, sigma^2 = -90 dBm, rho_0 = -30 dB, H = 50 m.
TRANSMIT_POWER_W = 10.0
NOISE_W = 1e-12
REFERENCE_GAIN = 1e-3
ALTITUDE_M = 50.0

WAVE_1 = {"a": (0.0, 0.0, 16.0), "b": (60.0, 20.0, 15.5), "c": (300.0, -40.0, 17.0), "d": (330.0, 0.0, 15.0)}
WAVE_2 = {"e": (-200.0, 250.0, 18.0), "f": (20.0, 60.0, 15.2)}


class Fleet:
    """What the test hears of the fleet and the plan."""

    def __init__(self, graph: Graph, uavs: list[str]) -> None:
        self.deployments = graph.collect(Deployment, "deployment", LATCHED)
        self.allocations = {u: graph.collect(PowerAllocation, f"{u}/power_allocation", LATCHED) for u in uavs}
        self.states = {u: graph.collect(VehicleState, f"{u}/state", LATCHED) for u in uavs}
        self.poses = {u: graph.collect(PoseStamped, f"{u}/pose", SENSOR_DATA) for u in uavs}

    def plan_for(self, devices: dict[str, tuple[float, float, float]]) -> Deployment | None:
        """Return the newest deployment if it serves exactly these devices."""
        if not self.deployments:
            return None
        served = sorted(d for cell in self.deployments[-1].cells for d in cell.device_ids)
        return self.deployments[-1] if served == sorted(devices) else None

    def allocated(self, plan: Deployment) -> bool:
        """Whether every cell's power allocation of this plan has come."""
        heard = [self.allocations[cell.uav] for cell in plan.cells]
        return all(messages and messages[-1].plan_id == plan.plan_id for messages in heard)

    def arrived(self, plan: Deployment) -> bool:
        """Whether the bridge says REACHED for this plan and the last pose is within 1 m of the goal, for every cell."""
        for cell in plan.cells:
            state = self.states[cell.uav][-1]
            if state.goal_state != VehicleState.GOAL_REACHED or state.goal_plan_id != plan.plan_id:
                return False
            if self.distance_to_goal(cell.uav, cell.goal_pose.position) > 1.0:
                return False
        return True

    def distance_to_goal(self, uav: str, goal: Point) -> float:
        """Distance of the last pose from a goal [m]."""
        here = self.poses[uav][-1].pose.position
        return math.dist((here.x, here.y, here.z), (goal.x, goal.y, goal.z))


@pytest.fixture
def fleet_file(tmp_path: Path, free_ports: Callable[[int], list[int]]) -> Path:
    uavs = [
        {"name": f"uav{i}", "sysid": i, "url": f"udpin:127.0.0.1:{port}", "home_m": [10.0 * i, 0.0]}
        for i, port in enumerate(free_ports(5), 1)
    ]
    path = tmp_path / "fleet.yaml"
    path.write_text(
        yaml.safe_dump({"version": 1, "origin": {"latitude": -37.8142, "longitude": 144.9632}, "uavs": uavs})
    )
    return path


def report(devices: dict[str, tuple[float, float, float]]) -> DeviceUpdate:
    update = DeviceUpdate()
    update.header.frame_id = "map"
    update.devices = [
        Device(id=id_, position=Point(x=east, y=north), rate_demand=rate, weight=1.0)
        for id_, (east, north, rate) in devices.items()
    ]
    return update


def assert_serves(
    plan: Deployment, devices: dict[str, tuple[float, float, float]], allocations: dict[str, list[PowerAllocation]]
) -> None:
    """Oracle: equation (3) and constraint (6c), evaluated here from the messages alone."""
    for cell in plan.cells:
        allocation = allocations[cell.uav][-1]
        assert (allocation.plan_id, allocation.uav) == (plan.plan_id, cell.uav)
        assert list(allocation.device_ids) == list(cell.device_ids)
        assert sum(allocation.power_w) == pytest.approx(TRANSMIT_POWER_W, rel=1e-9)
        goal = cell.goal_pose.position
        assert goal.z == ALTITUDE_M
        for device, power in zip(allocation.device_ids, allocation.power_w, strict=True):
            east, north, demand = devices[device]
            gain = REFERENCE_GAIN / ((goal.x - east) ** 2 + (goal.y - north) ** 2 + ALTITUDE_M**2)
            assert np.log2(1 + power * gain / NOISE_W) >= demand - 1e-9


def fly(graph: Graph, fleet: Fleet, devices: dict[str, tuple[float, float, float]]) -> Deployment:
    """Wait for a plan for these devices, launch its aircraft and wait until all are at their goals."""
    plan = graph.wait(lambda: fleet.plan_for(devices), f"a plan for {sorted(devices)}")
    graph.wait(lambda: fleet.allocated(plan), "a power allocation of this plan for every cell")
    assert_serves(plan, devices, fleet.allocations)
    flying = {cell.uav for cell in plan.cells}
    answer = graph.call(FleetCommand, "bridge/launch", FleetCommand.Request(uavs=sorted(flying)))
    assert answer.success, answer
    assert {result.uav for result in answer.results} == flying
    # Meanwhile the planner hears of the rest of the fleet, and says so in plans of the same cells.
    graph.wait(lambda: fleet.arrived(fleet.deployments[-1]), "every aircraft of the newest plan within 1 m of its goal")
    newest = fleet.deployments[-1]
    assert {cell.uav for cell in newest.cells} == flying
    return newest


def test_two_waves_of_devices_become_a_hovering_fleet(
    graph: Graph, start_node: Callable[..., NodeProcess], fleet_file: Path
) -> None:
    uavs = [uav["name"] for uav in yaml.safe_load(fleet_file.read_text())["uavs"]]
    parameters = {"fleet_file": str(fleet_file)}
    # One plan for each wave: with its own scheme from scratch behind, the planner may publish another at any moment.
    nodes = [
        start_node("planner", {**parameters, "scheme": "jpap", "reoptimise": False}),
        start_node("bridge", {**parameters, "simulated_clock": True}),
    ]
    nodes.append(start_node("sim", {**parameters, "speedup": 5.0}))
    fleet = Fleet(graph, uavs)
    devices = graph.publisher(DeviceUpdate, "devices", DEVICES)

    plans = []
    present: dict[str, tuple[float, float, float]] = {}
    for wave in (WAVE_1, WAVE_2):
        present = present | wave
        devices.publish(report(wave))
        plans.append(fly(graph, fleet, present))

    assert plans[1].plan_id > plans[0].plan_id
    assert len(plans[1].cells) > len(plans[0].cells), "device e is out of reach of the first wave's UAVs"
    grounded = set(uavs) - {cell.uav for cell in plans[1].cells}
    for uav in grounded:
        assert not fleet.states[uav][-1].armed, f"nobody launched {uav}"
    assert [node.stop() for node in nodes] == [0, 0, 0]

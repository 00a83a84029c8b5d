"""Planner on one host, bridge and aircraft on another, a bad wire between them. Run by test_two_machines.py.

Every wait has a time-out and says what was missing; the exit status is 0 only if the whole story was lived through.
"""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
from pathlib import Path

import yaml
from geometry_msgs.msg import Point
from graph import Graph, NodeProcess
from jpap_msgs.msg import Deployment, Device, DeviceUpdate, VehicleState
from jpap_msgs.srv import FleetCommand
from two_hosts import Host, Wire

from jpap_ros.nodes.qos import DEVICES, LATCHED

UAVS = 4
OUTAGE_S = 6.0


def fleet_file(folder: Path) -> Path:
    """Write a fleet whose MAVLink stays on the aircraft's host."""
    uavs = [
        {"name": f"uav{i}", "sysid": i, "url": f"udpin:127.0.0.1:{14600 + i}", "home_m": [10.0 * i, 0.0]}
        for i in range(1, UAVS + 1)
    ]
    path = folder / "fleet.yaml"
    path.write_text(yaml.safe_dump({"version": 1, "origin": {"latitude": -37.8, "longitude": 145.0}, "uavs": uavs}))
    return path


def report(*devices: tuple[str, float, float, float]) -> DeviceUpdate:
    """Devices by id, east, north [m] and demand [bit/s/Hz]."""
    update = DeviceUpdate()
    update.header.frame_id = "map"
    update.devices = [
        Device(id=name, position=Point(x=east, y=north), rate_demand=rate, weight=1.0)
        for name, east, north, rate in devices
    ]
    return update


def main(loss: float, delay_s: float) -> None:
    """Fly over a wire that loses and delays; break it; fly on."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SUBNET"
    os.environ.pop("ROS_LOCALHOST_ONLY", None)
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        ground, field = Host("ground", "10.78.0.1"), Host("field", "10.78.0.2")
        stack.callback(ground.close)
        stack.callback(field.close)
        wire = stack.enter_context(Wire([ground, field], loss, delay_s))
        parameters = {"fleet_file": str(fleet_file(folder))}

        def start(host: Host, executable: str, **more: float) -> None:
            with host.inside():
                node = NodeProcess(executable, folder / f"{executable}.log", {**parameters, **more})
            stack.callback(node.kill)
            # On the way out of a failed run, so that the reader sees what the node saw.
            stack.callback(lambda: sys.stdout.write(f"--- {executable}\n{node.output}\n"))

        start(field, "sim", speedup=5.0)
        start(field, "bridge", simulated_clock=True)
        start(ground, "planner")
        with ground.inside():
            graph = Graph("operator")
        stack.callback(graph.close)
        plans = graph.collect(Deployment, "deployment", LATCHED)
        states = {f"uav{i}": graph.collect(VehicleState, f"uav{i}/state", LATCHED) for i in range(1, UAVS + 1)}
        devices = graph.publisher(DeviceUpdate, "devices", DEVICES)

        def served(*ids: str) -> bool:
            return bool(plans) and sorted(ids) == sorted(d for cell in plans[-1].cells for d in cell.device_ids)

        def arrived() -> bool:
            plan = plans[-1]
            return all(
                (heard := states[cell.uav])
                and heard[-1].goal_plan_id == plan.plan_id
                and heard[-1].goal_state == VehicleState.GOAL_REACHED
                for cell in plan.cells
            )

        devices.publish(report(("a", 100.0, 0.0, 17.0), ("b", -150.0, 80.0, 17.0)))
        graph.wait(lambda: served("a", "b"), "a plan for a and b")
        graph.wait(
            lambda: all(heard and heard[-1].link == VehicleState.LINK_CONNECTED for heard in states.values()),
            "all aircraft to be seen across the wire",
        )
        answer = graph.call(FleetCommand, "bridge/launch")
        assert answer.success, answer
        graph.wait(arrived, "the fleet at its goals")

        with wire.broken():
            devices.publish(report(("c", 250.0, 200.0, 17.0)))
            graph.wait(lambda: served("a", "b", "c"), "a plan for c: planner and operator share a host")
            graph.spin(OUTAGE_S)
            assert not arrived(), "nothing of the new plan can have crossed a broken wire"
        graph.wait(arrived, "the new goal to cross the mended wire and be reached", 90.0)
        sys.stdout.write("the fleet flew\n")


if __name__ == "__main__":
    main(float(sys.argv[1]), float(sys.argv[2]))

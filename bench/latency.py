"""Time from a device's join to its goal on the ROS graph and to the position target on the wire.

Planner, bridge and simulated aircraft run as processes. A relay between bridge and aircraft, in this process, sees the
moment at which a changed position target passes, without any of the project's MAVLink code. Devices join one at a time
beside those that are there from the start, and leave again before the next one. Each is placed where no aircraft can
serve it from where it hovers, but at least one can from elsewhere: it fits a present cell, whose aircraft has to move.
"""

from __future__ import annotations

import argparse
import selectors
import socket
import struct
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import rclpy
import yaml
from ament_index_python.packages import get_package_prefix
from geometry_msgs.msg import Point, PoseStamped
from jpap_msgs.msg import Deployment, Device, DeviceUpdate, VehicleState
from jpap_msgs.srv import FleetCommand
from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import String

from jpap_ros.demo.fleet_file import free_ports
from jpap_ros.demo.own_graph import own_graph
from jpap_ros.demo.processes import Children
from jpap_ros.nodes.qos import DEVICES, LATCHED
from jpap_ros.planning import LinkBudget

SET_POSITION_TARGET_GLOBAL_INT = 86
SIDE_M = 1500.0
#: Linux: have the kernel say when a datagram came, as a timespec.
SO_TIMESTAMPNS = 35
#: Setpoints leave at 5 Hz or more.
QUIET_S = 0.5
DEMANDS = 12.0, 17.0  # bit/s/Hz


class Relay(threading.Thread):
    """Pass datagrams between the bridge's and the aircraft's ports, noting each change of a vehicle's target."""

    def __init__(self, pairs: list[tuple[int, int]]) -> None:
        super().__init__(daemon=True)
        self.changes: dict[int, list[float]] = {}
        self._targets: dict[int, bytes] = {}
        self._selector = selectors.DefaultSelector()
        for aircraft_port, bridge_port in pairs:
            near = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            near.bind(("127.0.0.1", aircraft_port))
            far = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            far.connect(("127.0.0.1", bridge_port))
            far.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
            ends = {"near": near, "far": far, "aircraft": None, "id": bridge_port}
            self._selector.register(near, selectors.EVENT_READ, (ends, True))
            self._selector.register(far, selectors.EVENT_READ, (ends, False))

    def run(self) -> None:
        """Relay for ever; the process ends it."""
        while True:
            for key, _ in self._selector.select():
                ends, from_aircraft = key.data
                try:
                    data, notes, _, source = key.fileobj.recvmsg(65536, 64)
                    if from_aircraft:
                        ends["aircraft"] = source
                        ends["far"].send(data)
                    elif ends["aircraft"]:
                        self._note(ends["id"], data, _came_at(notes))
                        ends["near"].sendto(data, ends["aircraft"])
                except ConnectionRefusedError:
                    pass  # the bridge is not up yet

    def _note(self, vehicle: int, data: bytes, came_at: float) -> None:
        # A MAVLink 2 frame: magic, length, 2 flags, sequence, 2 ids, 3 bytes of message id, payload, checksum.
        at = 0
        while at + 12 <= len(data) and data[at] == 0xFD:
            length = data[at + 1]
            if int.from_bytes(data[at + 7 : at + 10], "little") == SET_POSITION_TARGET_GLOBAL_INT:
                target = data[at + 14 : at + 10 + length]  # all but time_boot_ms: place, velocity, type mask
                if self._targets.get(vehicle) != target:
                    self._targets[vehicle] = target
                    self.changes.setdefault(vehicle, []).append(came_at)
            at += 12 + length + (13 if data[at + 2] & 1 else 0)

    def changed(self, vehicle: int, after: float) -> float | None:
        """When a vehicle's target first changed after a moment; None if it has not yet."""
        return next((at for at in self.changes.get(vehicle, []) if at >= after), None)

    def quiet(self) -> bool:
        """Whether nobody's target has changed for a while: all hover."""
        return time.monotonic() > max((at[-1] for at in self.changes.values()), default=0.0) + QUIET_S


def _came_at(notes: list[tuple[int, int, bytes]]) -> float:
    """When the kernel got a datagram, on the monotonic clock: this process may have had something else to do."""
    (stamp,) = (data for _, kind, data in notes if kind == SO_TIMESTAMPNS)
    seconds, nanoseconds = struct.unpack("qq", stamp)
    return seconds + 1e-9 * nanoseconds - time.time() + time.monotonic()


class Watch:
    """The operator's node: reports devices, and notes when goals are published."""

    def __init__(self, uavs: list[str]) -> None:
        self.node = rclpy.create_node("latency")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.publisher = self.node.create_publisher(DeviceUpdate, "devices", DEVICES)
        self.plan: Deployment | None = None
        self.planned_at = 0.0
        self.states: dict[str, VehicleState] = {}
        self.goals: dict[str, tuple[float, float]] = {}
        self.changes: list[tuple[float, str]] = []
        self.node.create_subscription(Deployment, "deployment", self._on_plan, LATCHED)
        for name in uavs:
            self.node.create_subscription(VehicleState, f"{name}/state", self._on_state, LATCHED)
            self.node.create_subscription(
                PoseStamped, f"{name}/goal_pose", lambda m, name=name: self._on_goal(name, m), LATCHED
            )
        self.launch = self.node.create_client(FleetCommand, "bridge/launch")
        self._fault = self.node.create_publisher(String, "sim/fault", 10)

    def _on_plan(self, message: Deployment) -> None:
        self.plan = message
        self.planned_at = time.monotonic()

    def _on_state(self, message: VehicleState) -> None:
        self.states[message.uav] = message

    def _on_goal(self, name: str, message: PoseStamped) -> None:
        goal = (message.pose.position.x, message.pose.position.y)
        if self.goals.get(name) != goal:
            self.goals[name] = goal
            self.changes.append((time.monotonic(), name))

    def report(self, devices: dict[str, tuple[float, float, float]], departed: tuple[str, ...] = ()) -> None:
        update = DeviceUpdate()
        update.header.frame_id = "map"
        update.departed = list(departed)
        update.devices = [
            Device(id=i, position=Point(x=x, y=y), rate_demand=r, weight=1.0) for i, (x, y, r) in devices.items()
        ]
        self.publisher.publish(update)

    def wait(self, condition, what: str, timeout_s: float = 60.0) -> None:
        deadline = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > deadline:
                raise SystemExit(f"waited in vain for {what}")
            self.executor.spin_once(timeout_sec=0.005)

    def change_battery(self, uav: str) -> None:
        """In the air, which only a simulated aircraft can do: the measurement takes longer than one charge."""
        self._fault.publish(String(data=f"{uav} battery 1.0"))

    def settled(self) -> bool:
        """Whether every cell's aircraft is at its goal of the present plan."""
        return self.plan is not None and all(
            (state := self.states.get(cell.uav)) is not None
            and state.goal_plan_id == self.plan.plan_id
            and state.goal_state == VehicleState.GOAL_REACHED
            for cell in self.plan.cells
        )


def moving_join(
    rng: np.random.Generator, devices: dict[str, tuple[float, float, float]], plan: Deployment, link: LinkBudget
) -> tuple[float, float, float]:
    """Place and demand of a device that some cell of `plan` can serve, but none from where its aircraft hovers.

    A set needs the power sum w_k (|v - u_k|^2 + H^2) / eta at v, the least of it at the mean weighted by w.
    """
    cells = [
        (
            np.array([c.goal_pose.position.x, c.goal_pose.position.y]),
            np.array([devices[i] for i in c.device_ids]),
        )
        for c in plan.cells
    ]

    def power(members: np.ndarray, place: np.ndarray) -> float:
        weight = (2 ** members[:, 2] - 1) / link.eta
        return float(weight @ (((members[:, :2] - place) ** 2).sum(1) + link.altitude_m**2))

    for _ in range(10_000):
        hover, members = cells[rng.integers(len(cells))]
        rate, bearing = rng.uniform(*DEMANDS), rng.uniform(0, 2 * np.pi)
        # As far from this aircraft as takes it just over its power.
        lacking = rng.uniform(1.02, 1.1) * link.transmit_power_w - power(members, hover)
        distance2 = lacking * link.eta / (2**rate - 1) - link.altitude_m**2
        if distance2 <= 0:
            continue
        newcomer = np.array([*(hover + np.sqrt(distance2) * np.array([np.cos(bearing), np.sin(bearing)])), rate])
        joined = np.vstack([members, newcomer])
        best = np.average(joined[:, :2], axis=0, weights=2 ** joined[:, 2] - 1)
        if power(joined, best) <= 0.98 * link.transmit_power_w and all(
            power(np.vstack([m, newcomer]), h) > 1.02 * link.transmit_power_w for h, m in cells
        ):
            return tuple(newcomer)
    raise SystemExit("found no place for a device that makes an aircraft move")


def measure(devices: int, uavs: int, joins: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Seconds from each join to its plan, to the changed goal, and to the changed target on the wire."""
    rng = np.random.default_rng(seed)
    ports = free_ports(2 * uavs)
    names = [f"uav{i + 1}" for i in range(uavs)]
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        for file, used in (("bridge.yaml", ports[:uavs]), ("sim.yaml", ports[uavs:])):
            entries = [
                {"name": n, "sysid": i + 1, "url": f"udpin:127.0.0.1:{p}", "home_m": [20.0 * (i % 6), 20.0 * (i // 6)]}
                for i, (n, p) in enumerate(zip(names, used, strict=True))
            ]
            (work / file).write_text(
                yaml.safe_dump({"version": 1, "origin": {"latitude": -37.8, "longitude": 145.0}, "uavs": entries})
            )
        relay = Relay(list(zip(ports[uavs:], ports[:uavs], strict=True)))
        relay.start()
        vehicles = dict(zip(names, ports[:uavs], strict=True))
        programs = Path(get_package_prefix("jpap_ros")) / "lib" / "jpap_ros"
        rclpy.init(args=[])
        with Children(work) as children:
            for name, file in (("sim", "sim.yaml"), ("bridge", "bridge.yaml"), ("planner", "bridge.yaml")):
                extra = {
                    "sim": "speedup:=5.0",
                    "bridge": "simulated_clock:=true",
                    "planner": "reoptimise:=false",
                }[name]
                command = [str(programs / name), "--ros-args", "-p", f"fleet_file:={work / file}", "-p", extra]
                children.start(name, command)
            watch = Watch(names)
            watch.wait(lambda: watch.publisher.get_subscription_count() and watch.launch.service_is_ready(), "nodes")
            positions = rng.uniform(-SIDE_M / 2, SIDE_M / 2, (devices, 2))
            rates = rng.uniform(*DEMANDS, devices)
            present = {f"d{k}": (*positions[k], rates[k]) for k in range(devices)}
            watch.report(present)
            watch.wait(lambda: watch.plan and not watch.plan.unserved and watch.plan.cells, "a plan for all devices")
            answer = watch.launch.call_async(FleetCommand.Request())
            watch.wait(answer.done, "take-off", 120)
            watch.wait(lambda: watch.settled() and relay.quiet(), "the fleet at its goals", 120)
            to_plan, to_goal, to_wire = [], [], []
            for join in range(joins):
                for turn in range(3):
                    watch.change_battery(names[(3 * join + turn) % uavs])
                newcomer = {f"join{join}": moving_join(rng, present, watch.plan, LinkBudget())}
                goals, plan = len(watch.changes), watch.plan.plan_id
                started = time.monotonic()
                watch.report(newcomer)
                watch.wait(lambda plan=plan: watch.plan.plan_id > plan, "a new plan")
                to_plan.append(watch.planned_at - started)
                watch.wait(lambda goals=goals: len(watch.changes) > goals, "a new goal")
                goal_at, moved = watch.changes[goals]
                vehicle = vehicles[moved]
                watch.wait(lambda v=vehicle, s=started: relay.changed(v, s), "a new target on the wire")
                to_goal.append(goal_at - started)
                to_wire.append(relay.changed(vehicle, started) - started)
                watch.wait(lambda: watch.settled() and relay.quiet(), "the fleet at its goals", 120)
                plan = watch.plan.plan_id
                watch.report({}, departed=tuple(newcomer))
                watch.wait(lambda plan=plan: watch.plan.plan_id > plan, "a plan without it")
                watch.wait(lambda: watch.settled() and relay.quiet(), "the fleet at its goals", 120)
        rclpy.try_shutdown()
    return np.array(to_plan), np.array(to_goal), np.array(to_wire)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="scripts/bench latency", description=__doc__.split("\n\n")[0])
    parser.add_argument("--devices", type=int, default=40)
    parser.add_argument("--uavs", type=int, default=15)
    parser.add_argument("--joins", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    # The relay's thread must not wait for the interpreter while this one takes a plan in.
    sys.setswitchinterval(5e-4)
    with own_graph():
        to_plan, to_goal, to_wire = measure(options.devices, options.uavs, options.joins, options.seed)
    for label, values in (
        ("join -> plan published", to_plan),
        ("join -> goal published", to_goal),
        ("join -> target on the wire", to_wire),
    ):
        p50, p90, p99, worst = np.percentile(1000 * values, [50, 90, 99, 100])
        print(f"{label:28s} n={len(values)}  p50 {p50:.1f} ms  p90 {p90:.1f}  p99 {p99:.1f}  max {worst:.1f}")


if __name__ == "__main__":
    main()

"""Planner, bridge and simulated aircraft killed (SIGKILL) at bad moments and started again, over real DDS.

Oracle: where the aircraft really are, as the simulator says on /diagnostics (the nodes under test do not see that), its
own watch over the least separation, and the goals of the deployment before the kill.
"""

from __future__ import annotations

import math
import shutil
import signal
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point, PoseStamped
from graph import Graph, NodeProcess
from jpap_msgs.msg import Deployment, Device, DeviceUpdate, VehicleState
from jpap_msgs.srv import FleetCommand
from std_msgs.msg import String

from jpap_ros.nodes.qos import DEVICES, LATCHED, SENSOR_DATA

Vector = tuple[float, float, float]

#: Whoever has nothing to fly to stays this close to its goal, whatever is killed [m].
STAYS_M = 1.0
MIN_SEPARATION_M = 10.0
#: The default of tracking_error_m: what separation allows aircraft to be off.
TRACKING_ERROR_M = 2.0
#: A demand that, at this height, one UAV serves from within about 40 m: devices 100 m apart need one each.
RATE, ALTITUDE_M = 22.0, 25.0
#: Each below its device. The PX4, which on a busy machine may lose its stream by itself, has a test of its own.
HOMES = {"uav1": (0.0, -40.0), "uav2": (100.0, -40.0), "uav3": (200.0, -40.0), "uav4": (300.0, -40.0)}
FIRST = {"a": (0.0, 0.0), "b": (100.0, 0.0), "c": (200.0, 0.0)}
AWAY = {name: (east, north + 135.0) for name, (east, north) in FIRST.items()}
ARDUPILOTS, PX4 = ("uav1", "uav2", "uav3"), "uav4"


@dataclass(frozen=True)
class Truth:
    """One aircraft as the simulator says it is."""

    position: Vector
    mode: str
    armed: bool


class World:
    """The nodes, as processes that can be killed, and what the test hears of them."""

    def __init__(self, graph: Graph, folder: Path, ports: list[int]) -> None:
        self.graph, self.folder = graph, folder
        uavs = [
            {"name": name, "sysid": i, "url": f"udpin:127.0.0.1:{port}", "home_m": list(home)}
            for i, ((name, home), port) in enumerate(zip(HOMES.items(), ports, strict=True), 1)
        ]
        for uav in uavs:
            uav["autopilot"] = "px4" if uav["name"] == PX4 else "ardupilot"
        fleet = folder / "fleet.yaml"
        origin = {"latitude": -37.8142, "longitude": 144.9632}
        fleet.write_text(yaml.safe_dump({"version": 1, "origin": origin, "uavs": uavs}))
        self.plan_file = folder / "plan.json"
        shared = {"fleet_file": str(fleet)}
        self._parameters: dict[str, dict[str, Any]] = {
            "sim": shared,
            # Quick climbs: the fleet flies in real time, as its autopilots' time-outs do.
            "bridge": {
                **shared,
                "state_file": str(folder / "flown.json"),
                "min_separation_m": MIN_SEPARATION_M,
                "transit_climb_m_s": 2.4,
                "launch_stagger_s": 0.0,
            },
            # A plan from scratch behind may move aircraft at any moment, and nothing here should but what is tested.
            "planner": {
                **shared,
                "state_file": str(self.plan_file),
                "altitude_m": ALTITUDE_M,
                "reoptimise": False,
                "scheme": "jpap",
            },
        }
        self._nodes: dict[str, NodeProcess] = {}
        self._wanted: set[str] = set()
        self._starts = 0
        self._plans: list[Deployment] = graph.collect(Deployment, "deployment", LATCHED)
        self.states = {n: graph.collect(VehicleState, f"{n}/state", LATCHED) for n in HOMES}
        self.poses = {n: graph.collect(PoseStamped, f"{n}/pose", SENSOR_DATA) for n in HOMES}
        self.truth: dict[str, list[Truth]] = {name: [] for name in HOMES}
        self.least_m = math.inf
        graph.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 100)
        self._faults = graph.node.create_publisher(String, "sim/fault", 10)
        self.start("sim", "bridge", "planner")
        self._reports = graph.publisher(DeviceUpdate, "devices", DEVICES)
        self.devices: dict[str, tuple[float, float]] = {}

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            name = status.name.removeprefix("/sim: ")
            if name in self.truth:
                place = float(values["east_m"]), float(values["north_m"]), float(values["up_m"])
                self.truth[name].append(Truth(place, values["mode"], values["armed"] == "true"))
            elif name == "fleet":
                self.least_m = min(self.least_m, float(values["least_separation_m"]))

    # Processes

    def start(self, *names: str) -> None:
        for name in names:
            self._starts += 1
            self._wanted.add(name)
            log = self.folder / f"{self._starts}_{name}.log"
            self._nodes[name] = NodeProcess(name, log, self._parameters[name])

    def start_again(self, *names: str) -> None:
        """Start nodes; a new bridge is waited for, since calls would go to the dead one otherwise."""
        heard = {name: len(states) for name, states in self.states.items()}
        self.start(*names)
        if "bridge" in names:
            self.wait(lambda: all(len(self.states[n]) > heard[n] for n in HOMES), "the new bridge")

    def kill(self, *names: str) -> None:
        for name in names:
            self._wanted.remove(name)
            self._nodes[name].stop(signal.SIGKILL)

    def close(self) -> None:
        for node in self._nodes.values():
            node.kill()

    # Devices and plans

    @property
    def plan(self) -> Deployment:
        return self._plans[-1]

    @property
    def goals(self) -> dict[str, Vector]:
        """Goals of the newest plan, by UAV."""
        return {
            c.uav: (c.goal_pose.position.x, c.goal_pose.position.y, c.goal_pose.position.z) for c in self.plan.cells
        }

    def report(self, devices: dict[str, tuple[float, float]], rate: float = RATE, snapshot: bool = False) -> None:
        """Report devices (a snapshot: all that there are), and wait for a plan that serves them where they are."""
        update = DeviceUpdate(snapshot=snapshot)
        update.header.frame_id = "map"
        update.devices = [
            Device(id=name, position=Point(x=x, y=y), rate_demand=rate, weight=1.0) for name, (x, y) in devices.items()
        ]
        self.devices = devices if snapshot else self.devices | devices
        self._reports.publish(update)
        self.wait(self.served, f"a plan for {sorted(self.devices)}")

    def served(self) -> bool:
        """Whether the newest plan serves every device where it is: within reach of its UAV, by equation (1)."""
        if not self._plans:
            return False
        cells = {device: cell for cell in self.plan.cells for device in cell.device_ids}
        return cells.keys() == self.devices.keys() and all(
            math.dist((cells[n].goal_pose.position.x, cells[n].goal_pose.position.y), (x, y)) < 45.0
            for n, (x, y) in self.devices.items()
        )

    def newer_plan(self, than: Deployment) -> Deployment:
        """Wait for a plan of the restarted planner."""
        self.wait(lambda: self.plan.plan_id != than.plan_id, "a plan of the restarted planner")
        return self.plan

    # Aircraft

    def wait(self, condition: Callable[[], Any], what: str) -> Any:
        def alive() -> Any:
            for name in self._wanted:
                assert self._nodes[name].process.poll() is None, (
                    f"{name} has ended:\n{self._nodes[name].output[-2000:]}"
                )
            return condition()

        return self.graph.wait(alive, what)

    def launch(self, *names: str) -> None:
        answer = self.graph.call(FleetCommand, "bridge/launch", FleetCommand.Request(uavs=list(names)))
        assert answer.success, answer

    def launch_without_waiting(self, name: str) -> None:
        client = self.graph.node.create_client(FleetCommand, "bridge/launch")
        self.wait(client.service_is_ready, "bridge/launch")
        client.call_async(FleetCommand.Request(uavs=[name]))

    def fault(self, fault: str) -> None:
        self.wait(self._faults.get_subscription_count, "the simulator's ear for faults")
        self._faults.publish(String(data=fault))

    def state(self, name: str) -> VehicleState:
        return self.states[name][-1]

    def off(self, name: str, place: Vector | None = None) -> float:
        """How far an aircraft is from a place, or its goal [m], by the newest truth."""
        return math.dist(self.truth[name][-1].position, place or self.goals[name])

    def arrived(self, *names: str) -> None:
        """Wait until the bridge says that aircraft are at the goals of the newest plan, and they are."""

        def there(name: str) -> bool:
            state = self.state(name)
            told = (state.goal_state, state.goal_plan_id) == (VehicleState.GOAL_REACHED, self.plan.plan_id)
            return told and self.off(name) < STAYS_M

        self.wait(lambda: all(there(name) for name in names or self.goals), "aircraft at their goals")

    def hovering(self) -> Deployment:
        """Bring the world to where most tests begin: every device of `FIRST` served from its own hovering UAV."""
        self.start_again(*(name for name, node in self._nodes.items() if node.process.poll() is not None))
        self.launch(*ARDUPILOTS)
        self.report(FIRST, snapshot=True)
        self.arrived()
        assert self.goals.keys() == set(ARDUPILOTS)
        return self.plan

    def bring_to_goal(self, name: str) -> None:
        """Launch as an operator does: again, should PX4 have lost its stream of targets on a busy machine."""

        def there() -> bool:
            reached = self.state(name).goal_state == VehicleState.GOAL_REACHED
            return reached and name in self.goals and self.off(name) < STAYS_M

        for _ in range(5):
            self.launch(name)
            self.wait(
                lambda: there() or self.state(name).goal_state == VehicleState.GOAL_YIELDED, f"{name} at its goal"
            )
            if there():
                return
        raise AssertionError(f"{name} was taken over five times: {self.state(name).goal_reason}")

    def mark(self) -> dict[str, int]:
        """Remember how much truth there is."""
        return {name: len(truth) for name, truth in self.truth.items()}

    def strayed(self, since: dict[str, int], name: str, goal: Vector) -> float:
        """Farthest from a place that an aircraft has been since a mark [m]."""
        assert len(self.truth[name]) > since[name], "the simulator has said nothing"
        return max(math.dist(truth.position, goal) for truth in self.truth[name][since[name] :])

    def rested(self) -> None:
        """Wait until no aircraft moves, for two seconds."""

        def still(truth: list[Truth]) -> bool:
            return max(math.dist(a.position, b.position) for a in truth[-3:] for b in truth[-3:]) < 0.1

        since = self.mark()
        self.wait(
            lambda: all(len(t) >= since[n] + 3 and still(t) for n, t in self.truth.items()), "aircraft that hover"
        )


def on_leg(here: Vector, start: Vector, goal: Vector) -> tuple[float, float]:
    """How far along the straight way from start to goal a place lies, and how far aside [m]."""
    length = math.dist(start, goal)
    along = sum((p - a) * (b - a) for p, a, b in zip(here, start, goal, strict=True)) / length
    return along, math.sqrt(max(math.dist(here, start) ** 2 - along**2, 0.0))


@pytest.fixture(scope="module")
def world(ros_domain: int, tmp_path_factory: pytest.TempPathFactory, own_ports: Iterator[int]) -> Iterator[World]:
    graph = Graph()
    made = World(graph, tmp_path_factory.mktemp("restart"), [next(own_ports) for _ in HOMES])
    yield made
    made.close()
    graph.close()


@pytest.fixture(autouse=True)
def nobody_comes_too_near(world: World) -> Iterator[None]:
    yield
    assert world.least_m >= MIN_SEPARATION_M


def test_a_bridge_killed_during_a_take_off_arms_nobody_and_takes_over_in_the_air(world: World) -> None:
    world.report({name: FIRST[name] for name in "ab"}, snapshot=True)
    world.launch("uav1", "uav2")
    world.report(FIRST)
    world.arrived("uav1", "uav2")
    assert "uav3" in world.goals and not world.truth["uav3"][-1].armed
    world.launch_without_waiting("uav3")
    world.wait(lambda: 1.0 < world.truth["uav3"][-1].position[2] < 9.0, "uav3 on its way up")
    world.kill("bridge")
    world.rested()
    assert world.truth["uav3"][-1].mode == "GUIDED"
    assert math.dist(world.truth["uav3"][-1].position[:2], HOMES["uav3"]) < STAYS_M, "straight above its pad"
    world.start_again("bridge")
    world.arrived(*ARDUPILOTS)
    assert not any(truth.armed for truth in world.truth[PX4]), "nobody asked for uav4"


def test_a_planner_killed_while_all_hover_moves_nobody_and_answers_again(world: World) -> None:
    before, since = world.hovering(), world.mark()
    goals = world.goals
    world.kill("planner")
    world.start_again("planner")
    after = world.newer_plan(before)
    assert after.plan_id > before.plan_id and "planner restarted" in after.reason
    assert world.goals == goals
    world.arrived()
    world.report({"late": (2.0, 1.0)}, rate=10.0)
    assert world.goals == goals, "it fits where the aircraft is"
    world.arrived()
    assert max(world.strayed(since, name, goal) for name, goal in goals.items()) < STAYS_M


def test_a_planner_killed_in_the_middle_of_a_transition_changes_nothing_of_it(world: World) -> None:
    before = world.hovering()
    world.report(AWAY)
    goals, moved = world.goals, world.plan
    assert goals.keys() == set(ARDUPILOTS) and moved.plan_id > before.plan_id
    world.wait(lambda: all(10.0 < world.off(name) < 45.0 for name in goals), "everybody on the way")
    world.kill("planner")
    world.start_again("planner")
    after = world.newer_plan(moved)
    assert after.plan_id > moved.plan_id and world.goals == goals
    world.arrived()


@pytest.mark.parametrize("left_m", [(15.0, 45.0), (2.0, 8.0)], ids=["on the way", "slowing down"])
def test_a_bridge_killed_in_the_middle_of_a_transition_goes_on_where_aircraft_came_to_rest(
    world: World, left_m: tuple[float, float]
) -> None:
    world.hovering()
    starts = world.goals
    world.report(AWAY)
    goals = world.goals

    def left(name: str) -> float:
        here = world.poses[name][-1].pose.position
        return math.dist((here.x, here.y, here.z), goals[name])

    world.wait(lambda: all(left_m[0] < left(name) < left_m[1] for name in goals), "everybody far enough")
    world.kill("bridge")
    killed = world.mark()
    world.rested()
    for name, goal in goals.items():
        # By their autopilots' rules they have gone on for some seconds; all the same, nobody left the leg it was on.
        for truth in world.truth[name][killed[name] :]:
            along, aside = on_leg(truth.position, starts[name], goal)
            assert along <= math.dist(starts[name], goal) + TRACKING_ERROR_M
            assert aside <= TRACKING_ERROR_M
    assert {world.truth[name][-1].mode for name in ARDUPILOTS} == {"GUIDED"}
    world.start_again("bridge")
    world.arrived()
    assert world.goals == goals


@pytest.mark.parametrize("nodes", [("bridge",), ("bridge", "planner")], ids=["alone", "with the planner"])
def test_a_bridge_killed_while_all_hover_moves_nobody(world: World, nodes: tuple[str, ...]) -> None:
    before = world.hovering()
    goals, since = world.goals, world.mark()
    world.kill(*nodes)
    world.rested()
    world.start_again(*nodes)
    if "planner" in nodes:
        assert world.newer_plan(before).plan_id > before.plan_id
    world.arrived()
    assert world.goals == goals
    assert max(world.strayed(since, name, goal) for name, goal in goals.items()) < STAYS_M


def test_a_px4_that_fell_into_its_failsafe_hovers_until_an_operator_takes_it_back(world: World) -> None:
    world.hovering()
    world.report({"d": (300.0, 0.0)})
    world.bring_to_goal(PX4)
    goal, since = world.goals[PX4], world.mark()
    world.kill("bridge")
    world.wait(lambda: world.truth[PX4][-1].mode == "HOLD", "the failsafe for a stream that ends")
    world.start_again("bridge")
    world.wait(lambda: world.state(PX4).goal_state == VehicleState.GOAL_YIELDED, "uav4 left alone")
    assert "found in AUTO.LOITER after a restart" in world.state(PX4).goal_reason
    world.arrived(*ARDUPILOTS)
    assert world.strayed(since, PX4, goal) < STAYS_M
    world.bring_to_goal(PX4)


def test_whom_a_pilot_took_while_the_bridge_was_dead_is_not_commanded(world: World) -> None:
    world.hovering()
    goal, since = world.goals["uav2"], world.mark()
    world.kill("bridge")
    world.fault("uav2 pilot LOITER")
    world.wait(lambda: world.truth["uav2"][-1].mode == "LOITER", "the pilot at work")
    world.start_again("bridge")
    world.wait(lambda: world.state("uav2").goal_state == VehicleState.GOAL_YIELDED, "uav2 left to the pilot")
    assert "LOITER" in world.state("uav2").goal_reason and "bridge/launch" in world.state("uav2").goal_reason
    world.arrived("uav1")
    seen = world.mark()
    world.wait(lambda: len(world.truth["uav2"]) > seen["uav2"] + 3, "some seconds")
    assert {truth.mode for truth in world.truth["uav2"][-4:]} == {"LOITER"}
    assert world.strayed(since, "uav2", goal) < STAYS_M


def test_a_state_file_older_than_what_is_flown_moves_nobody_and_counts_on(world: World) -> None:
    world.hovering()
    old = world.folder / "old.json"
    shutil.copy(world.plan_file, old)
    world.report({"late": (2.0, 1.0)}, rate=10.0)
    before, goals, since = world.plan, world.goals, world.mark()
    world.arrived()
    world.kill("planner")
    shutil.copy(old, world.plan_file)
    world.start_again("planner")
    after = world.newer_plan(before)
    assert after.plan_id > before.plan_id
    assert f"aircraft follow plan {before.plan_id}" in after.reason
    # The device that the file does not know is reported still: its report is latched.
    world.wait(world.served, "every device served again")
    assert world.goals == goals
    world.arrived()
    assert max(world.strayed(since, name, goal) for name, goal in goals.items()) < STAYS_M


def test_a_fleet_that_reboots_stays_on_the_ground_until_it_is_launched(world: World) -> None:
    before = world.hovering()
    world.kill("sim")
    world.wait(lambda: all(world.state(n).link == VehicleState.LINK_LOST for n in HOMES), "every link lost")
    world.start_again("sim")
    world.wait(lambda: all(world.state(n).link == VehicleState.LINK_CONNECTED for n in HOMES), "every link back")
    since = world.mark()
    world.wait(lambda: all(len(world.truth[n]) > since[n] + 5 for n in HOMES), "some seconds")
    for name in HOMES:
        assert not any(truth.armed or truth.position[2] > 0.1 for truth in world.truth[name][since[name] :])
        assert world.state(name).goal_state in (VehicleState.GOAL_LOST, VehicleState.GOAL_NONE)
    # Whoever was heard first has the cells now, perhaps the PX4 among them.
    world.wait(world.served, "every device served again")
    crew = [name for name in world.goals if name != PX4]
    world.launch(*crew)
    world.arrived(*crew)
    assert world.plan.plan_id >= before.plan_id

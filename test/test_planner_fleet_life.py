"""The planner that manages its fleet: launches, losses, reliefs and returns, over real topics and services.

The test stands in for the bridge: it says what every aircraft does and serves the bridge's services, so that a battery
runs low or a link is lost exactly when the test wants it. Oracle: the rules of the fleet's life, worked by hand.
"""

import json
import signal

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point, PoseStamped
from jpap_msgs.msg import Deployment, Device, DeviceUpdate, FleetCommandResult, VehicleState
from jpap_msgs.srv import FleetCommand
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node

from jpap_ros.nodes.qos import DEVICES, LATCHED

UAVS = ["uav1", "uav2", "uav3", "uav4"]

#: Two places 2 km apart: two UAVs, whatever the scheme.
DEVICES_AT = {"west": (-1000.0, 0.0), "east": (1000.0, 0.0)}


class BridgeByHand:
    """Aircraft that are at once where they are sent."""

    def __init__(self, graph):
        self.graph = graph
        self.orders = []
        self.states = {
            name: VehicleState(
                uav=name,
                link=VehicleState.LINK_CONNECTED,
                landed_state=VehicleState.LANDED_ON_GROUND,
                position_valid=True,
                position=Point(x=10.0 * i, y=0.0, z=0.0),
                battery_remaining=0.9,
                battery_charge_state=1,
            )
            for i, name in enumerate(UAVS)
        }
        self.goals = {}
        self.silent = set()
        self.rounds = 0
        node = graph.node
        self._out = {name: node.create_publisher(VehicleState, f"{name}/state", LATCHED) for name in UAVS}
        for name in UAVS:
            node.create_subscription(PoseStamped, f"{name}/goal_pose", lambda m, n=name: self._on_goal(n, m), LATCHED)
        for order in ("launch", "return_home"):
            node.create_service(FleetCommand, f"bridge/{order}", lambda q, r, o=order: self._on_order(o, q, r))
        node.create_timer(0.2, self._report)

    def ordered(self, order):
        return [name for what, name in self.orders if what == order]

    def _on_goal(self, name, message):
        self.goals[name] = message
        self._fly(name)

    def _fly(self, name):
        if self.states[name].landed_state == VehicleState.LANDED_IN_AIR and name in self.goals:
            self.states[name].position = self.goals[name].pose.position

    def _on_order(self, order, request, response):
        for name in request.uavs:
            self.orders.append((order, name))
            state = self.states[name]
            up = order == "launch"
            state.armed = up
            state.landed_state = VehicleState.LANDED_IN_AIR if up else VehicleState.LANDED_ON_GROUND
            state.goal_state = VehicleState.GOAL_NONE if up else VehicleState.GOAL_YIELDED
            self._fly(name)
            response.results.append(FleetCommandResult(uav=name, success=True))
        response.success = True
        return response

    def _report(self):
        self.rounds += 1
        for name, state in self.states.items():
            if name not in self.silent:
                self._out[name].publish(state)


def cells(deployment):
    """What a deployment asks of each aircraft."""
    return {c.uav: (c.goal_pose, list(c.device_ids), list(c.power_w)) for c in deployment.cells}


class World:
    """The planner with the test's bridge."""

    def __init__(self, graph, start, rate):
        self.graph, self._start, self._rate = graph, start, rate
        self.process = start()
        self.deployments = graph.collect(Deployment, "deployment", LATCHED)
        self.bridge = BridgeByHand(graph)
        self._devices = graph.publisher(DeviceUpdate, "devices", DEVICES)

    def send(self, names=(), departed=()):
        message = DeviceUpdate(departed=list(departed))
        message.header.frame_id = "map"
        message.devices = [
            Device(id=n, position=Point(x=DEVICES_AT[n][0], y=DEVICES_AT[n][1]), rate_demand=self._rate, weight=1.0)
            for n in names
        ]
        self._devices.publish(message)

    def restart(self):
        """Kill the planner and start it again."""
        self.process.stop(signal.SIGKILL)
        self.process = self._start()

    def said(self, words):
        self.wait(lambda: words in self.process.output, words)

    def crew(self):
        """Aircraft by the device that it serves, as the newest deployment says."""
        return {c.device_ids[0]: c.uav for c in self.deployments[-1].cells if c.uav} if self.deployments else {}

    def wait(self, condition, what):
        return self.graph.wait(condition, what)

    def served(self):
        """Bring both devices on the air: the crew is launched and at its goals."""
        self.wait(lambda: all(s.get_subscription_count() for s in self.bridge._out.values()), "the planner's ears")
        # It may have heard what the states were before the test set them: by the second round it has heard these.
        heard = self.bridge.rounds + 2
        self.wait(lambda: self.bridge.rounds >= heard, "two rounds of reports")
        self.send(DEVICES_AT)
        self.wait(lambda: self.crew().keys() == DEVICES_AT.keys(), "a crew for both cells")
        self.wait(lambda: set(self.bridge.ordered("launch")) == set(self.crew().values()), "their launch")
        for device, uav in self.crew().items():
            self.wait(
                lambda d=device, u=uav: self.bridge.states[u].position.x == DEVICES_AT[d][0], f"{uav} over {device}"
            )
        return self.crew()


@pytest.fixture
def world(graph, start_node, tmp_path):
    """Return a function that starts the planner with the test's bridge."""

    def start(rate=16.0, **parameters):
        uavs = [{"name": n, "sysid": i, "url": f"udpin:127.0.0.1:{14000 + i}"} for i, n in enumerate(UAVS, 1)]
        fleet = {"version": 1, "origin": {"latitude": 0.0, "longitude": 0.0}, "uavs": uavs}
        (tmp_path / "fleet.yaml").write_text(yaml.safe_dump(fleet))
        settings = {"fleet_file": str(tmp_path / "fleet.yaml"), "manage_fleet": True, "reoptimise": False}
        return World(graph, lambda: start_node("planner", {**settings, **parameters}), rate)

    return start


def test_the_crew_is_launched_and_the_reserve_stays_on_the_ground(world):
    here = world()
    crew = here.served()
    here.graph.spin(1.5)
    assert sorted(here.bridge.orders) == sorted(("launch", uav) for uav in crew.values())


def test_the_crew_is_chosen_by_the_objective_that_is_set(world):
    # By hand: uav1 is over the west, uav2 2000 m from it and 2400 m from the east; 2000 m is the shortest longest
    # flight, which crosses over, and least squares would not (2400^2 < 2 * 2000^2).
    here = world(assignment="bottleneck")
    for name in UAVS[2:]:
        here.bridge.states[name].link = VehicleState.LINK_NEVER_SEEN
    here.bridge.states["uav1"].position = Point(x=-1000.0, y=0.0)
    here.bridge.states["uav2"].position = Point(x=-440.0, y=1920.0)
    assert here.served() == {"west": "uav2", "east": "uav1"}


def test_a_lost_aircraft_is_replaced_by_a_reserve(world):
    here = world(lost_after_s=1.0)
    crew = here.served()
    lost = here.bridge.states[crew["west"]]
    lost.link = VehicleState.LINK_LOST
    here.wait(lambda: here.crew().get("west") not in (None, crew["west"]), "another aircraft for the west")
    assert f"{crew['west']} is lost" in " ".join(d.reason for d in here.deployments)
    relief = here.crew()["west"]
    here.wait(lambda: relief in here.bridge.ordered("launch"), "its launch")
    here.wait(lambda: here.bridge.states[relief].position.x == -1000.0, "its arrival")
    assert here.crew()["east"] == crew["east"]


def test_a_tired_aircraft_leaves_only_when_its_relief_is_on_station(world):
    here = world()
    crew = here.served()
    tired = crew["west"]
    here.bridge.states[tired].battery_remaining = 0.25
    here.wait(lambda: "goes to relieve" in here.deployments[-1].reason, "a relief on its way")
    assert here.crew()["west"] == tired and ("return_home", tired) not in here.bridge.orders
    here.wait(lambda: here.crew()["west"] != tired, "the change of roles")
    relief = here.crew()["west"]
    reasons = " ".join(d.reason for d in here.deployments)
    assert f"{relief} relieves {tired}" in reasons and f"{tired} is low on battery" in reasons
    assert not any(d.interrupted for d in here.deployments), "16 bit/s/Hz are met from 65 m as well"
    here.wait(lambda: tired in here.bridge.ordered("return_home"), "the tired one to be sent home")
    # In order: the relief took off before the tired one was sent home.
    assert here.bridge.orders.index(("launch", relief)) < here.bridge.orders.index(("return_home", tired))
    here.wait(lambda: here.bridge.states[relief].position.z == 50.0, "the relief to take the cell's own height")


def test_an_aircraft_without_a_cell_is_sent_home_and_can_be_launched_again(world):
    here = world(idle_return_s=1.0)
    crew = here.served()
    here.send(departed=["west"])
    here.wait(lambda: crew["west"] in here.bridge.ordered("return_home"), "its return")
    assert crew["east"] not in here.bridge.ordered("return_home")
    here.send(["west"])
    # Both reserves and the one that came home are on the ground: any of them may go, but one must.
    here.wait(lambda: here.crew().keys() == DEVICES_AT.keys(), "a crew for both again")
    again = here.crew()["west"]
    here.wait(lambda: here.bridge.states[again].landed_state == VehicleState.LANDED_IN_AIR, "its launch")
    assert here.crew()["east"] == crew["east"]


def test_a_pilot_s_aircraft_is_left_to_the_pilot(world):
    here = world(lost_after_s=1.0)
    crew = here.served()
    taken = crew["west"]
    here.bridge.states[taken].goal_state = VehicleState.GOAL_YIELDED
    here.wait(lambda: here.crew().get("west") not in (None, taken), "another aircraft for the west")
    here.bridge.states[taken].landed_state = VehicleState.LANDED_ON_GROUND
    orders = list(here.bridge.orders)
    here.graph.spin(2.0)
    assert [order for order in here.bridge.orders[len(orders) :] if order[1] == taken] == []
    assert here.bridge.ordered("launch").count(taken) == 1


def test_devices_wait_for_aircraft_that_connect_later(world):
    here = world()
    for name in UAVS[1:]:
        here.bridge.states[name].link = VehicleState.LINK_NEVER_SEEN
    here.wait(lambda: all(s.get_subscription_count() for s in here.bridge._out.values()), "the planner's ears")
    here.graph.spin(1.0)
    here.send(DEVICES_AT)
    here.wait(lambda: len(here.crew()) == 1, "one cell for the one aircraft")
    assert len(here.deployments[-1].unserved) == 1 and here.deployments[-1].uavs_needed == 2
    here.bridge.states["uav2"].link = VehicleState.LINK_CONNECTED
    here.wait(lambda: here.crew().keys() == DEVICES_AT.keys(), "the second cell")


def test_unless_it_manages_the_fleet_the_planner_orders_nothing(world):
    here = world(manage_fleet=False)
    here.send(DEVICES_AT)
    here.wait(lambda: here.crew().keys() == DEVICES_AT.keys(), "a plan")
    here.graph.spin(2.0)
    assert here.bridge.orders == []


def test_batteries_in_the_wrong_order_stop_it_with_one_line(start_node):
    process = start_node("planner", {"manage_fleet": True, "low_battery": 0.1, "critical_battery": 0.2})
    assert process.wait() == 1
    assert len(process.output.strip().splitlines()) == 1 and "critical_battery" in process.output


def test_devices_that_a_relief_cannot_serve_from_above_are_named(world):
    # Equation (3) with 10 W, straight below: 21.93 bit/s/Hz from 50 m, 21.17 from 65 m.
    here = world(rate=21.5)
    crew = here.served()
    here.bridge.states[crew["west"]].battery_remaining = 0.25
    here.wait(lambda: here.crew()["west"] != crew["west"], "the change of roles")
    changes = [d for d in here.deployments if "relieves" in d.reason]
    assert [list(d.interrupted) for d in changes] == [["west"]]


def test_a_short_loss_is_told_and_changes_nothing(world):
    here = world(lost_after_s=600.0)
    crew, before = here.served(), here.deployments[-1]
    here.bridge.states[crew["west"]].link = VehicleState.LINK_LOST
    here.wait(lambda: f"{crew['west']} is lost" in here.deployments[-1].reason, "the news of the loss")
    here.bridge.states[crew["west"]].link = VehicleState.LINK_CONNECTED
    here.wait(lambda: f"{crew['west']} is back" in here.deployments[-1].reason, "the news that it is back")
    assert cells(here.deployments[-1]) == cells(before)


def test_a_planner_killed_while_it_manages_the_fleet_moves_nobody(world, tmp_path):
    here = world(state_file=str(tmp_path / "plan.json"))
    here.served()
    before, count, orders = here.deployments[-1], len(here.deployments), list(here.bridge.orders)
    here.restart()
    here.wait(lambda: len(here.deployments) > count, "a plan of the restarted planner")
    assert "planner restarted" in here.deployments[count].reason
    # Beyond the first looks at the fleet's life.
    here.graph.spin(1.5)
    assert all(cells(d) == cells(before) for d in here.deployments[count:])
    stored = json.loads((tmp_path / "plan.json").read_text())
    assert set(stored["names"].values()) == set(here.crew().values())
    assert here.bridge.orders == orders


def test_a_planner_killed_together_with_its_bridge_waits_until_aircraft_are_heard(world, tmp_path):
    here = world(state_file=str(tmp_path / "plan.json"))
    here.served()
    before, count, orders = here.deployments[-1], len(here.deployments), list(here.bridge.orders)
    # A bridge that has just started says this of everybody first.
    for state in here.bridge.states.values():
        state.link = VehicleState.LINK_NEVER_SEEN
    here.graph.spin(0.5)
    here.restart()
    here.said("listening to")
    here.graph.spin(1.0)
    for state in here.bridge.states.values():
        state.link = VehicleState.LINK_CONNECTED
    here.wait(lambda: len(here.deployments) > count, "a plan of the restarted planner")
    here.graph.spin(1.5)
    assert all(cells(d) == cells(before) for d in here.deployments[count:])
    assert here.bridge.orders == orders


def test_whom_the_planner_sent_home_is_launched_again_by_the_one_after_it(world, tmp_path):
    here = world(idle_return_s=1.0, state_file=str(tmp_path / "plan.json"))
    crew = here.served()
    back = crew["west"]
    here.send(departed=["west"])
    here.wait(lambda: back in here.bridge.ordered("return_home"), "its return")
    here.wait(lambda: back in json.loads((tmp_path / "plan.json").read_text())["sent_home"], "that to be kept")
    for name in set(UAVS) - set(crew.values()):
        here.bridge.states[name].link = VehicleState.LINK_LOST
    count = len(here.deployments)
    here.restart()
    here.wait(lambda: len(here.deployments) > count, "a plan of the restarted planner")
    assert here.bridge.states[back].goal_state == VehicleState.GOAL_YIELDED
    here.send(["west"])
    here.wait(lambda: here.crew().get("west") == back, "a cell for it")
    here.wait(lambda: here.bridge.ordered("launch").count(back) == 2, "its second launch")


def test_a_bridge_that_falls_silent_is_told_and_costs_nobody_his_cell(world):
    here = world(lost_after_s=1.0)
    crew, told = here.served(), here.bridge.rounds
    # What the bridge said last is how things are: nobody is believed to be on the ground still.
    here.wait(lambda: here.bridge.rounds >= told + 2, "reports of the present states")
    count, orders = len(here.deployments), list(here.bridge.orders)
    here.bridge.silent = set(UAVS)
    here.said("bridge silent: no aircraft's state for")
    here.graph.spin(2.0)
    here.bridge.silent = set()
    here.said("the bridge is heard again")
    here.graph.spin(1.5)
    assert here.crew() == crew and here.bridge.orders == orders
    assert not any("lost" in d.reason for d in here.deployments[count:])


@pytest.mark.parametrize(("height_m", "starts"), [(64.0, False), (70.0, True)])
def test_where_the_fence_leaves_no_room_above_a_cell_for_its_relief_that_is_refused(
    graph, start_node, tmp_path, height_m, starts
):
    fleet = {"version": 1, "origin": {"latitude": 0.0, "longitude": 0.0}, "fence": {"max_height_m": height_m}}
    fleet["uavs"] = [{"name": "uav1", "sysid": 1, "url": "udpin:127.0.0.1:14001"}]
    (tmp_path / "fleet.yaml").write_text(yaml.safe_dump(fleet))
    process = start_node("planner", {"fleet_file": str(tmp_path / "fleet.yaml"), "manage_fleet": True})
    rule = f"altitude_m + station_above_m must not exceed the fence's max_height_m ({height_m:g} m)"
    if not starts:
        assert process.wait() == 1 and rule in process.output
        return
    value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=56.0)
    request = SetParameters.Request(parameters=[Parameter(name="altitude_m", value=value)])
    answer = graph.call(SetParameters, "planner/set_parameters", request).results[0]
    assert not answer.successful and answer.reason.startswith(f"{rule}, got 71 m")


@pytest.mark.parametrize(("separation_m", "told"), [(15.0, False), (18.0, True)])
def test_a_bridge_that_would_hold_every_relief_is_told_of(world, graph, separation_m, told):
    bridge = Node("bridge", context=graph.node.context)
    bridge.declare_parameter("min_separation_m", separation_m)
    graph.add_node(bridge)
    said = graph.collect(DiagnosticArray, "/diagnostics", 10)
    here = world(station_above_m=15.0)
    here.served()

    def problem():
        return "start the planner with station_above_m 18 or more" in said[-1].status[0].message

    if told:
        here.wait(lambda: said and problem(), "the diagnostic")
        here.said("the bridge's min_separation_m is 18 m")
    else:
        graph.spin(2.0)
        assert said and not problem()
    bridge.destroy_node()

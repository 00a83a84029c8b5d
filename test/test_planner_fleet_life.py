"""The planner that manages its fleet: launches, losses, reliefs and returns, over real topics and services.

The test stands in for the bridge: it says what every aircraft does and serves the bridge's services, so that a battery
runs low or a link is lost exactly when the test wants it. Oracle: the rules of the fleet's life, worked by hand.
"""

import pytest
import yaml
from geometry_msgs.msg import Point, PoseStamped
from jpap_msgs.msg import Deployment, Device, DeviceUpdate, FleetCommandResult, VehicleState
from jpap_msgs.srv import FleetCommand

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
        for name, state in self.states.items():
            if name not in self.silent:
                self._out[name].publish(state)


class World:
    """The planner with the test's bridge."""

    def __init__(self, graph, process):
        self.graph, self.process = graph, process
        self.deployments = graph.collect(Deployment, "deployment", LATCHED)
        self.bridge = BridgeByHand(graph)
        self._devices = graph.publisher(DeviceUpdate, "devices", DEVICES)

    def send(self, names=(), departed=()):
        message = DeviceUpdate(departed=list(departed))
        message.header.frame_id = "map"
        message.devices = [
            Device(id=n, position=Point(x=DEVICES_AT[n][0], y=DEVICES_AT[n][1]), rate_demand=16.0, weight=1.0)
            for n in names
        ]
        self._devices.publish(message)

    def crew(self):
        """Aircraft by the device that it serves, as the newest deployment says."""
        return {c.device_ids[0]: c.uav for c in self.deployments[-1].cells if c.uav} if self.deployments else {}

    def wait(self, condition, what):
        return self.graph.wait(condition, what)

    def served(self):
        """Bring both devices on the air: the crew is launched and at its goals."""
        self.wait(lambda: all(s.get_subscription_count() for s in self.bridge._out.values()), "the planner's ears")
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

    def start(**parameters):
        uavs = [{"name": n, "sysid": i, "url": f"udpin:127.0.0.1:{14000 + i}"} for i, n in enumerate(UAVS, 1)]
        fleet = {"version": 1, "origin": {"latitude": 0.0, "longitude": 0.0}, "uavs": uavs}
        (tmp_path / "fleet.yaml").write_text(yaml.safe_dump(fleet))
        settings = {"fleet_file": str(tmp_path / "fleet.yaml"), "manage_fleet": True, "reoptimise": False}
        return World(graph, start_node("planner", {**settings, **parameters}))

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
    assert f"{relief} relieves {tired}" in " ".join(d.reason for d in here.deployments)
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

"""The planner as a process of its own, over real DDS.

Oracles: `solve` called here with the same devices, for the cells; the channel's equations with the paper's constants
written out, for powers and rates; the ROS contract, for everything else.
"""

import math
import re
import signal
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Point, PoseStamped
from jpap_msgs.msg import Deployment, Device, DeviceUpdate, GeoDevice, GeoDeviceUpdate, PowerAllocation, VehicleState
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.qos import QoSProfile
from std_srvs.srv import Trigger

from jpap_ros.nodes.qos import DEVICES, LATCHED
from jpap_ros.planning import solve

SCHEME = "jpap"
TRANSMIT_POWER_W, NOISE_W, REFERENCE_GAIN, ALTITUDE_M = 10.0, 1e-12, 1e-3, 50.0
ORIGIN = (-37.8136, 144.9631)
UAVS = [f"uav{i}" for i in range(1, 25)]

#: Three groups, 800 m and more apart: no UAV can serve two of them at these demands.
GROUPS = {
    "a1": (0.0, 0.0, 16.0),
    "a2": (40.0, 10.0, 15.5),
    "b1": (900.0, 0.0, 17.0),
    "b2": (930.0, 30.0, 15.0),
    "c1": (0.0, 800.0, 18.0),
}


def write_fleet(path, count):
    uavs = [
        {"name": name, "sysid": i, "url": f"udpin:127.0.0.1:{14000 + i}", "home_m": [10.0 * i, -50.0]}
        for i, name in enumerate(UAVS[:count], 1)
    ]
    origin = {"latitude": ORIGIN[0], "longitude": ORIGIN[1]}
    path.write_text(yaml.safe_dump({"version": 1, "origin": origin, "uavs": uavs}))
    return str(path)


#: As latched topics are, but with room for all that comes while the test does something else.
EVERY_PLAN = QoSProfile(depth=1000, reliability=LATCHED.reliability, durability=LATCHED.durability)


class Planner:
    """A running planner and all that the test hears of it."""

    def __init__(self, graph, start_node, fleet_file, **parameters):
        self.graph = graph
        # Unless a test is about it, no plan comes from behind and takes a plan id.
        settings = {"fleet_file": fleet_file, "scheme": SCHEME, "reoptimise": False}
        self.process = start_node("planner", {**settings, **parameters})
        self.deployments = graph.collect(Deployment, "deployment", EVERY_PLAN)
        self.goals = {name: graph.collect(PoseStamped, f"{name}/goal_pose", LATCHED) for name in UAVS}
        self.powers = {name: graph.collect(PowerAllocation, f"{name}/power_allocation", LATCHED) for name in UAVS}
        self._devices = None

    @property
    def last(self):
        return self.deployments[-1]

    def connect(self):
        self._devices = self.graph.publisher(DeviceUpdate, "devices", DEVICES)
        self.graph.wait(
            lambda: (
                self.graph.node.count_publishers("deployment") and self.graph.node.count_publishers("uav1/goal_pose")
            ),
            "the planner's topics",
        )

    def send(self, devices=(), departed=(), snapshot=False, frame="map"):
        if self._devices is None:
            self.connect()
        self._devices.publish(report(devices, departed, snapshot, frame))

    def silence(self):
        """Take the reporter of devices out of the graph, with all that it has said."""
        self.graph.node.destroy_publisher(self._devices)

    def plan(self, reason, timeout_s=60.0):
        """Wait for the deployment whose reason has these words."""
        return self.graph.wait(
            lambda: next((d for d in self.deployments if reason in d.reason), None),
            f"a plan because {reason!r}",
            timeout_s,
        )

    def said(self, *words):
        self.graph.wait(lambda: all(word in self.process.output for word in words), f"the words {words} in the log")

    def set(self, name, value):
        kind, field = {
            str: (ParameterType.PARAMETER_STRING, "string_value"),
            float: (ParameterType.PARAMETER_DOUBLE, "double_value"),
            int: (ParameterType.PARAMETER_INTEGER, "integer_value"),
        }[type(value)]
        content = ParameterValue(type=kind, **{field: value})
        request = SetParameters.Request(parameters=[Parameter(name=name, value=content)])
        return self.graph.call(SetParameters, "planner/set_parameters", request).results[0]


def report(devices=(), departed=(), snapshot=False, frame="map"):
    """Return an update from {id: (x, y, rate)} or from messages."""
    message = DeviceUpdate(snapshot=snapshot, departed=list(departed))
    message.header.frame_id = frame
    entries = devices.items() if isinstance(devices, dict) else [(None, device) for device in devices]
    message.devices = [entry if name is None else device(name, *entry) for name, entry in entries]
    return message


def device(name, x, y, rate, weight=1.0):
    return Device(id=name, position=Point(x=x, y=y), rate_demand=rate, weight=weight)


def cells_by_solve(devices, **options):
    """Return {set of device ids: (position, powers by id)} as `solve` finds it, in the order given."""
    names = list(devices)
    deployment = solve(
        [devices[n][:2] for n in names], [devices[n][2] for n in names], **{"scheme": SCHEME, "max_uavs": 6, **options}
    )
    return {
        frozenset(names[k] for k in deployment.cell(uav)): (
            deployment.uav_positions[uav],
            {names[k]: deployment.power_w[k] for k in deployment.cell(uav)},
        )
        for uav in range(len(deployment.uav_positions))
    }


def assert_cells_are(message, expected):
    assert {frozenset(cell.device_ids) for cell in message.cells} == set(expected)
    for cell in message.cells:
        position, powers = expected[frozenset(cell.device_ids)]
        goal = cell.goal_pose.position
        assert (goal.x, goal.y, goal.z) == pytest.approx((*position, ALTITUDE_M), abs=1e-6)
        assert dict(zip(cell.device_ids, cell.power_w, strict=True)) == pytest.approx(powers)


def assert_demands_met(message, devices):
    """Equations (1) and (3) and constraint (6c), from the message alone."""
    for cell in message.cells:
        assert sum(cell.power_w) == pytest.approx(TRANSMIT_POWER_W)
        assert cell.uav_rate == pytest.approx(sum(cell.rate))
        for name, power, rate in zip(cell.device_ids, cell.power_w, cell.rate, strict=True):
            x, y, demand = devices[name]
            goal = cell.goal_pose.position
            gain = REFERENCE_GAIN / ((goal.x - x) ** 2 + (goal.y - y) ** 2 + ALTITUDE_M**2)
            assert rate == pytest.approx(math.log2(1 + power * gain / NOISE_W))
            assert rate >= demand * (1 - 1e-9)


@pytest.fixture
def planner(graph, start_node, tmp_path):
    """Return a function that starts a planner; parameters as keywords, `uavs` the size of its fleet."""

    def start(uavs=6, **parameters):
        return Planner(graph, start_node, write_fleet(tmp_path / "fleet.yaml", uavs), **parameters)

    return start


def test_devices_become_a_deployment_goals_and_power_allocations(planner):
    node = planner()
    node.send(GROUPS)
    plan = node.plan("5 devices joined")
    assert_cells_are(plan, cells_by_solve(GROUPS))
    assert_demands_met(plan, GROUPS)
    assert (plan.plan_id, plan.scheme, plan.header.frame_id) == (1, SCHEME, "map")
    assert plan.uavs_needed == len(plan.cells) and list(plan.unserved) == []
    assert plan.average_uav_rate == pytest.approx(np.mean([cell.uav_rate for cell in plan.cells]))
    assert 0 < plan.planning_time.sec + plan.planning_time.nanosec * 1e-9 < 60
    flying = {cell.uav: cell for cell in plan.cells}
    assert flying.keys() <= set(UAVS) and len(flying) == len(plan.cells)
    node.graph.wait(lambda: all(node.goals[name] and node.powers[name] for name in flying), "every goal")
    for name, cell in flying.items():
        goal, power = node.goals[name][-1], node.powers[name][-1]
        assert goal.header == plan.header == power.header
        assert goal.pose == cell.goal_pose
        assert (goal.pose.orientation.w, goal.pose.orientation.x) == (1.0, 0.0)
        assert (power.plan_id, power.uav, power.device_ids) == (plan.plan_id, name, cell.device_ids)
        assert (list(power.power_w), list(power.rate)) == (list(cell.power_w), list(cell.rate))
    assert all(not node.goals[name] for name in set(UAVS) - flying.keys())
    assert node.process.output.count("listening to /devices and /geo_devices") == 1


def test_a_late_subscriber_gets_the_plan_in_force(planner):
    node = planner()
    node.send(GROUPS)
    plan = node.plan("joined")
    late = node.graph.collect(Deployment, "deployment", LATCHED)
    goals = node.graph.collect(PoseStamped, f"{plan.cells[0].uav}/goal_pose", LATCHED)
    node.graph.wait(lambda: late and goals, "latched messages")
    assert [(message.header, message.plan_id, message.cells) for message in late] == [(plan.header, 1, plan.cells)]
    assert goals[0].header == plan.header and goals[0].pose == plan.cells[0].goal_pose


def test_a_planner_that_starts_late_gets_the_reports_it_missed(planner, graph):
    publisher = graph.node.create_publisher(DeviceUpdate, "devices", DEVICES)
    for name, entry in GROUPS.items():
        publisher.publish(report({name: entry}))
    node = planner(debounce_s=0.5, debounce_max_s=5.0)
    assert_cells_are(node.plan("5 devices joined"), cells_by_solve(GROUPS))


@pytest.mark.parametrize("late", ["planner", "reporter"])
def test_what_a_reporter_repeats_is_answered_by_one_plan_for_what_is_so_now(planner, graph, late):
    """A device has moved a hundred times before the two found each other; only where it is now counts."""
    node = planner() if late == "reporter" else None
    if node:
        graph.wait(lambda: graph.node.count_publishers("deployment"), "the planner")
    reporter = graph.node.create_publisher(DeviceUpdate, "devices", DEVICES)
    for step in range(100):
        reporter.publish(report({"walker": (10.0 * step, 0.0, 16.0)}))
    node = node or planner()
    node.plan("1 device joined")
    graph.spin(1.0)
    (plan,) = node.deployments
    (cell,) = plan.cells
    assert cell.goal_pose.position.x == pytest.approx(990.0, abs=1e-3)


def test_positions_in_degrees_end_where_the_earth_s_radii_put_them(planner, graph):
    """Metres per degree of WGS-84 at the origin's latitude, from the ellipsoid's radii of curvature."""
    latitude = math.radians(ORIGIN[0])
    a, e2 = 6378137.0, 6.69437999014e-3
    prime_vertical = a / math.sqrt(1 - e2 * math.sin(latitude) ** 2)
    meridional = prime_vertical * (1 - e2) / (1 - e2 * math.sin(latitude) ** 2)
    north, east = math.degrees(120.0 / meridional), math.degrees(-70.0 / (prime_vertical * math.cos(latitude)))
    node = planner()
    geo = graph.publisher(GeoDeviceUpdate, "geo_devices", DEVICES)
    geo.publish(
        GeoDeviceUpdate(
            devices=[GeoDevice(id="g", latitude=ORIGIN[0] + north, longitude=ORIGIN[1] + east, rate_demand=16.0)]
        )
    )
    goal = node.plan("1 device joined").cells[0].goal_pose.position
    # One device alone is served from straight above; the plane's curvature over 140 m is below a centimetre.
    assert (goal.x, goal.y) == pytest.approx((-70.0, 120.0), abs=0.05)


def test_a_burst_of_forty_joins_makes_one_plan(planner):
    node = planner(debounce_s=0.5, debounce_max_s=30.0)
    for k in range(40):
        node.send({f"d{k}": (5.0 * k, 0.0, 15.0)})
    plan = node.plan("40 devices joined")
    assert plan.plan_id == 1
    assert sum(len(cell.device_ids) for cell in plan.cells) + len(plan.unserved) == 40
    node.graph.spin(1.5)
    assert node.deployments == [plan]


def test_an_endless_stream_of_events_cannot_put_planning_off(planner):
    node = planner(debounce_s=30.0, debounce_max_s=1.0)
    node.connect()
    started, k = time.monotonic(), 0
    while not node.deployments:
        assert time.monotonic() - started < 25.0, "no plan before the quiet time of 30 s, which the stream never leaves"
        k += 1
        node.send({"d": (float(k), 0.0, 16.0)})
        node.graph.spin(0.1)


def test_every_event_is_in_the_reason_of_a_plan(planner):
    node = planner()
    node.send(GROUPS)
    node.plan("5 devices joined")
    node.send({"a1": (5.0, 5.0, 16.0), "b1": (900.0, 0.0, 17.5), "d1": (20.0, 20.0, 15.0)}, departed=["c1"])
    plan = node.plan("1 device joined, 1 moved, 1 changed demand, 1 left")
    now = {**GROUPS, "a1": (5.0, 5.0, 16.0), "b1": (900.0, 0.0, 17.5), "d1": (20.0, 20.0, 15.0)}
    del now["c1"]
    assert {d for cell in plan.cells for d in cell.device_ids} == set(now)
    assert_demands_met(plan, now)
    assert plan.plan_id == 2
    node.send(GROUPS, snapshot=True)
    plan = node.plan("1 device joined, 1 moved, 1 changed demand, 1 left", 60)
    node.graph.wait(lambda: node.last.plan_id == 3, "the plan after the snapshot")
    assert {d for cell in node.last.cells for d in cell.device_ids} == set(GROUPS)
    assert_demands_met(node.last, GROUPS)


def test_an_unchanged_cell_keeps_its_aircraft_and_a_lost_cell_gives_its_power_back(planner):
    node = planner()
    node.send(GROUPS)
    first = {frozenset(cell.device_ids): cell.uav for cell in node.plan("joined").cells}
    node.send({"e1": (-900.0, 0.0, 16.0)})
    second = {frozenset(cell.device_ids): cell.uav for cell in node.plan("1 device joined").cells}
    assert first.items() <= second.items() and len(second) == len(first) + 1
    node.send(departed=["e1"])
    third = {frozenset(cell.device_ids): cell.uav for cell in node.plan("1 device left").cells}
    assert third == first
    freed = second[frozenset({"e1"})]
    node.graph.wait(lambda: node.powers[freed] and not node.powers[freed][-1].device_ids, "an empty allocation")
    assert node.powers[freed][-1].plan_id == 3


def test_goals_go_to_the_aircraft_that_are_nearest(planner, graph):
    """uav5 stands by group a and uav6 by group b, by their telemetry; all others are at home, 50 m south of a."""
    node = planner()
    states = {name: graph.publisher(VehicleState, f"{name}/state", LATCHED) for name in ("uav5", "uav6")}
    for name, x in (("uav5", 20.0), ("uav6", 915.0)):
        states[name].publish(
            VehicleState(uav=name, link=VehicleState.LINK_CONNECTED, position_valid=True, position=Point(x=x, y=5.0))
        )
    # Different topics may overtake each other.
    node.said("uav5 is heard", "uav6 is heard")
    devices = {name: entry for name, entry in GROUPS.items() if name[0] in "ab"}
    node.send(devices)
    node.plan("4 devices joined")
    by_group = {cell.device_ids[0][0]: cell.uav for cell in node.last.cells}
    assert by_group == {"a": "uav5", "b": "uav6"}


#: Squared distances are least in sum where uav2 flies 1200 m to east; if uav1 goes there, nobody flies beyond 1000 m.
CORNERS = {"west": (0.0, 0.0, 16.0), "east": (1000.0, 0.0, 16.0)}
STANDS = {"uav1": (0.0, 0.0), "uav2": (280.0, 960.0)}


def test_who_flies_where_follows_the_objective_that_is_set(planner, graph):
    """Oracle: both objectives worked by hand from three distances; 280^2 + 960^2 = 1000^2, 720^2 + 960^2 = 1200^2."""
    node = planner(uavs=2)
    for name, (x, y) in STANDS.items():
        graph.publisher(VehicleState, f"{name}/state", LATCHED).publish(
            VehicleState(uav=name, link=VehicleState.LINK_CONNECTED, position_valid=True, position=Point(x=x, y=y))
        )
    node.said("uav1 is heard", "uav2 is heard")

    def crew():
        return {cell.device_ids[0]: cell.uav for cell in node.last.cells}

    node.send(CORNERS)
    node.plan("2 devices joined")
    assert crew() == {"west": "uav1", "east": "uav2"}
    assert node.set("assignment", "bottleneck").successful
    # Who has a cell keeps it: nobody is exchanged in the air because of a parameter.
    node.plan("parameter assignment is now bottleneck")
    assert crew() == {"west": "uav1", "east": "uav2"}
    node.send(departed=CORNERS)
    node.plan("2 devices left")
    node.send(CORNERS)
    graph.wait(lambda: node.last.plan_id == 4, "the fourth plan")
    assert crew() == {"west": "uav2", "east": "uav1"}
    refused = node.set("assignment", "shortest")
    assert not refused.successful and "'shortest'" in refused.reason


BAD = {
    "nan position": (device("bad", math.nan, 0.0, 16.0), "position.x", "nan"),
    "infinite position": (device("bad", 0.0, math.inf, 16.0), "position.y", "inf"),
    "nan demand": (device("bad", 0.0, 0.0, math.nan), "rate_demand", "nan"),
    "infinite demand": (device("bad", 0.0, 0.0, math.inf), "rate_demand", "inf"),
    "negative demand": (device("bad", 0.0, 0.0, -2.5), "rate_demand", "-2.5"),
    "zero demand": (device("bad", 0.0, 0.0, 0.0), "rate_demand", "0.0"),
    "negative weight": (device("bad", 0.0, 0.0, 16.0, -1.0), "weight", "-1.0"),
    "nan weight": (device("bad", 0.0, 0.0, 16.0, math.nan), "weight", "nan"),
}


def test_bad_devices_are_named_and_ignored_alone(planner, graph):
    node = planner()
    diagnostics = graph.collect(DiagnosticArray, "/diagnostics", 10)
    expected = dict(GROUPS)
    node.send(GROUPS)
    node.plan("5 devices joined")
    for k, (bad, field, value) in enumerate(BAD.values()):
        # A different name each, so that each fault is a new one; the good device beside it is taken in.
        bad.id = f"bad{k}"
        good = {f"good{k}": (30.0 + k, 20.0, 15.0)}
        expected |= good
        node.send([bad, *report(good).devices])
        graph.wait(lambda k=k: node.last.plan_id == k + 2, f"the plan with good{k}")
        node.said(f"device 'bad{k}': {field} must be", f"got {value}")
        assert {d for cell in node.last.cells for d in cell.device_ids} == set(expected)
    plans = len(node.deployments)

    # The last good report stays, whatever is wrong with the new one: none of these makes another plan.
    node.send([device("a1", math.nan, 0.0, 16.0)])
    node.said("device 'a1': position.x must be")
    node.send([device("", 0.0, 0.0, 16.0)])
    node.said("device '': id must not be empty")
    node.send([device("a2", 1.0, 1.0, 16.0), device("a2", 2.0, 2.0, 16.0)])
    node.said("device 'a2': id must be unique in a report, got 'a2' 2 times")
    node.send([device("b1", 1.0, 1.0, 16.0)], departed=["b1"])
    node.said("device 'b1': id must not be both in devices and in departed")
    node.send({"x1": (0.0, 0.0, 16.0)}, frame="odom")
    node.said("header.frame_id must be 'map', got 'odom'")
    node.send({"x1": (0.0, 0.0, 16.0)}, snapshot=True, frame="")
    node.said("header.frame_id must be 'map', got ''")
    # The same fault again is not said again.
    for _ in range(5):
        node.send([device("a1", math.nan, 0.0, 16.0)])
    graph.wait(lambda: faults(diagnostics) >= len(BAD) + 11, "the faults to be counted")
    assert node.process.output.count("device 'a1'") == 1
    assert status(diagnostics).level == DiagnosticStatus.WARN
    assert "wrong and ignored" in status(diagnostics).message

    # And nothing has crashed or been lost: the next good report is planned with everything known before.
    assert len(node.deployments) == plans
    node.send({"last": (10.0, 30.0, 15.0)})
    graph.wait(lambda: len(node.deployments) == plans + 1, "the next plan")
    assert {d for cell in node.last.cells for d in cell.device_ids} == {*expected, "last"}
    assert_demands_met(node.last, {**expected, "last": (10.0, 30.0, 15.0)})


def test_bad_degrees_are_named_and_ignored_alone(planner, graph):
    node = planner()
    geo = graph.publisher(GeoDeviceUpdate, "geo_devices", DEVICES)
    geo.publish(
        GeoDeviceUpdate(
            devices=[
                GeoDevice(id="pole", latitude=95.0, longitude=ORIGIN[1], rate_demand=16.0),
                GeoDevice(id="nowhere", latitude=ORIGIN[0], longitude=math.nan, rate_demand=16.0),
                GeoDevice(id="abroad", latitude=ORIGIN[0] + 3.0, longitude=ORIGIN[1], rate_demand=16.0),
                GeoDevice(id="good", latitude=ORIGIN[0], longitude=ORIGIN[1], rate_demand=16.0),
            ]
        )
    )
    assert [list(cell.device_ids) for cell in node.plan("1 device joined").cells] == [["good"]]
    node.said(
        "device 'pole': latitude must be", "95.0", "device 'nowhere': longitude must be", "nan", "device 'abroad'"
    )


def test_a_demand_that_no_uav_can_meet_is_reported_and_harms_nobody(planner):
    node = planner()
    node.send({**GROUPS, "greedy": (100.0, 0.0, 25.0)})
    plan = node.plan("6 devices joined")
    assert [u.id for u in plan.unserved] == ["greedy"]
    # log2(1 + P_T rho_0 / (sigma^2 H^2)) is 21.93 bit/s/Hz.
    assert "25" in plan.unserved[0].reason and "21.93" in plan.unserved[0].reason
    node.said("not served: device 'greedy': rate_demand 25 bit/s")
    assert_cells_are(plan, cells_by_solve(GROUPS))


def test_a_fleet_too_small_serves_what_it_can_and_says_so(planner, graph):
    node = planner(uavs=2)
    diagnostics = graph.collect(DiagnosticArray, "/diagnostics", 10)
    node.send(GROUPS)
    plan = node.plan("5 devices joined")
    served = {d for cell in plan.cells for d in cell.device_ids}
    left_out = {u.id: u.reason for u in plan.unserved}
    assert sorted(cell.uav for cell in plan.cells) == ["uav1", "uav2"]
    assert served | left_out.keys() == set(GROUPS) and not served & left_out.keys()
    assert left_out and all(left_out.values())
    assert plan.uavs_needed == 3
    assert_demands_met(plan, GROUPS)
    graph.wait(lambda: diagnostics and "not served" in status(diagnostics).message, "a warning in the diagnostics")
    assert status(diagnostics).level == DiagnosticStatus.WARN


@pytest.mark.parametrize(
    ("trouble", "words"),
    [
        ({"link": VehicleState.LINK_LOST}, "is lost"),
        ({"goal_state": VehicleState.GOAL_YIELDED, "goal_reason": "pilot"}, "was taken over (pilot)"),
        ({"system_status": 5}, "reports a critical system status"),
        ({"battery_charge_state": 3}, "has a critical battery"),
    ],
    ids=["lost", "yielded", "status", "battery"],
)
def test_aircraft_in_trouble_give_their_cell_to_another_and_may_come_back(planner, graph, trouble, words):
    node = planner(uavs=3)
    node.send(GROUPS)
    first = node.plan("5 devices joined")
    victim = first.cells[0].uav
    state = graph.publisher(VehicleState, f"{victim}/state", LATCHED)
    healthy = {"uav": victim, "link": VehicleState.LINK_CONNECTED, "position_valid": False}
    state.publish(VehicleState(**{**healthy, **trouble}))
    second = node.plan(f"{victim} {words}")
    assert victim not in [cell.uav for cell in second.cells]
    assert second.unserved and second.uavs_needed == 3
    state.publish(VehicleState(**healthy))
    third = node.plan(f"{victim} is available")
    assert victim in [cell.uav for cell in third.cells] and not third.unserved


def test_what_happens_to_aircraft_is_in_the_reason_of_a_plan(planner, graph):
    node = planner(uavs=3, low_battery=0.3)
    # What was heard before there was anything to serve is told with the first plan, and makes none by itself.
    said = {name: graph.publisher(VehicleState, f"{name}/state", LATCHED) for name in UAVS[:3]}

    def says(name, landed_state=VehicleState.LANDED_IN_AIR, battery=0.9):
        said[name].publish(
            VehicleState(
                uav=name, link=VehicleState.LINK_CONNECTED, landed_state=landed_state, battery_remaining=battery
            )
        )

    says("uav1")
    node.said("uav1 is heard")
    assert not node.deployments
    node.send({"a1": GROUPS["a1"]})
    assert "uav1 joined" in node.plan("1 device joined").reason
    says("uav2")
    node.plan("uav2 joined")
    says("uav2", battery=0.29)
    node.plan("uav2 is low on battery")
    says("uav2", VehicleState.LANDED_ON_GROUND, battery=0.28)
    plan = node.plan("uav2 has landed")
    assert "uav1" not in plan.reason and [list(cell.device_ids) for cell in plan.cells] == [["a1"]]


def test_of_a_storm_of_events_none_is_lost_and_none_told_twice(planner, graph):
    """Oracle: what was sent, counted; read from all reasons together."""
    node = planner(uavs=24)
    said = graph.publisher(VehicleState, "uav1/state", LATCHED)
    rng = np.random.default_rng(8)
    known = {f"d{k}": (*rng.uniform(-300, 300, 2), 14.0) for k in range(20)}
    node.send(known)
    node.plan("20 devices joined")
    sent = Counter()
    for k in range(60):
        kind = ("joined", "moved", "changed demand", "left")[int(rng.integers(4))]
        sent[kind] += 1
        name = f"n{k}" if kind == "joined" else sorted(known)[int(rng.integers(len(known)))]
        x, y, rate = known.get(name, (*rng.uniform(-300, 300, 2), 14.0))
        if kind == "left":
            del known[name]
            node.send(departed=[name])
        else:
            known[name] = (x + 1.0 * (kind == "moved"), y, rate + 0.01 * (kind == "changed demand"))
            node.send({name: known[name]})
        if k == 20:
            said.publish(VehicleState(uav="uav1", link=VehicleState.LINK_LOST))
        if k == 30:
            assert node.set("tolerance", 0.4).successful and node.set("max_devices_per_uav", 9).successful
        if k == 40:
            assert graph.call(Trigger, "planner/replan").success
        # Now in the middle of planning, now in the quiet time, now after it.
        graph.spin(float(rng.choice([0.0, 0.0, 0.02, 0.1])))

    def told():
        counts = Counter()
        for plan in node.deployments[1:]:
            for number, what in re.findall(r"(\d+)(?: devices?)? (joined|moved|changed demand|left)", plan.reason):
                counts[what] += int(number)
        return counts

    graph.wait(lambda: sum(told().values()) >= 60, "all events in reasons")
    graph.spin(0.5)
    assert told() == sent
    reasons = ", ".join(plan.reason for plan in node.deployments)
    for once in ("uav1 is lost", "parameter max_devices_per_uav is now 9", "operator asked"):
        assert reasons.count(once) == 1
    assert len(node.deployments) < 62, "some were answered together"
    assert {d for cell in node.last.cells for d in cell.device_ids} | {u.id for u in node.last.unserved} == set(known)
    assert_demands_met(node.last, known)


def flies_at_its_goal(graph, node, cell):
    """Let telemetry say that a cell's aircraft is there, and wait for the plan that says so."""
    state = VehicleState(uav=cell.uav, link=VehicleState.LINK_CONNECTED, landed_state=VehicleState.LANDED_IN_AIR)
    state.position_valid, state.position = True, cell.goal_pose.position
    graph.publisher(VehicleState, f"{cell.uav}/state", LATCHED).publish(state)
    return node.plan(f"{cell.uav} joined")


def test_powers_wait_until_they_suit_those_who_are_served(planner, graph):
    """By hand: shared by two, 10 W reach devices of 17 bit/s/Hz up to 188.8 m; by three, up to
    sqrt(1e10 / 3 / (2^17 - 1) - 50^2) = 151.4 m. The UAV over a goes to 290 - 188.8 = 101.2 m when b joins, and on to
    290 - 151.4 = 138.6 m when c does: only there is b within reach of its new power.
    """
    node = planner(uavs=1)
    node.send({"a": (0.0, 0.0, 17.0)})
    node.plan("1 device joined")
    node.send({"b": (290.0, 0.0, 17.0)})
    graph.wait(lambda: len(node.deployments) == 2, "the plan for b")
    assert node.last.cells[0].goal_pose.position.x == pytest.approx(101.2, abs=0.1)
    flies_at_its_goal(graph, node, node.last.cells[0])
    node.send({"c": (150.0, 0.0, 17.0)})
    graph.wait(lambda: len(node.last.cells[0].device_ids) == 3, "the plan for c")
    assert node.last.cells[0].goal_pose.position.x == pytest.approx(138.6, abs=0.1)
    assert not node.last.interrupted and not node.last.unserved
    powers = node.powers["uav1"]
    graph.wait(lambda: powers[-1].plan_id == node.last.plan_id, "the powers of that plan")
    assert {len(m.device_ids): m.apply_within_m for m in powers} == {1: 0.0, 2: 0.0, 3: pytest.approx(2.0)}


def test_an_aircraft_goes_on_until_the_one_that_takes_over_serves(planner, graph):
    """By hand: two devices 300 m apart need two UAVs at 19 bit/s/Hz (with half the power one reaches 83.9 m), and one
    at 17 (188.8 m). Who is to serve both is 1500 m off: the other one holds its device until that one has come.
    """
    node = planner(uavs=2)
    node.send({"a": (0.0, 0.0, 19.0), "b": (300.0, 0.0, 19.0)})
    cells = {cell.uav: cell for cell in node.plan("2 devices joined").cells}
    states = {uav: graph.publisher(VehicleState, f"{uav}/state", LATCHED) for uav in cells}

    def fly(uav, east, north):
        state = VehicleState(uav=uav, link=VehicleState.LINK_CONNECTED, landed_state=VehicleState.LANDED_IN_AIR)
        state.position_valid, state.position = True, Point(x=east, y=north, z=ALTITUDE_M)
        states[uav].publish(state)

    for uav, cell in cells.items():
        fly(uav, cell.goal_pose.position.x, cell.goal_pose.position.y)
        node.plan(f"{uav} joined")
    devices = {"a": (0.0, 0.0, 17.0), "b": (300.0, 0.0, 17.0)}
    node.send(devices)
    node.plan("changed demand")
    (place,) = solve([(0.0, 0.0), (300.0, 0.0)], [17.0, 17.0], scheme=SCHEME).uav_positions.tolist()
    heir, holder = sorted(
        cells,
        key=lambda uav: math.hypot(
            place[0] - cells[uav].goal_pose.position.x, place[1] - cells[uav].goal_pose.position.y
        ),
    )
    fly(heir, 150.0, 1500.0)
    time.sleep(0.5)
    assert graph.call(Trigger, "planner/replan").success
    plan = node.last
    told = {cell.uav: cell for cell in plan.cells}
    held = list(cells[holder].device_ids)
    assert list(told[holder].device_ids) == held and told[holder].goal_pose == cells[holder].goal_pose
    assert not set(held) & set(told[heir].device_ids), "no device is in two cells"
    assert math.dist(place, (told[heir].goal_pose.position.x, told[heir].goal_pose.position.y)) < 0.1
    powers = node.powers[heir]
    graph.wait(lambda: sorted(powers[-1].device_ids) == ["a", "b"], "powers for both devices")
    assert not set(plan.interrupted) & set(held) and not plan.unserved
    fly(heir, *place)
    plan = node.plan(f"{holder} waited for others, which serve now")
    (cell,) = plan.cells
    assert cell.uav == heir and sorted(cell.device_ids) == ["a", "b"] and not plan.interrupted
    assert_demands_met(plan, devices)
    graph.wait(lambda: not node.powers[holder][-1].device_ids, f"an empty allocation for {holder}")


@pytest.mark.parametrize(("apart", "interrupted"), [(250.0, ["b"]), (150.0, [])])
def test_a_device_is_interrupted_only_if_it_must_be_and_then_it_is_reported(planner, graph, apart, interrupted):
    """By hand, from equations (3) and (10): with half the power each, a device of 17 bit/s/Hz is served up to
    sqrt(5e9 / (2^17 - 1) - 50^2) = 188.8 m. When the first UAV is lost, the one over c takes b: at 150 m from where it
    is, at 250 m only after it has flown 61.2 m. a is 400 m or more from c, twice the reach is 377.6 m.
    """
    devices = {"a": (-250.0, 0.0, 17.0), "b": (0.0, 0.0, 17.0), "c": (apart, 0.0, 17.0)}
    node = planner(uavs=2)
    node.send({name: devices[name] for name in "ab"})
    (first,) = node.plan("2 devices joined").cells
    node.send({"c": devices["c"]})
    cells = {frozenset(cell.device_ids): cell for cell in node.plan("1 device joined").cells}
    assert cells.keys() == {frozenset("ab"), frozenset("c")}
    # Only who is known to be in the air takes devices over without an interruption.
    flies_at_its_goal(graph, node, cells[frozenset("c")])
    lost = graph.publisher(VehicleState, f"{first.uav}/state", LATCHED)
    lost.publish(VehicleState(uav=first.uav, link=VehicleState.LINK_LOST))
    plan = node.plan(f"{first.uav} is lost")
    (cell,) = plan.cells
    assert sorted(cell.device_ids) == ["b", "c"] and [entry.id for entry in plan.unserved] == ["a"]
    assert cell.goal_pose.position.x == pytest.approx(apart - max(apart - 188.79, 0.0), abs=0.1)
    assert_demands_met(plan, devices)
    assert list(plan.interrupted) == interrupted
    # The log comes after the message; this is its last line.
    node.said("not served: device 'a'")
    assert ("interrupted on the way: device 'b'" in node.process.output) == bool(interrupted)


def test_parameters_change_the_plan_at_run_time_and_bad_ones_are_refused(planner):
    node = planner()
    node.send(GROUPS)
    node.plan("5 devices joined")
    assert node.set("scheme", "spiral_epa").successful
    plan = node.plan("parameter scheme is now spiral_epa")
    assert plan.scheme == "spiral_epa"
    assert_cells_are(plan, cells_by_solve(GROUPS, scheme="spiral_epa"))
    refused = node.set("scheme", "guess")
    assert not refused.successful and "scheme" in refused.reason and "guess" in refused.reason
    refused = node.set("altitude_m", -1.0)
    assert not refused.successful and "altitude_m" in refused.reason
    assert node.set("altitude_m", 60.0).successful
    plan = node.plan("parameter altitude_m is now 60.0")
    assert {cell.goal_pose.position.z for cell in plan.cells} == {60.0}
    assert len(node.deployments) == 3


def test_what_a_plan_from_scratch_is_worth_is_told_and_weighed_again(planner):
    # Oracle: none of these parameters makes another plan by itself, and yet each change of one is an event.
    node = planner()
    node.send(GROUPS)
    node.plan("5 devices joined")
    for name, value in (("metre_cost", 0.5), ("tolerance", 0.25), ("replanning", "scratch")):
        assert node.set(name, value).successful
        node.plan(f"parameter {name} is now {value}")


def test_the_operator_can_ask_for_a_plan(planner, graph):
    node = planner()
    node.send(GROUPS)
    plan = node.plan("5 devices joined")
    answer = graph.call(Trigger, "planner/replan")
    assert answer.success and answer.message.startswith(f"plan 2: {len(plan.cells)} UAVs serve 5 devices; gain 0 ")
    again = node.plan("operator asked")
    assert again.plan_id == 2 and again.cells == plan.cells


def test_a_quick_plan_is_followed_by_the_proven_one(planner):
    """The optimal scheme: oracle for the number of UAVs and its proof is `solve` with all the time it wants."""
    rng = np.random.default_rng(4)
    where, rates = rng.uniform(-600, 600, (24, 2)).tolist(), rng.uniform(15, 19, 24).tolist()
    devices = {f"d{i}": (x, y, r) for i, ((x, y), r) in enumerate(zip(where, rates, strict=True))}
    best = solve(where, rates, scheme="optimal")
    assert best.proven_optimal
    node = planner(scheme="optimal", uavs=24, time_limit_s=60.0, reoptimise=True)
    node.send(devices)
    quick = node.plan("24 devices joined")
    assert_demands_met(quick, devices)
    proven = node.graph.wait(lambda: next((d for d in node.deployments if d.proven_optimal), None), "the proven plan")
    assert_demands_met(proven, devices)
    assert {d for cell in proven.cells for d in cell.device_ids} == set(devices)
    assert len(proven.cells) == proven.uavs_needed == proven.min_uavs_bound == len(best.uav_positions)
    assert proven.gap == 0.0 and proven.average_uav_rate >= quick.average_uav_rate
    assert proven.plan_id > quick.plan_id or quick.proven_optimal
    # The operator's question is answered by a plan from scratch as well, which now gains nothing.
    answer = node.graph.call(Trigger, "planner/replan")
    assert answer.success and f"{len(proven.cells)} UAVs serve 24 devices" in answer.message


def test_a_plan_from_scratch_that_comes_late_is_brought_up_to_date(planner):
    """While a device moves more often than the solver answers, every answer is for what is no more."""
    node = planner(scheme="optimal", reoptimise=True, time_limit_s=2.0, uavs=40)
    rng = np.random.default_rng(1)
    field = {f"d{k}": (*rng.uniform(0, 1500, 2), rng.uniform(13, 18)) for k in range(60)}
    node.send(field)
    first = node.plan("60 devices joined")

    def better():
        x, y, rate = field["d0"]
        field["d0"] = (x + 1.0, y, rate)
        node.send({"d0": field["d0"]})
        node.graph.spin(0.3)
        return any("plan from scratch" in plan.reason for plan in node.deployments)

    node.graph.wait(better, "a plan from scratch, though a device moves three times a second")
    assert len(node.last.cells) < len(first.cells)
    assert {name for cell in node.last.cells for name in cell.device_ids} == set(field)


def test_a_plan_is_proven_again_after_an_event_that_asks_for_nothing_new(planner, graph):
    """An aircraft that joins was counted on before, so that a plan from scratch has the same task."""
    node = planner(scheme="optimal", uavs=3, reoptimise=True)
    node.send({"school": (-300.0, 0.0, 16.0), "clinic": (300.0, 20.0, 16.0)})

    def proven_after(plan):
        def found():
            return next((d for d in node.deployments if d.plan_id >= plan.plan_id and d.proven_optimal), None)

        return graph.wait(found, f"a proof after {plan.reason!r}", 30.0)

    proven_after(node.plan("2 devices joined"))
    said = graph.publisher(VehicleState, "uav3/state", LATCHED)
    for landed_state, reason in (
        (VehicleState.LANDED_IN_AIR, "uav3 joined"),
        (VehicleState.LANDED_ON_GROUND, "uav3 has landed"),
    ):
        said.publish(
            VehicleState(uav="uav3", link=VehicleState.LINK_CONNECTED, landed_state=landed_state, battery_remaining=0.9)
        )
        plan = node.plan(reason)
        # Oracle: by construction each place needs a UAV of its own.
        proven = proven_after(plan)
        assert proven.min_uavs_bound == len(proven.cells) == 2


def test_devices_that_fall_silent_are_taken_out(planner):
    node = planner(device_timeout_s=3.0)
    node.send({"short": (0.0, 0.0, 16.0), "long": (20.0, 0.0, 16.0)})
    node.plan("2 devices joined")
    # Reported again and again in the same place: no event, but a sign of life.
    while not any("fell silent" in d.reason for d in node.deployments):
        node.send({"long": (20.0, 0.0, 16.0)})
        node.graph.spin(0.3)
    plan = node.plan("1 device fell silent")
    assert [list(cell.device_ids) for cell in plan.cells] == [["long"]]


def test_without_autostart_a_lifecycle_manager_brings_it_up_and_no_event_is_lost(planner, graph):
    node = planner(autostart=False)

    def change(transition):
        request = ChangeState.Request(transition=Transition(id=transition))
        return graph.call(ChangeState, "planner/change_state", request).success

    def state():
        return graph.call(GetState, "planner/get_state").current_state.label

    assert state() == "unconfigured"
    assert not change(Transition.TRANSITION_ACTIVATE)
    assert change(Transition.TRANSITION_CONFIGURE) and state() == "inactive"
    node.send({"a1": GROUPS["a1"]})
    assert graph.call(Trigger, "planner/replan").message == "the planner is not active"
    assert not node.deployments
    assert change(Transition.TRANSITION_ACTIVATE) and state() == "active"
    assert [list(cell.device_ids) for cell in node.plan("1 device joined").cells] == [["a1"]]
    assert change(Transition.TRANSITION_DEACTIVATE) and state() == "inactive"
    node.send({"a2": GROUPS["a2"]})
    assert change(Transition.TRANSITION_ACTIVATE)
    graph.wait(lambda: {d for c in node.last.cells for d in c.device_ids} == {"a1", "a2"}, "the plan with both")
    assert change(Transition.TRANSITION_DEACTIVATE) and change(Transition.TRANSITION_CLEANUP)
    assert state() == "unconfigured"
    assert change(Transition.TRANSITION_CONFIGURE) and change(Transition.TRANSITION_ACTIVATE)
    node.graph.wait(lambda: node.process.output.count("listening to") == 3, "the third activation")


def test_all_names_are_relative_to_the_namespace(graph, start_node, tmp_path):
    start_node(
        "planner",
        {"fleet_file": write_fleet(tmp_path / "fleet.yaml", 2), "scheme": SCHEME},
        namespace="/rescue",
    )
    deployments = graph.collect(Deployment, "/rescue/deployment", LATCHED)
    goals = {name: graph.collect(PoseStamped, f"/rescue/{name}/goal_pose", LATCHED) for name in UAVS[:2]}
    graph.publisher(DeviceUpdate, "/rescue/devices", DEVICES).publish(report({"a1": GROUPS["a1"]}))
    graph.wait(lambda: deployments and any(goals.values()), "a plan in the namespace")
    assert graph.call(Trigger, "/rescue/planner/replan").success


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_it_ends_cleanly_when_told_to(planner, how):
    node = planner()
    node.send(GROUPS)
    node.plan("5 devices joined")
    assert node.process.stop(how) == 0
    assert "Traceback" not in node.process.output


def test_after_a_kill_it_goes_on_from_its_state_file_and_moves_nobody(planner, tmp_path):
    state = str(tmp_path / "state.json")
    first = planner(state_file=state)
    first.send(GROUPS)
    first.plan("5 devices joined")
    first.send({"a3": (20.0, 30.0, 15.0)})
    before = first.plan("1 device joined")
    first.process.stop(signal.SIGKILL)
    # The devices' own reports are gone with the reporter: only the file remembers them.
    first.silence()

    second = planner(state_file=state)
    after = second.plan("planner restarted, going on from plan 2")
    assert after.plan_id == 3 and after.cells == before.cells
    second.send({"c2": (10.0, 820.0, 15.0)})
    grown = second.plan("1 device joined")
    assert_demands_met(grown, {**GROUPS, "a3": (20.0, 30.0, 15.0), "c2": (10.0, 820.0, 15.0)})
    assert [cell for cell in grown.cells if "c2" not in cell.device_ids] == [
        cell for cell in before.cells if "c1" not in cell.device_ids
    ]


def test_a_damaged_state_file_is_named_and_planning_starts_afresh(planner, tmp_path):
    (tmp_path / "state.json").write_text("{")
    node = planner(state_file=str(tmp_path / "state.json"))
    node.send(GROUPS)
    assert node.plan("5 devices joined").plan_id == 1
    node.said("starting afresh", "state.json")


def test_plan_ids_count_on_from_those_that_aircraft_still_follow(planner, graph):
    node = planner()
    state = graph.publisher(VehicleState, "uav2/state", LATCHED)
    state.publish(VehicleState(uav="uav2", link=VehicleState.LINK_CONNECTED, goal_plan_id=41))
    node.said("uav2 is heard")
    node.send(GROUPS)
    assert node.plan("5 devices joined").plan_id == 42


def test_a_wrong_fleet_file_stops_it_with_one_line(start_node, tmp_path):
    path = tmp_path / "fleet.yaml"
    fleet = yaml.safe_load(Path(write_fleet(path, 2)).read_text())
    fleet["uavs"][1]["sysid"] = 1
    path.write_text(yaml.safe_dump(fleet))
    process = start_node("planner", {"fleet_file": str(path), "scheme": SCHEME})
    assert process.wait() == 1
    lines = process.output.strip().splitlines()
    assert len(lines) == 1 and "sysid" in lines[0] and "fleet.yaml" in lines[0], lines


def test_a_wrong_parameter_stops_it_with_one_line(start_node):
    process = start_node("planner", {"scheme": "guess"})
    assert process.wait() == 1
    lines = process.output.strip().splitlines()
    assert len(lines) == 1 and "scheme" in lines[0] and "'guess'" in lines[0], lines


def status(arrays):
    """Return the planner's newest diagnostic status."""
    return next(s for array in reversed(arrays) for s in array.status if "planner" in s.name)


def faults(arrays):
    if not arrays:
        return 0
    return int(next(entry.value for entry in status(arrays).values if entry.key == "wrong reports so far"))

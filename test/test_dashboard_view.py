"""What the page is told: the document as a whole and as changes, the words for plans, the event log.

Oracle: states worked by hand; and for the changes, that a reader who merges them has what a page that opens now gets.
"""

from __future__ import annotations

import copy
import json
import math
from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jpap_ros.dashboard.event_log import CAPACITY, MAX_TEXT, EventLog
from jpap_ros.dashboard.fleet_view import STALE_AFTER_S, TRACK_POINTS, FleetView
from jpap_ros.dashboard.inbox import Inbox
from jpap_ros.dashboard.narrator import plan_lines, status_line, vehicle_lines
from jpap_ros.dashboard.records import ERROR, OK, STALE, WARN, Plan, PlannedCell, Pose, Status, Vehicle
from jpap_ros.planning.devices import Changes, Device

FLYING = Vehicle("connected", "ardupilot", "GUIDED", True, "in air", battery=0.8, goal="en route", distance_m=12.34)
CELL = PlannedCell("uav1", (10.0, 20.0, 50.0), {"a": 16.0}, 16.0)
PLAN = Plan(1, "1 device joined", "optimal", (CELL,), needed=1, bound=1, proven=True, average_rate=16.0)


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


def make_view(names=("uav1", "uav2"), clock=None) -> FleetView:
    return FleetView(names, EventLog(lambda: 0.0), clock or Clock())


def merge(document: dict, delta: dict) -> None:
    """Take in changes as the page does, written apart from it."""
    for key in ("uavs", "devices"):
        for name, fields in delta.get(key, {}).items():
            if fields is None:
                document[key].pop(name, None)
            else:
                document[key].setdefault(name, {}).update(fields)
    for key in ("plan", "health"):
        if key in delta:
            document[key] = delta[key]
    document["events"] = document["events"] + delta.get("events", [])


def texts(view: FleetView) -> list[str]:
    return [event.text for event in view.log.since(0)]


@pytest.mark.parametrize(
    ("needed", "cells", "bound", "proven", "words"),
    [
        (14, 14, 14, True, "14 UAVs, proven minimum"),
        (15, 15, 14, False, "15 UAVs, at least 14 needed"),
        (1, 1, 1, True, "1 UAV, proven minimum"),
        (3, 3, None, False, "3 UAVs, no proof of the minimum"),
        (5, 3, 4, False, "3 of the 5 UAVs needed, at least 4"),
        (0, 0, 0, True, "no UAV needed"),
    ],
)
def test_the_proof_in_words(needed, cells, bound, proven, words) -> None:
    # Oracle: the wording that the issue asks for, and its neighbours.
    plan = Plan(1, "", "optimal", (CELL,) * cells, needed=needed, bound=bound, proven=proven)
    assert plan.proof() == words


def test_a_snapshot_says_everything_in_plain_json() -> None:
    view = make_view()
    view.set_devices([Device("a", (1.234, 5.0), 15.0), Device("b", (9.0, 9.0), 99.0)], Changes(joined=("a", "b")))
    view.set_plan(replace(PLAN, unserved={"b": "demands too much"}))
    view.set_vehicle("uav1", FLYING)
    view.set_pose("uav1", Pose((3.04, 4.0, 50.0), 361.0))
    snapshot = json.loads(json.dumps(view.snapshot(), allow_nan=False))
    uav = snapshot["uavs"]["uav1"]
    assert (uav["x"], uav["y"], uav["z"], uav["heading"]) == (3.0, 4.0, 50.0, 1)
    assert (uav["mode"], uav["goal"], uav["distance"], uav["goal_at"]) == ("GUIDED", "en route", 12.3, [10, 20, 50])
    assert snapshot["uavs"]["uav2"]["link"] == "never seen"
    assert snapshot["devices"]["a"] == {
        "x": 1.23, "y": 5.0, "demand": 15.0, "weight": 1.0, "cell": 0, "rate": 16.0, "reason": ""
    }  # fmt: skip
    assert (snapshot["devices"]["b"]["cell"], snapshot["devices"]["b"]["reason"]) == (None, "demands too much")
    assert snapshot["plan"]["proof"] == "1 UAV, proven minimum"
    assert snapshot["tracks"] == {"uav1": [[3.0, 4.0]]}


def test_an_aircraft_serves_from_its_cell_only_and_while_it_is_heard() -> None:
    # Oracle: what service means to who is on the ground: the aircraft is at the place that the plan gives it.
    view = make_view()
    view.set_devices([Device("a", (1.0, 5.0), 15.0)], Changes(joined=("a",)))
    view.set_plan(PLAN)
    reached = replace(FLYING, goal="reached", position=CELL.position)
    for vehicle, serves in (
        (Vehicle("never seen"), False),
        (replace(FLYING, position=CELL.position), False),
        (reached, True),
        (replace(reached, link="lost"), False),
        (replace(reached, position=None), False),
        # Its goal of the plan before, still.
        (replace(reached, position=(300.0, 20.0, 50.0)), False),
    ):
        view.set_vehicle("uav1", vehicle)
        assert view.snapshot()["uavs"]["uav1"]["serving"] is serves, vehicle
    view.set_vehicle("uav2", reached)
    assert not view.snapshot()["uavs"]["uav2"]["serving"], "another's cell"


def test_a_cell_without_an_aircraft_serves_nobody() -> None:
    view = make_view()
    view.set_devices([Device("a", (1.0, 5.0), 15.0)], Changes(joined=("a",)))
    view.set_plan(replace(PLAN, cells=(replace(CELL, uav=""),)))
    snapshot = view.snapshot()
    assert snapshot["devices"]["a"]["reason"] == "no aircraft for its cell"
    assert snapshot["plan"]["unserved"] == {"a": "no aircraft for its cell"}
    assert any("0 of 1 device to be served" in text for text in texts(view))


def test_changes_hold_only_what_changed() -> None:
    view = make_view()
    view.set_vehicle("uav1", FLYING)
    view.set_pose("uav1", Pose((0.0, 0.0, 50.0), 0.0))
    assert view.delta()["uavs"]["uav1"]["mode"] == "GUIDED"
    view.set_pose("uav1", Pose((0.0, 7.0, 50.0), 0.0))
    delta = view.delta()
    assert delta["uavs"] == {"uav1": {"y": 7.0}}
    assert delta.keys() == {"type", "now", "uavs"}
    # Less than what the page shows is no change.
    view.set_pose("uav1", Pose((0.01, 7.01, 50.0), 0.2))
    assert view.delta().keys() == {"type", "now"}


NAMES = st.sampled_from(["uav1", "uav2"])
SMALL = st.floats(-1e4, 1e4)
DEVICES = st.dictionaries(
    st.sampled_from("abcd"), st.builds(lambda x, r: Device("?", (x, x), r), SMALL, st.floats(1, 30))
)
STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("pose"), NAMES, SMALL),
        st.tuples(st.just("vehicle"), NAMES, st.sampled_from(["none", "en route", "reached", "yielded"])),
        st.tuples(st.just("devices"), DEVICES),
        st.tuples(st.just("plan"), st.lists(st.sampled_from("abcd"), unique=True), st.integers(1, 9)),
        st.tuples(st.just("wait"), st.integers(1, 9)),
        st.tuples(st.just("tell")),
    ),
    max_size=30,
)


@settings(max_examples=60, deadline=None)
@given(STEPS)
def test_merging_all_changes_gives_what_a_page_that_opens_gets(steps) -> None:
    clock = Clock()
    view = make_view(clock=clock)
    view.delta()
    page = copy.deepcopy(view.snapshot())
    for step in steps:
        if step[0] == "pose":
            view.set_pose(step[1], Pose((step[2], 0.0, 50.0), 0.0))
        elif step[0] == "vehicle":
            view.set_vehicle(step[1], replace(FLYING, goal=step[2]))
        elif step[0] == "devices":
            view.set_devices([replace(device, id=name) for name, device in step[1].items()], Changes())
        elif step[0] == "plan":
            cell = replace(CELL, rates=dict.fromkeys(step[1], 16.0))
            view.set_plan(replace(PLAN, id=step[2], cells=(cell,)))
        elif step[0] == "wait":
            clock.now += step[1]
        else:
            merge(page, view.delta())
    merge(page, view.delta())
    now = view.snapshot()
    for key in ("uavs", "devices", "plan", "health", "events"):
        assert page[key] == now[key], key


def test_tracks_are_short_and_of_steps_that_can_be_seen() -> None:
    view = make_view()
    view.set_vehicle("uav1", FLYING)
    for i in range(3 * TRACK_POINTS):
        view.set_pose("uav1", Pose((2.0 * i, 0.0, 50.0), 0.0))
    track = view.snapshot()["tracks"]["uav1"]
    assert len(track) == TRACK_POINTS
    assert all(b[0] - a[0] >= 3.0 for a, b in pairwise(track))
    view.set_pose("uav1", Pose((math.nan, 0.0, 50.0), 0.0))
    assert view.snapshot()["uavs"]["uav1"]["x"] == 2.0 * (3 * TRACK_POINTS - 1)


def test_silence_of_planner_bridge_and_aircraft_shows() -> None:
    clock = Clock()
    view = make_view(clock=clock)
    assert view.snapshot()["health"]["planner"] == {"heard": False, "silent_s": 0, "level": OK, "message": ""}
    view.set_roles(["/planner"], ["/bridge"])
    view.set_vehicle("uav1", FLYING)
    view.set_pose("uav1", Pose((0.0, 0.0, 0.0), 0.0))
    view.set_statuses([Status("/planner", "deployment", WARN, "2 devices are not served")])
    health = view.snapshot()["health"]
    assert health["planner"] == {"heard": True, "silent_s": 0, "level": WARN, "message": "2 devices are not served"}
    clock.now += STALE_AFTER_S + 2.5
    health = view.snapshot()["health"]
    assert (health["planner"]["silent_s"], health["bridge"]["silent_s"], health["last_data"]) == (7, 7, 7)
    assert view.snapshot()["uavs"]["uav1"]["age"] == 7
    view.set_vehicle("uav1", replace(FLYING, link="lost"))
    health = view.snapshot()["health"]
    assert (health["bridge"]["silent_s"], health["lost"]) == (0, ["uav1"])


def test_link_figures_come_from_the_bridge_and_nobody_else() -> None:
    view = make_view()
    view.set_roles([], ["/bridge"])
    view.set_vehicle("uav1", FLYING)
    values = {"heartbeat age [s]": "3.4", "loss on udpin:0.0.0.0:1 [%]": "12.0", "loss on tcp:b:2 [%]": "nan"}
    view.set_statuses([Status("/bridge", "uav1", OK, "", values), Status("/sim", "uav1", OK, "", {"battery": "1"})])
    uav = view.snapshot()["uavs"]["uav1"]
    assert (uav["link_age"], uav["loss"]) == (3, 0.12)


def test_an_aircraft_without_a_cell_has_no_goal_but_a_relief_has() -> None:
    view = make_view()
    view.set_plan(PLAN)
    view.set_goal("uav2", (5.0, 5.0, 60.0))
    view.set_plan(replace(PLAN, id=2, cells=(replace(CELL, uav="uav2"),)))
    uavs = view.snapshot()["uavs"]
    assert (uavs["uav1"]["goal_at"], uavs["uav2"]["goal_at"]) == (None, [10.0, 20.0, 50.0])


def test_statuses_cannot_fill_memory() -> None:
    view = make_view()
    for i in range(5000):
        view.set_statuses([Status("/x", f"part {i}", OK, "")])
    assert len(view._statuses) == 2000


class TestEventLog:
    def test_a_fleet_in_good_order_is_no_news_when_it_is_first_heard_of(self) -> None:
        assert vehicle_lines("u", None, FLYING) == []
        assert vehicle_lines("u", None, Vehicle("never seen")) == []
        assert vehicle_lines("u", None, Vehicle("lost")) == [("error", "u: link lost")]
        assert vehicle_lines("u", Vehicle("never seen"), FLYING)[0] == ("info", "u: link connected")

    def test_keeps_the_newest_and_cuts_what_is_long(self) -> None:
        log = EventLog(lambda: 7.0)
        for i in range(CAPACITY + 10):
            log.add("info", "plan", f"{i}" * 1000)
        events = log.since(0)
        assert (len(events), events[-1].number, log.last) == (CAPACITY, CAPACITY + 10, CAPACITY + 10)
        assert len(events[-1].text) == MAX_TEXT
        assert [event.number for event in log.since(CAPACITY + 8)] == [CAPACITY + 9, CAPACITY + 10]

    def test_explains_each_replan(self) -> None:
        view = make_view()
        view.set_plan(replace(PLAN, reason="3 devices joined, 1 left", planning_s=0.0123))
        assert texts(view) == [
            "Plan 1 because 3 devices joined, 1 left: 1 UAV, proven minimum; 1 of 1 device to be served; "
            "planned in 12 ms (optimal)"
        ]

    def test_names_who_is_newly_left_out_once(self) -> None:
        before = replace(PLAN, unserved={"b": "demands 99 bit/s"})
        now = replace(before, id=2, unserved={"b": "demands 99 bit/s", "c": "too far"}, interrupted=("a",))
        levels = [(level, text) for level, text in plan_lines(before, now) if level == "warning"]
        assert levels == [
            ("warning", "Plan 2 leaves out c: too far"),
            ("warning", "Plan 2 interrupts on the way: a"),
        ]
        assert [level for level, _ in plan_lines(now, replace(now, id=3))] == ["info"]

    @pytest.mark.parametrize(
        ("now", "lines"),
        [
            (FLYING, []),
            (replace(FLYING, link="lost"), [("error", "u: link lost")]),
            (replace(FLYING, goal="reached"), []),
            (
                replace(FLYING, goal="rejected", reason="outside the fence"),
                [("error", "u: goal rejected: outside the fence")],
            ),
            (
                replace(FLYING, goal="yielded", reason="mode became LOITER without the bridge asking"),
                [("warning", "u was taken over: mode became LOITER without the bridge asking")],
            ),
            (
                replace(FLYING, goal="yielded", reason="lands by the operator's command"),
                [("info", "u lands by the operator's command")],
            ),
            (replace(FLYING, landed="on ground"), [("info", "u is on the ground")]),
            (
                replace(FLYING, emergency=True),
                [("error", "u: the autopilot reports an emergency (mode GUIDED)")],
            ),
            (replace(FLYING, battery_low=True, battery=0.19), [("warning", "u: battery low, 19 % left")]),
        ],
    )
    def test_what_happens_to_an_aircraft(self, now, lines) -> None:
        assert vehicle_lines("u", FLYING, now) == lines

    def test_a_node_that_says_the_same_in_other_numbers_is_no_news(self) -> None:
        first = Status("/bridge", "link udp", ERROR, "3.1 frames/s refused")
        assert status_line(None, first) == ("error", "/bridge link udp: 3.1 frames/s refused")
        assert status_line(first, replace(first, message="2e-1 frames/s refused")) is None
        assert status_line(first, replace(first, level=OK, message="up")) == (
            "info",
            "/bridge link udp: up (was an error)",
        )
        assert status_line(None, Status("/bridge", "uav1", STALE, "never heard")) == (
            "warning",
            "/bridge uav1: never heard",
        )

    def test_a_lost_link_is_told_once(self) -> None:
        view = make_view()
        view.set_roles([], ["/bridge"])
        view.set_vehicle("uav1", FLYING)
        view.set_vehicle("uav1", replace(FLYING, link="lost"))
        view.set_statuses([Status("/bridge", "uav1", ERROR, "link lost"), Status("/sim", "uav1", WARN, "no GPS")])
        assert texts(view) == ["uav1: link lost"]


def test_the_inbox_keeps_order_and_of_poses_only_the_newest() -> None:
    inbox, done = Inbox(), []
    for i in range(3):
        inbox.put(lambda i=i: done.append(i))
        inbox.put_newest("uav1", lambda i=i: done.append(f"pose {i}"))
    # What is put in meanwhile waits for the next time, or a flood would never end.
    inbox.put(lambda: inbox.put(lambda: done.append("later")))
    inbox.drain()
    assert done == [0, 1, 2, "pose 2"]
    inbox.drain()
    assert done[-1] == "later"

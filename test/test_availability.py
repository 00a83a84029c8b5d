"""The life of a fleet.

Oracle: a small world of its own in which aircraft fly to where they are told, batteries drain and things fail; what
must hold (a cell is never left before its relief is there, nobody has two duties, a pilot's aircraft is never
commanded) is read off that world, not off the product's state.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jpap_ros.fleet.availability import Charge, FleetLife, FleetPolicy, Link, Order, Station, Vehicle

POLICY = FleetPolicy()
HERE, THERE = (0.0, 0.0, 50.0), (300.0, 0.0, 50.0)


def ground(name, east=0.0, **fields):
    return Vehicle(name, Link.CONNECTED, False, (east, -100.0, 0.0), 1.0, **fields)


def flying(name, place=HERE, **fields):
    return replace(Vehicle(name, Link.CONNECTED, True, place, 1.0), **fields)


def orders(roster):
    return {action.uav: action.order for action in roster.actions}


class World:
    """Aircraft that do as they are told, at 10 m/s, and drain 1 % of battery in 6 s."""

    def __init__(self, count):
        self.vehicles = {f"uav{i}": ground(f"uav{i}", 20.0 * i) for i in range(count)}
        self.homes = {name: vehicle.position for name, vehicle in self.vehicles.items()}
        self.bound_home = set()

    def act(self, roster, step_s):
        for action in roster.actions:
            vehicle = self.vehicles[action.uav]
            assert vehicle.link is Link.CONNECTED and not vehicle.yielded and not vehicle.busy
            if action.order is Order.LAUNCH:
                assert not vehicle.in_air
                self.vehicles[action.uav] = replace(vehicle, in_air=True)
            else:
                assert vehicle.in_air
                self.bound_home.add(action.uav)
        for name, vehicle in self.vehicles.items():
            goal = self.homes[name] if name in self.bound_home else roster.goals.get(name)
            if vehicle.in_air and goal is not None:
                away = np.subtract(goal, vehicle.position)
                length = float(np.linalg.norm(away))
                share = min(10 * step_s / length, 1.0) if length else 1.0
                vehicle = replace(vehicle, position=tuple((np.array(vehicle.position) + share * away).tolist()))
            if name in self.bound_home and vehicle.position == self.homes[name]:
                self.bound_home.discard(name)
                vehicle = replace(vehicle, in_air=False)
            change = -step_s / 600 if vehicle.in_air else step_s / 300
            self.vehicles[name] = replace(
                vehicle, busy=name in self.bound_home, battery=min(max(vehicle.battery + change, 0.0), 1.0)
            )


def test_who_holds_a_station_stays_and_nobody_else_is_sent_there():
    life = FleetLife(POLICY)
    fleet = [flying("a", THERE), flying("b", HERE), ground("c", 290.0)]
    assert life.step(0.0, fleet, {5: Station(THERE)}).crew == {5: "a"}
    held = {5: Station(THERE, held_by="a")}
    # Not even after a plan that left the station out for a moment, nor when it is low on battery.
    life.step(1.0, fleet, {})
    for now_s, battery in ((2.0, 0.9), (30.0, 0.2)):
        fleet[0] = flying("a", THERE, battery=battery)
        roster = life.step(now_s, fleet, held)
        assert roster.crew == {5: "a"} and not roster.reliefs and roster.goals == {"a": THERE}
    fleet[0] = replace(fleet[0], battery=0.01)
    roster = life.step(31.0, fleet, held)
    assert not roster.crew and orders(roster)["a"] is Order.RETURN and not roster.uncrewed


def test_a_relief_on_its_way_to_a_station_that_is_given_up_is_no_relief():
    life = FleetLife(POLICY)
    fleet = [flying("a", THERE), flying("b", HERE)]
    assert life.step(0.0, fleet, {5: Station(THERE)}).crew == {5: "a"}
    fleet[0] = flying("a", THERE, battery=0.2)
    assert life.step(0.5, fleet, {5: Station(THERE)}).reliefs == {5: "b"}
    above = (*THERE[:2], THERE[2] + POLICY.station_above_m)
    fleet[1] = flying("b", above)
    roster = life.step(1.0, fleet, {5: Station(THERE, held_by="a")})
    assert roster.crew == {5: "a"} and not roster.reliefs


def test_a_cell_is_crewed_launched_and_sent_home_when_it_ends():
    life = FleetLife(POLICY)
    fleet = [ground("a"), ground("b", 290.0)]
    roster = life.step(0.0, fleet, {5: Station(THERE)})
    assert roster.crew == {5: "b"}  # the nearest
    assert orders(roster) == {"b": Order.LAUNCH}
    assert roster.goals == {"b": THERE}
    assert (roster.usable, roster.reserves, roster.uncrewed) == (2, ("a",), ())
    assert roster.events == ("b takes cell 5",)
    fleet[1] = flying("b", THERE)
    assert life.step(1.0, fleet, {5: Station(THERE)}).actions == ()
    assert life.step(2.0, fleet, {}).actions == ()  # not at once: the next plan may need it
    assert life.step(21.9, fleet, {}).actions == ()
    assert orders(life.step(22.0, fleet, {})) == {"b": Order.RETURN}


def test_a_command_without_effect_is_repeated_and_then_another_aircraft_goes():
    life = FleetLife(POLICY)
    fleet = [ground("a"), ground("b", 50.0)]
    launched = [action.uav for t in range(125) for action in life.step(float(t), fleet, {1: Station(HERE)}).actions]
    assert launched == ["a"] * 25 + ["b"]  # every 5 s from 0 to 120 s


def test_the_relief_is_there_before_the_tired_one_leaves():
    life = FleetLife(POLICY, crew={1: "a"})
    fleet = [flying("a", battery=0.3), ground("b")]
    roster = life.step(0.0, fleet, {1: Station(HERE)})
    assert (roster.crew, roster.reliefs) == ({1: "a"}, {1: "b"})
    assert orders(roster) == {"b": Order.LAUNCH}
    waiting = (0.0, 0.0, 50.0 + POLICY.station_above_m)
    assert roster.goals == {"a": HERE, "b": waiting}
    fleet[1] = flying("b", (0.0, 0.0, waiting[2] + POLICY.arrival_radius_m + 0.1))
    assert life.step(1.0, fleet, {1: Station(HERE)}).crew == {1: "a"}
    fleet[1] = flying("b", waiting)
    roster = life.step(2.0, fleet, {1: Station(HERE)})
    assert (roster.crew, roster.reliefs, roster.goals) == ({1: "b"}, {}, {"b": HERE})
    assert orders(roster) == {"a": Order.RETURN}
    assert roster.events == ("b relieves a",)


def test_a_relief_that_fails_is_replaced_and_at_the_critical_battery_the_tired_one_goes_anyway():
    life = FleetLife(POLICY, crew={1: "a"})
    fleet = [flying("a", battery=0.2), ground("b"), ground("c", 900.0)]
    assert life.step(0.0, fleet, {1: Station(HERE)}).reliefs == {1: "b"}
    fleet[1] = replace(fleet[1], link=Link.LOST)
    assert life.step(1.0, fleet, {1: Station(HERE)}).reliefs == {1: "b"}
    assert life.step(6.0, fleet, {1: Station(HERE)}).reliefs == {1: "c"}
    fleet[0] = flying("a", battery=0.15)
    roster = life.step(7.0, fleet, {1: Station(HERE)})
    assert roster.crew == {1: "c"}
    assert orders(roster) == {"a": Order.RETURN}  # c has had its order a second ago


def test_tired_stays_tired_until_it_stands_on_the_ground():
    life = FleetLife(POLICY, crew={1: "a"})
    life.step(0.0, [flying("a", battery=0.3)], {1: Station(HERE)})
    roster = life.step(1.0, [flying("a", battery=0.35), ground("b")], {1: Station(HERE)})
    assert roster.reliefs == {1: "b"}
    roster = life.step(2.0, [ground("a"), flying("b")], {1: Station(HERE)})
    # Nobody had told it to land: it is not sent up again at once.
    assert (roster.crew, roster.reserves) == ({1: "b"}, ())
    later = life.step(2.0 + POLICY.launch_timeout_s, [ground("a"), flying("b")], {1: Station(HERE)})
    assert later.reserves == ("a",)


@pytest.mark.parametrize("fault", [{"link": Link.LOST}, {"yielded": True}])
def test_one_that_does_not_obey_is_an_obstacle_at_once_and_loses_its_cell_after_a_while(fault):
    life = FleetLife(POLICY, crew={1: "a"})
    fleet = [flying("a", **fault), ground("b")]
    roster = life.step(0.0, fleet, {1: Station(HERE)})
    assert [obstacle.position for obstacle in roster.obstacles] == [HERE]
    assert roster.crew == {1: "a"}
    assert life.step(4.9, fleet, {1: Station(HERE)}).crew == {1: "a"}
    roster = life.step(5.0, fleet, {1: Station(HERE)})
    assert roster.crew == {1: "b"}
    assert orders(roster) == {"b": Order.LAUNCH}
    # It comes back: no obstacle any more, and over its cell, where the other one is not yet.
    roster = life.step(6.0, [flying("a"), flying("b", THERE)], {1: Station(HERE)})
    assert (roster.obstacles, roster.crew, roster.usable) == ((), {1: "a"}, 2)


def test_a_short_silence_changes_nothing():
    life = FleetLife(POLICY, crew={1: "a"})
    for t in range(30):
        link = Link.LOST if t % 5 else Link.CONNECTED
        roster = life.step(float(t), [flying("a", link=link), ground("b")], {1: Station(HERE)})
        assert roster.crew == {1: "a"}


def test_too_few_aircraft_crew_the_heaviest_cells_and_the_rest_is_named():
    life = FleetLife(POLICY)
    stations = {1: Station(HERE, 1.0), 2: Station(THERE, 9.0)}
    roster = life.step(0.0, [ground("a"), Vehicle("never")], stations)
    assert (roster.crew, roster.uncrewed, roster.usable) == ({2: "a"}, (1,), 1)


def test_who_is_not_launched():
    fleet = [
        ground("low", charge=Charge.LOW),
        replace(ground("half"), battery=0.5),
        ground("taken", yielded=True),
        ground("busy", busy=True),
        replace(ground("nowhere"), position=None),
        Vehicle("never"),
    ]
    roster = FleetLife(POLICY).step(0.0, fleet, {1: Station(HERE)})
    assert (roster.crew, roster.usable, roster.actions, roster.reserves) == ({}, 0, (), ())
    unknown = replace(ground("unknown"), battery=math.nan)
    assert FleetLife(POLICY).step(0.0, [unknown], {1: Station(HERE)}).crew == {1: "unknown"}


def test_after_a_restart_nobody_changes_cells():
    fleet = [flying("a", THERE), flying("b", HERE)]
    roster = FleetLife(POLICY, crew={1: "a", 2: "b"}).step(0.0, fleet, {1: Station(HERE), 2: Station(THERE)})
    assert roster.crew == {1: "a", 2: "b"}
    assert roster.actions == ()


def test_battery_relay_for_an_hour_leaves_no_cell_without_aircraft():
    """Two cells, five aircraft that fly for ten minutes and charge for five: somebody is always there."""
    world, life = World(5), FleetLife(POLICY)
    stations = {1: Station(HERE), 2: Station(THERE)}
    handovers = 0
    for second in range(3600):
        roster = life.step(float(second), list(world.vehicles.values()), stations)
        handovers += sum("relieves" in event for event in roster.events)
        world.act(roster, 1.0)
        if second > 90:
            for station in stations.values():
                away = min(math.dist(v.position, station.position) for v in world.vehicles.values() if v.in_air)
                assert away <= POLICY.station_above_m + POLICY.arrival_radius_m, second
    assert handovers >= 12
    assert min(vehicle.battery for vehicle in world.vehicles.values()) > POLICY.critical_battery


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 6), cells=st.integers(0, 4))
def test_whatever_fails_duties_are_unique_and_orders_allowed(seed, count, cells):
    rng = np.random.default_rng(seed)
    world, life = World(count), FleetLife(POLICY)
    stations = {i: Station((*rng.uniform(-300, 300, 2).tolist(), 50.0)) for i in range(cells)}
    for second in range(300):
        if rng.random() < 0.1:
            name = rng.choice(list(world.vehicles))
            fault = [
                {"link": Link.LOST},
                {"link": Link.CONNECTED, "yielded": False},
                {"yielded": True},
                {"battery": float(rng.uniform(0, 1))},
                {"charge": Charge(rng.integers(0, 4))},
            ][rng.integers(5)]
            world.vehicles[name] = replace(world.vehicles[name], **fault)
        if rng.random() < 0.02:
            stations.pop(rng.choice(list(stations)), None) if stations else None
        if rng.random() < 0.02:
            stations[1000 + second] = Station((*rng.uniform(-300, 300, 2).tolist(), 50.0))
        before = dict(world.vehicles)
        roster = life.step(float(second), list(world.vehicles.values()), stations)
        duties = [*roster.crew.values(), *roster.reliefs.values()]
        assert len(duties) == len(set(duties))
        assert set(roster.reliefs) <= set(roster.crew) <= set(stations)
        assert set(roster.uncrewed) == set(stations) - set(roster.crew)
        assert set(roster.goals) == set(duties)
        assert len(roster.crew) <= roster.usable <= count
        for action in roster.actions:
            assert (action.order is Order.LAUNCH) == (action.uav in duties)
        silent = {name for name, v in before.items() if v.in_air and (v.link is Link.LOST or v.yielded)}
        assert {obstacle.name for obstacle in roster.obstacles} == silent
        world.act(roster, 1.0)


def test_the_same_history_gives_the_same_decisions():
    def run():
        world, life = World(4), FleetLife(POLICY)
        decisions = []
        for second in range(400):
            roster = life.step(float(second), list(world.vehicles.values()), {1: Station(HERE), 2: Station(THERE)})
            decisions.append((roster.crew, roster.actions, roster.events))
            world.act(roster, 1.0)
        return decisions

    assert run() == run()


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"low_battery": math.nan}, "low_battery must be finite and >= 0, got nan"),
        ({"lost_after_s": -1}, "lost_after_s must be finite and >= 0, got -1"),
        ({"low_battery": 0.7}, "critical_battery <= low_battery <= ready_battery <= 1 must hold, got 0.15, 0.7, 0.6"),
        ({"objective": "time"}, "objective must be one of distance2, bottleneck, got 'time'"),
    ],
)
def test_bad_policy_is_named(fields, message):
    with pytest.raises(ValueError, match=message):
        FleetPolicy(**fields)


def test_aircraft_without_a_duty_are_told_of_too_when_they_go_and_come_back():
    life = FleetLife(POLICY, crew={1: "a"})
    fleet = [flying("a"), ground("b"), ground("c"), Vehicle("never")]
    assert life.step(0.0, fleet, {1: Station(HERE)}).events == ()
    fleet[1], fleet[2] = replace(fleet[1], link=Link.LOST), replace(fleet[2], yielded=True)
    # At once, though their duties would be given to others only later.
    assert life.step(1.0, fleet, {1: Station(HERE)}).events == ("b is lost", "c was taken over")
    assert life.step(1.0 + POLICY.lost_after_s, fleet, {1: Station(HERE)}).events == ()
    assert life.step(9.0, fleet, {1: Station(HERE)}).events == ()
    assert life.step(10.0, [flying("a"), ground("b"), ground("c")], {1: Station(HERE)}).events == (
        "b is back",
        "c is back",
    )


@pytest.mark.parametrize(("heir_at", "taken_back"), [(400.0, True), (15.0, False)])
def test_one_that_is_back_gets_its_cell_again_unless_its_heir_is_there(heir_at, taken_back):
    life = FleetLife(POLICY, crew={1: "a"})
    fleet = [flying("a"), flying("b", (900.0, 0.0, 50.0))]
    life.step(0.0, fleet, {1: Station(HERE)})
    fleet[0] = replace(fleet[0], link=Link.LOST)
    life.step(1.0, fleet, {1: Station(HERE)})
    assert life.step(1.0 + POLICY.lost_after_s, fleet, {1: Station(HERE)}).crew == {1: "b"}
    # a has hovered over its cell all the time.
    fleet = [flying("a"), flying("b", (heir_at, 0.0, 50.0))]
    roster = life.step(9.0, fleet, {1: Station(HERE)})
    assert roster.crew == {1: "a" if taken_back else "b"}
    assert ("a takes cell 1 back" in roster.events) == taken_back


def test_a_tired_one_that_is_back_serves_until_its_heir_relieves_it():
    life = FleetLife(POLICY, crew={1: "a"})
    fleet = [flying("a", battery=0.28), flying("b", (900.0, 0.0, 50.0))]
    life.step(0.0, [replace(fleet[0], yielded=True), fleet[1]], {1: Station(HERE)})
    given = life.step(POLICY.lost_after_s, [replace(fleet[0], yielded=True), fleet[1]], {1: Station(HERE)})
    assert given.crew == {1: "b"}
    roster = life.step(9.0, fleet, {1: Station(HERE)})
    assert (roster.crew, roster.reliefs) == ({1: "a"}, {1: "b"})


def test_a_short_loss_is_told_and_a_long_one_twice():
    life = FleetLife(POLICY, crew={1: "a"})
    lost, stations = flying("a", link=Link.LOST), {1: Station(HERE)}
    assert life.step(0.0, [flying("a")], stations).events == ()
    assert life.step(1.0, [lost], stations).events == ("a is lost",)
    assert life.step(2.0, [flying("a")], stations).events == ("a is back",)
    assert life.step(3.0, [lost], stations).events == ("a is lost",)
    assert life.step(3.0 + POLICY.lost_after_s, [lost], stations).events == ("a has been lost for 5 s",)


def test_low_is_told_when_a_relief_is_wanted():
    # 1200 m at 8 m/s, 65 m up at 1.5 m/s: 193 s home, so critical at 193/1500 + 0.05 = 0.179; the relief from there
    # needs 1.3 * 193 s + 45 s = 296 s more: low at 0.376.
    life, station = FleetLife(POLICY, crew={1: "a"}), {1: Station((1200.0, 0.0, 50.0))}
    pad = replace(ground("a"), position=(0.0, 0.0, 0.0))
    relief = replace(pad, name="b")
    life.step(0.0, [pad, relief], station)
    over = replace(pad, in_air=True, position=(1200.0, 0.0, 50.0))
    roster = life.step(50.0, [replace(over, battery=0.38), relief], station)
    assert roster.events == () and roster.reliefs == {}
    roster = life.step(51.0, [replace(over, battery=0.37), relief], station)
    assert roster.events == ("a is low on battery", "b goes to relieve a") and roster.reliefs == {1: "b"}
    assert life.step(52.0, [replace(over, battery=0.18), relief], station).crew == {1: "a"}
    roster = life.step(53.0, [replace(over, battery=0.178), relief], station)
    assert "a is at its critical battery" in roster.events and roster.crew == {1: "b"}


def test_of_two_tired_ones_the_one_that_must_go_home_first_is_relieved_first():
    life = FleetLife(POLICY, crew={1: "a", 2: "b"})
    stations = {1: Station(HERE, 9.0), 2: Station(THERE, 1.0)}
    fleet = [flying("a", HERE, battery=0.25), flying("b", THERE, battery=0.2), ground("c")]
    # c is nearer to the first, and that is the heavier one.
    assert life.step(0.0, fleet, stations).reliefs == {2: "c"}


def test_a_cell_far_away_is_never_left_at_the_critical_battery():
    """An hour, 1.3 km from the pads, with batteries for 600 s in the air (which the policy takes for 1500 s)."""
    world, life = World(6), FleetLife(replace(POLICY, cruise_m_s=10.0, climb_m_s=5.0))
    stations = {1: Station((1300.0, 0.0, 50.0))}
    events = []
    for second in range(3600):
        roster = life.step(float(second), list(world.vehicles.values()), stations)
        events += roster.events
        world.act(roster, 1.0)
    assert sum("relieves" in event for event in events) >= 6
    assert not [event for event in events if "critical" in event]
    assert min(vehicle.battery for vehicle in world.vehicles.values()) > 0.0


def test_one_that_would_soon_be_tired_itself_relieves_nobody():
    life = FleetLife(POLICY, crew={1: "a"})
    near = flying("b", (20.0, 0.0, 50.0), battery=POLICY.ready_battery - 0.01)
    fleet = [flying("a", battery=0.25), near, ground("c", 900.0)]
    assert life.step(0.0, fleet, {1: Station(HERE)}).reliefs == {1: "c"}

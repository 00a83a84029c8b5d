"""From one plan to the next: who is interrupted, and when the radios take their new powers.

Oracles: aircraft flown straight in small steps, with radios that do what PowerAllocation says, and equation (3) with
the powers that each of them applies at each moment; cases worked by hand.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jpap_ros.fleet.cells import Aircraft
from jpap_ros.fleet.handover import handed_over
from jpap_ros.fleet.plan import (
    PlanSettings,
    full_deployment,
    named_plan,
    plan_change,
    plan_from_scratch,
    weigh,
    with_crew,
)
from jpap_ros.planning.devices import Device
from jpap_ros.planning.replanning_decision import ReplanningPolicy
from jpap_ros.planning.replanning_state import LiveCell, LivePlan

SETTINGS = PlanSettings(scheme="jpap")
LINK = SETTINGS.link
#: With all 10 W a device of 17 bit/s/Hz is served up to sqrt(1e10 / (2^17 - 1) - 50^2) = 271.7 m.
RATE = 17.0
ARRIVE = "arrive first"


def flying(name, x, y=0.0, **more):
    return Aircraft(name, (float(x), float(y)), connected=True, airborne=True, **more)


def grounded(name, x, y=0.0):
    return Aircraft(name, (float(x), float(y)), connected=True)


def device(name, x, y=0.0, rate=RATE):
    return Device(name, (float(x), float(y)), rate)


def cell_of(plan, name):
    return next(cell for cell in plan.cells if name in cell.device_ids)


def test_a_reserve_on_the_ground_interrupts_those_of_the_lost():
    devices = [device("a", 0)]
    before = plan_from_scratch(devices, SETTINGS, [flying("u1", 0), grounded("u2", 1500)])
    lost = [Aircraft("u1", (0.0, 0.0), airborne=True, unavailable="is lost"), grounded("u2", 1500)]
    after = plan_change(devices, SETTINGS, lost, before)
    assert cell_of(after, "a").uav == "u2" and ARRIVE in after.interrupted["a"]
    # It stays named until it is served again, whatever is planned meanwhile.
    for x, named in ((1500, True), (600, True), (0, False)):
        after = plan_change(devices, SETTINGS, [lost[0], flying("u2", x)], after)
        assert ("a" in after.interrupted) is named


def test_a_plan_whose_crew_was_changed_is_compared_with_the_one_that_was_flown():
    """The fleet's life has given the cell to a reserve before the planner hears of it."""
    devices = [device("a", 0)]
    before = plan_from_scratch(devices, SETTINGS, [flying("u1", 0), grounded("u2", 1500)])
    fleet = [Aircraft("u1", (0.0, 0.0), airborne=True, unavailable="cannot be given a cell now"), grounded("u2", 1500)]
    crew = {before.cells[0].id: "u2"}
    planned = plan_change(devices, SETTINGS, fleet, with_crew(before, crew))
    assert ARRIVE in handed_over(before, with_crew(planned, crew), fleet, LINK).interrupted["a"]


@pytest.mark.parametrize(("above_m", "rate", "named"), [(12.0, 17.0, False), (12.0, 21.6, True), (0.0, 21.6, False)])
def test_a_relief_above_the_cell_interrupts_only_whom_it_does_not_reach_from_there(above_m, rate, named):
    """By hand: right above, 10 W give log2(1 + 1e10 / 50^2) = 21.93 bit/s/Hz from 50 m and 21.31 from 62 m."""
    devices = [device("a", 0, rate=rate)]
    before = plan_from_scratch(devices, SETTINGS, [flying("u1", 0), grounded("u2", 900)])
    fleet = [flying("u1", 0), flying("u2", 0, up_m=50.0 + above_m)]
    after = handed_over(before, with_crew(before, {before.cells[0].id: "u2"}), fleet, LINK)
    assert bool(after.interrupted) is named and after.cells[0].apply_within_m == 0


def plan_of(devices, *cells):
    """A plan by hand: (aircraft, east, north, devices) of each cell, whose power is shared equally."""
    live = tuple(
        LiveCell(i, (float(x), float(y)), tuple(names), (10.0 / len(names),) * len(names))
        for i, (_, x, y, names) in enumerate(cells)
    )
    crew = {i: uav for i, (uav, *_) in enumerate(cells)}
    plan = LivePlan(live, SETTINGS.demands(devices), {}, len(cells), len(cells))
    return named_plan(plan, SETTINGS, [flying(uav, 0) for uav in crew.values()], crew)


@pytest.mark.parametrize(
    ("u2", "named"), [(flying("u2", 100), 0), (flying("u2", 180), 0), (grounded("u2", 100), 1), (flying("u2", 300), 1)]
)
def test_who_goes_to_another_aircraft_is_named_unless_that_is_in_reach_already(u2, named):
    """By hand: with half the power a UAV reaches sqrt(5e9 / (2^17 - 1) - 50^2) = 188.8 m."""
    devices = [device("a", 0), device("b", 100)]
    before = plan_of(devices, ("u1", 0, 0, "a"), ("u2", 100, 0, "b"))
    merged = plan_of(devices, ("u1", 9000, 0, "b"), ("u2", 100, 0, "ab"))
    merged = replace(
        merged,
        cells=tuple(cell for cell in merged.cells if cell.uav == "u2"),
        live=replace(merged.live, cells=merged.live.cells[1:]),
    )
    after = handed_over(before, merged, [flying("u1", 0), u2], LINK)
    assert list(after.interrupted) == ["a"] * named
    # b keeps its 10 W until its 5 W are enough, at 188.8 m.
    assert after.cells[0].apply_within_m == pytest.approx(188.8 if u2.position[0] == 300 else 0.0, abs=0.1)


def test_a_plan_from_scratch_pays_for_those_it_interrupts_from_where_the_aircraft_are():
    devices = [device("a", 0), device("b", 100)]
    before = plan_of(devices, ("u1", 0, 0, "a"), ("u2", 100, 0, "b"))
    full = full_deployment(devices, SETTINGS, 2)
    policy = ReplanningPolicy(rate_value=0.0, metre_cost=0.0, interruption_cost=1.0)
    there = [flying("u1", 0), flying("u2", 100)]
    weighed = weigh(full, devices, SETTINGS, there, before, policy)
    assert weighed.adopted and not weighed.plan.interrupted
    (cell,) = weighed.plan.cells
    on_its_way = [replace(craft, position=(0.0, 1500.0)) if craft.name == cell.uav else craft for craft in there]
    assert not weigh(full, devices, SETTINGS, on_its_way, before, policy).adopted


def test_powers_that_wait_still_wait_after_a_plan_that_leaves_the_cell_alone():
    """By hand: b is served with 10 W up to 271.7 m, with 5 W up to 188.8 m; the UAV comes from 100 m beyond that."""
    devices = [device("a", 0), device("b", 100)]
    before = plan_of(devices, ("u1", 300, 0, "b"))
    shared = plan_of(devices, ("u1", 100, 0, "ab"))
    first = handed_over(before, shared, [flying("u1", 300)], LINK)
    (cell,) = first.cells
    assert (cell.apply_within_m, cell.power_until_w) == (pytest.approx(188.8, abs=0.1), (("b", 10.0),))
    waiting = plan_change(devices, SETTINGS, [flying("u1", 295)], first)
    assert waiting.cells == first.cells and not waiting.interrupted
    applied = plan_change(devices, SETTINGS, [flying("u1", 280)], first)
    assert (applied.cells[0].apply_within_m, applied.cells[0].power_until_w) == (0.0, ())


class World:
    """Aircraft that fly straight to their goals, and radios that do what their power allocation says."""

    def __init__(self, seed):
        self.rng = np.random.default_rng(seed)
        self.devices = {}
        for _ in range(self.rng.integers(1, 9)):
            self.join()
        self.place = {f"u{i}": (100.0 * i, -300.0, 0.0) for i in range(6)}
        self.up = set(list(self.place)[: self.rng.integers(0, 7)])
        self.lost = set()
        self.goal, self.applied, self.waiting = {}, {}, {}
        self.plan = None

    def join(self):
        name = f"d{len(self.devices)}-{self.rng.integers(10**6)}"
        self.devices[name] = device(name, *self.rng.uniform(0, 700, 2), self.rng.uniform(14, 18))

    def event(self):
        """Let something happen to a device or to an aircraft."""
        names, kind = list(self.devices), self.rng.choice(["join", "join", "leave", "move", "launch", "loss", "weigh"])
        name = self.rng.choice(names) if names else None
        if kind == "join" or name is None:
            self.join()
        elif kind == "leave":
            del self.devices[name]
        elif kind == "move":
            east, north = np.array(self.devices[name].position) + self.rng.normal(0, 60, 2)
            self.devices[name] = replace(self.devices[name], position=(float(east), float(north)))
        elif kind == "launch":
            self.up |= set(self.place) - self.lost
        elif kind == "loss" and len(self.lost) < 4:
            self.lost.add(str(self.rng.choice(list(self.place))))
        return kind

    def aircraft(self):
        return [
            Aircraft(
                uav,
                place[:2],
                connected=uav not in self.lost,
                airborne=uav in self.up,
                unavailable="is lost" if uav in self.lost else "",
                up_m=place[2],
            )
            for uav, place in self.place.items()
        ]

    def publish(self, plan):
        """What each radio and each autopilot makes of a plan."""
        self.plan = plan
        busy = {cell.uav: cell for cell in plan.cells if cell.uav}
        for uav in self.place:
            self.goal.pop(uav, None)
            self.waiting.pop(uav, None)
            if uav not in busy:
                self.applied[uav] = {}
                continue
            cell = busy[uav]
            self.goal[uav] = (*cell.position, LINK.altitude_m)
            self.waiting[uav] = cell.apply_within_m, dict(zip(cell.device_ids, cell.power_w, strict=True))
        self.obey()

    def obey(self):
        for uav, (within_m, powers) in list(self.waiting.items()):
            if within_m == 0 or math.dist(self.place[uav], self.goal[uav]) <= within_m:
                self.applied[uav] = powers
                del self.waiting[uav]

    def fly(self, step_m=1.0):
        for uav in self.goal.keys() & (self.up - self.lost):
            way = np.subtract(self.goal[uav], self.place[uav])
            length = float(np.linalg.norm(way))
            share = 1.0 if length <= step_m else step_m / length
            self.place[uav] = tuple((np.array(self.place[uav]) + share * way).tolist())
        self.obey()

    def served(self, margin):
        """Devices whose rate is their demand and a margin more."""
        return {
            name
            for uav in self.up - self.lost
            for name, power in self.applied.get(uav, {}).items()
            if name in self.devices
            for there in [(*self.devices[name].position, 0.0)]
            if math.log2(1 + power * LINK.eta / math.dist(self.place[uav], there) ** 2)
            >= self.devices[name].rate_demand + margin
        }


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_who_is_served_and_not_named_stays_served_until_the_next_plan(seed):
    """Joins, moves, launches, losses and plans from scratch while aircraft are anywhere on their ways.

    An aircraft within 2 m of its goal counts as there: what 2 m change from 50 m away is at most 2 / (50 ln 2) = 0.058.
    """
    world, margin = World(seed), 0.06
    for _ in range(8):
        before = world.served(margin)
        kind = world.event()
        # As it was before a loss, but for the present demands and places.
        before &= world.devices.keys() if kind == "loss" else world.served(margin)
        devices, fleet, old = list(world.devices.values()), world.aircraft(), world.plan
        if old is None:
            plan = plan_from_scratch(devices, SETTINGS, fleet)
        elif kind == "weigh":
            full = full_deployment(devices, SETTINGS, sum(craft.available for craft in fleet))
            plan = weigh(full, devices, SETTINGS, fleet, old, ReplanningPolicy(tolerance=0.0)).plan
        else:
            plan = plan_change(devices, SETTINGS, fleet, old)
        plan = handed_over(old, plan, fleet, LINK)
        world.publish(plan)
        safe = before - plan.interrupted.keys() - plan.unserved.keys()
        for _ in range(int(world.rng.integers(1, 400))):
            short = safe - world.served(-margin)
            assert not short, f"{short} lost the rate after {kind}"
            world.fly()

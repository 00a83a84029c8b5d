"""Which aircraft gets which cell. Oracle: every assignment tried in turn, and rules worked by hand."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jpap_ros.fleet.cells import Aircraft, FleetCell, FleetPlan
from jpap_ros.fleet.naming import name_cells
from jpap_ros.fleet.plan import full_deployment, plan_change, plan_from_scratch, weigh
from jpap_ros.fleet.plan_settings import PlanSettings
from jpap_ros.planning import SCHEMES, LinkBudget
from jpap_ros.planning.devices import Device
from jpap_ros.planning.replanning_decision import ReplanningPolicy
from jpap_ros.planning.replanning_state import LivePlan

SCHEME = "jpap"
RATE = 16.0


def cell(number, x, y, *ids):
    return FleetCell(number, "", (float(x), float(y)), ids, (1.0,) * len(ids), (RATE,) * len(ids))


def craft(name, x, y, connected=True, unavailable=""):
    return Aircraft(name, (float(x), float(y)), connected, unavailable=unavailable)


def who(named):
    return {ids: c.uav for c in named for ids in [c.device_ids]}


def cost(named, fleet):
    where = {c.name: c.position for c in fleet}
    return sum(math.dist(c.position, where[c.uav]) ** 2 for c in named if c.uav)


points = st.tuples(st.integers(-500, 500), st.integers(-500, 500))


@settings(max_examples=60, deadline=None)
@given(st.lists(points, min_size=1, max_size=4), st.lists(points, min_size=4, max_size=6))
def test_the_sum_of_squared_distances_is_least(goals, homes):
    cells = [cell(i, *goal, f"d{i}") for i, goal in enumerate(goals)]
    fleet = [craft(f"uav{i}", *home) for i, home in enumerate(homes)]
    least = min(
        sum(math.dist(goal, homes[i]) ** 2 for goal, i in zip(goals, order, strict=True))
        for order in itertools.permutations(range(len(homes)), len(goals))
    )
    for connected in (True, False):
        named = name_cells(cells, [craft(c.name, *c.position, connected) for c in fleet], {})
        assert {c.device_ids for c in named} == {c.device_ids for c in cells}
        assert len({c.uav for c in named}) == len(cells)
        assert cost(named, fleet) == pytest.approx(least, abs=1e-6)


def test_a_cell_keeps_its_aircraft_though_another_is_nearer():
    fleet = [craft("far", 900, 0), craft("near", 1, 0)]
    assert who(name_cells([cell(7, 5, 0, "a")], fleet, {7: "far"})) == {("a",): "far"}


def test_a_cell_whose_aircraft_is_gone_gets_the_nearest():
    fleet = [craft("x", 50, 0), craft("y", 10, 0)]
    assert who(name_cells([cell(7, 0, 0, "a")], fleet, {7: "gone"})) == {("a",): "y"}


def test_aircraft_with_telemetry_come_first_however_far():
    fleet = [craft("silent", 0, 0, connected=False), craft("heard", 9000, 0)]
    assert who(name_cells([cell(0, 0, 0, "a")], fleet, {})) == {("a",): "heard"}
    both = name_cells([cell(0, 0, 0, "a"), cell(1, 9000, 9000, "b")], fleet, {})
    assert who(both) == {("a",): "silent", ("b",): "heard"}


def test_all_with_telemetry_are_used_before_one_without():
    fleet = [craft("s1", 0, 0, connected=False), craft("s2", 10, 0, connected=False), craft("heard", 5000, 0)]
    named = name_cells([cell(0, 0, 0, "a"), cell(1, 10, 0, "b")], fleet, {})
    assert "heard" in who(named).values()


def test_cells_beyond_the_fleet_have_no_name_and_come_last():
    named = name_cells([cell(0, 100, 0, "a"), cell(1, 1, 0, "b")], [craft("x", 0, 0)], {})
    assert [(c.uav, c.device_ids) for c in named] == [("x", ("b",)), ("", ("a",))]


def test_cells_come_in_the_order_of_the_fleet():
    fleet = [craft("z", 100, 0), craft("a", 0, 0)]
    assert [c.uav for c in name_cells([cell(0, 0, 0, "p"), cell(1, 100, 0, "q")], fleet, {})] == ["z", "a"]


def spread(count):
    """Devices so far apart (2 km) that each needs a UAV of its own."""
    return [Device(f"d{i}", (2000.0 * i, 0.0), RATE) for i in range(count)]


def test_unavailable_aircraft_get_no_cell_and_the_rest_is_reported():
    fleet = [craft("a", 0, 0), craft("b", 0, 0, unavailable="is lost"), craft("c", 0, 0)]
    plan = plan_from_scratch(spread(3), PlanSettings(scheme=SCHEME), fleet)
    assert [c.uav for c in plan.cells] == ["a", "c"]
    assert len(plan.unserved) == 1 and plan.uavs_needed == 3
    assert plan.summary() == "2 UAVs serve 2 devices, 1 unserved, 3 UAVs needed"


def test_without_devices_there_are_no_cells():
    plan = plan_from_scratch([], PlanSettings(scheme=SCHEME), [craft("a", 0, 0)])
    assert (plan.cells, plan.unserved, plan.uavs_needed) == ((), {}, 0)
    assert math.isnan(plan.average_uav_rate)


def test_without_aircraft_every_device_is_unserved():
    plan = plan_from_scratch(spread(2), PlanSettings(scheme=SCHEME), [craft("a", 0, 0, unavailable="is lost")])
    assert plan.cells == () and plan.unserved.keys() == {"d0", "d1"}


def test_rates_are_in_bit_per_second_and_meet_the_demands():
    """Shannon's formula with the bandwidth, computed here from the powers and the geometry alone."""
    bandwidth, link = 180e3, LinkBudget()
    devices = [Device(f"d{i}", (40.0 * i, 10.0 * i), bandwidth * (15 + i / 4)) for i in range(8)]
    plan = plan_from_scratch(
        devices, PlanSettings(scheme=SCHEME, bandwidth_hz=bandwidth), [craft("a", 0, 0), craft("b", 0, 0)]
    )
    demand = {device.id: device for device in devices}
    assert plan.unserved == {}
    for c in plan.cells:
        assert sum(c.power_w) == pytest.approx(10.0)
        assert c.uav_rate == pytest.approx(sum(c.rate))
        for name, power, rate in zip(c.device_ids, c.power_w, c.rate, strict=True):
            distance2 = math.dist(c.position, demand[name].position) ** 2 + link.altitude_m**2
            assert rate == pytest.approx(bandwidth * np.log2(1 + power * 1e-3 / distance2 / 1e-12))
            assert rate >= demand[name].rate_demand * (1 - 1e-9)
    assert plan.average_uav_rate == pytest.approx(np.mean([c.uav_rate for c in plan.cells]))


def test_an_impossible_demand_is_reported_and_the_others_are_served():
    devices = [Device("greedy", (0.0, 0.0), 30.0), Device("modest", (10.0, 0.0), RATE)]
    plan = plan_from_scratch(devices, PlanSettings(scheme=SCHEME), [craft("a", 0, 0)])
    assert [c.device_ids for c in plan.cells] == [("modest",)]
    assert plan.unserved.keys() == {"greedy"} and "30" in plan.unserved["greedy"]


def test_a_joining_device_leaves_every_other_cell_and_name_as_it_was():
    fleet = [craft(f"u{i}", 10 * i, 0) for i in range(5)]
    before = plan_from_scratch(spread(3), PlanSettings(scheme=SCHEME), fleet)
    after = plan_change([*spread(3), Device("new", (5.0, 5.0), RATE)], PlanSettings(scheme=SCHEME), fleet, before)
    assert {c.device_ids: c.uav for c in after.cells if "new" not in c.device_ids} == {
        c.device_ids: c.uav for c in before.cells if "d0" not in c.device_ids
    }
    (joined,) = [c for c in after.cells if "new" in c.device_ids]
    assert set(joined.device_ids) == {"d0", "new"}
    assert joined.uav == next(c.uav for c in before.cells if c.device_ids == ("d0",))
    assert not after.from_scratch and after.unserved == {}


def test_a_lost_aircraft_is_replaced_by_a_reserve_and_nobody_else_moves():
    fleet = [craft(f"u{i}", 10 * i, 0) for i in range(4)]
    before = plan_from_scratch(spread(3), PlanSettings(scheme=SCHEME), fleet)
    victim = before.cells[0].uav
    now = [craft(c.name, *c.position, unavailable="is lost" if c.name == victim else "") for c in fleet]
    after = plan_change(spread(3), PlanSettings(scheme=SCHEME), now, before)
    was, is_now = ({c.device_ids: c.uav for c in plan.cells} for plan in (before, after))
    changed = [ids for ids in was if was[ids] != is_now[ids]]
    assert len(changed) == 1 and was[changed[0]] == victim
    assert is_now[changed[0]] not in was.values()


def test_without_a_reserve_the_lightest_cells_are_given_up():
    devices = [Device(f"d{i}", (2000.0 * i, 0.0), RATE, weight) for i, weight in enumerate((1.0, 5.0, 3.0))]
    fleet = [craft(f"u{i}", 2000 * i, 0) for i in range(3)]
    before = plan_from_scratch(devices, PlanSettings(scheme=SCHEME), fleet)
    for lost in range(3):
        now = [craft(c.name, *c.position, unavailable="is lost" if i == lost else "") for i, c in enumerate(fleet)]
        after = plan_change(devices, PlanSettings(scheme=SCHEME), now, before)
        assert len(after.cells) == 2 and all(c.uav and c.uav != f"u{lost}" for c in after.cells)
        assert len(after.unserved) == 1 and after.uavs_needed == 3


def scattered(count, seed):
    """Devices of the paper's scenario."""
    rng = np.random.default_rng(seed)
    where, rates = rng.uniform(-750, 750, (count, 2)), rng.uniform(15, 20, count)
    return [
        Device(f"d{i}", (x, y), r) for i, ((x, y), r) in enumerate(zip(where.tolist(), rates.tolist(), strict=True))
    ]


def airborne(fleet):
    return [Aircraft(c.name, c.position, True, True) for c in fleet]


def test_a_plan_from_scratch_is_flown_only_where_it_is_worth_it():
    """The optimal scheme saves UAVs over jpap here; a price of metres that no saving pays for keeps all in place."""
    devices, fleet = scattered(20, seed=1), [craft(f"u{i}", 10 * i, 0) for i in range(20)]
    settings_ = PlanSettings(scheme="optimal", time_limit_s=20.0)
    present = plan_from_scratch(devices, settings_, fleet)
    full = full_deployment(devices, settings_, len(fleet))
    assert len(full.uav_positions) < len(present.cells)

    taken = weigh(full, devices, settings_, airborne(fleet), present, ReplanningPolicy())
    assert taken.adopted and taken.plan.from_scratch
    assert len(taken.plan.cells) == len(full.uav_positions) == taken.plan.min_uavs_bound
    assert taken.plan.proven_optimal and taken.plan.gap == 0.0
    assert taken.plan.average_uav_rate_bound == pytest.approx(full.average_uav_rate_bound)

    left = weigh(full, devices, settings_, airborne(fleet), present, ReplanningPolicy(metre_cost=100.0))
    assert not left.adopted and left.plan.cells == present.cells
    # The bound holds for the plan that stays, too.
    assert left.plan.min_uavs_bound == full.min_uavs_bound and not left.plan.proven_optimal
    assert left.plan.gap == pytest.approx(1 - full.min_uavs_bound / len(present.cells))

    # On the ground metres cost nothing.
    assert weigh(full, devices, settings_, fleet, present, ReplanningPolicy(metre_cost=100.0)).adopted


def test_a_plan_that_stays_is_not_called_proven_where_the_separation_leaves_a_device_out():
    """Two UAVs are needed, and at least two; but within 5 m of one place no two can hover 20 m apart."""
    link = LinkBudget()
    demand = math.log2(1 + link.power_eta / (5.0**2 + link.altitude_m**2))
    devices = [Device(name, (0.0, 0.0), demand) for name in ("a", "b")]
    fleet = [craft(f"u{i}", 10 * i, 0) for i in range(2)]
    settings_ = PlanSettings(scheme="optimal", min_separation_m=20.0, time_limit_s=5.0)
    # As many UAVs as the scheme without a bound asks for.
    present = replace(plan_from_scratch(devices, settings_, fleet), uavs_needed=2)
    full = full_deployment(devices, settings_, len(fleet))
    assert len(full.unserved) == len(present.unserved) == 1
    assert full.min_uavs_bound == 2

    left = weigh(full, devices, settings_, airborne(fleet), present, ReplanningPolicy(metre_cost=100.0))
    assert not left.adopted and left.plan.min_uavs_bound == 2
    assert not left.plan.proven_optimal


def test_the_quick_plan_of_a_slow_scheme_meets_every_demand():
    devices, fleet = scattered(30, seed=2), [craft(f"u{i}", 10 * i, 0) for i in range(30)]
    plan = plan_from_scratch(devices, PlanSettings(scheme="optimal"), fleet)
    demand = {device.id: device for device in devices}
    assert sorted(name for c in plan.cells for name in c.device_ids) == sorted(demand)
    assert plan.scheme == "optimal" and not plan.proven_optimal and plan.min_uavs_bound is None
    for c in plan.cells:
        assert sum(c.power_w) == pytest.approx(10.0)
        for name, power in zip(c.device_ids, c.power_w, strict=True):
            distance2 = math.dist(c.position, demand[name].position) ** 2 + 50.0**2
            assert np.log2(1 + power * 1e-3 / distance2 / 1e-12) >= demand[name].rate_demand * (1 - 1e-9)


EXTREMES = [
    Device("d0", (0.0, 0.0), 1e308),
    Device("d0", (0.0, 0.0), 1e-300),
    Device("d0", (1e5, -1e5), RATE),
    Device("d0", (0.0, 0.0), RATE, 1e300),
    Device("d0", (0.0, 0.0), 1030.0),
]


@pytest.mark.parametrize("scheme", sorted(SCHEMES))
@pytest.mark.parametrize("extreme", EXTREMES, ids=["huge", "tiny", "far", "heavy", "beyond"])
def test_no_single_device_can_spoil_the_plan_for_the_others(scheme, extreme):
    """A device that is served, and then reports an extreme that the table accepts: the checker finds nothing broken."""
    devices, fleet = spread(3), [craft(f"u{i}", 10 * i, 0) for i in range(5)]
    for bandwidth in (1.0, 1e-3):
        how = PlanSettings(scheme=scheme, bandwidth_hz=bandwidth, time_limit_s=20.0)
        before = plan_from_scratch([Device(d.id, d.position, d.rate_demand * bandwidth) for d in devices], how, fleet)
        now = [extreme, *(Device(d.id, d.position, d.rate_demand * bandwidth) for d in devices[1:])]
        for plan in (plan_change(now, how, fleet, before), plan_from_scratch(now, how, fleet)):
            demands = how.demands(now)
            live = plan.live.deployment(how.limits(len(fleet)))
            assert live.violations(demands.positions, demands.rates, how.link) == []
            served = {name for c in plan.cells for name in c.device_ids}
            assert {"d1", "d2"} <= served and served | plan.unserved.keys() == {"d0", "d1", "d2"}


def test_devices_of_the_greatest_weights_stay_in_the_plan_when_their_aircraft_is_lost():
    """Two weights whose sum is no number share a cell. Oracle: what all weights alike would give, by hand."""
    devices = [Device("a", (0.0, 0.0), RATE, 1.7e308), Device("b", (10.0, 0.0), RATE, 1.7e308), spread(3)[2]]
    fleet = [craft("x", 0, 0), craft("y", 4000, 0), craft("z", 9000, 0)]
    before = plan_from_scratch(devices, PlanSettings(scheme=SCHEME), fleet)
    assert who(before.cells) == {("a", "b"): "x", ("d2",): "y"}
    after = plan_change(devices, PlanSettings(scheme=SCHEME), fleet[1:], before)
    assert who(after.cells) == {("a", "b"): "z", ("d2",): "y"} and not after.unserved


def fleet_plan(cells=(), needed=0, bound=None, proven=False):
    return FleetPlan(cells, cells, LivePlan.empty(), {}, needed, bound, proven, SCHEME, math.nan, {}, True)


def test_the_summary_counts():
    plan = fleet_plan((cell(0, 0, 0, "a", "b"),), needed=1)
    assert plan.summary() == "1 UAV serves 2 devices"
    assert plan.average_uav_rate == 2 * RATE


@pytest.mark.parametrize(
    ("needed", "bound", "proven", "gap"),
    [(10, 8, False, 0.2), (8, 8, True, 0.0), (5, None, False, math.nan), (0, 0, False, 0.0)],
)
def test_the_gap_is_the_part_of_the_uavs_that_may_be_too_many(needed, bound, proven, gap):
    assert fleet_plan((), needed, bound, proven).gap == pytest.approx(gap, nan_ok=True)

"""Incremental replanning and the decision for a plan made from scratch.

Oracles: `Deployment.violations`, which recomputes every constraint of P1 from positions and powers; `solve` from
scratch for who can be served; dense sampling of flights and moments for interruptions; dense grids for positions;
figures worked out by hand from equations (5) and (10).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jpap_ros.planning import LinkBudget, solve
from jpap_ros.planning.replanning import replan
from jpap_ros.planning.replanning_continuity import HOVER_RADIUS_M, Continuity, OnAir, Radio
from jpap_ros.planning.replanning_decision import ReplanningPolicy, consider
from jpap_ros.planning.replanning_position import nearest_position
from jpap_ros.planning.replanning_rules import POWER_RULES, PowerRule
from jpap_ros.planning.replanning_state import Demands, Limits, LiveCell, LivePlan

LINK = LinkBudget()
FAST_SCHEMES = [scheme for scheme in POWER_RULES if scheme != "optimal"]


class World:
    """Devices that come, go, move and change their demand at random."""

    def __init__(self, seed, count, side=900.0):
        self.rng = np.random.default_rng(seed)
        self.side = side
        self.rows = {}
        self.names = itertools.count()
        for _ in range(count):
            self.join()

    def join(self):
        self.rows[f"d{next(self.names)}"] = self.draw()

    def draw(self):
        return (*self.rng.uniform(0, self.side, 2).tolist(), self.rng.uniform(14, 19), self.rng.choice([1.0, 3.0]))

    def event(self):
        kind = self.rng.choice(["join", "leave", "move", "demand"])
        if kind == "join" or len(self.rows) < 2:
            return self.join()
        name = self.rng.choice(list(self.rows))
        x, y, rate, weight = self.rows[name]
        if kind == "leave":
            del self.rows[name]
        elif kind == "move":
            self.rows[name] = (x + self.rng.normal(0, 60), y + self.rng.normal(0, 60), rate, weight)
        else:
            self.rows[name] = (x, y, self.rng.uniform(14, 19), weight)
        return None

    @property
    def demands(self):
        table = np.array(list(self.rows.values())).reshape(-1, 4)
        return Demands.of(list(self.rows), table[:, :2], table[:, 2], table[:, 3])


def violations(plan, limits):
    return plan.deployment(limits).violations(
        plan.demands.positions,
        plan.demands.rates,
        limits.link,
        limits.max_devices_per_uav,
        limits.max_uavs,
        limits.min_separation_m,
    )


def solved(demands, limits):
    deployment = solve(
        demands.positions,
        demands.rates,
        limits.scheme,
        limits.link,
        limits.max_devices_per_uav,
        limits.max_uavs,
        demands.weights,
        limits.min_separation_m,
    )
    return LivePlan.of(deployment, demands)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    scheme=st.sampled_from([*POWER_RULES]),
    count=st.integers(0, 14),
    separation=st.sampled_from([0.0, 30.0]),
    limit=st.sampled_from([None, 3]),
    fleet=st.sampled_from([None, 3]),
)
def test_after_any_events_no_constraint_is_broken(seed, scheme, count, separation, limit, fleet):
    world = World(seed, count)
    limits = Limits(scheme, LINK, limit, fleet, separation)
    plan = replan(LivePlan.empty(), world.demands, limits).plan
    for _ in range(8):
        before = plan
        world.event()
        change = replan(before, world.demands, limits)
        plan = change.plan
        assert violations(plan, limits) == []
        assert set(plan.cell_of) | set(plan.unserved) == set(world.rows)
        untouched = {cell.id: cell for cell in before.cells if cell.id not in change.touched + change.ended}
        assert all(cell is untouched[cell.id] for cell in plan.cells if cell.id in untouched)
        if fleet is None and separation == 0:
            assert not plan.unserved  # as `solve` without limits, which leaves out only what nobody can serve


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), scheme=st.sampled_from(FAST_SCHEMES), count=st.integers(1, 25))
def test_a_plan_made_from_scratch_is_left_alone_when_nothing_happens(seed, scheme, count):
    demands = World(seed, count).demands
    limits = Limits(scheme, LINK)
    plan = solved(demands, limits)
    change = replan(plan, demands, limits)
    assert (change.touched, change.ended, change.moved_m, dict(change.interrupted)) == ((), (), 0.0, {})
    assert all(new is old for new, old in zip(change.plan.cells, plan.cells, strict=True))


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), scheme=st.sampled_from(FAST_SCHEMES), count=st.integers(1, 15))
def test_one_event_touches_few_cells_and_interrupts_nobody_while_there_are_uavs(seed, scheme, count):
    world = World(seed, count)
    limits = Limits(scheme, LINK)
    plan = solved(world.demands, limits)
    then = dict(world.rows)
    world.event()
    changed = {name for name, row in world.rows.items() if then.get(name) != row} | (then.keys() - world.rows.keys())
    change = replan(plan, world.demands, limits)
    assert len(change.touched) + len(change.ended) <= 2
    assert set(change.interrupted) <= changed
    for name in world.rows.keys() - changed:
        assert change.plan.cell_of[name].id == plan.cell_of[name].id


def test_a_departed_device_frees_its_power_by_hand():
    # QDPA: w = 2^r - 1 = 3, 3, 1 at 10 W; without the second device 3/4 and 1/4 of it remain.
    demands = Demands.of(["a", "b", "c"], [[0, 0], [10, 0], [20, 0]], [2.0, 2.0, 1.0])
    limits = Limits("jpap", LINK)
    plan = solved(demands, limits)
    (cell,) = plan.cells
    assert dict(zip(cell.device_ids, cell.power_w, strict=True)) == pytest.approx(
        {"a": 30 / 7, "b": 30 / 7, "c": 10 / 7}
    )
    change = replan(plan, Demands.of(["a", "c"], [[0, 0], [20, 0]], [2.0, 1.0]), limits)
    (cell,) = change.plan.cells
    assert dict(zip(cell.device_ids, cell.power_w, strict=True)) == pytest.approx({"a": 7.5, "c": 2.5})
    assert cell.position == plan.cells[0].position


def test_a_joining_device_goes_to_the_uav_that_need_not_move():
    demands = Demands.of(["a", "b"], [[0, 0], [2000, 0]], [15.0, 15.0])
    limits = Limits("optimal", LINK)
    plan = replan(LivePlan.empty(), demands, limits).plan
    assert len(plan.cells) == 2
    change = replan(plan, Demands.of(["a", "b", "c"], [[0, 0], [2000, 0], [40, 0]], [15.0, 15.0, 15.0]), limits)
    assert change.plan.cell_of["c"].id == plan.cell_of["a"].id
    assert (change.moved_m, change.touched) == (0.0, (plan.cell_of["a"].id,))


def test_a_fleet_too_small_leaves_out_the_light_and_says_how_many_it_takes():
    demands = Demands.of(["a", "b", "c"], [[0, 0], [5000, 0], [9000, 0]], [16.0] * 3, [1.0, 5.0, 2.0])
    change = replan(LivePlan.empty(), demands, Limits("jpap", LINK, max_uavs=2))
    assert set(change.plan.cell_of) == {"b", "c"}
    assert "all 2 of the fleet are in use" in change.plan.unserved["a"]
    assert change.plan.uavs_needed == 3


def test_no_uav_could_serve_it():
    change = replan(LivePlan.empty(), Demands.of(["a"], [[0, 0]], [25.0]), Limits("jpap", LINK))
    assert "the most that one UAV can give" in change.plan.unserved["a"]
    assert change.plan.cells == ()


def test_a_lost_cell_is_picked_up_by_a_neighbour_or_by_a_new_one():
    near = Demands.of(["a", "b"], [[0, 0], [60, 0]], [14.0, 14.0])
    limits = Limits("optimal", LINK, max_devices_per_uav=None)
    cells = (LiveCell(0, (0.0, 0.0), ("a",), (10.0,)), LiveCell(1, (60.0, 0.0), ("b",), (10.0,)))
    change = replan(LivePlan(cells, near, {}, 2, 2), near, limits, lost_cells=[1])
    assert change.plan.cell_of["b"].id == 0
    assert change.ended == (1,)
    far = Demands.of(["a", "b"], [[0, 0], [5000, 0]], [14.0, 14.0])
    cells = (cells[0], replace(cells[1], position=(5000.0, 0.0)))
    change = replan(LivePlan(cells, far, {}, 2, 2), far, limits, lost_cells=[1])
    assert change.plan.cell_of["b"].id == 2
    assert "arrive first" in change.interrupted["b"]


def test_cell_ids_are_never_used_again():
    limits = Limits("jpap", LINK)
    plan = replan(LivePlan.empty(), Demands.of(["a"], [[0, 0]], [15.0]), limits).plan
    plan = replan(plan, Demands.of([], [], []), limits).plan
    assert plan.cells == ()
    plan = replan(plan, Demands.of(["a"], [[0, 0]], [15.0]), limits).plan
    assert [cell.id for cell in plan.cells] == [1]


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), reach=st.floats(0.97, 1.4))
def test_interruptions_against_sampled_flights(seed, reach):
    """Every change of powers at one of 201 moments, seen at 201 places on the way."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 4))
    demands = Demands.of([f"d{i}" for i in range(count)], rng.uniform(0, 100, (count, 2)), rng.uniform(12, 15, count))
    a, b = rng.uniform(0, 100, (2, 2))

    def powers(at):
        distance2 = ((demands.positions - at) ** 2).sum(axis=1)
        exact = (2**demands.rates - 1) * (distance2 + LINK.altitude_m**2) / LINK.eta
        return exact * rng.uniform(1.0, reach + 0.5, count)

    old = LiveCell(0, tuple(a.tolist()), demands.ids, tuple(powers(a).tolist()))
    new = LiveCell(0, tuple(b.tolist()), demands.ids, tuple(powers(b).tolist()))
    now = OnAir.at_goals(LivePlan((old,), demands, {}, 1, 1), LINK)
    broken = Continuity(now, demands, LINK).power_change(new).broken
    way = np.linspace(0, 1, 201)
    distance2 = ((a + way[:, None, None] * (b - a) - demands.positions) ** 2).sum(axis=2)

    def fewest(margin):
        """Fewest interrupted devices for any sampled moment, where rates count as `margin` higher."""
        fine_old = LINK.rate(np.array(old.power_w), distance2) + margin >= demands.rates
        fine_new = LINK.rate(np.array(new.power_w), distance2) + margin >= demands.rates
        served = [np.where((way < moment)[:, None], fine_old, fine_new).all(axis=0) for moment in way]
        return min(int((~fine).sum()) for fine in served)

    # Between two samples, at most 0.71 m apart, a rate changes by less than 0.71 / (H ln 2) = 0.0205 bit/s/Hz.
    assert fewest(0.021) <= len(broken) <= fewest(-0.021)


@settings(max_examples=200, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_who_is_not_named_is_served_all_the_way_with_the_powers_that_apply(seed):
    """Oracle: the way from anywhere in space, sampled at 401 places, and equation (3) with the powers of each."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 5))
    names = [f"d{i}" for i in range(count)]
    demands = Demands.of(names, rng.uniform(0, 100, (count, 2)), rng.uniform(12, 15, count))
    a, b = rng.uniform((-20, -20, 30), (120, 120, 80)), np.array([*rng.uniform(0, 100, 2), LINK.altitude_m])
    if rng.random() < 0.2:
        a[:2] = b[:2]

    def powers(at, spare):
        distance2 = ((demands.positions - at[:2]) ** 2).sum(axis=1) + at[2] ** 2
        return (2**demands.rates - 1) * distance2 / LINK.eta * rng.uniform(0.98, spare, count)

    old, new = powers(a, 1.8), np.maximum(powers(b, 1.8), powers(b, 1.0))
    elsewhere = rng.random(count) < 0.3  # served by another UAV until now
    radio = Radio(tuple(a.tolist()), {n: float(p) for n, p, o in zip(names, old, elsewhere, strict=True) if not o})
    other = Radio((0.0, 0.0, 50.0), {n: 1e6 for n, o in zip(names, elsewhere, strict=True) if o})
    cell = LiveCell(3, tuple(b[:2].tolist()), tuple(names), tuple(new.tolist()))
    change = Continuity(OnAir({3: radio}, (other,)), demands, LINK).power_change(cell)

    way = a + np.linspace(0, 1, 401)[:, None] * (b - a)
    left_m = np.linalg.norm(way - b, axis=1)
    distance2 = ((way[:, None, :2] - demands.positions) ** 2).sum(axis=2) + way[:, 2:] ** 2
    changed = np.logical_or.accumulate(left_m <= change.within_m) if change.within_m else np.ones(401, dtype=bool)
    power = np.where(changed[:, None], new, np.where(elsewhere, 0.0, old))
    rate = np.log2(1 + power * LINK.eta / distance2)
    # Within 2 m of the goal a rate may be short by what 2 m make: from straight above 2 log2(52 / 50) = 0.113.
    short = (rate < demands.rates - np.where(left_m <= HOVER_RADIUS_M, 0.115, 1e-6)[:, None]).any(axis=0)
    meets_at_goal = np.log2(1 + new * LINK.eta / distance2[-1]) >= demands.rates - 1e-9
    now = elsewhere | (np.log2(1 + old * LINK.eta / distance2[0]) >= demands.rates)
    for k, name in enumerate(names):
        if now[k] and name not in change.broken and meets_at_goal[k]:
            assert not short[k], f"{name} is short of its rate"
        if not now[k]:
            assert name not in change.broken or old[k] * LINK.eta / distance2[0, k] >= (2 ** demands.rates[k] - 1) * (
                1 - 1e-8
            )


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_nearest_position_against_a_dense_grid(seed):
    rng = np.random.default_rng(seed)
    discs = [(*rng.uniform(-20, 20, 2).tolist(), float(rng.uniform(15, 40) ** 2)) for _ in range(rng.integers(1, 4))]
    others = [tuple(point) for point in rng.uniform(-40, 40, (rng.integers(0, 5), 2)).tolist()]
    here = tuple(rng.uniform(-60, 60, 2).tolist())
    found = nearest_position(here, discs, others, 15.0)
    step = 0.5
    grid = np.stack(np.meshgrid(np.arange(-65, 65, step), np.arange(-65, 65, step)), axis=-1).reshape(-1, 2)
    good = np.ones(len(grid), dtype=bool)
    for x, y, r2 in discs:
        good &= ((grid - (x, y)) ** 2).sum(axis=1) <= r2
    for other in others:
        good &= ((grid - other) ** 2).sum(axis=1) >= 15.0**2
    if not good.any():
        return
    assert found is not None
    assert all(math.dist(found, (x, y)) <= math.sqrt(r2) * (1 + 1e-9) for x, y, r2 in discs)
    assert all(math.dist(found, other) >= 15.0 for other in others)
    nearest = np.sqrt(((grid[good] - here) ** 2).sum(axis=1)).min()
    assert math.dist(found, here) <= nearest + 1e-9


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), scheme=st.sampled_from([*POWER_RULES]))
def test_the_discs_of_a_rule_are_where_its_powers_meet_the_demands(seed, scheme):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 6))
    positions, rates = rng.uniform(0, 120, (count, 2)), rng.uniform(13, 18, count)
    rule = PowerRule.of(scheme, LINK)
    snr = 2**rates - 1
    discs = rule.discs([tuple(row) for row in positions.tolist()], snr.tolist())
    for at in rng.uniform(-50, 170, (40, 2)):
        distance2 = ((positions - at) ** 2).sum(axis=1)
        if scheme == "optimal":
            meets = (snr * (distance2 + LINK.altitude_m**2) / LINK.eta).sum() <= LINK.transmit_power_w
        else:
            meets = (LINK.rate(rule.powers(distance2, snr), distance2) >= rates).all()
        inside = discs is not None and all(math.dist(at, (x, y)) ** 2 <= r2 for x, y, r2 in discs)
        if scheme != "jpap_epa_common":
            assert inside == meets
        elif inside:  # the smallest radius taken for all: sufficient
            assert meets
        if inside:
            power = rule.powers(distance2, snr)
            assert power.sum() == pytest.approx(LINK.transmit_power_w)
            assert (LINK.rate(power, distance2) >= rates - 1e-9).all()


def cells_at(places, ids=None):
    """A plan of one device below each UAV."""
    demands = Demands.of([f"d{i}" for i in range(len(places))], places, [15.0] * len(places))
    ids = range(len(places)) if ids is None else ids
    cells = tuple(LiveCell(i, place, (f"d{k}",), (10.0,)) for k, (i, place) in enumerate(zip(ids, places, strict=True)))
    return LivePlan(cells, demands, {}, max(ids) + 1, len(places))


def test_the_same_plan_again_is_not_adopted_and_keeps_every_id():
    plan = cells_at([(0.0, 0.0), (900.0, 0.0)], ids=[7, 4])
    limits = Limits("jpap", LINK)
    decision = consider(plan.deployment(limits), plan, plan.demands, limits)
    assert not decision.adopt
    assert (decision.gain, decision.cost, decision.change.touched) == (0.0, 0.0, ())
    assert [cell.id for cell in decision.change.plan.cells] == [7, 4]


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), old=st.integers(1, 5), new=st.integers(1, 5))
def test_cells_take_over_with_the_least_squared_distance_of_all_permutations(seed, old, new):
    rng = np.random.default_rng(seed)
    present = cells_at([tuple(p) for p in rng.uniform(0, 500, (old, 2)).tolist()])
    demands = present.demands
    full = cells_at([tuple(p) for p in rng.uniform(0, 500, (new, 2)).tolist()]).deployment(Limits("jpap", LINK))
    full = replace(full, serving_uav=np.zeros(old), power_w=np.full(old, 10.0 / old), rate=np.ones(old))
    change = consider(full, present, demands, Limits("jpap", LINK)).change
    place = {cell.id: cell.position for cell in present.cells}
    total = sum(math.dist(c.position, place[c.id]) ** 2 for c in change.plan.cells if c.id in place)
    short, long = sorted([list(map(tuple, full.uav_positions.tolist())), list(place.values())], key=len)
    best = min(
        sum(math.dist(a, b) ** 2 for a, b in zip(short, order, strict=True))
        for order in itertools.permutations(long, len(short))
    )
    assert total == pytest.approx(best)
    assert len({cell.id for cell in change.plan.cells}) == new


def test_gain_and_cost_by_hand():
    # Two devices 60 m apart, a UAV over each; the other plan serves both with one UAV from the middle.
    plan = cells_at([(0.0, 0.0), (60.0, 0.0)])
    limits = Limits("jpap", LINK)
    full = solve(plan.demands.positions, plan.demands.rates, "jpap")
    assert len(full.uav_positions) == 1
    moved = float(np.hypot(*(full.uav_positions[0] - (0, 0)))), float(np.hypot(*(full.uav_positions[0] - (60, 0))))
    rate = full.average_uav_rate / plan.deployment(limits).average_uav_rate - 1
    policy = ReplanningPolicy(metre_cost=0.001, launch_cost=0.25, interruption_cost=0.0)
    decision = consider(full, plan, plan.demands, limits, policy)
    assert decision.gain == pytest.approx(1.0 + rate)
    assert decision.cost == pytest.approx(0.001 * min(moved) + 0.25)
    assert decision.adopt
    assert "+1 UAVs saved" in decision.reason
    dear = ReplanningPolicy(metre_cost=1.0)
    assert not consider(full, plan, plan.demands, limits, dear).adopt


def test_a_lost_cell_has_no_heir():
    plan = cells_at([(0.0, 0.0), (900.0, 0.0)])
    limits = Limits("jpap", LINK)
    change = consider(plan.deployment(limits), plan, plan.demands, limits, lost_cells=[1]).change
    assert [cell.id for cell in change.plan.cells] == [0, 2]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Demands.of(["a", "a"], [[0, 0]] * 2, [1, 1]), "ids must be unique, got 'a' twice"),
        (lambda: Demands.of(["a"], [[0, 0]], [0]), r"rates\[0\] must be finite and > 0, got 0.0"),
        (lambda: Demands.of(["a"], [[0, 0]] * 2, [1, 1]), "ids must have one entry for each of 2 positions, got 1"),
        (lambda: Limits("best"), "scheme must be one of jpap, .*, got 'best'"),
        (lambda: Limits(max_uavs=-1), "max_uavs must be >= 0, got -1"),
        (lambda: Limits(min_separation_m=math.nan), "min_separation_m must be finite and >= 0, got nan"),
        (lambda: ReplanningPolicy(metre_cost=-1), "metre_cost must be finite and >= 0, got -1"),
        (lambda: PowerRule.of("best", LINK), "scheme must be one of jpap, .*, got 'best'"),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()

"""Traffic control over time.

Oracle: distances between all aircraft at every simulated instant, measured here; the aircraft follow their setpoints
exactly, but for those that drop out, which stop dead, as no aircraft can: nothing could be harder on the others, which
need time to notice it and to brake.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from jpap_ros.fleet.traffic import TrafficControl, Traveller
from jpap_ros.fleet.transit import plan_transit
from jpap_ros.fleet.transit_plan import TransitLimits, TransitPlan

LIMITS = TransitLimits(min_separation_m=10.0, tracking_error_m=1.0)
STEP_S = 0.1
Vector = tuple[float, float, float]


class World:
    """Aircraft that fly what traffic control says."""

    def __init__(self, control: TrafficControl, places: dict[str, Vector]) -> None:
        self.control = control
        self.now = 0.0
        self.places = dict(places)
        self.goals: dict[str, Vector | None] = dict.fromkeys(places)
        self.obeys = dict.fromkeys(places, True)
        self.nearest = math.inf

    def step(self) -> None:
        fleet = {
            name: Traveller(place, self.obeys[name], True, self.goals[name], self.now)
            for name, place in self.places.items()
        }
        if isinstance(self.control._worker, LateWorker):
            self.control._worker.step()
        self.control.step(self.now, fleet)
        self.now += STEP_S
        for name in self.places:
            if self.obeys[name]:
                setpoint = self.control.setpoint(name, self.now)
                assert setpoint is not None
                self.places[name] = setpoint.position
        pairs = combinations(self.places.values(), 2)
        self.nearest = min(self.nearest, min((math.dist(a, b) for a, b in pairs), default=math.inf))

    def run(self, until: Callable[[], bool], limit_s: float = 600.0) -> bool:
        end = self.now + limit_s
        while self.now < end:
            self.step()
            if until():
                return True
        return False

    def at(self, name: str) -> bool:
        """Whether an aircraft is at its goal, has none, or does not obey."""
        goal = self.goals[name]
        return goal is None or not self.obeys[name] or math.dist(self.places[name], goal) < 1e-2

    def at_goals(self) -> bool:
        return all(self.at(name) for name in self.places)


@pytest.fixture
def control() -> Iterator[TrafficControl]:
    made = TrafficControl(LIMITS, waits_for_plans=True)
    yield made
    made.close()


def test_two_swap_places_and_keep_apart(control: TrafficControl) -> None:
    world = World(control, {"a": (0.0, 0.0, 50.0), "b": (100.0, 0.0, 50.0)})
    world.goals = {"a": (100.0, 0.0, 50.0), "b": (0.0, 0.0, 50.0)}
    assert world.run(world.at_goals)
    assert world.nearest >= 10.0
    assert control.held("a") == control.held("b") == ""


def test_a_new_goal_on_the_way_stops_the_aircraft_softly_and_leads_on(control: TrafficControl) -> None:
    world = World(control, {"a": (0.0, 0.0, 50.0), "b": (0.0, 300.0, 50.0)})
    world.goals = {"a": (400.0, 0.0, 50.0), "b": (400.0, 300.0, 50.0)}
    world.run(lambda: world.places["a"][0] > 100.0)
    other_before = world.places["b"]
    world.goals["a"] = (100.0, -200.0, 50.0)
    speeds = []
    for _ in range(30):
        before = world.places["a"]
        world.step()
        speeds.append(math.dist(before, world.places["a"]) / STEP_S)
    # The greatest acceleration is that of the limits, whatever happens.
    assert np.abs(np.diff(speeds)).max() <= LIMITS.acceleration_m_s2 * STEP_S * 1.05
    assert world.places["b"][0] - other_before[0] == pytest.approx(30 * STEP_S * LIMITS.speed_m_s, rel=1e-6), (
        "b flies on"
    )
    assert world.run(world.at_goals)


def test_a_convoy_stops_when_a_member_is_taken_over_and_then_goes_round_it(control: TrafficControl) -> None:
    world = World(control, {"a": (0.0, 0.0, 50.0), "b": (100.0, 0.0, 50.0)})
    world.goals = {"a": (100.0, 0.0, 50.0), "b": (0.0, 0.0, 50.0)}
    world.run(lambda: world.places["b"] != (100.0, 0.0, 50.0) or world.places["a"] != (0.0, 0.0, 50.0))
    world.obeys["b"] = False
    world.goals["a"] = (150.0, 0.0, 50.0)
    assert world.run(world.at_goals)
    assert world.nearest >= 10.0


def test_an_aircraft_far_from_its_setpoint_stops_its_convoy(control: TrafficControl) -> None:
    fleet = {"a": Traveller((0.0, 0.0, 50.0), True, True, (500.0, 0.0, 50.0), 0.0)}
    control.step(0.0, fleet)
    ahead = control.setpoint("a", 20.0)
    assert ahead is not None and ahead.position[0] > 50.0, "on its way"
    # 20 s later it still says it is where it was, though it should have been far ahead.
    control.step(20.0, {"a": Traveller((0.0, 0.0, 50.0), True, True, (500.0, 0.0, 50.0), 20.0)})
    stopped = control.setpoint("a", 30.0)
    assert stopped is not None
    # From cruising speed it takes v^2 / 2a to stop.
    braking_m = LIMITS.speed_m_s**2 / (2 * LIMITS.acceleration_m_s2)
    assert stopped.position[0] == pytest.approx(ahead.position[0] + braking_m, abs=1e-6)
    assert stopped.velocity == pytest.approx((0.0, 0.0, 0.0))


def test_one_that_is_late_on_a_simulated_clock_flies_on() -> None:
    """Oracle: the definition of `faster`. A fifth of a second of the machine's delay is not straying, half one is."""
    real = TransitLimits(tracking_error_m=2.0, speed_m_s=8.0, acceleration_m_s2=1.5)
    assert real.faster(1.0).lag_s == 0.0
    for late_s, flies_on in ((0.12, True), (0.5, False)):
        control = TrafficControl(real.faster(8.0))
        try:
            goal = (600.0, 0.0, 50.0)
            control.step(0.0, {"a": Traveller((0.0, 0.0, 50.0), True, True, goal, 0.0)})
            here, now = control.setpoint("a", max(4.0 - late_s, 0.0)).position, 4.0
            control.step(now, {"a": Traveller(here, True, True, goal, now)})
            speed = control.setpoint("a", now + 0.5).velocity[0]
            assert (speed > 60.0) == flies_on
        finally:
            control.close()


def test_an_aircraft_whose_goal_is_taken_away_stops_on_its_way(control: TrafficControl) -> None:
    world = World(control, {"a": (0.0, 0.0, 50.0)})
    world.goals = {"a": (400.0, 0.0, 50.0)}
    world.run(lambda: world.places["a"][0] > 100.0)
    here, world.goals["a"] = world.places["a"][0], None
    world.run(lambda: False, 30.0)
    # v^2 / 2a, and the way of the step in which it was noticed.
    braking_m = LIMITS.speed_m_s**2 / (2 * LIMITS.acceleration_m_s2)
    assert world.places["a"][0] == pytest.approx(here + braking_m, abs=LIMITS.speed_m_s * STEP_S)


def test_those_held_in_a_convoy_do_not_stop_the_others() -> None:
    # b waits for a goal above which somebody stands; a and b cross, and so share a convoy.
    control = TrafficControl(QUICK, waits_for_plans=True)
    try:
        world = World(control, {"a": (0.0, 0.0, 50.0), "b": (40.0, 40.0, 50.0), "c": (80.0, 0.0, 50.0)})
        world.goals = {"a": (40.0, 80.0, 50.0), "b": (80.0, 0.0, 50.0), "c": None}
        world.obeys["c"] = False
        assert world.run(lambda: world.at("a"), 60.0)
        assert "c" in control.held("b")
        assert world.nearest >= 10.0
    finally:
        control.close()


def test_an_obstacle_above_a_goal_holds_the_aircraft_and_says_who_it_is(control: TrafficControl) -> None:
    fleet = {
        "a": Traveller((0.0, 0.0, 50.0), True, True, (100.0, 0.0, 50.0), 0.0),
        "stranger": Traveller((100.0, 0.0, 60.0), False, True),
    }
    for step in range(20):
        control.step(step * STEP_S, fleet)
    assert "stranger" in control.held("a")
    assert control.setpoint("stranger", 1.0) is None
    # It goes on by itself when the way is free.
    for step in range(20, 60):
        control.step(step * STEP_S, {"a": fleet["a"]})
    assert control.held("a") == ""
    assert control.setpoint("a", 60.0).position != (0.0, 0.0, 50.0)  # type: ignore[union-attr]


#: Quick aircraft, so that a story is told in few steps; a drop-out is noticed in the step after the next.
QUICK = TransitLimits(10.0, 1.0, reaction_s=2 * STEP_S, speed_m_s=20.0, vertical_speed_m_s=10.0, acceleration_m_s2=10.0)
GRID = [(40.0 * i, 40.0 * j, 50.0) for i in range(5) for j in range(5)]


@pytest.mark.parametrize("dropped", ["ahead", "behind"])
def test_others_stop_short_of_one_that_drops_out_at_any_moment(dropped: str) -> None:
    # Straight ways that cross; the one behind comes by 14.1 m from the other, and over its very path 20 m later.
    for moment_s in np.arange(0.5, 12.0, 0.5):
        control = TrafficControl(QUICK, waits_for_plans=True)
        try:
            world = World(control, {"ahead": (0.0, 0.0, 50.0), "behind": (60.0, -80.0, 50.0)})
            world.goals = {"ahead": (100.0, 0.0, 50.0), "behind": (60.0, 20.0, 50.0)}
            world.run(lambda: False, moment_s)
            assert world.places["ahead"][1:] == (0.0, 50.0), "no detour"
            world.obeys[dropped] = False
            world.run(lambda: False, 8.0)
            assert world.nearest >= 10.0 - 1e-6, moment_s
        finally:
            control.close()


class LateWorker:
    """Plans as the worker does, but answers only after some more steps."""

    def __init__(self, delay_steps: int) -> None:
        self._delay_steps = delay_steps
        self._answer: tuple[Future[TransitPlan], TransitPlan] | None = None
        self._steps_left = 0
        self.answers = 0

    def submit(self, *request: Any) -> Future[TransitPlan]:
        assert self._answer is None, "one request at a time"
        self._answer, self._steps_left = (Future(), plan_transit(*request)), self._delay_steps
        return self._answer[0]

    def step(self) -> None:
        self._steps_left -= 1
        if self._answer is not None and self._steps_left <= 0:
            (future, plan), self._answer = self._answer, None
            future.set_result(plan)
            self.answers += 1

    def close(self) -> None:
        pass


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), delay_steps=st.sampled_from([0, 0, 3, 30]))
def test_nobody_comes_close_whatever_changes_when(data: st.DataObject, delay_steps: int) -> None:
    """Also where plans come late, after goals have changed and aircraft have dropped out."""
    control = TrafficControl(QUICK, waits_for_plans=not delay_steps)
    if delay_steps:
        control._worker = LateWorker(delay_steps)  # type: ignore[assignment]
    try:
        count = data.draw(st.integers(2, 7))
        names = [f"u{i}" for i in range(count)]
        starts = data.draw(st.permutations(GRID))[:count]
        world = World(control, dict(zip(names, starts, strict=True)))
        for _ in range(data.draw(st.integers(1, 4))):
            goals = data.draw(st.permutations(GRID))[:count]
            world.goals = dict(zip(names, goals, strict=True))
            if data.draw(st.booleans()):
                world.obeys[data.draw(st.sampled_from(names))] = False
            world.run(lambda: False, data.draw(st.floats(0.5, 8.0)))
        # Aircraft that stay where they dropped out may stand in the way of a goal; nobody else may be left over.
        assert world.run(lambda: all(world.at(name) or control.held(name) for name in names), 400.0)
        assert world.nearest >= 10.0 - 1e-6
    finally:
        control.close()


def test_a_late_plan_is_flown_only_by_those_whom_it_still_fits() -> None:
    # a and b exchange places, so both ask the worker; before it answers, c has begun to fly through between them.
    control = TrafficControl(QUICK)
    control._worker = late = LateWorker(5)  # type: ignore[assignment]
    world = World(control, {"a": (0.0, 0.0, 50.0), "b": (80.0, 0.0, 50.0), "c": (40.0, 60.0, 62.0)})
    world.goals = {"a": (80.0, 0.0, 50.0), "b": (0.0, 0.0, 50.0), "c": None}
    world.run(lambda: False, 3 * STEP_S)
    assert late.answers == 0
    assert world.places["a"] == (0.0, 0.0, 50.0)
    world.goals["c"] = (40.0, -60.0, 62.0)
    world.run(lambda: False, 2 * STEP_S)
    assert world.places["c"] != (40.0, 60.0, 62.0), "straight flights do not wait for the worker"
    assert world.run(world.at_goals, 60.0)
    assert late.answers >= 2
    assert world.nearest >= 10.0


def test_one_that_hovers_a_hair_from_its_goal_holds_up_nobody(control: TrafficControl) -> None:
    # A tenth of a millimetre off is at the goal; the other's transition must be flown all the same.
    world = World(control, {"a": (0.0, 0.0, 50.0001), "b": (100.0, 0.0, 50.0)})
    world.goals = {"a": (0.0, 0.0, 50.0), "b": (100.0, 40.0, 50.0)}
    assert world.run(world.at_goals, limit_s=60.0)


#: As ArduPilot: how long it keeps the velocity of its last target, braking included [s].
RUNS_ON_S = 4.6
SILENT_AFTER_S = 4.0


class Silence:
    """An aircraft whose link is lost at a moment: what it does is told here, not asked of traffic control."""

    def __init__(self, world: World, name: str, deaf: bool) -> None:
        self.world, self.name, self.deaf = world, name, deaf
        self.since, self.last_heard = world.now, world.places[name]
        self.velocity, self.left_m = (0.0, 0.0, 0.0), 0.0

    def step(self) -> None:
        """As World.step, with this one unheard, and lost after the time-out; then it runs on, not past its leg."""
        world, name = self.world, self.name
        lost = world.now - self.since > SILENT_AFTER_S
        fleet = {
            other: Traveller(place, True, True, world.goals[other], world.now) for other, place in world.places.items()
        }
        fleet[name] = Traveller(
            self.last_heard, not lost, True, world.goals[name], self.since, heard=not lost, runs_on_s=RUNS_ON_S
        )
        world.control.step(world.now, fleet)
        world.now += STEP_S
        for other in world.places:
            setpoint = world.control.setpoint(other, world.now)
            if other != name:
                assert setpoint is not None
                world.places[other] = setpoint.position
            elif setpoint is None or (self.deaf and world.now > self.since + STEP_S):
                speed = math.hypot(*self.velocity)
                share = 0.0 if speed == 0.0 else min(speed * STEP_S, self.left_m) / speed
                x, y, z = (p + share * v for p, v in zip(world.places[name], self.velocity, strict=True))
                world.places[name], self.left_m = (x, y, z), self.left_m - share * speed
            else:
                self.velocity = setpoint.velocity
                self.left_m = min(math.hypot(*self.velocity) * RUNS_ON_S, setpoint.ahead_m)
                world.places[name] = setpoint.position
        pairs = combinations(world.places.values(), 2)
        world.nearest = min([world.nearest, *(math.dist(a, b) for a, b in pairs)])


@pytest.mark.parametrize("deaf", [True, False])
@pytest.mark.parametrize("moment_s", [1.0, 6.0, 11.0, 16.0])
def test_one_that_falls_silent_on_its_way_is_kept_clear_of_wherever_it_runs_on_to(deaf: bool, moment_s: float) -> None:
    limits = TransitLimits(min_separation_m=10.0, tracking_error_m=1.0, speed_m_s=8.0, acceleration_m_s2=1.5)
    control = TrafficControl(limits, waits_for_plans=True)
    try:
        world = World(control, {"silent": (0.0, 0.0, 50.0), "other": (110.0, 60.0, 50.0), "third": (60.0, -60.0, 50.0)})
        world.goals = {"silent": (300.0, 0.0, 50.0), "other": None, "third": None}
        world.run(lambda: False, moment_s)
        silence = Silence(world, "silent", deaf)
        while world.now < moment_s + SILENT_AFTER_S + 0.5:
            silence.step()
        line = control.lost("silent")
        assert line[0] == pytest.approx(silence.last_heard, abs=limits.speed_m_s * STEP_S)
        # Others are sent to places ahead of it, where it would be run into if it were thought to have stopped.
        ahead = world.places["silent"][0]
        world.goals["other"] = (ahead + 25.0, 0.0, 50.0)
        world.goals["third"] = (ahead - 20.0, 60.0, 50.0)
        while world.now < moment_s + 60.0:
            silence.step()
        assert line[0][0] - 1.0 <= world.places["silent"][0] <= line[-1][0] + 1e-6, "it is on the line that is closed"
        assert world.nearest >= 10.0 - 1e-6
        # Heard again, it is where it says, and the rest of the line is free.
        world.step()
        world.step()
        assert control.lost("silent") == ()
    finally:
        control.close()


def test_one_that_was_told_to_stop_and_hears_nothing_is_expected_on_the_way_it_was_on(control: TrafficControl) -> None:
    world = World(control, {"a": (0.0, 0.0, 50.0)})
    world.goals = {"a": (400.0, 0.0, 50.0)}
    world.run(lambda: world.places["a"][0] > 100.0)
    silence = Silence(world, "a", deaf=True)
    world.goals["a"] = (100.0, 200.0, 50.0)
    while world.now - silence.since < SILENT_AFTER_S + 0.5:
        silence.step()
    line = np.array(control.lost("a"))
    # Deaf, it flies on eastwards at cruising speed, whatever it has been told since.
    assert line[:, 0].max() >= silence.last_heard[0] + LIMITS.speed_m_s * RUNS_ON_S


def test_a_pilots_aircraft_is_where_it_says(control: TrafficControl) -> None:
    world = World(control, {"a": (0.0, 0.0, 50.0), "b": (200.0, 0.0, 50.0)})
    world.goals = {"a": (400.0, 0.0, 80.0), "b": None}
    world.run(lambda: world.places["a"][0] > 50.0)
    world.obeys["a"] = False
    world.step()
    assert control.lost("a") == ()


def test_who_was_left_on_a_line_by_somebody_else_keeps_others_off_it(control: TrafficControl) -> None:
    left = Traveller((0.0, 0.0, 50.0), False, True, heard=False, way=((100.0, 0.0, 50.0),))
    fleet = {"left": left, "a": Traveller((60.0, 60.0, 50.0), True, True, (60.0, 0.0, 50.0), 0.0)}
    for step in range(20):
        control.step(step * STEP_S, fleet)
    assert "left" in control.held("a")


def test_an_aircraft_on_its_way_up_stops_when_a_pilot_takes_over_the_one_above_it() -> None:
    control = TrafficControl(LIMITS, waits_for_plans=True)
    try:
        low, high = Traveller((0, 0, 50), True, True, (0, 0, 110)), Traveller((0, 0, 122), True, True)
        control.step(0.0, {"low": low, "high": high})
        start = control.setpoint("low", 4.0)
        assert start.velocity[2] > 0
        taken = replace(high, obeys=False)
        for moment in np.arange(4.0, 60.0, 0.5):
            place = control.setpoint("low", moment).position
            control.step(moment, {"low": replace(low, position=place, heard_at=moment), "high": taken})
        assert control.setpoint("low", 60.0).position[2] <= 122 - LIMITS.min_separation_m - 5.0
    finally:
        control.close()

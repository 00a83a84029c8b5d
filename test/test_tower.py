"""Take-offs and landings in turn, in a world in which aircraft climb and land by themselves at speeds of their own.

Oracle: distances between all aircraft in the air, measured here at every step; the column rules and the waves are the
product's, the climbing, flying and descending are this file's. Small cases are worked out by hand.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from jpap_ros.fleet.tower import Tower, Turn
from jpap_ros.fleet.traffic import TrafficControl, Traveller, Vector
from jpap_ros.fleet.transit_plan import TransitLimits

LIMITS = TransitLimits(min_separation_m=10.0, tracking_error_m=2.0, speed_m_s=8.0)
#: Planned separation 10 + 2 * 2 m, and 1 m for climbs that end early.
LAYER_M = 15.0
TAKEOFF_M = 10.0
STEP_S = 0.2
ON_GROUND, CLIMBS, FLIES, COMES_HOME, LANDS, LANDED = range(6)


class Plane:
    """One aircraft that does in time what it is told."""

    def __init__(self, pad: Vector, goal: Vector | None, speed: float) -> None:
        self.pad, self.goal, self.speed = pad, goal, speed
        self.place = pad
        self.doing = ON_GROUND
        self.turn: Turn | None = None

    @property
    def flies(self) -> bool:
        return self.doing not in (ON_GROUND, LANDED)

    @property
    def obeys(self) -> bool:
        return self.doing in (FLIES, COMES_HOME)


class Aerodrome:
    """Pads, planes, and the least distance between any two in the air."""

    def __init__(self, traffic: TrafficControl, planes: dict[str, Plane]) -> None:
        self.traffic, self.planes = traffic, planes
        self.tower = Tower(traffic, TAKEOFF_M, LIMITS.max_altitude_m)
        self.now = 0.0
        self.least_m = math.inf

    def launch(self) -> None:
        turns = self.tower.departures({name: plane.pad for name, plane in self.planes.items()})
        for name, plane in self.planes.items():
            plane.turn = turns[name]

    def recall(self) -> None:
        flying = {name: plane for name, plane in self.planes.items() if plane.doing == FLIES}
        for name, turn in self.tower.arrivals({n: (plane.place, plane.pad) for n, plane in flying.items()}).items():
            flying[name].turn, flying[name].doing = turn, COMES_HOME

    def run(self, state: int, limit_s: float) -> bool:
        """Let time pass until all are in a state; False if they are not by then."""
        end = self.now + limit_s
        while self.now < end and any(plane.doing != state for plane in self.planes.values()):
            self.step()
        return all(plane.doing == state for plane in self.planes.values())

    def step(self) -> None:
        fleet = {}
        for name, plane in self.planes.items():
            goal = plane.goal
            if plane.doing == COMES_HOME:
                goal = self.tower.waiting_place(plane.turn)
            fleet[name] = Traveller(plane.place, plane.obeys, plane.flies, goal, self.now)
        self.traffic.step(self.now, fleet)
        self.now += STEP_S
        for name, plane in self.planes.items():
            self._act(name, plane)
        aloft = [plane.place for plane in self.planes.values() if plane.flies]
        for a, b in combinations(aloft, 2):
            self.least_m = min(self.least_m, math.dist(a, b))

    def _act(self, name: str, plane: Plane) -> None:
        east, north, up = plane.place
        if plane.doing == ON_GROUND and plane.turn and self.tower.may_climb(plane.turn, self.now) is None:
            plane.doing = CLIMBS
        elif plane.doing == CLIMBS:
            plane.place = east, north, min(up + plane.speed * STEP_S, plane.turn.altitude_m)
            if plane.place[2] == plane.turn.altitude_m:
                plane.doing = FLIES
                self.tower.leave(plane.turn)
        elif plane.doing in (FLIES, COMES_HOME):
            setpoint = self.traffic.setpoint(name, self.now)
            plane.place = setpoint.position if setpoint else plane.place
            at_place = plane.doing == COMES_HOME and plane.place == self.tower.waiting_place(plane.turn)
            if at_place and self.tower.may_land(plane.turn, plane.place, self.now) is None:
                plane.doing = LANDS
        elif plane.doing == LANDS:
            plane.place = east, north, max(up - plane.speed * STEP_S, plane.pad[2])
            if plane.place[2] == plane.pad[2]:
                plane.doing = LANDED
                self.tower.leave(plane.turn)


@pytest.fixture
def traffic() -> Iterator[TrafficControl]:
    made = TrafficControl(LIMITS, waits_for_plans=True)
    yield made
    made.close()


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(2, 7), side=st.sampled_from([15.0, 30.0, 80.0]))
def test_a_fleet_on_pads_close_together_takes_off_and_comes_home_apart(seed: int, count: int, side: float) -> None:
    rng = np.random.default_rng(seed)
    traffic = TrafficControl(LIMITS, waits_for_plans=True)
    try:
        planes = {}
        for i in range(count):
            pad = (*rng.uniform(0, side, 2).tolist(), 0.0)
            # Some have no goal, and hover where their climb ends; the others' goals are 100 m apart, far from the pads.
            goal = (200.0 + 100.0 * i, float(rng.uniform(-200, 200)), 50.0) if rng.uniform() < 0.7 else None
            planes[f"uav{i}"] = Plane(pad, goal, rng.uniform(1.5, 4.0))
        field = Aerodrome(traffic, planes)
        field.launch()
        assert field.run(FLIES, 600.0), {name: plane.doing for name, plane in planes.items()}
        for _ in range(int(rng.integers(0, 200))):
            field.step()
        field.recall()
        assert field.run(LANDED, 1200.0), {name: (plane.doing, plane.place) for name, plane in planes.items()}
        assert all(math.dist(plane.place, plane.pad) < 1e-6 for plane in planes.values())
        assert field.least_m >= LIMITS.planned_separation_m - 1e-3
    finally:
        traffic.close()


def test_one_that_gives_up_lets_the_next_one_climb(traffic: TrafficControl) -> None:
    tower = Tower(traffic, TAKEOFF_M, LIMITS.max_altitude_m)
    traffic.step(0.0, {})
    turns = tower.departures({"a": (0.0, 0.0, 0.0), "b": (10.0, 0.0, 0.0)})
    assert (turns["a"].altitude_m, turns["b"].altitude_m) == (TAKEOFF_M + LAYER_M, TAKEOFF_M)
    hindrance = tower.may_climb(turns["b"], 0.0)
    assert hindrance is not None and hindrance.words == "a climbs first" and hindrance.passes
    assert tower.may_climb(turns["a"], 0.0) is None
    tower.leave(turns["a"])
    # Until a step shows what became of a, its column stays closed.
    hindrance = tower.may_climb(turns["b"], 0.0)
    assert hindrance is not None and hindrance.words == "a is in the column"
    traffic.step(0.1, {"a": Traveller((0.0, 0.0, 0.0), obeys=False, flies=False)})
    assert tower.may_climb(turns["b"], 0.1) is None


def test_one_that_hangs_in_the_air_keeps_its_neighbour_on_the_ground_and_is_named(traffic: TrafficControl) -> None:
    tower = Tower(traffic, TAKEOFF_M, LIMITS.max_altitude_m)
    stuck = Traveller((0.0, 0.0, 3.0), obeys=False, flies=True)
    traffic.step(0.0, {"a": stuck})
    turns = tower.departures({"b": (10.0, 0.0, 0.0), "c": (60.0, 0.0, 0.0)})
    hindrance = tower.may_climb(turns["b"], 0.0)
    assert hindrance is not None and hindrance.words == "a is in the column" and not hindrance.passes
    assert tower.may_climb(turns["c"], 0.0) is None


def test_those_apart_land_at_once_and_one_above_another_waits(traffic: TrafficControl) -> None:
    tower = Tower(traffic, TAKEOFF_M, LIMITS.max_altitude_m)
    # a and b are 12 m apart, which is less than planned but as near as they are now; c is above a.
    places = {"a": (0.0, 0.0, 30.0), "b": (12.0, 0.0, 30.0), "c": (0.0, 0.0, 50.0)}
    hovering = {name: Traveller(place, obeys=True, flies=True) for name, place in places.items()}
    traffic.step(0.0, hovering)
    turns = {name: tower.landing(name, (*place[:2], 0.0)) for name, place in places.items()}
    hindrance = tower.may_land(turns["c"], places["c"], 0.0)
    assert hindrance is not None and hindrance.words == "a is in the column"
    # a lands in bounded time, or gives up.
    assert hindrance.passes
    assert tower.may_land(turns["a"], places["a"], 0.0) is None
    assert tower.may_land(turns["b"], places["b"], 0.0) is None
    for name in ("a", "b"):
        tower.leave(turns[name])
        hovering[name] = Traveller((*places[name][:2], 0.0), obeys=False, flies=False)
    traffic.step(0.1, hovering)
    assert tower.may_land(turns["c"], places["c"], 0.1) is None


def test_nobody_flies_through_a_column_that_is_in_use(traffic: TrafficControl) -> None:
    # The straight way from (-100, 0, 20) to (100, 0, 20) leads over the pad, below the height of the climb.
    planes = {
        "climber": Plane((0.0, 0.0, 0.0), None, 0.2),
        "passer": Plane((-100.0, 0.0, 20.0), (100.0, 0.0, 20.0), 2.0),
    }
    planes["passer"].doing = FLIES
    field = Aerodrome(traffic, planes)
    field.step()
    planes["passer"].goal = (100.0, 0.0, 20.0)
    planes["climber"].turn = field.tower.departures({"climber": (0.0, 0.0, 0.0)})["climber"]
    while planes["passer"].place != (100.0, 0.0, 20.0):
        assert field.now < 200.0
        field.step()
    assert field.least_m >= LIMITS.planned_separation_m - 1e-6

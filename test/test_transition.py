"""A transition under way, and its message.

Oracles: distances sampled densely in time here, kinematics by hand, and the round trip through the real message type.
"""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import pytest
from jpap_msgs.msg import Convoy as ConvoyMessage
from jpap_msgs.msg import Transition as TransitionMessage
from std_msgs.msg import Header

from jpap_ros.fleet.time_law import TimeLaw
from jpap_ros.fleet.transit import plan_transit
from jpap_ros.fleet.transit_plan import Convoy, TransitLimits, TransitPlan
from jpap_ros.mavlink.transition import Transition
from jpap_ros.nodes.transition_conversions import transit_plan, transition_message

LIMITS = TransitLimits(min_separation_m=10.0, tracking_error_m=1.0)
#: Two that swap places and one that stays out of it.
STARTS = {"a": (0.0, 0.0, 50.0), "b": (100.0, 0.0, 50.0), "c": (0.0, 500.0, 50.0)}
GOALS = {"a": (100.0, 0.0, 50.0), "b": (0.0, 0.0, 50.0), "c": (0.0, 600.0, 50.0)}


def least_distance(transition: Transition, names: str, start: float, end: float) -> float:
    times = np.linspace(start, end, 2001)
    paths = {name: np.array([transition.point(name, t).position_m for t in times]) for name in names}
    return min(float(np.linalg.norm(paths[a] - paths[b], axis=1).min()) for a, b in combinations(names, 2))


def test_setpoints_begin_at_the_starts_and_end_at_the_goals() -> None:
    plan = plan_transit(STARTS, GOALS, LIMITS)
    transition = Transition(plan, 7, started=100.0)
    for name, start in STARTS.items():
        first = transition.point(name, 100.0)
        last = transition.point(name, 100.0 + plan.duration_s)
        assert first.position_m == pytest.approx(start)
        assert last.position_m == pytest.approx(GOALS[name])
        assert last.velocity_m_s == pytest.approx((0.0, 0.0, 0.0))
        assert last.arrived
        assert not first.arrived
    assert least_distance(transition, "abc", 100.0, 100.0 + plan.duration_s) >= 10.0


def test_velocity_is_the_slope_of_the_position() -> None:
    plan = plan_transit(STARTS, GOALS, LIMITS)
    transition = Transition(plan, 7, started=0.0)
    step = 1e-4
    for time_s in np.linspace(0.1, plan.duration_s - 0.1, 37):
        for name in STARTS:
            before, after = transition.point(name, time_s - step), transition.point(name, time_s + step)
            slope = (np.array(after.position_m) - before.position_m) / (2 * step)
            # Where a phase of the motion ends within the step, the slope is between the two velocities.
            assert transition.point(name, time_s).velocity_m_s == pytest.approx(tuple(slope), abs=1e-2)


def test_a_convoy_brakes_together_when_a_member_drops_out_and_the_others_fly_on() -> None:
    # a and b share a convoy of one leg of 100 m at 5 m/s with 2.5 m/s^2: after 10 s they have flown
    # 5 m (speeding up for 2 s) + 40 m, and they stop after another v^2 / 2a = 5 m.
    law = TimeLaw(speed=0.05, acceleration=0.025)
    pair = Convoy(("a", "b"), np.array([[[0, 0, 50], [0, 40, 50]], [[100, 0, 50], [100, 40, 50]]], float), (law,))
    lone = Convoy(("c",), np.array([[[0, 500, 50]], [[0, 600, 50]]], float), (law,))
    transition = Transition(TransitPlan((pair, lone)), 7, started=0.0)
    transition.watch(lambda name: True, 9.0)
    assert transition.point("a", 10.0).position_m == pytest.approx((45.0, 0.0, 50.0))

    transition.watch(lambda name: name != "b", 10.0)

    assert "b dropped out" in transition.stopped("a")
    assert transition.stopped("c") == ""
    assert transition.point("a", 10.0).velocity_m_s == pytest.approx((5.0, 0.0, 0.0)), "no jump"
    assert transition.point("a", 100.0).position_m == pytest.approx((50.0, 0.0, 50.0))
    assert transition.point("a", 100.0).arrived
    assert transition.point("c", 100.0).position_m == pytest.approx((0.0, 600.0, 50.0))


def test_a_plan_survives_its_message() -> None:
    plan = plan_transit(STARTS, GOALS, LIMITS)
    message = transition_message(plan, Header(frame_id="map"), 7, 1, 10.0)
    again = transit_plan(message)
    assert (message.plan_id, message.number, message.min_separation_m) == (7, 1, 10.0)
    assert set(again.names) == set(plan.names)
    for time_s in np.linspace(0.0, plan.duration_s, 50):
        for name in plan.names:
            assert again.position(name, time_s) == pytest.approx(plan.position(name, time_s))


def convoy(**changes: object) -> ConvoyMessage:
    plan = TransitPlan((Convoy(("a",), np.array([[[0, 0, 50]], [[9, 0, 50]]], float), (TimeLaw(0.5, 0.25),)),))
    message = transition_message(plan, Header(), 1, 1, 10.0).convoys[0]
    for name, value in changes.items():
        setattr(message, name, value)
    return message


@pytest.mark.parametrize(
    ("bad", "says"),
    [
        ({"uavs": []}, "uavs is empty"),
        ({"uavs": ["a", "b"]}, "waypoints must have 4 points"),
        ({"speed": [0.5, 0.5]}, "one value for each leg"),
        ({"speed": [0.0]}, "impossible time law"),
        ({"acceleration": [math.nan]}, "impossible time law"),
        ({"initial_speed": [-1.0]}, "impossible time law"),
    ],
)
def test_a_message_that_cannot_be_flown_is_refused_in_words(bad: dict[str, object], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        transit_plan(TransitionMessage(convoys=[convoy(**bad)]))


def test_waypoints_that_are_not_finite_and_aircraft_named_twice_are_refused() -> None:
    broken = convoy()
    broken.waypoints[0].x = math.inf
    with pytest.raises(ValueError, match="finite"):
        transit_plan(TransitionMessage(convoys=[broken]))
    with pytest.raises(ValueError, match="twice"):
        transit_plan(TransitionMessage(convoys=[convoy(), convoy()]))

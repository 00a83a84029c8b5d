"""The life of a goal and the joining of goals with plans. Oracle: the state chart of DESIGN.md, followed by hand."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jpap_ros.mavlink.goals import Goal, GoalLife, GoalState
from jpap_ros.mavlink.vehicle import TargetEcho
from jpap_ros.nodes.goal_book import GoalBook

TARGET = (-378136000, 1449631000)


def echo(lat_e7: int, lon_e7: int) -> TargetEcho:
    return TargetEcho(lat_e7, lon_e7, 50.0, 5, 0.0)


def sent(distance_m: float = 100.0) -> GoalLife:
    life = GoalLife(arrival_radius_m=1.0)
    life.sent(TARGET, 10.0)
    life.moved(distance_m)
    return life


def test_the_good_life() -> None:
    life = GoalLife(arrival_radius_m=1.0)
    states = [life.state]
    life.sent(TARGET, 10.0)
    life.moved(100.0)
    states.append(life.state)
    life.echoed(echo(*TARGET))
    states.append(life.state)
    life.moved(99.0)
    states.append(life.state)
    life.moved(0.9)
    states.append(life.state)
    assert states == [GoalState.NONE, GoalState.SENT, GoalState.ACCEPTED, GoalState.EN_ROUTE, GoalState.REACHED]
    assert life.distance_m == 0.9


@pytest.mark.parametrize("off", [(2, 0), (0, -2), (2, 2)])
def test_an_echo_within_two_units_is_the_target(off: tuple[int, int]) -> None:
    life = sent()
    life.echoed(echo(TARGET[0] + off[0], TARGET[1] + off[1]))
    assert life.state is GoalState.ACCEPTED


def test_an_answer_alone_is_no_flight() -> None:
    """PX4 acknowledges a DO_REPOSITION outside its fence, and stays."""
    life = sent()
    life.answered(12.0)
    assert life.state is GoalState.ACCEPTED
    life.tick(16.9, "")
    assert life.state is GoalState.ACCEPTED
    life.tick(17.1, "Reposition is outside geofence")
    assert life.state is GoalState.REJECTED
    assert "accepted but has not been flown" in life.reason and life.reason.endswith("outside geofence")


def test_an_answer_and_a_flight_are_enough() -> None:
    life = sent()
    life.answered(12.0)
    life.moved(99.0)
    life.tick(30.0, "")
    assert life.state is GoalState.EN_ROUTE
    echoed = sent()
    echoed.answered(12.0)
    echoed.echoed(echo(*TARGET))
    echoed.tick(30.0, "")
    assert echoed.state is GoalState.ACCEPTED


def test_an_echo_of_another_target_is_no_acceptance_and_is_told() -> None:
    life = sent()
    life.echoed(echo(TARGET[0] + 3, TARGET[1]))
    assert life.state is GoalState.SENT
    life.tick(14.9, "")
    assert life.state is GoalState.SENT
    life.tick(15.1, "Fence: target outside")
    assert life.state is GoalState.REJECTED
    assert "keeps another target" in life.reason and "-37.8135997" in life.reason
    assert life.reason.endswith("Fence: target outside")


def test_no_sign_of_obeying_is_rejection_until_there_is_one() -> None:
    life = sent()
    life.sent(TARGET, 14.0)  # a repetition does not start the time anew
    life.tick(15.1, "")
    assert life.state is GoalState.REJECTED and "no sign of obeying" in life.reason
    life.echoed(echo(*TARGET))
    assert (life.state, life.reason) == (GoalState.ACCEPTED, "")


def test_progress_counts_where_nothing_is_echoed() -> None:
    life = sent()
    life.moved(99.6)
    assert life.state is GoalState.SENT
    life.moved(99.4)
    assert life.state is GoalState.EN_ROUTE


def test_reached_does_not_flicker_in_wind() -> None:
    life = sent()
    life.moved(0.5)
    life.moved(1.9)
    assert life.state is GoalState.REACHED
    life.moved(2.1)
    assert life.state is GoalState.EN_ROUTE
    life.moved(1.5)
    assert life.state is GoalState.EN_ROUTE
    life.moved(1.0)
    assert life.state is GoalState.REACHED


def test_a_new_target_begins_a_new_life() -> None:
    life = sent()
    life.moved(0.5)
    life.sent((TARGET[0] + 1000, TARGET[1]), 20.0)
    assert life.state is GoalState.SENT
    life.echoed(echo(*TARGET))  # late echo of the former target
    assert life.state is GoalState.SENT


@pytest.mark.parametrize("state", [GoalState.NONE, GoalState.REJECTED, GoalState.YIELDED, GoalState.LOST])
def test_set_aside_stays_until_sent_again(state: GoalState) -> None:
    life = sent()
    life.set_aside(state, "because")
    life.echoed(echo(*TARGET))
    life.moved(0.1)
    life.acknowledged()
    life.refused("no")
    life.tick(100.0, "")
    assert (life.state, life.reason) == (state, "because")
    life.sent(TARGET, 200.0)
    assert (life.state, life.reason) == (GoalState.SENT, "")


@pytest.mark.parametrize("state", [GoalState.SENT, GoalState.ACCEPTED, GoalState.EN_ROUTE, GoalState.REACHED])
def test_what_is_observed_cannot_be_set(state: GoalState) -> None:
    with pytest.raises(ValueError, match=state.name):
        GoalLife().set_aside(state, "")


def test_a_refusal_by_command_ack() -> None:
    life = sent()
    life.refused("reposition: denied")
    assert (life.state, life.reason) == (GoalState.REJECTED, "reposition: denied")


@given(st.lists(st.floats(0.0, 200.0), min_size=1, max_size=30))
def test_reached_is_never_said_beyond_the_departure_radius(distances: list[float]) -> None:
    life = sent()
    for distance in distances:
        life.moved(distance)
        assert life.state is not GoalState.REACHED or distance <= 2.0
        assert life.state is GoalState.REACHED or distance > 1.0


A, B, C = (100, 0), (100, 1), (101, 0)


class TestGoalBook:
    def test_goal_and_deployment_in_either_order(self) -> None:
        for goal_first in (True, False):
            book = GoalBook()
            if goal_first:
                book.put_goal("u", A, Goal(1, 2, 3))
                entry = book.entry("u")
                assert entry is not None and entry.goal == Goal(1, 2, 3)
                book.put_plan(A, 7, ["u"])
            else:
                book.put_plan(A, 7, ["u"])
                assert book.entry("u") is None
                book.put_goal("u", A, Goal(1, 2, 3))
            entry = book.entry("u")
            assert entry is not None and entry.goal == Goal(1, 2, 3, plan_id=7)

    def test_no_cell_in_a_newer_plan_withdraws_the_goal(self) -> None:
        book = GoalBook()
        book.put_goal("u", A, Goal(1, 2, 3))
        book.put_plan(B, 8, ["other"])
        entry = book.entry("u")
        assert entry is not None and entry.goal is None and entry.reason == "no cell in plan 8"

    def test_an_old_goal_stays_with_its_plan_until_the_new_one_comes(self) -> None:
        book = GoalBook()
        book.put_plan(A, 7, ["u"])
        book.put_goal("u", A, Goal(1, 2, 3))
        book.entry("u")
        book.put_plan(C, 8, ["u"])
        entry = book.entry("u")
        assert entry is not None and entry.goal == Goal(1, 2, 3, plan_id=7)
        book.put_goal("u", C, Goal(4, 5, 6))
        entry = book.entry("u")
        assert entry is not None and entry.goal == Goal(4, 5, 6, plan_id=8)

    def test_a_goal_newer_than_the_plan_is_flown_at_once(self) -> None:
        book = GoalBook()
        book.put_plan(A, 7, ["other"])
        book.put_goal("u", B, Goal(1, 2, 3))
        entry = book.entry("u")
        assert entry is not None and entry.goal == Goal(1, 2, 3, plan_id=0)

    def test_a_dropped_goal_is_forgotten(self) -> None:
        book = GoalBook()
        book.put_goal("u", A, Goal(1, 2, 3))
        book.drop_goal("u")
        assert book.entry("u") is None


def test_goals_at_the_same_place_whatever_the_plan() -> None:
    assert Goal(1, 2, 3, plan_id=1).same_place(Goal(1, 2, 3, plan_id=2))
    assert not Goal(1, 2, 3).same_place(Goal(1, 2, 3, yaw=0.0))
    assert not Goal(1, 2, 3).same_place(None)

"""The command protocol. Oracle: https://mavlink.io/en/services/command.html, followed by hand on a fake clock."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.mavlink.commands import ORDER_ATTEMPTS, Command, CommandChannel, Pending

OWN = (245, 191)
VEHICLE = (7, 1)
ARM = Command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (1.0,), "arm")
MODE = Command(mavlink.MAV_CMD_DO_SET_MODE, (1.0, 4.0), "mode GUIDED", idempotent=True)


class Rig:
    """A channel with a fake clock and wire."""

    def __init__(self) -> None:
        self.wire: list[Any] = []
        self.channel = CommandChannel(self.wire.append, OWN, VEHICLE)

    def ack(
        self,
        command: Command,
        result: int,
        now: float,
        source: tuple[int, int] = VEHICLE,
        target: tuple[int, int] = OWN,
    ) -> None:
        message = mavlink.MAVLink_command_ack_message(command.id, result, 0, 0, *target)
        self.channel.hear(message, source, now)

    def run(self, until: float, start: float = 0.0) -> None:
        for tenth in range(round(start * 10), round(until * 10) + 1):
            self.channel.tick(tenth / 10)


@pytest.fixture
def rig() -> Rig:
    return Rig()


def ended(pending: Pending, accepted: bool, words: str = "") -> bool:
    outcome = pending.outcome
    return outcome is not None and outcome.accepted is accepted and words in outcome.reason


def test_an_accepted_command_is_sent_once(rig: Rig) -> None:
    pending = rig.channel.start(MODE, 0.0)
    rig.ack(MODE, mavlink.MAV_RESULT_ACCEPTED, 0.5)
    rig.run(10.0)
    assert ended(pending, True)
    assert len(rig.wire) == 1
    sent = rig.wire[0]
    assert (sent.target_system, sent.target_component, sent.command) == (7, 1, 176)
    assert [sent.param1, sent.param2, sent.param3, sent.confirmation] == [1.0, 4.0, 0.0, 0]


def test_a_harmless_command_is_repeated_with_confirmation_raised_then_given_up(rig: Rig) -> None:
    pending = rig.channel.start(MODE, 0.0)
    rig.run(20.0)
    assert [m.confirmation for m in rig.wire] == [0, 1, 2]
    assert ended(pending, False, "no answer")
    assert rig.channel.unanswered_in_row == 1


def test_an_order_is_repeated_more_often(rig: Rig) -> None:
    pending = rig.channel.start(replace(MODE, attempts=ORDER_ATTEMPTS), 0.0)
    rig.run(20.0)
    assert [m.confirmation for m in rig.wire] == list(range(8))
    assert ended(pending, False, "no answer")


class TestInsistence:
    """What must not be done late or twice. Oracle: PROMPT_S (10 s) and ANSWER_TIMEOUT_S (1 s), by hand."""

    def test_it_is_sent_again_each_second_while_it_is_certainly_not_done_but_not_late(self, rig: Rig) -> None:
        sent_at: list[float] = []
        pending = rig.channel.start(ARM, 0.0, lambda at: bool(sent_at.append(at)))
        rig.run(60.0)
        assert [m.confirmation for m in rig.wire] == list(range(10))
        assert sent_at == list(range(9)), "asked about the last time it was sent, the last one at 9 s"
        assert ended(pending, False, "no answer")
        assert rig.channel.unanswered_in_row == 1

    def test_it_is_not_sent_again_once_it_shows(self, rig: Rig) -> None:
        pending = rig.channel.start(ARM, 0.0, lambda at: True)
        rig.run(60.0)
        assert len(rig.wire) == 1 and ended(pending, False, "no answer")

    def test_it_is_not_sent_again_while_nobody_knows(self, rig: Rig) -> None:
        known: dict[float, bool] = {}
        pending = rig.channel.start(ARM, 0.0, known.get)
        rig.run(5.0)
        assert len(rig.wire) == 1 and pending.outcome is None
        known[0.0] = False
        rig.run(5.1, start=5.1)
        assert len(rig.wire) == 2
        rig.run(60.0, start=5.2)
        assert len(rig.wire) == 2 and ended(pending, False, "no answer")

    @pytest.mark.parametrize("result", [mavlink.MAV_RESULT_FAILED, mavlink.MAV_RESULT_TEMPORARILY_REJECTED])
    def test_no_is_an_answer(self, rig: Rig, result: int) -> None:
        pending = rig.channel.start(ARM, 0.0, lambda at: False)
        rig.ack(ARM, result, 0.1)
        rig.run(60.0)
        assert len(rig.wire) == 1 and ended(pending, False)

    def test_cancelled_it_is_over(self, rig: Rig) -> None:
        rig.channel.start(ARM, 0.0, lambda at: False)
        rig.run(1.5)
        rig.channel.cancel("link lost")
        rig.run(60.0, start=1.6)
        assert len(rig.wire) == 2


def test_what_nobody_waits_for_any_more_is_withdrawn_and_another_of_its_kind_is_not(rig: Rig) -> None:
    first = rig.channel.start(MODE, 0.0)
    rig.channel.withdraw(first)
    rig.run(5.0)
    assert len(rig.wire) == 1 and ended(first, False, "withdrawn")
    second = rig.channel.start(MODE, 5.0)
    rig.channel.withdraw(first)
    rig.run(7.5, start=5.1)
    assert second.outcome is None and len(rig.wire) == 4


@pytest.mark.parametrize("result", [None, mavlink.MAV_RESULT_TEMPORARILY_REJECTED])
def test_arming_is_never_repeated(rig: Rig, result: int | None) -> None:
    pending = rig.channel.start(ARM, 0.0)
    if result is not None:
        rig.ack(ARM, result, 0.1)
    rig.run(60.0)
    assert len(rig.wire) == 1
    assert ended(pending, False)


def test_an_answer_after_the_end_changes_nothing(rig: Rig) -> None:
    pending = rig.channel.start(ARM, 0.0)
    rig.run(10.0)
    rig.ack(ARM, mavlink.MAV_RESULT_ACCEPTED, 10.1)
    assert ended(pending, False, "no answer")


def test_in_progress_extends_the_wait_and_stops_the_repeating(rig: Rig) -> None:
    pending = rig.channel.start(MODE, 0.0)
    rig.ack(MODE, mavlink.MAV_RESULT_IN_PROGRESS, 0.5)
    rig.run(9.0)
    assert pending.outcome is None
    rig.ack(MODE, mavlink.MAV_RESULT_IN_PROGRESS, 9.0)
    rig.run(18.0, start=9.0)
    assert pending.outcome is None
    rig.ack(MODE, mavlink.MAV_RESULT_ACCEPTED, 18.0)
    assert ended(pending, True)
    assert len(rig.wire) == 1


def test_in_progress_and_then_silence_ends(rig: Rig) -> None:
    pending = rig.channel.start(ARM, 0.0)
    rig.ack(ARM, mavlink.MAV_RESULT_IN_PROGRESS, 0.5)
    rig.run(11.0)
    assert ended(pending, False, "stopped answering")


def test_temporarily_rejected_means_later(rig: Rig) -> None:
    pending = rig.channel.start(MODE, 0.0)
    rig.ack(MODE, mavlink.MAV_RESULT_TEMPORARILY_REJECTED, 0.1)
    rig.run(0.9)
    assert len(rig.wire) == 1
    rig.run(1.2, start=1.0)
    assert len(rig.wire) == 2
    rig.ack(MODE, mavlink.MAV_RESULT_ACCEPTED, 1.3)
    assert ended(pending, True)


def test_temporarily_rejected_for_ever_ends(rig: Rig) -> None:
    pending = rig.channel.start(MODE, 0.0)
    for tenth in range(300):
        if pending.outcome is None:
            rig.ack(MODE, mavlink.MAV_RESULT_TEMPORARILY_REJECTED, tenth / 10)
            rig.channel.tick(tenth / 10)
    assert ended(pending, False, "temporarily rejected")
    assert len(rig.wire) == 6  # the first time and five times later


def test_the_other_kind_is_tried_once(rig: Rig) -> None:
    pending = rig.channel.start(MODE, 0.0)
    rig.ack(MODE, mavlink.MAV_RESULT_COMMAND_INT_ONLY, 0.1)
    rig.ack(MODE, mavlink.MAV_RESULT_COMMAND_LONG_ONLY, 0.2)
    assert [m.get_type() for m in rig.wire] == ["COMMAND_LONG", "COMMAND_INT"]
    assert ended(pending, False, "COMMAND_LONG only")


@pytest.mark.parametrize(
    ("source", "target"),
    [
        ((7, 1), (255, 190)),  # the vehicle's answer to a ground station
        ((7, 1), (245, 1)),  # to another component of our system
        ((7, 154), OWN),  # the gimbal of the same vehicle
        ((8, 1), OWN),  # another vehicle
    ],
)
def test_answers_meant_for_others_are_not_ours(rig: Rig, source: tuple[int, int], target: tuple[int, int]) -> None:
    pending = rig.channel.start(ARM, 0.0)
    rig.ack(ARM, mavlink.MAV_RESULT_ACCEPTED, 0.1, source, target)
    assert pending.outcome is None


def test_an_answer_without_target_fields_is_ours(rig: Rig) -> None:
    pending = rig.channel.start(ARM, 0.0)
    rig.ack(ARM, mavlink.MAV_RESULT_ACCEPTED, 0.1, target=(0, 0))
    assert ended(pending, True)


def test_one_command_of_a_kind_at_a_time(rig: Rig) -> None:
    first = rig.channel.start(ARM, 0.0)
    second = rig.channel.start(ARM, 0.1)
    other = rig.channel.start(MODE, 0.1)
    assert ended(second, False, "earlier")
    assert first.outcome is None and other.outcome is None
    assert [m.command for m in rig.wire] == [400, 176]


def test_a_cancelled_command_is_not_sent_late(rig: Rig) -> None:
    pending = rig.channel.start(MODE, 0.0)
    rig.channel.cancel("link lost")
    rig.run(20.0)
    assert ended(pending, False, "link lost")
    assert len(rig.wire) == 1


def test_the_answer_may_come_while_sending() -> None:
    # A wire that answers at once, from within send: the reply must have been expected before.
    def answer(message: Any) -> None:
        channel.hear(mavlink.MAVLink_command_ack_message(message.command, 0, 0, 0, *OWN), VEHICLE, 0.0)

    channel = CommandChannel(answer, OWN, VEHICLE)
    assert ended(channel.start(ARM, 0.0), True)


def test_a_position_goes_out_in_ten_millionths_of_a_degree() -> None:
    command = Command(192, (-1.0, 1.0, 0.0, math.nan, -37.81361, 144.96312, 50.0), "reposition", True, frame=6)
    message = command.message(7, 1, as_int=True, confirmation=0)
    # By hand: 1e7 times the degrees.
    assert (message.x, message.y, message.z, message.frame) == (-378136100, 1449631200, 50.0, 6)
    assert message.current == 0 and message.autocontinue == 0


def test_unused_position_of_command_int_is_the_largest_int32() -> None:
    # https://mavlink.io/en/messages/common.html#COMMAND_INT: INT32_MAX where x or y is not used.
    land = Command(21, (0.0, 0.0, 0.0, math.nan, math.nan, math.nan, 0.0), "land")
    message = land.message(7, 1, as_int=True, confirmation=0)
    assert (message.x, message.y) == (2147483647, 2147483647)

"""Launch step by step against an autopilot that answers as it is told, on a fake clock.

Oracle: DESIGN.md and the command protocol (https://mavlink.io/en/services/command.html): a mode counts once the
heartbeat shows it; arming and take-off are repeated only while telemetry shows that they were not done, and never late.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.fleet.config import MapOrigin, UavConfig
from jpap_ros.mavlink import procedures
from jpap_ros.mavlink.aircraft import Aircraft
from jpap_ros.mavlink.aircraft_settings import AircraftSettings
from jpap_ros.mavlink.authority import Holder
from jpap_ros.mavlink.commands import PROMPT_S
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.mavlink.guards import PlanDeadman
from jpap_ros.mavlink.procedures import ARM_SHOWS_S
from jpap_ros.mavlink.streams import WANTED

ORIGIN = MapOrigin(-37.8136, 144.9631, 20.0)
MODE, ARM, TAKEOFF = (
    mavlink.MAV_CMD_DO_SET_MODE,
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
    mavlink.MAV_CMD_NAV_TAKEOFF,
)
GUIDED, LOITER = 4, 5
GROUND, RISING, AIR = (
    mavlink.MAV_LANDED_STATE_ON_GROUND,
    mavlink.MAV_LANDED_STATE_TAKEOFF,
    mavlink.MAV_LANDED_STATE_IN_AIR,
)


class Rig:
    """An aircraft and an ArduCopter whose obedience, answers and telemetry can be taken away.

    Attributes
    ----------
    hears, answers : callable
        Whether the try with this number (from 1) of a command is heard, and whether one heard is answered.
    """

    def __init__(self) -> None:
        self.now = 100.0
        self.sent: list[tuple[float, Any]] = []
        self.hears: Callable[[int, int], bool] = lambda command, number: True
        self.answers: Callable[[int], bool] = lambda command: True
        self.obeys: Callable[[int], bool] = lambda command: True
        self.tells_landed_state = True
        self.beats = True
        self.mode, self.armed, self.landed, self.height_m = 0, False, GROUND, 0.0
        self.aircraft = Aircraft(
            UavConfig("uav1", 1, ()),
            LocalFrame(ORIGIN),
            AircraftSettings(takeoff_height_m=10.0),
            (245, 191),
            self._send,
            PlanDeadman(0.0),
            {message_id: wanted.rate_hz for message_id, wanted in WANTED.items()},
        )
        self.done: list[tuple[bool, str]] = []
        self.telemetry()
        self.aircraft.run(
            procedures.launch(self.aircraft), lambda success, words: self.done.append((success, words)), "launch"
        )

    def tries(self, command: int, param1: float | None = None) -> list[Any]:
        """Times and messages of a command sent."""
        return [(at, m) for at, m in self.sent if m.command == command and param1 in (None, m.param1)]

    def _send(self, message: Any) -> None:
        if not message.get_type().startswith("COMMAND"):
            return
        self.sent.append((self.now, message))
        command = message.command
        if not self.hears(command, len(self.tries(command))):
            return
        if self.obeys(command):
            if command == MODE:
                self.mode = int(message.param2)
            elif command == ARM:
                self.armed = message.param1 == 1.0
            elif command == TAKEOFF:
                self.landed = RISING
        if self.answers(command):
            self._hear(mavlink.MAVLink_command_ack_message(command, 0, 0, 0, 245, 191))

    def _hear(self, message: Any) -> None:
        self.aircraft.hear(message, (1, 1), self.now)

    def telemetry(self) -> None:
        base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0)
        if self.beats:
            self._hear(mavlink.MAVLink_heartbeat_message(2, 3, base, self.mode, 4, 3))
        if self.tells_landed_state:
            self._hear(mavlink.MAVLink_extended_sys_state_message(0, self.landed))
        self._hear(mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 15_900, -1, 87, 0, 0, 0, 0, 0, 0))
        self._hear(
            mavlink.MAVLink_home_position_message(-378136000, 1449631000, 20_000, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0)
        )
        height_mm = round(self.height_m * 1e3)
        self._hear(
            mavlink.MAVLink_global_position_int_message(
                round(self.now * 1e3), -378136000, 1449631000, 20_000 + height_mm, height_mm, 0, 0, 0, 0
            )
        )

    def until_sent(self, command: int) -> None:
        """Let time pass until a command was sent."""
        while not self.tries(command):
            self.watch(0.1)

    def run(self, seconds: float = 90.0) -> tuple[bool, str]:
        """Let time pass until the launch has ended; telemetry comes twice a second."""
        end = self.now + seconds
        while not self.done and self.now < end:
            self.watch(0.1)
        (outcome,) = self.done
        return outcome

    def watch(self, seconds: float) -> None:
        """Let time pass."""
        for _ in range(round(seconds * 10)):
            self.now += 0.1
            if self.landed in (RISING, AIR):
                self.height_m = min(10.0, self.height_m + 0.3)
                self.landed = RISING if self.height_m < 10.0 else AIR
            if round(self.now * 10) % 5 == 0:
                self.telemetry()
            self.aircraft.tick(self.now)


@pytest.fixture
def rig() -> Rig:
    return Rig()


def test_each_is_sent_once_to_one_that_hears_and_answers(rig: Rig) -> None:
    success, words = rig.run()
    assert success and words == "in the air at 10 m; flies its goals now"
    orders = [m.command for _, m in rig.sent if m.command in (MODE, ARM, TAKEOFF)]
    assert orders == [MODE, ARM, TAKEOFF]


def test_a_mode_that_is_accepted_but_does_not_show_is_no_mode(rig: Rig) -> None:
    rig.obeys = lambda command: command != MODE
    success, words = rig.run()
    assert not success and "accepted, but the heartbeat still shows STABILIZE" in words
    assert not rig.tries(ARM) and not rig.tries(TAKEOFF)


def test_arming_that_is_accepted_but_does_not_show_is_no_arming(rig: Rig) -> None:
    rig.obeys = lambda command: command != ARM
    success, words = rig.run()
    assert not success and words == "arm: accepted, but the heartbeat shows it disarmed"
    assert len(rig.tries(ARM, 1.0)) == 1 and not rig.tries(TAKEOFF)


def test_a_lost_answer_is_made_good_by_the_heartbeat_and_nothing_is_sent_again(rig: Rig) -> None:
    rig.answers = lambda command: command == MODE
    success, words = rig.run()
    assert success, words
    assert len(rig.tries(ARM)) == len(rig.tries(TAKEOFF)) == 1


def test_what_is_lost_is_sent_again_with_confirmation_raised(rig: Rig) -> None:
    rig.hears = lambda command, number: number >= {MODE: 5, ARM: 4, TAKEOFF: 3}.get(command, 1)
    success, words = rig.run()
    assert success, words
    for command, count in ((MODE, 5), (ARM, 4), (TAKEOFF, 3)):
        assert [m.confirmation for _, m in rig.tries(command)] == list(range(count))


@pytest.mark.parametrize("lost", [ARM, TAKEOFF])
def test_nothing_dangerous_is_sent_late(rig: Rig, lost: int) -> None:
    rig.hears = lambda command, number: command != lost
    success, words = rig.run()
    assert not success and "no answer" in words
    times = [at for at, m in rig.tries(lost, 1.0 if lost == ARM else None)]
    tries, prompt_s = ((4, 5), ARM_SHOWS_S + 0.5) if lost == ARM else ((5, 11), PROMPT_S)
    assert tries[0] <= len(times) <= tries[1] and times[-1] - times[0] < prompt_s
    # What was armed is disarmed again.
    assert not rig.armed


def test_while_no_heartbeat_comes_arming_is_sent_again_for_three_seconds_at_most(rig: Rig) -> None:
    rig.hears = lambda command, number: command != ARM
    rig.until_sent(ARM)
    rig.beats = False
    rig.watch(3.9)
    times = [at for at, _ in rig.tries(ARM)]
    assert 6 <= len(times) <= 9 and 2.0 < times[-1] - times[0] <= 3.0


def test_what_a_human_disarms_at_once_is_not_armed_again_and_again(rig: Rig) -> None:
    """It was armed and disarmed between two heartbeats, and the answer is lost: none of them shows it armed."""
    rig.obeys, rig.answers = (lambda command: command != ARM), (lambda command: command != ARM)
    success, words = rig.run()
    assert not success and "no answer" in words
    times = [at for at, _ in rig.tries(ARM, 1.0)]
    assert len(times) <= 5 and times[-1] - times[0] < ARM_SHOWS_S + 0.5


def test_what_was_seen_armed_is_never_armed_again(rig: Rig) -> None:
    rig.answers = lambda command: command != ARM
    rig.until_sent(ARM)
    rig.telemetry()
    rig.armed = False
    success, words = rig.run()
    assert not success and "disarmed without the bridge asking" in words
    assert len(rig.tries(ARM)) == 1


@pytest.mark.parametrize(("after", "never"), [(MODE, ARM), (ARM, TAKEOFF), (TAKEOFF, MODE)])
def test_a_pilot_who_takes_over_just_after_a_change_of_mode_keeps_it(rig: Rig, after: int, never: int) -> None:
    """Within the second in which a heartbeat could still be one from before the change."""
    rig.mode = LOITER
    rig.telemetry()
    rig.until_sent(after)
    rig.telemetry()  # GUIDED is confirmed
    sent = len(rig.sent)
    rig.mode = LOITER
    rig.telemetry()
    success, words = rig.run()
    assert not success and "LOITER" in words
    # One whose change of mode was not noticed yet goes back to nobody, on the ground.
    assert rig.aircraft.authority.holder is (Holder.NOBODY if after == MODE else Holder.OTHERS)
    rig.watch(20.0)
    assert never not in {m.command for _, m in rig.sent[sent:]}


def test_one_late_heartbeat_from_before_the_change_ends_nothing(rig: Rig) -> None:
    rig.mode = LOITER
    rig.telemetry()
    rig.until_sent(MODE)
    rig.telemetry()
    rig.mode = LOITER
    rig.telemetry()
    rig.mode = GUIDED
    success, words = rig.run()
    assert success, words


def test_who_takes_off_by_himself_while_he_waits_for_his_turn_is_not_taken(rig: Rig) -> None:
    aircraft = rig.aircraft
    aircraft.run(procedures.launch(aircraft, delay_s=5.0), lambda *end: rig.done.append(end), "launch")
    rig.done.clear()
    rig.watch(1.0)
    rig.armed, rig.landed = True, RISING
    success, words = rig.run()
    assert not success and "somebody else flies it" in words
    assert not rig.tries(MODE) and aircraft.authority.holder is Holder.NOBODY


def test_without_a_landed_state_take_off_is_never_sent_twice(rig: Rig) -> None:
    rig.tells_landed_state = False
    rig.hears = lambda command, number: command != TAKEOFF
    success, words = rig.run()
    assert not success and "no answer" in words
    assert len(rig.tries(TAKEOFF)) == 1


@pytest.mark.parametrize("lost", [MODE, ARM, TAKEOFF])
def test_an_operator_who_calls_it_off_ends_the_tries(rig: Rig, lost: int) -> None:
    rig.hears = lambda command, number: command != lost
    param1 = 1.0 if lost == ARM else None
    rig.watch(5.0)
    before = len(rig.tries(lost, param1))
    assert before >= 2
    rig.aircraft.run(procedures.hold(rig.aircraft), lambda success, words: None, "hold")
    rig.watch(20.0)
    assert rig.done == [(False, "superseded by hold")]
    assert len(rig.tries(lost, param1)) == before

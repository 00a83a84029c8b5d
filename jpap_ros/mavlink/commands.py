"""The command protocol, for one vehicle: answers matched, repeated only where repeating is harmless.

Source: https://mavlink.io/en/services/command.html. What must not be done late or twice (arming, take-off) is sent
again only while the operator's order is fresh and telemetry lets no doubt that this is harmless.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

#: Times that a harmless question is sent before it counts as unanswered, and the wait after each [s].
ATTEMPTS = 3
ANSWER_TIMEOUT_S = 1.0
#: The same for a harmless order, which is worth more trouble: with three frames of ten lost, 8 fail once in 15,000.
ORDER_ATTEMPTS = 8
#: A command that is sent once only gets this long [s].
SINGLE_ANSWER_TIMEOUT_S = 3.0
#: What must not be done late is not sent later than this after it was first sent [s].
PROMPT_S = 10.0
#: An IN_PROGRESS extends the wait by this much [s].
PROGRESS_TIMEOUT_S = 10.0
#: TEMPORARILY_REJECTED means later: asked again after this long, this many times.
LATER_S = 1.0
LATER_ATTEMPTS = 5

_UNUSED_INT = 0x7FFFFFFF
_RESULT_WORDS = {
    mavlink.MAV_RESULT_TEMPORARILY_REJECTED: "temporarily rejected",
    mavlink.MAV_RESULT_DENIED: "denied",
    mavlink.MAV_RESULT_UNSUPPORTED: "not supported",
    mavlink.MAV_RESULT_FAILED: "failed",
    mavlink.MAV_RESULT_COMMAND_LONG_ONLY: "accepted as COMMAND_LONG only",
    mavlink.MAV_RESULT_COMMAND_INT_ONLY: "accepted as COMMAND_INT only",
}


@dataclass(frozen=True)
class Command:
    """One MAV_CMD with its parameters.

    Attributes
    ----------
    id : int
        MAV_CMD.
    params : tuple of float
        Parameters 1 to 7, zeros left off at the end; a position's latitude and longitude in degrees.
    words : str
        What it asks for, for messages to people.
    idempotent : bool
        Sending it twice does what sending it once does, even if late.
    frame : int or None
        MAV_FRAME of the position in parameters 5 to 7: the command then goes out as COMMAND_INT, whose 1e-7 degrees
        do not suffer from single precision. None: COMMAND_LONG.
    attempts : int
        Times that it is sent at most, if it is idempotent.
    answer_timeout_s : float
        Wait for an answer before it is sent again, if it is [s].
    """

    id: int
    params: tuple[float, ...]
    words: str
    idempotent: bool = False
    frame: int | None = None
    attempts: int = ATTEMPTS
    answer_timeout_s: float = ANSWER_TIMEOUT_S

    def message(self, system: int, component: int, as_int: bool, confirmation: int) -> Any:
        """COMMAND_INT or COMMAND_LONG."""
        p = self.params + (0.0,) * (7 - len(self.params))
        if not as_int:
            return mavlink.MAVLink_command_long_message(system, component, self.id, confirmation, *p)
        scale = 1.0 if self.frame is None else 1e7
        x, y = (_UNUSED_INT if math.isnan(v) else round(v * scale) for v in p[4:6])
        frame = mavlink.MAV_FRAME_GLOBAL if self.frame is None else self.frame
        return mavlink.MAVLink_command_int_message(system, component, frame, self.id, 0, 0, *p[:4], x, y, p[6])


@dataclass(frozen=True)
class Outcome:
    """How a command ended.

    Attributes
    ----------
    accepted : bool
        The autopilot accepted it, which is not yet: it was done.
    result : int or None
        MAV_RESULT; None if no answer came.
    reason : str
        Why it was not accepted, in words.
    """

    accepted: bool
    result: int | None
    reason: str = ""


#: Whether telemetry shows that a command was done that was last sent at a time [s]; None: not to be told yet.
Done = Callable[[float], "bool | None"]


class Pending:
    """A command under way; `outcome` is set once it has ended."""

    def __init__(self, command: Command) -> None:
        self.command = command
        self.outcome: Outcome | None = None


class _Exchange(Pending):
    """What the channel remembers of a command under way."""

    def __init__(self, command: Command, done: Done | None, now: float) -> None:
        super().__init__(command)
        self.done = done
        self.began = self.sent_at = now
        self.as_int = command.frame is not None
        self.switched = False
        self.sent = 0
        self.postponed = 0
        self.in_progress = False
        self.due = 0.0
        self.waits_to_resend = False


class CommandChannel:
    """All commands to one vehicle.

    Parameters
    ----------
    send : callable
        Puts a message on the way to the vehicle.
    own : (int, int)
        System and component id of the sender, which an answer must name.
    target : (int, int)
        System and component id of the autopilot.
    """

    def __init__(self, send: Callable[[Any], object], own: tuple[int, int], target: tuple[int, int]) -> None:
        self._send = send
        self._own = own
        self._target = target
        self._open: dict[int, _Exchange] = {}
        #: Commands given up without an answer since the last answer.
        self.unanswered_in_row = 0

    def busy(self, command_id: int) -> bool:
        """True while a command of this kind is under way."""
        return command_id in self._open

    def start(self, command: Command, now: float, done: Done | None = None) -> Pending:
        """Send a command; a second one of a kind that is still under way ends at once, unsent.

        Parameters
        ----------
        done : callable, optional
            Makes a command that is not idempotent be sent again, while it is not answered, no later than `PROMPT_S`
            after the first time, and each time only if telemetry shows that it was not done.
        """
        exchange = _Exchange(command, done, now)
        if command.id in self._open:
            exchange.outcome = Outcome(False, None, f"{command.words}: an earlier command of the kind is not answered")
            return exchange
        # The answer may come while sending: be ready for it first.
        self._open[command.id] = exchange
        self._transmit(exchange, now)
        return exchange

    def hear(self, ack: Any, source: tuple[int, int], now: float) -> None:
        """Take a COMMAND_ACK from `source` (system, component); one that is not meant for us changes nothing."""
        exchange = self._open.get(ack.command)
        # Target 0 is what MAVLink 1 and senders that do not fill the field give.
        meant = ack.target_system in (0, self._own[0]) and ack.target_component in (0, self._own[1])
        if source != self._target or not meant:
            return
        self.unanswered_in_row = 0
        if exchange is None or exchange.waits_to_resend:
            return
        if ack.result == mavlink.MAV_RESULT_ACCEPTED:
            self._end(exchange, Outcome(True, ack.result))
        elif ack.result == mavlink.MAV_RESULT_IN_PROGRESS:
            exchange.in_progress = True
            exchange.due = now + PROGRESS_TIMEOUT_S
        elif self._other_kind_asked_for(ack.result, exchange):
            exchange.as_int = not exchange.as_int
            exchange.switched = True
            exchange.sent = 0
            self._transmit(exchange, now)
        elif (
            ack.result == mavlink.MAV_RESULT_TEMPORARILY_REJECTED
            and exchange.command.idempotent
            and exchange.postponed < LATER_ATTEMPTS
        ):
            exchange.postponed += 1
            exchange.waits_to_resend = True
            exchange.due = now + LATER_S
        else:
            words = _RESULT_WORDS.get(ack.result, f"result {ack.result}")
            self._end(exchange, Outcome(False, ack.result, f"{exchange.command.words}: {words}"))

    def tick(self, now: float) -> None:
        """Repeat or give up what is overdue."""
        for exchange in [e for e in self._open.values() if now >= e.due]:
            if exchange.waits_to_resend:
                exchange.waits_to_resend = False
                exchange.sent = 0
                self._transmit(exchange, now)
            elif exchange.in_progress:
                self._end(exchange, Outcome(False, None, f"{exchange.command.words}: stopped answering while at it"))
            elif exchange.command.idempotent and exchange.sent < exchange.command.attempts:
                self._transmit(exchange, now)
            else:
                self._insist(exchange, now)

    def _insist(self, exchange: _Exchange, now: float) -> None:
        """Repeat what must not be done twice if it was certainly not done; else wait for a sign, or give up."""
        late = now - exchange.began >= PROMPT_S
        done = exchange.done(exchange.sent_at) if exchange.done is not None and not late else True
        if done:
            self.unanswered_in_row += 1
            self._end(exchange, Outcome(False, None, f"{exchange.command.words}: no answer"))
        elif done is False:
            self._transmit(exchange, now)

    def withdraw(self, pending: Pending) -> None:
        """Send a command no more, if it is still under way: nobody waits for it."""
        if self._open.get(pending.command.id) is pending:
            self._end(self._open[pending.command.id], Outcome(False, None, f"{pending.command.words}: withdrawn"))

    def cancel(self, reason: str) -> None:
        """End everything under way, e.g. because the vehicle rebooted or was lost: nothing of it is sent late."""
        for exchange in list(self._open.values()):
            self._end(exchange, Outcome(False, None, f"{exchange.command.words}: {reason}"))

    @staticmethod
    def _other_kind_asked_for(result: int, exchange: _Exchange) -> bool:
        if exchange.switched:
            return False
        return bool(
            (result == mavlink.MAV_RESULT_COMMAND_INT_ONLY and not exchange.as_int)
            or (result == mavlink.MAV_RESULT_COMMAND_LONG_ONLY and exchange.as_int)
        )

    def _transmit(self, exchange: _Exchange, now: float) -> None:
        repeated = exchange.command.idempotent or exchange.done is not None
        exchange.due = now + (exchange.command.answer_timeout_s if repeated else SINGLE_ANSWER_TIMEOUT_S)
        exchange.sent_at = now
        exchange.sent += 1
        self._send(exchange.command.message(*self._target, exchange.as_int, exchange.sent - 1))

    def _end(self, exchange: _Exchange, outcome: Outcome) -> None:
        del self._open[exchange.command.id]
        exchange.outcome = outcome

"""Ask a vehicle for the messages that the bridge needs, at the rates it needs."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.mavlink.commands import Command, CommandChannel, Pending


@dataclass(frozen=True)
class Wanted:
    """How often a message should come [Hz], how rarely it may, and how important it is (1 first)."""

    rate_hz: float
    min_rate_hz: float
    priority: int


#: By message id.
WANTED: dict[int, Wanted] = {
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: Wanted(4.0, 0.5, 1),
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: Wanted(2.0, 0.5, 1),
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: Wanted(2.0, 0.4, 2),
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: Wanted(1.0, 0.2, 2),
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: Wanted(1.0, 0.2, 3),
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: Wanted(0.5, 0.0, 3),
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: Wanted(0.5, 0.1, 3),
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: Wanted(0.2, 0.1, 3),
}
#: What REQUEST_DATA_STREAM calls them, for an autopilot that does not know SET_MESSAGE_INTERVAL.
_DATA_STREAMS_HZ = {
    mavlink.MAV_DATA_STREAM_POSITION: 4,
    mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: 2,
    mavlink.MAV_DATA_STREAM_EXTRA3: 1,
}
#: Without a position for this long, and this many of its periods, everything is asked for again: a reboot forgets
#: what was asked before. The same for the landed state alone [s].
SILENCE_S = 3.0
SILENCE_PERIODS = 5.0
#: A change of a rate by a smaller share is not worth the question.
WORTH_ASKING = 0.1
#: Pause once nothing was answered, and between questions for home [s].
RETRY_S = 5.0


class StreamRequests:
    """The questions to one vehicle, one after the other.

    Parameters
    ----------
    commands : CommandChannel
    send : callable
        Puts a message on the way to the vehicle.
    target : (int, int)
        System and component id of the autopilot.
    rates_hz : mapping of int to float
        By message id; 0 switches a message off.
    """

    def __init__(
        self,
        commands: CommandChannel,
        send: Callable[[Any], object],
        target: tuple[int, int],
        rates_hz: Mapping[int, float],
    ) -> None:
        self._commands = commands
        self._send = send
        self._target = target
        self._rates_hz = dict(rates_hz)
        self._wanted: deque[int] = deque()
        self._asked: tuple[int, float, Pending] | None = None
        self._not_before = -math.inf
        self._home_not_before = -math.inf
        self._fell_back = False
        self._unanswered = 0
        self._done_at = -math.inf

    def restart(self) -> None:
        """Ask for everything: the vehicle is new, came back, rebooted, or is reached over another link."""
        self._wanted = deque(self._rates_hz)
        if self._asked is not None:
            # Else the first question would wait for the answer to one that nobody hears.
            self._commands.withdraw(self._asked[2])
        self._asked = None
        self._not_before = -math.inf
        self._home_not_before = -math.inf
        self._fell_back = False
        self._unanswered = 0

    def want(self, rates_hz: Mapping[int, float]) -> None:
        """Ask for other rates, where they differ enough."""
        for message_id, rate_hz in rates_hz.items():
            before = self._rates_hz.get(message_id, 0.0)
            close = abs(rate_hz - before) <= WORTH_ASKING * before and (rate_hz > 0.0) == (before > 0.0)
            if message_id in self._rates_hz and close:
                continue
            self._rates_hz[message_id] = rate_hz
            if message_id not in self._wanted:
                self._wanted.append(message_id)

    def tick(self, now: float, home_known: bool, position_at: float, landed_at: float = -math.inf) -> None:
        """Ask the next question, if it is time.

        Parameters
        ----------
        home_known : bool
        position_at : float
            When a position was last heard, same clock; minus infinity: never.
        landed_at : float
            The same of a landed state, which not every vehicle sends.
        """
        self._take_answer(now)
        if not self._wanted and self._silent(mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, position_at, now):
            self.restart()
        landed = mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE
        if not self._wanted and landed_at > -math.inf and self._silent(landed, landed_at, now):
            self._wanted.append(landed)
        if self._wanted and self._asked is None and now >= self._not_before:
            message_id = self._wanted[0]
            rate_hz = self._rates_hz[message_id]
            # -1 switches it off.
            interval_us = round(1e6 / rate_hz) if rate_hz > 0.0 else -1
            words = f"interval of message {message_id}"
            ask = Command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, (float(message_id), float(interval_us)), words, True)
            self._asked = message_id, rate_hz, self._commands.start(ask, now)
        if not home_known and now >= self._home_not_before:
            self._home_not_before = now + RETRY_S
            home_id = float(mavlink.MAVLINK_MSG_ID_HOME_POSITION)
            self._commands.start(Command(mavlink.MAV_CMD_REQUEST_MESSAGE, (home_id,), "home position", True), now)

    def _silent(self, message_id: int, heard_at: float, now: float) -> bool:
        """Whether a message has not come for too long, nor was anything asked for."""
        rate_hz = self._rates_hz.get(message_id, 0.0)
        patience_s = max(SILENCE_S, SILENCE_PERIODS / rate_hz) if rate_hz > 0.0 else SILENCE_S
        return now - max(heard_at, self._done_at) > patience_s

    def _take_answer(self, now: float) -> None:
        if self._asked is None or (outcome := self._asked[2].outcome) is None:
            return
        message_id, asked_hz, _ = self._asked
        self._asked = None
        if outcome.result is None:
            self._wanted.rotate(-1)
            self._unanswered += 1
            if self._unanswered >= len(self._wanted):
                # Nobody answers at all: less often from now on.
                self._not_before = now + RETRY_S
            return
        self._unanswered = 0
        self._done_at = now
        # It may have been given another rate while the question was under way.
        if asked_hz == self._rates_hz[message_id]:
            self._wanted.remove(message_id)
        if outcome.result == mavlink.MAV_RESULT_UNSUPPORTED and not self._fell_back:
            self._fell_back = True
            for stream, rate_hz in _DATA_STREAMS_HZ.items():
                self._send(mavlink.MAVLink_request_data_stream_message(*self._target, stream, rate_hz, 1))

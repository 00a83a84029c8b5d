"""Ask a vehicle for the messages that the bridge needs, at the rates it needs."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.mavlink.commands import Command, CommandChannel, Pending

#: Rates wanted [Hz] by message id.
RATES_HZ: dict[int, float] = {
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 4.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 2.0,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: 2.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 0.5,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 0.2,
}
#: What REQUEST_DATA_STREAM calls them, for an autopilot that does not know SET_MESSAGE_INTERVAL.
_DATA_STREAMS_HZ = {
    mavlink.MAV_DATA_STREAM_POSITION: 4,
    mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: 2,
    mavlink.MAV_DATA_STREAM_EXTRA3: 1,
}
#: Pause before what was not answered is asked for again, and between questions for home [s].
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
    """

    def __init__(self, commands: CommandChannel, send: Callable[[Any], object], target: tuple[int, int]) -> None:
        self._commands = commands
        self._send = send
        self._target = target
        self._wanted: deque[int] = deque()
        self._asked: tuple[int, Pending] | None = None
        self._not_before = -math.inf
        self._home_not_before = -math.inf
        self._fell_back = False

    def restart(self) -> None:
        """Ask for everything: the vehicle is new, came back, or rebooted."""
        self._wanted = deque(RATES_HZ)
        self._asked = None
        self._not_before = -math.inf
        self._home_not_before = -math.inf
        self._fell_back = False

    def tick(self, now: float, home_known: bool) -> None:
        """Ask the next question, if it is time."""
        self._take_answer(now)
        if self._wanted and self._asked is None and now >= self._not_before:
            message_id = self._wanted[0]
            interval_us = 1e6 / RATES_HZ[message_id]
            words = f"interval of message {message_id}"
            ask = Command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, (float(message_id), interval_us), words, True)
            self._asked = message_id, self._commands.start(ask, now)
        if not home_known and now >= self._home_not_before:
            self._home_not_before = now + RETRY_S
            home_id = float(mavlink.MAVLINK_MSG_ID_HOME_POSITION)
            self._commands.start(Command(mavlink.MAV_CMD_REQUEST_MESSAGE, (home_id,), "home position", True), now)

    def _take_answer(self, now: float) -> None:
        if self._asked is None or (outcome := self._asked[1].outcome) is None:
            return
        message_id, _ = self._asked
        self._asked = None
        if outcome.result is None:
            self._wanted.rotate(-1)
            self._not_before = now + RETRY_S
            return
        self._wanted.remove(message_id)
        if outcome.result == mavlink.MAV_RESULT_UNSUPPORTED and not self._fell_back:
            self._fell_back = True
            for stream, rate_hz in _DATA_STREAMS_HZ.items():
                self._send(mavlink.MAVLink_request_data_stream_message(*self._target, stream, rate_hz, 1))

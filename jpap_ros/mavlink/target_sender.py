"""When a target goes out to one aircraft: at once when it changes, else at a regular rate."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.mavlink.aircraft_settings import AircraftSettings
from jpap_ros.mavlink.autopilots import AltitudeDatum, Autopilot, Target, Transport
from jpap_ros.mavlink.commands import CommandChannel, Outcome, Pending
from jpap_ros.mavlink.statistics import Traffic
from jpap_ros.mavlink.vehicle import Vehicle

#: Least rate of targets that move [Hz].
MOVING_TARGET_HZ = 5.0


class TargetSender:
    """Puts targets on the wire, as setpoints or by DO_REPOSITION.

    Parameters
    ----------
    vehicle : Vehicle
    commands : CommandChannel
    send : callable
        Puts a message on the way to this aircraft.
    """

    def __init__(self, vehicle: Vehicle, commands: CommandChannel, send: Callable[[Any], object]) -> None:
        #: What went out last, and since when; None: nothing that the aircraft may be believed to fly to.
        self.sent: Target | None = None
        self.changed_at = -math.inf
        #: Position targets that went out, counted by time.
        self.traffic = Traffic()
        self._vehicle = vehicle
        self._commands = commands
        self._send = send
        self._send_at = -math.inf
        self._reposition: Pending | None = None

    def hurry(self) -> None:
        """The next target goes out at once, not at the next regular time."""
        self._send_at = -math.inf

    def put(
        self, target: Target, autopilot: Autopilot, datum: AltitudeDatum, settings: AircraftSettings, now: float
    ) -> bool:
        """Put a target on the wire if it is due.

        Returns
        -------
        bool
            Whether a setpoint went out in the place of a different one.

        Raises
        ------
        TargetError
            If the autopilot cannot be told this target.
        """
        sent = self.sent
        changed = target != sent
        if settings.transport is Transport.REPOSITION:
            if changed and not self._commands.busy(mavlink.MAV_CMD_DO_REPOSITION):
                command = autopilot.reposition(target, self._vehicle, datum)
                self.sent, self.changed_at = target, now
                self._reposition = self._commands.start(command, now)
            return False
        moves = target.velocity_ned_m_s is not None
        moved_before = sent is not None and sent.velocity_ned_m_s is not None
        if now < self._send_at and (not changed or (moves and moved_before)):
            return False
        message = autopilot.position_target(target, self._vehicle, datum, round(now * 1e3))
        rate_hz = max(settings.setpoint_rate_hz, autopilot.min_stream_hz, MOVING_TARGET_HZ if moves else 0.0)
        interval_s = 1.0 / rate_hz
        # Regular on average, however late this call comes; after a pause, regular from now on.
        self._send_at = max(self._send_at, now - interval_s) + interval_s
        self.sent = target
        if changed:
            self.changed_at = now
        self._send(message)
        self.traffic.add(0, now)
        return changed and sent is not None

    def take_answer(self) -> Outcome | None:
        """How the last DO_REPOSITION ended, told once; None: it has not ended, or there was none."""
        if self._reposition is None or self._reposition.outcome is None:
            return None
        outcome, self._reposition = self._reposition.outcome, None
        return outcome

"""Telemetry rates of the aircraft on one link, fitted to its byte budget and to what is measured on it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.fleet.config import LinkConfig
from jpap_ros.mavlink.autopilots import Autopilot
from jpap_ros.mavlink.budget import Allocation, Budget, Stream, frame_size
from jpap_ros.mavlink.streams import WANTED, Wanted

#: Shares of the budget: above the first rates are lowered, below the second they are raised, and both aim at the third.
TOO_MUCH, ROOM, AIM = 1.0, 0.75, 0.9
#: A change shows whole in the measurement after this long: its window, and a vehicle asked after the other [s].
SETTLE_S = 7.0
#: Priority of what nobody asked for: it goes first.
_UNASKED_PRIORITY = 4


class LinkRates:
    """Rates for one link, adjusted by integral control with a dead band.

    The budget less what is measured beside the streams planned here (ground stations, other components, commands) is
    what these may cost together. Heartbeats and position targets are among them, and never slowed.

    Parameters
    ----------
    link : LinkConfig
    setpoint_hz : float
        Position targets a second to each aircraft.
    """

    def __init__(self, link: LinkConfig, setpoint_hz: float) -> None:
        self._link = link
        self._setpoint_hz = setpoint_hz
        self._room = link.max_bytes_per_s
        self._crowd: Counter[Autopilot] = Counter()
        self._settled_at = -float("inf")
        self._streams, self._allocation = self._allocate()

    def rates_hz(self, autopilot: Autopilot | None) -> dict[int, float]:
        """What to ask one aircraft for, by message id; 0 switches a message off.

        On a link with a budget what its autopilot sends unasked is among them.
        """
        unasked: Mapping[int, float] = {} if autopilot is None else autopilot.unasked_hz
        fitted = zip(self._streams, self._allocation.rates_hz, strict=True)
        rates = {stream.message_id: rate for stream, rate in fitted if stream.priority > 0}
        asked = {message_id: rates[message_id] for message_id in WANTED}
        if self._link.max_bytes_per_s is None:
            return asked
        return asked | {message_id: rates[message_id] for message_id in unasked if message_id in rates}

    def adapt(self, bytes_per_s: float, loss: float, autopilots: Iterable[Autopilot], now: float) -> bool:
        """Fit the rates to a measurement.

        Parameters
        ----------
        bytes_per_s : float
            Received and sent together.
        loss : float
            Share of messages lost on the way, 0 to 1. They took their room all the same.
        autopilots : iterable of Autopilot
            Of the aircraft that are heard on the link.
        now : float
            Monotonic time [s].

        Returns
        -------
        bool
            Whether the rates changed.
        """
        budget = self._link.max_bytes_per_s
        if budget is None or self._room is None:
            return False
        crowd = Counter(autopilots)
        if crowd != self._crowd:
            self._crowd = crowd
            return self._change(now)
        load = bytes_per_s / max(1.0 - loss, 0.1)
        if now < self._settled_at or not crowd or ROOM * budget <= load <= TOO_MUCH * budget:
            return False
        most = sum(stream.rate_hz * stream.size_bytes for stream in self._streams)
        self._room = min(max(self._least(budget), self._room + AIM * budget - load), most)
        return self._change(now)

    def problem(self, bytes_per_s: float) -> str:
        """What is wrong if the link cannot carry what must be carried, and what to do; empty if it can."""
        budget, link = self._link.max_bytes_per_s, self._link
        if budget is None or self._room is None:
            return ""
        must = sum(stream.rate_hz * stream.size_bytes for stream in self._streams if stream.priority == 0)
        if must > budget:
            return (
                f"{link.url} carries {budget:g} byte/s, too little for heartbeats and {self._setpoint_hz:g} targets a "
                f"second to {len(link.uavs)} aircraft: lower setpoint_rate_hz or use more links"
            )
        if bytes_per_s > TOO_MUCH * budget and self._room <= self._least(budget):
            return (
                f"{link.url} carries {budget:g} byte/s, but {bytes_per_s:.0f} are measured with telemetry at its "
                "least: let ground stations ask for less or use more links"
            )
        return ""

    def _least(self, budget: float) -> float:
        """Cost of what is kept, whoever else uses the link [byte/s]."""
        least = sum(s.size_bytes * (s.min_rate_hz if s.priority > 0 else s.rate_hz) for s in self._streams)
        return min(budget, least)

    def _change(self, now: float) -> bool:
        before = self._streams, self._allocation
        self._streams, self._allocation = self._allocate()
        if (self._streams, self._allocation) == before:
            return False
        self._settled_at = now + SETTLE_S
        return True

    def _allocate(self) -> tuple[list[Stream], Allocation]:
        """Streams of all aircraft together, those never slowed first, and their rates."""
        count = len(self._link.uavs)
        targets = Wanted(self._setpoint_hz, 0.0, 0)
        streams = [
            self._stream(mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT, targets, count),
            # Both ways.
            self._stream(mavlink.MAVLINK_MSG_ID_HEARTBEAT, Wanted(2.0, 0.0, 0), count),
            *(self._stream(message_id, wanted, count) for message_id, wanted in WANTED.items()),
        ]
        for autopilot, number in self._crowd.items():
            for message_id, rate_hz in autopilot.unasked_hz.items():
                streams.append(self._stream(message_id, Wanted(rate_hz, 0.0, _UNASKED_PRIORITY), number))
        return streams, Budget(self._room).allocate(streams)

    def _stream(self, message_id: int, wanted: Wanted, aircraft: int) -> Stream:
        size = aircraft * frame_size(message_id, self._link.signing_key_file is not None)
        return Stream(message_id, wanted.rate_hz, size, wanted.priority, wanted.min_rate_hz)

"""How far an aircraft's battery still goes: when it has to be relieved, and when it has to go home."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

Place = tuple[float, float, float]

#: The drain in the air is believed after so long [s]: batteries are reported in whole per cent.
_MEASURED_AFTER_S = 60.0
#: What falls faster than so many times the drain of `endurance_s`, and a step, is no drain but a jump.
_STEADY, _STEP = 10.0, 0.05
#: What must be left on the ground at home.
_LANDED_WITH = 0.05
#: How far below `ready_battery` an aircraft is low, or critical, at the most.
_LOW_BELOW_READY, _CRITICAL_BELOW_READY = 0.05, 0.1


@dataclass(frozen=True)
class EndurancePolicy:
    """What the battery's thresholds follow from.

    Attributes
    ----------
    low_battery : float
        Share at or below which an aircraft is relieved, however near its relief is.
    critical_battery : float
        Share at or below which it goes home, relieved or not, however near that is.
    ready_battery : float
        Share from which an aircraft on the ground may be launched.
    endurance_s : float
        How long a full battery keeps an aircraft in the air [s], until its drain is measured.
    cruise_m_s, climb_m_s : float
        Speed over ground and vertical speed of a relief [m/s].
    way_factor : float
        How much longer than straight at these speeds a relief may need: for turns, others' ways and wind.
    relief_slack_s : float
        For taking off and waiting for the way up [s].
    station_above_m : float
        How far above the cell's place the relief waits [m].
    """

    low_battery: float = 0.3
    critical_battery: float = 0.15
    ready_battery: float = 0.6
    endurance_s: float = 1500.0
    cruise_m_s: float = 8.0
    climb_m_s: float = 1.5
    way_factor: float = 1.3
    relief_slack_s: float = 45.0
    station_above_m: float = 15.0

    def __post_init__(self) -> None:
        for name in ("endurance_s", "cruise_m_s", "climb_m_s"):
            if getattr(self, name) == 0:
                raise ValueError(f"{name} must be greater than 0, got {getattr(self, name)!r}")
        if not self.critical_battery <= self.low_battery <= self.ready_battery <= 1:
            raise ValueError(
                "critical_battery <= low_battery <= ready_battery <= 1 must hold, got"
                f" {self.critical_battery!r}, {self.low_battery!r}, {self.ready_battery!r}"
            )


@dataclass
class _Flight:
    began_s: float
    battery: float
    newest_s: float
    newest: float


class Endurance:
    """Keeps what each aircraft's battery did since its take-off, and where it took off.

    Parameters
    ----------
    policy : EndurancePolicy

    Notes
    -----
    With drain d per second, a relief that has `way` seconds to fly, and home as far away, an aircraft is critical at

        critical = max(critical_battery, min(d * way_home + 0.05, ready_battery - 0.1))

    and low where what is left above that lasts until its relief is there:

        low = max(low_battery, min(critical + d * (way_factor * way + relief_slack_s), ready_battery - 0.05)).

    Both stay below `ready_battery`, so that whoever is launched can begin to serve.
    """

    def __init__(self, policy: EndurancePolicy) -> None:
        self._policy = policy
        self._flights: dict[str, _Flight] = {}
        self._pads: dict[str, Place] = {}

    def observe(self, now_s: float, name: str, in_air: bool, battery: float, position: Place | None) -> None:
        """Take in a report; one that is first seen in the air is taken to have just taken off."""
        if in_air:
            flight = self._flights.get(name)
            if flight is None or self._jumped(flight, now_s, battery):
                self._flights[name] = _Flight(now_s, battery, now_s, battery)
            else:
                flight.newest_s, flight.newest = now_s, battery
            return
        self._flights.pop(name, None)
        if position is not None:
            self._pads[name] = position

    def _jumped(self, flight: _Flight, now_s: float, battery: float) -> bool:
        """Whether what was measured before says nothing of what follows: a fault, or a battery first told now."""
        steadily = _STEADY * (now_s - flight.newest_s) / self._policy.endurance_s + _STEP
        return math.isnan(flight.battery) or battery > flight.battery or flight.newest - battery > steadily

    def drain(self, now_s: float, name: str, battery: float) -> float:
        """Share of the battery that a second in the air costs [1/s]."""
        flight, planned = self._flights.get(name), 1.0 / self._policy.endurance_s
        if flight is None or now_s - flight.began_s < _MEASURED_AFTER_S or math.isnan(battery):
            return planned
        return max((flight.battery - battery) / (now_s - flight.began_s), 0.5 * planned)

    def critical(self, now_s: float, name: str, battery: float, station: Place) -> float:
        """Share at which an aircraft at a station has to go home."""
        home = self._pads.get(name)
        way_s = 0.0 if home is None else self._way_s(home, station)
        needed = self.drain(now_s, name, battery) * way_s + _LANDED_WITH
        return max(self._policy.critical_battery, min(needed, self._policy.ready_battery - _CRITICAL_BELOW_READY))

    def low(self, now_s: float, name: str, battery: float, station: Place, reliefs: Iterable[Place]) -> float:
        """Share at which an aircraft at a station has to be relieved.

        Its relief is the nearest of `reliefs`; where there is none, one that would start where it took off itself.
        """
        policy = self._policy
        starts = list(reliefs) or ([self._pads[name]] if name in self._pads else [])
        way_s = min((self._way_s(start, station) for start in starts), default=0.0)
        needed_s = policy.way_factor * way_s + policy.relief_slack_s
        wanted = self.critical(now_s, name, battery, station) + self.drain(now_s, name, battery) * needed_s
        return max(policy.low_battery, min(wanted, policy.ready_battery - _LOW_BELOW_READY))

    def left_s(self, now_s: float, name: str, battery: float, station: Place) -> float:
        """Time until an aircraft at a station has to go home [s]; 0 where its battery is unknown."""
        if math.isnan(battery):
            return 0.0
        above = battery - self.critical(now_s, name, battery, station)
        return max(above, 0.0) / self.drain(now_s, name, battery)

    def _way_s(self, start: Place, station: Place) -> float:
        policy = self._policy
        return (
            math.dist(start[:2], station[:2]) / policy.cruise_m_s
            + (station[2] + policy.station_above_m) / policy.climb_m_s
        )

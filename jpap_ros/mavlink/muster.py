"""Aircraft that are told to take off together get their turns together, once it is known where each stands."""

from __future__ import annotations

from collections.abc import Mapping

from jpap_ros.fleet.tower import Tower, Turn
from jpap_ros.mavlink.aircraft import Aircraft
from jpap_ros.mavlink.vehicle import LinkState

#: An aircraft that was just heard for the first time tells its place within this [s].
PLACES_WITHIN_S = 5.0


class Muster:
    """The aircraft of one order to take off.

    Parameters
    ----------
    tower : Tower
    fleet : mapping of str to Aircraft
    now : float
        Local clock [s].
    """

    def __init__(self, tower: Tower, fleet: Mapping[str, Aircraft], now: float) -> None:
        self._tower = tower
        self._fleet = fleet
        self._deadline = now + PLACES_WITHIN_S
        self._turns: dict[str, Turn] | None = None

    def turn(self, name: str, now: float) -> Turn | None:
        """An aircraft's turn; None while it is awaited where others of the order stand.

        Later than that, one whose place was not known gets a turn of its own, after the others.
        """
        if self._turns is None:
            if now < self._deadline and any(_silent(aircraft) for aircraft in self._fleet.values()):
                return None
            self._turns = self._give(self._fleet)
        if name not in self._turns:
            self._turns |= self._give({name: self._fleet[name]})
        return self._turns.get(name)

    def leave(self, name: str) -> None:
        """One of them is in the air, or has given up."""
        turn = (self._turns or {}).get(name)
        if turn is not None:
            self._tower.leave(turn)

    def _give(self, fleet: Mapping[str, Aircraft]) -> dict[str, Turn]:
        return self._tower.departures(
            {name: pad for name, one in fleet.items() if (pad := one.whereabouts.pad_m) is not None}
        )


def _silent(aircraft: Aircraft) -> bool:
    """Whether it is there, but has not said where."""
    return aircraft.vehicle.link is LinkState.CONNECTED and aircraft.whereabouts.enu_m is None

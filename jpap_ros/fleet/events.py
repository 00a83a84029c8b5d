"""What has happened since the last plan, in words."""

from __future__ import annotations

from collections import Counter

from jpap_ros.fleet.availability import Charge, Link, Vehicle
from jpap_ros.planning.devices import Changes

_DEVICE_EVENTS = ("joined", "moved", "changed demand", "left", "fell silent")
#: More aircraft that join are counted, not named.
_NAMED = 3


class Events:
    """Collects events until a plan answers them; `str()` gives the deployment's reason."""

    def __init__(self) -> None:
        self._devices: Counter[str] = Counter()
        self._joined: dict[str, None] = {}
        self._others: dict[str, None] = {}

    def __bool__(self) -> bool:
        return bool(self._devices or self._joined or self._others)

    def add_changes(self, changes: Changes) -> None:
        """Add what a device report changed."""
        counts = {
            "joined": len(changes.joined),
            "moved": len(changes.moved),
            "changed demand": len(changes.demanded),
            "left": len(changes.left),
        }
        self._devices.update({event: count for event, count in counts.items() if count})

    def add_silent(self, count: int) -> None:
        """Add devices that timed out."""
        self._devices["fell silent"] += count

    def add_aircraft(self, name: str) -> None:
        """Add an aircraft that is heard for the first time."""
        self._joined[name] = None

    def add(self, event: str) -> None:
        """Add any other event, in words; the same one twice counts once."""
        self._others[event] = None

    def merge(self, earlier: Events) -> None:
        """Take in events that happened before these."""
        self._devices.update(earlier._devices)
        self._joined = {**earlier._joined, **self._joined}
        self._others = {**earlier._others, **self._others}

    def __str__(self) -> str:
        parts: list[str] = []
        for event in _DEVICE_EVENTS:
            if count := self._devices[event]:
                noun = "" if parts else " device" if count == 1 else " devices"
                parts.append(f"{count}{noun} {event}")
        many = len(self._joined) > _NAMED
        joined = [f"{len(self._joined)} UAVs joined"] if many else [f"{name} joined" for name in self._joined]
        return ", ".join([*parts, *joined, *self._others])


class AircraftWatch:
    """Tells what happened to aircraft between two reports, which is more than whether they can be given a cell.

    Parameters
    ----------
    low_battery : float or None
        Share at or below which a battery is low; None: the fleet's life tells that, when it wants a relief.
    """

    def __init__(self, low_battery: float | None) -> None:
        self._low_battery = low_battery
        self._heard: set[str] = set()
        self._in_air: set[str] = set()
        self._tired: set[str] = set()

    def take(self, vehicle: Vehicle, events: Events) -> bool:
        """Take in a report; True if it told an event, which is added."""
        name = vehicle.name
        if vehicle.link is not Link.CONNECTED:
            return False
        joined = name not in self._heard
        tired = vehicle.in_air and self._is_low(vehicle) and name not in self._tired
        landed = not vehicle.in_air and name in self._in_air
        if joined:
            events.add_aircraft(name)
            self._heard.add(name)
        if tired:
            events.add(f"{name} is low on battery")
            self._tired.add(name)
        if landed:
            events.add(f"{name} has landed")
        if vehicle.in_air:
            self._in_air.add(name)
        else:
            # In the air a battery recovers a little when the load falls: tired is tired until it stands on the ground.
            self._in_air.discard(name)
            self._tired.discard(name)
        return joined or tired or landed

    def _is_low(self, vehicle: Vehicle) -> bool:
        if self._low_battery is None:
            return False
        return vehicle.battery <= self._low_battery or vehicle.charge in (Charge.LOW, Charge.CRITICAL)

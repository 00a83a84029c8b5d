"""What has happened since the last plan, in words."""

from __future__ import annotations

from collections import Counter

from jpap_ros.planning.devices import Changes

_DEVICE_EVENTS = ("joined", "moved", "changed demand", "left", "fell silent")


class Events:
    """Collects events until a plan answers them; `str()` gives the deployment's reason."""

    def __init__(self) -> None:
        self._devices: Counter[str] = Counter()
        self._others: dict[str, None] = {}

    def __bool__(self) -> bool:
        return bool(self._devices or self._others)

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

    def add(self, event: str) -> None:
        """Add any other event, in words; the same one twice counts once."""
        self._others[event] = None

    def merge(self, earlier: Events) -> None:
        """Take in events that happened before these."""
        self._devices.update(earlier._devices)
        self._others = {**earlier._others, **self._others}

    def __str__(self) -> str:
        parts: list[str] = []
        for event in _DEVICE_EVENTS:
            if count := self._devices[event]:
                noun = "" if parts else " device" if count == 1 else " devices"
                parts.append(f"{count}{noun} {event}")
        return ", ".join([*parts, *self._others])

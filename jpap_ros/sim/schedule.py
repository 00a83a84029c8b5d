"""Faults written down as text, to strike at a given time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from jpap_ros.sim.fleet import SimFleet
from jpap_ros.sim.vehicle import SimVehicle


def _silence(vehicle: SimVehicle, argument: str) -> None:
    vehicle.silent = _SWITCH[argument or "on"]


def _battery(vehicle: SimVehicle, argument: str) -> None:
    vehicle.set_battery(float(argument))


def _prearm(vehicle: SimVehicle, argument: str) -> None:
    vehicle.prearm_failure = argument or None


def _refuse_arming(vehicle: SimVehicle, argument: str) -> None:
    vehicle.refuse_arming = _SWITCH[argument or "on"]


_SWITCH = {"on": True, "off": False}

#: What can strike a vehicle, by name.
FAULTS: dict[str, Callable[[SimVehicle, str], None]] = {
    "silence": _silence,
    "battery": _battery,
    "prearm": _prearm,
    "refuse_arming": _refuse_arming,
    "pilot": lambda vehicle, argument: vehicle.pilot_takes(argument),
    "reboot": lambda vehicle, _: vehicle.reboot(),
    "crash": lambda vehicle, _: vehicle.crash(),
}


@dataclass(frozen=True)
class ScheduledFault:
    """One line of a schedule.

    Attributes
    ----------
    time_s : float
        After the start, on the wall clock [s].
    uav, fault, argument : str
    """

    time_s: float
    uav: str
    fault: str
    argument: str = ""

    @classmethod
    def parse(cls, text: str) -> ScheduledFault:
        """Read `<seconds> <uav> <fault> [argument]`, e.g. `30 uav2 pilot LOITER`; ValueError if wrong."""
        words = text.split(maxsplit=3)
        if len(words) < 3:
            raise ValueError(f"a fault must read '<seconds> <uav> <fault> [argument]', got {text!r}")
        try:
            time_s = float(words[0])
        except ValueError:
            time_s = math.nan
        if not 0.0 <= time_s < math.inf:
            raise ValueError(f"a fault's time must be a number of seconds from 0, got {words[0]!r} in {text!r}")
        if words[2] not in FAULTS:
            raise ValueError(f"a fault must be one of {', '.join(FAULTS)}, got {words[2]!r} in {text!r}")
        return cls(time_s, words[1], words[2], words[3] if len(words) > 3 else "")


class FaultSchedule:
    """Faults in the order of their times.

    Parameters
    ----------
    fleet : SimFleet
    lines : iterable of str
        See `ScheduledFault.parse`.

    Raises
    ------
    ValueError
        If a line is wrong or names no vehicle of the fleet.
    """

    def __init__(self, fleet: SimFleet, lines: Iterable[str]) -> None:
        self._fleet = fleet
        self._left: list[ScheduledFault] = []
        for line in lines:
            self.add(line)

    def add(self, line: str) -> None:
        """Add one fault; ValueError if the line is wrong or names no vehicle of the fleet."""
        fault = ScheduledFault.parse(line)
        if fault.uav not in self._fleet.vehicles:
            raise ValueError(f"a fault names {fault.uav!r}, which is not in the fleet")
        self._left.append(fault)
        self._left.sort(key=lambda fault: fault.time_s)

    def strike(self, elapsed_s: float) -> list[ScheduledFault]:
        """Let everything happen whose time has come; return it. ValueError if an argument is wrong."""
        struck = [fault for fault in self._left if fault.time_s <= elapsed_s]
        self._left = self._left[len(struck) :]
        for fault in struck:
            FAULTS[fault.fault](self._fleet[fault.uav], fault.argument)
        return struck

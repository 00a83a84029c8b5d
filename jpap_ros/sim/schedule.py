"""Faults written down as text, to strike at a given time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from jpap_ros.sim.fleet import SimFleet
from jpap_ros.sim.vehicle import SimVehicle

Strike = Callable[[SimVehicle], None]


def _switch(fault: str, argument: str) -> bool:
    if argument not in ("", "on", "off"):
        raise ValueError(f"{fault} needs on or off, got {argument!r}")
    return argument != "off"


def _silence(vehicle: SimVehicle, argument: str) -> Strike:
    silent = _switch("silence", argument)
    return lambda struck: setattr(struck, "silent", silent)


def _refuse_arming(vehicle: SimVehicle, argument: str) -> Strike:
    refuse = _switch("refuse_arming", argument)
    return lambda struck: setattr(struck, "refuse_arming", refuse)


def _prearm(vehicle: SimVehicle, argument: str) -> Strike:
    return lambda struck: setattr(struck, "prearm_failure", argument or None)


def _battery(vehicle: SimVehicle, argument: str) -> Strike:
    try:
        charge = float(argument)
    except ValueError:
        charge = math.nan
    if not 0.0 <= charge <= 1.0:
        raise ValueError(f"battery needs a charge from 0 to 1, got {argument!r}")
    return lambda struck: struck.set_battery(charge)


def _pilot(vehicle: SimVehicle, argument: str) -> Strike:
    if argument not in vehicle.MODE_NAMES:
        raise ValueError(f"pilot needs a mode, which must be one of {', '.join(vehicle.MODE_NAMES)}, got {argument!r}")
    return lambda struck: struck.pilot_takes(argument)


#: What can strike a vehicle, by name: each checks its argument for the vehicle and returns what to do to it.
FAULTS: dict[str, Callable[[SimVehicle, str], Strike]] = {
    "silence": _silence,
    "battery": _battery,
    "prearm": _prearm,
    "refuse_arming": _refuse_arming,
    "pilot": _pilot,
    "reboot": lambda vehicle, _: SimVehicle.reboot,
    "crash": lambda vehicle, _: SimVehicle.crash,
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
        If a line is wrong, names no vehicle of the fleet, or has an argument that its vehicle does not know.
    """

    def __init__(self, fleet: SimFleet, lines: Iterable[str]) -> None:
        self._fleet = fleet
        self._left: list[tuple[ScheduledFault, SimVehicle, Strike]] = []
        for line in lines:
            self.add(line)

    def add(self, line: str) -> None:
        """Add one fault; ValueError as for the lines at the start."""
        fault = ScheduledFault.parse(line)
        vehicle = self._fleet.vehicles.get(fault.uav)
        if vehicle is None:
            raise ValueError(f"a fault names {fault.uav!r}, which is not in the fleet")
        self._left.append((fault, vehicle, FAULTS[fault.fault](vehicle, fault.argument)))
        self._left.sort(key=lambda entry: entry[0].time_s)

    def strike(self, elapsed_s: float) -> list[ScheduledFault]:
        """Let everything happen whose time has come; return it."""
        struck = []
        while self._left and self._left[0][0].time_s <= elapsed_s:
            fault, vehicle, strike = self._left.pop(0)
            strike(vehicle)
            struck.append(fault)
        return struck

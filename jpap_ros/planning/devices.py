"""The device table: every device that the planner knows of, kept from reports that may be wrong."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

#: Farthest from the map's origin that a device can be [m], east and north each; the map is a plane.
MAX_COORDINATE_M = 100_000.0


@dataclass(frozen=True)
class Device:
    """A device as reported.

    Attributes
    ----------
    id : str
    position : tuple of float
        East and north [m] in the map frame.
    rate_demand : float
        Least data rate it needs [bit/s].
    weight : float
        Priority when the fleet is too small [-].
    """

    id: str
    position: tuple[float, float]
    rate_demand: float
    weight: float = 1.0


@dataclass(frozen=True)
class Fault:
    """Why a device's report was ignored: the device, the field and the value."""

    id: str
    field: str
    problem: str

    def __str__(self) -> str:
        return f"device {self.id!r}: {self.field} {self.problem}"


@dataclass(frozen=True)
class Changes:
    """What one report changed: ids of devices by event, and the faults found in it."""

    joined: tuple[str, ...] = ()
    moved: tuple[str, ...] = ()
    demanded: tuple[str, ...] = ()
    left: tuple[str, ...] = ()
    faults: tuple[Fault, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.joined or self.moved or self.demanded or self.left)


class DeviceTable:
    """Present devices by id, in the order in which they joined.

    A report that is wrong in any field is ignored whole: the device keeps its last good report, and no other device
    is affected.
    """

    def __init__(self) -> None:
        self._devices: dict[str, Device] = {}
        self._heard: dict[str, float] = {}

    def __len__(self) -> int:
        return len(self._devices)

    def __contains__(self, device_id: object) -> bool:
        return device_id in self._devices

    @property
    def devices(self) -> tuple[Device, ...]:
        """All present devices."""
        return tuple(self._devices.values())

    def apply(
        self,
        reported: Sequence[Device | Fault],
        departed: Iterable[str] = (),
        *,
        snapshot: bool = False,
        now_s: float = 0.0,
    ) -> Changes:
        """Take in one report.

        Parameters
        ----------
        reported : sequence of Device or Fault
            Devices that joined or changed; a Fault stands for one that could not even be read.
        departed : iterable of str
            Ids that left; ids not known are no fault, since a report can come twice.
        snapshot : bool
            Whether `reported` are all the devices there are, so that every other one has left.
        now_s : float
            Time of the report [s], for `expire`.

        Returns
        -------
        Changes
            A device that reports the same again has not changed.
        """
        leaving = list(dict.fromkeys(departed))
        faults = [Fault(name, "departed id", "must not be empty") for name in leaving if not name]
        seen = Counter(entry.id for entry in reported)
        good: dict[str, Device] = {}
        for entry in reported:
            fault = entry if isinstance(entry, Fault) else find_fault(entry)
            if entry.id and seen[entry.id] > 1:
                fault = Fault(entry.id, "id", f"must be unique in a report, got {entry.id!r} {seen[entry.id]} times")
            elif entry.id and entry.id in leaving:
                fault = Fault(entry.id, "id", f"must not be both in devices and in departed, got {entry.id!r}")
            if fault:
                faults.append(fault)
            elif isinstance(entry, Device):
                good[entry.id] = entry
        # A device whose report is wrong is still there.
        staying = set(seen)
        left = [name for name in leaving if name in self._devices and name not in staying]
        if snapshot:
            left += [name for name in self._devices if name not in staying and name not in leaving]
        for name in left:
            del self._devices[name], self._heard[name]
        joined, moved, demanded = [], [], []
        for name, device in good.items():
            known = self._devices.get(name)
            if known is None:
                joined.append(name)
            else:
                if known.position != device.position:
                    moved.append(name)
                if (known.rate_demand, known.weight) != (device.rate_demand, device.weight):
                    demanded.append(name)
            self._devices[name] = device
        for name in staying & self._devices.keys():
            self._heard[name] = now_s
        return Changes(tuple(joined), tuple(moved), tuple(demanded), tuple(left), tuple(dict.fromkeys(faults)))

    def expire(self, now_s: float, timeout_s: float) -> tuple[str, ...]:
        """Remove the devices that no report named for `timeout_s` [s], and return their ids."""
        silent = tuple(name for name in self._devices if now_s - self._heard[name] > timeout_s)
        for name in silent:
            del self._devices[name], self._heard[name]
        return silent


def find_fault(device: Device) -> Fault | None:
    """What is wrong with a device's report by itself, or None."""
    if not device.id:
        return Fault(device.id, "id", f"must not be empty, got {device.id!r}")
    for axis, value in zip("xy", device.position, strict=True):
        if not abs(value) <= MAX_COORDINATE_M:
            limit = f"{MAX_COORDINATE_M:g}"
            return Fault(device.id, f"position.{axis}", f"must be from -{limit} to {limit} m, got {value!r}")
    for field, value in (("rate_demand", device.rate_demand), ("weight", device.weight)):
        if not 0 < value < math.inf:
            return Fault(device.id, field, f"must be finite and > 0, got {value!r}")
    return None

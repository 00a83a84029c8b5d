"""From device reports to the device table; what is wrong in them is said once, counted, and harms nobody else."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence

from jpap_msgs.msg import DeviceUpdate, GeoDeviceUpdate

from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.nodes import planner_conversions as conversions
from jpap_ros.planning.devices import Changes, Device, DeviceTable, Fault

#: More faults than these are counted but neither remembered nor said: random ids must not fill memory or disk.
_MAX_REMEMBERED = 1000

#: For so long after a restart, what latched topics say may be older than what the state file says [s].
_REPLAY_S = 10.0


class DeviceIntake:
    """Reads reports on both topics into one table.

    Parameters
    ----------
    map_frame : str
        The only frame in which a position in metres is accepted.
    local : LocalFrame
        Puts positions in degrees on the map.
    warn : callable
        Takes a line for the operator.
    """

    def __init__(self, map_frame: str, local: LocalFrame, warn: Callable[[str], object]) -> None:
        self._map_frame = map_frame
        self._local = local
        self._warn = warn
        self._table = DeviceTable()
        self._faults: dict[tuple[str, str], Fault] = {}
        self._refused: set[str] = set()
        #: Stamp of each device's newest report [ns]; 0 where that had none.
        self._stamps: dict[str, int] = {}
        self._restored: dict[str, int] = {}
        self._replay_until_s = -math.inf
        self.faults = 0

    @property
    def devices(self) -> tuple[Device, ...]:
        """All present devices."""
        return self._table.devices

    @property
    def ignored(self) -> int:
        """Number of devices whose newest report is wrong."""
        return len({fault.id for fault in self._faults.values()})

    @property
    def stamps(self) -> dict[str, int]:
        """Stamp of the newest report of each present device [ns]; 0 where that had none."""
        return dict(self._stamps)

    def restore(self, devices: Sequence[Device], stamps: Mapping[str, int]) -> None:
        """Take in devices that were known before a restart, as if they had just reported.

        Reporters' latched reports come again then: those older than `stamps`, by the reporters' own clocks, change
        nothing of these devices.
        """
        self._table.apply(devices, now_s=time.monotonic())
        self._stamps, self._restored = dict(stamps), dict(stamps)
        self._replay_until_s = time.monotonic() + _REPLAY_S

    def take(self, message: DeviceUpdate) -> Changes:
        """Read a report in metres; one in another frame is refused whole."""
        frame = message.header.frame_id
        if frame == self._map_frame:
            return self._take(message, conversions.devices_of(message))
        self.faults += 1
        if frame not in self._refused and len(self._refused) < _MAX_REMEMBERED:
            self._refused.add(frame)
            self._warn(f"refused a device report: header.frame_id must be {self._map_frame!r}, got {frame!r}")
        return Changes()

    def take_geo(self, message: GeoDeviceUpdate) -> Changes:
        """Read a report in degrees."""
        return self._take(message, conversions.geo_devices_of(message, self._local))

    def expire(self, timeout_s: float) -> tuple[str, ...]:
        """Remove the devices that no report named for so long [s], and return their ids."""
        silent = self._table.expire(time.monotonic(), timeout_s)
        for name in silent:
            self._stamps.pop(name, None)
        if silent:
            self._forget_faults_of(set(silent))
        return silent

    def _take(self, message: DeviceUpdate | GeoDeviceUpdate, reported: Sequence[Device | Fault]) -> Changes:
        stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        old = self._outdated(stamp)
        reported = [entry for entry in reported if entry.id not in old]
        departed = [name for name in message.departed if name not in old]
        # What were all devices at the time of an old report are not all that there are now.
        snapshot = message.snapshot and not old
        changes = self._table.apply(reported, departed, snapshot=snapshot, now_s=time.monotonic())
        self._note(stamp, reported, changes)
        wrong = {fault.id for fault in changes.faults}
        self._forget_faults_of({entry.id for entry in reported if entry.id not in wrong} | set(changes.left))
        self.faults += len(changes.faults)
        new = [fault for fault in changes.faults if (fault.id, fault.field) not in self._faults]
        new = new[: _MAX_REMEMBERED - len(self._faults)]
        self._faults.update({(fault.id, fault.field): fault for fault in new})
        if new:
            self._warn(f"ignored in a device report: {conversions.listed(new)}")
        return changes

    def _outdated(self, stamp: int) -> set[str]:
        """Devices of which the state file knows something newer than a report with this stamp [ns]."""
        if not stamp or time.monotonic() > self._replay_until_s:
            return set()
        return {name for name, newest in self._restored.items() if stamp < newest}

    def _note(self, stamp: int, reported: Sequence[Device | Fault], changes: Changes) -> None:
        for name in changes.left:
            self._stamps.pop(name, None)
        for entry in reported:
            if isinstance(entry, Device) and entry.id in self._table:
                self._stamps[entry.id] = stamp

    def _forget_faults_of(self, mended: set[str]) -> None:
        """A fault that comes back after its device reported well is news again."""
        if self._faults:
            self._faults = {key: fault for key, fault in self._faults.items() if fault.id not in mended}

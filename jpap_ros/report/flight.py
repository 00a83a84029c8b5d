"""The course of a flight, put together from what was told: devices, plans and aircraft over time."""

from __future__ import annotations

import math
import re
from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from jpap_ros.fleet.config import FleetConfig, FleetFileError, parse_fleet
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.report.recording import Recording, RecordingError, Told

Floats = npt.NDArray[np.float64]

DEPLOYMENT = "jpap_msgs/msg/Deployment"
STATE = "jpap_msgs/msg/VehicleState"
DEVICES = "jpap_msgs/msg/DeviceUpdate"
GEO_DEVICES = "jpap_msgs/msg/GeoDeviceUpdate"
POSE = "geometry_msgs/msg/PoseStamped"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
LOG = "rcl_interfaces/msg/Log"

#: Positions further apart in time say nothing of what was between them [s].
MAX_POSITION_GAP_S = 5.0
#: Below this height an aircraft is on or near its pad [m].
FLYING_ABOVE_M = 2.0

_CONNECTED = 1
#: MAV_LANDED_STATE: in the air, taking off, landing.
_AIRBORNE = (2, 3, 4)


def is_of_flight(topic: str, type_name: str) -> bool:
    """Whether a message tells something of a flight."""
    if type_name == POSE:
        return topic.endswith("/pose")
    return type_name in (DEPLOYMENT, STATE, DEVICES, GEO_DEVICES, DIAGNOSTICS, LOG)


@dataclass(frozen=True, slots=True)
class DeviceReport:
    """What was known of a device from a moment on; `demand` is 0 once it has left [bit/s]."""

    at_s: float
    position: tuple[float, float]
    demand: float
    weight: float = 1.0


@dataclass(frozen=True)
class ReportedChange:
    """A device report that changed something: when it was sent [s], and in words."""

    at_s: float
    what: str


@dataclass(frozen=True)
class Plan:
    """A deployment.

    Attributes
    ----------
    at_s : float
        When it was published [s].
    began_s : float
        When planning began [s]: what was reported later is not in it.
    planning_s : float
    message : object
        The Deployment.
    """

    at_s: float
    began_s: float
    planning_s: float
    message: Any


@dataclass
class Track:
    """Where an aircraft was told to be, and its states."""

    times: list[float] = field(default_factory=list)
    points: list[tuple[float, float, float]] = field(default_factory=list)
    states: list[tuple[float, Any]] = field(default_factory=list)

    def positions(self, grid: Floats) -> Floats:
        """Return (T, 3) positions, linear in between; NaN where none was told for too long."""
        if not self.times:
            return np.full((len(grid), 3), math.nan)
        times, points = np.array(self.times), np.array(self.points)
        after = np.clip(np.searchsorted(times, grid, side="right"), 1, max(1, len(times) - 1))
        found = np.column_stack([np.interp(grid, times, points[:, axis]) for axis in range(3)])
        gap = times[np.minimum(after, len(times) - 1)] - times[after - 1]
        outside = (grid < times[0]) | (grid > times[-1] + MAX_POSITION_GAP_S)
        found[outside | ((gap > MAX_POSITION_GAP_S) & (grid < times[-1]))] = math.nan
        return found

    def airborne(self, grid: Floats) -> npt.NDArray[np.bool_]:
        """Return (T,) whether it was in the air, connected and off its pad."""
        flying = np.array(
            [state.landed_state in _AIRBORNE and state.link == _CONNECTED for _, state in self.states], dtype=bool
        )
        heights = self.positions(grid)[:, 2]
        return held(np.array([at for at, _ in self.states]), flying, grid, False) & (heights > FLYING_ABOVE_M)


@dataclass(frozen=True)
class Flight:
    """Everything that the report is made of; times are seconds since the recording began.

    Attributes
    ----------
    began_s : float
        Since 1970 [s].
    duration_s : float
    fleet : FleetConfig or None
    bandwidth_hz : float
        Of the planner.
    plans : tuple of Plan
    devices : mapping of str to list of DeviceReport
    changes : tuple of ReportedChange
    tracks : mapping of str to Track
    diagnostics, log : tuple of (float, object)
        Statuses and log lines.
    notes : tuple of str
    """

    began_s: float
    duration_s: float
    fleet: FleetConfig | None
    bandwidth_hz: float
    plans: tuple[Plan, ...]
    devices: dict[str, list[DeviceReport]]
    changes: tuple[ReportedChange, ...]
    tracks: dict[str, Track]
    diagnostics: tuple[tuple[float, Any], ...]
    log: tuple[tuple[float, Any], ...]
    notes: tuple[str, ...]

    def grid(self, step_s: float = 0.5, most: int = 4000) -> Floats:
        """Return (T,) evenly spaced moments [s], not more than `most`."""
        count = min(most, math.floor(self.duration_s / step_s) + 1)
        return np.linspace(0.0, self.duration_s, count) if count > 1 else np.zeros(1)

    def device_at(self, name: str, at_s: float) -> DeviceReport | None:
        """What was known of a device at a moment; None before its first report and after it left."""
        reports = self.devices.get(name, [])
        found = bisect_right(reports, at_s, key=lambda report: report.at_s)
        if found == 0 or reports[found - 1].demand == 0.0:
            return None
        return reports[found - 1]


def flight_of(recording: Recording, namespace: str | None = None) -> Flight:
    """Put a flight together.

    Parameters
    ----------
    recording : Recording
    namespace : str, optional
        Of the fleet; needed where several planners were recorded.

    Raises
    ------
    RecordingError
        If there is no deployment in it, or which fleet is meant is not clear.
    """
    spaces = sorted({_namespace(item.topic) for item in recording.told if item.type_name == DEPLOYMENT})
    if namespace is not None:
        wanted = "/" + namespace.strip("/")
        spaces = [space for space in spaces if space == wanted]
    where = ", ".join(str(path) for path in recording.paths)
    if not spaces:
        raise RecordingError(f"{where}: no deployment was recorded" + (f" in {namespace!r}" if namespace else ""))
    if len(spaces) > 1:
        raise RecordingError(f"{where}: has fleets in {', '.join(spaces)}: choose one with --namespace")
    notes = list(recording.notes)
    fleet = _fleet(recording.fleet_text, notes)
    return _Builder(recording, spaces[0], fleet, notes).flight()


def held(times: Floats, values: npt.NDArray[Any], grid: Floats, before: Any) -> npt.NDArray[Any]:
    """Return at each moment the newest of (K,) values that hold from `times` on; `before` where there is none yet."""
    index = np.searchsorted(times, grid, side="right")
    return np.concatenate([np.array([before], dtype=values.dtype), values])[index]


class _Builder:
    def __init__(self, recording: Recording, namespace: str, fleet: FleetConfig | None, notes: list[str]) -> None:
        self._recording = recording
        self._prefix = namespace.rstrip("/") + "/"
        self._fleet = fleet
        self._frame = None if fleet is None else LocalFrame(fleet.origin)
        self._notes = notes
        told = [item for item in recording.told if self._concerns(item)]
        self._began_s = min(min(item.sent_s, item.heard_s) if _is_live(item) else item.heard_s for item in told)
        self._told = told
        self._plans: list[Plan] = []
        self._devices: dict[str, list[DeviceReport]] = {}
        self._changes: list[ReportedChange] = []
        self._tracks: dict[str, Track] = {name: Track() for name in (() if fleet is None else fleet.names)}
        self._diagnostics: list[tuple[float, Any]] = []
        self._log: list[tuple[float, Any]] = []

    def _concerns(self, item: Told) -> bool:
        return item.type_name in (DIAGNOSTICS, LOG) or item.topic.startswith(self._prefix)

    def flight(self) -> Flight:
        for item in self._told:
            at_s = item.sent_s - self._began_s
            if item.type_name == DEPLOYMENT:
                self._add_plan(at_s, item.message)
            elif item.type_name in (DEVICES, GEO_DEVICES):
                self._add_report(at_s, item)
            elif item.type_name == STATE:
                self._track(item.message.uav).states.append((at_s, item.message))
            elif item.type_name == POSE:
                self._add_pose(item)
            elif item.type_name == DIAGNOSTICS:
                self._diagnostics += [(at_s, status) for status in item.message.status]
            else:
                self._log.append((at_s, item.message))
        for track in self._tracks.values():
            track.states.sort(key=lambda state: state[0])
        return Flight(
            began_s=self._began_s,
            duration_s=max(item.heard_s for item in self._told) - self._began_s,
            fleet=self._fleet,
            bandwidth_hz=self._bandwidth_hz(),
            plans=tuple(sorted(self._plans, key=lambda plan: plan.at_s)),
            devices=self._devices,
            changes=tuple(self._changes),
            tracks=dict(sorted(self._tracks.items(), key=lambda item: _natural(item[0]))),
            diagnostics=tuple(self._diagnostics),
            log=tuple(self._log),
            notes=tuple(self._notes),
        )

    def _track(self, name: str) -> Track:
        return self._tracks.setdefault(name, Track())

    def _add_plan(self, at_s: float, message: Any) -> None:
        planning_s = message.planning_time.sec + 1e-9 * message.planning_time.nanosec
        self._plans.append(Plan(at_s, at_s - planning_s, planning_s, message))

    def _add_pose(self, item: Told) -> None:
        uav = item.topic.split("/")[-2]
        stamp = item.message.header.stamp
        at_s = stamp.sec + 1e-9 * stamp.nanosec
        # The bridge stamps a pose with the moment at which it was true. On a simulated clock that is another time.
        if abs(at_s - item.sent_s) > MAX_POSITION_GAP_S:
            at_s = item.sent_s
        at_s -= self._began_s
        track, point = self._track(uav), item.message.pose.position
        if track.times and at_s <= track.times[-1]:
            return
        track.times.append(at_s)
        track.points.append((point.x, point.y, point.z))

    def _add_report(self, at_s: float, item: Told) -> None:
        update = item.message
        reported = dict(self._reported(item))
        gone = set(update.departed)
        if update.snapshot:
            gone |= self._devices.keys() - reported.keys()
        counts = {"joined": 0, "moved": 0, "changed demand": 0, "left": 0}
        for name, (position, demand, weight) in reported.items():
            before = self._present(name)
            if before is None:
                counts["joined"] += 1
            elif before.position != position:
                counts["moved"] += 1
            elif (before.demand, before.weight) != (demand, weight):
                counts["changed demand"] += 1
            else:
                continue
            self._devices.setdefault(name, []).append(DeviceReport(at_s, position, demand, weight))
        for name in gone:
            if (before := self._present(name)) is not None:
                counts["left"] += 1
                self._devices[name].append(DeviceReport(at_s, before.position, 0.0))
        what = ", ".join(f"{count} {verb}" for verb, count in counts.items() if count)
        if what:
            self._changes.append(ReportedChange(at_s, what))

    def _present(self, name: str) -> DeviceReport | None:
        last = self._devices[name][-1] if name in self._devices else None
        return None if last is None or last.demand == 0.0 else last

    def _reported(self, item: Told) -> Iterable[tuple[str, tuple[tuple[float, float], float, float]]]:
        """Devices of a report that the planner, too, could use."""
        for device in item.message.devices:
            if item.type_name == DEVICES:
                position = (device.position.x, device.position.y)
            elif self._frame is None:
                self._add_note("devices in latitude and longitude are left out: the recording has no fleet file")
                return
            else:
                try:
                    position = self._frame.to_map(device.latitude, device.longitude)
                except ValueError:
                    continue
            figures = (*position, device.rate_demand, device.weight)
            if all(map(math.isfinite, figures)) and device.rate_demand > 0.0 and device.weight > 0.0:
                yield device.id, (position, device.rate_demand, device.weight)

    def _bandwidth_hz(self) -> float:
        for node, values in self._recording.parameters.items():
            if _namespace(node) == (self._prefix.rstrip("/") or "/") and "bandwidth_hz" in values:
                return float(values["bandwidth_hz"])
        self._add_note("the planner's parameters were not recorded: bandwidth_hz is taken as 1")
        return 1.0

    def _add_note(self, note: str) -> None:
        if note not in self._notes:
            self._notes.append(note)


def _namespace(topic: str) -> str:
    return topic.rpartition("/")[0] or "/"


def _natural(name: str) -> list[tuple[int, str]]:
    """Sort key in which uav10 follows uav9."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]


def _is_live(item: Told) -> bool:
    """Whether a message was sent while it was recorded, and not latched before."""
    return item.heard_s - item.sent_s < 1.0


def _fleet(text: str | None, notes: list[str]) -> FleetConfig | None:
    if text is None:
        notes.append("the recording has no fleet file")
        return None
    try:
        return parse_fleet(text)
    except FleetFileError as error:
        notes.append(f"the recording's fleet file cannot be used: {error}")
        return None

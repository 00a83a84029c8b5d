"""Puts a flight together from what was told."""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Iterable
from typing import Any

from jpap_ros.fleet.config import FleetConfig, FleetFileError, parse_fleet
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.report.flight import MAX_POSITION_GAP_S, DeviceReport, Flight, Plan, ReportedChange, Track
from jpap_ros.report.recording import RecordingError, RecordingReader, Told

DEPLOYMENT = "jpap_msgs/msg/Deployment"
STATE = "jpap_msgs/msg/VehicleState"
DEVICES = "jpap_msgs/msg/DeviceUpdate"
GEO_DEVICES = "jpap_msgs/msg/GeoDeviceUpdate"
POSE = "geometry_msgs/msg/PoseStamped"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
LOG = "rcl_interfaces/msg/Log"

#: Of the log's levels.
_LOG_WARN = 30
#: A message heard so long after it was sent was latched [s].
_LATCHED_S = 1.0


def is_of_flight(topic: str, type_name: str) -> bool:
    """Whether a message tells something of a flight."""
    if type_name == POSE:
        return topic.endswith("/pose")
    return type_name in (DEPLOYMENT, STATE, DEVICES, GEO_DEVICES, DIAGNOSTICS, LOG)


def read_flight(reader: RecordingReader, namespace: str | None = None) -> Flight:
    """Read a flight.

    Parameters
    ----------
    reader : RecordingReader
        Of messages that are `is_of_flight`.
    namespace : str, optional
        Of the fleet; needed where several planners were recorded.

    Raises
    ------
    RecordingError
        If there is no deployment in it, or which fleet is meant is not clear.
    """
    collector = _Collector()
    for item in reader:
        collector.add(item)
    spaces = sorted({_namespace(item.topic) for item in collector.plans})
    if namespace is not None:
        wanted = "/" + namespace.strip("/")
        spaces = [space for space in spaces if space == wanted]
    where = ", ".join(str(path) for path in reader.paths)
    if not spaces:
        raise RecordingError(f"{where}: no deployment was recorded" + (f" in {namespace!r}" if namespace else ""))
    if len(spaces) > 1:
        raise RecordingError(f"{where}: has fleets in {', '.join(spaces)}: choose one with --namespace")
    return _Builder(collector, reader, spaces[0]).flight()


class _Collector:
    """Takes in messages in any order of topics and keeps what is needed of each; times are those of sending [s].

    Which messages belong to the fleet that is meant is only known at the end, so that all are kept by topic.
    """

    def __init__(self) -> None:
        self.plans: list[Told] = []
        self.reports: list[Told] = []
        self.poses: dict[str, Track] = {}
        self.states: dict[str, Track] = {}
        self.diagnostics: list[tuple[float, str, int, str]] = []
        self.log: list[tuple[float, Any]] = []
        self.began_s, self.ended_s = math.inf, -math.inf
        self._levels: dict[str, int] = {}

    def add(self, item: Told) -> None:
        # What was latched before the recording began does not make it longer.
        live = item.heard_s - item.sent_s < _LATCHED_S
        self.began_s = min(self.began_s, item.sent_s if live else item.heard_s)
        self.ended_s = max(self.ended_s, item.heard_s)
        if item.type_name == DEPLOYMENT:
            self.plans.append(item)
        elif item.type_name in (DEVICES, GEO_DEVICES):
            self.reports.append(item)
        elif item.type_name == STATE:
            self.states.setdefault(item.topic, Track()).add_state(item.sent_s, item.message)
        elif item.type_name == POSE:
            self._add_pose(item)
        elif item.type_name == DIAGNOSTICS:
            self._add_diagnostics(item)
        elif item.message.level >= _LOG_WARN:
            self.log.append((item.sent_s, item.message))

    def _add_pose(self, item: Told) -> None:
        stamp, point = item.message.header.stamp, item.message.pose.position
        at_s = stamp.sec + 1e-9 * stamp.nanosec
        # The bridge stamps a pose with the moment at which it was true. On a simulated clock that is another time.
        if abs(at_s - item.sent_s) > MAX_POSITION_GAP_S:
            at_s = item.sent_s
        self.poses.setdefault(item.topic, Track()).add_pose(at_s, (point.x, point.y, point.z))

    def _add_diagnostics(self, item: Told) -> None:
        """Keep changes of level only: figures in a status's words change every second."""
        for status in item.message.status:
            # The definition calls the level a byte.
            level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
            if level != self._levels.get(status.name, 0):
                self.diagnostics.append((item.sent_s, status.name, level, status.message))
            self._levels[status.name] = level


class _Builder:
    """Makes a flight of what was collected, for the fleet in one namespace."""

    def __init__(self, collected: _Collector, reader: RecordingReader, namespace: str) -> None:
        self._collected = collected
        self._parameters = reader.parameters
        self._prefix = namespace.rstrip("/") + "/"
        self._notes = list(reader.notes)
        self._fleet = _fleet(reader.fleet_text, self._notes)
        self._frame = None if self._fleet is None else LocalFrame(self._fleet.origin)
        self._began_s = collected.began_s
        self._devices: dict[str, list[DeviceReport]] = {}
        self._changes: list[ReportedChange] = []

    def flight(self) -> Flight:
        collected, began_s = self._collected, self._began_s
        for item in sorted(collected.reports, key=lambda item: item.sent_s):
            if item.topic.startswith(self._prefix):
                self._add_report(item.sent_s - began_s, item)
        plans = [self._plan(item) for item in collected.plans if item.topic.startswith(self._prefix)]
        return Flight(
            began_s=began_s,
            duration_s=collected.ended_s - began_s,
            fleet=self._fleet,
            bandwidth_hz=self._bandwidth_hz(),
            plans=tuple(sorted(plans, key=lambda plan: plan.at_s)),
            devices=self._devices,
            changes=tuple(self._changes),
            tracks=self._tracks(),
            diagnostics=tuple(
                (at_s - began_s, name, level, message) for at_s, name, level, message in collected.diagnostics
            ),
            log=tuple((at_s - began_s, line) for at_s, line in collected.log),
            notes=tuple(self._notes),
        )

    def _plan(self, item: Told) -> Plan:
        at_s, planning = item.sent_s - self._began_s, item.message.planning_time
        planning_s = planning.sec + 1e-9 * planning.nanosec
        return Plan(at_s, at_s - planning_s, planning_s, item.message)

    def _tracks(self) -> dict[str, Track]:
        tracks = {name: Track() for name in (() if self._fleet is None else self._fleet.names)}
        for topic, pose in self._collected.poses.items():
            if topic.startswith(self._prefix):
                track = tracks.setdefault(topic.split("/")[-2], Track())
                track.times = array("d", (at_s - self._began_s for at_s in pose.times))
                track.points = pose.points
        for topic, told in self._collected.states.items():
            if topic.startswith(self._prefix):
                track = tracks.setdefault(told.states[-1][1].uav, Track())
                track.states = [(at_s - self._began_s, state) for at_s, state in told.states]
                track.charge_times = array("d", (at_s - self._began_s for at_s in told.charge_times))
                track.charge = told.charge
        return dict(sorted(tracks.items(), key=lambda item: _natural(item[0])))

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
        for node, values in self._parameters.items():
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


def _fleet(text: str | None, notes: list[str]) -> FleetConfig | None:
    if text is None:
        notes.append("the recording has no fleet file")
        return None
    try:
        return parse_fleet(text)
    except FleetFileError as error:
        notes.append(f"the recording's fleet file cannot be used: {error}")
        return None

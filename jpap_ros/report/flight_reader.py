"""Puts a flight together from what was told."""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Iterable, Sequence
from typing import Any

from jpap_ros.fleet.config import FleetConfig, FleetFileError, parse_fleet
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.planning.devices import Device, DeviceTable, Fault
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
#: Devices named in one line; the rest is counted.
_NAMED = 5


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
    others = {_namespace(item.topic) for item in collector.plans} - {spaces[0]}
    return _Builder(collector, reader, spaces[0], others).flight()


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
        self._said: dict[str, tuple[int, str]] = {}

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
        """Keep changes of level, and of the words of a trouble; the figures among them change every second."""
        for status in item.message.status:
            # The definition calls the level a byte.
            level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
            words = re.sub(r"[-+]?\d[\d.,e+-]*", "#", status.message) if level else ""
            if (level, words) != self._said.get(status.name, (0, "")):
                self.diagnostics.append((item.sent_s, status.name, level, status.message))
            self._said[status.name] = level, words


class _Builder:
    """Makes a flight of what was collected, for the fleet in one namespace, beside which there may be others."""

    def __init__(self, collected: _Collector, reader: RecordingReader, namespace: str, others: set[str]) -> None:
        self._collected = collected
        self._parameters = reader.parameters
        self._prefix = namespace.rstrip("/") + "/"
        self._others = others
        self._notes = list(reader.notes)
        self._fleet = _fleet(reader.fleet_text, self._notes)
        self._frame = None if self._fleet is None else LocalFrame(self._fleet.origin)
        self._began_s = collected.began_s
        self._map_frame = self._parameter("map_frame", "map")
        self._timeout_s = float(self._parameter("device_timeout_s", 0.0)) or math.inf
        # The planner's own table: what it ignores or takes as left must not count here.
        self._table = DeviceTable()
        self._named: dict[str, float] = {}
        self._devices: dict[str, list[DeviceReport]] = {}
        self._changes: list[ReportedChange] = []

    def flight(self) -> Flight:
        collected, began_s = self._collected, self._began_s
        duration_s = collected.ended_s - began_s
        for item in sorted(collected.reports, key=lambda item: item.sent_s):
            if item.topic.startswith(self._prefix):
                self._add_report(item.sent_s - began_s, item)
        self._expire(duration_s)
        plans = [self._plan(item) for item in collected.plans if item.topic.startswith(self._prefix)]
        return Flight(
            began_s=began_s,
            duration_s=duration_s,
            fleet=self._fleet,
            bandwidth_hz=float(self._parameter("bandwidth_hz", 1.0)),
            plans=tuple(sorted(plans, key=lambda plan: plan.at_s)),
            devices=self._devices,
            changes=tuple(self._changes),
            tracks=self._tracks(),
            diagnostics=tuple(
                (at_s - began_s, name, level, message)
                for at_s, name, level, message in collected.diagnostics
                if _namespace("/" + name.partition(":")[0].lstrip("/")).rstrip("/") + "/" == self._prefix
            ),
            log=tuple((at_s - began_s, line) for at_s, line in collected.log if self._is_own_logger(line.name)),
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

    def _is_own_logger(self, name: str) -> bool:
        """Whether a logger, e.g. `team_a.bridge`, is of a node of this fleet and not of one beside it."""

        def within(namespace: str) -> bool:
            return f"{name}.".startswith(namespace.strip("/").replace("/", ".") + ".")

        if self._prefix != "/":
            return within(self._prefix)
        return not any(within(other) for other in self._others)

    def _add_report(self, at_s: float, item: Told) -> None:
        update = item.message
        if item.type_name == DEVICES and update.header.frame_id != self._map_frame:
            self._add_note(
                f"device reports in frame {update.header.frame_id!r} are left out, as the planner leaves them out:"
                f" its map_frame is {self._map_frame!r}"
            )
            return
        self._expire(at_s)
        reported = list(self._reported(item))
        self._named |= {entry.id: at_s for entry in reported}
        changes = self._table.apply(reported, update.departed, snapshot=update.snapshot, now_s=at_s)
        changed = {*changes.joined, *changes.moved, *changes.demanded}
        for device in self._table.devices if changed else ():
            if device.id in changed:
                known = DeviceReport(at_s, device.position, device.rate_demand, device.weight)
                self._devices.setdefault(device.id, []).append(known)
        for name in changes.left:
            self._leave(name, at_s)
        told = {
            "joined": changes.joined,
            "moved": changes.moved,
            "changed demand": changes.demanded,
            "left": changes.left,
        }
        what = "; ".join(f"{len(ids)} {verb}: {_listed(ids)}" for verb, ids in told.items() if ids)
        if what:
            self._changes.append(ReportedChange(at_s, what))

    def _expire(self, now_s: float) -> None:
        """Take devices that no report names for the planner's `device_timeout_s` as left, from then on."""
        left: dict[float, list[str]] = {}
        for name in self._table.expire(now_s, self._timeout_s):
            left.setdefault(self._named[name] + self._timeout_s, []).append(name)
        for at_s, names in sorted(left.items()):
            for name in names:
                self._leave(name, at_s)
            what = f"{len(names)} not reported for {self._timeout_s:g} s, taken as left: {_listed(names)}"
            self._changes.append(ReportedChange(at_s, what, reported=False))

    def _leave(self, name: str, at_s: float) -> None:
        self._devices[name].append(DeviceReport(at_s, self._devices[name][-1].position, 0.0))

    def _reported(self, item: Told) -> Iterable[Device | Fault]:
        for device in item.message.devices:
            if item.type_name == DEVICES:
                position = (device.position.x, device.position.y)
            elif self._frame is None:
                self._add_note("devices in latitude and longitude are left out: the recording has no fleet file")
                return
            else:
                try:
                    position = self._frame.to_map(device.latitude, device.longitude)
                except ValueError as error:
                    yield Fault(device.id, "position", str(error))
                    continue
            yield Device(device.id, position, device.rate_demand, device.weight)

    def _parameter(self, name: str, default: Any) -> Any:
        """Value of a parameter of the planner, or how it comes if it was not recorded."""
        for node, values in self._parameters.items():
            if _namespace(node) == (self._prefix.rstrip("/") or "/") and "bandwidth_hz" in values:
                return values.get(name, default)
        self._add_note("the planner's parameters were not recorded: bandwidth_hz is taken as 1")
        return default

    def _add_note(self, note: str) -> None:
        if note not in self._notes:
            self._notes.append(note)


def _namespace(topic: str) -> str:
    return topic.rpartition("/")[0] or "/"


def _listed(names: Sequence[str]) -> str:
    """Name the first of many."""
    more = len(names) - _NAMED
    return ", ".join(names[:_NAMED]) + (f" and {more} more" if more > 0 else "")


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

"""What the page shows, kept as one JSON document: whole for a page that opens, as changes for those that are open."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from typing import Any

from jpap_ros.dashboard.event_log import EventLog
from jpap_ros.dashboard.narrator import TROUBLED_GOALS, device_lines, plan_lines, status_line, vehicle_lines
from jpap_ros.dashboard.records import ERROR, OK, Plan, Point, Pose, Status, Vehicle
from jpap_ros.planning.devices import Changes, Device

Json = dict[str, Any]

#: A part that says something every second is taken for silent after so long [s].
STALE_AFTER_S = 5.0
#: Positions kept of each track, and the way between two of them [m].
TRACK_POINTS, TRACK_STEP_M = 200, 3.0
#: Diagnostic statuses kept; more are ignored, so that nobody fills memory with names.
MAX_STATUSES = 2000
#: An aircraft as near to its cell's place serves it: the rates differ from the plan's by a few per cent at most [m].
AT_CELL_M = 15.0
#: Silence shorter than this is not shown, so that it is not sent again and again [s].
_FRESH_S = 2.0


class FleetView:
    """Devices, aircraft, plan and health as the page shows them.

    Not thread-safe: everything is called on the server's thread.

    Parameters
    ----------
    uavs : iterable of str
        Names in the fleet file.
    log : EventLog
    clock : callable
        Monotonic time [s].
    """

    def __init__(self, uavs: Iterable[str], log: EventLog, clock: Callable[[], float] = time.monotonic) -> None:
        self.log = log
        self.names = tuple(uavs)
        self.devices: dict[str, Device] = {}
        self.vehicles: dict[str, Vehicle] = {}
        self.plan: Plan | None = None
        self._clock = clock
        self._poses: dict[str, Pose] = {}
        self._goals: dict[str, Point] = {}
        self._cells: dict[str, Point] = {}
        self._left_out: dict[str, str] = {}
        self._heard: dict[str, float] = {}
        self._tracks: dict[str, deque[tuple[float, float]]] = {name: deque(maxlen=TRACK_POINTS) for name in self.names}
        self._statuses: dict[tuple[str, str], Status] = {}
        self._planners: frozenset[str] = frozenset()
        self._bridges: frozenset[str] = frozenset()
        self._last_data_s: float | None = None
        # What the pages have been told, to tell them only what differs.
        self._told_uavs: dict[str, Json] = {name: {} for name in self.names}
        self._told_devices: dict[str, Json] = {}
        self._told_health: Json = {}
        self._told_event = 0
        self._changed_uavs = set(self.names)
        self._changed_devices: set[str] = set()
        self._plan_changed = False
        self._told_s = -math.inf

    # What comes from the graph

    def set_pose(self, name: str, pose: Pose) -> None:
        """Take in where an aircraft is."""
        if not all(map(math.isfinite, pose.position)):
            return
        self._touch(f"pose {name}")
        self._poses[name] = pose
        track, (east, north, _) = self._tracks[name], pose.position
        if not track or math.dist(track[-1], (east, north)) >= TRACK_STEP_M:
            track.append((round(east, 1), round(north, 1)))

    def set_vehicle(self, name: str, vehicle: Vehicle) -> None:
        """Take in what the bridge knows of an aircraft."""
        self._touch("bridge")
        for level, text in vehicle_lines(name, self.vehicles.get(name), vehicle):
            self.log.add(level, "aircraft", text)
        self.vehicles[name] = vehicle
        self._changed_uavs.add(name)

    def set_goal(self, name: str, goal: Point) -> None:
        """Take in where an aircraft should hover."""
        self._touch()
        if all(map(math.isfinite, goal)):
            self._goals[name] = goal
            self._changed_uavs.add(name)

    def set_devices(self, devices: Iterable[Device], changes: Changes) -> None:
        """Take in all present devices, and what has just changed of them."""
        self._touch()
        before, self.devices = self.devices, {device.id: device for device in devices}
        self._changed_devices |= {name for name in before if name not in self.devices}
        self._changed_devices |= {name for name, device in self.devices.items() if before.get(name) != device}
        told = {
            "joined": changes.joined,
            "moved": changes.moved,
            "changed demand": changes.demanded,
            "left": changes.left,
        }
        for level, text in device_lines(told):
            self.log.add(level, "devices", text)

    def set_plan(self, plan: Plan) -> None:
        """Take in the deployment in force."""
        self._touch("planner")
        for level, text in plan_lines(self.plan, plan):
            self.log.add(level, "plan", text)
        # Whoever had a cell and has none now has no goal either; a relief on its way has one without a cell.
        for cell in self.plan.cells if self.plan is not None else ():
            self._goals.pop(cell.uav, None)
        for cell in plan.cells:
            if cell.uav in self._told_uavs and all(map(math.isfinite, cell.position)):
                self._goals[cell.uav] = cell.position
        self.plan, self._plan_changed = plan, True
        self._cells = {cell.uav: cell.position for cell in plan.cells}
        self._left_out = plan.left_out
        self._changed_uavs |= set(self.names)
        self._changed_devices |= set(self.devices)

    def set_statuses(self, statuses: Iterable[Status]) -> None:
        """Take in what nodes say of themselves."""
        for status in statuses:
            key = (status.node, status.part)
            if key not in self._statuses and len(self._statuses) >= MAX_STATUSES:
                continue
            if status.node in self._planners:
                self._touch("planner")
            self._touch(f"status {status.node} {status.part}")
            line = status_line(self._statuses.get(key), status)
            if line and not self._is_told(status):
                self.log.add(line[0], "node", line[1])
            self._statuses[key] = status
            if status.part in self._told_uavs:
                self._changed_uavs.add(status.part)

    def set_roles(self, planners: Iterable[str], bridges: Iterable[str]) -> None:
        """Take in which nodes publish the deployment, and which the aircraft's states."""
        roles = frozenset(planners), frozenset(bridges)
        if roles != (self._planners, self._bridges):
            self._planners, self._bridges = roles
            self._changed_uavs |= set(self.names)

    def _is_told(self, status: Status) -> bool:
        """Whether an aircraft's own state says the same, or will: the log must not say it twice."""
        if status.part not in self._told_uavs:
            return False
        vehicle = self.vehicles.get(status.part)
        if vehicle is None or status.node not in self._bridges:
            return True
        return vehicle.link != "connected" or vehicle.goal in TROUBLED_GOALS or vehicle.battery_low

    def _touch(self, source: str = "") -> None:
        self._last_data_s = self._clock()
        if source:
            self._heard[source] = self._last_data_s

    # What goes to the pages

    def snapshot(self) -> Json:
        """Everything, for a page that opens."""
        places = self._places()
        return {
            "type": "snapshot",
            "now": time.time(),
            "uavs": {name: self._state(name) | self._motion(name) for name in self.names},
            "tracks": {name: list(track) for name, track in self._tracks.items() if track},
            "devices": {name: self._device(name, places) for name in self.devices},
            "plan": self._plan(),
            "health": self._health(),
            "events": [asdict(event) for event in self.log.since(0)],
        }

    def delta(self) -> Json:
        """What changed since the last call; null for a device that has left. Changes are to be merged by key."""
        delta: Json = {"type": "delta", "now": time.time()}
        uavs = {}
        for name in self.names:
            entry = self._motion(name)
            if name in self._changed_uavs:
                entry |= self._state(name)
            told = self._told_uavs[name]
            if changed := _difference(told, entry):
                uavs[name] = changed
                told.update(changed)
        self._changed_uavs.clear()
        devices: Json = {}
        if self._changed_devices:
            places = self._places()
            for name in self._changed_devices:
                if name not in self.devices:
                    if self._told_devices.pop(name, None) is not None:
                        devices[name] = None
                    continue
                entry = self._device(name, places)
                if changed := _difference(self._told_devices.get(name, {}), entry):
                    devices[name] = changed
                    self._told_devices[name] = entry
            self._changed_devices.clear()
        if uavs:
            delta["uavs"] = uavs
        if devices:
            delta["devices"] = devices
        if self._plan_changed:
            delta["plan"], self._plan_changed = self._plan(), False
        health = self._health()
        if health != self._told_health:
            delta["health"] = self._told_health = health
        if events := self.log.since(self._told_event):
            delta["events"] = [asdict(event) for event in events]
            self._told_event = self.log.last
        return delta

    def _state(self, name: str) -> Json:
        """What changes now and then of an aircraft."""
        vehicle = self.vehicles.get(name)
        goal = self._goals.get(name)
        entry: Json = {"goal_at": None if goal is None else [_tenth(value) for value in goal]}
        if vehicle is None:
            return entry | {"link": "never seen"}
        return entry | {
            "link": vehicle.link,
            "autopilot": vehicle.autopilot,
            "mode": vehicle.mode,
            "armed": vehicle.armed,
            "landed": vehicle.landed,
            "emergency": vehicle.emergency,
            "battery": None if vehicle.battery is None else round(vehicle.battery, 2),
            "battery_low": vehicle.battery_low,
            "goal": vehicle.goal,
            "taken_over": vehicle.taken_over,
            "plan_id": vehicle.plan_id,
            "reason": vehicle.reason,
            "distance": None if vehicle.distance_m is None else _tenth(vehicle.distance_m),
            **self._link_figures(name),
        }

    def _motion(self, name: str) -> Json:
        """What changes with every pose."""
        vehicle, pose = self.vehicles.get(name), self._poses.get(name)
        if vehicle is None:
            return {}
        position = pose.position if pose is not None else vehicle.position
        entry: Json = {"age": _finite(self._age(f"pose {name}")), "serving": self._is_serving(name, vehicle, position)}
        if position is not None:
            entry["x"], entry["y"], entry["z"] = (_tenth(value) for value in position)
        if pose is not None and math.isfinite(pose.heading_deg):
            entry["heading"] = round(pose.heading_deg) % 360
        return entry

    def _is_serving(self, name: str, vehicle: Vehicle, position: Point | None) -> bool:
        """Whether an aircraft is where the plan has it serve; the goal that it reached may be one of before."""
        cell = self._cells.get(name)
        there = cell is not None and position is not None and math.dist(position, cell) <= AT_CELL_M
        return there and vehicle.link == "connected" and vehicle.goal == "reached"

    def _link_figures(self, name: str) -> Json:
        """Age of the newest heartbeat [s] and share of the aircraft's messages lost, as the bridge tells."""
        status = next((s for node in self._bridges if (s := self._statuses.get((node, name)))), None)
        values = status.values if status is not None else {}
        losses = [_number(value) for key, value in values.items() if key.startswith("loss on ")]
        known = [loss for loss in losses if loss is not None]
        age = _number(values.get("heartbeat age [s]"))
        return {
            "link_age": None if age is None else 0 if age < _FRESH_S else math.floor(age),
            "loss": round(max(known) / 100.0, 2) if known else None,
        }

    def _places(self) -> dict[str, tuple[int, float]]:
        """Cell and rate [bit/s] of each device that the plan serves."""
        if self.plan is None:
            return {}
        return {device: (i, rate) for i, cell in enumerate(self.plan.cells) for device, rate in cell.rates.items()}

    def _device(self, name: str, places: Mapping[str, tuple[int, float]]) -> Json:
        device = self.devices[name]
        cell, rate = places.get(name, (None, None))
        return {
            "x": round(device.position[0], 2),
            "y": round(device.position[1], 2),
            "demand": device.rate_demand,
            "weight": device.weight,
            "cell": cell,
            "rate": None if rate is None else _figures(rate),
            "reason": self._left_out.get(name, ""),
        }

    def _plan(self) -> Json | None:
        plan = self.plan
        if plan is None:
            return None
        return {
            "id": plan.id,
            "reason": plan.reason,
            "scheme": plan.scheme,
            "proof": plan.proof(),
            "proven": plan.proven,
            "unserved": self._left_out,
            "average_rate": _finite(plan.average_rate),
            "average_rate_bound": _finite(plan.average_rate_bound),
            "interrupted": list(plan.interrupted),
            "planning_s": plan.planning_s,
            "cells": [
                {
                    "uav": cell.uav,
                    "at": [_tenth(value) for value in cell.position],
                    "rate": _figures(cell.uav_rate),
                    "radius": None if cell.radius_m is None else _tenth(cell.radius_m),
                    "devices": len(cell.rates),
                }
                for cell in plan.cells
            ],
        }

    def _health(self) -> Json:
        own = {(s.node, s.part): s for s in self._statuses.values()}
        planner = next((s for s in own.values() if s.node in self._planners), None)
        links = [s for s in own.values() if s.node in self._bridges and s.part.startswith("link ")]
        lost = [name for name, vehicle in self.vehicles.items() if vehicle.link == "lost"]
        return {
            "planner": {
                **self._voice("planner"),
                "level": planner.level if planner else OK,
                "message": planner.message if planner else "",
            },
            "bridge": {
                **self._voice("bridge"),
                "level": max((s.level for s in links), default=OK),
                "message": "; ".join(f"{s.part}: {s.message}" for s in links if s.level != OK),
            },
            "lost": lost,
            "others": [
                {"node": s.node, "part": s.part, "message": s.message, "error": s.level >= ERROR}
                for (node, part), s in own.items()
                if s.level != OK
                and node not in self._planners | self._bridges
                and part not in self._told_uavs
                and self._age(f"status {node} {part}") < STALE_AFTER_S
            ][:10],
            "last_data": None if self._last_data_s is None else self._age_of(self._last_data_s),
        }

    def _voice(self, source: str) -> Json:
        """Whether a part was ever heard, and for how long it is silent now [s]."""
        heard = source in self._heard
        age = self._age(source) if heard else 0.0
        return {"heard": heard, "silent_s": age if age > STALE_AFTER_S else 0}

    def _age(self, source: str) -> float:
        heard = self._heard.get(source)
        return math.inf if heard is None else self._age_of(heard)

    def _age_of(self, heard_s: float) -> float:
        age = self._clock() - heard_s
        return 0 if age < _FRESH_S else math.floor(age)


def _difference(told: Mapping[str, Any], now: Mapping[str, Any]) -> Json:
    return {key: value for key, value in now.items() if key not in told or told[key] != value}


def _tenth(value: float) -> float:
    return round(value, 1)


def _figures(value: float) -> float:
    return float(f"{value:.6g}")


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _number(text: str | None) -> float | None:
    try:
        return _finite(float(text)) if text is not None else None
    except ValueError:
        return None

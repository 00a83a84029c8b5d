"""A flight: devices, plans and aircraft over time."""

from __future__ import annotations

import math
from array import array
from bisect import bisect_right
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from jpap_ros.fleet.config import FleetConfig

Floats = npt.NDArray[np.float64]

#: Positions further apart in time say nothing of what was between them [s].
MAX_POSITION_GAP_S = 5.0
#: Below this height an aircraft is on or near its pad [m].
FLYING_ABOVE_M = 2.0

_CONNECTED = 1
#: MAV_LANDED_STATE: in the air, taking off, landing.
_AIRBORNE = (2, 3, 4)
#: GOAL_REJECTED, GOAL_YIELDED, GOAL_LOST.
_GOAL_TROUBLE = (5, 6, 7)


@dataclass(frozen=True, slots=True)
class DeviceReport:
    """What was known of a device from a moment on; `demand` is 0 once it has left [bit/s]."""

    at_s: float
    position: tuple[float, float]
    demand: float
    weight: float = 1.0


@dataclass(frozen=True)
class ReportedChange:
    """What changed of the devices: when [s], in words, and whether by a report or for want of one."""

    at_s: float
    what: str
    reported: bool = True


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
    """Where an aircraft was told to be, and its states.

    Attributes
    ----------
    times : array of float
        Of the positions [s].
    points : array of float
        East, north and up [m] of each, one after the other.
    states : list of (float, object)
        States that differ from the one before in more than figures, and when they were told [s].
    charge_times, charge : array of float
        When a battery was told [s], and what was left of it [0..1].
    """

    times: array[float] = field(default_factory=lambda: array("d"))
    points: array[float] = field(default_factory=lambda: array("d"))
    states: list[tuple[float, Any]] = field(default_factory=list)
    charge_times: array[float] = field(default_factory=lambda: array("d"))
    charge: array[float] = field(default_factory=lambda: array("d"))

    def add_pose(self, at_s: float, place: tuple[float, float, float]) -> None:
        """Take in a position; one that is no newer than the last is left out."""
        if not self.times or at_s > self.times[-1]:
            self.times.append(at_s)
            self.points.extend(place)

    def add_state(self, at_s: float, state: Any) -> None:
        """Take in a state."""
        if not self.states or _signature(state) != _signature(self.states[-1][1]):
            self.states.append((at_s, state))
        if math.isfinite(state.battery_remaining):
            self.charge_times.append(at_s)
            self.charge.append(state.battery_remaining)

    @property
    def places(self) -> Floats:
        """Return (K, 3) positions [m]."""
        return np.array(self.points).reshape(-1, 3)

    def positions(self, grid: Floats) -> Floats:
        """Return (T, 3) positions, linear in between; NaN where none was told for too long."""
        if not self.times:
            return np.full((len(grid), 3), math.nan)
        times, points = np.array(self.times), self.places
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
    diagnostics : tuple of (float, str, int, str)
        Changes of a status's level or trouble: when, of which status, to which level, and its message.
    log : tuple of (float, object)
        Lines of warnings and errors.
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
    diagnostics: tuple[tuple[float, str, int, str], ...]
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


def held(times: Floats, values: npt.NDArray[Any], grid: Floats, before: Any) -> npt.NDArray[Any]:
    """Return at each moment the newest of (K,) values that hold from `times` on; `before` where there is none yet."""
    index = np.searchsorted(times, grid, side="right")
    return np.concatenate([np.array([before], dtype=values.dtype), values])[index]


def _signature(state: Any) -> tuple[Any, ...]:
    """What makes a state another one; figures do not."""
    return (
        state.link,
        state.autopilot,
        state.mode,
        state.armed,
        state.landed_state,
        state.goal_state,
        state.goal_reason if state.goal_state in _GOAL_TROUBLE else "",
    )

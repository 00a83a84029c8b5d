"""What rate each device got over time, from where its aircraft really was, and for how much of it that was enough."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from jpap_ros.report.flight import Flight, Floats, Plan, held

#: An aircraft that hovers within a metre of its goal serves a rate that differs from the plan's by less than this.
RATE_TOLERANCE = 0.01


@dataclass(frozen=True)
class DeviceService:
    """One device over the moments of a grid.

    Attributes
    ----------
    name : str
    demand : (T,) ndarray
        Demanded rate [bit/s]; 0 while the device is not there.
    rate : (T,) ndarray
        Served rate [bit/s].
    """

    name: str
    demand: Floats
    rate: Floats

    @property
    def present(self) -> npt.NDArray[np.bool_]:
        """When the device is there."""
        return self.demand > 0.0

    @property
    def satisfied(self) -> npt.NDArray[np.bool_]:
        """When it gets what it demands, but for `RATE_TOLERANCE`."""
        return self.present & (self.rate >= (1.0 - RATE_TOLERANCE) * self.demand)

    @property
    def availability(self) -> float:
        """Share of its time for which it gets what it demands; NaN if it was never there."""
        there = np.count_nonzero(self.present)
        return float(np.count_nonzero(self.satisfied) / there) if there else float("nan")


def overall_availability(services: list[DeviceService]) -> float:
    """Share of all device time for which devices got what they demand."""
    there = sum(np.count_nonzero(service.present) for service in services)
    return float(sum(np.count_nonzero(s.satisfied) for s in services) / there) if there else float("nan")


def served_rates(flight: Flight, grid: Floats) -> list[DeviceService]:
    """Rates of every device that was reported, in the order of the reports.

    Notes
    -----
    A plan gives the rate that a device gets with its power from its aircraft's goal. From elsewhere the rate follows
    from equations (1) to (3) of the paper: the signal-to-noise ratio falls with the square of the distance, so it is
    that at the goal times (distance from the goal / distance from the aircraft)^2, both in space. No rate is served by
    an aircraft on the ground, of unknown position or without a link to the bridge.
    """
    services = {name: np.zeros(len(grid)) for name in flight.devices}
    places = {name: track.positions(grid) for name, track in flight.tracks.items()}
    airborne = {name: track.airborne(grid) for name, track in flight.tracks.items()}
    ends = [plan.at_s for plan in flight.plans[1:]] + [np.inf]
    for plan, end_s in zip(flight.plans, ends, strict=True):
        span = np.flatnonzero((grid >= plan.at_s) & (grid < end_s))
        for cell in plan.message.cells:
            if len(span) and cell.uav in places:
                flown = span[airborne[cell.uav][span]]
                for name, rate in zip(cell.device_ids, cell.rate, strict=True):
                    if name in services:
                        here = places[cell.uav][flown]
                        services[name][flown] = _rates(flight, plan, cell, name, rate, grid[flown], here)
    return [DeviceService(name, _demand(flight, name, grid), rate) for name, rate in services.items()]


def _rates(
    flight: Flight, plan: Plan, cell: Any, name: str, planned_rate: float, moments: Floats, places: Floats
) -> Floats:
    goal = cell.goal_pose.position
    planned_for = flight.device_at(name, plan.began_s) or flight.devices[name][0]
    goal_m2 = _squared((goal.x, goal.y, goal.z), planned_for.position)
    reports = flight.devices[name]
    positions = held(np.array([r.at_s for r in reports]), np.arange(len(reports)), moments, 0)
    device = np.array([report.position for report in reports])[positions]
    here_m2 = np.sum((places[:, :2] - device) ** 2, axis=1) + places[:, 2] ** 2
    snr = np.expm1(np.log(2.0) * planned_rate / flight.bandwidth_hz) * goal_m2 / here_m2
    rates: Floats = flight.bandwidth_hz * np.log2(1.0 + snr)
    return rates


def _squared(goal: tuple[float, float, float], device: tuple[float, float]) -> float:
    return (goal[0] - device[0]) ** 2 + (goal[1] - device[1]) ** 2 + goal[2] ** 2


def _demand(flight: Flight, name: str, grid: Floats) -> Floats:
    reports = flight.devices[name]
    times, demands = np.array([r.at_s for r in reports]), np.array([r.demand for r in reports])
    return held(times, demands, grid, 0.0)

"""The report's pictures, as SVG text."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import LogFormatter, MaxNLocator

from jpap_ros.report.flight import Flight, Floats, held
from jpap_ros.report.latency import Answer
from jpap_ros.report.motion import Separation
from jpap_ros.report.service import RATE_TOLERANCE, DeviceService
from jpap_ros.study.style import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, VERMILLION, figure_style

_WIDTH_IN = 10.5
#: Points drawn of one line.
_MOST_POINTS = 1500
#: Lines with more points in all become an image within the picture.
_MOST_VECTOR_POINTS = 20_000
_LINES = (BLUE, ORANGE, GREEN, VERMILLION, PURPLE, BLACK, GREY)
_DASHES = ("-", "--", "-.", ":")
_MOST_LABELLED = 45
_MOST_IN_LEGEND = 24
_WORST_SHOWN = 6


class TimeAxis:
    """Time since the beginning, in the unit that suits the duration."""

    def __init__(self, duration_s: float) -> None:
        self.unit, self._seconds = ("s", 1.0) if duration_s <= 600 else ("min", 60.0)
        if duration_s > 4 * 3600:
            self.unit, self._seconds = "h", 3600.0
        self._end = max(duration_s, 1.0) / self._seconds

    def of(self, seconds: Floats | Sequence[float]) -> Floats:
        """Seconds in the axis's unit."""
        return np.asarray(seconds, dtype=float) / self._seconds

    def dress(self, axes: Axes) -> None:
        """Label an axis with it."""
        axes.set_xlim(0.0, self._end)
        axes.set_xlabel(f"time since the recording began [{self.unit}]")


@contextmanager
def _style() -> Iterator[None]:
    """Settings within which the pictures are drawn; an id is shown as it is, and `$` in it begins no formula."""
    with figure_style(), plt.rc_context({"text.parse_math": False}):
        yield


@contextmanager
def _picture(height_in: float, columns: int = 1) -> Iterator[tuple[Figure, list[Axes]]]:
    with _style():
        figure, axes = plt.subplots(1, columns, figsize=(_WIDTH_IN, height_in), squeeze=False, layout="constrained")
        try:
            yield figure, list(axes[0])
        finally:
            plt.close(figure)


def _svg(figure: Figure) -> str:
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None}, dpi=110, bbox_inches="tight")
    return text.getvalue()


def _mark_plans(axes: Axes, flight: Flight, time: TimeAxis) -> None:
    for at_s in time.of([plan.at_s for plan in flight.plans]):
        axes.axvline(float(at_s), color=GREY, linewidth=0.6, linestyle=":", zorder=0)


def service_map(flight: Flight, grid: Floats, services: Sequence[DeviceService]) -> str:
    """Every device's share of its demand over time, the worst on top."""
    time = TimeAxis(flight.duration_s)
    ordered = sorted(services, key=lambda service: (service.availability, service.name))
    shares = np.array([np.where(s.present, s.rate / np.where(s.present, s.demand, 1.0), np.nan) for s in ordered])
    # Light to dark in one hue, and one clear step at the demand: told apart without seeing colours.
    levels = [0.0, 0.001, 0.5, 0.8, 0.9, 1.0 - RATE_TOLERANCE, 10.0]
    colours = ListedColormap(["#7A1C00", "#B5460F", "#E07B39", "#F2B27E", "#FBE3CC", "#2A78B5"]).with_extremes(
        bad="#F3F4F6"
    )
    with _picture(min(12.0, max(2.4, 1.2 + 0.16 * len(ordered)))) as (figure, (axes,)):
        mesh = axes.imshow(
            np.ma.masked_invalid(shares),
            aspect="auto",
            interpolation="nearest",
            extent=(*time.of([0.0, flight.duration_s or 1.0]), len(ordered) - 0.5, -0.5),
            cmap=colours,
            norm=BoundaryNorm(levels, colours.N),
        )
        axes.grid(visible=False)
        if len(ordered) <= _MOST_LABELLED:
            axes.set_yticks(range(len(ordered)), [s.name for s in ordered], fontsize=7)
        else:
            axes.set_ylabel(f"{len(ordered)} devices, the worst served on top")
        bar = figure.colorbar(mesh, ax=axes, spacing="uniform", ticks=levels[:-1], pad=0.01, fraction=0.03)
        bar.ax.set_yticklabels(["none", "", "50 %", "80 %", "90 %", "demand"], fontsize=7)
        _mark_plans(axes, flight, time)
        time.dress(axes)
        return _svg(figure)


def worst_devices(flight: Flight, grid: Floats, services: Sequence[DeviceService]) -> str:
    """Served rate against demand of the devices that were served worst."""
    time = TimeAxis(flight.duration_s)
    worst = sorted(services, key=lambda service: (service.availability, service.name))[:_WORST_SHOWN]
    keep = _thinned(len(grid), _MOST_POINTS)
    columns = 3
    rows = math.ceil(len(worst) / columns)
    with _style():
        figure, panels = plt.subplots(
            rows, columns, figsize=(_WIDTH_IN, 1.9 * rows), squeeze=False, sharex=True, layout="constrained"
        )
        for axes, service in zip(panels.flat, worst, strict=False):
            there = np.where(service.present, 1.0, np.nan)[keep]
            axes.step(time.of(grid[keep]), service.demand[keep] * there, color=BLACK, linestyle="--", label="demand")
            axes.plot(time.of(grid[keep]), service.rate[keep] * there, color=BLUE, label="served")
            axes.set_title(f"{service.name}: {100 * service.availability:.1f} %", loc="left")
            axes.set_ylim(bottom=0.0)
            axes.set_ylabel("rate [bit/s]")
        for axes in list(panels.flat)[len(worst) :]:
            axes.set_visible(False)
        for axes in panels[-1]:
            time.dress(axes)
        panels[0][0].legend(loc="lower right")
        text = _svg(figure)
        plt.close(figure)
        return text


def totals(flight: Flight, grid: Floats, services: Sequence[DeviceService]) -> str:
    """Demanded and served rate of all devices, and how many of them were satisfied."""
    time = TimeAxis(flight.duration_s)
    keep = _thinned(len(grid), _MOST_POINTS)
    demand = np.sum([s.demand for s in services], axis=0)
    rate = np.sum([np.where(s.present, np.minimum(s.rate, s.demand), 0.0) for s in services], axis=0)
    there = np.sum([s.present for s in services], axis=0)
    satisfied = np.sum([s.satisfied for s in services], axis=0)
    with _picture(2.5, 2) as (figure, (rates, counts)):
        rates.step(time.of(grid[keep]), demand[keep], where="post", color=BLACK, linestyle="--", label="demanded")
        rates.plot(time.of(grid[keep]), rate[keep], color=BLUE, label="served, of what is demanded")
        rates.set_ylabel("sum of rates [bit/s]")
        counts.step(time.of(grid[keep]), there[keep], where="post", color=BLACK, linestyle="--", label="present")
        counts.step(time.of(grid[keep]), satisfied[keep], where="post", color=BLUE, label="get their demand")
        counts.set_ylabel("devices")
        for axes in (rates, counts):
            axes.set_ylim(bottom=0.0)
            axes.legend(loc="lower right")
            _mark_plans(axes, flight, time)
            time.dress(axes)
        return _svg(figure)


def fleet_size(flight: Flight, grid: Floats) -> str:
    """UAVs in use and in the air against the proven minimum."""
    time = TimeAxis(flight.duration_s)
    keep = _thinned(len(grid), _MOST_POINTS)
    at_s = np.array([plan.at_s for plan in flight.plans])
    used = held(at_s, np.array([float(len(plan.message.cells)) for plan in flight.plans]), grid, np.nan)
    bounds = [float(plan.message.min_uavs_bound) for plan in flight.plans]
    proven = held(at_s, np.array([np.nan if bound < 0 else bound for bound in bounds]), grid, np.nan)
    flying = np.zeros(len(grid))
    for track in flight.tracks.values():
        flying += track.airborne(grid)
    with _picture(2.6) as (figure, (axes,)):
        axes.fill_between(
            time.of(grid[keep]), flying[keep], step="post", color=GREY, alpha=0.25, linewidth=0, label="in the air"
        )
        axes.step(time.of(grid[keep]), used[keep], where="post", color=BLUE, label="in use (cells of the plan)")
        axes.step(
            time.of(grid[keep]), proven[keep], where="post", color=VERMILLION, linestyle="--", label="proven minimum"
        )
        axes.set_ylim(bottom=0.0)
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_ylabel("UAVs")
        axes.legend(loc="lower right", ncols=3)
        _mark_plans(axes, flight, time)
        time.dress(axes)
        return _svg(figure)


def latencies(flight: Flight, answered: Sequence[Answer]) -> str:
    """How long planning took, and how long reports waited for their plan."""
    time = TimeAxis(flight.duration_s)
    with _picture(2.6) as (figure, (axes,)):
        axes.plot(
            time.of([plan.at_s for plan in flight.plans]),
            [1000.0 * plan.planning_s for plan in flight.plans],
            "o",
            color=BLUE,
            label="planning",
        )
        axes.plot(
            time.of([answer.at_s for answer in answered]),
            [1000.0 * answer.latency_s for answer in answered],
            "D",
            color=VERMILLION,
            markerfacecolor="white",
            label="device report to deployment",
        )
        axes.set_yscale("log")
        axes.margins(y=0.25)
        axes.yaxis.set_major_formatter("{x:g}")
        # In plain figures, too: the usual one writes formulas.
        axes.yaxis.set_minor_formatter(LogFormatter())
        axes.set_ylabel("duration [ms]")
        axes.legend(loc="best")
        time.dress(axes)
        return _svg(figure)


def tracks(flight: Flight, grid: Floats, flown: Mapping[str, float]) -> str:
    """Draw the map: tracks, and devices and cells as they were in the end."""
    keep = _thinned(len(grid), _MOST_POINTS)
    places = {name: track.positions(grid)[keep] for name, track in flight.tracks.items()}
    places = {name: points[np.isfinite(points[:, 0])] for name, points in places.items()}
    moved = [name for name, points in places.items() if len(points) and flown[name] > 0.0]
    parked = [points[-1] for name, points in places.items() if len(points) and name not in moved]
    coarse = sum(len(places[name]) for name in moved) > _MOST_VECTOR_POINTS
    with _picture(_map_height(flight, [places[name] for name in moved])) as (figure, (axes,)):
        for index, name in enumerate(moved):
            points, colour = places[name], _LINES[index % len(_LINES)]
            axes.plot(points[:, 0], points[:, 1], color=colour, linewidth=1.2, alpha=0.8, rasterized=coarse)
            axes.plot(*points[0, :2], "s", color=colour, markersize=3.0)
            axes.plot(*points[-1, :2], "^", color=colour, markersize=7.0, markeredgecolor="white", zorder=3)
            if len(moved) <= _MOST_LABELLED:
                axes.annotate(name, points[-1, :2], (5, 5), textcoords="offset points", fontsize=8, color=colour)
        if parked:
            axes.plot(*np.array(parked)[:, :2].T, "s", color=GREY, markersize=3.0, linestyle="none", label="parked")
        _devices_and_cells(axes, flight)
        _fence(axes, flight)
        axes.set_aspect("equal")
        axes.set_xlabel("east [m]")
        axes.set_ylabel("north [m]")
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return _svg(figure)


def _map_height(flight: Flight, tracks_m: Sequence[Floats]) -> float:
    """Height that suits the shape of what is on the map [in]."""
    devices = [report.position for reports in flight.devices.values() for report in reports]
    points = np.concatenate([np.array(devices).reshape(-1, 2), *(points[:, :2] for points in tracks_m)])
    if len(points) < 2:
        return 5.0
    width, height = np.ptp(points, axis=0) + 50.0
    return float(np.clip(0.85 * _WIDTH_IN * height / width + 0.6, 3.5, 9.0))


def _devices_and_cells(axes: Axes, flight: Flight) -> None:
    plan = flight.plans[-1].message
    goals = {device: cell.goal_pose.position for cell in plan.cells for device in cell.device_ids}
    last = {name: reports[-1] for name, reports in flight.devices.items()}
    for name, goal in goals.items():
        if name in last:
            x, y = last[name].position
            axes.plot([x, goal.x], [y, goal.y], color=GREY, linewidth=0.5, zorder=1)
    kinds = {
        "device, served": ([r for n, r in last.items() if n in goals and r.demand], "o", BLACK),
        "device, not served": ([r for n, r in last.items() if n not in goals and r.demand], "X", VERMILLION),
        "device that has left": ([r for r in last.values() if not r.demand], ".", GREY),
    }
    for label, (reports, marker, colour) in kinds.items():
        if reports:
            xs, ys = zip(*(report.position for report in reports), strict=True)
            axes.plot(xs, ys, marker, color=colour, markersize=3.5, linestyle="none", label=label)
    axes.plot([], [], "s", color=BLUE, markersize=3.0, linestyle="none", label="aircraft, first seen")
    axes.plot([], [], "^", color=BLUE, markersize=7.0, linestyle="none", label="aircraft, last seen")


def _fence(axes: Axes, flight: Flight) -> None:
    fence = None if flight.fleet is None else flight.fleet.fence
    if fence is None:
        return
    if fence.polygon_m:
        xs, ys = zip(*fence.polygon_m, fence.polygon_m[0], strict=True)
        axes.plot(xs, ys, color=VERMILLION, linestyle="-.", linewidth=1.0, label="geofence")
    elif fence.center_m is not None and fence.radius_m is not None:
        # A fence far around the flight must not shrink the map.
        edge = Circle(fence.center_m, fence.radius_m, fill=False, edgecolor=VERMILLION, linestyle="-.", linewidth=1.0)
        axes.add_artist(edge)


def metres(flown: Mapping[str, float]) -> str:
    """Metres flown by each aircraft that flew."""
    moved = {name: length for name, length in flown.items() if length > 0.0}
    with _picture(2.6) as (figure, (axes,)):
        axes.bar(range(len(moved)), list(moved.values()), color=BLUE)
        few = len(moved) <= _MOST_LABELLED
        axes.set_xticks(range(len(moved)) if few else [], list(moved) if few else [], rotation=45, ha="right")
        axes.set_xlabel("" if few else f"{len(moved)} aircraft")
        axes.set_ylabel("flown [m]")
        axes.grid(visible=False, axis="x")
        return _svg(figure)


def separations(flight: Flight, separation: Separation) -> str:
    """Least distance between aircraft in the air over time."""
    time = TimeAxis(flight.duration_s)
    with _picture(2.6) as (figure, (axes,)):
        axes.plot(time.of(separation.moments), separation.least_m, color=BLUE, label="the two nearest aircraft")
        if math.isfinite(separation.ever_m):
            axes.plot(time.of([separation.at_s]), [separation.ever_m], "v", color=VERMILLION, label="least of all")
        axes.set_ylim(bottom=0.0)
        axes.set_ylabel("distance in space [m]")
        axes.legend(loc="best")
        time.dress(axes)
        return _svg(figure)


def batteries(flight: Flight, flown: Mapping[str, float]) -> str:
    """Battery over time, of the aircraft that flew in colour."""
    time = TimeAxis(flight.duration_s)
    with _picture(2.8) as (figure, (axes,)):
        moved = 0
        for name, track in flight.tracks.items():
            times, left = np.array(track.charge_times), np.array(track.charge)
            if not len(times):
                continue
            keep = _thinned(len(times), _MOST_POINTS)
            line: dict[str, Any] = {"color": GREY, "linewidth": 0.8}
            if flown[name] > 0.0:
                style = _DASHES[moved // len(_LINES) % len(_DASHES)]
                line = {"color": _LINES[moved % len(_LINES)], "linestyle": style, "label": name}
                moved += 1
            axes.plot(time.of(times[keep]), 100.0 * left[keep], **line)
        axes.set_ylim(0.0, 103.0)
        axes.set_ylabel("battery [%]")
        if 0 < moved <= _MOST_IN_LEGEND:
            axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.03), ncols=2 if moved > 12 else 1)
        time.dress(axes)
        return _svg(figure)


def _thinned(count: int, most: int) -> np.ndarray:
    """Return indices of at most about `most` of so many points, the last one among them."""
    step = max(1, math.ceil(count / most))
    return np.unique(np.append(np.arange(0, count, step), max(0, count - 1)))

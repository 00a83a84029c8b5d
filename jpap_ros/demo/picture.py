"""The picture at the end: devices by demand, aircraft, coverage circles and links."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from jpap_msgs.msg import Deployment, VehicleState
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle


def draw(
    path: Path,
    plan: Deployment,
    devices: Mapping[str, tuple[float, float, float]],
    states: Mapping[str, VehicleState],
    tracks: Mapping[str, list[tuple[float, float]]],
) -> None:
    """Write a map of a deployment as PNG.

    Parameters
    ----------
    path : Path
        File to write.
    plan : Deployment
        The plan in force.
    devices : mapping of str to (float, float, float)
        East [m], north [m] and demand [bit/s/Hz] of each device.
    states : mapping of str to VehicleState
        Last state of each aircraft: they are drawn where they are, not where they should be.
    tracks : mapping of str to list of (float, float)
        Where each aircraft has been [m].
    """
    shown = [*(place[:2] for place in devices.values()), *(place for track in tracks.values() for place in track)]
    (left, right), (bottom, top) = _window(shown)
    figure = Figure(figsize=(9.0, 7.4 * (top - bottom) / (right - left) + 1.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for name, track in tracks.items():
        if len(track) > 1:
            axes.plot(*zip(*track, strict=True), color="0.65", linewidth=0.9, zorder=1, label="_" + name)
    links, aircraft = [], []
    for cell in plan.cells:
        state = states[cell.uav]
        here = (state.position.x, state.position.y)
        aircraft.append(here)
        links += [[here, devices[device][:2]] for device in cell.device_ids]
        if math.isfinite(cell.coverage_radius_m):
            goal = (cell.goal_pose.position.x, cell.goal_pose.position.y)
            axes.add_patch(
                Circle(goal, cell.coverage_radius_m, facecolor="#0072B2", edgecolor="#0072B2", alpha=0.10, zorder=2)
            )
        axes.annotate(cell.uav, here, xytext=(6, 6), textcoords="offset points", fontsize=8, zorder=6)
    axes.add_collection(LineCollection(links, colors="#0072B2", linewidths=0.9, alpha=0.7, zorder=3))
    east, north, demand = zip(*devices.values(), strict=True)
    dots = axes.scatter(east, north, c=demand, cmap="viridis", s=34, edgecolors="black", linewidths=0.5, zorder=4)
    unserved = [devices[item.id] for item in plan.unserved if item.id in devices]
    if unserved:
        axes.scatter(
            *list(zip(*unserved, strict=True))[:2], marker="x", color="#D55E00", s=60, zorder=5, label="unserved"
        )
    axes.scatter(
        *zip(*aircraft, strict=True), marker="*", color="#D55E00", s=150, edgecolors="black", zorder=5, label="UAV"
    )
    idle = {name: state for name, state in states.items() if name not in {cell.uav for cell in plan.cells}}
    _draw_idle(axes, idle, tracks)
    axes.plot([], [], color="0.65", label="track")
    figure.colorbar(dots, ax=axes, label="rate demand [bit/s/Hz]", fraction=0.03, pad=0.02)
    served = sum(len(cell.device_ids) for cell in plan.cells)
    axes.set(
        xlabel="east [m]",
        ylabel="north [m]",
        xlim=(left, right),
        ylim=(bottom, top),
        aspect="equal",
        title=f"{served} of {len(devices)} devices served, UAVs: {len(plan.cells)} ({plan.scheme}),"
        f" average UAV rate {plan.average_uav_rate:.1f} bit/s/Hz",
    )
    figure.legend(loc="outside lower center", ncols=6, frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)


def _window(shown: Sequence[tuple[float, float]]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Ranges of east and north [m] that show all, with some room, and are neither a strip nor a pole."""
    ranges = [(min(values), max(values)) for values in zip(*shown, strict=True)]
    wide, high = (most - least for least, most in ranges)
    spans = max(wide, 0.9 * high, 10.0), max(high, 0.5 * wide, 9.0)
    middles = [(least + most) / 2 for least, most in ranges]
    (east, north), (across, up) = middles, (0.57 * span for span in spans)
    return (east - across, east + across), (north - up, north + up)


def _draw_idle(axes: Axes, states: Mapping[str, VehicleState], tracks: Mapping[str, list[tuple[float, float]]]) -> None:
    """Aircraft without a cell: on the ground, in the air, or, where they were last, not heard any more."""
    looks = {
        "on the ground": {"marker": "s", "facecolors": "white", "edgecolors": "0.4", "s": 22},
        "in the air without a cell": {"marker": "*", "facecolors": "white", "edgecolors": "#D55E00", "s": 150},
        "lost": {"marker": "X", "color": "black", "s": 80},
    }
    for label, look in looks.items():
        places = {name: tracks[name][-1] for name in states if tracks.get(name) and _condition(states[name]) == label}
        if not places:
            continue
        axes.scatter(*zip(*places.values(), strict=True), zorder=4.5, label=label, **look)
        for name, place in places.items() if label != "on the ground" else ():
            axes.annotate(name, place, xytext=(6, 6), textcoords="offset points", fontsize=8, zorder=6)


def _condition(state: VehicleState) -> str:
    if state.link != VehicleState.LINK_CONNECTED:
        return "lost"
    return "on the ground" if state.landed_state == VehicleState.LANDED_ON_GROUND else "in the air without a cell"

"""The picture at the end: devices by demand, aircraft, coverage circles and links."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from jpap_msgs.msg import Deployment, VehicleState
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
    figure = Figure(figsize=(9, 8.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for name, track in tracks.items():
        if len(track) > 1:
            axes.plot(*zip(*track, strict=True), color="0.75", linewidth=0.8, zorder=1, label="_" + name)
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
    axes.plot([], [], color="0.75", label="track")
    figure.colorbar(dots, ax=axes, label="rate demand [bit/s/Hz]", shrink=0.8)
    served = sum(len(cell.device_ids) for cell in plan.cells)
    axes.set(
        xlabel="east [m]",
        ylabel="north [m]",
        aspect="equal",
        title=f"{served} devices served by {len(plan.cells)} UAVs ({plan.scheme}),"
        f" average UAV rate {plan.average_uav_rate:.1f} bit/s/Hz",
    )
    axes.legend(loc="upper right", framealpha=0.9)
    axes.margins(0.06)
    axes.autoscale_view()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)

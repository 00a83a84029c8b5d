"""Figure 2: the map of one deployment, JPAP beside both readings of EPA-JPAP."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from jpap_ros.planning import Deployment, solve
from jpap_ros.planning.link_budget import Floats
from jpap_ros.study.scenario import Scenario
from jpap_ros.study.style import GREY, VERMILLION, figure_style, look, save

#: What the figure compares. As in the paper, JPAP's UAVs are stars and those of EPA-JPAP squares.
SCHEMES = ("jpap", "jpap_epa", "jpap_epa_common")

#: Most maps in a row.
COLUMNS = 4


def plot_map(
    scenario: Scenario, path: Path, *, devices: int = 40, draw: int = 0, schemes: Sequence[str] = SCHEMES
) -> list[Path]:
    """Draw the deployments of several schemes for one field of devices, side by side; return the files."""
    positions, rates = scenario.draw(devices, draw)
    deployments = [
        solve(
            positions,
            rates,
            scheme,
            scenario.link,
            max_devices_per_uav=scenario.max_devices_per_uav,
            seed=scenario.scheme_seed(devices, draw),
        )
        for scheme in schemes
    ]
    with figure_style():
        figure = draw_deployments(positions, rates, deployments)
        for axes in figure.axes[: len(schemes)]:
            axes.set(xlim=(-60, scenario.side_m + 60), ylim=(-60, scenario.side_m + 60))
        return save(figure, path)


def draw_deployments(
    positions: Floats,
    rates: Floats,
    deployments: Sequence[Deployment],
    names: Sequence[str] = (),
    proof: str = "",
) -> Figure:
    """Draw deployments of the same devices side by side; to be called and saved within `figure_style`.

    Parameters
    ----------
    positions : (K, 2) float
        Device positions [m].
    rates : (K,) float
        Demanded rates [bit/s/Hz].
    deployments : sequence of Deployment
        At least one.
    names : sequence of str
        Name of each UAV, to be written beside it; for one deployment.
    proof : str
        What to say of the number of UAVs instead of the mere number; for one deployment.
    """
    columns = min(len(deployments), COLUMNS)
    rows = -(-len(deployments) // columns)
    # In a row, the figure is as wide as a page; alone, a map has room for names, and the shape of what it shows.
    size = (3.3 * columns, 4.6 * rows) if len(deployments) > 1 else _size(positions, deployments[0])
    figure, panels = plt.subplots(
        rows, columns, figsize=size, sharex=True, sharey=True, squeeze=False, layout="constrained"
    )
    for axes, deployment in zip(panels.flat, deployments, strict=False):
        dots = _draw(axes, positions, rates, deployment, proof)
    for axes in panels.flat[len(deployments) :]:
        axes.set_visible(False)
    for axes in panels[-1]:
        axes.set_xlabel("East [m]")
    for axes in panels[:, 0]:
        axes.set_ylabel("North [m]")
    for name, (east, north) in zip(names, deployments[0].uav_positions if names else (), strict=True):
        panels[0][0].annotate(name, (east, north), xytext=(5, 5), textcoords="offset points", fontsize=7, zorder=6)
    figure.colorbar(
        dots,
        ax=list(panels.flat),
        location="bottom",
        shrink=0.35 if columns > 1 else 0.6,
        aspect=40,
        label="Rate demand $r_k$ [bit/s/Hz]",
    )
    return figure


def _size(positions: Floats, deployment: Deployment) -> tuple[float, float]:
    """Width and height [in] of a figure of one map."""
    reach = circle_radii(deployment, positions)[:, None]
    shown = np.concatenate([positions, deployment.uav_positions - reach, deployment.uav_positions + reach])
    east, north = np.maximum(np.ptp(shown, axis=0), 1.0)
    return 7.5, 1.9 + 6.5 * float(np.clip(north / east, 0.4, 1.4))


def circle_radii(deployment: Deployment, positions: Floats) -> Floats:
    """Radius of the circle to draw round each UAV [m], (N,).

    The common coverage radius d_sv where the scheme has one; else the distance to the farthest device served.
    """
    if deployment.coverage_radius_m is not None:
        return deployment.coverage_radius_m
    return np.array(
        [
            np.hypot(*(positions[deployment.cell(uav)] - centre).T).max()
            for uav, centre in enumerate(deployment.uav_positions)
        ]
    )


def _draw(axes: Axes, positions: Floats, rates: Floats, deployment: Deployment, proof: str) -> PathCollection:
    style = look(deployment.scheme)
    served = np.flatnonzero(deployment.serving_uav >= 0)
    links = np.stack([positions[served], deployment.uav_positions[deployment.serving_uav[served]]], axis=1)
    axes.add_collection(LineCollection(list(links), colors=GREY, linewidths=0.8, zorder=2))
    for centre, radius in zip(deployment.uav_positions, circle_radii(deployment, positions), strict=True):
        axes.add_patch(
            Circle(
                (float(centre[0]), float(centre[1])),
                float(radius),
                fill=False,
                edgecolor=style.colour,
                linestyle="--",
                linewidth=0.7,
                alpha=0.7,
            )
        )
    dots = axes.scatter(
        positions[:, 0], positions[:, 1], c=rates, cmap="viridis", s=14, zorder=4, edgecolors="white", linewidths=0.4
    )
    unserved = positions[deployment.serving_uav < 0]
    if len(unserved):
        east, north = unserved.T
        axes.scatter(east, north, marker="x", color=VERMILLION, s=40, linewidths=1.4, zorder=5, label="not served")
        axes.legend(loc="upper right", frameon=True)
    axes.plot(
        deployment.uav_positions[:, 0],
        deployment.uav_positions[:, 1],
        linestyle="none",
        marker=style.marker,
        markersize=11 if style.marker == "*" else 8,
        color=style.colour,
        markerfacecolor="none",
        zorder=3,
    )
    circles = "of radius $d_{sv}$" if deployment.coverage_radius_m is not None else "reach the farthest device"
    axes.set_aspect("equal")
    number = proof or f"{len(deployment.uav_positions)} UAVs"
    # The study's label tells of a proof that this one deployment may lack.
    label = "Optimal" if deployment.scheme == "optimal" else style.label
    axes.set_title(f"{label}: {number}\n{deployment.average_uav_rate:.1f} bit/s/Hz a UAV\ncircles {circles}")
    return dots

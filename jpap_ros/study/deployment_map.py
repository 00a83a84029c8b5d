"""Figure 2: the map of one deployment, JPAP beside both readings of EPA-JPAP."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.patches import Circle

from jpap_ros.planning import Deployment, solve
from jpap_ros.planning.link_budget import Floats
from jpap_ros.study.scenario import Scenario
from jpap_ros.study.style import GREY, figure_style, look, save

#: What the figure compares. As in the paper, JPAP's UAVs are stars and those of EPA-JPAP squares.
SCHEMES = ("jpap", "jpap_epa", "jpap_epa_common")


def plot_map(
    scenario: Scenario, path: Path, *, devices: int = 40, draw: int = 0, schemes: Sequence[str] = SCHEMES
) -> list[Path]:
    """Draw the deployments of several schemes for one field of devices, side by side; return the files."""
    positions, rates = scenario.draw(devices, draw)
    with figure_style():
        figure, panels = plt.subplots(
            ncols=len(schemes),
            figsize=(3.3 * len(schemes), 4.6),
            sharex=True,
            sharey=True,
            squeeze=False,
            layout="constrained",
        )
        for axes, scheme in zip(panels[0], schemes, strict=True):
            deployment = solve(
                positions,
                rates,
                scheme,
                scenario.link,
                max_devices_per_uav=scenario.max_devices_per_uav,
                seed=scenario.scheme_seed(devices, draw),
            )
            dots = _draw(axes, positions, rates, deployment)
            axes.set(xlabel="East [m]", xlim=(-60, scenario.side_m + 60), ylim=(-60, scenario.side_m + 60))
        panels[0][0].set_ylabel("North [m]")
        figure.colorbar(
            dots, ax=list(panels[0]), location="bottom", shrink=0.35, aspect=40, label="Rate demand $r_k$ [bit/s/Hz]"
        )
        return save(figure, path)


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


def _draw(axes: Axes, positions: Floats, rates: Floats, deployment: Deployment) -> PathCollection:
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
    axes.set_title(
        f"{style.label}: {len(deployment.uav_positions)} UAVs\n"
        f"{deployment.average_uav_rate:.1f} bit/s/Hz a UAV\ncircles {circles}"
    )
    return dots

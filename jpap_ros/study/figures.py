"""The curves over device number and link budget: the paper's Figures 1 and 3, and the link budget that Figure 2 needs.

Every point is a mean over draws, with its 95 % confidence interval as an error bar.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.container import ErrorbarContainer

from jpap_ros.study.rows import Row
from jpap_ros.study.style import GREY, figure_style, look, save, scheme_order
from jpap_ros.study.summary import Metric, mean_of

#: UAVs that the paper's Figure 2 shows for 40 devices.
PAPER_DEVICES = 40
PAPER_UAVS = {"JPAP": 14, "EPA-JPAP": 15}


def average_rate(row: Row) -> float:
    """Metric of Figure 1."""
    return row.average_uav_rate


def uav_number(row: Row) -> float:
    """Metric of Figure 3."""
    return row.uavs


def plot_over_devices(rows: Sequence[Row], metric: Metric, ylabel: str, path: Path) -> list[Path]:
    """Figures 1 and 3: a metric against the number of devices, at the stated link budget."""
    with figure_style():
        figure, axes = plt.subplots(figsize=(5.2, 3.6))
        _curves(axes, [row for row in rows if row.gain_db == 0], metric, "devices")
        axes.set_xlabel("Number of devices $K$")
        axes.set_xticks(sorted({row.devices for row in rows}))
        axes.set_ylabel(ylabel)
        axes.set_ylim(bottom=0)
        axes.set_ylim(top=axes.get_ylim()[1] * 1.35)
        _legend(axes, "upper left")
        return save(figure, path)


def plot_over_gain(rows: Sequence[Row], path: Path) -> list[Path]:
    """UAV number of 40 devices against link budget, for schemes run at several, beside the paper's Figure 2 counts."""
    varied = {row.scheme for row in rows if row.devices == PAPER_DEVICES and row.gain_db != 0}
    here = [row for row in rows if row.devices == PAPER_DEVICES and row.scheme in varied]
    with figure_style():
        figure, axes = plt.subplots(figsize=(5.2, 3.6))
        _curves(axes, here, uav_number, "gain_db")
        for name, count in PAPER_UAVS.items():
            axes.axhline(count, color=GREY, linewidth=0.9, linestyle=(0, (1, 1)), zorder=1)
            above = count == max(PAPER_UAVS.values())
            axes.text(
                1.01,
                count,
                f"paper: {name} {count}",
                transform=axes.get_yaxis_transform(),
                fontsize=7.5,
                color="#555555",
                va="bottom" if above else "top",
            )
        axes.set_xlabel("Link budget above the stated one [dB]")
        axes.set_ylabel(f"Number of UAVs for {PAPER_DEVICES} devices")
        axes.set_ylim(bottom=0)
        _legend(axes, "lower left")
        return save(figure, path)


def _curves(axes: Axes, rows: Sequence[Row], metric: Metric, over: str) -> None:
    """One curve with error bars for each scheme."""
    for rank, scheme in enumerate(sorted({row.scheme for row in rows}, key=scheme_order)):
        own = [row for row in rows if row.scheme == scheme]
        places: list[float] = sorted({getattr(row, over) for row in own})
        means = [mean_of(own, metric, **{over: place}) for place in places]
        style = look(scheme)
        axes.errorbar(
            places,
            [mean.value for mean in means],
            yerr=[mean.half_width for mean in means],
            label=style.label,
            color=style.colour,
            linestyle=style.line,
            marker=style.marker,
            markerfacecolor=style.face,
            markersize=8 if style.marker == "*" else 5,
            capsize=2.5,
            elinewidth=0.9,
            linewidth=style.width,
            # Where curves run together, the paper's scheme, which comes first, is on top.
            zorder=3 - rank / 100,
        )


def _legend(axes: Axes, where: Literal["upper left", "lower left"]) -> None:
    """Legend without the error bars."""
    containers, labels = axes.get_legend_handles_labels()
    lines = [container[0] if isinstance(container, ErrorbarContainer) else container for container in containers]
    axes.legend(lines, labels, loc=where, ncols=2, handlelength=2.8, columnspacing=1.2)

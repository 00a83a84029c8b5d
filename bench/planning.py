"""Time of `jpap` over the number of devices, and against the listing: literal, polished, and with a generic solver.

All in one run, in CPU time of one thread, so that the ratios hold whatever else the machine does. Devices have the
density of the paper's K = 100 (1500 m x 1500 m); time is the median of several instances, planning only. Cells are
compared one by one.
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import minimize

from jpap_ros.planning import LinkBudget, solve
from jpap_ros.planning.allocation import QDPA
from jpap_ros.planning.geometry import nearest_common_point
from jpap_ros.planning.reference import (
    drmp_position,
    literal_position,
    nearest_of_the_best,
    reference_jpap,
    sum_rate,
)
from jpap_ros.planning.solver import Problem, validate
from jpap_ros.study.style import BLUE, GREY, VERMILLION, figure_style, save

SIZES = (20, 40, 60, 80, 100, 300, 1000, 3000, 10_000)
PAPER_DEVICES, PAPER_SIDE_M = 100, 1500.0
#: Most time that a plan may take [s], by number of devices.
WANTED_S = {100: 0.010, 10_000: 5.0}


def instance(count: int, seed: int) -> Problem:
    """Devices at the density of the paper's K = 100, demands uniform in [15, 20] bit/s/Hz."""
    draw = np.random.default_rng(seed)
    side = PAPER_SIDE_M * math.sqrt(count / PAPER_DEVICES)
    return validate(
        draw.uniform(0, side, (count, 2)), draw.uniform(15, 20, count), LinkBudget(), None, None, None, 0.0, None, 0
    )


def slsqp_position(
    points: np.ndarray, strengths: np.ndarray, squared_radii: np.ndarray, height2: float, start: np.ndarray
) -> np.ndarray:
    """DRMP by SciPy's SLSQP, from the present position and from each device."""
    xs, ys = points.T.tolist()
    found = []
    for first in [start, *points]:
        feasible = nearest_common_point(*map(float, first), xs, ys, squared_radii.tolist())
        result = minimize(
            lambda v: -sum_rate(v, points, strengths, height2),
            first if feasible is None else feasible,
            method="SLSQP",
            constraints={"type": "ineq", "fun": lambda v: (squared_radii - ((points - v) ** 2).sum(axis=1)) / height2},
        )
        position = nearest_common_point(*result.x.tolist(), xs, ys, squared_radii.tolist())
        if position is not None:
            found.append(np.array(position))
    return nearest_of_the_best(found, points, strengths, height2, start)


def paper_steps(*cell: Any, epsilon: float) -> np.ndarray:
    """DRMP as it stands, with the 1 / epsilon^2 steps of the subgradient method that section IV-D counts."""
    return literal_position(*cell, iterations=math.ceil(1 / epsilon**2), tolerance_m=0.0)


def timed(run: Callable[[], object]) -> float:
    """Seconds of CPU time."""
    started = time.process_time()
    run()
    return time.process_time() - started


def median_time(count: int, instances: int) -> float:
    """Median over instances of the best of several runs [s]: other processes only ever add to the time."""
    runs = 15 if count <= 100 else 3
    return statistics.median(best_time(instance(count, seed), runs) for seed in range(instances))


def best_time(problem: Problem, runs: int) -> float:
    """Best of several runs of `jpap` [s]."""
    return min(timed(lambda: solve(problem.positions, problem.rates)) for _ in range(runs))


def compare(name: str, placer: Callable[..., np.ndarray], remark: str, instances: int) -> float:
    """Print how many times faster `jpap` is than the listing with a placer, and whether the cells are the same.

    Returns the listing's mean time [s].
    """
    slow = fast = 0.0
    same = 0
    for seed in range(instances):
        problem = instance(PAPER_DEVICES, seed)
        fast += best_time(problem, 15)
        started = time.process_time()
        reference = reference_jpap(problem, QDPA, placer)
        slow += time.process_time() - started
        deployment = solve(problem.positions, problem.rates)
        cells = [deployment.cell(uav).tolist() for uav in range(len(deployment.uav_positions))]
        same += cells == [sorted(members) for members, _ in reference]
    print(
        f"{name}: {slow / instances:.3f} s, jpap {fast / instances * 1e3:.1f} ms, {slow / fast:.0f} times faster"
        f" ({remark}); all cells identical in {same} of {instances} instances"
    )
    return slow / instances


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--instances", type=int, default=10, help="instances for each figure (default: %(default)s)")
    parser.add_argument("--largest", type=int, default=SIZES[-1], help="most devices (default: %(default)s)")
    parser.add_argument(
        "--plot",
        type=Path,
        default=Path("out/planning"),
        help="log-log plot to save as PNG and SVG (default: %(default)s)",
    )
    arguments = parser.parse_args()
    sizes = [count for count in SIZES if count <= arguments.largest]
    times = [median_time(count, arguments.instances if count <= 1000 else 1) for count in sizes]
    for count, seconds in zip(sizes, times, strict=True):
        wanted = f" (wanted at most {WANTED_S[count] * 1e3:.0f})" if count in WANTED_S else ""
        print(f"jpap, K = {count:6d}: {seconds * 1e3:9.1f} ms{wanted}")
    slope = np.polyfit(np.log(sizes), np.log(times), 1)[0]
    print(f"log-log slope: {slope:.2f} (K log K over the same sizes: {_slope_of_k_log_k(sizes):.2f})")
    references = {
        name: compare(name, placer, remark, arguments.instances)
        for name, placer, remark in (
            ("literal listing, error tolerance 3 %", partial(paper_steps, epsilon=0.03), "wanted 100"),
            ("literal listing, error tolerance 1 %", partial(paper_steps, epsilon=0.01), "wanted 100"),
            ("listing, subgradient method stopped early", literal_position, "not the paper's"),
            ("literal listing and a polish of each position", drmp_position, "not the paper's"),
            ("listing with SLSQP at each step", slsqp_position, "wanted 5"),
        )
    }
    _plot(arguments.plot, sizes, times, references)


def _slope_of_k_log_k(sizes: list[int]) -> float:
    counts = np.array(sizes, float)
    return float(np.polyfit(np.log(counts), np.log(counts * np.log(counts)), 1)[0])


def _plot(path: Path, sizes: list[int], times: list[float], references: dict[str, float]) -> None:
    counts = np.array(sizes, float)
    with figure_style():
        figure, axes = plt.subplots(figsize=(5.2, 3.6))
        axes.loglog(counts, times, "o-", color=BLUE, label="jpap")
        k_log_k = counts * np.log(counts)
        axes.loglog(
            counts, times[-1] * k_log_k / k_log_k[-1], "--", color=GREY, label="$K \\log K$ through the last point"
        )
        axes.plot(list(WANTED_S), list(WANTED_S.values()), "v", color=VERMILLION, label="wanted at most")
        for marker, (name, seconds) in zip("sPXD*", references.items(), strict=True):
            axes.plot(PAPER_DEVICES, seconds, marker, color=GREY, linestyle="none", label=name)
        axes.set(xlabel="Number of devices $K$, at constant density", ylabel="CPU time of a plan [s]")
        # Room for the legend below the curve.
        axes.set_ylim(bottom=min(times) / 3000)
        axes.legend(loc="lower right")
        for file in save(figure, path):
            print(f"plot: {file}")


if __name__ == "__main__":
    main()

"""How accurate the listing taken literally is, over the steps of its subgradient method, and how long it takes.

The paper says neither how many steps to take nor when they have converged. For each reading, over the same fields of
K = 100:

* the multipliers, where one is not 0, and the position that belongs to them, against the exact ones: the position of
  `placement`, and the multipliers with which the paper's (21) and (22) hold there;
* the position that the DRMP algorithm chose, grid and all, and its rate, against the exact optimum;
* the time of the whole listing, and whether the cells are those of `jpap`.
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from planning import PAPER_DEVICES, instance

from jpap_ros.planning import solve
from jpap_ros.planning.allocation import QDPA
from jpap_ros.planning.geometry import common_point
from jpap_ros.planning.placement import RATE_TOLERANCE, place
from jpap_ros.planning.reference import (
    Placer,
    drmp_position,
    lagrange_multipliers,
    literal_position,
    pulls,
    reference_jpap,
    sum_rate,
)

#: The arguments of a `reference.Placer`.
Cell = tuple[np.ndarray, np.ndarray, np.ndarray, float, np.ndarray]
#: The options of `lagrange_multipliers` for each reading.
STEPS: dict[str, dict[str, Any]] = {
    **{f"{steps} steps": {"iterations": steps, "tolerance_m": 0.0} for steps in (100, 300, 1000, 3000)},
    **{f"until {tolerance:g} m": {"tolerance_m": tolerance} for tolerance in (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)},
    "until 1e-06 m, a single fixed-point step for each": {"solved_m": math.inf},
}
#: How a cell is placed, and those options, for each reading.
READINGS: dict[str, tuple[Placer, dict[str, Any]]] = {
    **{name: (partial(literal_position, **options), options) for name, options in STEPS.items()},
    "until 1e-06 m, the best point of the grid": (partial(literal_position, grid_tolerance=0.0), {}),
    "with a polish": (drmp_position, {"iterations": 1000, "tolerance_m": 0.0, "solved_m": math.inf}),
}


@dataclass
class Errors:
    """What a reading left, one entry a placement."""

    steps: list[int] = field(default_factory=list)
    multiplier: list[float] = field(default_factory=list)
    multiplier_m: list[float] = field(default_factory=list)
    position_m: list[float] = field(default_factory=list)
    rate: list[float] = field(default_factory=list)


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--instances", type=int, default=10, help="fields (default: %(default)s)")
    problems = [instance(PAPER_DEVICES, seed) for seed in range(parser.parse_args().instances)]
    deployments = [solve(problem.positions, problem.rates) for problem in problems]
    for name, (placer, options) in READINGS.items():
        errors, seconds, same = Errors(), 0.0, 0
        for problem, deployment in zip(problems, deployments, strict=True):
            placed: list[tuple[Cell, np.ndarray]] = []
            started = time.process_time()
            cells = reference_jpap(problem, QDPA, partial(recorded, placed, placer))
            seconds += time.process_time() - started
            same += [sorted(members) for members, _ in cells] == [
                deployment.cell(uav).tolist() for uav in range(len(deployment.uav_positions))
            ]
            for cell, found in placed:
                add_multiplier_errors(errors, cell, options)
                add_position_errors(errors, cell, found)
        print(
            f"{name}: {seconds / len(problems):.3f} s a field, {same} of {len(problems)} with all cells identical;"
            f" {statistics.mean(errors.steps):.0f} steps on average, {max(errors.steps)} at most\n"
            f"  {len(errors.multiplier)} placements of {len(errors.steps)} with multipliers:"
            f" relative error {spread(errors.multiplier)}; position {spread(errors.multiplier_m)} m\n"
            f"  all {len(errors.rate)} placements with the grid: position {spread(errors.position_m)} m,"
            f" rate {spread(errors.rate)} bit/s/Hz below;"
            f" {sum(rate > RATE_TOLERANCE for rate in errors.rate)} by more than {RATE_TOLERANCE:g}"
        )


def recorded(placed: list[tuple[Cell, np.ndarray]], placer: Placer, *cell: Any) -> np.ndarray:
    """A placer that leaves what it was given and what it found in `placed`."""
    found = placer(*cell)
    placed.append((cell, found))
    return found


def add_multiplier_errors(errors: Errors, cell: Cell, options: dict[str, Any]) -> None:
    """Compare the Lagrange method within H of every device, where the problem is convex, with the exact solution."""
    points, strengths, squared_radii, height2, _ = cell
    radii2, mean = np.minimum(squared_radii, height2), points.mean(axis=0)
    if common_point(points, radii2) is None:
        return
    multipliers, position, steps = lagrange_multipliers(points, strengths, radii2, height2, mean, **options)
    errors.steps.append(steps)
    best = exact((points, strengths, radii2, height2, mean))
    ways = best - points
    binding = (ways**2).sum(axis=1) > radii2 * (1 - 1e-6)
    if binding.any():
        # Equations (21) and (22) at the exact position: there, the multipliers hold against the pulls.
        wanted = np.zeros(len(points))
        wanted[binding] = -pulls(points, strengths, height2, best) @ ways @ np.linalg.pinv(ways[binding])
        errors.multiplier.append(float(np.abs(multipliers - wanted).max() / wanted.max()))
        errors.multiplier_m.append(math.dist(position, best))


def add_position_errors(errors: Errors, cell: Cell, found: np.ndarray) -> None:
    """Compare what the whole DRMP algorithm found with the exact optimum; of several, with the one next to it."""
    points, strengths, squared_radii, height2, _ = cell
    best = exact((points, strengths, squared_radii, height2, found))
    errors.position_m.append(math.dist(found, best))
    errors.rate.append(sum_rate(best, points, strengths, height2) - sum_rate(found, points, strengths, height2))


def exact(cell: Cell) -> np.ndarray:
    """The position that `jpap` would choose."""
    points, strengths, squared_radii, height2, (x, y) = cell
    found = place(*points.T.tolist(), strengths.tolist(), squared_radii.tolist(), height2, (float(x), float(y)))
    assert found is not None
    return np.array(found)


def spread(errors: list[float]) -> str:
    """Median, 95 % quantile and largest."""
    return f"{statistics.median(errors):.1e} (95 %: {np.quantile(errors, 0.95):.1e}, at most {max(errors):.1e})"


if __name__ == "__main__":
    main()

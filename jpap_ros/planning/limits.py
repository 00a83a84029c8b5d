"""A fleet that is too small: which cells to fly, and why a device is left out."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np

from jpap_ros.planning.deployment import Deployment
from jpap_ros.planning.geometry import close_pairs
from jpap_ros.planning.link_budget import Floats
from jpap_ros.planning.optimal.servability import Ints, Servability
from jpap_ros.planning.solver import Problem


def limit_fleet(problem: Problem, deployment: Deployment) -> Deployment:
    """Fly the cells of the most weight, then of the most demanded rate, where there are more than `max_uavs`.

    The cells are those of the scheme, and disjoint, so no other choice among them serves more.
    """
    count = len(deployment.uav_positions)
    if problem.max_uavs is None or count <= problem.max_uavs:
        return deployment
    served = deployment.serving_uav >= 0
    whole = [deployment.cell(uav) for uav in range(count)]
    worth = [(exact_sum(problem.weights[cell]), exact_sum(problem.rates[cell])) for cell in whole]
    flown = np.sort(sorted(range(count), key=worth.__getitem__, reverse=True)[: problem.max_uavs]).astype(np.int64)
    number = np.full(count + 1, -1)
    number[flown] = np.arange(len(flown))
    serving_uav = number[deployment.serving_uav]
    left_out = np.flatnonzero(served & (serving_uav < 0))
    cells = [whole[uav] for uav in flown]
    apart = not len(close_pairs(deployment.uav_positions, problem.min_separation_m))
    reasons = explain(
        problem, cells, deployment.uav_positions[flown], left_out, deployment.uavs_needed if apart else None
    )
    radius = deployment.coverage_radius_m
    return replace(
        deployment,
        uav_positions=deployment.uav_positions[flown],
        serving_uav=serving_uav,
        power_w=np.where(serving_uav >= 0, deployment.power_w, 0.0),
        rate=np.where(serving_uav >= 0, deployment.rate, 0.0),
        uav_rate=deployment.uav_rate[flown],
        coverage_radius_m=None if radius is None else radius[flown],
        unserved=dict(sorted({**deployment.unserved, **reasons}.items())),
        average_uav_rate_bound=None,
    )


def exact_sum(values: Floats) -> Fraction:
    """The sum without rounding: weights of very different size count, each in full."""
    return sum(map(Fraction, values.tolist()), Fraction(0))


def explain(
    problem: Problem, cells: list[Ints], positions: Floats, left_out: Ints, uavs_needed: int | None
) -> dict[int, str]:
    """Why each device is left out by a fleet of these cells, and what more UAVs or power would serve it.

    Parameters
    ----------
    positions : (N, 2) float
        Where the UAVs hover [m].
    uavs_needed : int or None
        UAVs that are known to serve every device; None where no number is.
    """
    servability = Servability.of(problem)
    sets = servability.measure_all(cells)
    room = np.array([len(cell) < problem.cell_limit for cell in cells], dtype=bool)
    fleet = f"the fleet of {len(cells)} UAV{'s' * (len(cells) != 1)} is used up"
    helps = []
    if uavs_needed is not None:
        more = uavs_needed - len(cells)
        helps.append(f"{more} more UAV{'s' * (more != 1)} would serve every device")
    reasons = {}
    for k in left_out.tolist():
        joined = servability.joined(sets, np.full(len(cells), k))
        load = joined.load
        if problem.min_separation_m > 0:
            # From where it hovers: elsewhere it might be too close to another one.
            load = load + joined.weight * ((joined.centroid - positions) ** 2).sum(axis=1)
        load = np.where(room, load, np.inf)
        if not len(cells) or not np.isfinite(load).any():
            why, others = f"{fleet} or full" if cells else fleet, helps
        else:
            uav = int(load.argmin())
            decibels = 10 * math.log10(max(float(load[uav]), 1.0))
            # Rounded up: with the power that is stated the device can be served.
            other = (
                f"{math.ceil(decibels * 100) / 100:.2f} dB more transmit power would let UAV {uav} serve it too"
                if decibels > 0
                else f"UAV {uav} could serve it too with its power shared out otherwise"
            )
            why, others = fleet, [*helps, other]
        reasons[k] = "; ".join([why, ", or ".join(others)] if others else [why])
    return reasons

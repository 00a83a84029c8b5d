"""A fleet that is too small: which cells to fly, and why a device is left out."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from jpap_ros.planning.deployment import Deployment
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
    serving = deployment.serving_uav[served]
    weight = np.bincount(serving, weights=problem.weights[served], minlength=count)
    demand = np.bincount(serving, weights=problem.rates[served], minlength=count)
    flown = np.sort(np.lexsort((np.arange(count), -demand, -weight))[: problem.max_uavs])
    number = np.full(count + 1, -1)
    number[flown] = np.arange(len(flown))
    serving_uav = number[deployment.serving_uav]
    left_out = np.flatnonzero(served & (serving_uav < 0))
    cells = [np.flatnonzero(serving_uav == uav) for uav in range(len(flown))]
    reasons = explain(problem, cells, left_out, deployment.uavs_needed)
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


def explain(problem: Problem, cells: list[Ints], left_out: Ints, uavs_needed: int) -> dict[int, str]:
    """Why each device is left out by a fleet of these cells, and what more UAVs or power would serve it."""
    servability = Servability.of(problem)
    sets = servability.measure_all(cells)
    room = np.array([len(cell) < problem.cell_limit for cell in cells], dtype=bool)
    more = uavs_needed - len(cells)
    fleet = f"the fleet of {len(cells)} UAV{'s' * (len(cells) != 1)} is used up"
    help_uavs = f"{more} more UAV{'s' * (more != 1)} would serve every device"
    reasons = {}
    for k in left_out.tolist():
        load = servability.joined(sets, np.full(len(cells), k)).load
        load = np.where(room, load, np.inf)
        if not len(cells) or not np.isfinite(load).any():
            why = f"{fleet} or full; {help_uavs}" if cells else f"{fleet}; {help_uavs}"
        else:
            uav = int(load.argmin())
            decibels = 10 * math.log10(max(float(load[uav]), 1.0))
            # Rounded up: with the power that is stated the device can be served.
            other = (
                f"{math.ceil(decibels * 100) / 100:.2f} dB more transmit power would let UAV {uav} serve it too"
                if decibels > 0
                else f"UAV {uav} could serve it too with its power shared out otherwise"
            )
            why = f"{fleet}; {help_uavs}, or {other}"
        reasons[k] = why
    return reasons

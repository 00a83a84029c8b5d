"""From the cells and positions that a scheme chose to a deployment, by the scheme's power allocation."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jpap_ros.planning.allocation import Allocation
from jpap_ros.planning.deployment import Deployment, make_deployment
from jpap_ros.planning.solver import Problem


def deploy(
    problem: Problem,
    scheme: str,
    allocation: Allocation,
    cells: Sequence[NDArray[np.int64]],
    uav_positions: ArrayLike,
) -> Deployment:
    """Deployment that serves every device, with the power of each UAV split by the allocation rule.

    Parameters
    ----------
    problem : Problem
    scheme : str
        Key of SCHEMES.
    allocation : Allocation
        The rule; it gives the coverage radius too, where it has a common one.
    cells : sequence of (n,) int
        Devices of each UAV; every device in exactly one cell.
    uav_positions : (N, 2) array_like
        UAV positions [m].
    """
    demand, link = problem.snr_demand, problem.link
    power, radii = np.zeros(len(demand)), []
    for cell in cells:
        strengths, squared_radii = allocation.split(demand[cell].tolist(), link.power_eta, link.altitude_m**2)
        power[cell] = strengths
        radii.append(math.sqrt(squared_radii[0]))
    return make_deployment(
        scheme,
        problem.positions,
        problem.rates,
        problem.link,
        cells,
        uav_positions,
        power / link.eta,
        unserved={},
        coverage_radius_m=radii if allocation.common_radius else None,
    )

"""The scheme `optimal`: the smallest fleet, proven, then the largest average UAV rate with that fleet."""

from __future__ import annotations

import math

import numpy as np
from scipy import sparse

from jpap_ros.planning.deployment import Deployment, make_deployment
from jpap_ros.planning.link_budget import Floats
from jpap_ros.planning.optimal.enumeration import all_sets
from jpap_ros.planning.optimal.milp import incidence, minimise
from jpap_ros.planning.optimal.position import best_positions, share_power
from jpap_ros.planning.optimal.servability import Ints, Servability
from jpap_ros.planning.solver import Problem


def optimal(problem: Problem) -> Deployment:
    """Solve P1: the fewest UAVs, then the partition, positions and powers of the largest average rate."""
    count = len(problem.rates)
    if count == 0:
        return _deploy(problem, [], np.empty((0, 2)), 0)
    servability = Servability.of(problem)
    members, sets = all_sets(servability)
    hover = best_positions(servability, members, sets, problem.link.power_eta)
    matrix = incidence(members, count)
    ones = np.ones(count)
    fewest = minimise(np.ones(len(members)), matrix, ones, np.full(count, np.inf), integer=True)
    uavs = math.ceil(fewest.bound - 1e-6)
    with_count = sparse.csc_array(sparse.vstack([matrix, np.ones((1, len(members)))]))
    sides = np.append(ones, uavs)
    best = minimise(-hover.rate, with_count, sides, sides, integer=True, deadline=problem.deadline)
    assert best.x is not None
    chosen = np.flatnonzero(best.x > 0.5)
    return _deploy(problem, [members[i] for i in chosen], hover.position[chosen], uavs)


def _deploy(problem: Problem, cells: list[Ints], centres: Floats, bound: int) -> Deployment:
    servability = Servability.of(problem)
    power = np.zeros(len(problem.rates))
    for cell, centre in zip(cells, centres, strict=True):
        shares, _ = share_power(servability, cell[None], centre[None], problem.link.power_eta)
        power[cell] = shares[0] * problem.link.transmit_power_w
    return make_deployment(
        "optimal",
        problem.positions,
        problem.rates,
        problem.link,
        cells,
        centres,
        power,
        unserved={},
        min_uavs_bound=bound,
        proven_optimal=len(cells) == bound,
    )

"""Hovering UAVs at least `min_separation_m` apart, with every demand still met.

A UAV serves its cell from anywhere in a disc (see `optimal.servability`), so UAVs that came out too close can often
be moved apart at no cost but some rate. Two discs whose farthest points are closer than the separation never can.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from jpap_ros.planning.deployment import Deployment, make_deployment
from jpap_ros.planning.link_budget import Floats, snr_demand
from jpap_ros.planning.optimal.enumeration import TooManySets
from jpap_ros.planning.optimal.position import share_power
from jpap_ros.planning.optimal.servability import Ints, Servability, Sets
from jpap_ros.planning.solver import Problem

#: Positions are moved apart by this much more than asked, and kept this much inside their discs; relative.
_MARGIN = 1e-7
_TRIES = 8
_SWEEPS = 250


def keep_apart(problem: Problem, deployment: Deployment) -> Deployment:
    """Move UAVs that are closer than `problem.min_separation_m`, with as little else changed as possible.

    A UAV that is moved shares its power out by water-filling, and its coverage radius is the one those powers give.
    Where moving is not enough a cell is split, if the fleet has another UAV, or its device of least weight is left
    unserved, with the reason.
    """
    if not len(_too_close(deployment.uav_positions, problem.min_separation_m)):
        return deployment
    servability = Servability.of(problem)
    cells = [deployment.cell(uav) for uav in range(len(deployment.uav_positions))]
    wanted = deployment.uav_positions.copy()
    unserved = dict(deployment.unserved)
    while True:
        sets = servability.measure_all(cells)
        moved = spread(wanted, sets, problem.min_separation_m, problem.seed)
        close = _too_close(moved, problem.min_separation_m)
        if not len(close):
            break
        # The cell with the least room gives way.
        uav = int(min(close.ravel(), key=lambda i: (sets.slack_radius[i], i)))
        most = math.inf if problem.max_uavs is None else problem.max_uavs
        if len(cells[uav]) > 1 and len(cells) < most:
            hardest = int(cells[uav][problem.rates[cells[uav]].argmax()])
            cells[uav] = cells[uav][cells[uav] != hardest]
            cells.append(np.array([hardest]))
            wanted = np.vstack([wanted, problem.positions[hardest]])
        else:
            first = min(cells[uav], key=lambda k: (problem.weights[k], -problem.rates[k], k))
            unserved[int(first)] = (
                f"the UAVs that could serve it would have to hover closer than {problem.min_separation_m:g} m"
                " to one another"
            )
            cells[uav] = cells[uav][cells[uav] != first]
            if not len(cells[uav]):
                del cells[uav]
                wanted = np.delete(wanted, uav, axis=0)
    return _redeploy(problem, servability, deployment, cells, moved, unserved)


def _redeploy(
    problem: Problem,
    servability: Servability,
    old: Deployment,
    cells: list[Ints],
    positions: Floats,
    unserved: dict[int, str],
) -> Deployment:
    power = np.zeros(len(problem.rates))
    radii = []
    for uav, (cell, position) in enumerate(zip(cells, positions, strict=True)):
        same = uav < len(old.uav_positions) and np.array_equal(cell, old.cell(uav))
        if same and np.array_equal(position, old.uav_positions[uav]):
            power[cell] = old.power_w[cell]
        else:
            shares, _ = share_power(servability, cell[None], position[None], problem.link.power_eta)
            power[cell] = shares[0] * problem.link.transmit_power_w
        squared = power[cell] * problem.link.eta / snr_demand(problem.rates[cell]) - problem.link.altitude_m**2
        radii.append(math.sqrt(max(float(squared.min()), 0.0)))
    made = make_deployment(
        old.scheme,
        problem.positions,
        problem.rates,
        problem.link,
        cells,
        positions,
        power,
        unserved=dict(sorted(unserved.items())),
        coverage_radius_m=None if old.coverage_radius_m is None else radii,
        uavs_needed=max(old.uavs_needed, len(cells)),
        min_uavs_bound=old.min_uavs_bound,
        proven_optimal=old.proven_optimal and len(cells) <= old.uavs_needed and len(unserved) == len(old.unserved),
        average_uav_rate_bound=old.average_uav_rate_bound if len(cells) == len(old.uav_positions) else None,
    )
    return replace(made, runtime_s=old.runtime_s)


def spread(wanted: Floats, sets: Sets, separation: float, seed: int) -> Floats:
    """Positions near the wanted ones, each in the disc of its set, pairwise `separation` apart if that is found.

    Parameters
    ----------
    wanted : (N, 2) float
        Preferred positions [m]; each that is in no conflict stays.
    sets : Sets
        Of the N cells.
    separation : float
        [m]
    """
    reach = sets.slack_radius * (1 - _MARGIN)
    if len(_hopeless(sets, separation)):
        return wanted
    random = np.random.default_rng(seed)
    best: Floats = wanted
    fewest: float = math.inf
    for attempt in range(_TRIES):
        here: Floats = wanted.copy()
        if attempt:
            # Another beginning for those in conflict: anywhere in their discs.
            close = np.unique(_too_close(best, separation))
            angle, part = random.uniform(0, 2 * np.pi, len(close)), np.sqrt(random.uniform(0, 1, len(close)))
            here = best.copy()
            offset = (reach[close] * part)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
            here[close] = sets.centroid[close] + offset
        for _ in range(_SWEEPS):
            close = _too_close(here, separation)
            if not len(close):
                return here
            for first, second in close:
                _push(here, int(first), int(second), separation, random)
            touched = np.unique(close)
            away = here[touched] - sets.centroid[touched]
            distance = np.maximum(np.hypot(away[:, 0], away[:, 1]), 1e-300)
            here[touched] = sets.centroid[touched] + away * np.minimum(1, reach[touched] / distance)[:, None]
        left = len(_too_close(here, separation))
        if left < fewest:
            best, fewest = here, left
    return best


def never_apart(members: list[Ints], sets: Sets, separation: float, most: int) -> Ints:
    """Pairs of disjoint sets that no two UAVs so far apart can serve: the farthest points of their discs are nearer.

    Returns
    -------
    (n, 2) int

    Raises
    ------
    TooManySets
        If more than `most` pairs have to be looked at.
    """
    tree = cKDTree(sets.centroid)
    if tree.count_neighbors(tree, separation) > 20 * most:
        raise TooManySets
    pairs = _hopeless(sets, separation)
    own = [set(cell.tolist()) for cell in members]
    disjoint = np.array([own[i].isdisjoint(own[j]) for i, j in pairs.tolist()], dtype=bool)
    if disjoint.sum() > most:
        raise TooManySets
    apart: Ints = pairs[disjoint]
    return apart


def _hopeless(sets: Sets, separation: float) -> Ints:
    """Pairs of sets whose discs have no two points so far apart."""
    pairs = cKDTree(sets.centroid).query_pairs(separation, output_type="ndarray").astype(np.int64)
    first, second = pairs[:, 0], pairs[:, 1]
    between = np.hypot(*(sets.centroid[first] - sets.centroid[second]).T)
    found: Ints = pairs[between + sets.slack_radius[first] + sets.slack_radius[second] < separation]
    return found


def _push(here: Floats, first: int, second: int, separation: float, random: np.random.Generator) -> None:
    away = here[second] - here[first]
    distance = float(np.hypot(*away))
    lacking = separation * (1 + 2 * _MARGIN) - distance
    if lacking <= 0:
        return
    if distance < 1e-9:
        angle = random.uniform(0, 2 * np.pi)
        away, distance = np.array([math.cos(angle), math.sin(angle)]), 1.0
    here[first] -= away / distance * lacking / 2
    here[second] += away / distance * lacking / 2


def _too_close(positions: Floats, separation: float) -> Ints:
    """Pairs of UAVs closer than the separation, (n, 2)."""
    if separation <= 0 or len(positions) < 2:
        return np.empty((0, 2), np.int64)
    pairs = cKDTree(positions).query_pairs(separation, output_type="ndarray")
    apart = np.hypot(*(positions[pairs[:, 0]] - positions[pairs[:, 1]]).T)
    close: Ints = pairs[apart < separation].astype(np.int64)
    return close

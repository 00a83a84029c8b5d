"""Hovering UAVs at least `min_separation_m` apart, with every demand still met.

A UAV serves its cell from anywhere in a disc (see `optimal.servability`), so UAVs that came out too close can often
be moved apart at no cost but some rate. Two discs whose farthest points are closer than the separation never can.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from fractions import Fraction

import numpy as np
from scipy.spatial import cKDTree

from jpap_ros.planning.deployment import Deployment, make_deployment
from jpap_ros.planning.geometry import close_pairs
from jpap_ros.planning.limits import exact_sum, explain
from jpap_ros.planning.link_budget import Floats, snr_demand
from jpap_ros.planning.optimal.enumeration import TooManySets
from jpap_ros.planning.optimal.position import share_power
from jpap_ros.planning.optimal.servability import Ints, Servability, Sets
from jpap_ros.planning.separation_places import MARGIN, Places
from jpap_ros.planning.solver import Problem

#: Beginnings that are tried; where far too many UAVs want the room, no beginning helps.
_TRIES, _TRIES_OF_MANY, _MANY = 8, 2, 3
_SWEEPS = 250
#: A try ends when this many sweeps took less than this part off what the UAVs lack in distance.
_PATIENCE, _PROGRESS = 25, 0.01
#: Part of the cells in excess that gives way before the others are spread again.
_AT_ONCE = 0.25
#: Time that there is in any case [s], even past the deadline: without any, devices would be left out for nothing.
_LEAST_TIME_S = 0.3


def keep_apart(problem: Problem, deployment: Deployment, uavs_needed: int | None = None) -> Deployment:
    """Move UAVs that are closer than `problem.min_separation_m`, with as little else changed as possible.

    A UAV that is moved shares its power out by water-filling, and its coverage radius is the one those powers give.
    Where moving is not enough the cells of less weight give way: what has no place of its own goes to other cells, or
    to another UAV, if the fleet has one, or is left unserved, with the reason.

    Some moments after `problem.deadline` nobody is moved any more, and what is too close gives way at once.

    Parameters
    ----------
    uavs_needed : int or None
        UAVs that are known to serve every device so far apart.
    """
    separation = problem.min_separation_m
    if not len(close_pairs(deployment.uav_positions, separation)):
        return deployment
    deadline = max(problem.deadline, time.monotonic() + _LEAST_TIME_S)
    servability = Servability.of(problem)
    cells = [deployment.cell(uav) for uav in range(len(deployment.uav_positions))]
    sets = servability.measure_all(cells)
    weight = [exact_sum(problem.weights[cell]) for cell in cells]
    losers = _who_gives_way(_hopeless(sets, separation), weight, sets.slack_radius)
    stay = np.setdiff1d(np.arange(len(cells)), losers)
    positions = deployment.uav_positions.copy()
    tries = _TRIES_OF_MANY
    while True:
        positions[stay] = spread(positions[stay], sets[stay], separation, problem.seed, deadline, tries)
        losers = _who_gives_way(stay[close_pairs(positions[stay], separation)], weight, sets.slack_radius)
        if not len(losers):
            break
        if len(losers) <= _MANY and tries < _TRIES:
            tries = _TRIES
            continue
        # A few at a time: those that stay get more room.
        few = len(losers) if time.monotonic() > deadline else math.ceil(_AT_ONCE * len(losers))
        stay = np.setdiff1d(stay, losers[:few])
    places = Places(problem, servability, deadline)
    for uav in stay.tolist():
        places.take(cells[uav], positions[uav], uav)
    others = sorted(set(range(len(cells))) - set(stay.tolist()), key=lambda uav: (-weight[uav], uav))
    homeless = [k for uav in others for k in places.fly(cells[uav], deployment.uav_positions[uav], uav)]
    left_out = [
        k
        for k in sorted([*homeless, *deployment.unserved], key=lambda k: (-problem.weights[k], problem.rates[k], k))
        if not places.join(k) and places.fly(np.array([k]), problem.positions[k])
    ]
    return _redeploy(problem, deployment, places, left_out, uavs_needed)


def _who_gives_way(pairs: Ints, weight: list[Fraction], room: Floats) -> Ints:
    """Cells that leave no pair whole where no two of a pair can stay, in the order in which they should go.

    Next is the one of the least weight for the conflicts that it ends; of equals, the one with the least room.
    """
    foes: dict[int, set[int]] = {}
    for first, second in pairs.tolist():
        foes.setdefault(first, set()).add(second)
        foes.setdefault(second, set()).add(first)
    losers = []
    while foes:
        loser = min(foes, key=lambda cell: (weight[cell] / len(foes[cell]), room[cell], cell))
        losers.append(loser)
        for foe in foes.pop(loser):
            foes[foe].remove(loser)
            if not foes[foe]:
                del foes[foe]
    return np.array(losers, dtype=np.int64)


def no_place(problem: Problem) -> str:
    """Why a device is left out though there are UAVs."""
    return (
        "this scheme found no place for it: the UAVs that could serve it would hover closer than"
        f" {problem.min_separation_m:g} m to another one"
    )


def _redeploy(
    problem: Problem, old: Deployment, places: Places, left_out: list[int], uavs_needed: int | None
) -> Deployment:
    order = np.argsort(places.origin, kind="stable")
    cells, positions = [places.cells[i] for i in order], places.positions[order]
    power = np.zeros(len(problem.rates))
    radii = []
    for i, cell, position in zip(order, cells, positions, strict=True):
        origin = places.origin[i]
        same = origin < len(old.uav_positions) and np.array_equal(cell, old.cell(origin))
        if same and np.array_equal(position, old.uav_positions[origin]):
            power[cell] = old.power_w[cell]
        else:
            shares, _ = share_power(places.servability, cell[None], position[None], problem.link.power_eta)
            power[cell] = shares[0] * problem.link.transmit_power_w
        squared = power[cell] * problem.link.eta / snr_demand(problem.rates[cell]) - problem.link.altitude_m**2
        radii.append(math.sqrt(max(float(squared.min()), 0.0)))
    too_few: list[int] = []
    if len(cells) == problem.max_uavs:
        too_few = left_out if uavs_needed is not None else [k for k in left_out if k in old.unserved]
    unserved = dict.fromkeys(left_out, no_place(problem))
    unserved.update(explain(problem, cells, positions, np.array(too_few, dtype=np.int64), uavs_needed))
    fewest = len(cells) <= old.uavs_needed and not left_out
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
        uavs_needed=max(old.uavs_needed, len(cells)) if left_out else len(cells),
        min_uavs_bound=old.min_uavs_bound,
        proven_optimal=old.proven_optimal and (fewest or uavs_needed is not None),
        served_weight_bound=old.served_weight_bound,
    )
    alike = len(cells) == len(old.uav_positions) and made.unserved.keys() == old.unserved.keys()
    return replace(made, average_uav_rate_bound=old.average_uav_rate_bound if alike else None, runtime_s=old.runtime_s)


def spread(
    wanted: Floats, sets: Sets, separation: float, seed: int, deadline: float = math.inf, tries: int = _TRIES
) -> Floats:
    """Positions near the wanted ones, each in the disc of its set, pairwise `separation` apart if that is found.

    Parameters
    ----------
    wanted : (N, 2) float
        Preferred positions [m]; each that is in no conflict stays.
    sets : Sets
        Of the N cells.
    separation : float
        [m]
    deadline : float
        `time.monotonic()` by which to return.
    tries : int
        Most beginnings.
    """
    reach = sets.slack_radius * (1 - MARGIN)
    if len(_hopeless(sets, separation)):
        return wanted
    random = np.random.default_rng(seed)
    best: Floats = wanted
    fewest: float = len(close_pairs(wanted, separation))
    for attempt in range(tries):
        if not fewest or time.monotonic() > deadline:
            break
        here: Floats = best.copy()
        if attempt:
            # Another beginning for those in conflict: anywhere in their discs.
            close = np.unique(close_pairs(best, separation))
            angle, part = random.uniform(0, 2 * np.pi, len(close)), np.sqrt(random.uniform(0, 1, len(close)))
            offset = (reach[close] * part)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
            here[close] = sets.centroid[close] + offset
        _push_apart(here, sets.centroid, reach, separation, random, deadline)
        left = len(close_pairs(here, separation))
        if left < fewest:
            best, fewest = here, left
    return best


def _push_apart(
    here: Floats, centre: Floats, reach: Floats, separation: float, random: np.random.Generator, deadline: float
) -> None:
    """Push all that are too close away from each other, within their discs, again and again; in place."""
    before = math.inf
    for sweep in range(_SWEEPS):
        close = close_pairs(here, separation)
        if not len(close) or time.monotonic() > deadline:
            return
        away = here[close[:, 1]] - here[close[:, 0]]
        distance = np.hypot(away[:, 0], away[:, 1])
        # From one point they part in any direction.
        angle = random.uniform(0, 2 * np.pi, len(close))
        away = np.where((distance < 1e-9)[:, None], np.column_stack([np.cos(angle), np.sin(angle)]), away)
        lacking = separation * (1 + 2 * MARGIN) - distance
        if sweep % _PATIENCE == 0:
            if lacking.sum() > before * (1 - _PROGRESS):
                return
            before = lacking.sum()
        push = away / np.where(distance < 1e-9, 1.0, distance)[:, None] * lacking[:, None] / 2
        touched, number = np.unique(close, return_inverse=True)
        number = number.reshape(close.shape)
        # One that is pushed from many sides takes part of the sum: all of it would overshoot.
        share = np.maximum(np.bincount(number.ravel()) / 2, 1)
        total = np.column_stack(
            [
                np.bincount(number[:, 1], push[:, axis], len(touched))
                - np.bincount(number[:, 0], push[:, axis], len(touched))
                for axis in (0, 1)
            ]
        )
        off = here[touched] + total / share[:, None] - centre[touched]
        length = np.maximum(np.hypot(off[:, 0], off[:, 1]), 1e-300)
        here[touched] = centre[touched] + off * np.minimum(1, reach[touched] / length)[:, None]


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

"""K-means baseline: cluster the devices, and hover over the centroid of each cluster."""

from __future__ import annotations

import math
import time
import warnings

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2

from jpap_ros.planning.allocation import EPA, QDPA, Allocation
from jpap_ros.planning.cells import deploy
from jpap_ros.planning.deployment import Deployment
from jpap_ros.planning.geometry import RELATIVE_TOLERANCE
from jpap_ros.planning.link_budget import Floats
from jpap_ros.planning.solver import Problem

#: k-means++ initialisations tried for each number of clusters.
INITIALISATIONS = 10
#: Lloyd iterations between two looks whether the clusters still change, and the most such looks.
ITERATIONS, LOOKS = 5, 60

Members = NDArray[np.int64]


def kmeans_qdpa(problem: Problem) -> Deployment:
    """K-means with QoS demand based power allocation; see `kmeans`."""
    return deploy(problem, "kmeans_qdpa", QDPA, *kmeans(problem, QDPA))


def kmeans_epa(problem: Problem) -> Deployment:
    """K-means with equal power allocation, each device with its own radius (5); see `kmeans`."""
    return deploy(problem, "kmeans_epa", EPA, *kmeans(problem, EPA))


def kmeans(problem: Problem, allocation: Allocation) -> tuple[list[Members], Floats]:
    """Cells of the smallest number of clusters with which every device is satisfied at its centroid.

    Parameters
    ----------
    problem : Problem
    allocation : Allocation
        The rule that splits a UAV's power, and with it the coverage radii.

    Returns
    -------
    cells : list of (n,) int
        Devices of each UAV.
    centroids : (N, 2) float
        Position of each UAV [m].

    Notes
    -----
    Galkin, Kibiłda and DaSilva, "Deployment of UAV-mounted access points according to spatial user locations in
    two-tier cellular networks", Wireless Days 2016: a UAV over the centroid of each cluster of users. They fix the
    number of clusters; here it is the smallest that meets every demand, as in the comparison of the paper.

    The number N is raised one by one from a lower bound that no deployment can beat. For each N, Lloyd's algorithm
    runs from `INITIALISATIONS` k-means++ initialisations; N is accepted as soon as the clusters of one of them satisfy
    every device (of several, those with the least sum of squared distances). A larger N need not satisfy where a
    smaller one did, so N is not bisected. "Smallest" is thus relative to the initialisations tried.

    k-means++ draws its centroids one after the other, so a sequence of draws that goes on to the last device holds an
    initialisation for every N: its first N. `INITIALISATIONS` such sequences are drawn, from the problem's seed.

    No clustering divides devices at one and the same place. Where they are too many for one UAV, they are packed into
    cells by first fit, largest demand first, and all these cells but the last are set aside; the rest is clustered.
    Every place by itself is then a cluster that satisfies, so the search ends at the latest with one cluster a place.

    Where the time limit strikes before, the clusters tried last are kept as far as they satisfy, and the others are cut
    in two across their longer axis, again and again, until all do. N may then be larger than that, or even smaller, as
    cutting suits the devices at hand where Lloyd's algorithm does not.

    The clusters depend on the order of the devices, as the random draws do; translation and rotation of the devices
    change nothing but rounding.
    """
    demand = problem.snr_demand
    crowded, rest = _set_crowds_aside(problem, allocation, demand)
    cells = crowded + _cluster(problem, allocation, demand, rest)
    return cells, np.array([_centroid(problem.positions[cell]) for cell in cells]).reshape(-1, 2)


def _cluster(problem: Problem, allocation: Allocation, demand: Floats, rest: Members) -> list[Members]:
    """The devices `rest` in the smallest number of clusters that satisfies them all."""
    if not len(rest):
        return []
    points = problem.positions[rest]
    places, place_of = np.unique(points, axis=0, return_inverse=True)
    rng = np.random.default_rng(problem.seed)
    initial: list[Floats] = []
    tried = [rest]
    for count in range(_lower_bound(problem, demand[rest]), len(places)):
        good = []
        for start in range(INITIALISATIONS):
            if time.monotonic() > problem.deadline:
                return _cut_unsatisfied(problem, allocation, demand, tried)
            if start == len(initial):
                initial.append(_k_means_plus_plus(points, len(places), rng))
            tried = _split(rest, _lloyd(points, initial[start][:count]))
            if all(_satisfied(problem, allocation, demand, cluster) for cluster in tried):
                good.append(tried)
        if good:
            return min(good, key=lambda clusters: _sum_of_squares(problem.positions, clusters))
    return _split(rest, place_of.reshape(-1))


def _cut_unsatisfied(
    problem: Problem, allocation: Allocation, demand: Floats, clusters: list[Members]
) -> list[Members]:
    """Cut each cluster that does not satisfy its devices in two, until all do."""
    left, done = list(clusters), []
    while left:
        cluster = left.pop()
        if _satisfied(problem, allocation, demand, cluster):
            done.append(cluster)
        else:
            left += _cut(problem.positions, cluster)
    return done


def _cut(positions: Floats, cluster: Members) -> list[Members]:
    """The two halves of a cluster of several places, cut across the middle of its longer axis."""
    offsets = positions[cluster] - _centroid(positions[cluster])
    offsets /= np.abs(offsets).max()
    axis = np.linalg.eigh(offsets.T @ offsets)[1][:, -1]
    along = offsets @ axis
    return _split(cluster, (along > (along.min() + along.max()) / 2).astype(np.int64))


def _lower_bound(problem: Problem, demand: Floats) -> int:
    """No fewer UAVs can serve these devices: by K_max, and by the power to serve each from straight above."""
    by_power = math.fsum(demand) * problem.link.altitude_m**2 / problem.link.power_eta
    return max(1, math.ceil(len(demand) / problem.cell_limit), math.ceil(by_power * (1 - RELATIVE_TOLERANCE)))


def _k_means_plus_plus(points: Floats, places: int, rng: np.random.Generator) -> Floats:
    """Every place once, in the order in which k-means++ drew them, (places, 2).

    The draws are those of SciPy's `kmeans2`, which works out all the distances anew for each of them: in 13 s for 1000
    devices.
    """
    drawn = np.empty(places, np.int64)
    drawn[0] = rng.integers(len(points))
    nearest2 = np.full(len(points), np.inf)
    # Places whose squared distance underflows cannot be told apart; those drawn twice leave clusters empty.
    with np.errstate(invalid="ignore"):
        for i in range(1, places):
            nearest2 = np.minimum(nearest2, ((points - points[drawn[i - 1]]) ** 2).sum(axis=1))
            below = (nearest2 / nearest2.sum()).cumsum()
            drawn[i] = min(int(np.searchsorted(below, rng.uniform())), len(points) - 1)
    centroids: Floats = points[drawn]
    return centroids


def _lloyd(points: Floats, centroids: Floats) -> NDArray[np.int32]:
    """Cluster of each point: Lloyd's algorithm until nothing changes. A cluster may be empty."""
    labels: NDArray[np.int32] = np.full(len(points), -1, np.int32)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for _ in range(LOOKS):
            before = labels
            centroids, labels = kmeans2(points, centroids, iter=ITERATIONS, minit="matrix")
            if np.array_equal(before, labels):
                break
    return labels


def _sum_of_squares(positions: Floats, clusters: list[Members]) -> float:
    """The quantity that k-means minimises: squared distances of all devices to their centroids [m^2]."""
    offsets = (positions[cluster] - _centroid(positions[cluster]) for cluster in clusters)
    return sum(float((offset**2).sum()) for offset in offsets)


def _split(members: Members, labels: NDArray[np.signedinteger]) -> list[Members]:
    """Members by label, largest cluster first; empty clusters dropped."""
    order = np.argsort(labels, kind="stable")
    groups = np.split(members[order], np.flatnonzero(np.diff(labels[order])) + 1)
    return sorted((group for group in groups if len(group)), key=len, reverse=True)


def _centroid(points: Floats) -> Floats:
    # Relative to one of the points: exact where all are the same, and precise far from the origin.
    centroid: Floats = points[0] + (points - points[0]).mean(axis=0)
    return centroid


def _satisfied(problem: Problem, allocation: Allocation, demand: Floats, cell: Members) -> bool:
    """Whether one UAV over the centroid meets every demand of the cell."""
    if len(cell) > problem.cell_limit:
        return False
    points = problem.positions[cell]
    squared_distance = ((points - _centroid(points)) ** 2).sum(axis=1)
    reach = allocation.squared_radii(demand[cell], problem.link) * (1 + RELATIVE_TOLERANCE)
    return bool((squared_distance <= reach).all())


def _set_crowds_aside(problem: Problem, allocation: Allocation, demand: Floats) -> tuple[list[Members], Members]:
    """Cells of devices that stand at one place and exceed one UAV, and all the other devices."""
    _, place_of = np.unique(problem.positions, axis=0, return_inverse=True)
    aside: list[Members] = []
    for crowd in _split(np.arange(len(demand)), place_of.reshape(-1)):
        if _satisfied(problem, allocation, demand, crowd):
            continue
        packed: list[list[int]] = []
        for device in crowd[np.argsort(-demand[crowd], kind="stable")].tolist():
            for cell in packed:
                if _satisfied(problem, allocation, demand, np.array([*cell, device])):
                    cell.append(device)
                    break
            else:
                packed.append([device])
        aside += [np.array(cell) for cell in packed[:-1]]
    rest = np.ones(len(demand), bool)
    for full in aside:
        rest[full] = False
    return aside, np.flatnonzero(rest)

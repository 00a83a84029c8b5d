"""Spiral baseline: place UAVs along the boundary of the uncovered devices, inwards turn by turn."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from jpap_ros.planning.allocation import EPA, QDPA, Allocation
from jpap_ros.planning.cells import deploy
from jpap_ros.planning.deployment import Deployment
from jpap_ros.planning.geometry import RELATIVE_TOLERANCE, common_point
from jpap_ros.planning.link_budget import Floats
from jpap_ros.planning.solver import Problem

Members = NDArray[np.int64]


def spiral_qdpa(problem: Problem) -> Deployment:
    """Spiral placement with QoS demand based power allocation; see `spiral`."""
    return deploy(problem, "spiral_qdpa", QDPA, *spiral(problem, QDPA))


def spiral_epa(problem: Problem) -> Deployment:
    """Spiral placement with equal power allocation, each device with its own radius (5); see `spiral`."""
    return deploy(problem, "spiral_epa", EPA, *spiral(problem, EPA))


def spiral(problem: Problem, allocation: Allocation) -> tuple[list[Members], Floats]:
    """Cells and UAV positions of the spiral placement.

    Parameters
    ----------
    problem : Problem
    allocation : Allocation
        The rule that splits a UAV's power, and with it the coverage radii.

    Returns
    -------
    cells : list of (n,) int
        Devices of each UAV.
    positions : (N, 2) float
        Position of each UAV [m], in the order of placement.

    Notes
    -----
    Lyu, Zeng, Zhang and Lim, "Placement optimization of UAV-mounted mobile base stations", IEEE Communications
    Letters 21(3), 2017 (arXiv 1612.01047). The boundary devices are the corners of the convex hull of the uncovered
    devices, counter-clockwise. Each UAV starts over one of them; a local cover (`_local_cover`) first takes in other
    boundary devices, then, from the position so reached, inner ones. The next UAV starts over the next boundary device
    of the old hull that is still uncovered, or, where none is left, on the new hull.

    There, each UAV covers what is within one fixed radius r. Here the radii follow from the power allocation, and so
    from the set S of devices at hand: d_k(S) of equation (11) under QDPA, of (5) with P_T / |S| under EPA. Hence

    * "u covers k" becomes: from u, every device of S + k is within its radius for S + k;
    * "the smallest enclosing circle of S + k has a radius of at most r" becomes: the discs of radii d_k(S + k) round
      the devices of S + k share a point; the UAV moves to the deepest such point, which for QDPA is the centre of
      that circle;
    * "k is more than 2 r from a device of S" becomes: their two discs for S + k do not meet;
    * a cell of K_max devices is full.

    With equal demands and a radius that did not depend on |S|, this is the published algorithm.

    The UAV stays where its local cover ends: at the deepest point common to the discs of its cell. The published
    algorithm leaves the first boundary device open; here it is the one farthest from the mean of the uncovered
    devices, so that translation, rotation and order of the devices change nothing (but ties).
    """
    demand = problem.snr_demand
    uncovered = np.ones(len(demand), bool)
    cells: list[Members] = []
    centres: list[Floats] = []
    boundary: list[int] = []
    while uncovered.any():
        hull = convex_hull(problem.positions, np.flatnonzero(uncovered))
        left = set(hull)
        first = next((k for k in boundary if k in left), None)
        if first is None:
            first = _farthest_out(problem.positions, uncovered, hull)
        at = hull.index(first)
        boundary = hull[at + 1 :] + hull[:at]
        cover = _LocalCover(problem, allocation, demand, first)
        cover.extend(np.array(boundary, np.int64))
        inner = uncovered.copy()
        inner[hull] = False
        cover.extend(np.flatnonzero(inner))
        cells.append(np.array(cover.members))
        centres.append(cover.position)
        uncovered[cover.members] = False
    return cells, np.array(centres).reshape(-1, 2)


class _LocalCover:
    """One UAV and the devices S it covers so far."""

    def __init__(self, problem: Problem, allocation: Allocation, demand: Floats, first: int) -> None:
        self._problem, self._allocation, self._demand = problem, allocation, demand
        self.members = [first]
        self.position: Floats = problem.positions[first]

    def extend(self, candidates: Members) -> None:
        """Take in candidates: those covered as it stands, then the nearest other one, again and again until it fails.

        Then move to the deepest point common to the discs of S.
        """
        remaining = [k for k in self._nearest_first(self._perhaps_near(candidates)) if self._discs_meet(k)]
        while remaining and not self._full:
            remaining = [k for k in remaining if not self._take_in_from_here(k)]
            if not remaining or self._full or not self._move_to_take_in(remaining.pop(0)):
                break
            remaining = [k for k in self._nearest_first(remaining) if self._discs_meet(k)]
        deepest = self._common_point(self.members)
        # None only by rounding; the position reached covers S as well.
        self.position = self.position if deepest is None else deepest

    @property
    def _full(self) -> bool:
        return len(self.members) >= self._problem.cell_limit

    def _take_in_from_here(self, k: int) -> bool:
        """Take in k if, from the present position, every device of S + k is within its radius for S + k."""
        joined = [*self.members, k]
        squared_distance = ((self._problem.positions[joined] - self.position) ** 2).sum(axis=1)
        if self._full or (squared_distance > self._squared_radii(joined)).any():
            return False
        self.members = joined
        return True

    def _move_to_take_in(self, k: int) -> bool:
        """Take in k and move to the deepest common point of the discs of S + k, if there is one."""
        joined = [*self.members, k]
        point = self._common_point(joined)
        if point is None:
            return False
        self.members, self.position = joined, point
        return True

    def _discs_meet(self, k: int) -> bool:
        """Whether the disc of k for S + k meets that of each device of S."""
        joined = [*self.members, k]
        squared = self._squared_radii(joined)
        if squared.min() < 0:
            return False
        radii = np.sqrt(squared)
        offset = self._problem.positions[self.members] - self._problem.positions[k]
        reach = (radii[:-1] + radii[-1]) * (1 + RELATIVE_TOLERANCE)
        return bool((np.hypot(*offset.T) <= reach).all())

    def _perhaps_near(self, candidates: Members) -> list[int]:
        """Candidates whose disc meets that of the first device if each has all the power: the rest has no chance."""
        link, first = self._problem.link, self.members[0]
        most = np.sqrt(np.maximum(link.power_eta / self._demand - link.altitude_m**2, 0))
        offset = self._problem.positions[candidates] - self._problem.positions[first]
        near: list[int] = candidates[np.hypot(*offset.T) <= most[candidates] + most[first] + 1].tolist()
        return near

    def _nearest_first(self, candidates: list[int]) -> list[int]:
        offset = self._problem.positions[candidates] - self.position
        return [candidates[i] for i in np.argsort((offset**2).sum(axis=1), kind="stable")]

    def _squared_radii(self, members: list[int]) -> Floats:
        return self._allocation.squared_radii(self._demand[members], self._problem.link)

    def _common_point(self, members: list[int]) -> Floats | None:
        return common_point(self._problem.positions[members], self._squared_radii(members))


def convex_hull(points: Floats, members: Members) -> list[int]:
    """Corners of the convex hull of some points, counter-clockwise from the leftmost (Andrew's monotone chain).

    Points on an edge are no corners; of points at one place the one with the lowest index is. Two points or points on
    one line give the two ends, a single place gives one corner.

    Parameters
    ----------
    points : (K, 2) float
    members : (n,) int
        Indices of the points to take; n >= 1.
    """
    order = members[np.lexsort((members, points[members, 1], points[members, 0]))]
    distinct = np.r_[True, (np.diff(points[order], axis=0) != 0).any(axis=1)]
    corners = [(*point, k) for point, k in zip(points[order].tolist(), order.tolist(), strict=True)]
    ordered = [corner for corner, new in zip(corners, distinct, strict=True) if new]
    if len(ordered) == 1:
        return [ordered[0][2]]
    return _chain(ordered)[:-1] + _chain(ordered[::-1])[:-1]


def _chain(ordered: list[tuple[float, float, int]]) -> list[int]:
    """The part of the hull that turns left all the way from the first to the last of the points."""
    chain: list[tuple[float, float, int]] = []
    for point in ordered:
        while len(chain) > 1 and _turn(chain[-2], chain[-1], point) <= 0:
            chain.pop()
        chain.append(point)
    return [k for _, _, k in chain]


def _turn(a: tuple[float, float, int], b: tuple[float, float, int], c: tuple[float, float, int]) -> float:
    """Twice the signed area of the triangle a, b, c: positive for a left turn."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _farthest_out(points: Floats, uncovered: np.ndarray, hull: list[int]) -> int:
    """The corner of the hull that is farthest from the mean of the uncovered points."""
    offset = points[hull] - points[uncovered].mean(axis=0)
    return hull[int(((offset**2).sum(axis=1)).argmax())]

"""The JPAP scheme, section IV-C of the paper, for any power allocation rule.

The scheme takes a dense boundary device, gives it all the power of a new UAV, and adds the device nearest to the
UAV as long as one position serves them all; then the next UAV. Where the text leaves room:

* of equally dense boundary devices, the one that demands most is taken, then the first in the paper's order: largest
  a, largest b, smallest a, smallest b. Where devices are equally extreme or equally near, the one with the lower
  index is taken;
* at most K_max devices get one UAV, constraint (6e); the listing's `i <= K_max` would let one more in;
* of positions whose rates differ by less than `placement.RATE_TOLERANCE` the UAV takes the one it reaches from where
  it is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from jpap_ros.planning.allocation import EPA, EPA_COMMON, QDPA, Allocation
from jpap_ros.planning.cells import deploy
from jpap_ros.planning.deployment import Deployment
from jpap_ros.planning.geometry import last_is_apart
from jpap_ros.planning.placement import place
from jpap_ros.planning.solver import Problem

#: Part by which a sum of weighted squares may be wrong from rounding.
ROUNDING = 1e-9


def jpap(problem: Problem) -> Deployment:
    """JPAP with QDPA: the scheme that the paper proposes."""
    return jpap_with("jpap", problem, QDPA)


def jpap_epa(problem: Problem) -> Deployment:
    """JPAP with equal power; every device has its own coverage radius (5)."""
    return jpap_with("jpap_epa", problem, EPA)


def jpap_epa_common(problem: Problem) -> Deployment:
    """JPAP with equal power; the smallest coverage radius (5) of a cell holds for all its devices."""
    return jpap_with("jpap_epa_common", problem, EPA_COMMON)


def jpap_with(scheme: str, problem: Problem, allocation: Allocation, *, skip_infeasible: bool = False) -> Deployment:
    """The listing of section IV-C.

    Parameters
    ----------
    scheme : str
        Name for the deployment.
    problem : Problem
        Each of its demands can be met by a UAV of its own.
    allocation : Allocation
        How a UAV splits its power.
    skip_infeasible : bool
        Leave out a device that cannot be added and go on with the next nearest. The listing (step 9) stops there.
    """
    devices = _Devices(problem)
    cells, positions = [], []
    while (first := devices.dense_boundary_device()) is not None:
        cell = _Cell(devices, first, allocation)
        candidates = _Candidates(problem.positions, devices.near(first))
        while len(cell.members) < problem.cell_limit:
            nearest = candidates.pop_nearest(cell.position)
            if nearest is None or not (cell.add(nearest) or skip_infeasible):
                break
        devices.remove(cell.members)
        cells.append(np.array(cell.members))
        positions.append(cell.position)
    return deploy(problem, scheme, allocation, cells, positions)


class _Devices:
    """The uncovered set K_U: its extremes, and the devices within the 2 d_k^0 area of one."""

    def __init__(self, problem: Problem) -> None:
        self.link = problem.link
        self.xs, self.ys = problem.positions[:, 0].tolist(), problem.positions[:, 1].tolist()
        self.demand = problem.snr_demand.tolist()
        # d_k^0 of equation (5) with all the power; rounding must not make the radius of a servable device imaginary.
        reach2 = problem.link.power_eta / problem.snr_demand - problem.link.altitude_m**2
        self.range = (2 * np.sqrt(np.maximum(reach2, 0))).tolist()
        self.uncovered = [True] * len(self.xs)
        self.tree = cKDTree(problem.positions) if self.xs else None
        self.found: dict[int, list[int]] = {}
        a, b = problem.positions.T
        # Lists whose last uncovered entry is the extreme device; of equals, the lowest index comes last.
        self.extremes = [np.argsort(key, kind="stable")[::-1].tolist() for key in (-a, -b, a, b)]

    def dense_boundary_device(self) -> int | None:
        """k_0: the boundary device with the most uncovered devices in its 2 d_k^0 area; None if all are covered."""
        best, best_key = None, (-1, 0.0)
        for order in self.extremes:
            while order and not self.uncovered[order[-1]]:
                order.pop()
            if order:
                key = len(self.near(order[-1])), self.demand[order[-1]]
                if key > best_key:
                    best, best_key = order[-1], key
        return best

    def near(self, device: int) -> list[int]:
        """K_0: the other uncovered devices within 2 d_k^0 of a device, in ascending order."""
        known = self.found.get(device)
        if known is None:
            assert self.tree is not None
            point = self.xs[device], self.ys[device]
            known = self.tree.query_ball_point(point, self.range[device], return_sorted=True)
            known.remove(device)
        self.found[device] = [other for other in known if self.uncovered[other]]
        return self.found[device]

    def remove(self, covered: list[int]) -> None:
        """Take devices out of the uncovered set."""
        for device in covered:
            self.uncovered[device] = False
            self.found.pop(device, None)


class _Candidates:
    """The candidates K_0 of one UAV, from which the nearest is taken again and again."""

    def __init__(self, positions: NDArray[np.float64], indices: list[int]) -> None:
        self.indices = indices
        # Complex numbers: the distances from a position in one step.
        self.points = positions[indices].view(np.complex128).ravel()
        self.left = len(indices)

    def pop_nearest(self, position: tuple[float, float]) -> int | None:
        """Take out the candidate with the shortest distance to a position; None if there is none left."""
        if not self.left:
            return None
        nearest = int(np.abs(self.points - complex(*position)).argmin())
        self.points[nearest] = np.inf
        self.left -= 1
        return self.indices[nearest]


class _Cell:
    """One UAV with the devices K_C that it covers, and its best position v*."""

    def __init__(self, devices: _Devices, first: int, allocation: Allocation) -> None:
        self.devices, self.allocation = devices, allocation
        self.power_eta, self.height2 = devices.link.power_eta, devices.link.altitude_m**2
        self.members = [first]
        self.xs, self.ys, self.demand = [devices.xs[first]], [devices.ys[first]], [devices.demand[first]]
        self.position = self.xs[0], self.ys[0]
        self.squared_radii = allocation.split(self.demand, self.power_eta, self.height2)[1]
        # Sums of w, w x, w y and w (x^2 + y^2), relative to the first device.
        self.sums = (self.demand[0], 0.0, 0.0, 0.0)

    def add(self, device: int) -> bool:
        """Cover one more device from the best position for all, if there is any; else change nothing."""
        x, y, w = self.devices.xs[device], self.devices.ys[device], self.devices.demand[device]
        dx, dy = x - self.xs[0], y - self.ys[0]
        sw, sx, sy, ss = self.sums
        sums = sw + w, sx + w * dx, sy + w * dy, ss + w * (dx * dx + dy * dy)
        if not self._enough_power(*sums):
            return False
        xs, ys, demand = [*self.xs, x], [*self.ys, y], [*self.demand, w]
        strengths, squared_radii = self.allocation.split(demand, self.power_eta, self.height2)
        if last_is_apart(xs, ys, squared_radii):
            return False
        position = place(xs, ys, strengths, squared_radii, self.height2, self.position)
        if position is None:
            return False
        self.members.append(device)
        self.xs, self.ys, self.demand, self.sums = xs, ys, demand, sums
        self.position, self.squared_radii = position, squared_radii
        return True

    def _enough_power(self, sw: float, sx: float, sy: float, ss: float) -> bool:
        """Whether any split of the power could serve devices with these sums.

        The power needed is sum w_k (|v - u_k|^2 + H^2) / eta, least at the w-weighted centroid.
        """
        needed = ss - (sx * sx + sy * sy) / sw + self.height2 * sw
        return needed <= self.power_eta * (1 + ROUNDING)

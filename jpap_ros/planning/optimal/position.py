"""The position and the powers that maximise one UAV's rate, to a stated tolerance, for many cells at a time.

Branch and bound over squares of positions. With the power shared out by water-filling, the rate R(v) of a set is, by
Lagrangian duality, at most

    P_T / level + sum over k of phi_k(q_k(v)) [nat],    q_k(v) = |v - u_k|^2 + H^2,

for any water level, with equality for the right one; phi_k is convex and decreasing. On a square it lies below its
chord over the range of q_k, and a sum of chords is a concave paraboloid in v whose maximum over the square is at
hand. The error is of second order in the size of the square. docs/optimal.md has the proof.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from jpap_ros.planning.link_budget import Floats
from jpap_ros.planning.optimal.servability import Ints, Servability, Sets
from jpap_ros.planning.water_filling import water_fill

#: Largest distance between the rate of a returned position and the best there is [bit/s/Hz].
RATE_TOLERANCE = 5e-4
_MOST_ROUNDS = 60


@dataclass(frozen=True, eq=False)
class Hover:
    """Best positions of many sets.

    Attributes
    ----------
    position : (n, 2) float
        [m]
    rate : (n,) float
        Sum rate there, with water-filling [bit/s/Hz].
    bound : (n,) float
        Proven upper bound on the sum rate from any position [bit/s/Hz].
    """

    position: Floats
    rate: Floats
    bound: Floats


def best_positions(
    servability: Servability, members: list[Ints], sets: Sets, power_eta: float, rounds: int = _MOST_ROUNDS
) -> Hover:
    """The position of each servable set that maximises its water-filled rate.

    Parameters
    ----------
    members : list of int arrays
        The sets.
    sets : Sets
        Their measures.
    power_eta : float
        P_T eta [m^2].
    rounds : int
        Most halvings of the squares; the default ends with every bound within RATE_TOLERANCE of the rate, fewer
        give a quick estimate with its bound.
    """
    count = len(members)
    hover = Hover(np.empty((count, 2)), np.empty(count), np.empty(count))
    sizes = np.array([len(m) for m in members], dtype=np.int64)
    for size in np.unique(sizes):
        which = np.flatnonzero(sizes == size)
        search = _Search(servability, np.array([members[i] for i in which]), sets[which], power_eta)
        search.run(rounds)
        hover.position[which], hover.rate[which], hover.bound[which] = search.position, search.rate, search.bound
    return hover


def share_power(servability: Servability, members: Ints, position: Floats, power_eta: float) -> tuple[Floats, Floats]:
    """Water-filled powers, as shares of P_T, and rates [bit/s/Hz] of sets of one size at given positions.

    Parameters
    ----------
    members : (n, m) int
    position : (n, 2) float

    Returns
    -------
    power, rate : (n, m) float
    """
    q = _squared_distance(servability, members, position)
    power = water_fill(q / power_eta, servability.demand[members] * q, np.ones(len(q)))
    rate: Floats = np.log2(1 + power * power_eta / q)
    return power, rate


def _squared_distance(servability: Servability, members: Ints, position: Floats) -> Floats:
    q: Floats = ((servability.positions[members] - position[:, None]) ** 2).sum(axis=2) + servability.height2
    return q


class _Search:
    """Branch and bound over positions, for sets of one size side by side."""

    def __init__(self, servability: Servability, members: Ints, sets: Sets, power_eta: float) -> None:
        self.servability, self.members, self.sets, self.power_eta = servability, members, sets, power_eta
        self.position = sets.centroid.copy()
        self.rate = share_power(servability, members, self.position, power_eta)[1].sum(axis=1)
        self.bound = np.full(len(members), math.inf)

    def run(self, rounds: int) -> None:
        # A point outside the hull of its devices can be moved nearer to all of them.
        u = self.servability.positions[self.members]
        reach = self.sets.slack_radius[:, None]
        low = np.maximum(u.min(axis=1), self.sets.centroid - reach)
        high = np.minimum(u.max(axis=1), self.sets.centroid + reach)
        owner = np.arange(len(self.members))
        centre, half = (low + high) / 2, (high - low).max(axis=1) / 2
        bound = np.full(len(owner), math.inf)
        for _ in range(rounds):
            bound = np.minimum(bound, self._examine(owner, centre, half))
            alive = bound > self.rate[owner] + RATE_TOLERANCE
            self.bound = self.rate + RATE_TOLERANCE
            np.maximum.at(self.bound, owner[alive], bound[alive])
            if not alive.any():
                break
            owner, centre, half = owner[alive], centre[alive], half[alive] / 2
            owner, half, bound = np.repeat(owner, 4), np.repeat(half, 4), np.repeat(bound[alive], 4)
            quarters = np.tile([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]], (len(centre), 1))
            centre = np.repeat(centre, 4, axis=0) + quarters * half[:, None]
            outside = np.maximum(np.abs(centre - self.sets.centroid[owner]) - half[:, None], 0)
            reached = (outside**2).sum(axis=1) <= self.sets.slack_radius[owner] ** 2 * (1 + 1e-9)
            owner, centre, half, bound = owner[reached], centre[reached], half[reached], bound[reached]

    def _examine(self, owner: Ints, centre: Floats, half: Floats) -> Floats:
        """Try positions in each square, keep the best of each set, and return the bound of each square."""
        members = self.members[owner]
        demand = self.servability.demand[members]
        power, q = self._try(owner, centre)
        # The water level of the set at the square's centre; any level gives a valid bound.
        dry = power <= demand * q * (1 + 1e-9)
        level = np.where(dry, np.inf, power + q / self.power_eta).min(axis=1)
        level = np.where(np.isinf(level), (demand * q + q / self.power_eta).min(axis=1), level)[:, None]
        away = np.abs(self.servability.positions[members] - centre[:, None])
        near = (np.maximum(away - half[:, None, None], 0) ** 2).sum(axis=2) + self.servability.height2
        far = ((away + half[:, None, None]) ** 2).sum(axis=2) + self.servability.height2
        at_near, at_far = self._phi(near, demand, level), self._phi(far, demand, level)
        span = far - near
        slope = np.where(span > 0, (at_near - at_far) / np.where(span > 0, span, 1.0), 1 / far)
        u = self.servability.positions[members]
        weight = slope.sum(axis=1, keepdims=True)
        top = (slope[:, :, None] * u).sum(axis=1) / weight
        top = centre + np.clip(top - centre, -half[:, None], half[:, None])
        self._try(owner, top)
        at_top = ((u - top[:, None]) ** 2).sum(axis=2) + self.servability.height2
        bound: Floats = ((at_near - slope * (at_top - near)).sum(axis=1) + 1 / level[:, 0]) / math.log(2)
        return bound

    def _phi(self, q: Floats, demand: Floats, level: Floats) -> Floats:
        """Max over P >= demand q of ln(1 + P power_eta / q) - P / level."""
        noise = q / self.power_eta
        power = np.maximum(demand * q, level - noise)
        value: Floats = np.log1p(power / noise) - power / level
        return value

    def _try(self, owner: Ints, position: Floats) -> tuple[Floats, Floats]:
        """Share the power from the feasible point nearest to each position; remember the best of each set."""
        centroid, reach = self.sets.centroid[owner], self.sets.slack_radius[owner]
        away = position - centroid
        distance = np.hypot(away[:, 0], away[:, 1])
        shrink = np.minimum(1.0, reach / np.maximum(distance, 1e-300))
        point = centroid + away * shrink[:, None]
        members = self.members[owner]
        q = _squared_distance(self.servability, members, point)
        power = water_fill(q / self.power_eta, self.servability.demand[members] * q, np.ones(len(q)))
        rate = np.log2(1 + power * self.power_eta / q).sum(axis=1)
        order = np.argsort(rate, kind="stable")  # the last of each set, its best, wins
        best = np.full(len(self.rate), -1)
        best[owner[order]] = order
        tried = np.flatnonzero(best >= 0)
        better = tried[rate[best[tried]] > self.rate[tried]]
        self.rate[better], self.position[better] = rate[best[better]], point[best[better]]
        return power, q

"""The scheme `optimal`: the smallest fleet, proven, then the largest average UAV rate with that fleet."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from jpap_ros.planning.deployment import Deployment, make_deployment
from jpap_ros.planning.jpap import jpap, jpap_epa, jpap_epa_common
from jpap_ros.planning.kmeans import kmeans_epa, kmeans_qdpa
from jpap_ros.planning.limits import explain, limit_fleet
from jpap_ros.planning.link_budget import Floats
from jpap_ros.planning.optimal.enumeration import TooManySets, all_sets, maximal_sets
from jpap_ros.planning.optimal.fleet import Fleet, first_cells, smallest_fleet
from jpap_ros.planning.optimal.partition import Partition, RateProgram
from jpap_ros.planning.optimal.position import RATE_TOLERANCE, best_positions, share_power
from jpap_ros.planning.optimal.rate_search import RateSearch
from jpap_ros.planning.optimal.servability import Ints, Servability
from jpap_ros.planning.optimal.service import serve_most
from jpap_ros.planning.separation import keep_apart, never_apart, spread
from jpap_ros.planning.solver import Problem
from jpap_ros.planning.spiral import spiral_epa, spiral_qdpa

#: Time that the scheme takes at most where the caller sets no limit [s].
DEFAULT_TIME_S = 30.0
#: Share of the time that the proof of the smallest fleet may take; the rate gets the rest.
_FLEET_SHARE = 0.85
#: A deployment is made from a better fleet when this many times the time that it takes has passed.
_YIELD_EVERY = 20
#: Kept back from the time limit for the last steps, which cannot be interrupted.
_RESERVE = 0.05
#: Most servable sets with which the rate is solved as one program.
_MOST_RATE_SETS = 20_000
#: Share of the time for the rate that its program may take, before local search takes over.
_PROGRAM_SHARE = 0.75
#: Schemes whose partitions are starts for the local search, and the most devices for which they are quick.
_RIVALS = (jpap, jpap_epa, jpap_epa_common, spiral_qdpa, spiral_epa, kmeans_qdpa, kmeans_epa)
_MOST_DEVICES_FOR_RIVALS = 150
_MOST_MAXIMAL_SETS = 300_000
#: Most pairs of sets that are kept apart in one program.
_MOST_PAIRS = 50_000


def optimal(problem: Problem) -> Deployment:
    """Solve P1: the fewest UAVs, then the partition, positions and powers of the largest average rate.

    Returns the best deployment found by `problem.deadline`, or in DEFAULT_TIME_S where there is none, with its
    bounds; earlier where nothing is left to prove.
    """
    *_, best = improve(problem)
    return best


def improve(problem: Problem) -> Iterator[Deployment]:
    """Yield ever better deployments, the first one as good as `jpap` at once, until proven or the deadline.

    Each has fewer UAVs, a better bound or a larger average rate than the one before; the last is the best.
    """
    count = len(problem.rates)
    if count == 0 or problem.max_uavs == 0:
        yield limit_fleet(problem, _nothing(problem) if count == 0 else _jpap(problem))
        return
    began = time.monotonic()
    deadline = problem.deadline if math.isfinite(problem.deadline) else began + DEFAULT_TIME_S
    deadline -= _RESERVE * max(deadline - began, 0)
    solver = _Solver(problem, deadline)
    paper = _jpap(problem)
    start = [paper.cell(uav) for uav in range(len(paper.uav_positions))]
    quick = first_cells(solver.servability)
    yield from solver.run(start, quick if len(quick) < len(start) else start)


def _jpap(problem: Problem) -> Deployment:
    return jpap(replace(problem, max_uavs=None, min_separation_m=0.0))


def _nothing(problem: Problem) -> Deployment:
    return make_deployment(
        "optimal", problem.positions, problem.rates, problem.link, [], np.empty((0, 2)), np.empty(0),
        unserved={}, min_uavs_bound=0, proven_optimal=True,
    )  # fmt: skip


class _Solver:
    """One run of the scheme on one problem."""

    def __init__(self, problem: Problem, deadline: float) -> None:
        self.problem, self.deadline = problem, deadline
        self.servability = Servability.of(problem)
        self.power_eta = problem.link.power_eta

    def run(self, paper: list[Ints], start: list[Ints]) -> Iterator[Deployment]:
        """Yield deployments as they are found, from the cells of `jpap` and a start with no more cells."""
        began = time.monotonic()
        prove_until = began + _FLEET_SHARE * (self.deadline - began)
        fleet = Fleet(start, 1)
        next_yield = began
        for better in smallest_fleet(self.servability, start, prove_until, self.problem.seed):
            fleet = better
            now = time.monotonic()
            if now >= next_yield:
                deployment = self._deploy(fleet, self._hover(fleet.cells))
                next_yield = now + _YIELD_EVERY * (time.monotonic() - now)
                yield deployment
        if self.problem.max_uavs is not None and len(fleet.cells) > self.problem.max_uavs:
            yield self._deploy_limited(fleet, self._largest_rate(self._serve_most(fleet, self.problem.max_uavs)))
            return
        cells = fleet.cells
        if len(paper) == len(cells):
            cells = max(cells, paper, key=lambda some: self._hover(some).total_rate)
        partition = self._largest_rate(cells)
        if self.problem.min_separation_m > 0:
            fleet, partition = self._apart(fleet, partition)
        yield self._deploy(fleet, partition)

    def _serve_most(self, fleet: Fleet, uavs: int) -> list[Ints]:
        """Cells for a fleet that is too small: the most weight, then the most demanded rate."""
        until = time.monotonic() + 0.5 * (self.deadline - time.monotonic())
        try:
            members, _ = maximal_sets(self.servability, _MOST_MAXIMAL_SETS, until)
        except TooManySets:
            members = fleet.cells
        chosen = serve_most(members, self.problem.weights, self.problem.rates, uavs, until)
        if chosen is None:
            # Disjoint cells: the choice among them is quick.
            chosen = serve_most(fleet.cells, self.problem.weights, self.problem.rates, uavs, math.inf)
            assert chosen is not None
        return chosen

    def _hover(self, cells: list[Ints]) -> Partition:
        """The cells as they are, each from its best position."""
        hover = best_positions(self.servability, cells, self.servability.measure_all(cells), self.power_eta)
        bound = float(hover.bound[0]) if len(cells) == 1 else math.inf
        return Partition(cells, hover.position, hover.rate, bound)

    def _largest_rate(self, cells: list[Ints]) -> Partition:
        """Re-partition the devices of these cells into as many cells of the largest rate."""
        if len(cells) == 1:
            return self._hover(cells)
        devices = np.concatenate(cells)
        part = self.servability.subset(devices)
        number = np.full(len(self.servability), -1)
        number[devices] = np.arange(len(devices))
        local = [number[cell] for cell in cells]
        found = None
        began = time.monotonic()
        try:
            members, sets = all_sets(part, _MOST_RATE_SETS, began + 0.3 * (self.deadline - began))
        except TooManySets:
            pass
        else:
            program = RateProgram(part, members, sets, self.power_eta)
            found = program.solve(len(local), local, began + _PROGRAM_SHARE * (self.deadline - began))
            assert found is not None
        if found is None or found.bound - found.total_rate > 2 * len(cells) * RATE_TOLERANCE:
            found = self._search_rate(part, local if found is None else found.cells, found, devices)
        bound = min(found.bound, _simple_rate_bound(len(devices), len(cells), self.problem))
        return replace(found, cells=[devices[cell] for cell in found.cells], bound=bound)

    def _search_rate(self, part: Servability, cells: list[Ints], proven: Partition | None, devices: Ints) -> Partition:
        """Local search from the best partition into so many cells that this or any other scheme has found."""
        starts = [cells]
        if len(devices) == len(self.servability) <= _MOST_DEVICES_FOR_RIVALS:
            free = replace(self.problem, max_uavs=None, min_separation_m=0.0)
            number = np.argsort(devices)
            for rival in _RIVALS:
                if time.monotonic() > self.deadline:
                    break
                other = rival(free)
                if len(other.uav_positions) == len(cells):
                    starts.append([number[other.cell(uav)] for uav in range(len(cells))])
        searches = [RateSearch(part, start, self.power_eta) for start in starts]
        best = max(searches, key=lambda search: float(search.rates.sum()))
        found = best.run(self.deadline, self.problem.seed)
        return found if proven is None else replace(found, bound=proven.bound)

    def _apart(self, fleet: Fleet, partition: Partition) -> tuple[Fleet, Partition]:
        """Cells whose UAVs can hover apart, at the least cost in UAVs where all servable sets are known."""
        separation = self.problem.min_separation_m
        positions = self._spread(partition)
        if positions is not None:
            return fleet, replace(partition, positions=positions)
        try:
            members, sets = all_sets(self.servability, _MOST_RATE_SETS, self.deadline)
            pairs = never_apart(members, sets, separation, _MOST_PAIRS)
        except TooManySets:
            return fleet, partition
        program = RateProgram(self.servability, members, sets, self.power_eta)
        bound, proven = fleet.bound, fleet.proven
        limit = len(self.servability) if self.problem.max_uavs is None else self.problem.max_uavs
        for uavs in range(len(fleet.cells), limit + 1):
            found = program.solve(uavs, None, self.deadline, pairs)
            if time.monotonic() > self.deadline:
                break
            if found is None:
                # No partition into so many cells keeps apart what must be.
                bound = uavs + 1 if proven else bound
                continue
            positions = self._spread(found)
            if positions is not None:
                return Fleet(found.cells, bound), replace(found, positions=positions)
            # Any two can be kept apart, but all together were not: more UAVs are tried, without proof.
            proven = False
        return fleet, partition

    def _spread(self, partition: Partition) -> Floats | None:
        sets = self.servability.measure_all(partition.cells)
        positions = spread(partition.positions, sets, self.problem.min_separation_m, self.problem.seed)
        gaps = np.hypot(*(positions[:, None] - positions[None]).transpose(2, 0, 1))
        gaps[np.diag_indices(len(gaps))] = np.inf
        return positions if gaps.min(initial=np.inf) >= self.problem.min_separation_m else None

    def _deploy_limited(self, fleet: Fleet, partition: Partition) -> Deployment:
        made = self._deploy(fleet, partition)
        unexplained = [k for k in np.flatnonzero(made.serving_uav < 0).tolist() if k not in made.unserved]
        cells = [made.cell(uav) for uav in range(len(made.uav_positions))]
        reasons = explain(self.problem, cells, np.array(unexplained, dtype=np.int64), len(fleet.cells))
        return replace(made, unserved=dict(sorted({**made.unserved, **reasons}.items())))

    def _deploy(self, fleet: Fleet, partition: Partition) -> Deployment:
        problem = self.problem
        # The search may end at the same cells in another order, depending on when it was interrupted.
        order = np.argsort([cell.min() for cell in partition.cells])
        cells, positions = [partition.cells[uav] for uav in order], partition.positions[order]
        power = np.zeros(len(problem.rates))
        for cell, position in zip(cells, positions, strict=True):
            shares, _ = share_power(self.servability, cell[None], position[None], self.power_eta)
            power[cell] = shares[0] * problem.link.transmit_power_w
        made = make_deployment(
            "optimal",
            problem.positions,
            problem.rates,
            problem.link,
            cells,
            positions,
            power,
            unserved={},
            uavs_needed=len(fleet.cells),
            min_uavs_bound=fleet.bound,
            proven_optimal=fleet.proven,
            average_uav_rate_bound=(partition.bound / len(partition.cells) if math.isfinite(partition.bound) else None),
        )
        return keep_apart(problem, limit_fleet(problem, made))


def _simple_rate_bound(devices: int, uavs: int, problem: Problem) -> float:
    """Total rate of all devices at no distance and equal powers; by concavity no split of them gives more."""
    return devices * math.log2(1 + problem.link.power_eta * uavs / (devices * problem.link.altitude_m**2))

"""The scheme `optimal`: the smallest fleet, proven, then the largest average UAV rate with that fleet."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from jpap_ros.planning.deployment import Deployment, make_deployment
from jpap_ros.planning.geometry import close_pairs
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
from jpap_ros.planning.optimal.service import Service
from jpap_ros.planning.separation import keep_apart, never_apart, no_place, spread
from jpap_ros.planning.solver import Problem
from jpap_ros.planning.spiral import spiral_epa, spiral_qdpa

#: Time that the scheme takes at most where the caller sets no limit [s].
DEFAULT_TIME_S = 30.0
#: Share of the time that the proof of the smallest fleet may take; the rate gets the rest.
_FLEET_SHARE = 0.85
#: Where the fleet seems to be too small: shares of the time that is left for a first look at the smallest fleet, for
#: the choice of whom to serve, and for the proof of the smallest fleet.
_FIRST_SHARE, _SERVICE_SHARE, _PROOF_SHARE = 0.3, 0.5, 0.6
#: Where UAVs must be kept apart: share of the time that is left for the rate, and then for other cells.
_RATE_SHARE = 0.6
#: A deployment is made from a better fleet when this many times the time that it takes has passed.
_YIELD_EVERY = 20
#: Kept back from the time limit for the last steps, which cannot be interrupted.
_RESERVE = 0.05
#: The same where UAVs must be kept apart, which is the last step.
_RESERVE_APART = 0.3
#: Most servable sets with which the rate is solved as one program.
_MOST_RATE_SETS = 20_000
#: Share of the time for the rate that its program may take, before local search takes over.
_PROGRAM_SHARE = 0.75
#: Schemes whose partitions are starts for the local search, and the most devices for which they are quick.
_RIVALS = (jpap, jpap_epa, jpap_epa_common, spiral_qdpa, spiral_epa, kmeans_qdpa, kmeans_epa)
_MOST_DEVICES_FOR_RIVALS = 150
#: Most maximal sets over which whom to serve is decided.
_MOST_SERVICE_SETS = 300_000
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
    deadline -= (_RESERVE_APART if problem.min_separation_m > 0 else _RESERVE) * max(deadline - began, 0)
    solver = _Solver(problem, deadline)
    paper = _jpap(problem)
    quick = first_cells(solver.servability)
    yield from solver.run(paper, quick if len(quick) < len(paper.uav_positions) else _cells(paper))


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
        self.limit = len(problem.rates) if problem.max_uavs is None else problem.max_uavs
        self.service = Service(self.servability, problem.weights, problem.rates, self.limit)
        #: All servable sets, and the pairs of them that can never be far enough apart, where they are known.
        self.program: tuple[list[Ints], Ints] | None = None

    def run(self, made_by_jpap: Deployment, start: list[Ints]) -> Iterator[Deployment]:
        """Yield deployments as they are found, from that of `jpap` and a start with no more cells."""
        fleet, limit, paper = Fleet(start, 1), self.limit, _cells(made_by_jpap)
        seen = []
        if self.problem.min_separation_m > 0:
            # As `jpap` itself would be kept apart, for where this scheme can serve no more.
            plain = keep_apart(self.problem, limit_fleet(self.problem, made_by_jpap))
            seen.append(replace(plain, scheme="optimal", coverage_radius_m=None))
        for better, made in self._prove(fleet, _FLEET_SHARE if len(start) <= limit else _FIRST_SHARE):
            fleet = better
            if made is not None:
                seen.append(made)
                yield made
            if fleet.bound > limit:
                break
        chosen = None
        if len(fleet.cells) > limit:
            # Whom to serve comes before how many more UAVs it would take.
            chosen = self._serve_most(fleet, paper, self._in(_SERVICE_SHARE))
            yield self._deploy(fleet, self._hover(chosen))
            for better, _ in self._prove(fleet, _PROOF_SHARE):
                fleet = better
        separation = self.problem.min_separation_m
        if len(fleet.cells) > limit:
            partition = self._hover(fleet.cells)
        else:
            cells, chosen = fleet.cells, None
            if len(paper) == len(cells):
                cells = max(cells, paper, key=lambda some: self._hover(some).total_rate)
            partition = self._largest_rate(cells, self._in(_RATE_SHARE) if separation > 0 else self.deadline)
        known = separation == 0
        if separation > 0:
            fleet, separated = self._apart(fleet, partition, self._in(_RATE_SHARE))
            known = separated is not None
            if separated is not None and len(fleet.cells) <= limit:
                partition = separated
        if known and len(fleet.cells) <= limit:
            yield self._deploy(fleet, partition, known)
            return
        # Not all can be served.
        choices = [partition if chosen is None else self._largest_rate(chosen, self.deadline)]
        if self.program is not None and (most := self._serve_most_apart()) is not None:
            choices.append(self._hover(most))
        deployments = [self._deploy(fleet, choice, known) for choice in choices]
        if separation > 0:
            # What was deployed first had more time for its separation.
            deployments += seen
        best = max(deployments, key=lambda made: (self.service.value(_cells(made)), -len(made.uav_positions)))
        needed = max(len(fleet.cells), fleet.bound) if best.unserved else len(best.uav_positions)
        yield replace(
            best,
            uavs_needed=needed,
            min_uavs_bound=fleet.bound,
            proven_optimal=needed == fleet.bound and (known or not best.unserved),
            served_weight_bound=self.service.bound if best.unserved else None,
        )

    def _prove(self, fleet: Fleet, share: float) -> Iterator[tuple[Fleet, Deployment | None]]:
        """Better fleets, found in this share of the time that is left, and now and then what they deploy."""
        if fleet.proven:
            yield fleet, None
            return
        bound, next_yield = fleet.bound, time.monotonic()
        for better in smallest_fleet(self.servability, fleet.cells, self._in(share), self.problem.seed):
            fleet, now, made = Fleet(better.cells, max(better.bound, bound)), time.monotonic(), None
            if now >= next_yield:
                made = self._deploy(fleet, self._hover(fleet.cells))
                next_yield = now + _YIELD_EVERY * (time.monotonic() - now)
            yield fleet, made

    def _in(self, share: float) -> float:
        """`time.monotonic()` when this share of the time that is left will have passed."""
        now = time.monotonic()
        return now + share * max(self.deadline - now, 0)

    def _serve_most(self, fleet: Fleet, paper: list[Ints], until: float) -> list[Ints]:
        """Cells for a fleet that is too small: the most weight, then the most demanded rate."""
        began = time.monotonic()
        greedy, pool = self.service.greedy(began + 0.5 * (until - began))
        starts = [self.service.fill(self.service.best_of(cells)) for cells in (fleet.cells, paper, greedy)]
        best = max(starts, key=self.service.value)
        try:
            every, _ = maximal_sets(
                self.servability, _MOST_SERVICE_SETS, time.monotonic() + 0.4 * (until - time.monotonic())
            )
        except TooManySets:
            every = None
        chosen = self.service.improve(best, [*pool, *fleet.cells, *paper], every, until)
        return max(best, self.service.fill(chosen), key=self.service.value)

    def _serve_most_apart(self) -> list[Ints] | None:
        """Cells that serve the most, none of which can never be apart."""
        assert self.program is not None
        members, pairs = self.program
        return self.service.choose(members, [], self.deadline, pairs, complete=True)

    def _hover(self, cells: list[Ints]) -> Partition:
        """The cells as they are, each from its best position."""
        hover = best_positions(self.servability, cells, self.servability.measure_all(cells), self.power_eta)
        bound = float(hover.bound[0]) if len(cells) == 1 else math.inf
        return Partition(cells, hover.position, hover.rate, bound)

    def _largest_rate(self, cells: list[Ints], until: float) -> Partition:
        """Re-partition the devices of these cells into as many cells of the largest rate, by the time given."""
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
            members, sets = all_sets(part, _MOST_RATE_SETS, began + 0.3 * (until - began))
        except TooManySets:
            pass
        else:
            program = RateProgram(part, members, sets, self.power_eta)
            found = program.solve(len(local), local, began + _PROGRAM_SHARE * (until - began))
            assert found is not None
        if found is None or found.bound - found.total_rate > 2 * len(cells) * RATE_TOLERANCE:
            found = self._search_rate(part, local if found is None else found.cells, found, devices, until)
        bound = min(found.bound, _simple_rate_bound(len(devices), len(cells), self.problem))
        return replace(found, cells=[devices[cell] for cell in found.cells], bound=bound)

    def _search_rate(
        self, part: Servability, cells: list[Ints], proven: Partition | None, devices: Ints, until: float
    ) -> Partition:
        """Local search from the best partition into so many cells that this or any other scheme has found."""
        starts = [cells]
        if len(devices) == len(self.servability) <= _MOST_DEVICES_FOR_RIVALS:
            free = replace(self.problem, max_uavs=None, min_separation_m=0.0)
            number = np.argsort(devices)
            for rival in _RIVALS:
                if time.monotonic() > until:
                    break
                other = rival(free)
                if len(other.uav_positions) == len(cells):
                    starts.append([number[other.cell(uav)] for uav in range(len(cells))])
        searches = [RateSearch(part, start, self.power_eta) for start in starts]
        best = max(searches, key=lambda search: float(search.rates.sum()))
        found = best.run(until, self.problem.seed)
        return found if proven is None else replace(found, bound=proven.bound)

    def _apart(self, fleet: Fleet, partition: Partition, until: float) -> tuple[Fleet, Partition | None]:
        """The smallest fleet whose UAVs can hover apart, and its cells and positions; None where none was found.

        More UAVs are flown only where no other cells do. The bound on the fleet is the better one in either case.
        """
        separation, count = self.problem.min_separation_m, len(self.servability)
        positions = self._spread(partition)
        if positions is not None:
            return fleet, replace(partition, positions=positions)
        try:
            members, sets = all_sets(self.servability, _MOST_RATE_SETS, until)
            pairs = never_apart(members, sets, separation, _MOST_PAIRS)
        except TooManySets:
            return fleet, None
        self.program = members, pairs
        program = RateProgram(self.servability, members, sets, self.power_eta)
        bound, proven = fleet.bound, fleet.proven
        for uavs in range(len(fleet.cells), count + 1):
            found = program.solve(uavs, None, until, pairs)
            if found is None:
                if time.monotonic() > until:
                    break
                # No partition into so many cells keeps apart what must be.
                bound = min(uavs + 1, count) if proven else bound
                continue
            positions = self._spread(found)
            if positions is not None:
                return Fleet(found.cells, bound), replace(found, positions=positions)
            # Any two can be kept apart, but all together were not: more UAVs are tried, without proof.
            proven = False
        return Fleet(fleet.cells, bound), None

    def _spread(self, partition: Partition) -> Floats | None:
        """Positions of the cells' UAVs that are apart; None where none are found."""
        separation = self.problem.min_separation_m
        sets = self.servability.measure_all(partition.cells)
        positions = spread(partition.positions, sets, separation, self.problem.seed, self.deadline)
        return None if len(close_pairs(positions, separation)) else positions

    def _deploy(self, fleet: Fleet, partition: Partition, known: bool = False) -> Deployment:
        """Fly a partition of all devices, or of those that are to be served.

        Parameters
        ----------
        known : bool
            Whether the cells of the fleet can hover apart.
        """
        problem = self.problem
        # The search may end at the same cells in another order, depending on when it was interrupted.
        order = np.argsort([cell.min() for cell in partition.cells])
        cells, positions = [partition.cells[uav] for uav in order], partition.positions[order]
        power = np.zeros(len(problem.rates))
        for cell, position in zip(cells, positions, strict=True):
            shares, _ = share_power(self.servability, cell[None], position[None], self.power_eta)
            power[cell] = shares[0] * problem.link.transmit_power_w
        left_out = np.setdiff1d(np.arange(len(power)), np.concatenate(cells))
        whole = not len(left_out)
        known = known or problem.min_separation_m == 0
        known = known or (whole and not len(close_pairs(positions, problem.min_separation_m)))
        needed = max(len(fleet.cells), fleet.bound)
        if len(cells) == problem.max_uavs:
            unserved = explain(problem, cells, positions, left_out, needed if known else None)
        else:
            unserved = dict.fromkeys(left_out.tolist(), no_place(problem))
        made = make_deployment(
            "optimal",
            problem.positions,
            problem.rates,
            problem.link,
            cells,
            positions,
            power,
            unserved=unserved,
            uavs_needed=needed,
            min_uavs_bound=fleet.bound,
            # Where UAVs are still to be moved apart, that they can be is the last part of the proof.
            proven_optimal=fleet.proven and (known or (whole and len(cells) <= self.limit)),
            served_weight_bound=self.service.bound,
            average_uav_rate_bound=(partition.bound / len(partition.cells) if math.isfinite(partition.bound) else None),
        )
        flown = keep_apart(problem, limit_fleet(problem, made), needed if known else None)
        return flown if flown.unserved else replace(flown, served_weight_bound=None)


def _cells(deployment: Deployment) -> list[Ints]:
    return [deployment.cell(uav) for uav in range(len(deployment.uav_positions))]


def _simple_rate_bound(devices: int, uavs: int, problem: Problem) -> float:
    """Total rate of all devices at no distance and equal powers; by concavity no split of them gives more."""
    return devices * math.log2(1 + problem.link.power_eta * uavs / (devices * problem.link.altitude_m**2))

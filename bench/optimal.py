"""The scheme `optimal`: time and gap over the number of devices, and what it gains over `jpap`.

Demands are uniform in [15, 20] bit/s/Hz and devices have the density of the paper's K = 100 where K is larger, its
1500 m x 1500 m where K is not. Times are CPU seconds of this one process, so that other load does not count; limits
of time given to `solve` are wall clock, as everywhere. `plain` is HiGHS on the set cover over all maximal servable
sets, without anything else, in the same run.

    scripts/bench optimal                # time and gap, gains, hard cases
    scripts/bench optimal --never-worse  # 1,000 mixed random instances against every other scheme
"""

from __future__ import annotations

import argparse
import math
import resource
import statistics
import time

import numpy as np

from jpap_ros.planning import SCHEMES, Deployment, LinkBudget, solve
from jpap_ros.planning.optimal.enumeration import all_sets, maximal_sets
from jpap_ros.planning.optimal.fleet import first_cells, smallest_fleet
from jpap_ros.planning.optimal.milp import incidence, minimise
from jpap_ros.planning.optimal.partition import RateProgram
from jpap_ros.planning.optimal.servability import Servability
from jpap_ros.planning.solver import Problem, validate

LINK = LinkBudget()
SIZES = (20, 40, 60, 80, 100)
HARD_CASES = (
    ("K = 1,000, demands [15, 20]", 1000, 15.0, 20.0, 30.0),
    ("K = 100, demands [13, 18]", 100, 13.0, 18.0, 30.0),
    ("K = 100, demands [10, 15]", 100, 10.0, 15.0, 60.0),
)


def instance(count: int, seed: int, low: float = 15.0, high: float = 20.0) -> Problem:
    """Devices uniform over the square."""
    draw = np.random.default_rng(seed)
    side = 1500.0 * math.sqrt(max(count, 100) / 100)
    return validate(
        draw.uniform(0, side, (count, 2)), draw.uniform(low, high, count), LINK, None, None, None, 0.0, None, 0
    )


def plain_milp(problem: Problem, seconds: float) -> tuple[float, float, float]:
    """Fleet, bound and CPU time of HiGHS alone."""
    started = time.process_time()
    count = len(problem.rates)
    members, _ = maximal_sets(Servability.of(problem))
    found = minimise(
        np.ones(len(members)), incidence(members, count), np.ones(count), np.full(count, np.inf),
        integer=True, deadline=time.monotonic() + seconds,
    )  # fmt: skip
    return found.objective, math.ceil(found.bound - 1e-6), time.process_time() - started


def prove_fleet(problem: Problem, seconds: float) -> tuple[int, int, float]:
    """Fleet, bound and CPU time of the first stage alone."""
    started = time.process_time()
    servability = Servability.of(problem)
    for fleet in smallest_fleet(servability, first_cells(servability), time.monotonic() + seconds, 0):  # noqa: B007
        pass
    return len(fleet.cells), fleet.bound, time.process_time() - started


def timed(problem: Problem, scheme: str, seconds: float | None = None) -> tuple[Deployment, float]:
    """Deployment and CPU time of a scheme."""
    started = time.process_time()
    found = solve(problem.positions, problem.rates, scheme, time_limit_s=seconds)
    return found, time.process_time() - started


def spread(values: list[float], digits: int = 2) -> str:
    """Median and worst."""
    return f"{statistics.median(values):.{digits}f} / {max(values):.{digits}f}"


def time_and_gap(draws: int) -> None:
    """Proof of the smallest fleet, with the plain MILP beside it; then the whole scheme against jpap."""
    print(f"CPU seconds, median / worst of {draws} draws; UAVs and rates are means")
    print("  K | fleet proven | time to prove | plain MILP    | all of optimal | rate proven | UAVs jpap, optimal,"
          " saved | rate jpap, optimal, gain")  # fmt: skip
    for count in SIZES:
        prove, plain, whole = [], [], []
        proven = rate_proven = 0
        fleets, rates = [], []
        for seed in range(draws):
            problem = instance(count, seed)
            size, bound, seconds = prove_fleet(problem, 30)
            prove.append(seconds)
            plain_size, plain_bound, seconds = plain_milp(problem, 60)
            plain.append(seconds)
            found, seconds = timed(problem, "optimal")
            whole.append(seconds)
            paper, _ = timed(problem, "jpap")
            assert found.violations(problem.positions, problem.rates, LINK) == []
            assert size == len(found.uav_positions) or bound < size
            assert plain_bound < plain_size or round(plain_size) == size
            proven += size == bound
            assert found.average_uav_rate_bound is not None
            rate_proven += found.average_uav_rate_bound - found.average_uav_rate <= 2e-3
            fleets.append((len(paper.uav_positions), len(found.uav_positions)))
            rates.append((paper.average_uav_rate, found.average_uav_rate))
        (before, after), (low, high) = np.mean(fleets, axis=0), np.mean(rates, axis=0)
        print(f"{count:4d} | {proven:2d} of {draws:2d}     | {spread(prove):13s} | {spread(plain):13s} |"
              f" {spread(whole):14s} | {rate_proven:2d} of {draws:2d}    | {before:5.1f} {after:5.1f}"
              f" {100 * (1 - after / before):4.1f} % | {low:5.2f} {high:5.2f} {100 * (high / low - 1):4.1f} %",
              flush=True)  # fmt: skip


def hard_cases(draws: int, stretch: float) -> None:
    """Large and dense instances: what is proven within the limit, which other load may stretch."""
    print("\nhard cases: UAVs, proven bound, gap, CPU s / wall s, jpap's UAVs")
    for name, count, low, high, limit in HARD_CASES:
        for seed in range(draws):
            problem = instance(count, seed, low, high)
            started = time.monotonic()
            found, seconds = timed(problem, "optimal", limit * stretch)
            wall = time.monotonic() - started
            paper = solve(problem.positions, problem.rates)
            assert found.violations(problem.positions, problem.rates, LINK) == []
            assert found.min_uavs_bound is not None
            size, bound = len(found.uav_positions), found.min_uavs_bound
            print(f"  {name}, draw {seed}, limit {limit:.0f} s: {size} >= {bound}, {100 * (size - bound) / size:.1f} %,"
                  f" {seconds:.1f} / {wall:.1f}, {len(paper.uav_positions)}", flush=True)  # fmt: skip
    print(f"peak memory: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.2f} GiB")


def which_count(draws: int) -> None:
    """Whether the smallest fleet maximises the objective of P1, the average rate, over all numbers of UAVs."""
    print("\nnumber of UAVs with the largest average rate (6a), proven")
    for count in SIZES[:3]:
        at_least = 0
        for seed in range(draws):
            problem = instance(count, seed)
            servability = Servability.of(problem)
            members, sets = all_sets(servability)
            program = RateProgram(servability, members, sets, LINK.power_eta)
            fewest = len(solve(problem.positions, problem.rates, "optimal").uav_positions)
            at_least += best_count(program, fewest, count) == fewest
        print(f"  K = {count}: the smallest fleet in {at_least} of {draws} draws", flush=True)


def best_count(program: RateProgram, fewest: int, most: int) -> int:
    """The number of UAVs of the largest average rate, by going up until the bound excludes all larger ones."""
    best, at = 0.0, fewest
    for uavs in range(fewest, most + 1):
        found = program.solve(uavs, None, math.inf)
        assert found is not None
        if found.total_rate / uavs > best:
            best, at = found.total_rate / uavs, uavs
        # (relaxed + n marginal) / (uavs + n) lies between its values at n = 1 and n = infinity.
        if max((found.relaxed + found.marginal) / (uavs + 1), found.marginal) < best:
            break
    return at


def never_worse(draws: int) -> None:
    """Mixed random instances against every other scheme."""
    worse = 0
    for seed in range(draws):
        draw = np.random.default_rng(seed)
        count, low = int(draw.integers(1, 31)), draw.uniform(12, 19)
        link = LinkBudget(altitude_m=float(draw.choice([20.0, 50.0, 120.0])))
        most = [None, None, 1, 3][draw.integers(4)]
        # Dense enough to share, sparse enough to take seconds in all.
        positions = draw.uniform(0, float(10 ** draw.uniform(2.3, 3.5)), (count, 2))
        rates = draw.uniform(low, low + draw.uniform(0.1, 3), count)
        best = solve(positions, rates, "optimal", link, max_devices_per_uav=most, time_limit_s=5)
        problems = best.violations(positions, rates, link, most)
        proven_rate = (
            best.average_uav_rate_bound is not None and best.average_uav_rate_bound - best.average_uav_rate < 2e-3
        )
        for name in set(SCHEMES) - {"optimal"}:
            other = solve(positions, rates, name, link, max_devices_per_uav=most)
            more = len(best.uav_positions) > len(other.uav_positions)
            same = len(best.uav_positions) == len(other.uav_positions)
            slower = same and other.average_uav_rate > best.average_uav_rate + 1e-3
            if more or problems or slower:
                worse += 1
                print(f"  seed {seed}: worse than {name}, rate proven: {proven_rate}, {problems[:1]}", flush=True)
        if seed % 100 == 99 or seed == draws - 1:
            print(f"never worse: {seed + 1} instances, {worse} exceptions", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--hard-draws", type=int, default=2)
    parser.add_argument(
        "--stretch", type=float, default=1.0, help="factor on the wall-clock limits, where other load shares the cores"
    )
    parser.add_argument("--hard-only", action="store_true", help="only the hard cases")
    parser.add_argument("--never-worse", action="store_true", help="only the 1,000 instances against every scheme")
    parser.add_argument("--instances", type=int, default=1000, help="number of instances for --never-worse")
    args = parser.parse_args()
    if args.never_worse:
        never_worse(args.instances)
        return
    if args.hard_only:
        hard_cases(args.hard_draws, args.stretch)
        return
    time_and_gap(args.draws)
    which_count(args.draws)
    hard_cases(args.hard_draws, args.stretch)


if __name__ == "__main__":
    main()

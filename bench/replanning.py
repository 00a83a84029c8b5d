"""Replanning: separation over random transitions, time to answer an event, and what an hour of churn costs.

Three parts, each against a reference in the same run:
- transitions: the least distance of densely sampled setpoints, never below the limit, against straight flights;
- assignment: what keeping the assignment of least squared distance saves in legs and in time, against a random one;
- churn: devices come, go, move and change; smallest change with a weighed plan behind it, against planning from scratch
  at every event with the cells matched the same way.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from jpap_ros.fleet.assignment import assign
from jpap_ros.fleet.transit import plan_transit
from jpap_ros.fleet.transit_plan import Obstacle, TransitLimits, TransitPlan, minimum_separation
from jpap_ros.planning import LinkBudget, solve
from jpap_ros.planning.replanning import Change, compare, replan
from jpap_ros.planning.replanning_decision import consider
from jpap_ros.planning.replanning_state import Demands, Limits, LivePlan

LIMITS = TransitLimits(min_separation_m=10.0, tracking_error_m=1.0)
SIDE_M = 1500.0
#: What rounding may take from a distance [m].
ROUNDING_M = 1e-6


def sampled_track(plan: TransitPlan, step_s: float = 0.2) -> np.ndarray:
    """Setpoints of all aircraft at dense times, (T, n, 3)."""
    times = np.arange(0.0, plan.duration_s + 2 * step_s, step_s)
    return np.array([np.concatenate([convoy.at(t)[0] for convoy in plan.convoys]) for t in times])


def sampled_separation(track: np.ndarray, obstacles: list[Obstacle]) -> float:
    """Least distance in a track; the reference for the closed form."""
    first, second = np.triu_indices(track.shape[1], k=1)
    least = math.inf
    if len(first):
        least = math.sqrt(((track[:, first] - track[:, second]) ** 2).sum(axis=2).min())
    for obstacle in obstacles:
        east, north, up = obstacle.position
        below = np.clip(track[..., 2], min(obstacle.bottom_m, up), up)
        gap = np.sqrt((track[..., 0] - east) ** 2 + (track[..., 1] - north) ** 2 + (track[..., 2] - below) ** 2)
        least = min(least, float(gap.min()) - obstacle.radius_m)
    return least


def transitions(count: int) -> None:
    """Print the least separation of random transitions, relative to what is allowed; fail if it is less."""
    rng = np.random.default_rng(0)
    worst, straight_below, held, aircraft, excess, times = math.inf, 0, 0, 0, 0.0, []
    for _ in range(count):
        size = int(rng.integers(2, 16))
        side = float(rng.choice([60.0, 150.0, 400.0, 1500.0]))
        starts, goals = rng.uniform(0, side, (2, size, 3)) * (1, 1, 0) + (0, 0, 50)
        starts[:, 2] += rng.choice([0.0, 20.0]) * rng.uniform(-1, 1, size)
        if rng.random() < 0.5:
            goals = goals[assign(starts[:, :2], goals[:, :2])]
        obstacles = [
            Obstacle(f"silent{i}", (*rng.uniform(0, side, 2), 50.0), radius_m=2.0) for i in range(rng.integers(0, 3))
        ]
        names = [f"uav{i}" for i in range(size)]
        started = time.perf_counter()
        plan = plan_transit(dict(zip(names, starts)), dict(zip(names, goals)), LIMITS, obstacles)  # noqa: B905
        times.append(time.perf_counter() - started)
        track = sampled_track(plan)
        began, seen = sampled_separation(track[:1], obstacles), sampled_separation(track, obstacles)
        allowed = min(LIMITS.min_separation_m, began)
        worst = min(worst, seen - allowed)
        excess = max(excess, minimum_separation(plan, obstacles) - seen)
        share = np.linspace(0, 1, 200)[:, None, None]
        flights = starts + share * (goals - starts)
        i, j = np.triu_indices(size, k=1)
        straight_below += bool(np.linalg.norm(flights[:, i] - flights[:, j], axis=2).min() < allowed - 1e-6)
        held += len(plan.held)
        aircraft += size
    print(
        f"transitions: {count}, {aircraft} aircraft; least sampled separation minus what is allowed {worst:+.2e} m;"
        f" closed form above the sampled one by at most {excess:.2e} m; {held} aircraft held ({held / aircraft:.1%});"
        f" straight flights would have broken it in {straight_below} ({straight_below / count:.0%});"
        f" planning p50 {np.median(times) * 1e3:.1f} ms, p99 {np.quantile(times, 0.99) * 1e3:.1f} ms"
    )
    if worst < -ROUNDING_M:
        raise SystemExit(f"a transition came {-worst:.2g} m nearer than is allowed")


def spaced(rng: np.random.Generator, count: int, side: float, spacing: float) -> np.ndarray:
    """Random places in a square, none nearer than `spacing` to another."""
    found: list[np.ndarray] = []
    while len(found) < count:
        place = rng.uniform(0, side, 2)
        if all(math.dist(place, other) >= spacing for other in found):
            found.append(place)
    return np.column_stack([np.array(found), np.full(count, 50.0)])


def assignments(count: int) -> None:
    """Print legs and durations with the assignment of least squared distance, the bottleneck one and a random one."""
    for objective in ("distance2", "bottleneck", "random"):
        rng = np.random.default_rng(1)
        legs, durations, metres, held = [], [], [], 0
        for _ in range(count):
            starts, goals = (spaced(rng, 30, 600.0, 17.0) for _ in range(2))
            if objective != "random":
                goals = goals[assign(starts[:, :2], goals[:, :2], objective=objective)]
            names = [f"uav{i}" for i in range(30)]
            plan = plan_transit(dict(zip(names, starts)), dict(zip(names, goals)), LIMITS)  # noqa: B905
            legs.append(max(len(convoy.laws) for convoy in plan.convoys))
            durations.append(plan.duration_s)
            metres.append(sum(float(np.linalg.norm(np.diff(plan.path(n), axis=0), axis=1).sum()) for n in names))
            held += len(plan.held)
        print(
            f"assignment {objective:10s}: legs at most {max(legs)}, full service after {np.median(durations):.0f} s"
            f" (median), {np.median(metres):.0f} m flown (median), {held} held"
        )


@dataclass
class Tally:
    """What a way of replanning has cost so far."""

    times: list[float] = field(default_factory=list)
    moved_m: float = 0.0
    launches: int = 0
    interrupted: int = 0
    uavs: list[int] = field(default_factory=list)

    def add(self, change: Change, before: LivePlan, elapsed_s: float | None) -> None:
        if elapsed_s is not None:
            self.times.append(elapsed_s)
        self.moved_m += change.moved_m
        self.launches += len({cell.id for cell in change.plan.cells} - {cell.id for cell in before.cells})
        self.interrupted += len(change.interrupted)

    def show(self, name: str, events: int, device_events: int) -> None:
        print(
            f"churn, {name:15s}: re-plan p50 {np.median(self.times) * 1e3:.1f} ms, p99"
            f" {np.quantile(self.times, 0.99) * 1e3:.1f} ms; {self.moved_m / events:.1f} m flown and"
            f" {self.launches / events:.2f} launches an event; guaranteed rate interrupted {self.interrupted} times in"
            f" {device_events} device-events ({1 - self.interrupted / device_events:.4%} untouched); UAVs on average"
            f" {np.mean(self.uavs):.1f}"
        )


def churn(events: int, devices: int) -> Iterator[Demands]:
    """Devices after each of some random events."""
    rng = np.random.default_rng(2)
    rows = {f"d{k}": (*rng.uniform(0, SIDE_M, 2), rng.uniform(13, 18)) for k in range(devices)}
    for event in range(events + 1):
        table = np.array(list(rows.values()))
        yield Demands.of(list(rows), table[:, :2], table[:, 2])
        kind = rng.integers(4)
        name = str(rng.choice(list(rows)))
        x, y, rate = rows[name]
        if kind == 0 or len(rows) < devices * 0.9:
            rows[f"e{event}"] = (*rng.uniform(0, SIDE_M, 2), rng.uniform(13, 18))
        elif kind == 1 or len(rows) > devices * 1.1:
            del rows[name]
        elif kind == 2:
            rows[name] = (x + rng.normal(0, 30), y + rng.normal(0, 30), rate)
        else:
            rows[name] = (x, y, rng.uniform(13, 18))


def compare_churn(events: int, devices: int) -> None:
    """Print the cost of churn, replanned incrementally and from scratch."""
    limits = Limits("jpap", LinkBudget())
    live: LivePlan | None = None
    scratch: LivePlan | None = None
    tallies = {name: Tally() for name in ("smallest change", "from scratch")}
    adopted = device_events = 0
    for demands in churn(events, devices):
        started = time.perf_counter()
        full = solve(demands.positions, demands.rates, limits.scheme, limits.link)
        solving = time.perf_counter() - started
        if live is None or scratch is None:
            live = scratch = LivePlan.of(full, demands)
            continue
        device_events += len(demands.ids)
        started = time.perf_counter()
        change = replan(live, demands, limits)
        tallies["smallest change"].add(change, live, time.perf_counter() - started)
        live = change.plan
        decision = consider(full, live, demands, limits)
        if decision.adopt:
            adopted += 1
            tallies["smallest change"].add(decision.change, live, None)
            live = decision.change.plan
        matched = consider(full, scratch, demands, limits).change.plan
        tallies["from scratch"].add(compare(scratch, matched, limits), scratch, solving)
        scratch = matched
        for name, plan in (("smallest change", live), ("from scratch", scratch)):
            broken = plan.deployment(limits).violations(demands.positions, demands.rates, limits.link)
            if broken:
                raise AssertionError(f"{name}: {broken[0]}")
            tallies[name].uavs.append(len(plan.cells))
    for name, tally in tallies.items():
        tally.show(name, events, device_events)
    print(f"churn: {events} events, {devices} devices; plans from scratch adopted {adopted} times")


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--transitions", type=int, default=10_000, help="random transitions (default: %(default)s)")
    parser.add_argument("--assignments", type=int, default=50, help="random fleets of 30 (default: %(default)s)")
    parser.add_argument("--events", type=int, default=720, help="events of churn, one in 5 s (default: %(default)s)")
    parser.add_argument("--devices", type=int, default=100, help="devices of churn (default: %(default)s)")
    arguments = parser.parse_args()
    if arguments.assignments:
        assignments(arguments.assignments)
    if arguments.events:
        compare_churn(arguments.events, arguments.devices)
    if arguments.transitions:
        transitions(arguments.transitions)


if __name__ == "__main__":
    main()

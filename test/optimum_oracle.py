"""Independent optima of P1 for small instances: written from the paper's equations alone, without the product."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from scipy import optimize


def servable(positions, rates, link, members) -> bool:
    """Whether one UAV meets the demands of these devices, from the power-weighted centroid."""
    w = 2.0 ** rates[members] - 1
    u = positions[members]
    centre = w @ u / w.sum()
    snr_power = 10 ** ((link.transmit_power_dbm + link.reference_gain_db - link.noise_power_dbm) / 10)
    return bool(w @ (((u - centre) ** 2).sum(axis=1) + link.altitude_m**2) <= snr_power)


def servable_sets(positions, rates, link, most) -> list[tuple[int, ...]]:
    """Every servable set, by depth-first search over increasing indices."""
    found: list[tuple[int, ...]] = []

    def extend(members: tuple[int, ...]) -> None:
        found.append(members)
        if len(members) < most:
            for k in range(members[-1] + 1, len(rates)):
                if servable(positions, rates, link, [*members, k]):
                    extend((*members, k))

    for k in range(len(rates)):
        extend((k,))
    return found


def partitions(items: list[int]) -> Iterator[list[list[int]]]:
    """Every partition of a list (Bell number of them)."""
    if not items:
        yield []
        return
    first, rest = items[0], items[1:]
    for part in partitions(rest):
        yield [[first], *part]
        for i in range(len(part)):
            yield [*part[:i], [first, *part[i]], *part[i + 1 :]]


def fewest_by_partitions(positions, rates, link, most) -> int:
    """Smallest number of cells over all partitions."""
    known: dict[tuple[int, ...], bool] = {}

    def good(cell: list[int]) -> bool:
        key = tuple(sorted(cell))
        if key not in known:
            known[key] = len(key) <= most and servable(positions, rates, link, list(key))
        return known[key]

    return min(len(p) for p in partitions(list(range(len(rates)))) if all(map(good, p)))


def fewest_by_milp(positions, rates, link, most) -> int:
    """Smallest set cover by all servable sets, with scipy's solver."""
    sets = servable_sets(positions, rates, link, most)
    covers = np.zeros((len(rates), len(sets)))
    for column, members in enumerate(sets):
        covers[list(members), column] = 1
    found = optimize.milp(
        np.ones(len(sets)),
        constraints=optimize.LinearConstraint(covers, lb=1),
        integrality=np.ones(len(sets)),
        bounds=optimize.Bounds(0, 1),
    )
    return round(found.fun)


def best_rate(positions, rates, link, members) -> float:
    """Largest sum rate of one cell: grid of positions, refined; power by bisection on the water level."""
    u, r = positions[list(members)], rates[list(members)]
    w = 2.0**r - 1
    noise_per_d2 = 10 ** ((link.noise_power_dbm - link.reference_gain_db) / 10 - 3)
    total = 10 ** (link.transmit_power_dbm / 10 - 3)

    def rate(v):
        noise = noise_per_d2 * (((u - v) ** 2).sum(axis=1) + link.altitude_m**2)
        floor = w * noise
        if floor.sum() > total:
            return -math.inf
        low, high = 0.0, total + noise.max() + floor.max()
        for _ in range(60):
            level = (low + high) / 2
            if np.maximum(floor, level - noise).sum() > total:
                high = level
            else:
                low = level
        return float(np.log2(1 + np.maximum(floor, low - noise) / noise).sum())

    centre = w @ u / w.sum()
    slack = total / noise_per_d2 - w @ (((u - centre) ** 2).sum(axis=1) + link.altitude_m**2)
    radius = math.sqrt(max(slack, 0) / w.sum())
    if len(members) == 1:
        return rate(u[0])
    grid = [centre + radius * np.array([x, y]) for x in np.linspace(-1, 1, 15) for y in np.linspace(-1, 1, 15)]
    tops = sorted(grid, key=rate)[-2:]
    fine = [
        optimize.minimize(lambda v: -max(rate(v), -1e9), v, method="Nelder-Mead", options={"xatol": 1e-4}) for v in tops
    ]
    return max(-result.fun for result in fine)

"""Whether a deployment holds: every constraint of P1, computed afresh."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from jpap_ros.planning.deployment import RELATIVE_TOLERANCE, Deployment
from jpap_ros.planning.link_budget import Floats, LinkBudget


def find_violations(
    deployment: Deployment,
    positions: ArrayLike,
    rates: ArrayLike,
    link: LinkBudget,
    max_devices_per_uav: int | None = None,
    max_uavs: int | None = None,
    min_separation_m: float = 0.0,
) -> list[str]:
    """Every broken constraint of P1, in words and numbers. See `Deployment.violations`."""
    count = len(deployment.serving_uav)
    where, demand = np.asarray(positions, float), np.asarray(rates, float)
    if demand.shape != (count,) or (where.shape != (count, 2) and where.size + count > 0):
        return [
            f"shapes: the deployment is for {count} devices,"
            f" there are positions of shape {where.shape} and rates of shape {demand.shape}"
        ]
    where = where.reshape(count, 2)
    wild = [
        f"{name}[{', '.join(map(str, index))}] is {array[tuple(index)]}"
        for name in ("uav_positions", "power_w", "rate", "uav_rate")
        for array in [getattr(deployment, name)]
        for index in np.argwhere(~np.isfinite(array)).tolist()
    ]
    uavs = len(deployment.uav_positions)
    wild += [
        f"device {k}: its serving UAV {uav} does not exist, there are {uavs}"
        for k, uav in enumerate(deployment.serving_uav.tolist())
        if not -1 <= uav < uavs
    ]
    if wild:
        return wild
    return [
        *_who_is_served(deployment),
        *_powers(deployment, link),
        *_rates(deployment, where, demand, link),
        *_limits(deployment, max_devices_per_uav, max_uavs, min_separation_m),
    ]


def _differs(value: float, expected: float) -> bool:
    return abs(value - expected) > RELATIVE_TOLERANCE * max(abs(expected), 1.0)


def _who_is_served(deployment: Deployment) -> list[str]:
    """(6d): every device is served by one UAV, or listed as unserved with a reason."""
    found = []
    for k, uav in enumerate(deployment.serving_uav.tolist()):
        if uav == -1 and not deployment.unserved.get(k):
            found.append(f"(6d) device {k} is served by no UAV, and no reason is given")
        if uav >= 0 and k in deployment.unserved:
            found.append(f"(6d) device {k} is listed as unserved ({deployment.unserved[k]}), but UAV {uav} serves it")
    found += [
        f"(6d) device {k} is listed as unserved, but there are {len(deployment.serving_uav)} devices"
        for k in deployment.unserved
        if not 0 <= k < len(deployment.serving_uav)
    ]
    return found


def _powers(deployment: Deployment, link: LinkBudget) -> list[str]:
    """(6c): the powers of each UAV are not negative and sum to P_T."""
    power, serving = deployment.power_w, deployment.serving_uav
    found = [f"(6c) device {k} has the negative power {power[k]:.9g} W" for k in np.flatnonzero(power < 0)]
    found += [
        f"(6c) device {k} is unserved, but has the power {power[k]:.9g} W"
        for k in np.flatnonzero((serving < 0) & (power != 0))
    ]
    served = serving >= 0
    sums = np.bincount(serving[served], weights=power[served], minlength=len(deployment.uav_positions))
    counts = np.bincount(serving[served], minlength=len(sums))
    total = link.transmit_power_w
    for uav, (spent, members) in enumerate(zip(sums.tolist(), counts.tolist(), strict=True)):
        if not members:
            found.append(f"UAV {uav} serves no device")
        elif abs(spent - total) > RELATIVE_TOLERANCE * total:
            found.append(f"(6c) UAV {uav}: its powers sum to {spent:.12g} W, P_T is {total:.12g} W")
    return found


def _rates(deployment: Deployment, positions: Floats, demand: Floats, link: LinkBudget) -> list[str]:
    """(6b): every served device gets its demand; and all rates reported are those of equations (3) and (4)."""
    serving = deployment.serving_uav
    served = np.flatnonzero(serving >= 0)
    offset = positions[served] - deployment.uav_positions[serving[served]]
    given = np.zeros(len(serving))
    given[served] = link.rate(np.maximum(deployment.power_w[served], 0), (offset**2).sum(axis=1))
    found = [
        f"(6b) device {k} gets {given[k]:.12g} bit/s/Hz from UAV {serving[k]}, {demand[k]:.12g} demanded"
        for k in served
        if not given[k] >= demand[k] * (1 - RELATIVE_TOLERANCE)
    ]
    found += [
        f"(3) device {k}: reported rate {deployment.rate[k]:.12g}, from its power and distance {given[k]:.12g} bit/s/Hz"
        for k in range(len(given))
        if _differs(deployment.rate[k], given[k])
    ]
    sums = np.bincount(serving[served], weights=given[served], minlength=len(deployment.uav_rate))
    found += [
        f"(4) UAV {uav}: reported rate {deployment.uav_rate[uav]:.12g}, its devices' sum is {total:.12g} bit/s/Hz"
        for uav, total in enumerate(sums.tolist())
        if _differs(deployment.uav_rate[uav], total)
    ]
    return found


def _limits(
    deployment: Deployment, max_devices_per_uav: int | None, max_uavs: int | None, min_separation_m: float
) -> list[str]:
    """(6e), and the fleet's own limits: its size, and the least distance between two of its UAVs."""
    found = []
    where = deployment.uav_positions
    if max_devices_per_uav is not None:
        counts = np.bincount(deployment.serving_uav[deployment.serving_uav >= 0], minlength=len(where))
        found += [
            f"(6e) UAV {uav} serves {counts[uav]} devices, K_max is {max_devices_per_uav}"
            for uav in np.flatnonzero(counts > max_devices_per_uav)
        ]
    if max_uavs is not None and len(where) > max_uavs:
        found.append(f"{len(where)} UAVs are deployed, the fleet has {max_uavs}")
    if min_separation_m > 0 and len(where) > 1:
        close = cKDTree(where).query_pairs(min_separation_m)
        for first, second in sorted(close):
            apart = float(np.hypot(*(where[first] - where[second])))
            if apart < min_separation_m * (1 - RELATIVE_TOLERANCE):
                found.append(
                    f"UAVs {first} and {second} are {apart:.12g} m apart, at least {min_separation_m:.12g} m wanted"
                )
    return found

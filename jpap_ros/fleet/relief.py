"""What a hand-over costs the devices: the relief takes over from above its cell's place, and sinks to it afterwards."""

from __future__ import annotations

from collections.abc import Collection

from jpap_ros.fleet.cells import FleetPlan
from jpap_ros.planning import LinkBudget
from jpap_ros.planning.deployment import RELATIVE_TOLERANCE


def short_from_above(plan: FleetPlan, cells: Collection[int], link: LinkBudget, above_m: float) -> dict[str, str]:
    """Devices whose demand is not met while the UAV of their cell is too high, and why.

    Parameters
    ----------
    plan : FleetPlan
    cells : collection of int
        Ids of the cells that a relief takes over.
    link : LinkBudget
        With the height of the cells' places.
    above_m : float
        How far above that the relief is [m].

    Notes
    -----
    Equation (3) with the cell's own powers: a device whose UAV gives it more than it asked for may not notice.
    """
    demands, height_m = plan.live.demands, link.altitude_m + above_m
    short = {}
    for cell in plan.cells:
        for name, power in zip(cell.device_ids, cell.power_w, strict=True) if cell.id in cells else ():
            k = demands.index[name]
            (x, y), (east, north) = demands.places[k], cell.position
            snr = power * link.eta / ((x - east) ** 2 + (y - north) ** 2 + height_m**2)
            if snr * (1 + RELATIVE_TOLERANCE) < demands.snr_demand[k]:
                short[name] = f"its UAV's relief takes over from {above_m:g} m above"
    return short

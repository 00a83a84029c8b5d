"""One plan for the whole fleet: cells from the planning schemes, each given to a named aircraft."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from jpap_ros.fleet.cells import Aircraft, FleetCell, FleetPlan
from jpap_ros.fleet.naming import name_cells
from jpap_ros.planning import LinkBudget, solve
from jpap_ros.planning.devices import Device


@dataclass(frozen=True)
class PlanSettings:
    """How to plan; see `jpap_ros.planning.solve`.

    Attributes
    ----------
    scheme : str
    link : LinkBudget
    bandwidth_hz : float
        Bandwidth of each device's channel [Hz]: a demand in bit/s is this times one in bit/s/Hz.
    max_devices_per_uav : int or None
    min_separation_m : float
    time_limit_s : float or None
    """

    scheme: str = "jpap"
    link: LinkBudget = field(default_factory=LinkBudget)
    bandwidth_hz: float = 1.0
    max_devices_per_uav: int | None = None
    min_separation_m: float = 0.0
    time_limit_s: float | None = None


def plan_fleet(
    devices: Sequence[Device],
    settings: PlanSettings,
    aircraft: Sequence[Aircraft],
    present: Sequence[FleetCell] = (),
) -> FleetPlan:
    """Plan cells for the devices and give each to an aircraft.

    Parameters
    ----------
    devices : sequence of Device
        Validated by the device table.
    settings : PlanSettings
    aircraft : sequence of Aircraft
        The whole fleet; those that are unavailable get no cell.
    present : sequence of FleetCell
        The plan in force.

    Returns
    -------
    FleetPlan
        Cells in the order of `aircraft`.
    """
    available = [craft for craft in aircraft if craft.available]
    deployment = solve(
        np.array([device.position for device in devices], dtype=np.float64).reshape(-1, 2),
        np.array([device.rate_demand for device in devices], dtype=np.float64) / settings.bandwidth_hz,
        scheme=settings.scheme,
        link=settings.link,
        max_devices_per_uav=settings.max_devices_per_uav,
        max_uavs=len(available),
        weights=np.array([device.weight for device in devices], dtype=np.float64),
        min_separation_m=settings.min_separation_m,
        time_limit_s=settings.time_limit_s,
    )
    radii = deployment.coverage_radius_m
    cells = []
    for index, position in enumerate(deployment.uav_positions.tolist()):
        members = deployment.cell(index)
        cells.append(
            FleetCell(
                uav="",
                position=(position[0], position[1]),
                device_ids=tuple(devices[k].id for k in members),
                power_w=tuple(deployment.power_w[members].tolist()),
                rate=tuple((deployment.rate[members] * settings.bandwidth_hz).tolist()),
                coverage_radius_m=math.nan if radii is None else float(radii[index]),
            )
        )
    return FleetPlan(
        cells=name_cells(cells, available, present),
        unserved=tuple((devices[k].id, reason) for k, reason in deployment.unserved.items()),
        uavs_needed=deployment.uavs_needed,
        min_uavs_bound=deployment.min_uavs_bound,
        proven_optimal=deployment.proven_optimal,
        scheme=deployment.scheme,
    )

"""One plan for the whole fleet: cells from the planning layer, each given to a named aircraft.

An event is answered at once by the smallest change of the plan in force (`plan_change`). A plan from scratch is made
behind it (`full_deployment`, slow for some schemes) and replaces it where that is worth the flight (`weigh`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from jpap_ros.fleet.cells import Aircraft, FleetCell, FleetPlan
from jpap_ros.fleet.handover import handed_over, on_air
from jpap_ros.fleet.naming import name_cells
from jpap_ros.fleet.plan_settings import PlanSettings
from jpap_ros.planning import Deployment, solve
from jpap_ros.planning.devices import Device
from jpap_ros.planning.replanning import replan
from jpap_ros.planning.replanning_decision import ReplanningPolicy, consider
from jpap_ros.planning.replanning_state import Demands, LivePlan

#: Schemes that may take seconds; a quick plan goes ahead of theirs.
SLOW_SCHEMES = frozenset({"optimal"})

_QUICK_SCHEME = "jpap"

#: What a plan from scratch must gain while no aircraft is in the air: more than rounding.
_GROUND_TOLERANCE = 0.01


@dataclass(frozen=True, eq=False)
class Weighed:
    """What came of a plan from scratch.

    Attributes
    ----------
    plan : FleetPlan
        The plan from scratch if it is worth the flight; else the plan in force with the bound that was proven.
    adopted : bool
    reason : str
        Gain and cost in words.
    """

    plan: FleetPlan
    adopted: bool
    reason: str


def full_deployment(devices: Sequence[Device], settings: PlanSettings, uavs: int) -> Deployment:
    """Plan from scratch for so many UAVs; devices in the order given."""
    demands = settings.demands(devices)
    return solve(
        demands.positions,
        demands.rates,
        scheme=settings.scheme,
        link=settings.link,
        max_devices_per_uav=settings.max_devices_per_uav,
        max_uavs=uavs,
        weights=demands.weights,
        min_separation_m=settings.min_separation_m,
        time_limit_s=settings.time_limit_s,
    )


def brought_up_to_date(
    full: Deployment, made_for: Sequence[Device], devices: Sequence[Device], settings: PlanSettings, uavs: int
) -> Deployment:
    """Return a plan from scratch, made for devices as they were, with the smallest change for those there are now.

    Without its proof, which was for the others.
    """
    limits = settings.limits(uavs)
    return replan(LivePlan.of(full, settings.demands(made_for)), settings.demands(devices), limits).plan.deployment(
        limits
    )


def plan_change(
    devices: Sequence[Device], settings: PlanSettings, aircraft: Sequence[Aircraft], present: FleetPlan
) -> FleetPlan:
    """Fit the devices and the aircraft that there are now into the plan in force, with the smallest change.

    Parameters
    ----------
    devices : sequence of Device
        Validated by the device table.
    settings : PlanSettings
        Those that the plan in force was made with.
    aircraft : sequence of Aircraft
        The whole fleet; those that are unavailable get no cell.
    present : FleetPlan
        The plan in force.

    Returns
    -------
    FleetPlan
        Cells in the order of `aircraft`.
    """
    available = [craft for craft in aircraft if craft.available]
    demands, limits = settings.demands(devices), settings.limits(len(available))
    now = on_air(present, aircraft, settings.link, {cell.id: cell.uav for cell in present.cells})
    live = replan(present.live, demands, limits, _lost_cells(present, available, demands), now, same_powers=True).plan
    return handed_over(present, named_plan(live, settings, available, present.names), aircraft, settings)


def plan_from_scratch(
    devices: Sequence[Device], settings: PlanSettings, aircraft: Sequence[Aircraft], present: FleetPlan | None = None
) -> FleetPlan:
    """Plan from the devices alone, or quickly where the scheme may take long; cells keep their aircraft if they can.

    Parameters are those of `plan_change`; `present` may be missing.
    """
    available = [craft for craft in aircraft if craft.available]
    demands, limits = settings.demands(devices), settings.limits(len(available))
    slow = settings.scheme in SLOW_SCHEMES
    quick = replace(settings, scheme=_QUICK_SCHEME) if slow else settings
    full = full_deployment(devices, quick, len(available))
    live = LivePlan.of(full, demands)
    if present is not None:
        lost = _lost_cells(present, available, demands)
        base = replan(present.live, demands, limits, lost).plan
        live = consider(full, base, demands, limits, lost_cells=lost).change.plan
    if slow:
        # The quick scheme's cells, with the power rule of the scheme that was asked for.
        live = replan(live, demands, limits).plan
    holders = present.names if present is not None else {}
    plan = named_plan(live, settings, available, holders, full=None if slow else full)
    return handed_over(present, plan, aircraft, settings)


def weigh(
    full: Deployment,
    devices: Sequence[Device],
    settings: PlanSettings,
    aircraft: Sequence[Aircraft],
    present: FleetPlan,
    policy: ReplanningPolicy,
) -> Weighed:
    """Weigh a plan from scratch against the plan in force for the same devices and aircraft.

    Parameters
    ----------
    full : Deployment
        From `full_deployment` with the same devices, settings and number of available aircraft.
    devices, settings, aircraft, present
        As in `plan_change`.
    policy : ReplanningPolicy
        Its costs count only while an aircraft of the plan in force is in the air: before take-off a change is free.
    """
    available = [craft for craft in aircraft if craft.available]
    demands, limits = settings.demands(devices), settings.limits(len(available))
    used = set(present.names.values())
    if not any(craft.airborne for craft in aircraft if craft.name in used):
        tolerance = min(policy.tolerance, _GROUND_TOLERANCE)
        policy = replace(policy, metre_cost=0.0, launch_cost=0.0, interruption_cost=0.0, tolerance=tolerance)
    now = on_air(present, aircraft, settings.link, {cell.id: cell.uav for cell in present.cells})
    decision = consider(full, present.live, demands, limits, policy, on_air=now)
    if decision.adopt:
        plan = named_plan(decision.change.plan, settings, available, present.names, full=full)
        return Weighed(handed_over(present, plan, aircraft, settings), True, decision.reason)
    bound = full.min_uavs_bound
    alike = len(present.target) == len(full.uav_positions) and len(present.live.unserved) == len(full.unserved) == 0
    plan = replace(
        present,
        min_uavs_bound=bound,
        # Where devices are left out, the bound alone does not say that so many UAVs would serve them.
        proven_optimal=bound == present.uavs_needed and (full.proven_optimal or not present.live.unserved),
        average_uav_rate_bound=_rate_bound(full, settings) if alike else math.nan,
    )
    return Weighed(plan, False, decision.reason)


def _rate_bound(full: Deployment | None, settings: PlanSettings) -> float:
    """Bound on the average UAV rate [bit/s]; NaN where none is known."""
    if full is None or full.average_uav_rate_bound is None:
        return math.nan
    return settings.bandwidth_hz * full.average_uav_rate_bound


def with_crew(plan: FleetPlan, crew: Mapping[int, str]) -> FleetPlan:
    """Return a plan with these aircraft in its cells; a cell that is not among them has none."""

    def crewed(cells: tuple[FleetCell, ...]) -> tuple[FleetCell, ...]:
        return tuple(replace(cell, uav=crew.get(cell.id, "")) for cell in cells)

    return replace(plan, cells=crewed(plan.cells), target=crewed(plan.target))


def _lost_cells(present: FleetPlan, available: Sequence[Aircraft], demands: Demands) -> list[int]:
    """Cells whose aircraft is gone and for which there is no other; those of least weight where some can be kept."""
    names = {craft.name for craft in available}
    held = [cell for cell in present.target if cell.uav in names]
    orphans = [cell for cell in present.target if cell.uav not in names]

    def weight(cell: FleetCell) -> float:
        return math.fsum(
            float(demands.weights[demands.index[name]]) for name in cell.device_ids if name in demands.index
        )

    orphans.sort(key=lambda cell: (-weight(cell), cell.id))
    return [cell.id for cell in orphans[max(len(available) - len(held), 0) :]]


def _not_holding(available: Sequence[Aircraft], holders: Mapping[int, str], live: LivePlan) -> Sequence[Aircraft]:
    """Those who are not at a cell that is no more, until others serve; all where the others are too few."""
    wanted = {cell.id for cell in live.cells}
    holding = {name for cell_id, name in holders.items() if cell_id not in wanted}
    others = [craft for craft in available if craft.name not in holding]
    heard = sum(craft.connected or craft.name in holders.values() for craft in others)
    return others if heard >= len(live.cells) else available


def named_plan(
    live: LivePlan,
    settings: PlanSettings,
    available: Sequence[Aircraft],
    holders: Mapping[int, str],
    full: Deployment | None = None,
) -> FleetPlan:
    """Give the cells of a plan aircraft.

    Parameters
    ----------
    live : LivePlan
    settings : PlanSettings
        With which it was made.
    available : sequence of Aircraft
    holders : mapping of int to str
        Aircraft that cells have already, by the cell's id.
    full : Deployment, optional
        The plan from scratch that this is, if it is one.
    """
    deployment = live.deployment(settings.limits(len(available)))
    radii = deployment.coverage_radius_m
    index = live.demands.index
    cells = [
        FleetCell(
            id=cell.id,
            uav="",
            position=cell.position,
            device_ids=cell.device_ids,
            power_w=cell.power_w,
            rate=tuple(settings.bandwidth_hz * float(deployment.rate[index[name]]) for name in cell.device_ids),
            coverage_radius_m=math.nan if radii is None else float(radii[k]),
        )
        for k, cell in enumerate(live.cells)
    ]
    named = name_cells(cells, _not_holding(available, holders, live), holders, settings.assignment)
    return FleetPlan(
        cells=named,
        target=named,
        live=live,
        unserved=live.unserved,
        uavs_needed=live.uavs_needed,
        min_uavs_bound=None if full is None else full.min_uavs_bound,
        proven_optimal=full is not None and full.proven_optimal,
        average_uav_rate_bound=_rate_bound(full, settings),
        scheme=settings.scheme,
        interrupted={},
        from_scratch=full is not None,
    )

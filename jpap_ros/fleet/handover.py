"""From one plan to the next: what the aircraft's radios do now, when they take new powers, and whom that interrupts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from jpap_ros.fleet.cells import Aircraft, FleetCell, FleetPlan
from jpap_ros.planning import LinkBudget
from jpap_ros.planning.replanning_continuity import HOVER_RADIUS_M, Continuity, OnAir, Place, Radio


def on_air(plan: FleetPlan, aircraft: Sequence[Aircraft], link: LinkBudget, crew: Mapping[int, str]) -> OnAir:
    """Return what is transmitted now, under a plan in force, and who goes on with it.

    Parameters
    ----------
    plan : FleetPlan
        The plan that the radios were last told.
    aircraft : sequence of Aircraft
        The whole fleet.
    link : LinkBudget
    crew : mapping of int to str
        Who flies for which cell from now on, by the cell's id.

    Notes
    -----
    An aircraft that is lost served at its goal, as far as is known, and does not go on. One that takes a cell over has
    no powers of its own yet.
    """
    fleet = {craft.name: craft for craft in aircraft}
    flying: dict[int, Radio] = {}
    gone: list[Radio] = []
    for cell in plan.cells:
        craft = fleet.get(cell.uav)
        if not cell.uav or (craft is not None and craft.serves_nobody):
            continue
        place = craft.place(link.altitude_m) if craft is not None else None
        if place is not None and crew.get(cell.id) == cell.uav:
            flying[cell.id] = _radio(cell, place, link)
        else:
            gone.append(_radio(cell, place or _goal(cell, link), link))
    for cell_id, name in crew.items():
        place = fleet[name].place(link.altitude_m) if name in fleet else None
        if cell_id not in flying and place is not None:
            flying[cell_id] = Radio(place, {})
    return OnAir(flying, tuple(gone))


def handed_over(before: FleetPlan | None, plan: FleetPlan, aircraft: Sequence[Aircraft], link: LinkBudget) -> FleetPlan:
    """Return a plan that says when each aircraft takes its powers, and whom the change to it interrupts.

    Parameters
    ----------
    before : FleetPlan or None
        The plan that the radios were last told, with the aircraft that flew it.
    plan : FleetPlan
        The new one, with the aircraft that will fly it.
    aircraft : sequence of Aircraft
        The whole fleet.
    link : LinkBudget

    Notes
    -----
    A cell that stays as it is goes on as it was told. A device that is interrupted is listed until it is served again.
    """
    if before is None:
        return plan
    was = {cell.id: cell for cell in before.cells}
    now = on_air(before, aircraft, link, plan.names)
    continuity = Continuity(now, plan.live.demands, link)
    new = {cell.id: cell for cell in plan.live.cells}
    cells: list[FleetCell] = []
    interrupted: dict[str, str] = {}
    for cell in plan.cells:
        old, radio = was.get(cell.id), now.flying.get(cell.id)
        known = {name: why for name, why in before.interrupted.items() if name in cell.device_ids}
        if old is not None and _task(old) == _task(cell):
            applied = radio is not None and _applies(old, radio.place, link)
            cells.append(
                replace(
                    cell,
                    apply_within_m=0.0 if applied else old.apply_within_m,
                    power_until_w=() if applied else old.power_until_w,
                )
            )
            if radio is None or radio.place != _goal(cell, link):
                interrupted |= known
            continue
        change = continuity.power_change(new[cell.id])
        until = tuple(radio.power_w.items()) if radio is not None and change.within_m else ()
        cells.append(replace(cell, apply_within_m=change.within_m, power_until_w=until))
        interrupted |= {name: why for name, why in known.items() if name not in continuity.guaranteed}
        interrupted |= change.broken
    return replace(plan, cells=tuple(cells), interrupted=interrupted)


def _radio(cell: FleetCell, place: Place, link: LinkBudget) -> Radio:
    goal = _goal(cell, link)
    if _applies(cell, place, link):
        powers = dict(zip(cell.device_ids, cell.power_w, strict=True))
    else:
        powers = dict(cell.power_until_w)
    return Radio(goal if math.dist(place, goal) <= HOVER_RADIUS_M else place, powers)


def _applies(cell: FleetCell, place: Place, link: LinkBudget) -> bool:
    return cell.apply_within_m == 0 or math.dist(place, _goal(cell, link)) <= cell.apply_within_m


def _goal(cell: FleetCell, link: LinkBudget) -> Place:
    return (*cell.position, link.altitude_m)


def _task(cell: FleetCell) -> tuple[object, ...]:
    return cell.uav, cell.position, cell.device_ids, cell.power_w

"""From one plan to the next: who goes on as told for now, when radios take new powers, and whom that interrupts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from jpap_ros.fleet.cells import Aircraft, FleetCell, FleetPlan
from jpap_ros.fleet.plan_settings import PlanSettings
from jpap_ros.planning import LinkBudget
from jpap_ros.planning.deployment import RELATIVE_TOLERANCE
from jpap_ros.planning.replanning_continuity import HOVER_RADIUS_M, Continuity, OnAir, Place, Radio, Told
from jpap_ros.planning.replanning_handover import HandOver, hand_over
from jpap_ros.planning.replanning_state import Demands


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
        Who flies for which cell from now on, by the cell's id; an empty name where nobody does.

    Notes
    -----
    An aircraft that is lost served at its goal, as far as is known, and does not go on. One whose cell is no more may
    go on until it is told to leave; one that was relieved does not.
    """
    fleet = {craft.name: craft for craft in aircraft}
    duty = {uav: cell_id for cell_id, uav in crew.items()}
    flying: dict[int, Radio] = {}
    gone: list[Radio] = []
    for cell in plan.cells:
        craft = fleet.get(cell.uav)
        if not cell.uav or (craft is not None and craft.serves_nobody):
            continue
        place = craft.place(link.altitude_m) if craft is not None else None
        cell_id = duty.get(cell.uav, cell.id)
        if place is None or (cell_id == cell.id and crew.get(cell_id, cell.uav) != cell.uav):
            gone.append(_radio(cell, place or _goal(cell, link), link))
        else:
            flying[cell_id] = _radio(cell, place, link)
    for cell_id, name in crew.items():
        place = fleet[name].place(link.altitude_m) if name in fleet else None
        if cell_id not in flying and place is not None:
            # It has no powers of its own yet.
            flying[cell_id] = Radio(place, {})
    return OnAir(flying, tuple(gone))


def handed_over(
    before: FleetPlan | None, plan: FleetPlan, aircraft: Sequence[Aircraft], settings: PlanSettings
) -> FleetPlan:
    """Return a plan with what each aircraft is told now, so that nobody is interrupted who need not be.

    Parameters
    ----------
    before : FleetPlan or None
        The plan that the radios were last told, with the aircraft that flew it.
    plan : FleetPlan
        The one that is to come into force, with the aircraft that will fly it.
    aircraft : sequence of Aircraft
        The whole fleet.
    settings : PlanSettings
        With which it was made.

    Notes
    -----
    See `jpap_ros.planning.replanning_handover`. An aircraft that waits is told once more what it was told before. A
    device that is interrupted is listed until it is served again.
    """
    if before is None:
        return plan
    link, demands = settings.link, plan.live.demands
    now = on_air(before, aircraft, link, {cell.id: cell.uav for cell in plan.target})
    continuity = Continuity(now, demands, link)
    how = hand_over(continuity, plan.live, settings.min_separation_m, settings.hold_factor)
    was = {cell.uav: cell for cell in before.cells if cell.uav}
    names = {cell.id: cell.uav or "a further aircraft" for cell in (*before.cells, *plan.target)}
    wanted = {cell.id for cell in plan.target}
    leaving = [cell for cell in before.cells if cell.id in how.waits and cell.id not in wanted]
    cells: list[FleetCell] = []
    on_old_way: set[str] = set()
    unheard: set[str] = set()
    for cell in (*plan.target, *leaving):
        old, radio = was.get(cell.uav), now.flying.get(cell.id)
        waits_for = tuple(dict.fromkeys(names[other] for other in how.waits.get(cell.id, ())))
        as_told = cell.id not in how.changes or (radio is None and old is not None and _task(old) == _task(cell))
        if old is not None and (waits_for or as_told):
            told = _told_before(old, demands, settings) if waits_for else cell
            if radio is not None and _applies(old, radio.place, link):
                told = replace(told, apply_within_m=0.0, power_until_w=())
            else:
                told = replace(told, apply_within_m=old.apply_within_m, power_until_w=old.power_until_w)
            cells.append(replace(told, id=cell.id, waits_for=waits_for))
            if radio is None:
                unheard |= set(old.served)
            if radio is None or radio.place != _goal(old, link):
                on_old_way |= set(told.device_ids)
        else:
            within_m = how.changes[cell.id].within_m
            until = tuple(radio.power_w.items()) if radio is not None and within_m else ()
            cells.append(replace(cell, apply_within_m=within_m, power_until_w=until))
    owner = _owners(cells, plan, how, continuity, link)
    interrupted = {
        name: why
        for name, why in before.interrupted.items()
        if name in plan.live.cell_of and (name in on_old_way or name not in continuity.guaranteed)
    }
    # Of one that is not heard nothing new is known.
    interrupted |= {name: why for name, why in how.broken.items() if name in plan.live.cell_of and name not in unheard}
    return replace(
        plan,
        cells=tuple(
            replace(cell, elsewhere=frozenset(name for name in cell.device_ids if owner.get(name) != cell.id))
            for cell in cells
        ),
        # Whom the plan leaves out may still be served by one that waits.
        unserved={name: why for name, why in plan.live.unserved.items() if name not in owner}
        | _waiting_devices(plan, owner, how, names),
        interrupted=interrupted,
    )


def moved_on(
    told: FleetPlan, plan: FleetPlan, aircraft: Sequence[Aircraft], settings: PlanSettings
) -> FleetPlan | None:
    """Return the plan in force as it is to be told now that aircraft have come farther; None where nothing is new.

    Parameters
    ----------
    told : FleetPlan
        As it was told last.
    plan : FleetPlan
        The same with who flies it from now on.
    aircraft, settings
        As in `handed_over`.
    """
    if not told.waiting:
        return None
    now = handed_over(told, plan, aircraft, settings)
    before, news = ({(cell.uav, bool(cell.waits_for), cell.elsewhere) for cell in p.cells} for p in (told, now))
    return now if news != before else None


def _owners(
    cells: Sequence[FleetCell], plan: FleetPlan, how: HandOver, continuity: Continuity, link: LinkBudget
) -> dict[str, int]:
    """Cell that each device counts for now: where it shall be, unless that waits or another one has to hold it."""
    shall_be = plan.live.cell_of
    owner: dict[str, int] = {}
    for cell in cells:
        if cell.waits_for:
            for name, power_w in zip(cell.device_ids, cell.power_w, strict=True):
                first = name not in owner or (name in shall_be and shall_be[name].id == cell.id)
                if first and continuity.meets(_goal(cell, link), name, power_w):
                    owner[name] = cell.id
    owner |= {name: cell.id for cell in cells if not cell.waits_for for name in cell.device_ids}
    return owner | dict(how.holders)


def _waiting_devices(
    plan: FleetPlan, owner: Mapping[str, int], how: HandOver, names: Mapping[int, str]
) -> dict[str, str]:
    """Devices for whom no aircraft has time yet, and why."""
    return {
        name: f"{names[cell.id]} will serve it once it need not wait for"
        f" {', '.join(dict.fromkeys(names[v] for v in how.waits[cell.id]))}"
        for cell in plan.live.cells
        if cell.id in how.waits
        for name in cell.device_ids
        if name not in owner
    }


def _told_before(cell: FleetCell, demands: Demands, settings: PlanSettings) -> FleetCell:
    """What an aircraft was told, for those of its devices that there still are, with the rates they get now."""
    here = [k for k, name in enumerate(cell.device_ids) if name in demands.index]
    rows = [demands.index[cell.device_ids[k]] for k in here]
    power = np.array([cell.power_w[k] for k in here])
    rate = settings.link.rate(power, ((demands.positions[rows] - cell.position) ** 2).sum(axis=1))
    return replace(
        cell,
        device_ids=tuple(cell.device_ids[k] for k in here),
        power_w=tuple(power.tolist()),
        rate=tuple((settings.bandwidth_hz * rate).tolist()),
    )


def _radio(cell: FleetCell, place: Place, link: LinkBudget) -> Radio:
    goal = _goal(cell, link)
    powers = dict(zip(cell.device_ids, cell.power_w, strict=True))
    there = goal if math.dist(place, goal) <= HOVER_RADIUS_M else place
    if math.fsum(cell.power_w) > link.transmit_power_w * (1 + RELATIVE_TOLERANCE):
        # More than it may have now: it cannot be told that once more.
        return Radio(there, powers if _applies(cell, place, link) else dict(cell.power_until_w))
    if _applies(cell, place, link):
        return Radio(there, powers, Told(goal, powers))
    return Radio(there, dict(cell.power_until_w), Told(goal, powers, cell.apply_within_m))


def _applies(cell: FleetCell, place: Place, link: LinkBudget) -> bool:
    return cell.apply_within_m == 0 or math.dist(place, _goal(cell, link)) <= cell.apply_within_m


def _goal(cell: FleetCell, link: LinkBudget) -> Place:
    return (*cell.position, link.altitude_m)


def _task(cell: FleetCell) -> tuple[object, ...]:
    return cell.uav, cell.position, cell.device_ids, cell.power_w

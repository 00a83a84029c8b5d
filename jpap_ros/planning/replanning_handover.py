"""Make before break: which UAVs go on as they are until others have taken over those whom they serve."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

from jpap_ros.planning.replanning_continuity import Continuity, PowerChange
from jpap_ros.planning.replanning_state import LiveCell, LivePlan

#: Of each UAV that could wait, by its cell: the cells whose UAVs have to serve first, with the devices that they get.
Needs = dict[int, dict[int, list[str]]]


@dataclass(frozen=True)
class HandOver:
    """How a new plan comes into force.

    Attributes
    ----------
    changes : mapping of int to PowerChange
        When each cell's UAV takes its new powers; cells are missing that are as their UAV was told already.
    waits : mapping of int to tuple of int
        UAVs that go on as they were told for now, by the id of their cell, and the cells whose UAVs they wait for.
    holders : mapping of str to int
        Devices that one of these serves until another UAV does, with its cell.
    broken : mapping of str to str
        Devices that are served now and not at every moment until the whole plan is in force, and why.
    delayed : tuple of str
        Devices that nobody serves now and that shall be served by one of those who wait.
    """

    changes: Mapping[int, PowerChange]
    waits: Mapping[int, tuple[int, ...]]
    holders: Mapping[str, int]
    broken: Mapping[str, str]
    delayed: tuple[str, ...]


def hand_over(continuity: Continuity, plan: LivePlan, min_separation_m: float, hold_factor: float) -> HandOver:
    """Find out who has to wait for whom so that nobody is interrupted who need not be.

    Parameters
    ----------
    continuity : Continuity
        What is transmitted now, and what the UAVs were told.
    plan : LivePlan
        The plan that is to come into force.
    min_separation_m : float
        Least distance between the goals of two UAVs [m].
    hold_factor : float
        How many times as much as one that waits a device counts that is served.

    Notes
    -----
    A UAV waits if it serves a device, and goes on to do so as it was told, that another one shall have and does not
    reach yet. And it waits if its new goal is too near to that of a UAV that waits. But it goes if those devices weigh
    less than those, by `hold_factor`, that nobody serves meanwhile: whom it shall serve instead, and whom others shall
    that wait for it, directly or behind one another. And where they would wait for one another in a ring for ever, the
    one goes whose devices to be handed over within the ring weigh least. Whomever they leave without waiting is
    interrupted.

    Nothing is remembered: who waits follows from what is transmitted now. So the same question, asked again when UAVs
    have come farther, says who may go then.
    """
    told = {cell.id for cell in plan.cells if _as_told(continuity, cell)}
    holder = _holders(continuity, plan, told)
    changes = {cell.id: continuity.power_change(cell, holder) for cell in plan.cells if cell.id not in told}
    broken = {name: plan.unserved[name] for name in continuity.guaranteed if name in plan.unserved}
    needs: Needs = {u: {} for u in continuity.flying if u not in told}
    for cell in plan.cells:
        late = changes[cell.id].broken if cell.id in changes else _late(continuity, cell)
        broken |= late
        for name in late:
            if name in holder:
                needs[holder[name]].setdefault(cell.id, []).append(name)
    nodes = needs.keys() | changes.keys()
    blocked = {
        cell.id: {u for u in needs if u != cell.id and _too_near(continuity, u, cell, min_separation_m)}
        for cell in plan.cells
        if cell.id in nodes
    }
    shared = _shared(continuity, plan, holder, needs)
    for u, heirs in shared.items():
        # Whoever takes over as soon as it goes may go at the same time, but not later.
        blocked[u] = blocked.get(u, set()) | heirs.keys()
    _let_go(needs, blocked, plan, continuity, hold_factor)
    _break_rings(needs, nodes, blocked, continuity)
    going = _unblocked({u for u in nodes if not needs.get(u)}, nodes, blocked)
    waits = {
        u: tuple(needs[u]) or tuple(sorted(blocked[u] - going))
        for u in needs
        if u not in going and continuity.flying[u].told is not None
    }
    holders = {name: u for u in waits for names in needs[u].values() for name in names}
    holders |= {name: u for u in waits for v, names in shared.get(u, {}).items() if v not in going for name in names}
    return HandOver(
        changes,
        waits,
        holders,
        broken={name: why for name, why in broken.items() if name not in holders},
        delayed=tuple(
            name
            for cell in plan.cells
            if cell.id in waits
            for name in cell.device_ids
            if name not in continuity.guaranteed
        ),
    )


def _as_told(continuity: Continuity, cell: LiveCell) -> bool:
    """Whether a cell asks of its UAV what that was told already."""
    radio = continuity.flying.get(cell.id)
    if radio is None or radio.told is None or radio.told.goal != continuity.goal(cell):
        return False
    return radio.told.power_w == cell.powers


def _holders(continuity: Continuity, plan: LivePlan, told: Collection[int]) -> dict[str, int]:
    """For each device that goes to another UAV, one that serves it for as long as it is told nothing new.

    Rather one that has no cell in the plan: nobody waits for it.
    """
    ids = {cell.id for cell in plan.cells}
    found: dict[str, int] = {}
    for u in sorted(continuity.flying.keys() - set(told), key=lambda u: (u in ids, u)):
        radio = continuity.flying[u]
        for name in radio.told.power_w if radio.told is not None else ():
            cell = plan.cell_of.get(name)
            if cell is not None and cell.id != u and name not in found and continuity.keeps(u, name):
                found[name] = u
    return found


def _shared(continuity: Continuity, plan: LivePlan, holder: Mapping[str, int], needs: Needs) -> Needs:
    """Devices whose heir would serve them as soon as it goes, of each UAV that has them, by the heir's cell."""
    found: Needs = {}
    for name, u in holder.items():
        heir = plan.cell_of[name].id
        if heir in needs and name not in needs[u].get(heir, ()) and not continuity.keeps(heir, name):
            found.setdefault(u, {}).setdefault(heir, []).append(name)
    return found


def _late(continuity: Continuity, cell: LiveCell) -> dict[str, str]:
    """Devices that are served now, but not yet, or not all the way, by the UAV that was told to."""
    radio = continuity.flying[cell.id]
    assert radio.told is not None
    if radio.place == radio.told.goal and not radio.told.within_m:
        return {}
    why = "its UAV is on a way, told earlier, that leads out of reach"
    served = [name for name in cell.device_ids if name in continuity.guaranteed]
    return {name: why for name in served if not continuity.keeps(cell.id, name)}


def _too_near(continuity: Continuity, waiting: int, cell: LiveCell, min_separation_m: float) -> bool:
    """Whether a cell's goal is too near to where another UAV goes on to fly as long as it waits."""
    told = continuity.flying[waiting].told
    # Goals may be as near as allowed, but for rounding.
    return told is not None and math.dist(told.goal[:2], cell.position) < min_separation_m * (1 - 1e-6)


def _unblocked(ready: set[int], pending: Collection[int], blocked: Mapping[int, set[int]]) -> set[int]:
    """Those of `ready` whose goals are free once all of them have left."""
    while stay := {u for u in ready if blocked.get(u, set()) & (set(pending) - ready)}:
        ready = ready - stay
    return ready


def _let_go(
    needs: Needs, blocked: Mapping[int, set[int]], plan: LivePlan, continuity: Continuity, hold_factor: float
) -> None:
    """Take needs away from those for whom devices wait that weigh more than what they hold, the worst first."""
    unserved = {
        cell.id: _weight([name for name in cell.device_ids if name not in continuity.guaranteed], continuity)
        for cell in plan.cells
    }
    while True:
        excess = {
            u: math.fsum(unserved.get(w, 0.0) for w in _behind(u, needs, blocked))
            - hold_factor * _weight([name for names in needs[u].values() for name in names], continuity)
            for u in needs
            if needs[u]
        }
        worst = max(excess, key=lambda u: (excess[u], -u), default=None)
        if worst is None or excess[worst] <= 0:
            return
        needs[worst] = {}


def _behind(first: int, needs: Needs, blocked: Mapping[int, set[int]]) -> set[int]:
    """Who waits for a UAV, directly or behind one another, and itself."""
    found, new = {first}, {first}
    while new:
        new = {u for u in needs.keys() - found if (needs[u].keys() | blocked.get(u, set())) & new}
        found |= new
    return found


def _break_rings(needs: Needs, nodes: Collection[int], blocked: Mapping[int, set[int]], continuity: Continuity) -> None:
    """Take needs away until everybody can go at last."""
    while ring := _stuck(needs, nodes, blocked):
        costs = {
            u: _weight([name for v in needs[u].keys() & ring for name in needs[u][v]], continuity)
            for u in ring
            if needs.get(u, {}).keys() & ring
        }
        first = min(costs, key=lambda u: (costs[u], u))
        needs[first] = {v: names for v, names in needs[first].items() if v not in ring}


def _weight(names: Collection[str], continuity: Continuity) -> float:
    demands = continuity.demands
    return math.fsum(float(demands.weights[demands.index[name]]) for name in names)


def _stuck(needs: Needs, nodes: Collection[int], blocked: Mapping[int, set[int]]) -> set[int]:
    """Those who wait for one another for ever, when all others have gone as soon as they could."""
    pending = set(nodes)
    while pending:
        ready = _unblocked({u for u in pending if not needs.get(u, {}).keys() & pending}, pending, blocked)
        if not ready:
            break
        pending -= ready
    return pending

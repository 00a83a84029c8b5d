"""Incremental replanning: answer an event with the smallest change of the deployment in force.

How it decides, and what it guarantees, is in docs/replanning.md.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from jpap_ros.planning.deployment import RELATIVE_TOLERANCE
from jpap_ros.planning.link_budget import snr_demand
from jpap_ros.planning.replanning_continuity import Continuity, OnAir
from jpap_ros.planning.replanning_handover import hand_over
from jpap_ros.planning.replanning_position import Point, nearest_position
from jpap_ros.planning.replanning_state import Demands, Limits, LiveCell, LivePlan
from jpap_ros.planning.solver import servable_alone

#: Powers that differ by less than this part are the same: a cell that nothing happened to is left untouched.
SAME_POWER = 1e-9


@dataclass(frozen=True, eq=False)
class Change:
    """A new plan, and what it means to those who are served.

    Attributes
    ----------
    plan : LivePlan
    touched : tuple of int
        Ids of cells that are new or whose position, devices or powers changed.
    ended : tuple of int
        Ids of cells that are no more: their aircraft are free.
    moved_m : float
        Sum of the distances that cells move [m].
    interrupted : mapping of str to str
        Devices whose demand was met and now is not guaranteed at every moment of the change, and why.
    waits : tuple of str
        Devices that nobody serves now and whose UAV has to wait for others, and those for whose sake it waits.
    """

    plan: LivePlan
    touched: tuple[int, ...]
    ended: tuple[int, ...]
    moved_m: float
    interrupted: Mapping[str, str]
    waits: tuple[str, ...]


def replan(
    present: LivePlan,
    demands: Demands,
    limits: Limits,
    lost_cells: Collection[int] = (),
    on_air: OnAir | None = None,
    same_powers: bool = False,
) -> Change:
    """Fit the devices that there are now into the deployment in force, with the smallest change.

    Parameters
    ----------
    present : LivePlan
        The plan in force.
    demands : Demands
        Every device that there is now.
    limits : Limits
    lost_cells : collection of int
        Cells that have lost their aircraft and will get no other: their devices go to the neighbours.
    on_air : OnAir, optional
        What is transmitted now; if missing, every UAV is at its place in the plan in force.
    same_powers : bool
        The plan in force was made with the same link and power rule: a cell that nothing happened to has its powers.

    Returns
    -------
    Change
        Its deployment has no `violations`.

    Notes
    -----
    A device whose position and demand are as before stays in its cell. One that changed stays if its cell can still
    serve it with the others. All that are without a cell then, by weight and then by demand, go to the cell that has
    to move least for them, of equal ones the one nearest, without interrupting anybody's guaranteed rate on the way: if
    there is such a cell, not their own either. Where there is none, a new cell is opened; and where there is no UAV for
    that, a short interruption of others is accepted, and reported. Powers are shared out anew wherever anything
    changed, so a departed device frees its own.
    """
    alive = _affordable([cell for cell in present.cells if cell.id not in lost_cells], demands, limits)
    on_air = on_air or OnAir.at_goals(present, limits.link, lost_cells)
    draft = _Draft(present, alive, demands, limits, Continuity(on_air, demands, limits.link))
    for cell in alive:
        rows = [demands.index[name] for name in cell.device_ids if name in demands.index]
        as_before = [k for k in rows if _unchanged(demands.ids[k], present.demands, demands)]
        draft.keep(cell, as_before, [k for k in rows if k not in as_before])
    possible = servable_alone(demands.rates, limits.link)
    unserved: dict[int, str] = {}
    for k in draft.waiting():
        if not possible[k]:
            unserved[k] = (
                f"demands {demands.rates[k]:.6g} bit/s/Hz; the most that one UAV can give, from straight above"
                f" with all its power, is {limits.link.max_rate:.6g}"
            )
        elif not draft.serve(k, limits.max_uavs):
            unserved[k] = draft.refusal()
    cells, next_id = draft.cells(same_powers), draft.next_id
    for k in unserved:
        if possible[k]:
            draft.serve(k, None)
    reasons = {demands.ids[k]: why for k, why in sorted(unserved.items())}
    plan = LivePlan(cells, demands, reasons, next_id, len(draft.members))
    return _compare(present, plan, limits, draft.continuity)


def compare(present: LivePlan, plan: LivePlan, limits: Limits, on_air: OnAir | None = None) -> Change:
    """Say what a new plan changes against the one in force; `on_air` as for `replan`."""
    now = on_air or OnAir.at_goals(present, limits.link)
    return _compare(present, plan, limits, Continuity(now, plan.demands, limits.link))


def _compare(present: LivePlan, plan: LivePlan, limits: Limits, continuity: Continuity) -> Change:
    old = {cell.id: cell for cell in present.cells}
    new = {cell.id: cell for cell in plan.cells}
    how = hand_over(continuity, plan, limits.min_separation_m, limits.hold_factor)
    return Change(
        plan=plan,
        touched=tuple(cell.id for cell in plan.cells if old.get(cell.id) != cell),
        ended=tuple(cell_id for cell_id in old if cell_id not in new),
        moved_m=math.fsum(math.dist(old[i].position, new[i].position) for i in old if i in new),
        interrupted=how.broken,
        waits=(*how.delayed, *how.holders),
    )


def _affordable(cells: list[LiveCell], demands: Demands, limits: Limits) -> list[LiveCell]:
    """Cells that the fleet has aircraft for: those whose devices weigh most, in their order."""
    if limits.max_uavs is None or len(cells) <= limits.max_uavs:
        return cells

    def weight(cell: LiveCell) -> float:
        return math.fsum(demands.weights[demands.index[name]] for name in cell.device_ids if name in demands.index)

    chosen = {cell.id for cell in sorted(cells, key=lambda cell: (-weight(cell), cell.id))[: limits.max_uavs]}
    return [cell for cell in cells if cell.id in chosen]


def _unchanged(name: str, before: Demands, now: Demands) -> bool:
    then = before.index.get(name)
    return then is not None and (before.places[then], before.rates[then]) == (
        now.places[now.index[name]],
        now.rates[now.index[name]],
    )


class _Draft:
    """Cells in the making, with devices by row of the table."""

    def __init__(
        self,
        present: LivePlan,
        alive: Sequence[LiveCell],
        demands: Demands,
        limits: Limits,
        continuity: Continuity,
    ) -> None:
        self.demands = demands
        self.limits = limits
        self.next_id = present.next_id
        self.before = {cell.id: cell for cell in present.cells}
        self.continuity = continuity
        self.members: dict[int, list[int]] = {}
        self.position: dict[int, Point] = {cell.id: cell.position for cell in alive}
        #: Cells all of whose devices are there and as they were.
        self.intact: set[int] = set()
        #: Farthest that a UAV can be from each device even if it has all the power [m], equation (5).
        self.reach_m = limits.link.coverage_radius(limits.link.transmit_power_w, demands.rates).tolist()

    def keep(self, cell: LiveCell, as_before: list[int], changed: list[int]) -> None:
        """Take over a cell with as many of its devices as it can still serve."""
        self.members[cell.id] = []
        if len(as_before) == len(cell.device_ids):
            self.intact.add(cell.id)
        # All at once first, since that is what nearly always holds; else one by one, those of old before the changed.
        if not self._take(cell.id, as_before + changed):
            for k in [*sorted(as_before, key=self._urgency), *sorted(changed, key=self._urgency)]:
                self._take(cell.id, [k])
        if not self.members[cell.id]:
            del self.members[cell.id], self.position[cell.id]

    def waiting(self) -> list[int]:
        """Devices without a cell, the most urgent first."""
        placed = {k for members in self.members.values() for k in members}
        return sorted((k for k in range(len(self.demands.ids)) if k not in placed), key=self._urgency)

    def serve(self, device: int, max_uavs: int | None) -> bool:
        """Find a place for a device with the least change: in a cell, in a new one, in one at others' expense."""
        own = self.demands.ids[device]
        return (
            self._join(device, interrupting=())
            or (own in self.continuity.guaranteed and self._join(device, interrupting=(own,)))
            or self._open(device, max_uavs)
            or self._join(device, interrupting=self.continuity.guaranteed)
        )

    def refusal(self) -> str:
        """Say why a device that one UAV could serve is served by none."""
        most = self.limits.max_uavs
        if most is not None and len(self.members) >= most:
            return f"no UAV in use can serve it as well, and all {most} of the fleet are in use"
        return (
            "no UAV in use can serve it as well, and a further one cannot hover within its reach at least"
            f" {self.limits.min_separation_m:g} m from the others"
        )

    def cells(self, same_powers: bool) -> tuple[LiveCell, ...]:
        """All cells with their powers; one that nothing happened to is as it was."""
        result = []
        for cell_id, members in self.members.items():
            kept, position = self.before.get(cell_id), self.position[cell_id]
            untouched = kept is not None and len(members) == len(kept.device_ids) and position == kept.position
            if same_powers and kept is not None and untouched and cell_id in self.intact:
                result.append(kept)
                continue
            cell = self._cell(cell_id, sorted(members), position)
            result.append(kept if kept is not None and _same(kept, cell) else cell)
        return tuple(result)

    def _urgency(self, device: int) -> tuple[float, float, int]:
        return -float(self.demands.weights[device]), self.demands.snr_demand[device], device

    def _join(self, device: int, interrupting: Collection[str]) -> bool:
        """Put a device into the cell that moves least for it, where only some may be interrupted on the way."""
        target, tolerated = self.demands.places[device], set(interrupting)
        best: tuple[float, float, int] | None = None
        goal = target
        for cell, here in sorted(self.position.items(), key=lambda item: math.dist(item[1], target)):
            if best is not None and best[0] == 0:
                break
            there = self._place_for(cell, [device])
            if there is None:
                continue
            score = math.dist(here, there), math.dist(here, target), cell
            if (best is None or score < best) and self._interrupted(cell, device, there) <= tolerated:
                best, goal = score, there
        if best is None:
            return False
        self.members[best[2]].append(device)
        self.position[best[2]] = goal
        return True

    def _interrupted(self, cell: int, device: int, there: Point) -> set[str]:
        """Devices that are interrupted if a device joins a cell."""
        if cell not in self.continuity.flying:
            # Those that are in it wait for its UAV already.
            return {self.demands.ids[device]} & self.continuity.guaranteed.keys()
        return set(self.continuity.power_change(self._cell(cell, [*self.members[cell], device], there)).broken)

    def _open(self, device: int, max_uavs: int | None) -> bool:
        """Open a new cell over a device."""
        if max_uavs is not None and len(self.members) >= max_uavs:
            return False
        cell = self.next_id
        self.position[cell] = self.demands.places[device]
        self.members[cell] = []
        if self._take(cell, [device]):
            self.next_id += 1
            return True
        del self.members[cell], self.position[cell]
        return False

    def _take(self, cell: int, devices: list[int]) -> bool:
        there = self._place_for(cell, devices)
        if there is None:
            return False
        self.members[cell] += devices
        self.position[cell] = there
        return True

    def _place_for(self, cell: int, devices: list[int]) -> Point | None:
        """Nearest position from which a cell could serve some more devices; None where there is none."""
        rows = self.members[cell] + devices
        most = self.limits.max_devices_per_uav
        if not rows or (most is not None and len(rows) > most) or self._too_far_apart(self.members[cell], devices):
            return None
        discs = self.limits.rule.discs(
            [self.demands.places[k] for k in rows], [self.demands.snr_demand[k] for k in rows]
        )
        if discs is None:
            return None
        others = [position for other, position in self.position.items() if other != cell]
        return nearest_position(self.position[cell], discs, others, self.limits.min_separation_m)

    def _too_far_apart(self, members: list[int], devices: list[int]) -> bool:
        """Whether two devices have no place in common: quickly settles most cells for most devices."""
        places, reach_m = self.demands.places, self.reach_m
        return any(
            math.dist(places[k], places[other]) > (reach_m[k] + reach_m[other]) * (1 + RELATIVE_TOLERANCE)
            for k in devices
            for other in members
        )

    def _cell(self, cell: int, rows: list[int], position: Point) -> LiveCell:
        distance2 = ((self.demands.positions[rows] - position) ** 2).sum(axis=1)
        power = self.limits.rule.powers(distance2, snr_demand(self.demands.rates[rows]))
        return LiveCell(cell, position, tuple(self.demands.ids[k] for k in rows), tuple(power.tolist()))


def _same(kept: LiveCell, cell: LiveCell) -> bool:
    if kept.position != cell.position or sorted(kept.device_ids) != sorted(cell.device_ids):
        return False
    before = dict(zip(kept.device_ids, kept.power_w, strict=True))
    powers = zip(cell.device_ids, cell.power_w, strict=True)
    return all(abs(before[name] - power) <= SAME_POWER * power for name, power in powers)

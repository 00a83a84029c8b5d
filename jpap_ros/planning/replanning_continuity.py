"""Whether every device keeps its guaranteed rate while UAVs fly from the old plan to the new one."""

from __future__ import annotations

import math

from jpap_ros.planning.deployment import RELATIVE_TOLERANCE
from jpap_ros.planning.link_budget import LinkBudget
from jpap_ros.planning.replanning_state import Demands, LiveCell, LivePlan

Point = tuple[float, float]


class Continuity:
    """The guarantees of the plan in force, and which of them a change would break.

    Parameters
    ----------
    present : LivePlan
        The plan in force.
    demands : Demands
        The devices that there are now.
    link : LinkBudget

    Notes
    -----
    Let a UAV fly straight from a to b, and let s be the share of the way flown. With its old power a device is in
    reach while s <= s_old, with its new one while s >= s_new (coverage discs are convex). A UAV changes the powers of
    all its devices at one moment, so none of those that stay is interrupted if the largest s_new is at most the
    smallest s_old; then any s between the two will do. A device that goes to another UAV is taken over by that one
    first, so that UAV has to change its powers, with the device in reach, before it moves.
    """

    def __init__(self, present: LivePlan, demands: Demands, link: LinkBudget) -> None:
        self._demands = demands
        self._link = link
        self._before = {cell.id: cell for cell in present.cells}
        #: Cell of each device whose present demand the plan in force meets.
        self.guaranteed = {
            name: cell
            for name, cell in present.cell_of.items()
            if name in demands.index and self._reach2(name, cell) >= self._distance2(name, cell.position)
        }

    def broken_by(self, cell: LiveCell) -> dict[str, str]:
        """Devices of a new cell without a guarantee at every moment of the change, and why.

        The moment at which its UAV changes the powers is chosen such that there are as few as possible.
        """
        served = [name for name in cell.device_ids if name in self.guaranteed]
        before = self._before.get(cell.id)
        if before is None:
            return dict.fromkeys(served, "goes to a UAV that has to arrive first")
        windows = {name: self._window(name, before, cell) for name in served}
        spared: set[str] = set()
        for moment in {0.0, *(first for first, _ in windows.values())}:
            fine = {name for name, (first, last) in windows.items() if first <= moment <= last}
            spared = max(spared, fine, key=len)
        why = f"out of reach at some moment while its UAV moves {math.dist(before.position, cell.position):.1f} m"
        return {name: why for name in served if name not in spared}

    def broken_by_plan(self, plan: LivePlan) -> dict[str, str]:
        """Devices that a new plan interrupts or leaves out, and why."""
        found = {name: plan.unserved[name] for name in self.guaranteed if name in plan.unserved}
        for cell in plan.cells:
            found |= self.broken_by(cell)
        return found

    def _window(self, name: str, before: LiveCell, cell: LiveCell) -> tuple[float, float]:
        """Shares of the way between which the powers have to change for this device's sake."""
        u = self._demands.places[self._demands.index[name]]
        last = 0.0
        if self.guaranteed[name].id == cell.id:
            last = _way_in_reach(before.position, cell.position, u, self._reach2(name, before))
        return 1.0 - _way_in_reach(cell.position, before.position, u, self._reach2(name, cell)), last

    def _reach2(self, name: str, cell: LiveCell) -> float:
        """Squared horizontal distance up to which a cell's power meets a device's demand [m^2], equation (5)."""
        power = cell.power_w[cell.device_ids.index(name)]
        reach2 = power * self._link.eta / self._demands.snr_demand[self._demands.index[name]]
        return reach2 * (1 + RELATIVE_TOLERANCE) - self._link.altitude_m**2

    def _distance2(self, name: str, position: Point) -> float:
        x, y = self._demands.places[self._demands.index[name]]
        return (x - position[0]) ** 2 + (y - position[1]) ** 2


def _way_in_reach(start: Point, end: Point, device: Point, reach2: float) -> float:
    """Share of the way from start to end, from its start on, that is within a squared distance of the device."""
    wx, wy = start[0] - device[0], start[1] - device[1]
    dx, dy = end[0] - start[0], end[1] - start[1]
    inside, slope, length2 = reach2 - wx * wx - wy * wy, wx * dx + wy * dy, dx * dx + dy * dy
    if inside < 0:
        return 0.0
    if (wx + dx) ** 2 + (wy + dy) ** 2 <= reach2:
        return 1.0
    return (-slope + math.sqrt(slope * slope + length2 * inside)) / length2

"""Whether every device keeps its guaranteed rate while UAVs fly from where they are to the places of a new plan."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from jpap_ros.planning.deployment import RELATIVE_TOLERANCE
from jpap_ros.planning.link_budget import LinkBudget
from jpap_ros.planning.replanning_state import Demands, LiveCell, LivePlan

Place = tuple[float, float, float]

#: A UAV this near to its goal is there [m]: it never hovers at the very point.
HOVER_RADIUS_M = 2.0


@dataclass(frozen=True)
class Radio:
    """What the radio of one UAV does at this moment.

    Attributes
    ----------
    place : tuple of float
        Where the UAV is: east, north, and up from the devices [m].
    power_w : mapping of str to float
        Power for each device [W].
    """

    place: Place
    power_w: Mapping[str, float]


@dataclass(frozen=True)
class OnAir:
    """All that is transmitted at this moment.

    Attributes
    ----------
    flying : mapping of int to Radio
        By the id of the cell that the UAV flies for from now on. A cell that is missing waits for a UAV to arrive.
    gone : tuple of Radio
        Of UAVs that have served until now and do not any more.
    """

    flying: Mapping[int, Radio]
    gone: tuple[Radio, ...] = ()

    @classmethod
    def at_goals(cls, plan: LivePlan, link: LinkBudget) -> OnAir:
        """Return what is transmitted once every UAV of a plan is at its goal."""
        return cls(
            {
                cell.id: Radio((*cell.position, link.altitude_m), dict(zip(cell.device_ids, cell.power_w, strict=True)))
                for cell in plan.cells
            }
        )


@dataclass(frozen=True)
class PowerChange:
    """When a UAV takes the powers of its new cell, and what that costs.

    Attributes
    ----------
    within_m : float
        Distance to the goal within which the new powers apply [m]; 0: at once.
    broken : mapping of str to str
        Devices that are served now and not at every moment until the UAV is at its goal, and why.
    """

    within_m: float
    broken: Mapping[str, str]


class Continuity:
    """Who is served at this moment, and whom of them a change would interrupt.

    Parameters
    ----------
    on_air : OnAir
        From where each UAV sets out, and with which powers.
    demands : Demands
        The devices that there are now.
    link : LinkBudget

    Notes
    -----
    Let a UAV fly straight from where it is to its goal, and let s be the share of the way flown. With its present power
    a device is in reach while s <= s_old, with its new one while s >= s_new: what a power reaches is a ball, and balls
    are convex. A UAV changes the powers of all its devices at one moment, so none of those that stay is interrupted if
    the largest s_new is at most the smallest s_old; then any s between the two will do. A device that goes to another
    UAV is taken over by that one first, which therefore has to change its powers, with the device in reach, before it
    moves.
    """

    def __init__(self, on_air: OnAir, demands: Demands, link: LinkBudget) -> None:
        self._demands = demands
        self._link = link
        #: Cells whose UAV flies, with what its radio does now.
        self.flying = on_air.flying
        #: Devices whose present demand is met at this moment, in a fixed order.
        self.guaranteed = {
            name: None
            for radio in (*on_air.flying.values(), *on_air.gone)
            for name, power in radio.power_w.items()
            if name in demands.index and math.dist(radio.place, self._place(name)) ** 2 <= self._reach2(name, power)
        }

    def power_change(self, cell: LiveCell) -> PowerChange:
        """Choose the moment for a new cell's powers: the earliest of those that interrupt the fewest."""
        served = [name for name in cell.device_ids if name in self.guaranteed]
        radio = self.flying.get(cell.id)
        if radio is None:
            return PowerChange(0.0, dict.fromkeys(served, "goes to a UAV that has to arrive first"))
        goal = (*cell.position, self._link.altitude_m)
        powers = dict(zip(cell.device_ids, cell.power_w, strict=True))
        windows = {name: self._window(name, radio, powers[name], goal) for name in served}
        spared: set[str] = set()
        best = 0.0
        for moment in sorted({0.0, *(first for first, _ in windows.values())}):
            fine = {name for name, (first, last) in windows.items() if first <= moment <= last}
            if len(fine) > len(spared):
                spared, best = fine, moment
        way_m = math.dist(radio.place, goal)
        why = f"out of reach at some moment while its UAV moves {way_m:.1f} m"
        within_m = max((1.0 - best) * way_m, HOVER_RADIUS_M) if best > 0 else 0.0
        return PowerChange(within_m, {name: why for name in served if name not in spared})

    def broken_by_plan(self, plan: LivePlan) -> dict[str, str]:
        """Devices that a new plan interrupts or leaves out, and why."""
        found = {name: plan.unserved[name] for name in self.guaranteed if name in plan.unserved}
        for cell in plan.cells:
            found |= self.power_change(cell).broken
        return found

    def _window(self, name: str, radio: Radio, power_w: float, goal: Place) -> tuple[float, float]:
        """Shares of the way between which the powers have to change for this device's sake."""
        u = self._place(name)
        last = 0.0
        if name in radio.power_w:
            last = _way_in_reach(radio.place, goal, u, self._reach2(name, radio.power_w[name]))
        return 1.0 - _way_in_reach(goal, radio.place, u, self._reach2(name, power_w)), last

    def _place(self, name: str) -> Place:
        return (*self._demands.places[self._demands.index[name]], 0.0)

    def _reach2(self, name: str, power_w: float) -> float:
        """Squared distance up to which a power meets a device's demand [m^2], equation (5)."""
        reach2 = power_w * self._link.eta / self._demands.snr_demand[self._demands.index[name]]
        return reach2 * (1 + RELATIVE_TOLERANCE)


def _way_in_reach(start: Place, end: Place, device: Place, reach2: float) -> float:
    """Share of the way from start to end, from its start on, that is within a squared distance of the device."""
    wx, wy, wz = start[0] - device[0], start[1] - device[1], start[2] - device[2]
    dx, dy, dz = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    inside = reach2 - wx * wx - wy * wy - wz * wz
    if inside < 0:
        return 0.0
    if (wx + dx) ** 2 + (wy + dy) ** 2 + (wz + dz) ** 2 <= reach2:
        return 1.0
    slope, length2 = wx * dx + wy * dy + wz * dz, dx * dx + dy * dy + dz * dz
    return (-slope + math.sqrt(slope * slope + length2 * inside)) / length2

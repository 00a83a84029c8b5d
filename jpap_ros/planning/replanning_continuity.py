"""Whether every device keeps its guaranteed rate while UAVs fly from where they are to the places of a new plan."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

from jpap_ros.planning.deployment import RELATIVE_TOLERANCE
from jpap_ros.planning.link_budget import LinkBudget
from jpap_ros.planning.replanning_state import Demands, LiveCell, LivePlan

Place = tuple[float, float, float]

#: A UAV this near to its goal is there [m]: it never hovers at the very point.
HOVER_RADIUS_M = 2.0


@dataclass(frozen=True)
class Told:
    """What a UAV goes on with as long as it is told nothing new.

    Attributes
    ----------
    goal : tuple of float
        Where it flies: east, north, and up from the devices [m].
    power_w : mapping of str to float
        Power for each device [W] that it takes on its way, or has already.
    within_m : float
        Distance to the goal within which it takes them [m]; 0: it has them already.
    """

    goal: Place
    power_w: Mapping[str, float]
    within_m: float = 0.0


@dataclass(frozen=True)
class Radio:
    """What the radio of one UAV does at this moment.

    Attributes
    ----------
    place : tuple of float
        Where the UAV is: east, north, and up from the devices [m].
    power_w : mapping of str to float
        Power for each device [W].
    told : Told or None
        What it does next; None where nothing is known of that.
    """

    place: Place
    power_w: Mapping[str, float]
    told: Told | None = None


@dataclass(frozen=True)
class OnAir:
    """All that is transmitted at this moment.

    Attributes
    ----------
    flying : mapping of int to Radio
        By the id of the cell that the UAV flies for from now on, or of the one that it flew for if it has none any
        more. A cell that is missing waits for a UAV to arrive.
    gone : tuple of Radio
        Of UAVs that have served until now and do not any more.
    """

    flying: Mapping[int, Radio]
    gone: tuple[Radio, ...] = ()

    @classmethod
    def at_goals(cls, plan: LivePlan, link: LinkBudget, lost: Collection[int] = ()) -> OnAir:
        """Return what is transmitted once every UAV of a plan is at its goal; those of `lost` cells do not go on."""
        flying = {}
        for cell in plan.cells:
            goal = (*cell.position, link.altitude_m)
            flying[cell.id] = Radio(goal, cell.powers, Told(goal, cell.powers))
        gone = tuple(flying.pop(cell_id) for cell_id in lost if cell_id in flying)
        return cls(flying, gone)


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
        self._link = link
        self.demands = demands
        #: Cells whose UAV flies, with what its radio does now.
        self.flying = on_air.flying
        #: Devices whose present demand is met at this moment, in a fixed order.
        self.guaranteed = {
            name: None
            for radio in (*on_air.flying.values(), *on_air.gone)
            for name in radio.power_w
            if name in demands.index and self._is_served(radio, name)
        }

    def goal(self, cell: LiveCell) -> Place:
        """Where the UAV of a cell hovers."""
        return (*cell.position, self._link.altitude_m)

    def power_change(self, cell: LiveCell, held: Collection[str] = ()) -> PowerChange:
        """Choose the moment for a new cell's powers: the earliest of those that interrupt the fewest.

        Devices that are `held`, because another UAV can serve them until this one does, do not decide.
        """
        served = [name for name in cell.device_ids if name in self.guaranteed]
        radio = self.flying.get(cell.id)
        if radio is None:
            return PowerChange(0.0, dict.fromkeys(served, "goes to a UAV that has to arrive first"))
        goal = self.goal(cell)
        powers = cell.powers
        windows = {name: self._window(name, radio, powers[name], goal) for name in served}
        most, best = 0, 0.0
        for moment in sorted({0.0, *(first for first, _ in windows.values())}):
            fine = sum(first <= moment <= last for name, (first, last) in windows.items() if name not in held)
            if fine > most:
                most, best = fine, moment
        way_m = math.dist(radio.place, goal)
        why = f"out of reach at some moment while its UAV moves {way_m:.1f} m"
        within_m = max((1.0 - best) * way_m, HOVER_RADIUS_M) if best > 0 else 0.0
        return PowerChange(within_m, {name: why for name, (a, b) in windows.items() if not a <= best <= b})

    def keeps(self, cell_id: int, name: str) -> bool:
        """Whether a UAV that is told nothing new serves a device from now on at every moment."""
        radio = self.flying.get(cell_id)
        if radio is None or radio.told is None or not (name in radio.power_w and name in radio.told.power_w):
            return False
        told = radio.told
        first, last = self._window(name, radio, told.power_w[name], told.goal)
        way_m = math.dist(radio.place, told.goal)
        change = 1.0 - told.within_m / way_m if told.within_m and way_m > told.within_m else 0.0
        return self._is_served(radio, name) and first <= change <= last

    def meets(self, place: Place, name: str, power_w: float) -> bool:
        """Whether a power [W] meets a device's demand from a place."""
        return math.dist(place, self._place(name)) ** 2 <= self._reach2(name, power_w)

    def _is_served(self, radio: Radio, name: str) -> bool:
        return self.meets(radio.place, name, radio.power_w[name])

    def _window(self, name: str, radio: Radio, power_w: float, goal: Place) -> tuple[float, float]:
        """Shares of the way between which the powers have to change for this device's sake."""
        u = self._place(name)
        last = 0.0
        if name in radio.power_w:
            last = _way_in_reach(radio.place, goal, u, self._reach2(name, radio.power_w[name]))
        return 1.0 - _way_in_reach(goal, radio.place, u, self._reach2(name, power_w)), last

    def _place(self, name: str) -> Place:
        return (*self.demands.places[self.demands.index[name]], 0.0)

    def _reach2(self, name: str, power_w: float) -> float:
        """Squared distance up to which a power meets a device's demand [m^2], equation (5)."""
        reach2 = power_w * self._link.eta / self.demands.snr_demand[self.demands.index[name]]
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

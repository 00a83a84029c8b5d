"""What a plan says to the fleet: cells with the names of the aircraft that fly them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from jpap_ros.planning.replanning_state import LivePlan


@dataclass(frozen=True)
class Aircraft:
    """One aircraft as the planner sees it.

    Attributes
    ----------
    name : str
        Name in the fleet file.
    position : tuple of float
        Where it is, or where it is believed to be: east and north [m].
    connected : bool
        Whether its telemetry arrives.
    airborne : bool
        Whether telemetry says that it is in the air.
    unavailable : str
        Why it can take no cell, in words; empty if it can.
    located : bool
        Whether it is sure to be at `position` and flies on from there as it is told.
    up_m : float or None
        How high it is there [m]; None: as high as the goals are.
    """

    name: str
    position: tuple[float, float]
    connected: bool = False
    airborne: bool = False
    unavailable: str = ""
    located: bool = True
    up_m: float | None = None

    @property
    def available(self) -> bool:
        """Whether it can be given a cell."""
        return not self.unavailable

    @property
    def serves_nobody(self) -> bool:
        """Whether it cannot have served anybody until now: it stands on the ground, or was never heard."""
        return not self.airborne and (self.connected or self.available)

    def place(self, level_m: float) -> tuple[float, float, float] | None:
        """Where it flies, east, north, up [m]; None if it does not, or where is unknown. Goals are at `level_m`."""
        if not (self.airborne and self.connected and self.available and self.located):
            return None
        return (*self.position, level_m if self.up_m is None else self.up_m)


@dataclass(frozen=True)
class FleetCell:
    """A named aircraft with the devices it serves.

    Attributes
    ----------
    id : int
        Stays the same from plan to plan as long as the cell exists.
    uav : str
        Empty if no aircraft is left for this cell.
    position : tuple of float
        East and north of the goal [m].
    device_ids : tuple of str
    power_w, rate : tuple of float
        For each device: transmit power [W] and rate [bit/s].
    coverage_radius_m : float
        Common coverage radius [m]; NaN where the scheme has none.
    apply_within_m : float
        Distance from the goal within which the aircraft takes these powers [m]; 0: at once.
    power_until_w : tuple of (str, float)
        Power for each device that it goes on with until then [W].
    elsewhere : frozenset of str
        Those of the devices that another aircraft serves for now.
    waits_for : tuple of str
        Why this is not what the plan wants of the aircraft, but what it was told before: aircraft that have to serve
        first, or to leave.
    """

    id: int
    uav: str
    position: tuple[float, float]
    device_ids: tuple[str, ...]
    power_w: tuple[float, ...]
    rate: tuple[float, ...]
    coverage_radius_m: float = math.nan
    apply_within_m: float = 0.0
    power_until_w: tuple[tuple[str, float], ...] = ()
    elsewhere: frozenset[str] = frozenset()
    waits_for: tuple[str, ...] = ()

    @property
    def served(self) -> dict[str, tuple[float, float]]:
        """Power [W] and rate [bit/s] of each device that no other aircraft serves for now."""
        shares = zip(self.device_ids, self.power_w, self.rate, strict=True)
        return {name: (power, rate) for name, power, rate in shares if name not in self.elsewhere}

    @property
    def uav_rate(self) -> float:
        """Sum of the rates of those devices [bit/s]."""
        return math.fsum(rate for _, rate in self.served.values())


@dataclass(frozen=True, eq=False)
class FleetPlan:
    """Every cell, and every device that is left out.

    Attributes
    ----------
    cells : tuple of FleetCell
        What each aircraft is told now. Some go on as they were told before, until others have taken over from them.
    target : tuple of FleetCell
        What it comes to once nobody waits any more.
    live : LivePlan
        `target` without names, for replanning.
    unserved : mapping of str to str
        Reason for each device that no cell serves.
    uavs_needed, min_uavs_bound, proven_optimal, scheme
        As in `jpap_ros.planning.Deployment`.
    average_uav_rate_bound : float
        Proven upper bound on `average_uav_rate` with this number of UAVs [bit/s]; NaN where none is known.
    interrupted : mapping of str to str
        Devices that are served on, but whose guaranteed rate the change to this plan, or to one before it, interrupts,
        and why.
    from_scratch : bool
        Whether the scheme made it from the devices alone; else it is a change of an earlier plan.
    """

    cells: tuple[FleetCell, ...]
    target: tuple[FleetCell, ...]
    live: LivePlan
    unserved: Mapping[str, str]
    uavs_needed: int
    min_uavs_bound: int | None
    proven_optimal: bool
    scheme: str
    average_uav_rate_bound: float
    interrupted: Mapping[str, str]
    from_scratch: bool

    @property
    def names(self) -> dict[int, str]:
        """Aircraft of each cell that has one, by the cell's id."""
        return {cell.id: cell.uav for cell in self.cells if cell.uav}

    @property
    def holding(self) -> dict[int, str]:
        """Aircraft of each cell that is no more and where one stays until others serve, by the cell's id."""
        wanted = {cell.id for cell in self.target}
        return {cell.id: cell.uav for cell in self.cells if cell.id not in wanted}

    @property
    def waiting(self) -> dict[str, tuple[str, ...]]:
        """Aircraft that go on as they were told before, and whom they wait for."""
        return {cell.uav: cell.waits_for for cell in self.cells if cell.uav and cell.waits_for}

    @property
    def average_uav_rate(self) -> float:
        """Mean of the cells' rates [bit/s]; NaN without cells."""
        return math.fsum(cell.uav_rate for cell in self.cells) / len(self.cells) if self.cells else math.nan

    @property
    def gap(self) -> float:
        """How far `uavs_needed` may be from the least possible, as a part of it; NaN without a bound."""
        if self.proven_optimal:
            return 0.0
        if self.min_uavs_bound is None:
            return math.nan
        return (self.uavs_needed - self.min_uavs_bound) / max(self.uavs_needed, 1)

    def summary(self) -> str:
        """Say it in words."""
        served = sum(len(cell.served) for cell in self.cells)
        uavs = "1 UAV serves" if len(self.cells) == 1 else f"{len(self.cells)} UAVs serve"
        text = f"{uavs} {served} device{'s' if served != 1 else ''}"
        if self.unserved:
            text += f", {len(self.unserved)} unserved"
        if self.uavs_needed > len(self.target):
            text += f", {self.uavs_needed} UAVs needed"
        return text

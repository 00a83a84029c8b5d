"""What replanning starts from and what it makes: cells that keep their identity from plan to plan."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from jpap_ros.planning.deployment import Deployment, make_deployment
from jpap_ros.planning.link_budget import Floats, LinkBudget, snr_demand
from jpap_ros.planning.replanning_rules import POWER_RULES, PowerRule
from jpap_ros.planning.solver import validate

#: See `Limits`.
HOLD_FACTOR = 3.0


@dataclass(frozen=True, eq=False)
class Demands:
    """The devices there are now.

    Attributes
    ----------
    ids : tuple of str
    positions : (K, 2) float
        [m], ENU.
    rates : (K,) float
        Demanded spectral efficiency [bit/s/Hz].
    weights : (K,) float
        Priorities.
    """

    ids: tuple[str, ...]
    positions: Floats
    rates: Floats
    weights: Floats

    @classmethod
    def of(
        cls, ids: Sequence[str], positions: ArrayLike, rates: ArrayLike, weights: ArrayLike | None = None
    ) -> Demands:
        """Check and convert; ValueError that names argument, index and value, as `solve`."""
        if len(set(ids)) != len(ids):
            twice = next(name for k, name in enumerate(ids) if name in ids[:k])
            raise ValueError(f"ids must be unique, got {twice!r} twice")
        problem = validate(positions, rates, LinkBudget(), None, None, weights, 0.0, None, 0)
        if len(ids) != len(problem.rates):
            raise ValueError(f"ids must have one entry for each of {len(problem.rates)} positions, got {len(ids)}")
        return cls(tuple(ids), problem.positions, problem.rates, problem.weights)

    @cached_property
    def index(self) -> Mapping[str, int]:
        """Row of each device."""
        return {name: k for k, name in enumerate(self.ids)}

    @cached_property
    def places(self) -> list[tuple[float, float]]:
        """Positions as plain floats [m]."""
        return [(x, y) for x, y in self.positions.tolist()]

    @cached_property
    def snr_demand(self) -> list[float]:
        """w_k = 2^r_k - 1 as plain floats."""
        return [float(w) for w in snr_demand(self.rates)]


@dataclass(frozen=True)
class Limits:
    """What a deployment has to keep to; as the arguments of `solve`.

    Attributes
    ----------
    scheme : str
        Its power rule is kept; see `POWER_RULES`.
    link : LinkBudget
    max_devices_per_uav : int or None
    max_uavs : int or None
    min_separation_m : float
    hold_factor : float
        When a UAV is to leave devices to another one that does not serve them yet, and may serve others instead that
        nobody serves: it waits as long as this times the weight of those is at least the weight of the others.
    """

    scheme: str = "jpap"
    link: LinkBudget = field(default_factory=LinkBudget)
    max_devices_per_uav: int | None = None
    max_uavs: int | None = None
    min_separation_m: float = 0.0
    hold_factor: float = HOLD_FACTOR

    def __post_init__(self) -> None:
        if not 0 <= self.hold_factor < math.inf:
            raise ValueError(f"hold_factor must be finite and >= 0, got {self.hold_factor!r}")
        if self.scheme not in POWER_RULES:
            raise ValueError(f"scheme must be one of {', '.join(POWER_RULES)}, got {self.scheme!r}")
        validate([], [], self.link, self.max_devices_per_uav, self.max_uavs, None, self.min_separation_m, None, 0)

    @cached_property
    def rule(self) -> PowerRule:
        """Power rule of the scheme."""
        return PowerRule.of(self.scheme, self.link)


@dataclass(frozen=True)
class LiveCell:
    """One UAV's place with the devices it serves.

    Attributes
    ----------
    id : int
        Stays the same as long as the cell exists, so that the cell keeps its aircraft.
    position : tuple of float
        East and north [m].
    device_ids : tuple of str
    power_w : tuple of float
        For each of `device_ids` [W].
    """

    id: int
    position: tuple[float, float]
    device_ids: tuple[str, ...]
    power_w: tuple[float, ...]

    @property
    def powers(self) -> dict[str, float]:
        """Power for each device [W]."""
        return dict(zip(self.device_ids, self.power_w, strict=True))


@dataclass(frozen=True, eq=False)
class LivePlan:
    """A deployment in force.

    Attributes
    ----------
    cells : tuple of LiveCell
    demands : Demands
        The devices it was made for.
    unserved : mapping of str to str
        Reason for each device that no cell serves.
    next_id : int
        Id of the next new cell; ids are not used again.
    uavs_needed : int
        UAVs with which every servable device is served; more than the cells where the fleet is too small.
    """

    cells: tuple[LiveCell, ...]
    demands: Demands
    unserved: Mapping[str, str]
    next_id: int
    uavs_needed: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "unserved", MappingProxyType(dict(self.unserved)))

    @classmethod
    def empty(cls) -> LivePlan:
        """Return the plan without devices."""
        return cls((), Demands.of((), [], []), {}, 0, 0)

    @classmethod
    def of(
        cls, deployment: Deployment, demands: Demands, cell_ids: Sequence[int] | None = None, next_id: int | None = None
    ) -> LivePlan:
        """Make a plan of what `solve` returned for these devices; cells are numbered in order unless ids are given."""
        ids = tuple(range(len(deployment.uav_positions))) if cell_ids is None else tuple(cell_ids)
        cells = []
        for cell_id, (x, y), uav in zip(ids, deployment.uav_positions.tolist(), range(len(ids)), strict=True):
            members = deployment.cell(uav).tolist()
            power = tuple(deployment.power_w[members].tolist())
            cells.append(LiveCell(cell_id, (x, y), tuple(demands.ids[k] for k in members), power))
        unserved = {demands.ids[k]: reason for k, reason in deployment.unserved.items()}
        following = max(ids, default=-1) + 1 if next_id is None else next_id
        return cls(tuple(cells), demands, unserved, following, deployment.uavs_needed)

    @cached_property
    def cell_of(self) -> Mapping[str, LiveCell]:
        """Cell of each served device."""
        return {name: cell for cell in self.cells for name in cell.device_ids}

    def deployment(self, limits: Limits) -> Deployment:
        """As `solve` would return it: UAVs in the order of `cells`, devices in the order of `demands`."""
        index = self.demands.index
        members = [np.array([index[name] for name in cell.device_ids], dtype=np.int64) for cell in self.cells]
        power = np.zeros(len(self.demands.ids))
        for cell, rows in zip(self.cells, members, strict=True):
            power[rows] = cell.power_w
        demand = snr_demand(self.demands.rates)
        radii = [limits.rule.coverage_radius_m(demand[rows]) for rows in members]
        return make_deployment(
            limits.scheme,
            self.demands.positions,
            self.demands.rates,
            limits.link,
            members,
            [cell.position for cell in self.cells],
            power,
            unserved={index[name]: reason for name, reason in self.unserved.items()},
            coverage_radius_m=None if any(map(math.isnan, radii)) else radii,
            uavs_needed=self.uavs_needed,
        )

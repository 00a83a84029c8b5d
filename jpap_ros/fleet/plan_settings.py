"""How to plan for a fleet: what every plan keeps to, whatever happens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from jpap_ros.fleet.assignment import OBJECTIVES
from jpap_ros.planning import LinkBudget
from jpap_ros.planning.devices import Device
from jpap_ros.planning.replanning_state import HOLD_FACTOR, Demands, Limits
from jpap_ros.planning.solver import MIN_RATE

#: Demands are planned for within these limits [bit/s/Hz]: below is nothing to share out, above is far beyond any link,
#: and 2^r is still a number.
_DEMAND_RANGE = (MIN_RATE, 500.0)

#: Weights count within these limits [-]: sums of far greater ones overflow.
_WEIGHT_RANGE = (1e-9, 1e9)


@dataclass(frozen=True)
class PlanSettings:
    """How to plan; see `jpap_ros.planning.solve`.

    Attributes
    ----------
    scheme : str
    link : LinkBudget
    bandwidth_hz : float
        Bandwidth of each device's channel [Hz]: a demand in bit/s is this times one in bit/s/Hz.
    max_devices_per_uav : int or None
    min_separation_m : float
    time_limit_s : float or None
    assignment : str
        Which aircraft takes a cell that has none; see `assign`.
    hold_factor : float
        How many times as much as one that waits a device counts that is served; see `Limits`.

    The last two change no cell: settings that differ only in them are equal.
    """

    scheme: str = "jpap"
    link: LinkBudget = field(default_factory=LinkBudget)
    bandwidth_hz: float = 1.0
    max_devices_per_uav: int | None = None
    min_separation_m: float = 0.0
    time_limit_s: float | None = None
    assignment: str = field(default=OBJECTIVES[0], compare=False)
    hold_factor: float = field(default=HOLD_FACTOR, compare=False)

    def __post_init__(self) -> None:
        if self.assignment not in OBJECTIVES:
            raise ValueError(f"assignment must be one of {', '.join(OBJECTIVES)}, got {self.assignment!r}")

    def limits(self, uavs: int) -> Limits:
        """Return what every plan for so many UAVs has to keep to."""
        return Limits(self.scheme, self.link, self.max_devices_per_uav, uavs, self.min_separation_m, self.hold_factor)

    def demands(self, devices: Sequence[Device]) -> Demands:
        """Return the devices with their demands in bit/s/Hz."""
        return Demands.of(
            tuple(device.id for device in devices),
            np.array([device.position for device in devices], dtype=np.float64).reshape(-1, 2),
            np.clip([device.rate_demand / self.bandwidth_hz for device in devices], *_DEMAND_RANGE),
            np.clip([device.weight for device in devices], *_WEIGHT_RANGE),
        )

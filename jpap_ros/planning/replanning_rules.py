"""From where, and with which powers, one UAV serves a given set of devices, under the power rule of each scheme."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jpap_ros.planning.allocation import EPA, EPA_COMMON, QDPA, Allocation
from jpap_ros.planning.geometry import RELATIVE_TOLERANCE, Disc
from jpap_ros.planning.link_budget import Floats, LinkBudget
from jpap_ros.planning.water_filling import water_fill

#: The paper's power rule of each scheme; None: every device's least power, and the rest by water-filling.
POWER_RULES: dict[str, Allocation | None] = {
    "jpap": QDPA,
    "jpap_epa": EPA,
    "jpap_epa_common": EPA_COMMON,
    "kmeans_qdpa": QDPA,
    "kmeans_epa": EPA,
    "spiral_qdpa": QDPA,
    "spiral_epa": EPA,
    "optimal": None,
}


@dataclass(frozen=True)
class PowerRule:
    """The power rule of a scheme, over one channel.

    Attributes
    ----------
    allocation : Allocation or None
        None: least power for each demand, the rest by water-filling.
    link : LinkBudget
    """

    allocation: Allocation | None
    link: LinkBudget

    @classmethod
    def of(cls, scheme: str, link: LinkBudget) -> PowerRule:
        """Rule of a scheme; ValueError if there is none of that name."""
        if scheme not in POWER_RULES:
            raise ValueError(f"scheme must be one of {', '.join(POWER_RULES)}, got {scheme!r}")
        return cls(POWER_RULES[scheme], link)

    def discs(self, positions: Sequence[tuple[float, float]], snr_demand: Sequence[float]) -> list[Disc] | None:
        """Discs whose common points are exactly those from which one UAV serves all the devices.

        For an allocation of the paper these are the coverage discs, equation (5). For least power it is one disc: the
        demand sum_k w_k (|v - u_k|^2 + H^2) <= P_T eta reads |v - c|^2 <= P_T eta / W - H^2 - V, with W the sum, c the
        mean and V the variance of the u_k, all weighted by w_k.

        Returns
        -------
        list of Disc or None
            None where one of them is empty.
        """
        height2 = self.link.altitude_m**2
        if self.allocation is not None:
            radii = self.allocation.split(snr_demand, self.link.power_eta, height2)[1]
            if min(radii) < 0:
                return None
            return [(x, y, r2) for (x, y), r2 in zip(positions, radii, strict=True)]
        weight = math.fsum(snr_demand)
        x0, y0 = positions[0]
        x = math.fsum(w * (u - x0) for w, (u, _) in zip(snr_demand, positions, strict=True)) / weight
        y = math.fsum(w * (v - y0) for w, (_, v) in zip(snr_demand, positions, strict=True)) / weight
        spread = math.fsum(
            w * ((u - x0 - x) ** 2 + (v - y0 - y) ** 2) for w, (u, v) in zip(snr_demand, positions, strict=True)
        )
        reach = self.link.power_eta / weight
        squared = reach - height2 - spread / weight
        if squared < -RELATIVE_TOLERANCE * reach:
            return None
        return [(x0 + x, y0 + y, max(squared, 0.0))]

    def powers(self, distance2: Floats, snr_demand: Floats) -> Floats:
        """Power for each device of one cell [W], (n,), given squared horizontal distances to the UAV [m^2]."""
        if self.allocation is not None:
            return self.allocation.powers(snr_demand, self.link)
        noise = (distance2 + self.link.altitude_m**2) / self.link.eta
        return water_fill(noise, snr_demand * noise, self.link.transmit_power_w)

    def coverage_radius_m(self, snr_demand: Floats) -> float:
        """Common coverage radius of a cell [m]; NaN where the rule has none."""
        if self.allocation is None or not self.allocation.common_radius:
            return math.nan
        return float(np.sqrt(max(self.allocation.squared_radii(snr_demand, self.link)[0], 0.0)))

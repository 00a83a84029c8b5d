"""How one UAV splits its power among its devices: QDPA, equations (8) to (11), and the equal split EPA."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jpap_ros.planning.link_budget import Floats, LinkBudget

#: A squared radius this close to 0, relative to H^2, is 0: the device is served from straight above, and only
#: the rounding of c / w - H^2 says otherwise.
ZERO_RADIUS = 1e-12


@dataclass(frozen=True)
class Allocation:
    """A power allocation rule.

    Attributes
    ----------
    name : str
        The paper's name of the rule.
    by_demand : bool
        Whether power is split in proportion to the demanded SNR, equation (10), or equally.
    common_radius : bool
        Whether all devices of a cell have one coverage radius: the smallest of equation (5). Under QDPA all are
        equal, equation (8), and this is d_sv of equation (11).
    """

    name: str
    by_demand: bool
    common_radius: bool

    def split(self, snr_demand: Sequence[float], power_eta: float, height2: float) -> tuple[list[float], list[float]]:
        """Split the power; plain floats, for the inner loop of the schemes.

        Parameters
        ----------
        snr_demand : sequence of float
            w_k = 2^r_k - 1 of the devices of one cell.
        power_eta : float
            P_T eta [m^2].
        height2 : float
            H^2 [m^2].

        Returns
        -------
        strengths : list of float
            c_k = P_k eta [m^2]: the SNR at distance D is c_k / D^2.
        squared_radii : list of float
            d_k^2 = c_k / w_k - H^2 [m^2], equation (5); negative where the device can be served from nowhere.
        """
        if self.by_demand:
            scale = power_eta / math.fsum(snr_demand)
            return [scale * w for w in snr_demand], [_squared_radius(scale, height2)] * len(snr_demand)
        strength = power_eta / len(snr_demand)
        if self.common_radius:
            radii = [_squared_radius(strength / max(snr_demand), height2)] * len(snr_demand)
        else:
            radii = [_squared_radius(strength / w, height2) for w in snr_demand]
        return [strength] * len(snr_demand), radii

    def powers(self, snr_demand: Floats, link: LinkBudget) -> Floats:
        """Power for each device of one cell [W], (n,): equation (10), or P_T / n."""
        share = snr_demand / math.fsum(snr_demand) if self.by_demand else np.full(len(snr_demand), 1 / len(snr_demand))
        power: Floats = link.transmit_power_w * share
        return power

    def squared_radii(self, snr_demand: Floats, link: LinkBudget) -> Floats:
        """Squared coverage radius of each device of one cell [m^2], (n,): equation (11), or (5) with P_T / n.

        Negative where the device can be served from nowhere with its share of the power.
        """
        return np.array(self.split(snr_demand.tolist(), link.power_eta, link.altitude_m**2)[1])


def _squared_radius(reach: float, height2: float) -> float:
    """Horizontal part of the squared distance `reach` [m^2]."""
    squared = reach - height2
    return 0.0 if -ZERO_RADIUS * height2 <= squared < 0 else squared


#: QoS demand based power allocation, equation (10): one radius for all.
QDPA = Allocation("QDPA", by_demand=True, common_radius=True)
#: Equal power allocation, each device with its own radius (5).
EPA = Allocation("EPA", by_demand=False, common_radius=False)
#: Equal power allocation, the smallest radius taken for all.
EPA_COMMON = Allocation("EPA with a common radius", by_demand=False, common_radius=True)

"""The radio link between one UAV and one device: equations (1) to (5) of the paper."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

#: Farthest from 0 that a level can be [dB, dBm], and range of heights [m]: beyond, double precision overflows.
MAX_LEVEL_DB = 300.0
MIN_ALTITUDE_M, MAX_ALTITUDE_M = 1e-6, 1e9


@dataclass(frozen=True)
class LinkBudget:
    """Parameters of the line-of-sight channel, and the quantities of the paper that follow from them.

    Parameters
    ----------
    transmit_power_dbm : float
        Total transmit power P_T of one UAV [dBm].
    noise_power_dbm : float
        Noise power sigma^2 at a device, over its bandwidth [dBm].
    reference_gain_db : float
        Channel gain rho_0 at the reference distance of 1 m [dB].
    altitude_m : float
        Height H of every UAV above the ground [m]; > 0.

    Raises
    ------
    ValueError
        If a value is not finite or beyond what can be computed with, or the altitude is not positive.

    Examples
    --------
    >>> link = LinkBudget()
    >>> float(round(link.max_rate, 3))
    21.932
    """

    transmit_power_dbm: float = 40.0
    noise_power_dbm: float = -90.0
    reference_gain_db: float = -30.0
    altitude_m: float = 50.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
            if not number or not math.isfinite(value):
                raise ValueError(f"{field.name} must be a finite number, got {value!r}")
            if field.name != "altitude_m" and abs(value) > MAX_LEVEL_DB:
                raise ValueError(f"{field.name} must be from -{MAX_LEVEL_DB:g} to {MAX_LEVEL_DB:g}, got {value!r}")
        if self.altitude_m <= 0:
            raise ValueError(f"altitude_m must be > 0, got {self.altitude_m!r}")
        if not MIN_ALTITUDE_M <= self.altitude_m <= MAX_ALTITUDE_M:
            raise ValueError(
                f"altitude_m must be from {MIN_ALTITUDE_M:g} to {MAX_ALTITUDE_M:g}, got {self.altitude_m!r}"
            )

    @property
    def transmit_power_w(self) -> float:
        """P_T [W]."""
        return float(10 ** (self.transmit_power_dbm / 10 - 3))

    @property
    def eta(self) -> float:
        """rho_0 / sigma^2 [m^2/W], the gain-to-noise ratio at 1 m; see equation (5)."""
        return float(10 ** ((self.reference_gain_db - self.noise_power_dbm) / 10 + 3))

    @property
    def power_eta(self) -> float:
        """P_T eta [m^2]: the largest sum of w_k (distance_k^2 + H^2) that one UAV can serve."""
        return float(10 ** ((self.transmit_power_dbm + self.reference_gain_db - self.noise_power_dbm) / 10))

    @property
    def max_rate(self) -> float:
        """Largest rate a device can get: from straight above, with all the power [bit/s/Hz]."""
        return math.log2(1 + self.power_eta / self.altitude_m**2)

    def channel_gain(self, distance2: ArrayLike) -> Floats:
        """Channel gain, equation (1), at a squared horizontal distance [m^2]."""
        gain: Floats = 10 ** (self.reference_gain_db / 10) / (np.asarray(distance2, float) + self.altitude_m**2)
        return gain

    def rate(self, power_w: ArrayLike, distance2: ArrayLike) -> Floats:
        """Rate [bit/s/Hz], equation (3), with a power [W] at a squared horizontal distance [m^2]."""
        snr = np.asarray(power_w, float) * self.eta / (np.asarray(distance2, float) + self.altitude_m**2)
        rate: Floats = np.log1p(snr) / math.log(2)
        return rate

    def coverage_radius(self, power_w: ArrayLike, rates: ArrayLike) -> Floats:
        """Coverage radius d_k on the ground [m], equation (5); NaN where the power serves no distance at all."""
        squared = np.asarray(power_w, float) * self.eta / snr_demand(rates) - self.altitude_m**2
        radius: Floats = np.sqrt(np.where(squared >= 0, squared, np.nan))
        return radius


def snr_demand(rates: ArrayLike) -> Floats:
    """Least signal-to-noise ratio 2^r - 1 that gives a rate of r bit/s/Hz: the weight w_k of a device."""
    # Above 1024 bit/s/Hz it is infinite as far as numbers go: what no power serves.
    with np.errstate(over="ignore"):
        demand: Floats = np.expm1(np.asarray(rates, float) * math.log(2))
    return demand

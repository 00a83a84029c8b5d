"""What a scheme returns: every UAV's position, and every device's UAV, power and rate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jpap_ros.planning.link_budget import Floats, LinkBudget

#: Relative tolerance of every comparison in `Deployment.violations`: rounding of double precision, no more.
RELATIVE_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class Deployment:
    """A set of cells: each UAV with the devices it serves. Immutable; arrays are read-only.

    Attributes
    ----------
    uav_positions : (N, 2) float
        Horizontal UAV positions [m], ENU.
    serving_uav : (K,) int
        Index of the UAV that serves each device; -1 where unserved.
    power_w : (K,) float
        Transmit power for each device [W]; 0 where unserved.
    rate : (K,) float
        Rate each device gets [bit/s/Hz], equation (3); 0 where unserved.
    uav_rate : (N,) float
        Rate of each UAV [bit/s/Hz], equation (4).
    average_uav_rate : float
        The objective (6a) of P1 [bit/s/Hz]; NaN without UAVs.
    coverage_radius_m : (N,) float or None
        Common coverage radius of each UAV [m], for schemes that have one.
    uavs_needed : int
        UAVs that serve every servable device; more than N where `max_uavs` was too small. Where no fleet was found
        whose UAVs serve them all as far apart as `min_separation_m` asks: at least so many.
    min_uavs_bound : int or None
        Proven lower bound on the UAVs needed to serve every servable device.
    proven_optimal : bool
        Whether `uavs_needed` is proven to be the least possible.
    unserved : mapping of int to str
        Why each unserved device is not served, by device index.
    scheme : str
        Key of SCHEMES.
    runtime_s : float
        Time that the scheme took [s].
    average_uav_rate_bound : float or None
        Proven upper bound on the average UAV rate of any deployment of N UAVs that serves the same devices
        [bit/s/Hz].
    served_weight_bound : float or None
        Where not every device is served: proven upper bound on the total weight of the devices that the fleet can
        serve. What is served is proven to be the most where its weight reaches the bound.
    """

    uav_positions: Floats
    serving_uav: NDArray[np.int64]
    power_w: Floats
    rate: Floats
    uav_rate: Floats
    coverage_radius_m: Floats | None
    uavs_needed: int
    min_uavs_bound: int | None
    proven_optimal: bool
    unserved: Mapping[int, str]
    scheme: str
    runtime_s: float
    average_uav_rate_bound: float | None = None
    served_weight_bound: float | None = None

    def __post_init__(self) -> None:
        def frozen(array: ArrayLike, dtype: type, shape: tuple[int, ...]) -> NDArray[np.generic]:
            copy: NDArray[np.generic] = np.array(array, dtype=dtype).reshape(shape)
            copy.flags.writeable = False
            return copy

        count, devices = len(self.uav_positions), len(self.serving_uav)
        set_field = object.__setattr__
        set_field(self, "uav_positions", frozen(self.uav_positions, np.float64, (count, 2)))
        set_field(self, "serving_uav", frozen(self.serving_uav, np.int64, (devices,)))
        for name in ("power_w", "rate"):
            set_field(self, name, frozen(getattr(self, name), np.float64, (devices,)))
        set_field(self, "uav_rate", frozen(self.uav_rate, np.float64, (count,)))
        if self.coverage_radius_m is not None:
            set_field(self, "coverage_radius_m", frozen(self.coverage_radius_m, np.float64, (count,)))
        set_field(self, "unserved", MappingProxyType(dict(self.unserved)))

    def __reduce__(self) -> tuple[type[Deployment], tuple[object, ...]]:
        # Copies are made by the constructor: a mapping proxy cannot be pickled, and arrays would come out writable.
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return Deployment, tuple({**values, "unserved": dict(self.unserved)}.values())

    @property
    def average_uav_rate(self) -> float:
        """The objective (6a) of P1 [bit/s/Hz]; NaN without UAVs."""
        return float(self.uav_rate.mean()) if len(self.uav_rate) else float("nan")

    def cell(self, uav: int) -> NDArray[np.int64]:
        """Indices of the devices that a UAV serves."""
        return np.flatnonzero(self.serving_uav == uav)

    def violations(
        self,
        positions: ArrayLike,
        rates: ArrayLike,
        link: LinkBudget,
        max_devices_per_uav: int | None = None,
        max_uavs: int | None = None,
        min_separation_m: float = 0.0,
    ) -> list[str]:
        """Every broken constraint of P1, in words and numbers; empty where the deployment holds.

        Everything is computed afresh from the positions and powers; nothing that the scheme says of itself is
        believed.

        Parameters
        ----------
        positions : (K, 2) array_like
            Device positions [m].
        rates : (K,) array_like
            Demanded rates [bit/s/Hz].
        link : LinkBudget
            The channel.
        max_devices_per_uav, max_uavs, min_separation_m
            The limits of `solve`.

        Returns
        -------
        list of str
            One entry for each broken constraint, with the constraint's number in the paper where it has one.
        """
        from jpap_ros.planning.checks import find_violations

        return find_violations(self, positions, rates, link, max_devices_per_uav, max_uavs, min_separation_m)


def make_deployment(
    scheme: str,
    positions: Floats,
    rates: Floats,
    link: LinkBudget,
    cells: Sequence[NDArray[np.int64]],
    uav_positions: ArrayLike,
    power_w: ArrayLike,
    *,
    unserved: Mapping[int, str],
    coverage_radius_m: ArrayLike | None = None,
    uavs_needed: int | None = None,
    min_uavs_bound: int | None = None,
    proven_optimal: bool = False,
    runtime_s: float = 0.0,
    average_uav_rate_bound: float | None = None,
    served_weight_bound: float | None = None,
) -> Deployment:
    """Make a deployment from cells (index arrays), UAV positions (N, 2) [m] and device powers (K,) [W].

    Rates follow from equation (3), so that no scheme can report a rate that its powers do not give.
    """
    centres = np.asarray(uav_positions, float).reshape(len(cells), 2)
    power = np.asarray(power_w, float)
    serving = np.full(len(positions), -1, dtype=np.int64)
    for uav, members in enumerate(cells):
        serving[members] = uav
    served = np.flatnonzero(serving >= 0)
    rate = np.zeros(len(positions))
    distance2 = ((positions[served] - centres[serving[served]]) ** 2).sum(axis=1)
    rate[served] = link.rate(power[served], distance2)
    uav_rate = np.bincount(serving[served], weights=rate[served], minlength=len(cells)).astype(np.float64)
    return Deployment(
        uav_positions=centres,
        serving_uav=serving,
        power_w=power,
        rate=rate,
        uav_rate=uav_rate,
        coverage_radius_m=None if coverage_radius_m is None else np.asarray(coverage_radius_m, float),
        uavs_needed=len(cells) if uavs_needed is None else uavs_needed,
        min_uavs_bound=min_uavs_bound,
        proven_optimal=proven_optimal,
        unserved=unserved,
        scheme=scheme,
        runtime_s=runtime_s,
        average_uav_rate_bound=average_uav_rate_bound,
        served_weight_bound=served_weight_bound,
    )

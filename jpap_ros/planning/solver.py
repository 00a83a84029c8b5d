"""`solve`: the one way in to every scheme. Validates, leaves out what cannot be served, and runs the scheme."""

from __future__ import annotations

import math
import operator
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from jpap_ros.planning.deployment import Deployment
from jpap_ros.planning.link_budget import Floats, LinkBudget, snr_demand

#: Farthest from the origin that a device can be [m], east and north each; squares of far greater ones overflow.
MAX_COORDINATE_M = 1e9
#: Least rate that a device can demand [bit/s/Hz]. Beside 1, a far smaller signal-to-noise ratio loses its digits.
MIN_RATE = 1e-6


@dataclass(frozen=True, eq=False)
class Problem:
    """A validated instance of P1; what every scheme is given.

    Attributes
    ----------
    positions : (K, 2) float
        Device positions [m].
    rates : (K,) float
        Demanded rates [bit/s/Hz], >= `MIN_RATE`; each can be met from straight above with all the power.
    weights : (K,) float
        Priorities, > 0.
    link : LinkBudget
    max_devices_per_uav : int or None
        K_max of constraint (6e).
    max_uavs : int or None
        Size of the fleet.
    min_separation_m : float
        Least horizontal distance between two UAVs [m].
    deadline : float
        `time.monotonic()` by which to return; infinite where there is no limit.
    seed : int
    """

    positions: Floats
    rates: Floats
    weights: Floats
    link: LinkBudget
    max_devices_per_uav: int | None
    max_uavs: int | None
    min_separation_m: float
    deadline: float
    seed: int

    @property
    def snr_demand(self) -> Floats:
        """w_k = 2^r_k - 1, (K,)."""
        return snr_demand(self.rates)

    @property
    def cell_limit(self) -> int:
        """Most devices in one cell: K_max, or K where there is none."""
        return len(self.rates) if self.max_devices_per_uav is None else self.max_devices_per_uav


Scheme = Callable[[Problem], Deployment]


def validate(
    positions: ArrayLike,
    rates: ArrayLike,
    link: LinkBudget,
    max_devices_per_uav: int | None,
    max_uavs: int | None,
    weights: ArrayLike | None,
    min_separation_m: float,
    time_limit_s: float | None,
    seed: int,
) -> Problem:
    """Check every argument of `solve`; raise ValueError that names the argument, the index and the value."""
    if not isinstance(link, LinkBudget):
        raise ValueError(f"link must be a LinkBudget, got {link!r}")
    where = _float_array("positions", positions)
    if where.size == 0:
        where = where.reshape(0, 2)
    if where.ndim != 2 or where.shape[1] != 2:
        raise ValueError(f"positions must have shape (K, 2), got {where.shape}")
    _require("positions", where, np.isfinite(where), "finite")
    _require("positions", where, np.abs(where) <= MAX_COORDINATE_M, f"within {MAX_COORDINATE_M:g} m of the origin")
    count = len(where)
    demand = _vector("rates", rates, count)
    _require("rates", demand, demand >= MIN_RATE, f">= {MIN_RATE:g}")
    priority = np.ones(count) if weights is None else _vector("weights", weights, count)
    if not _is_number(min_separation_m) or not 0 <= min_separation_m < math.inf:
        raise ValueError(f"min_separation_m must be finite and >= 0, got {min_separation_m!r}")
    if time_limit_s is not None and not (_is_number(time_limit_s) and time_limit_s > 0):
        raise ValueError(f"time_limit_s must be > 0 or None, got {time_limit_s!r}")
    return Problem(
        positions=where,
        rates=demand,
        weights=priority,
        link=link,
        max_devices_per_uav=_limit("max_devices_per_uav", max_devices_per_uav, 1),
        max_uavs=_limit("max_uavs", max_uavs, 0),
        min_separation_m=float(min_separation_m),
        deadline=time.monotonic() + (math.inf if time_limit_s is None else float(time_limit_s)),
        seed=_whole("seed", seed, 0),
    )


def solve(
    positions: ArrayLike,
    rates: ArrayLike,
    scheme: str = "jpap",
    link: LinkBudget = LinkBudget(),  # noqa: B008 (frozen)
    max_devices_per_uav: int | None = None,
    max_uavs: int | None = None,
    weights: ArrayLike | None = None,
    min_separation_m: float = 0.0,
    time_limit_s: float | None = None,
    seed: int = 0,
) -> Deployment:
    """Decide how many UAVs serve the devices, where each hovers and how much power each device gets.

    Parameters
    ----------
    positions : (K, 2) array_like
        Device positions [m], ENU.
    rates : (K,) array_like
        Demanded spectral efficiency of each device [bit/s/Hz]; >= 1e-6 (`MIN_RATE`).
    scheme : str
        A key of SCHEMES.
    link : LinkBudget
        The channel and the altitude.
    max_devices_per_uav : int, optional
        K_max of constraint (6e).
    max_uavs : int, optional
        Size of the fleet: what it can serve is served, the rest is reported unserved.
    weights : (K,) array_like, optional
        Priority of each device when the fleet is too small; > 0, default 1.
    min_separation_m : float
        Least horizontal distance between two UAVs [m].
    time_limit_s : float, optional
        Return the best deployment found by then [s].
    seed : int
        Seed of the schemes that draw at random.

    Returns
    -------
    Deployment
        A device that no UAV could serve, even from straight above with all its power, is reported unserved with
        the largest demand that could be met.

    Raises
    ------
    ValueError
        On bad input; names the argument, the index and the value.

    Examples
    --------
    >>> from jpap_ros.planning import solve
    >>> deployment = solve([[0, 0], [60, 0], [900, 900]], [16, 17, 18])
    >>> deployment.serving_uav.tolist()
    [1, 1, 0]
    """
    from jpap_ros.planning.schemes import SCHEMES

    started = time.monotonic()
    if not isinstance(scheme, str) or scheme not in SCHEMES:
        raise ValueError(f"scheme must be one of {', '.join(SCHEMES)}, got {scheme!r}")
    problem = validate(
        positions, rates, link, max_devices_per_uav, max_uavs, weights, min_separation_m, time_limit_s, seed
    )
    impossible = np.flatnonzero(~servable_alone(problem.rates, link))
    if not len(impossible):
        return replace(_within_limits(SCHEMES[scheme], problem), runtime_s=time.monotonic() - started)
    keep = np.flatnonzero(servable_alone(problem.rates, link))
    reduced = replace(
        problem, positions=problem.positions[keep], rates=problem.rates[keep], weights=problem.weights[keep]
    )
    part = _within_limits(SCHEMES[scheme], reduced)
    reasons = {
        int(k): f"demands {problem.rates[k]:.6g} bit/s/Hz; the most that one UAV can give, from straight above"
        f" with all its power, is {link.max_rate:.6g}"
        for k in impossible
    }
    return _embed(part, keep, len(problem.rates), reasons, time.monotonic() - started)


def _within_limits(scheme: Scheme, problem: Problem) -> Deployment:
    """Run a scheme, and see to the limits of the real fleet that it knows nothing of."""
    from jpap_ros.planning.limits import limit_fleet
    from jpap_ros.planning.separation import keep_apart

    return keep_apart(problem, limit_fleet(problem, scheme(problem)))


def servable_alone(rates: ArrayLike, link: LinkBudget) -> np.ndarray:
    """Whether each demand [bit/s/Hz] can be met from straight above with all the power of one UAV."""
    # Room for rounding, less than `allocation.ZERO_RADIUS` grants: a demand of exactly `link.max_rate` can be met.
    possible: np.ndarray = snr_demand(rates) * link.altitude_m**2 <= link.power_eta * (1 + 5e-13)
    return possible


def _embed(part: Deployment, keep: np.ndarray, count: int, reasons: dict[int, str], runtime_s: float) -> Deployment:
    """Put a deployment of the devices `keep` back among all `count` devices."""
    serving = np.full(count, -1, dtype=np.int64)
    power, rate = np.zeros(count), np.zeros(count)
    serving[keep], power[keep], rate[keep] = part.serving_uav, part.power_w, part.rate
    unserved = reasons | {int(keep[k]): why for k, why in part.unserved.items()}
    return replace(
        part,
        serving_uav=serving,
        power_w=power,
        rate=rate,
        unserved=dict(sorted(unserved.items())),
        runtime_s=runtime_s,
    )


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


def _limit(name: str, value: int | None, least: int) -> int | None:
    return None if value is None else _whole(name, value, least, "a whole number or None")


def _whole(name: str, value: int, least: int, what: str = "a whole number") -> int:
    try:
        number = operator.index(value)
    except TypeError:
        raise ValueError(f"{name} must be {what}, got {value!r}") from None
    if number < least:
        raise ValueError(f"{name} must be >= {least}, got {value!r}")
    return number


def _float_array(name: str, value: ArrayLike) -> Floats:
    try:
        if np.iscomplexobj(value):
            raise TypeError("complex ones are not allowed")
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be an array of numbers: {error}") from None


def _vector(name: str, value: ArrayLike, count: int) -> Floats:
    array = _float_array(name, value)
    if array.shape != (count,):
        raise ValueError(f"{name} must have shape ({count},) to match positions, got {array.shape}")
    _require(name, array, np.isfinite(array) & (array > 0), "finite and > 0")
    return array


def _require(name: str, array: Floats, good: np.ndarray, what: str) -> None:
    if not good.all():
        index = tuple(int(i) for i in np.argwhere(~good)[0])
        subscript = ", ".join(map(str, index))
        raise ValueError(f"{name}[{subscript}] must be {what}, got {array[index]}")

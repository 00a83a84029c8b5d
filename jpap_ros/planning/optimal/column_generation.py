"""A lower bound on the fleet where the servable sets are too many to enumerate: column generation.

For any values pi_k >= 0 of the devices, if no servable set is worth more than M then every UAV serves at most M of
the total sum pi, so N >= sum pi / M (Farley's bound). The linear program over the sets found so far proposes pi,
pricing finds M and further sets.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator

import numpy as np

from jpap_ros.planning.optimal.milp import incidence, minimise
from jpap_ros.planning.optimal.pricing import RELATIVE_GAP, price
from jpap_ros.planning.optimal.servability import Ints, Servability

_NEW_SETS = 150
#: Share of the best values so far in the values that are priced; damps the swings of the linear program.
_SMOOTHING = 0.4


def bounds_by_columns(
    servability: Servability, sets: list[Ints], fleet: int, deadline: float
) -> Iterator[tuple[int, list[Ints]]]:
    """Yield ever better lower bounds on the fleet, and all sets found so far.

    Parameters
    ----------
    sets : list of int arrays
        Servable sets that cover the devices.
    fleet : int
        UAVs that are known to suffice: a bound as large is all there is to find.
    """
    count = len(servability)
    pool = {members.tobytes(): members for members in (np.sort(members) for members in sets)}
    best_bound, best_value = 0.0, np.zeros(count)
    while time.monotonic() < deadline:
        columns = list(pool.values())
        relaxed = minimise(
            np.ones(len(columns)), incidence(columns, count), np.ones(count), np.full(count, np.inf),
            integer=False, deadline=deadline,
        )  # fmt: skip
        if relaxed.duals is None:
            return
        value = np.maximum(relaxed.duals, 0)
        smooth = _SMOOTHING * best_value + (1 - _SMOOTHING) * value if best_bound else value
        # A tight bound is worth its time only where it can still raise the whole number.
        gain = math.ceil(relaxed.objective / (1 + RELATIVE_GAP) - 1e-6) > math.ceil(best_bound - 1e-6)
        news = 0
        for attempt in (smooth, value):
            found = price(servability, attempt, deadline, exact=gain)
            if found.bound > 0 and (bound := float(attempt.sum()) / found.bound) > best_bound:
                best_bound, best_value = bound, attempt / found.bound
            worth = np.array([value[members].sum() for members in found.sets])
            for i in np.argsort(-worth)[:_NEW_SETS]:
                if worth[i] > 1 + 1e-6 and found.sets[i].tobytes() not in pool:
                    pool[found.sets[i].tobytes()] = found.sets[i]
                    news += 1
            if news:
                break
        yield math.ceil(best_bound - 1e-6), list(pool.values())
        if not news or math.ceil(best_bound - 1e-6) >= fleet:
            return

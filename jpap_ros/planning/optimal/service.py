"""Which devices a fleet that is too small should serve: the most weight, then the most demanded rate."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from jpap_ros.planning.link_budget import Floats
from jpap_ros.planning.optimal.cover import without_overlap
from jpap_ros.planning.optimal.milp import incidence, minimise
from jpap_ros.planning.optimal.servability import Ints


def serve_most(members: list[Ints], weights: Floats, rates: Floats, uavs: int, deadline: float) -> list[Ints] | None:
    """At most `uavs` disjoint cells, each part of one of the sets, that serve the most.

    Parameters
    ----------
    members : list of int arrays
        Servable sets; the result is the best there is if all maximal ones are among them.
    weights, rates : (K,) float
        Priorities, and demands that decide between equals.

    Returns
    -------
    list of int arrays or None
        The cells; None where none were found in time.
    """
    count, sets = len(weights), len(members)
    # Columns: the sets, then the devices. A device is served only if one of its sets is flown.
    served = sparse.hstack([incidence(members, count), -sparse.eye_array(count)])
    fleet = sparse.csr_array(np.concatenate([np.ones(sets), np.zeros(count)])[None])
    scale = weights / weights.max()
    by_weight = np.concatenate([np.zeros(sets), -scale])
    by_rate = np.concatenate([np.zeros(sets), -rates])
    limits = sparse.csc_array(sparse.vstack([served, fleet]))
    lower = np.append(np.zeros(count), 0.0)
    upper = np.append(np.full(count, np.inf), uavs)
    first = minimise(by_weight, limits, lower, upper, integer=True, deadline=deadline)
    if first.x is None:
        return None
    weighed = sparse.csc_array(sparse.vstack([limits, -by_weight[None]]))
    second = minimise(
        by_rate, weighed, np.append(lower, -first.objective - 1e-7), np.append(upper, np.inf),
        integer=True, start=first.x, deadline=deadline,
    )  # fmt: skip
    best = first if second.x is None else second
    assert best.x is not None
    return without_overlap([members[i] for i in np.flatnonzero(best.x[:sets] > 0.5)], count)

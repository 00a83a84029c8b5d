"""Whether a plan made from scratch is worth flying for."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, fields

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from jpap_ros.planning.deployment import Deployment
from jpap_ros.planning.replanning import Change, compare
from jpap_ros.planning.replanning_continuity import OnAir
from jpap_ros.planning.replanning_state import Demands, Limits, LivePlan


@dataclass(frozen=True)
class ReplanningPolicy:
    """What a better plan is worth and what it costs to get there; the unit is one UAV saved.

    Attributes
    ----------
    uav_value : float
        Gain for each UAV saved.
    rate_value : float
        Gain for the average UAV rate becoming larger by its own size: 10 % more gives a tenth of this.
    unserved_value : float
        Gain for each unit of weight of devices that are served in addition.
    metre_cost : float
        Cost of each metre flown by all UAVs together.
    launch_cost : float
        Cost of each UAV to be launched for a new cell, and of each to be sent home.
    interruption_cost : float
        Cost of each unit of weight of devices whose guaranteed rate is interrupted on the way; as well as of those who
        are held by one UAV until another one has come, and of those who are kept waiting for that.
    tolerance : float
        What the gain must exceed the cost by: up to this much the plan in force is as good as a new one.
    """

    uav_value: float = 1.0
    rate_value: float = 1.0
    unserved_value: float = 2.0
    metre_cost: float = 0.0005
    launch_cost: float = 0.1
    interruption_cost: float = 0.1
    tolerance: float = 0.5

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            number = isinstance(value, (int, float)) and not isinstance(value, bool)
            if not number or not 0 <= value < math.inf:
                raise ValueError(f"{item.name} must be finite and >= 0, got {value!r}")


@dataclass(frozen=True, eq=False)
class Decision:
    """Whether to replace the plan in force.

    Attributes
    ----------
    adopt : bool
    change : Change
        From the plan in force to the new one, whose cells have the ids of those in force as far as they go.
    gain, cost : float
        By the policy; see `ReplanningPolicy`.
    reason : str
        Gain and cost in words.
    """

    adopt: bool
    change: Change
    gain: float
    cost: float
    reason: str


def consider(
    full: Deployment,
    present: LivePlan,
    demands: Demands,
    limits: Limits,
    policy: ReplanningPolicy = ReplanningPolicy(),
    lost_cells: Collection[int] = (),
    on_air: OnAir | None = None,
) -> Decision:
    """Weigh a plan made from scratch for the present devices against the plan in force.

    Parameters
    ----------
    full : Deployment
        What `solve` returned for `demands`.
    present : LivePlan
        The plan in force, made for the same devices (by `replan`).
    demands : Demands
    limits : Limits
    policy : ReplanningPolicy
    lost_cells : collection of int
        Cells of the plan in force without an aircraft; none of the new cells takes over from them.
    on_air : OnAir, optional
        What is transmitted now; if missing, every UAV is at its place in the plan in force.

    Returns
    -------
    Decision

    Notes
    -----
    The new plan's cells take over from those in force such that the sum of squared distances is least. A launch or a
    return is not counted in metres, since where the aircraft stands is not known here, but by `launch_cost`.
    """
    plan = _adopt_ids(full, present, demands, lost_cells)
    change = compare(present, plan, limits, on_air)
    saved = len(present.cells) - len(plan.cells)
    before, after = present.deployment(limits).average_uav_rate, full.average_uav_rate
    rate = after / before - 1 if present.cells and plan.cells else 0.0
    served = _weight(present.unserved, demands) - _weight(plan.unserved, demands)
    launches = len({cell.id for cell in plan.cells} - {cell.id for cell in present.cells})
    interrupted = _weight(sorted({*change.interrupted, *change.waits} - plan.unserved.keys()), demands)
    gain = policy.uav_value * saved + policy.rate_value * rate + policy.unserved_value * served
    cost = (
        policy.metre_cost * change.moved_m
        + policy.launch_cost * (launches + len(change.ended))
        + policy.interruption_cost * interrupted
    )
    adopt = gain - cost > policy.tolerance
    reason = (
        f"gain {gain:.3g} ({saved:+d} UAVs saved, rate {rate:+.1%}, served weight {served:+g}) against cost {cost:.3g}"
        f" ({change.moved_m:.0f} m flown, {launches} launched, {len(change.ended)} sent home, {interrupted:g} weight"
        f" interrupted, held or kept waiting) and tolerance {policy.tolerance:g}"
    )
    return Decision(adopt, change, gain, cost, reason)


def _adopt_ids(full: Deployment, present: LivePlan, demands: Demands, lost_cells: Collection[int]) -> LivePlan:
    heirs = [cell for cell in present.cells if cell.id not in lost_cells]
    count = len(full.uav_positions)
    distance = cdist(full.uav_positions, np.array([cell.position for cell in heirs]).reshape(-1, 2))
    rows, columns = linear_sum_assignment(distance**2)
    ids = {int(row): heirs[column].id for row, column in zip(rows, columns, strict=True)}
    next_id = present.next_id
    for cell in range(count):
        if cell not in ids:
            ids[cell] = next_id
            next_id += 1
    return LivePlan.of(full, demands, [ids[cell] for cell in range(count)], next_id)


def _weight(names: Collection[str], demands: Demands) -> float:
    return math.fsum(float(demands.weights[demands.index[name]]) for name in names if name in demands.index)

"""Between `TransitPlan` and its message."""

from __future__ import annotations

import math

import numpy as np
from geometry_msgs.msg import Point
from jpap_msgs.msg import Convoy as ConvoyMessage
from jpap_msgs.msg import HeldUav, Transition
from std_msgs.msg import Header

from jpap_ros.fleet.time_law import TimeLaw
from jpap_ros.fleet.transit_plan import Convoy, TransitPlan


def transition_message(
    plan: TransitPlan, header: Header, plan_id: int, number: int, min_separation_m: float
) -> Transition:
    """Message of a transit plan; see Transition.msg for the fields."""
    return Transition(
        header=header,
        plan_id=plan_id,
        number=number,
        min_separation_m=min_separation_m,
        convoys=[
            ConvoyMessage(
                uavs=list(convoy.names),
                waypoints=[Point(x=x, y=y, z=z) for row in convoy.waypoints.tolist() for x, y, z in row],
                speed=[law.speed for law in convoy.laws],
                acceleration=[law.acceleration for law in convoy.laws],
                initial_speed=[law.initial_speed for law in convoy.laws],
            )
            for convoy in plan.convoys
        ],
        held=[HeldUav(uav=uav, reason=reason) for uav, reason in sorted(plan.held.items())],
    )


def transit_plan(message: Transition) -> TransitPlan:
    """Transit plan of a message; ValueError that names the field if it cannot be flown."""
    convoys = tuple(_convoy(f"convoys[{i}]", convoy) for i, convoy in enumerate(message.convoys))
    names = [name for convoy in convoys for name in convoy.names]
    if len(set(names)) < len(names):
        raise ValueError(f"convoys name an aircraft twice: {sorted(names)}")
    return TransitPlan(convoys, {held.uav: held.reason for held in message.held})


def _convoy(where: str, message: ConvoyMessage) -> Convoy:
    names, legs = tuple(message.uavs), len(message.speed)
    if not names:
        raise ValueError(f"{where}.uavs is empty")
    if not len(message.acceleration) == len(message.initial_speed) == legs:
        raise ValueError(f"{where}: speed, acceleration and initial_speed must have one value for each leg")
    if len(message.waypoints) != (legs + 1) * len(names):
        raise ValueError(
            f"{where}.waypoints must have {(legs + 1) * len(names)} points for {legs} legs of {len(names)} aircraft,"
            f" got {len(message.waypoints)}"
        )
    waypoints = np.array([(p.x, p.y, p.z) for p in message.waypoints]).reshape(legs + 1, len(names), 3)
    if not np.isfinite(waypoints).all():
        raise ValueError(f"{where}.waypoints must be finite")
    laws = []
    for leg, figures in enumerate(zip(message.speed, message.acceleration, message.initial_speed, strict=True)):
        speed, acceleration, initial = figures
        if not (all(map(math.isfinite, figures)) and speed > 0 and acceleration > 0 and initial >= 0):
            raise ValueError(f"{where}: leg {leg} has an impossible time law {figures}")
        laws.append(TimeLaw(speed, acceleration, initial))
    return Convoy(names, waypoints, tuple(laws))

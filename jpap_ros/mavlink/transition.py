"""A transition under way: the moving setpoint of every aircraft in it, and the brake if one of them drops out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from jpap_ros.fleet.transit_plan import Convoy, TransitPlan

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class MovingPoint:
    """Where an aircraft should be now.

    Attributes
    ----------
    position_m, velocity_m_s : (east, north, up)
        [m] and [m/s]; the velocity is zero at rest.
    arrived : bool
        The setpoint has come to the end of its path.
    """

    position_m: Vector
    velocity_m_s: Vector
    arrived: bool


class _Leader:
    """The clock of one convoy."""

    def __init__(self, convoy: Convoy, started: float) -> None:
        self.convoy = convoy
        self.started = started
        self.stopped_because = ""

    def brake(self, now: float, why: str) -> None:
        self.convoy = self.convoy.stop(now - self.started)
        self.started = now
        self.stopped_because = why


class Transition:
    """A transit plan with a running clock for each of its convoys.

    Parameters
    ----------
    plan : TransitPlan
    plan_id : int
        Deployment whose goals it leads to.
    started : float
        Local clock at its start [s].

    Notes
    -----
    The members of a convoy keep apart only as long as each follows its setpoint. So when one does not, because a pilot
    took it or its link is lost, all of its convoy slow down at once on the path that was checked, and hold. Other
    convoys go on: their paths do not come near.
    """

    def __init__(self, plan: TransitPlan, plan_id: int, started: float) -> None:
        self.plan_id = plan_id
        self._leaders = {name: leader for c in plan.convoys for leader in [_Leader(c, started)] for name in c.names}
        self._held = dict(plan.held)

    def __contains__(self, name: str) -> bool:
        return name in self._leaders

    def point(self, name: str, now: float) -> MovingPoint:
        """Moving setpoint of an aircraft; KeyError if it has no part in the transition."""
        leader = self._leaders[name]
        elapsed = now - leader.started
        index = leader.convoy.names.index(name)
        positions, velocities = leader.convoy.at(elapsed)
        east, north, up = map(float, positions[index])
        ve, vn, vu = map(float, velocities[index])
        return MovingPoint((east, north, up), (ve, vn, vu), elapsed >= leader.convoy.duration_s)

    def stopped(self, name: str) -> str:
        """Why an aircraft's path ends short of its goal; empty if it does not."""
        leader = self._leaders.get(name)
        return self._held.get(name, "") or (leader.stopped_because if leader else "")

    def watch(self, follows: Callable[[str], bool], now: float) -> None:
        """Stop every moving convoy of which a member does not follow its setpoint."""
        for leader in dict.fromkeys(self._leaders.values()):
            if leader.stopped_because or now - leader.started >= leader.convoy.duration_s:
                continue
            lost = [name for name in leader.convoy.names if not follows(name)]
            if lost:
                leader.brake(now, f"the transition was stopped: {', '.join(lost)} dropped out")

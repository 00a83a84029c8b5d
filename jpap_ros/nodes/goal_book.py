"""Which goal is in force for each aircraft, and which plan it belongs to, from two topics in any order."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from jpap_ros.mavlink.goals import Goal

#: Seconds and nanoseconds of a message's stamp.
Stamp = tuple[int, int]


@dataclass(frozen=True)
class Entry:
    """What an aircraft should do: fly to a goal, or hold because of something."""

    goal: Goal | None
    reason: str = ""


class GoalBook:
    """Joins `goal_pose` and `deployment` by their stamps.

    Notes
    -----
    A goal belongs to the deployment that has its stamp. A goal older than the deployment is withdrawn if the
    deployment has no cell for the aircraft; if it has one, the goal is kept until the new one comes. A goal newer
    than the deployment is flown at once, with plan id 0 until its deployment comes.
    """

    def __init__(self) -> None:
        self._goals: dict[str, tuple[Stamp, Goal]] = {}
        self._plan: tuple[Stamp, int, frozenset[str]] | None = None

    def put_goal(self, uav: str, stamp: Stamp, goal: Goal) -> None:
        """Take a goal."""
        self._goals[uav] = stamp, goal

    def drop_goal(self, uav: str) -> None:
        """Forget a goal: what came last for this aircraft could not be read."""
        self._goals.pop(uav, None)

    def put_plan(self, stamp: Stamp, plan_id: int, uavs: Iterable[str]) -> None:
        """Take a deployment: its id and the aircraft that have a cell in it."""
        self._plan = stamp, plan_id, frozenset(uavs)

    def entry(self, uav: str) -> Entry | None:
        """What an aircraft should do now; None if it never had a readable goal."""
        if uav not in self._goals:
            return None
        stamp, goal = self._goals[uav]
        if self._plan is None or stamp > self._plan[0]:
            return Entry(goal)
        plan_stamp, plan_id, uavs = self._plan
        if stamp == plan_stamp:
            # Kept with the goal: it still says so when the next deployment is here and its goal is not.
            goal = replace(goal, plan_id=plan_id)
            self._goals[uav] = stamp, goal
            return Entry(goal)
        if uav in uavs:
            return Entry(goal)
        return Entry(None, f"no cell in plan {plan_id}")

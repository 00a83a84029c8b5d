"""A recording cut into steps: what was told to the planner, and the plan that it answered with."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

from jpap_ros.report.flight_reader import DEPLOYMENT, DEVICES, GEO_DEVICES, STATE
from jpap_ros.report.recording import Recording, Told

#: Plans whose goals are nearer than this are the same [m]; so for power [W].
TOLERANCE = 1e-6


def is_planners(topic: str, type_name: str) -> bool:
    """Whether a message goes into the planner or is its answer."""
    return type_name in (DEPLOYMENT, STATE, DEVICES, GEO_DEVICES)


@dataclass(frozen=True)
class Step:
    """Messages that were sent before the planner began to make a plan, after those of the step before.

    Attributes
    ----------
    inputs : tuple of Told
        In the order of sending.
    plan : object or None
        The Deployment; None for what came after the last one.
    """

    inputs: tuple[Told, ...]
    plan: Any


def namespace_of(recording: Recording) -> str:
    """Return the planner's namespace with a slash at its end.

    Raises
    ------
    ValueError
        If there is not exactly one planner in the recording.
    """
    topics = sorted({item.topic for item in recording.told if item.type_name == DEPLOYMENT})
    if len(topics) != 1:
        raise ValueError(f"the recording must have one planner's deployments, it has {', '.join(topics) or 'none'}")
    return topics[0].removesuffix("deployment")


def steps_of(recording: Recording) -> list[Step]:
    """Cut a recording into steps.

    Notes
    -----
    Planning began `planning_time` before a deployment was sent. A report that was sent before, but hardly so, may
    have come too late for it: one that names a device which the deployment does not know belongs to the next step.
    """
    prefix = namespace_of(recording)
    told = sorted((item for item in recording.told if item.topic.startswith(prefix)), key=lambda item: item.sent_s)
    waiting = [item for item in told if item.type_name != DEPLOYMENT]
    steps = []
    for item in told:
        if item.type_name != DEPLOYMENT:
            continue
        plan = item.message
        began_s = item.sent_s - plan.planning_time.sec - 1e-9 * plan.planning_time.nanosec
        known = {name for cell in plan.cells for name in cell.device_ids} | {entry.id for entry in plan.unserved}
        count = 0
        while count < len(waiting) and waiting[count].sent_s <= began_s and not _is_news(waiting[count:], known):
            count += 1
        steps.append(Step(tuple(waiting[:count]), plan))
        waiting = waiting[count:]
    return [*steps, Step(tuple(waiting), None)] if waiting else steps


def _is_news(items: Sequence[Told], known: set[str]) -> bool:
    """Whether the first message names a device that a plan does not know and that no later one takes away."""
    first, *later = items
    if first.type_name == STATE:
        return False
    gone = {name for item in later if item.type_name != STATE for name in item.message.departed}
    return any(device.id not in known and device.id not in gone for device in first.message.devices)


def state_rounds(inputs: Iterable[Told]) -> list[list[Told]]:
    """Return what of the states the planner must be told, in rounds with at most one state of each aircraft.

    The last state of each, which is what the planner goes by, and before it those in which its link or its being in
    the air changed: what was lost and came back is an event all the same.
    """
    told: dict[str, list[Told]] = {}
    for item in inputs:
        if item.type_name == STATE:
            kept = told.setdefault(item.topic, [])
            if kept and _condition(kept[-1]) == _condition(item):
                kept[-1] = item
            else:
                kept.append(item)
    rounds = zip_longest(*told.values())
    return [[item for item in entries if item is not None] for entries in rounds]


def _condition(item: Told) -> tuple[int, int]:
    return item.message.link, item.message.landed_state


def differences(recorded: Any, made: Any) -> list[str]:
    """Say in words how a plan differs from the recorded one; nothing if it is the same.

    Plans are the same if they serve the same devices together, from goals and with powers that differ by no more than
    `TOLERANCE`, by the same aircraft, and leave out the same devices.
    """
    found = []
    before, after = _cells(recorded), _cells(made)
    for devices in before.keys() ^ after.keys():
        which = "has no more" if devices in before else "has a new"
        found.append(f"{which} cell of {', '.join(sorted(devices))}")
    for devices in before.keys() & after.keys():
        old, new = before[devices], after[devices]
        distance = math.dist(_goal(old), _goal(new))
        where = f"the cell of {', '.join(sorted(devices))}"
        if distance > TOLERANCE:
            found.append(f"{where} is {distance:.3g} m away")
        if any(abs(a - b) > TOLERANCE for a, b in zip(_powers(old), _powers(new), strict=True)):
            found.append(f"{where} has other powers")
        if old.uav != new.uav:
            found.append(f"{where} is flown by {new.uav or 'nobody'} instead of {old.uav or 'nobody'}")
    if left_out := {item.id for item in recorded.unserved} ^ {item.id for item in made.unserved}:
        found.append(f"served in one of them only: {', '.join(sorted(left_out))}")
    return found


def _cells(plan: Any) -> dict[frozenset[str], Any]:
    return {frozenset(cell.device_ids): cell for cell in plan.cells}


def _goal(cell: Any) -> tuple[float, float, float]:
    point = cell.goal_pose.position
    return point.x, point.y, point.z


def _powers(cell: Any) -> list[float]:
    return [power for _, power in sorted(zip(cell.device_ids, cell.power_w, strict=True))]

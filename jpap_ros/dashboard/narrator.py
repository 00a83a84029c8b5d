"""What is worth a line in the event log: the difference between what was known before and now, in words."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from jpap_ros.dashboard.event_log import ERROR, INFO, WARNING
from jpap_ros.dashboard.records import ERROR as ERROR_LEVEL
from jpap_ros.dashboard.records import OK, Plan, Status, Vehicle, count

#: Items named in one line; the rest is counted.
_NAMED = 5

#: States of a goal that is not flown.
TROUBLED_GOALS = ("rejected", "yielded", "lost")

Line = tuple[str, str]


def vehicle_lines(name: str, before: Vehicle | None, now: Vehicle) -> list[Line]:
    """Level and text for each change of an aircraft that an operator would want to look up later.

    Of an aircraft heard of for the first time only what is wrong with it is news.
    """
    if before is None:
        before = Vehicle("connected" if now.link == "lost" else now.link)
    lines = []
    if before.link != now.link:
        lines.append((ERROR if now.link == "lost" else INFO, f"{name}: link {now.link}"))
    if before.goal != now.goal or (before.reason != now.reason and now.goal in TROUBLED_GOALS):
        because = f": {now.reason}" if now.reason else ""
        if now.taken_over:
            lines.append((WARNING, f"{name} was taken over{because}"))
        elif now.goal == "yielded":
            lines.append((INFO, f"{name} {now.reason}"))
        elif now.goal in ("rejected", "lost"):
            lines.append((ERROR, f"{name}: goal {now.goal}{because}"))
        elif before.goal in TROUBLED_GOALS:
            lines.append((INFO, f"{name}: goal {now.goal}{because}, was {before.goal}"))
    if before.landed != now.landed and now.landed in ("in air", "on ground") and before.landed != "undefined":
        lines.append((INFO, f"{name} is {'in the air' if now.landed == 'in air' else 'on the ground'}"))
    if now.emergency and not before.emergency:
        lines.append((ERROR, f"{name}: the autopilot reports an emergency (mode {now.mode or 'unknown'})"))
    if now.battery_low and not before.battery_low:
        left = "" if now.battery is None else f", {100 * now.battery:.0f} % left"
        lines.append((WARNING, f"{name}: battery low{left}"))
    return lines


def plan_lines(before: Plan | None, now: Plan) -> list[Line]:
    """Why the planner planned, what came of it, and who is left out now that was not before."""
    devices = count(now.planned + len(now.left_out), "device")
    text = (
        f"Plan {now.id} because {now.reason or 'of an event'}: {now.proof()}; {now.planned} of {devices} to be served"
    )
    lines = [(INFO, f"{text}; planned in {1e3 * now.planning_s:.0f} ms ({now.scheme})")]
    known = before.left_out if before is not None else {}
    new = [f"{device}: {why}" for device, why in now.left_out.items() if known.get(device) != why]
    if new:
        lines.append((WARNING, f"Plan {now.id} leaves out {_listed(new)}"))
    interrupted = [device for device in now.interrupted if before is None or device not in before.interrupted]
    if interrupted:
        lines.append((WARNING, f"Plan {now.id} interrupts on the way: {_listed(interrupted)}"))
    return lines


def status_line(before: Status | None, now: Status) -> Line | None:
    """Return a line where a node's own report got worse, better or speaks of something else; None if it did not.

    Numbers alone do not make it something else: a rate in a message changes every second.
    """
    level_before = before.level if before is not None else OK
    same_words = before is not None and _without_numbers(before.message) == _without_numbers(now.message)
    if now.level == level_before and (now.level == OK or same_words):
        return None
    text = f"{now.node} {now.part}: {now.message}"
    if now.level == OK:
        return INFO, f"{text} (was {'an error' if level_before == ERROR_LEVEL else 'a warning'})"
    return (ERROR if now.level == ERROR_LEVEL else WARNING), text


def device_lines(changes: Mapping[str, Iterable[str]]) -> list[Line]:
    """One line for what a report changed, e.g. `2 devices joined: a, b`; `changes` has ids by event."""
    parts = [
        f"{count(len(ids), 'device')} {event}: {_listed(ids)}"
        for event, ids in ((event, list(ids)) for event, ids in changes.items())
        if ids
    ]
    return [(INFO, "; ".join(parts))] if parts else []


def _listed(items: Iterable[str]) -> str:
    texts = list(items)
    more = len(texts) - _NAMED
    return ", ".join(texts[:_NAMED]) + (f" and {more} more" if more > 0 else "")


def _without_numbers(text: str) -> str:
    return re.sub(r"[-+]?\d[\d.,e+-]*", "#", text)

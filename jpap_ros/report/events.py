"""Everything that happened, line by line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from jpap_ros.report.flight import Flight
from jpap_ros.report.motion import metres_by_plan

_LINKS = ("never seen", "connected", "lost")
_LANDED = ("landed state unknown", "on the ground", "in the air", "taking off", "landing")
_GOALS = ("no goal", "goal sent", "goal accepted", "on its way", "goal reached", "goal refused", "taken over", "lost")
#: Of a diagnostic status: OK, WARN, ERROR, STALE.
_LEVELS = ("ok", "warning", "error", "warning")
_LOG_ERROR = 40
_GOAL_TROUBLE = (5, 6, 7)
_LINK_LOST = 2


@dataclass(frozen=True)
class Event:
    """One line of the table.

    Attributes
    ----------
    at_s : float
    kind : str
        `plan`, `device`, `aircraft`, `diagnostic` or `log`.
    source : str
    text : str
    level : str
        `ok`, `warning` or `error`.
    """

    at_s: float
    kind: str
    source: str
    text: str
    level: str = "ok"


def events(flight: Flight) -> list[Event]:
    """Return all events in the order of their times."""
    found = [
        *(Event(change.at_s, "device", "", change.what) for change in flight.changes),
        *_plans(flight),
        *_aircraft(flight),
        *_diagnostics(flight),
        *_log(flight),
    ]
    return sorted(found, key=lambda event: event.at_s)


def _plans(flight: Flight) -> list[Event]:
    found = []
    for plan, metres in zip(flight.plans, metres_by_plan(flight), strict=True):
        message = plan.message
        served = sum(len(cell.device_ids) for cell in message.cells)
        text = (
            f"{message.reason or 'no reason told'}: {len(message.cells)} UAVs for {served} devices, {proof(message)}; "
            f"planned in {1000 * plan.planning_s:.1f} ms; {metres:.0f} m flown under it"
        )
        if message.unserved:
            text += "; not served: " + "; ".join(f"{item.id}: {item.reason}" for item in message.unserved[:5])
            text += f"; and {len(message.unserved) - 5} more" if len(message.unserved) > 5 else ""
        level = "warning" if message.unserved else "ok"
        found.append(Event(plan.at_s, "plan", f"plan {message.plan_id}", text, level))
    return found


def proof(message: Any) -> str:
    """What is proven of a deployment's number of UAVs, in words."""
    if message.proven_optimal:
        return (
            "proven minimum" if message.uavs_needed == len(message.cells) else f"{message.uavs_needed} needed, proven"
        )
    if message.min_uavs_bound >= 0:
        return f"at least {message.min_uavs_bound} proven"
    return "no bound proven"


def _aircraft(flight: Flight) -> list[Event]:
    found = []
    for name, track in flight.tracks.items():
        before = None
        for at_s, state in track.states:
            changes, level = [], "ok"
            if before is None or state.link != before.link:
                changes.append(f"link {_word(_LINKS, state.link)}")
                level = "error" if state.link == _LINK_LOST else level
            if before is not None:
                if state.mode != before.mode:
                    changes.append(f"mode {state.mode or 'unknown'}")
                if state.armed != before.armed:
                    changes.append("armed" if state.armed else "disarmed")
                if state.landed_state != before.landed_state:
                    changes.append(_word(_LANDED, state.landed_state))
                if state.goal_state != before.goal_state:
                    reason = f" ({state.goal_reason})" if state.goal_reason else ""
                    changes.append(_word(_GOALS, state.goal_state) + reason)
                    if state.goal_state in _GOAL_TROUBLE and level == "ok":
                        level = "warning"
            if changes:
                found.append(Event(at_s, "aircraft", name, ", ".join(changes), level))
            before = state
    return found


def _word(words: tuple[str, ...], value: int) -> str:
    return words[value] if value < len(words) else f"state {value}"


def _diagnostics(flight: Flight) -> list[Event]:
    return [
        Event(at_s, "diagnostic", name, message if level else f"all right again: {message}", _LEVELS[min(level, 3)])
        for at_s, name, level, message in flight.diagnostics
    ]


def _log(flight: Flight) -> list[Event]:
    return [
        Event(at_s, "log", line.name, line.msg, "error" if line.level >= _LOG_ERROR else "warning")
        for at_s, line in flight.log
    ]

"""How each aircraft and its link are, as diagnostic statuses that say what to do."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from jpap_ros.mavlink.goals import GoalState
from jpap_ros.mavlink.snapshot import AircraftSnapshot
from jpap_ros.mavlink.vehicle import LinkState


def aircraft_status(node: str, snapshot: AircraftSnapshot) -> DiagnosticStatus:
    """Return the status: ERROR where an aircraft is lost or not served, WARN where something asks for attention."""
    level, message = _verdict(snapshot)
    figures = {
        "link": snapshot.link.name.lower().replace("_", " "),
        "autopilot": snapshot.autopilot or "unknown",
        "mode": snapshot.mode or "unknown",
        "armed": snapshot.armed,
        "goal": snapshot.goal_state.name.lower().replace("_", " "),
        "goal reason": snapshot.goal_reason,
        "goal distance [m]": f"{snapshot.goal_distance_m:.2f}",
        "plan id": snapshot.goal_plan_id,
        "battery [%]": f"{100 * snapshot.battery.remaining:.0f}",
        "reboots": snapshot.reboots,
    }
    return DiagnosticStatus(
        level=level,
        name=f"{node}: {snapshot.name}",
        hardware_id=f"MAVLink system {snapshot.sysid}",
        message=message,
        values=[KeyValue(key=key, value=str(value)) for key, value in figures.items()],
    )


def _verdict(snapshot: AircraftSnapshot) -> tuple[bytes, str]:
    if snapshot.link is LinkState.LOST:
        return DiagnosticStatus.ERROR, "link lost"
    if snapshot.problems:
        return DiagnosticStatus.ERROR, "; ".join(snapshot.problems)
    if snapshot.link is LinkState.NEVER_SEEN:
        return DiagnosticStatus.WARN, "never heard"
    if snapshot.goal_state in (GoalState.REJECTED, GoalState.YIELDED, GoalState.LOST):
        return DiagnosticStatus.WARN, f"goal {snapshot.goal_state.name.lower()}: {snapshot.goal_reason}"
    return DiagnosticStatus.OK, snapshot.goal_reason or f"goal {snapshot.goal_state.name.lower().replace('_', ' ')}"

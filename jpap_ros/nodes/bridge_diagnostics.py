"""How each aircraft and its link are, as diagnostic statuses that say what to do."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from jpap_ros.mavlink.goals import GoalState
from jpap_ros.mavlink.link_report import LinkReport
from jpap_ros.mavlink.snapshot import AircraftSnapshot
from jpap_ros.mavlink.tlog import TlogFolder
from jpap_ros.mavlink.vehicle import LinkState

#: Share of messages lost from which a link asks for attention.
WORRYING_LOSS = 0.2
#: Share of its byte budget from which a link asks for attention.
WORRYING_USE = 1.1


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


def link_status(node: str, report: LinkReport) -> DiagnosticStatus:
    """Return the status: ERROR while frames with a wrong key arrive, WARN where a link is down, poor or overfull."""
    level, message = _link_verdict(report)
    figures = {
        "peers": report.peers,
        "signed": report.signed,
        "received [1/s]": f"{report.received_per_s:.1f}",
        "sent [1/s]": f"{report.sent_per_s:.1f}",
        "received [byte/s]": f"{report.received_bytes_per_s:.0f}",
        "sent [byte/s]": f"{report.sent_bytes_per_s:.0f}",
        "budget [byte/s]": "none" if report.max_bytes_per_s is None else f"{report.max_bytes_per_s:.0f}",
        "loss [%]": f"{100 * report.loss:.1f}",
        "frames dropped": report.dropped,
        "frames over budget": report.over_budget,
        "bad frames": report.bad_frames,
        "bytes skipped": report.skipped_bytes,
        "reconnects": report.reconnects,
        "unsigned frames refused": report.unsigned,
        "badly signed frames refused": report.badly_signed,
        "replayed frames refused": report.replayed,
    }
    figures |= {
        f"loss of {system}/{component} [%]": f"{100 * loss:.1f}" for system, component, loss in report.source_loss
    }
    return DiagnosticStatus(
        level=level,
        name=f"{node}: link {report.url}",
        hardware_id=report.url,
        message=message,
        values=[KeyValue(key=key, value=str(value)) for key, value in figures.items()],
    )


def tlog_status(node: str, tlog: TlogFolder) -> DiagnosticStatus:
    """Return the status: WARN while telemetry logs cannot be written."""
    return DiagnosticStatus(
        level=DiagnosticStatus.WARN if tlog.problem else DiagnosticStatus.OK,
        name=f"{node}: telemetry log",
        hardware_id=str(tlog.folder),
        message=f"{tlog.problem}; make room, logging goes on by itself" if tlog.problem else "written",
        values=[KeyValue(key="frames left out", value=str(tlog.lost))],
    )


def _link_verdict(report: LinkReport) -> tuple[bytes, str]:
    if report.refused_per_s > 0.0:
        return DiagnosticStatus.ERROR, (
            f"{report.refused_per_s:.1f} frames/s refused: unsigned, signed with another key, or replayed; "
            "check the key on the other side, or somebody else is sending"
        )
    if not report.up or report.problem:
        return DiagnosticStatus.WARN, report.problem or "down"
    if report.loss >= WORRYING_LOSS:
        return DiagnosticStatus.WARN, f"{100 * report.loss:.0f} % of messages lost"
    used = report.received_bytes_per_s + report.sent_bytes_per_s
    if report.max_bytes_per_s is not None and used > WORRYING_USE * report.max_bytes_per_s:
        return DiagnosticStatus.WARN, f"{used:.0f} of {report.max_bytes_per_s:.0f} byte/s used"
    return DiagnosticStatus.OK, "up" if report.peers else "up, nobody heard"


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

"""How each aircraft and its link are, as diagnostic statuses that say what to do."""

from __future__ import annotations

from collections.abc import Iterable

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from jpap_ros.mavlink.goals import GoalState
from jpap_ros.mavlink.link_report import LinkReport
from jpap_ros.mavlink.snapshot import AircraftSnapshot
from jpap_ros.mavlink.tlog import TlogFolder
from jpap_ros.mavlink.vehicle import AUTOPILOT_COMPONENT, LinkState
from jpap_ros.nodes.battery import is_critical, is_low
from jpap_ros.nodes.diagnostics import status_name

#: Share of messages lost from which a link asks for attention.
WORRYING_LOSS = 0.2
#: Share of its byte budget from which a link asks for attention.
WORRYING_USE = 1.1


def aircraft_status(
    node: str, snapshot: AircraftSnapshot, reports: Iterable[LinkReport], now_s: float
) -> DiagnosticStatus:
    """Return the status of one aircraft, with a message that says what to do.

    STALE while it was never heard; ERROR where it is lost, not served, or its battery is critical; WARN where its goal
    is not flown, its battery is low, or too much of what it sends is lost on every link that it has.

    Parameters
    ----------
    node : str
        Full name of the bridge.
    snapshot : AircraftSnapshot
    reports : iterable of LinkReport
        Of all links.
    now_s : float
        Monotonic time [s].
    """
    age_s = now_s - snapshot.heartbeat_at
    losses = {
        report.url: loss
        for report in reports
        for system, component, loss in report.source_loss
        if (system, component) == (snapshot.sysid, AUTOPILOT_COMPONENT)
    }
    level, message = _verdict(snapshot, age_s, min(losses.values(), default=0.0))
    figures = {
        "link": snapshot.link.name.lower().replace("_", " "),
        "heartbeat age [s]": f"{age_s:.1f}",
        "autopilot": snapshot.autopilot or "unknown",
        "mode": snapshot.mode or "unknown",
        "armed": snapshot.armed,
        "goal": snapshot.goal_state.name.lower().replace("_", " "),
        "goal reason": snapshot.goal_reason,
        "goal distance [m]": f"{snapshot.goal_distance_m:.2f}",
        "plan id": snapshot.goal_plan_id,
        "setpoints sent [1/s]": f"{snapshot.setpoint_rate_hz if snapshot.link is LinkState.CONNECTED else 0.0:.1f}",
        "battery [%]": f"{100 * snapshot.battery.remaining:.0f}",
        "battery [V]": f"{snapshot.battery.voltage_v:.2f}",
        "reboots": snapshot.reboots,
    }
    figures |= {f"loss on {url} [%]": f"{100 * loss:.1f}" for url, loss in losses.items()}
    return DiagnosticStatus(
        level=level,
        name=status_name(node, snapshot.name),
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
        name=status_name(node, f"link {report.url}"),
        hardware_id=report.url,
        message=message,
        values=[KeyValue(key=key, value=str(value)) for key, value in figures.items()],
    )


def tlog_status(node: str, tlog: TlogFolder) -> DiagnosticStatus:
    """Return the status: WARN while telemetry logs cannot be written."""
    return DiagnosticStatus(
        level=DiagnosticStatus.WARN if tlog.problem else DiagnosticStatus.OK,
        name=status_name(node, "telemetry log"),
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
        return DiagnosticStatus.WARN, f"{report.problem or 'down'}: check the other end; it is tried again and again"
    if report.loss >= WORRYING_LOSS:
        return DiagnosticStatus.WARN, f"{100 * report.loss:.0f} % of messages lost: check antennas and range"
    used = report.received_bytes_per_s + report.sent_bytes_per_s
    if report.max_bytes_per_s is not None and used > WORRYING_USE * report.max_bytes_per_s:
        return DiagnosticStatus.WARN, (
            f"{used:.0f} of {report.max_bytes_per_s:.0f} byte/s used: ask for slower streams on the other side, "
            "or raise max_bytes_per_s in the fleet file if the radio can do more"
        )
    return DiagnosticStatus.OK, "up" if report.peers else "up, nobody heard"


def _verdict(snapshot: AircraftSnapshot, age_s: float, loss: float) -> tuple[bytes, str]:
    if snapshot.link is LinkState.LOST:
        silence = f"not heard for {age_s:.0f} s: check its power and its radio; it is left to its own failsafe"
        # One whose system id is contested is not listened to either: the reason comes first.
        return DiagnosticStatus.ERROR, "; ".join((*snapshot.problems, silence))
    if snapshot.problems:
        return DiagnosticStatus.ERROR, "; ".join(snapshot.problems)
    if snapshot.link is LinkState.NEVER_SEEN:
        return DiagnosticStatus.STALE, (
            f"never heard: check its power, and its url and sysid {snapshot.sysid} in the fleet file"
        )
    battery = snapshot.battery.remaining, snapshot.battery.charge_state
    if is_critical(*battery):
        return DiagnosticStatus.ERROR, "battery critical: call bridge/return_home or bridge/land for it"
    if snapshot.goal_state is GoalState.YIELDED:
        return DiagnosticStatus.WARN, f"goal yielded: {snapshot.goal_reason}; bridge/launch gives it back"
    if snapshot.goal_state in (GoalState.REJECTED, GoalState.LOST):
        return DiagnosticStatus.WARN, (
            f"goal {snapshot.goal_state.name.lower()}: {snapshot.goal_reason}; "
            "mend that, then call bridge/launch for it, or planner/replan for another goal"
        )
    if is_low(*battery):
        return DiagnosticStatus.WARN, "battery low: have another aircraft ready to relieve it"
    if loss >= WORRYING_LOSS:
        return DiagnosticStatus.WARN, f"{100 * loss:.0f} % of its messages lost: check its antenna and range"
    return DiagnosticStatus.OK, snapshot.goal_reason or f"goal {snapshot.goal_state.name.lower().replace('_', ' ')}"

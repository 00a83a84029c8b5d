"""How recording goes, as a diagnostic status that says what to do."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from jpap_ros.nodes.diagnostics import hardware_of, status_name
from jpap_ros.nodes.recorder_writer import WriterReport


def recording_status(node: str, fleet_file: str, report: WriterReport, topics: int, dropping: bool) -> DiagnosticStatus:
    """Return the status: ERROR while nothing is recorded, WARN while a slow disk costs messages."""
    if report.problem:
        level, message = DiagnosticStatus.ERROR, f"not recording: {report.problem}; make room, it goes on by itself"
    elif dropping:
        level, message = DiagnosticStatus.WARN, "the disk is too slow: messages are dropped; record fewer topics"
    else:
        level, message = DiagnosticStatus.OK, f"recording to {report.path}"
    figures = {
        "file": report.path or "none",
        "topics": topics,
        "messages": report.messages,
        "bytes": report.bytes,
        "messages dropped": report.dropped,
        "messages lost": report.lost,
        "bytes waiting": report.pending_bytes,
    }
    return DiagnosticStatus(
        level=level,
        name=status_name(node, "recording"),
        hardware_id=hardware_of(fleet_file),
        message=message,
        values=[KeyValue(key=key, value=str(value)) for key, value in figures.items()],
    )

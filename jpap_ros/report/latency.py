"""How long planning took, and how long a device waited for the plan that answers its report."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass

from jpap_ros.report.flight import Flight


@dataclass(frozen=True)
class Answer:
    """A device report that changed something, and the plan that answers it.

    Attributes
    ----------
    at_s : float
        When the report was sent [s].
    what : str
        What it changed.
    plan_id : int
    latency_s : float
        From the report to the plan's publication [s].
    """

    at_s: float
    what: str
    plan_id: int
    latency_s: float


def answers(flight: Flight) -> list[Answer]:
    """Pair each report with the first plan whose planning began after it; reports that no plan answers are left out."""
    begins = [plan.began_s for plan in flight.plans]
    found = []
    for change in flight.changes:
        index = bisect_left(begins, change.at_s)
        if change.reported and index < len(begins):
            plan = flight.plans[index]
            found.append(Answer(change.at_s, change.what, plan.message.plan_id, plan.at_s - change.at_s))
    return found

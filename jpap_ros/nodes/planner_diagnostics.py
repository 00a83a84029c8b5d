"""How the planner is doing, as a diagnostic status whose level asks for the operator's attention when it should."""

from __future__ import annotations

import math
from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from jpap_ros.fleet.cells import FleetPlan


@dataclass
class PlannerHealth:
    """What the planner knows of itself.

    Attributes
    ----------
    active : bool
        Lifecycle state.
    plan : FleetPlan or None
        The plan in force.
    plan_id : int
    plan_made_s : float
        When the plan in force was published, monotonic [s].
    planning_s : float
        Time that planning took [s].
    latency_s : float
        From the first event that the plan answers to its publication [s].
    pending : bool
        Whether events wait for a plan, or one is being made.
    failure : str
        What went wrong when planning last; empty after a success.
    devices : int
        Devices in the table.
    ignored : int
        Devices whose newest report is wrong.
    faults : int
        Wrong reports so far.
    available, fleet : int
        UAVs that can take a cell, and all.
    relief_problem : str
        Why no aircraft could be relieved, and what to do about it; empty where they can be.
    bridge_silent_s : float
        How long no aircraft's state has come [s]; 0 if the bridge is well, or nobody has ever heard of one.
    """

    active: bool = False
    plan: FleetPlan | None = None
    plan_id: int = 0
    plan_made_s: float = math.nan
    planning_s: float = math.nan
    latency_s: float = math.nan
    pending: bool = False
    failure: str = ""
    devices: int = 0
    ignored: int = 0
    faults: int = 0
    available: int = 0
    fleet: int = 0
    relief_problem: str = ""
    bridge_silent_s: float = 0.0

    def problems(self) -> list[str]:
        """Everything that an operator should look at, in words, and what to do about it."""
        problems = []
        if self.bridge_silent_s:
            problems.append(
                f"bridge silent: no aircraft's state for {self.bridge_silent_s:.0f} s, what is known of them is old: "
                "start the bridge, or mend the network to it"
            )
        if self.relief_problem:
            problems.append(self.relief_problem)
        if self.plan is not None and self.plan.unserved:
            problems.append(
                f"{len(self.plan.unserved)} devices are not served: see why in topic deployment, then make more "
                "aircraft ready, or lower what those devices demand"
            )
        if self.plan is not None and self.plan.uavs_needed > self.available:
            problems.append(
                f"{self.plan.uavs_needed} UAVs are needed, {self.available} are available: make more ready, "
                "or give back those that were taken over"
            )
        if self.ignored:
            problems.append(
                f"the newest reports of {self.ignored} devices are wrong and ignored: mend their sender (see the log)"
            )
        return problems

    def status(self, name: str, now_s: float, hardware_id: str = "none") -> DiagnosticStatus:
        """Return the status: ERROR where planning failed, WARN where something lacks, else OK."""
        problems = self.problems()
        if self.failure:
            level, message = (
                DiagnosticStatus.ERROR,
                (f"planning failed, the last good plan stays: {self.failure}; mend that, then call planner/replan"),
            )
        elif problems:
            level, message = DiagnosticStatus.WARN, "; ".join(problems)
        elif not self.active:
            level, message = DiagnosticStatus.OK, "inactive: plans once it is activated"
        elif self.plan is None:
            level, message = DiagnosticStatus.OK, "no device yet"
        else:
            level, message = DiagnosticStatus.OK, self.plan.summary()
        plan = self.plan
        bound = plan.min_uavs_bound if plan is not None else None
        figures = {
            "plan id": self.plan_id,
            "plan age [s]": f"{now_s - self.plan_made_s:.3f}",
            "planning time [s]": f"{self.planning_s:.6f}",
            "latency from event to goals [s]": f"{self.latency_s:.6f}",
            "planning pending": self.pending,
            "devices": self.devices,
            "devices unserved": len(plan.unserved) if plan is not None else 0,
            "devices with wrong newest report": self.ignored,
            "wrong reports so far": self.faults,
            "UAVs available": self.available,
            "UAVs in fleet": self.fleet,
            "UAVs needed": plan.uavs_needed if plan is not None else 0,
            "UAVs needed at least, proven": "unknown" if bound is None else bound,
            "gap [%]": f"{100 * plan.gap:.1f}" if plan is not None else "nan",
            "average UAV rate [bit/s]": f"{plan.average_uav_rate:.6g}" if plan is not None else "nan",
        }
        return DiagnosticStatus(
            level=level,
            name=name,
            hardware_id=hardware_id,
            message=message,
            values=[KeyValue(key=key, value=str(value)) for key, value in figures.items()],
        )

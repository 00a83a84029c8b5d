"""Verdict on the planner for the operator.

Oracle: the rules in the docstring of `PlannerHealth.status`, one instance each, with plans that planning itself made.
"""

from __future__ import annotations

from dataclasses import replace

import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from jpap_ros.fleet.cells import Aircraft, FleetPlan
from jpap_ros.fleet.plan import full_deployment, named_plan
from jpap_ros.fleet.plan_settings import PlanSettings
from jpap_ros.nodes.planner_diagnostics import PlannerHealth
from jpap_ros.planning.devices import Device
from jpap_ros.planning.replanning_state import LivePlan

NOW = 500.0
DEVICES = [Device("a", (0.0, 0.0), 16.0), Device("b", (2000.0, 0.0), 17.0)]


def plan_for(uavs: int) -> FleetPlan:
    crew = [Aircraft(f"uav{i}", (0.0, 0.0), connected=True) for i in range(1, uavs + 1)]
    settings = PlanSettings(scheme="optimal")
    full = full_deployment(DEVICES, settings, uavs)
    return named_plan(LivePlan.of(full, settings.demands(DEVICES)), settings, crew, {}, full=full)


def figures(status: DiagnosticStatus) -> dict[str, str]:
    return {value.key: value.value for value in status.values}


@pytest.fixture(scope="module")
def good() -> PlannerHealth:
    return PlannerHealth(
        active=True, plan=plan_for(2), plan_id=7, plan_made_s=NOW - 3.0, planning_s=0.012, latency_s=0.034,
        devices=2, available=2, fleet=2,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "level", "words"),
    [
        ({}, DiagnosticStatus.OK, "2 UAVs serve 2 devices"),
        ({"plan": None}, DiagnosticStatus.OK, "no device yet"),
        ({"active": False}, DiagnosticStatus.OK, "inactive"),
        ({"failure": "boom"}, DiagnosticStatus.ERROR, "boom; mend that, then call planner/replan"),
        ({"ignored": 3}, DiagnosticStatus.WARN, "of 3 devices are wrong and ignored: mend their sender"),
        ({"bridge_silent_s": 12.3}, DiagnosticStatus.WARN, "bridge silent: no aircraft's state for 12 s"),
        ({"available": 1}, DiagnosticStatus.WARN, "2 UAVs are needed, 1 are available: make more ready"),
    ],
)
def test_verdicts(good: PlannerHealth, changes: dict[str, object], level: bytes, words: str) -> None:
    status = replace(good, **changes).status("/planner: deployment", NOW)
    assert status.level == level
    assert words in status.message
    assert status.name == "/planner: deployment"


def test_a_fleet_too_small_is_told_with_the_proof() -> None:
    # Two devices 2 km apart cannot share a UAV: two are needed, and that is proven.
    health = PlannerHealth(active=True, plan=plan_for(1), devices=2, available=1, fleet=1)
    status = health.status("planner", NOW)
    assert status.level == DiagnosticStatus.WARN
    assert "1 devices are not served" in status.message
    told = figures(status)
    assert (told["devices unserved"], told["UAVs needed"], told["UAVs needed at least, proven"]) == ("1", "2", "2")


def test_figures(good: PlannerHealth) -> None:
    told = figures(good.status("planner", NOW))
    assert told["plan id"] == "7"
    assert float(told["plan age [s]"]) == 3.0
    assert float(told["latency from event to goals [s]"]) == 0.034
    assert float(told["gap [%]"]) == 0.0
    assert good.plan is not None
    assert float(told["average UAV rate [bit/s]"]) == pytest.approx(good.plan.average_uav_rate, rel=1e-5)
    none = figures(replace(good, plan=None).status("planner", NOW))
    assert none["gap [%]"] == "nan"
    assert none["UAVs needed at least, proven"] == "unknown"

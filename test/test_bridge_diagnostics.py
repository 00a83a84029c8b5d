"""Verdict on an aircraft for the operator, and its position as a NavSatFix.

Oracle: the rules in the docstring of `aircraft_status`, one instance each; the definition of sensor_msgs/NavSatFix.
"""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import NavSatFix, NavSatStatus
from test_link_diagnostics import GOOD as LINK

from jpap_ros.mavlink.goals import GoalState
from jpap_ros.mavlink.snapshot import AircraftSnapshot
from jpap_ros.mavlink.vehicle import Battery, LinkState, Position
from jpap_ros.nodes.bridge_conversions import fix_of
from jpap_ros.nodes.bridge_diagnostics import aircraft_status

NOW = 1000.0
GOOD = AircraftSnapshot(
    name="uav1",
    sysid=1,
    link=LinkState.CONNECTED,
    heartbeat_at=NOW - 0.4,
    autopilot="px4",
    mode="OFFBOARD",
    armed=True,
    landed_state=2,
    system_status=4,
    battery=Battery(0.82, 15.9, 1),
    position=Position(-37.8, 144.9, 70.0, 50.0, (0.0, 0.0, 0.0), math.nan, NOW),
    enu_m=(1.0, 2.0, 50.0),
    geoid_separation_m=4.5,
    setpoint_rate_hz=5.0,
    flown=True,
    goal_state=GoalState.REACHED,
    goal_reason="",
    goal_plan_id=7,
    goal_distance_m=0.3,
    problems=(),
    reboots=0,
)


@pytest.mark.parametrize(
    ("changes", "level", "words"),
    [
        ({}, DiagnosticStatus.OK, "goal reached"),
        (
            {"link": LinkState.NEVER_SEEN, "heartbeat_at": -math.inf},
            DiagnosticStatus.STALE,
            "never heard: check its power, and its url and sysid 1",
        ),
        ({"link": LinkState.LOST, "heartbeat_at": NOW - 12.2}, DiagnosticStatus.ERROR, "not heard for 12 s: check"),
        (
            {"link": LinkState.LOST, "heartbeat_at": NOW - 12.2, "problems": ("sysid 1 is used by several",)},
            DiagnosticStatus.ERROR,
            "sysid 1 is used by several; not heard for 12 s",
        ),
        (
            {"link": LinkState.NEVER_SEEN, "heartbeat_at": -math.inf, "problems": ("expected 2 here",)},
            DiagnosticStatus.ERROR,
            "expected 2 here",
        ),
        ({"problems": ("home is not set",)}, DiagnosticStatus.ERROR, "home is not set"),
        ({"battery": Battery(0.1, 13.0, 3)}, DiagnosticStatus.ERROR, "bridge/return_home or bridge/land"),
        ({"battery": Battery(0.2, 14.0, 2)}, DiagnosticStatus.WARN, "battery low"),
        # An autopilot that calls every charge good. 15 and 30 %: the planner's critical_battery and low_battery.
        ({"battery": Battery(0.03, 13.0, 1)}, DiagnosticStatus.ERROR, "battery critical"),
        ({"battery": Battery(0.15, 13.0, 1)}, DiagnosticStatus.ERROR, "battery critical"),
        ({"battery": Battery(0.3, 14.0, 1)}, DiagnosticStatus.WARN, "battery low"),
        ({"battery": Battery(0.31, 14.0, 1)}, DiagnosticStatus.OK, "goal reached"),
        ({"battery": Battery(math.nan, 14.0, 0)}, DiagnosticStatus.OK, "goal reached"),
        ({"goal_state": GoalState.YIELDED, "goal_reason": "pilot"}, DiagnosticStatus.WARN, "pilot; bridge/launch"),
        ({"goal_state": GoalState.REJECTED, "goal_reason": "fence"}, DiagnosticStatus.WARN, "fence; mend that, then"),
        ({"goal_state": GoalState.NONE, "goal_reason": "waiting: no GPS"}, DiagnosticStatus.OK, "waiting: no GPS"),
    ],
)
def test_verdicts(changes: dict[str, object], level: bytes, words: str) -> None:
    status = aircraft_status("/bridge", replace(GOOD, **changes), [LINK], NOW)
    assert status.level == level
    assert words in status.message
    assert status.name == "/bridge: uav1"
    assert status.hardware_id == "MAVLink system 1"


def test_an_aircraft_of_which_too_much_is_lost_asks_for_attention() -> None:
    # One that is heard well by one of its links is well heard.
    poor = replace(LINK, source_loss=((1, 1, 0.7), (2, 1, 0.0)))
    status = aircraft_status("/bridge", GOOD, [poor], NOW)
    assert (status.level, status.message) == (
        DiagnosticStatus.WARN,
        "70 % of its messages lost: check its antenna and range",
    )
    assert aircraft_status("/bridge", GOOD, [poor, LINK], NOW).level == DiagnosticStatus.OK
    assert aircraft_status("/bridge", replace(GOOD, sysid=2), [poor], NOW).level == DiagnosticStatus.OK


def test_figures_are_those_of_the_snapshot_and_of_its_own_source_on_the_link() -> None:
    status = aircraft_status("/bridge", GOOD, [LINK], NOW)
    figures = {value.key: value.value for value in status.values}
    assert figures["heartbeat age [s]"] == "0.4"
    assert figures["setpoints sent [1/s]"] == "5.0"
    assert figures["battery [%]"] == "82"
    assert figures["battery [V]"] == "15.90"
    assert figures["mode"] == "OFFBOARD"
    # LINK has losses of systems 1 and 2: 5 % and 4 %.
    assert figures["loss on udpin:0.0.0.0:14550 [%]"] == "5.0"
    lost = aircraft_status("/bridge", replace(GOOD, link=LinkState.LOST), [], NOW)
    assert {v.key: v.value for v in lost.values}["setpoints sent [1/s]"] == "0.0", "nothing is sent to a lost aircraft"


def test_a_fix_says_no_more_than_is_known() -> None:
    fix = fix_of(GOOD, Time(sec=3))
    assert fix is not None
    assert (fix.header.frame_id, fix.header.stamp.sec) == ("uav1", 3)
    assert (fix.latitude, fix.longitude) == (-37.8, 144.9)
    # Ellipsoid = mean sea level + separation: 70 + 4.5 m.
    assert fix.altitude == 74.5
    assert fix.status.status == NavSatStatus.STATUS_FIX
    assert fix.status.service == NavSatStatus.SERVICE_UNKNOWN
    assert fix.position_covariance_type == NavSatFix.COVARIANCE_TYPE_UNKNOWN
    assert not fix.position_covariance.any()
    unknown = fix_of(replace(GOOD, geoid_separation_m=None), Time())
    assert unknown is not None and math.isnan(unknown.altitude)
    assert fix_of(replace(GOOD, position=None), Time()) is None

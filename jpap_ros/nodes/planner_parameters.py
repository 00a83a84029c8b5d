"""The planner's parameters, and the planning settings that follow from them."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from jpap_ros.fleet.assignment import OBJECTIVES
from jpap_ros.fleet.availability import FleetPolicy
from jpap_ros.fleet.plan_settings import PlanSettings
from jpap_ros.nodes.parameters import Param, fleet_file
from jpap_ros.planning import SCHEMES, LinkBudget
from jpap_ros.planning.replanning_decision import ReplanningPolicy
from jpap_ros.planning.replanning_state import HOLD_FACTOR

_LINK = LinkBudget()
_POLICY = ReplanningPolicy()
_LIFE = FleetPolicy()


def planner_parameters() -> tuple[Param, ...]:
    """Return every parameter of the planner."""
    return (
        fleet_file(),
        Param("autostart", True, "Configure and activate at start, without a lifecycle manager", fixed=True),
        Param("state_file", "", "File that keeps the plan, to go on after a restart; empty: none", fixed=True),
        Param("map_frame", "map", "Frame of positions: ENU, origin as in the fleet file", check=_frame, fixed=True),
        Param("scheme", "optimal", "Algorithm that makes the deployment", choices=tuple(SCHEMES)),
        Param("transmit_power_dbm", _LINK.transmit_power_dbm, "Total transmit power of one UAV [dBm]", -50.0, 100.0),
        Param("noise_power_dbm", _LINK.noise_power_dbm, "Noise power at a device [dBm]", -200.0, 0.0),
        Param("reference_gain_db", _LINK.reference_gain_db, "Channel gain at 1 m [dB]", -150.0, 0.0),
        Param("altitude_m", _LINK.altitude_m, "Height of every goal above the map's ground [m]", 1.0, 5000.0),
        Param("bandwidth_hz", 1.0, "Bandwidth of a device's channel; divides demands in bit/s [Hz]", 1e-3, 1e12),
        Param("max_devices_per_uav", 0, "Most devices that one UAV serves; 0: no limit", 0, 100_000),
        Param("min_separation_m", 15.0, "Least horizontal distance between two goals [m]", 0.0, 10_000.0),
        Param(
            "assignment",
            OBJECTIVES[0],
            "Which aircraft takes a cell that has none: least sum of squared distances, or shortest longest flight",
            choices=OBJECTIVES,
        ),
        Param("time_limit_s", 10.0, "Longest time for one plan; 0: no limit [s]", 0.0, 3600.0),
        Param(
            "debounce_s",
            0.002,
            "Quiet time after an event before planning: a burst makes one plan [s]",
            0.0,
            60.0,
        ),
        Param("debounce_max_s", 0.2, "Longest time that a stream of events can put planning off [s]", 0.0, 600.0),
        Param(
            "replanning",
            "incremental",
            "Answer to an event: the smallest change of the plan in force, or a plan from scratch",
            choices=("incremental", "scratch"),
        ),
        Param("reoptimise", True, "Plan from scratch behind every change, and fly there where it is worth it"),
        Param("uav_value", _POLICY.uav_value, "What a plan from scratch gains for each UAV saved", 0.0, 1e6),
        Param("rate_value", _POLICY.rate_value, "Its gain for 100 % more average UAV rate", 0.0, 1e6),
        Param("unserved_value", _POLICY.unserved_value, "Its gain for each weight of devices served more", 0.0, 1e6),
        Param("metre_cost", _POLICY.metre_cost, "Its cost for each metre flown by any UAV [1/m]", 0.0, 1e6),
        Param("launch_cost", _POLICY.launch_cost, "Its cost for each UAV launched or sent home", 0.0, 1e6),
        Param(
            "interruption_cost",
            _POLICY.interruption_cost,
            "Its cost for each weight interrupted, held or kept waiting",
            0.0,
            1e6,
        ),
        Param("tolerance", _POLICY.tolerance, "What gain must exceed cost by for it to be flown", 0.0, 1e6),
        Param(
            "hold_factor",
            HOLD_FACTOR,
            "How many times as much as one that waits a device counts that is served, until its heir is there",
            0.0,
            1e6,
        ),
        Param(
            "manage_fleet",
            False,
            "Launch, relieve and send home aircraft through the bridge; else only an operator does",
            fixed=True,
        ),
        Param(
            "low_battery",
            _LIFE.low_battery,
            "Share at which an aircraft is relieved; earlier where its relief has far to fly",
            0.0,
            1.0,
            fixed=True,
        ),
        Param(
            "critical_battery",
            _LIFE.critical_battery,
            "Share at which it goes home anyway; earlier where that is far",
            0.0,
            1.0,
            fixed=True,
        ),
        Param("ready_battery", _LIFE.ready_battery, "Share from which one may be launched", 0.0, 1.0, fixed=True),
        Param(
            "endurance_s",
            _LIFE.endurance_s,
            "How long a full battery lasts in the air, until its drain is measured [s]",
            10.0,
            1e6,
            fixed=True,
        ),
        Param("cruise_m_s", _LIFE.cruise_m_s, "Speed over ground of a relief on its way [m/s]", 0.1, 500.0, fixed=True),
        Param("climb_m_s", _LIFE.climb_m_s, "Vertical speed of a relief [m/s]", 0.1, 100.0, fixed=True),
        Param(
            "way_factor",
            _LIFE.way_factor,
            "How much longer than straight at these speeds a relief may take",
            1.0,
            10.0,
            fixed=True,
        ),
        Param(
            "relief_slack_s",
            _LIFE.relief_slack_s,
            "Time that a relief may take besides, to get ready and wait for its turn [s]",
            0.0,
            3600.0,
            fixed=True,
        ),
        Param(
            "station_above_m",
            _LIFE.station_above_m,
            "How far above its cell a relief waits: the min_separation_m of the bridge or more [m]",
            1.0,
            1000.0,
            fixed=True,
        ),
        Param(
            "lost_after_s",
            _LIFE.lost_after_s,
            "Silence after which an aircraft's cell goes to another [s]",
            0.0,
            3600.0,
            fixed=True,
        ),
        Param(
            "idle_return_s",
            _LIFE.idle_return_s,
            "Time after which one in the air without a cell is sent home [s]",
            0.0,
            86400.0,
            fixed=True,
        ),
        Param("device_timeout_s", 0.0, "A device not reported for so long has left; 0: never [s]", 0.0, 1e7),
    )


#: Parameters whose change may make another plan, or make a plan from scratch worth the flight.
PLAN_PARAMETERS = frozenset(
    {
        "scheme",
        "transmit_power_dbm",
        "noise_power_dbm",
        "reference_gain_db",
        "altitude_m",
        "bandwidth_hz",
        "max_devices_per_uav",
        "min_separation_m",
        "assignment",
        "hold_factor",
        "time_limit_s",
        "replanning",
        "reoptimise",
        *(item.name for item in fields(ReplanningPolicy)),
    }
)


def plan_settings(values: dict[str, Any]) -> PlanSettings:
    """Planning settings of parameter values by name; 0 means no limit there."""
    return PlanSettings(
        scheme=values["scheme"],
        link=LinkBudget(
            values["transmit_power_dbm"], values["noise_power_dbm"], values["reference_gain_db"], values["altitude_m"]
        ),
        bandwidth_hz=values["bandwidth_hz"],
        max_devices_per_uav=values["max_devices_per_uav"] or None,
        min_separation_m=values["min_separation_m"],
        time_limit_s=values["time_limit_s"] or None,
        assignment=values["assignment"],
        hold_factor=values["hold_factor"],
    )


def replanning_policy(values: dict[str, Any]) -> ReplanningPolicy:
    """What a plan from scratch is worth, from parameter values by name."""
    return ReplanningPolicy(**{item.name: values[item.name] for item in fields(ReplanningPolicy)})


def _frame(value: str) -> str | None:
    return None if value else f"must not be empty, got {value!r}"

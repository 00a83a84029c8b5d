"""The bridge's parameters, and the controller's settings that follow from them."""

from __future__ import annotations

from typing import Any

from jpap_ros.fleet.config import FleetConfig
from jpap_ros.fleet.transit_plan import TransitLimits
from jpap_ros.mavlink.aircraft_settings import AircraftSettings
from jpap_ros.mavlink.autopilots import Transport
from jpap_ros.mavlink.fleet_controller import ControllerSettings
from jpap_ros.mavlink.guards import GoalLimits
from jpap_ros.nodes.parameters import Param, fleet_file

_SEPARATION = "Aircraft in the air stay this far apart on their ways; 0: each flies straight to its goal [m]"


def bridge_parameters() -> tuple[Param, ...]:
    """Return every parameter of the bridge; none can change while aircraft are in the air."""
    return (
        fleet_file(),
        Param(
            "map_frame", "map", "Frame of goals and poses: ENU, origin as in the fleet file", check=_frame, fixed=True
        ),
        Param("sysid", 245, "The bridge's own MAVLink system id, not a vehicle's", 1, 254, fixed=True),
        Param("transport", "setpoint", "How goals are sent", choices=[t.value for t in Transport], fixed=True),
        Param(
            "setpoint_rate_hz",
            2.0,
            "Position targets a second to one aircraft, PX4 gets at least 5 [Hz]",
            0.2,
            50.0,
            fixed=True,
        ),
        Param("use_goal_yaw", False, "Fly the heading of goal_pose too, not only its position", fixed=True),
        Param("announce_plans", True, "Tell ground stations of each plan in a STATUSTEXT", fixed=True),
        Param(
            "plan_dir", "", "Keep each plan here as plan.geojson, plan.kml and plan.plan; empty: nowhere", fixed=True
        ),
        Param(
            "tlog_dir",
            "",
            "Keep what passes over each link here, as .tlog for ground stations; empty: nowhere",
            fixed=True,
        ),
        Param(
            "state_file",
            "",
            "File that says which aircraft are flown and where, to go on after a kill; empty: none",
            fixed=True,
        ),
        Param("simulated_clock", False, "All aircraft are simulated, and may fly faster than the clock", fixed=True),
        Param("arrival_radius_m", 1.0, "A goal is reached within this distance [m]", 0.1, 100.0, fixed=True),
        Param("takeoff_height_m", 10.0, "Height above home that bridge/launch climbs to [m]", 1.0, 500.0, fixed=True),
        Param("launch_stagger_s", 0.5, "Between the take-offs of one bridge/launch [s]", 0.0, 600.0, fixed=True),
        Param("ready_timeout_s", 30.0, "How long bridge/launch waits for GPS and checks [s]", 0.0, 600.0, fixed=True),
        Param("link_timeout_s", 4.0, "A vehicle is lost after this long without heartbeat [s]", 1.5, 60.0, fixed=True),
        Param(
            "plan_timeout_s",
            10.0,
            "Hold when the planner, or who else sends goals, is silent for so long; 0: never [s]",
            0.0,
            1e6,
            fixed=True,
        ),
        Param("min_separation_m", 10.0, _SEPARATION, 0.0, 1000.0, fixed=True),
        Param(
            "tracking_error_m", 2.0, "Farthest an aircraft may be from its moving setpoint [m]", 0.1, 50.0, fixed=True
        ),
        Param("transit_speed_m_s", 8.0, "Speed over ground on the way to a goal [m/s]", 0.1, 50.0, fixed=True),
        Param("transit_climb_m_s", 1.5, "Vertical speed on the way to a goal [m/s]", 0.1, 20.0, fixed=True),
        Param("transit_acceleration_m_s2", 1.5, "Acceleration on the way to a goal [m/s^2]", 0.1, 10.0, fixed=True),
        Param(
            "transit_min_height_m", 20.0, "No way to a goal leads lower than this or the goal [m]", 1.0, 5e3, fixed=True
        ),
        Param("transit_max_height_m", 120.0, "Highest layer used to pass one another [m]", 1.0, 5000.0, fixed=True),
        Param("max_goal_jump_m", 5000.0, "Most distance from aircraft to a new goal [m]", 1.0, 100_000.0, fixed=True),
    )


def controller_settings(values: dict[str, Any], fleet: FleetConfig) -> ControllerSettings:
    """Controller settings of parameter values by name."""
    return ControllerSettings(
        sysid=values["sysid"],
        aircraft=AircraftSettings(
            setpoint_rate_hz=values["setpoint_rate_hz"],
            arrival_radius_m=values["arrival_radius_m"],
            takeoff_height_m=values["takeoff_height_m"],
            link_timeout_s=values["link_timeout_s"],
            ready_timeout_s=values["ready_timeout_s"],
            transport=Transport(values["transport"]),
            simulated_clock=values["simulated_clock"],
            limits=GoalLimits(fleet.fence, values["max_goal_jump_m"]),
        ),
        traffic=_traffic(values),
        plan_timeout_s=values["plan_timeout_s"],
        launch_stagger_s=values["launch_stagger_s"],
    )


def _traffic(values: dict[str, Any]) -> TransitLimits | None:
    if values["min_separation_m"] == 0.0:
        return None
    return TransitLimits(
        min_separation_m=values["min_separation_m"],
        tracking_error_m=values["tracking_error_m"],
        speed_m_s=values["transit_speed_m_s"],
        vertical_speed_m_s=values["transit_climb_m_s"],
        acceleration_m_s2=values["transit_acceleration_m_s2"],
        min_altitude_m=values["transit_min_height_m"],
        max_altitude_m=values["transit_max_height_m"],
    )


def _frame(value: str) -> str | None:
    return None if value else f"must not be empty, got {value!r}"

"""Between the planner's plain objects and its messages."""

from __future__ import annotations

import math
from collections.abc import Iterable

from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from jpap_msgs.msg import (
    Cell,
    Deployment,
    DeviceUpdate,
    GeoDevice,
    GeoDeviceUpdate,
    PowerAllocation,
    UnservedDevice,
    VehicleState,
)
from std_msgs.msg import Header

from jpap_ros.fleet.cells import Aircraft, FleetCell, FleetPlan
from jpap_ros.fleet.config import UavConfig
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.planning.devices import Device, Fault

# Values of MAV_STATE and MAV_BATTERY_CHARGE_STATE, https://mavlink.io/en/messages/common.html
_MAV_STATE_CRITICAL = 5
_CHARGE_STATE_CRITICAL = 3

_AIRBORNE = (VehicleState.LANDED_IN_AIR, VehicleState.LANDED_TAKEOFF, VehicleState.LANDED_LANDING)


def is_in_air(state: VehicleState) -> bool:
    """Whether an aircraft is in the air; where it has not said so yet, after a start of the bridge, if it is armed."""
    unknown = state.landed_state == VehicleState.LANDED_UNDEFINED
    return state.armed if unknown else state.landed_state in _AIRBORNE


def devices_of(message: DeviceUpdate) -> list[Device]:
    """Devices of a report in metres."""
    return [Device(d.id, (d.position.x, d.position.y), d.rate_demand, d.weight) for d in message.devices]


def geo_devices_of(message: GeoDeviceUpdate, frame: LocalFrame) -> list[Device | Fault]:
    """Devices of a report in degrees; a Fault for each position that is not on the map."""
    return [_geo_device(entry, frame) for entry in message.devices]


def _geo_device(entry: GeoDevice, frame: LocalFrame) -> Device | Fault:
    try:
        position = frame.to_map(entry.latitude, entry.longitude)
    except ValueError as error:
        field, _, problem = str(error).partition(" ")
        return Fault(entry.id, field, problem)
    return Device(entry.id, position, entry.rate_demand, entry.weight)


def aircraft_of(config: UavConfig, state: VehicleState | None, goal: FleetCell | None) -> Aircraft:
    """Return an aircraft as the planner sees it: where telemetry says, else at its goal, else at home."""
    if state is not None and state.position_valid:
        position = (state.position.x, state.position.y)
    elif goal is not None:
        position = goal.position
    else:
        position = config.home_m or (0.0, 0.0)
    if state is None:
        return Aircraft(config.name, position, located=False)
    unavailable = why_unavailable(state)
    return Aircraft(
        config.name,
        position,
        connected=state.link == VehicleState.LINK_CONNECTED,
        airborne=is_in_air(state),
        unavailable=unavailable,
        # Whoever was taken over flies on as somebody else likes.
        located=state.position_valid and not unavailable,
        up_m=state.position.z if state.position_valid else None,
    )


def why_unavailable(state: VehicleState) -> str:
    """Why an aircraft can take no cell, in words; empty if it can. One that was never seen may yet appear."""
    if state.link == VehicleState.LINK_LOST or state.goal_state == VehicleState.GOAL_LOST:
        return "is lost"
    if state.goal_state == VehicleState.GOAL_YIELDED:
        return "was taken over" + (f" ({state.goal_reason})" if state.goal_reason else "")
    if state.system_status >= _MAV_STATE_CRITICAL:
        return f"reports a critical system status ({state.system_status})"
    if state.battery_charge_state >= _CHARGE_STATE_CRITICAL:
        return f"has a critical battery (charge state {state.battery_charge_state})"
    return ""


def deployment_message(
    plan: FleetPlan, header: Header, plan_id: int, reason: str, altitude_m: float, planning_time_s: float
) -> Deployment:
    """Return the plan in force as a message; positions in the header's frame."""
    return Deployment(
        header=header,
        plan_id=plan_id,
        reason=reason,
        scheme=plan.scheme,
        cells=[_cell(cell, altitude_m) for cell in plan.cells],
        unserved=[UnservedDevice(id=device, reason=why) for device, why in plan.unserved.items()],
        uavs_needed=plan.uavs_needed,
        min_uavs_bound=-1 if plan.min_uavs_bound is None else plan.min_uavs_bound,
        proven_optimal=plan.proven_optimal,
        gap=plan.gap,
        average_uav_rate=plan.average_uav_rate,
        # It holds for the plan, not for those who still do what they were told before.
        average_uav_rate_bound=math.nan if plan.waiting else plan.average_uav_rate_bound,
        interrupted=list(plan.interrupted),
        planning_time=_duration(planning_time_s),
    )


def _cell(cell: FleetCell, altitude_m: float) -> Cell:
    served = cell.served
    return Cell(
        uav=cell.uav,
        goal_pose=_pose((*cell.position, altitude_m)),
        device_ids=list(served),
        power_w=[power for power, _ in served.values()],
        rate=[rate for _, rate in served.values()],
        uav_rate=cell.uav_rate,
        coverage_radius_m=cell.coverage_radius_m,
    )


def goal_pose(cell: FleetCell, header: Header, altitude_m: float) -> PoseStamped:
    """Where the cell's aircraft should hover. A hover has no heading of its own: the orientation is the identity."""
    return relief_pose((*cell.position, altitude_m), header)


def relief_pose(place: tuple[float, float, float], header: Header) -> PoseStamped:
    """Return a goal at a place, east, north and up [m]."""
    return PoseStamped(header=header, pose=_pose(place))


def power_allocation(uav: str, cell: FleetCell | None, header: Header, plan_id: int) -> PowerAllocation:
    """How an aircraft splits its power; empty for one that has no cell any more."""
    message = PowerAllocation(header=header, plan_id=plan_id, uav=uav)
    if cell is not None:
        message.device_ids = list(cell.device_ids)
        message.power_w = list(cell.power_w)
        message.rate = list(cell.rate)
        message.apply_within_m = cell.apply_within_m
    return message


def listed(items: Iterable[object], limit: int = 5) -> str:
    """Join a few items in words, and count the others."""
    texts = [str(item) for item in items]
    more = len(texts) - limit
    return "; ".join(texts[:limit]) + (f"; and {more} more" if more > 0 else "")


def _pose(place: tuple[float, float, float]) -> Pose:
    return Pose(position=Point(x=place[0], y=place[1], z=place[2]), orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=1.0))


def _duration(seconds: float) -> Duration:
    whole = math.floor(seconds)
    return Duration(sec=whole, nanosec=min(999_999_999, round((seconds - whole) * 1e9)))

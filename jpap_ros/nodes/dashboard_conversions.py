"""From messages to what the dashboard keeps, and from what a page asks for to messages."""

from __future__ import annotations

import math

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point, PoseStamped
from jpap_msgs.msg import Deployment, DeviceUpdate, VehicleState
from jpap_msgs.msg import Device as DeviceMessage
from jpap_msgs.srv import FleetCommand
from std_msgs.msg import Header

from jpap_ros.dashboard.records import ERROR, Plan, PlannedCell, Pose, Status, Vehicle
from jpap_ros.dashboard.server import Outcome, UavOutcome
from jpap_ros.nodes.battery import is_low
from jpap_ros.planning.devices import Device

# Value of MAV_STATE, https://mavlink.io/en/messages/common.html
_MAV_STATE_CRITICAL = 5

_LINKS = {
    VehicleState.LINK_NEVER_SEEN: "never seen",
    VehicleState.LINK_CONNECTED: "connected",
    VehicleState.LINK_LOST: "lost",
}
_LANDED = {
    VehicleState.LANDED_ON_GROUND: "on ground",
    VehicleState.LANDED_IN_AIR: "in air",
    VehicleState.LANDED_TAKEOFF: "taking off",
    VehicleState.LANDED_LANDING: "landing",
}
_GOALS = {
    VehicleState.GOAL_NONE: "none",
    VehicleState.GOAL_SENT: "sent",
    VehicleState.GOAL_ACCEPTED: "accepted",
    VehicleState.GOAL_EN_ROUTE: "en route",
    VehicleState.GOAL_REACHED: "reached",
    VehicleState.GOAL_REJECTED: "rejected",
    VehicleState.GOAL_YIELDED: "yielded",
    VehicleState.GOAL_LOST: "lost",
}


def pose_of(message: PoseStamped) -> Pose:
    """Position and heading of an aircraft; the bridge's poses turn about the vertical only."""
    q = message.pose.orientation
    yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y**2 + q.z**2))
    return Pose(point_of(message.pose.position), math.degrees(math.pi / 2.0 - yaw))


def point_of(message: Point) -> tuple[float, float, float]:
    """East, north, up [m]."""
    return message.x, message.y, message.z


def vehicle_of(message: VehicleState) -> Vehicle:
    """What the bridge says of an aircraft; unknown numbers of a newer bridge read as unknown."""
    return Vehicle(
        link=_LINKS.get(message.link, "never seen"),
        autopilot=message.autopilot,
        mode=message.mode,
        armed=message.armed,
        landed=_LANDED.get(message.landed_state, "undefined"),
        emergency=message.system_status >= _MAV_STATE_CRITICAL,
        battery=_known(message.battery_remaining),
        battery_low=is_low(message.battery_remaining, message.battery_charge_state),
        position=point_of(message.position) if message.position_valid else None,
        goal=_GOALS.get(message.goal_state, "none"),
        plan_id=message.goal_plan_id,
        reason=message.goal_reason,
        distance_m=_known(message.goal_distance_m),
    )


def plan_of(message: Deployment) -> Plan:
    """Return the deployment in force."""
    return Plan(
        id=message.plan_id,
        reason=message.reason,
        scheme=message.scheme,
        cells=tuple(
            PlannedCell(
                uav=cell.uav,
                position=point_of(cell.goal_pose.position),
                rates=dict(zip(cell.device_ids, cell.rate, strict=False)),
                uav_rate=cell.uav_rate,
                radius_m=_known(cell.coverage_radius_m),
            )
            for cell in message.cells
        ),
        unserved={entry.id: entry.reason for entry in message.unserved},
        needed=message.uavs_needed,
        bound=message.min_uavs_bound if message.min_uavs_bound >= 0 else None,
        proven=message.proven_optimal,
        average_rate=_known(message.average_uav_rate),
        average_rate_bound=_known(message.average_uav_rate_bound),
        interrupted=tuple(message.interrupted),
        planning_s=message.planning_time.sec + 1e-9 * message.planning_time.nanosec,
    )


def status_of(message: DiagnosticStatus) -> Status:
    """One diagnostic status; its name is `<node>: <part>`, with or without a slash before the node's name."""
    node, _, part = message.name.partition(": ")
    return Status(
        node=f"/{node.lstrip('/')}",
        part=part,
        level=min(int.from_bytes(message.level, "little"), ERROR + 1),
        message=message.message,
        values={value.key: value.value for value in message.values},
    )


def device_update(device: Device | None, departed: str | None, header: Header) -> DeviceUpdate:
    """Report of a device that joined or changed, or of one that left."""
    update = DeviceUpdate(header=header, departed=[departed] if departed is not None else [])
    if device is not None:
        east, north = device.position
        update.devices = [
            DeviceMessage(
                id=device.id,
                position=Point(x=east, y=north, z=0.0),
                rate_demand=device.rate_demand,
                weight=device.weight,
            )
        ]
    return update


def outcome_of(response: FleetCommand.Response) -> Outcome:
    """What the bridge answered."""
    results = tuple(UavOutcome(result.uav, result.success, result.message) for result in response.results)
    return Outcome(response.success, response.message, results)


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None

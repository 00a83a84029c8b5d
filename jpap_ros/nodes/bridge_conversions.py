"""Between the bridge's plain objects and its messages."""

from __future__ import annotations

import math
from collections.abc import Container

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from jpap_msgs.msg import Deployment, VehicleState
from sensor_msgs.msg import NavSatFix, NavSatStatus
from std_msgs.msg import Header

from jpap_ros.mavlink.geodesy import yaw_enu_from_ned
from jpap_ros.mavlink.goals import Goal
from jpap_ros.mavlink.plan_files import GoalMark
from jpap_ros.mavlink.snapshot import AircraftSnapshot


def goal_of(message: PoseStamped, use_yaw: bool) -> Goal:
    """Return the goal that a pose asks for.

    The heading counts only if `use_yaw`: a quaternion cannot say "any heading", and planners send the identity.
    """
    position = message.pose.position
    return Goal(position.x, position.y, position.z, _yaw(message.pose.orientation) if use_yaw else None)


def goal_marks(message: Deployment, names: Container[str]) -> list[GoalMark]:
    """Return where a plan sends the UAVs of the fleet; cells without one are left out."""
    places = [(cell.uav, cell.goal_pose.position) for cell in message.cells if cell.uav in names]
    return [GoalMark(uav, (place.x, place.y), place.z) for uav, place in places]


def _yaw(q: Quaternion) -> float | None:
    """Rotation about the vertical [rad]; None for the zero quaternion, NaN for one that is not finite."""
    norm = math.hypot(q.x, q.y, q.z, q.w)
    if norm == 0.0:
        return None
    return math.atan2(2.0 * (q.w * q.z + q.x * q.y), q.w**2 + q.x**2 - q.y**2 - q.z**2) if norm < math.inf else math.nan


def pose_of(snapshot: AircraftSnapshot, header: Header) -> PoseStamped | None:
    """Return where an aircraft is, heading included where known; None if it is unknown."""
    if snapshot.enu_m is None or snapshot.position is None:
        return None
    east, north, up = snapshot.enu_m
    heading = snapshot.position.yaw_ned
    half = 0.0 if math.isnan(heading) else yaw_enu_from_ned(heading) / 2.0
    return PoseStamped(
        header=header,
        pose=Pose(
            position=Point(x=east, y=north, z=up),
            orientation=Quaternion(x=0.0, y=0.0, z=math.sin(half), w=math.cos(half)),
        ),
    )


def fix_of(snapshot: AircraftSnapshot, stamp: Time) -> NavSatFix | None:
    """Return where an aircraft is in degrees, with no more said of it than is known; None if it is unknown.

    The vehicle's estimate, GLOBAL_POSITION_INT, tells neither which satellites are behind it nor how good it is. Its
    height is above mean sea level; this message's is above the ellipsoid, NaN until the vehicle has told both.
    """
    position, separation_m = snapshot.position, snapshot.geoid_separation_m
    if position is None:
        return None
    return NavSatFix(
        header=Header(stamp=stamp, frame_id=snapshot.name),
        status=NavSatStatus(status=NavSatStatus.STATUS_FIX, service=NavSatStatus.SERVICE_UNKNOWN),
        latitude=position.latitude,
        longitude=position.longitude,
        altitude=math.nan if separation_m is None else position.amsl_m + separation_m,
        position_covariance_type=NavSatFix.COVARIANCE_TYPE_UNKNOWN,
    )


def state_message(snapshot: AircraftSnapshot, header: Header) -> VehicleState:
    """Return everything known of an aircraft."""
    message = VehicleState(
        header=header,
        uav=snapshot.name,
        sysid=snapshot.sysid,
        link=int(snapshot.link),
        autopilot=snapshot.autopilot,
        mode=snapshot.mode,
        armed=snapshot.armed,
        landed_state=_byte(snapshot.landed_state, VehicleState.LANDED_LANDING),
        system_status=_byte(snapshot.system_status, 255),
        battery_remaining=snapshot.battery.remaining,
        battery_voltage_v=snapshot.battery.voltage_v,
        battery_charge_state=_byte(snapshot.battery.charge_state, 255),
        goal_state=int(snapshot.goal_state),
        goal_plan_id=snapshot.goal_plan_id,
        goal_reason=snapshot.goal_reason,
        goal_distance_m=snapshot.goal_distance_m,
    )
    if snapshot.position is not None and snapshot.enu_m is not None:
        message.position_valid = True
        message.latitude = snapshot.position.latitude
        message.longitude = snapshot.position.longitude
        message.altitude_amsl_m = snapshot.position.amsl_m
        message.relative_altitude_m = snapshot.position.relative_m
        message.position = Point(x=snapshot.enu_m[0], y=snapshot.enu_m[1], z=snapshot.enu_m[2])
    return message


def _byte(value: int, highest: int) -> int:
    """What a vehicle sent, or 0 (undefined, in all these enumerations) where it is no value of the message's."""
    return value if 0 <= value <= highest else 0

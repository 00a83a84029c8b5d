"""The messages that a simulated vehicle sends about itself."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.sim.dynamics import GRAVITY

if TYPE_CHECKING:
    from jpap_ros.sim.vehicle import SimVehicle

CELLS = 4
FULL_CELL_V, EMPTY_CELL_V = 4.2, 3.5
CAPACITY_MAH = 5200
HOVER_CURRENT_A = 15.0
_UNKNOWN_CELL = 0xFFFF
_SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_GPS
    | mavlink.MAV_SYS_STATUS_AHRS
    | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
    | mavlink.MAV_SYS_STATUS_PREARM_CHECK
)


def heartbeat(vehicle: SimVehicle) -> Any:
    """HEARTBEAT."""
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_QUADROTOR,
        vehicle.AUTOPILOT,
        vehicle.base_mode(),
        vehicle.custom_mode,
        vehicle.system_status(),
        3,
    )


def sys_status(vehicle: SimVehicle) -> Any:
    """SYS_STATUS, with the battery and the pre-arm check."""
    health = _SENSORS
    if not vehicle.gps_ready:
        health &= ~(mavlink.MAV_SYS_STATUS_SENSOR_GPS | mavlink.MAV_SYS_STATUS_AHRS)
    if vehicle.prearm_problem() is not None:
        health &= ~mavlink.MAV_SYS_STATUS_PREARM_CHECK
    return mavlink.MAVLink_sys_status_message(
        _SENSORS,
        _SENSORS,
        health,
        250,
        round(_cell_voltage(vehicle) * CELLS * 1000),
        round(_current(vehicle) * 100),
        round(vehicle.battery * 100),
        0,
        0,
        0,
        0,
        0,
        0,
    )


def global_position_int(vehicle: SimVehicle) -> Any:
    """GLOBAL_POSITION_INT."""
    if not vehicle.gps_ready:
        return vehicle.position_before_fix()
    body = vehicle.body
    lat, lon = vehicle.lat_lon_e7()
    return mavlink.MAVLink_global_position_int_message(
        vehicle.boot_ms(),
        lat,
        lon,
        round(vehicle.amsl(body.z) * 1000),
        round((body.z - vehicle.home_z()) * 1000),
        round(body.vy * 100),
        round(body.vx * 100),
        round(-body.vz * 100),
        _centidegrees(body.yaw),
    )


def local_position_ned(vehicle: SimVehicle) -> Any:
    """LOCAL_POSITION_NED, from the estimator's origin."""
    if vehicle.ekf_origin is None:
        return None
    body, origin = vehicle.body, vehicle.ekf_origin
    return mavlink.MAVLink_local_position_ned_message(
        vehicle.boot_ms(),
        body.y - origin[1],
        body.x - origin[0],
        origin[2] - body.z,
        body.vy,
        body.vx,
        -body.vz,
    )


def gps_raw_int(vehicle: SimVehicle) -> Any:
    """GPS_RAW_INT, with the height above the ellipsoid as well."""
    body = vehicle.body
    if not vehicle.gps_ready:
        unknown = 0xFFFF
        return mavlink.MAVLink_gps_raw_int_message(
            vehicle.boot_us(), mavlink.GPS_FIX_TYPE_NO_FIX, 0, 0, 0, unknown, unknown, unknown, unknown, 0
        )
    lat, lon = vehicle.lat_lon_e7()
    amsl = vehicle.amsl(body.z)
    return mavlink.MAVLink_gps_raw_int_message(
        vehicle.boot_us(),
        mavlink.GPS_FIX_TYPE_3D_FIX,
        lat,
        lon,
        round(amsl * 1000),
        80,
        120,
        round(body.speed * 100),
        _centidegrees(math.atan2(body.vx, body.vy)),
        14,
        round((amsl + vehicle.options.geoid_separation_m) * 1000),
        800,
        1200,
        300,
        0,
        0,
    )


def attitude(vehicle: SimVehicle) -> Any:
    """ATTITUDE: a multirotor leans into its acceleration."""
    body = vehicle.body
    sin, cos = math.sin(body.yaw), math.cos(body.yaw)
    ahead, right = body.ax * sin + body.ay * cos, body.ax * cos - body.ay * sin
    return mavlink.MAVLink_attitude_message(
        vehicle.boot_ms(), math.atan2(right, GRAVITY), -math.atan2(ahead, GRAVITY), body.yaw, 0.0, 0.0, 0.0
    )


def extended_sys_state(vehicle: SimVehicle) -> Any:
    """EXTENDED_SYS_STATE."""
    return mavlink.MAVLink_extended_sys_state_message(mavlink.MAV_VTOL_STATE_UNDEFINED, vehicle.landed_state())


def battery_status(vehicle: SimVehicle) -> Any:
    """BATTERY_STATUS."""
    cell = round(_cell_voltage(vehicle) * 1000)
    return mavlink.MAVLink_battery_status_message(
        0,
        mavlink.MAV_BATTERY_FUNCTION_ALL,
        mavlink.MAV_BATTERY_TYPE_LIPO,
        2500,
        [cell] * CELLS + [_UNKNOWN_CELL] * (10 - CELLS),
        round(_current(vehicle) * 100),
        round((1.0 - vehicle.battery) * CAPACITY_MAH),
        -1,
        round(vehicle.battery * 100),
        round(vehicle.battery * vehicle.options.endurance_s),
        vehicle.charge_state(),
    )


def home_position(vehicle: SimVehicle) -> Any:
    """HOME_POSITION; None while there is none."""
    home, origin = vehicle.home, vehicle.ekf_origin
    if home is None or origin is None:
        return None
    lat, lon = vehicle.geodetic_e7(home[0], home[1])
    ned = (home[1] - origin[1], home[0] - origin[0], origin[2] - home[2])
    return mavlink.MAVLink_home_position_message(
        lat, lon, round(vehicle.amsl(home[2]) * 1000), *ned, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, vehicle.boot_us()
    )


def gps_global_origin(vehicle: SimVehicle) -> Any:
    """GPS_GLOBAL_ORIGIN; None while there is none."""
    origin = vehicle.ekf_origin
    if origin is None:
        return None
    lat, lon = vehicle.geodetic_e7(origin[0], origin[1])
    return mavlink.MAVLink_gps_global_origin_message(lat, lon, round(vehicle.amsl(origin[2]) * 1000), vehicle.boot_us())


def position_target_global_int(vehicle: SimVehicle) -> Any:
    """POSITION_TARGET_GLOBAL_INT: where the autopilot is flying to; None while it flies nowhere."""
    goal = vehicle.global_target()
    if goal is None:
        return None
    lat, lon = vehicle.goal_e7(goal)
    return mavlink.MAVLink_position_target_global_int_message(
        vehicle.boot_ms(),
        vehicle.ECHO_FRAME,
        vehicle.ECHO_TYPE_MASK,
        lat,
        lon,
        vehicle.amsl(goal[2]),
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
    )


def position_target_local_ned(vehicle: SimVehicle) -> Any:
    """POSITION_TARGET_LOCAL_NED: the same from the estimator's origin; None while it flies nowhere."""
    goal, origin = vehicle.manoeuvre.goal, vehicle.ekf_origin
    if goal is None or origin is None or not vehicle.armed:
        return None
    ned = (goal[1] - origin[1], goal[0] - origin[0], origin[2] - goal[2])
    rest = (0.0,) * 8
    return mavlink.MAVLink_position_target_local_ned_message(
        vehicle.boot_ms(), mavlink.MAV_FRAME_LOCAL_NED, vehicle.ECHO_TYPE_MASK, *ned, *rest
    )


def vfr_hud(vehicle: SimVehicle) -> Any:
    """VFR_HUD."""
    body = vehicle.body
    throttle = 0 if not vehicle.armed else 10 if vehicle.on_ground else 50
    heading = round(math.degrees(body.yaw)) % 360
    return mavlink.MAVLink_vfr_hud_message(body.speed, body.speed, heading, throttle, vehicle.amsl(body.z), body.vz)


def system_time(vehicle: SimVehicle) -> Any:
    """SYSTEM_TIME; its time since boot going back tells of a reboot."""
    unix_us = int(time.time() * 1e6) if vehicle.gps_ready else 0
    return mavlink.MAVLink_system_time_message(unix_us, vehicle.boot_ms())


def autopilot_version(vehicle: SimVehicle) -> Any:
    """AUTOPILOT_VERSION."""
    return mavlink.MAVLink_autopilot_version_message(
        vehicle.CAPABILITIES, vehicle.FLIGHT_SW_VERSION, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, vehicle.sysid
    )


BUILDERS: dict[int, Callable[[SimVehicle], Any]] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: heartbeat,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: sys_status,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: system_time,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: gps_raw_int,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: attitude,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: local_position_ned,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: global_position_int,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: gps_global_origin,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: vfr_hud,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: position_target_global_int,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: position_target_local_ned,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: battery_status,
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: autopilot_version,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: home_position,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: extended_sys_state,
}


def _centidegrees(angle: float) -> int:
    return round(math.degrees(angle) * 100) % 36000


def _cell_voltage(vehicle: SimVehicle) -> float:
    return EMPTY_CELL_V + (FULL_CELL_V - EMPTY_CELL_V) * vehicle.battery


def _current(vehicle: SimVehicle) -> float:
    if not vehicle.armed:
        return 0.3
    return 1.5 if vehicle.on_ground else HOVER_CURRENT_A

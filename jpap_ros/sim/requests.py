"""What peers ask a vehicle for: message rates, single messages, parameters, missions, the time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.sim.channel import Channel
from jpap_ros.sim.commands import ACCEPTED, DENIED, FAILED, Command
from jpap_ros.sim.telemetry import BUILDERS

if TYPE_CHECKING:
    from jpap_ros.sim.vehicle import SimVehicle

#: MESSAGE_INTERVAL has 16 bits for it.
_GREATEST_MESSAGE_ID = 0xFFFF
_LONGEST_INTERVAL_US = 0x7FFFFFFF

#: What a REQUEST_DATA_STREAM asks for, by stream.
_STREAMS: dict[int, tuple[int, ...]] = {
    mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: (
        mavlink.MAVLINK_MSG_ID_SYS_STATUS,
        mavlink.MAVLINK_MSG_ID_GPS_RAW_INT,
        mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT,
    ),
    mavlink.MAV_DATA_STREAM_POSITION: (
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    ),
    mavlink.MAV_DATA_STREAM_EXTRA1: (mavlink.MAVLINK_MSG_ID_ATTITUDE,),
    mavlink.MAV_DATA_STREAM_EXTRA2: (mavlink.MAVLINK_MSG_ID_VFR_HUD,),
    mavlink.MAV_DATA_STREAM_EXTRA3: (
        mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
        mavlink.MAVLINK_MSG_ID_BATTERY_STATUS,
        mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
    ),
}


def _set_message_interval(vehicle: SimVehicle, command: Command, channel: Channel) -> int:
    kind, interval_us = command.integer(1), command.param(2)
    if kind not in BUILDERS:
        return DENIED
    if not -1.0 <= interval_us <= _LONGEST_INTERVAL_US or 0.0 < interval_us < 1000.0:
        return DENIED
    if interval_us == 0.0:
        channel.restore(kind, vehicle.now)
    else:
        channel.set_interval(kind, interval_us / 1e6 if interval_us > 0.0 else None, vehicle.now)
    return ACCEPTED


def _get_message_interval(vehicle: SimVehicle, command: Command, channel: Channel) -> int:
    kind = command.integer(1)
    if not 0 <= kind <= _GREATEST_MESSAGE_ID:
        return DENIED
    interval = channel.interval(kind)
    interval_us = 0 if kind not in BUILDERS else -1 if interval is None else round(interval * 1e6)
    channel.put(mavlink.MAVLink_message_interval_message(kind, interval_us))
    return ACCEPTED


def _request_message(vehicle: SimVehicle, command: Command, channel: Channel) -> int:
    builder = BUILDERS.get(command.integer(1))
    if builder is None:
        return vehicle.UNKNOWN_REQUEST_RESULT
    message = builder(vehicle)
    if message is None:
        return FAILED
    channel.put(message)
    return ACCEPTED


def _request_capabilities(vehicle: SimVehicle, command: Command, channel: Channel) -> int:
    channel.put(BUILDERS[mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION](vehicle))
    return ACCEPTED


def _get_home_position(vehicle: SimVehicle, command: Command, channel: Channel) -> int:
    message = BUILDERS[mavlink.MAVLINK_MSG_ID_HOME_POSITION](vehicle)
    if message is None:
        return DENIED
    channel.put(message)
    return ACCEPTED


def _request_data_stream(vehicle: SimVehicle, message: Any, channel: Channel) -> None:
    for stream, kinds in _STREAMS.items():
        if message.req_stream_id in (mavlink.MAV_DATA_STREAM_ALL, stream):
            for kind in kinds:
                wanted = message.start_stop == 1 and message.req_message_rate > 0
                interval = 1.0 / message.req_message_rate if wanted else None
                channel.set_interval(kind, interval, vehicle.now)


def _parameter(vehicle: SimVehicle, message: Any, channel: Channel) -> None:
    for answer in vehicle.parameters.answer(message):
        channel.put(answer)


def _mission_request_list(vehicle: SimVehicle, message: Any, channel: Channel) -> None:
    target = (message.get_srcSystem(), message.get_srcComponent())
    channel.put(mavlink.MAVLink_mission_count_message(*target, 0, message.mission_type))


def _mission_write(vehicle: SimVehicle, message: Any, channel: Channel) -> None:
    target = (message.get_srcSystem(), message.get_srcComponent())
    channel.put(mavlink.MAVLink_mission_ack_message(*target, mavlink.MAV_MISSION_UNSUPPORTED, message.mission_type))


def _timesync(vehicle: SimVehicle, message: Any, channel: Channel) -> None:
    if message.tc1 == 0:
        channel.put(mavlink.MAVLink_timesync_message(int(vehicle.clock_s * 1e9), message.ts1))


#: Commands that ask for something, by MAV_CMD.
REQUESTS: Mapping[int, Callable[[SimVehicle, Command, Channel], int]] = {
    mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: _set_message_interval,
    mavlink.MAV_CMD_GET_MESSAGE_INTERVAL: _get_message_interval,
    mavlink.MAV_CMD_REQUEST_MESSAGE: _request_message,
    mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: _request_capabilities,
    mavlink.MAV_CMD_GET_HOME_POSITION: _get_home_position,
}

#: Other messages that ask for something, by name.
QUESTIONS: Mapping[str, Callable[[SimVehicle, Any, Channel], None]] = {
    "REQUEST_DATA_STREAM": _request_data_stream,
    "PARAM_REQUEST_LIST": _parameter,
    "PARAM_REQUEST_READ": _parameter,
    "PARAM_SET": _parameter,
    "MISSION_REQUEST_LIST": _mission_request_list,
    "MISSION_COUNT": _mission_write,
    "MISSION_CLEAR_ALL": _mission_write,
    "TIMESYNC": _timesync,
}

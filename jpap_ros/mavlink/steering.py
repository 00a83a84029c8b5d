"""What a ground station sends to steer a vehicle without a change of mode that its heartbeat would show."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.mavlink.autopilots import Autopilot

_COMMANDS = frozenset({mavlink.MAV_CMD_DO_REPOSITION, mavlink.MAV_CMD_DO_PAUSE_CONTINUE})
_TARGETS = frozenset({"SET_POSITION_TARGET_GLOBAL_INT", "SET_POSITION_TARGET_LOCAL_NED"})

_ITEMS = frozenset({"MISSION_ITEM", "MISSION_ITEM_INT"})
#: In `current`: not an item of a mission but ArduPilot's older way to send a target, or a height, in GUIDED.
_GUIDED_ITEM = (2, 3)


def steers(message: Any, autopilot: Autopilot, mode: str) -> bool:
    """Whether a message makes a vehicle in `mode` do something else in that very mode.

    A target, a pause, or the mode asked for that it is in, e.g. Hold while it flies to goals in Hold
    (`transport: reposition` on PX4). Any other change of mode shows in the heartbeat.
    """
    kind = message.get_type()
    if kind in _TARGETS:
        return True
    if kind in _ITEMS:
        return message.current in _GUIDED_ITEM
    if kind == "SET_MODE":
        return autopilot.mode_name(message.custom_mode) == mode
    if kind not in ("COMMAND_LONG", "COMMAND_INT"):
        return False
    if message.command == mavlink.MAV_CMD_DO_SET_MODE and mode:
        asked = autopilot.set_mode(mode).params[1:]
        return (message.param2, message.param3)[: len(asked)] == asked
    return message.command in _COMMANDS

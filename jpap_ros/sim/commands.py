"""MAVLink commands as a simulated vehicle receives them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

ACCEPTED: int = mavlink.MAV_RESULT_ACCEPTED
DENIED: int = mavlink.MAV_RESULT_DENIED
FAILED: int = mavlink.MAV_RESULT_FAILED
TEMPORARILY_REJECTED: int = mavlink.MAV_RESULT_TEMPORARILY_REJECTED
UNSUPPORTED: int = mavlink.MAV_RESULT_UNSUPPORTED
COMMAND_LONG_ONLY: int = mavlink.MAV_RESULT_COMMAND_LONG_ONLY
COMMAND_INT_ONLY: int = mavlink.MAV_RESULT_COMMAND_INT_ONLY

#: param2 of MAV_CMD_COMPONENT_ARM_DISARM that overrides all checks.
FORCE_ARM_MAGIC = 21196


@dataclass(frozen=True)
class Command:
    """A COMMAND_LONG or COMMAND_INT.

    Attributes
    ----------
    command : int
        MAV_CMD.
    params : tuple of float
        param1 to param7; of a COMMAND_INT the fifth and sixth are x and y as they came (degrees · 1e7).
    source : tuple of int
        System and component id of the sender.
    is_int : bool
    frame : int
        MAV_FRAME of a COMMAND_INT; 0 for a COMMAND_LONG.
    """

    command: int
    params: tuple[float, ...]
    source: tuple[int, int]
    is_int: bool = False
    frame: int = 0

    @classmethod
    def of(cls, message: Any) -> Command:
        """Read a message."""
        source = (message.get_srcSystem(), message.get_srcComponent())
        first = (message.param1, message.param2, message.param3, message.param4)
        if message.get_type() == "COMMAND_INT":
            return cls(message.command, (*first, message.x, message.y, message.z), source, True, message.frame)
        return cls(message.command, (*first, message.param5, message.param6, message.param7), source)

    def param(self, number: int) -> float:
        """param1 to param7."""
        return self.params[number - 1]

    def integer(self, number: int) -> int:
        """A parameter that stands for a whole number; 0 where it is not finite."""
        value = self.params[number - 1]
        return int(value) if math.isfinite(value) else 0

    def lat_lon(self) -> tuple[float, float]:
        """Latitude and longitude [deg] of the fifth and sixth parameter; NaN where not given."""
        x, y = self.params[4], self.params[5]
        if not self.is_int:
            return x, y
        # INT32_MAX stands for "use the present one" in the integer fields.
        if x == 0x7FFFFFFF or y == 0x7FFFFFFF:
            return float("nan"), float("nan")
        return x / 1e7, y / 1e7

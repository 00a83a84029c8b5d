"""The parameter protocol, for the handful of parameters that a simulated autopilot has."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

INT32, REAL32 = mavlink.MAV_PARAM_TYPE_INT32, mavlink.MAV_PARAM_TYPE_REAL32


class ParameterTable:
    """Parameters by name, in a fixed order; whole numbers are INT32, others REAL32.

    Parameters
    ----------
    defaults : mapping of str to int or float
    bytewise : bool
        Whole numbers travel as the float with the same bits (PX4) and not as the float of the same value (ArduPilot).
    """

    def __init__(self, defaults: Mapping[str, int | float], bytewise: bool) -> None:
        self._values = dict(defaults)
        self._names = list(defaults)
        self._bytewise = bytewise

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def answer(self, message: Any) -> list[Any]:
        """The PARAM_VALUEs that answer a PARAM_REQUEST_LIST, PARAM_REQUEST_READ or PARAM_SET."""
        kind = message.get_type()
        if kind == "PARAM_REQUEST_LIST":
            return [self._message(i) for i in range(len(self._names))]
        if kind == "PARAM_REQUEST_READ" and message.param_index >= 0:
            return [self._message(message.param_index)] if message.param_index < len(self._names) else []
        name = message.param_id.rstrip("\0")
        if name not in self._values:
            return []
        if kind == "PARAM_SET":
            self._values[name] = self._decode(name, message.param_value)
        return [self._message(self._names.index(name))]

    def _decode(self, name: str, wire: float) -> int | float:
        whole = isinstance(self._values[name], int)
        if whole and self._bytewise:
            return _int_of_bits(wire)
        if not math.isfinite(wire):
            return self._values[name]
        return round(wire) if whole else wire

    def _message(self, index: int) -> Any:
        name = self._names[index]
        value = self._values[name]
        whole = isinstance(value, int)
        wire = _float_of_bits(value) if isinstance(value, int) and self._bytewise else float(value)
        return mavlink.MAVLink_param_value_message(
            name.encode(), wire, INT32 if whole else REAL32, len(self._names), index
        )


def _float_of_bits(value: int) -> float:
    return float(struct.unpack("<f", struct.pack("<i", value))[0])


def _int_of_bits(value: float) -> int:
    return int(struct.unpack("<i", struct.pack("<f", value))[0])

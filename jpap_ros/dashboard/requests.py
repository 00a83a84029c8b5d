"""What a page may ask for, read from JSON that may be nonsense."""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

from jpap_ros.planning.devices import Device, find_fault

#: Longest message of a page [byte].
MAX_MESSAGE = 64 * 1024
MAX_ID = 64

#: Actions that concern aircraft, and the service of the bridge that does each. `give_back` returns an aircraft that
#: somebody has taken over to the planner's goals; in the air, that is what bridge/launch does.
ORDERS: Mapping[str, str] = {
    "launch": "launch",
    "hold": "hold",
    "return_home": "return_home",
    "land": "land",
    "give_back": "launch",
}


class RequestError(ValueError):
    """The request cannot be understood or is not allowed; the message names the field and the value."""


@dataclass(frozen=True)
class Hello:
    """First message of a page: who it is."""

    token: object


@dataclass(frozen=True)
class OrderRequest:
    """An action for some aircraft, a key of ORDERS."""

    action: str
    uavs: tuple[str, ...]


@dataclass(frozen=True)
class ReplanRequest:
    """Plan anew now."""


@dataclass(frozen=True)
class PutDevice:
    """A device joins or changes (exercise)."""

    device: Device


@dataclass(frozen=True)
class RemoveDevice:
    """A device leaves (exercise)."""

    id: str


Request = OrderRequest | ReplanRequest | PutDevice | RemoveDevice


def read_object(text: str) -> dict[str, Any]:
    """Read a JSON object; RequestError if it is none, or says NaN or Infinity."""
    try:
        data = json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise RequestError(f"the message is not JSON: {str(error)[:100]}") from None
    if not isinstance(data, dict):
        raise RequestError(f"the message must be an object, got {_short(data)}")
    return data


def read_hello(text: str) -> Hello:
    """Read the first message of a page."""
    data = read_object(text)
    if data.get("type") != "hello":
        raise RequestError(f"the first message must have type 'hello', got {_short(data.get('type'))}")
    return Hello(data.get("token"))


def number_of(data: Mapping[str, Any]) -> int | None:
    """Return the number by which the page knows its request, or None."""
    number = data.get("id")
    return number if type(number) is int and 0 <= number < 2**53 else None


def read_request(data: Mapping[str, Any], uavs: Collection[str], exercise: bool) -> Request:
    """Read a request.

    Parameters
    ----------
    data : mapping
    uavs : collection of str
        Names in the fleet file.
    exercise : bool
        Whether devices may be added, changed and removed by hand.

    Raises
    ------
    RequestError
        If any part is missing, unknown, of the wrong type or out of range.
    """
    if data.get("type") != "request":
        raise RequestError(f"type must be 'request', got {_short(data.get('type'))}")
    if number_of(data) is None:
        raise RequestError(f"id must be a whole number from 0, got {_short(data.get('id'))}")
    action = data.get("action")
    if isinstance(action, str) and action in ORDERS:
        return OrderRequest(action, _names(data.get("uavs"), uavs))
    if action == "replan":
        return ReplanRequest()
    if action in ("put_device", "remove_device"):
        if not exercise:
            raise RequestError(f"{action} needs the exercise mode: start the dashboard with exercise:=true")
        return (
            PutDevice(_device(data.get("device"))) if action == "put_device" else RemoveDevice(_id(data.get("device")))
        )
    known = ", ".join([*ORDERS, "replan", "put_device", "remove_device"])
    raise RequestError(f"action must be one of {known}; got {_short(action)}")


def _names(value: object, uavs: Collection[str]) -> tuple[str, ...]:
    # The bridge takes an empty list for all UAVs: a page that means all says so by naming them.
    if not isinstance(value, list) or not value:
        raise RequestError(f"uavs must be a list of at least one name, got {_short(value)}")
    for name in value:
        if not isinstance(name, str) or name not in uavs:
            raise RequestError(f"uavs: {_short(name)} is not in the fleet file")
    return tuple(dict.fromkeys(value))


def _device(value: object) -> Device:
    if not isinstance(value, dict):
        raise RequestError(f"device must be an object, got {_short(value)}")
    if unknown := value.keys() - {"id", "x", "y", "demand", "weight"}:
        raise RequestError(f"device: the unknown key {_short(min(unknown))}")
    position = (_number(value, "x"), _number(value, "y"))
    device = Device(_id(value.get("id")), position, _number(value, "demand"), _number(value, "weight", 1.0))
    if fault := find_fault(device):
        raise RequestError(str(fault))
    return device


def _id(value: object) -> str:
    if not isinstance(value, str) or not 0 < len(value) <= MAX_ID:
        raise RequestError(f"device id must be a text of 1 to {MAX_ID} characters, got {_short(value)}")
    if not value.isprintable() or value != value.strip():
        raise RequestError(f"device id must be printable without blanks at its ends, got {_short(value)}")
    return value


def _number(data: Mapping[str, Any], key: str, otherwise: float | None = None) -> float:
    value = data.get(key, otherwise)
    # bool is an int in Python, but no number on a page; an int may be too long for a float.
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise RequestError(f"device {key} must be a number, got {_short(value)}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise RequestError(f"device {key} must be finite, got {_short(value)}")
    return number


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is not JSON")


def _short(value: object) -> str:
    text = repr(value) if not isinstance(value, int) or abs(value) < 10**20 else "a huge number"
    return text if len(text) <= 60 else f"{text[:59]}…"

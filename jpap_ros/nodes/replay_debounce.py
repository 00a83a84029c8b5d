"""Has a planner wait for all that belongs to one plan, while it is told what it was once told over some time."""

from __future__ import annotations

import threading
from typing import Any

from rcl_interfaces.msg import Parameter, ParameterType
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.node import Node

#: Quiet time after an event before the planner plans [s]: longer than what two messages of one step are apart.
QUIET_S = 0.25
#: However long a step takes to tell, a stream of events must not begin a plan of its own [s].
_LONGEST_S = 600.0
_PATIENCE_S = 10.0
_NAMES = ("debounce_s", "debounce_max_s")


class LongDebounce:
    """Raises the debounce times of a planner, and sets them back.

    Not for the executor's thread, which completes the calls.

    Parameters
    ----------
    node : Node
        Spinning.
    planner : str
        Full name of the planner's node.
    """

    def __init__(self, node: Node, planner: str) -> None:
        self._get = node.create_client(GetParameters, f"{planner}/get_parameters")
        self._set = node.create_client(SetParameters, f"{planner}/set_parameters")
        self._before: list[Parameter] = []

    def hold(self) -> bool:
        """Raise them; False if the planner cannot be asked, or refuses."""
        got = _call(self._get, GetParameters.Request(names=list(_NAMES)))
        if got is None or [value.type for value in got.values] != [ParameterType.PARAMETER_DOUBLE] * len(_NAMES):
            return False
        before = [Parameter(name=name, value=value) for name, value in zip(_NAMES, got.values, strict=True)]
        if not self._put([_longer(*pair) for pair in zip(before, (QUIET_S, _LONGEST_S), strict=True)]):
            return False
        self._before = before
        return True

    def release(self) -> bool:
        """Set them back; False if that failed."""
        return not self._before or self._put(self._before)

    def _put(self, parameters: list[Parameter]) -> bool:
        answer = _call(self._set, SetParameters.Request(parameters=parameters))
        return answer is not None and all(result.successful for result in answer.results)


def _longer(parameter: Parameter, least_s: float) -> Parameter:
    value = type(parameter.value)(type=parameter.value.type, double_value=max(parameter.value.double_value, least_s))
    return Parameter(name=parameter.name, value=value)


def _call(client: Any, request: Any) -> Any:
    """Return the service's response, or None if there is none in time."""
    if not client.wait_for_service(_PATIENCE_S):
        return None
    answered = threading.Event()
    future = client.call_async(request)
    future.add_done_callback(lambda _: answered.set())
    return future.result() if answered.wait(_PATIENCE_S) else None

"""Parameters with description, type and range, declared in one line each and checked at start and at run time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter


class StartError(Exception):
    """The node cannot start; the message is the one line that the user sees."""


@dataclass(frozen=True)
class Param:
    """One parameter of a node.

    Attributes
    ----------
    name : str
    default : bool, int, float, str or list of str
        Gives the type as well.
    description : str
        With the unit in brackets.
    low, high : float, optional
        Inclusive range of a number.
    choices : sequence of str, optional
        Allowed values of a string.
    check : callable, optional
        Called with the value; returns what is wrong with it, or None.
    fixed : bool
        Cannot change while the node runs.
    """

    name: str
    default: Any
    description: str
    low: float | None = None
    high: float | None = None
    choices: Sequence[str] = ()
    check: Callable[[Any], str | None] | None = None
    fixed: bool = False

    def descriptor(self) -> ParameterDescriptor:
        """ROS description of the parameter."""
        descriptor = ParameterDescriptor(name=self.name, description=self.description, read_only=self.fixed)
        if self.choices:
            descriptor.additional_constraints = "one of " + ", ".join(self.choices)
        if self.low is not None and self.high is not None:
            if isinstance(self.default, int):
                descriptor.integer_range = [IntegerRange(from_value=int(self.low), to_value=int(self.high), step=0)]
            else:
                span = FloatingPointRange(from_value=float(self.low), to_value=float(self.high), step=0.0)
                descriptor.floating_point_range = [span]
        return descriptor

    def error(self, value: Any) -> str | None:
        """What is wrong with a value, or None."""
        if self.choices and value not in self.choices:
            return f"parameter {self.name} must be one of {', '.join(self.choices)}, got {value!r}"
        if isinstance(value, float) and not math.isfinite(value):
            return f"parameter {self.name} must be finite, got {value!r}"
        problem = self.check(value) if self.check else None
        return f"parameter {self.name}: {problem}" if problem else None


def declare(node: Node, params: Iterable[Param], changed: Callable[[dict[str, Any]], None] | None = None) -> None:
    """Declare parameters, and keep refusing bad values while the node runs.

    Parameters
    ----------
    node : Node
    params : iterable of Param
    changed : callable, optional
        Called after a change was accepted, with the new values by name.

    Raises
    ------
    StartError
        If a value given at start is wrong; names the parameter and the value.
    """
    table = {param.name: param for param in params}
    for param in table.values():
        try:
            value = node.declare_parameter(param.name, param.default, param.descriptor()).value
        except ParameterException as error:
            raise StartError(" ".join(str(error).split())) from None
        if problem := param.error(value):
            raise StartError(problem)

    def refuse(parameters: list[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            known = table.get(parameter.name)
            if known and (problem := known.error(parameter.value)):
                return SetParametersResult(successful=False, reason=problem)
        return SetParametersResult(successful=True)

    def accepted(parameters: list[Parameter]) -> None:
        values = {p.name: p.value for p in parameters if p.name in table}
        if changed and values:
            changed(values)

    node.add_on_set_parameters_callback(refuse)
    node.add_post_set_parameters_callback(accepted)


def values(node: Node, params: Iterable[Param]) -> dict[str, Any]:
    """Present values of declared parameters, by name."""
    return {param.name: node.get_parameter(param.name).value for param in params}


def fleet_file() -> Param:
    """Return the parameter that every node shares; its default is the example that comes with the package."""
    try:
        share = Path(get_package_share_directory("jpap_ros"))
    except PackageNotFoundError as error:
        raise StartError(f"{error}; source the workspace's setup file") from None
    return Param(
        "fleet_file",
        str(share / "config" / "fleet_example.yaml"),
        "Path of the fleet file (YAML), the same for planner, bridge and sim",
        fixed=True,
    )

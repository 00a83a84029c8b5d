"""Run one node as a process: start, spin, end with a clear line and the right exit status."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Sequence

import rclpy
from rclpy.exceptions import NameValidationException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.utilities import remove_ros_args

from jpap_ros.fleet.config import FleetFileError
from jpap_ros.nodes.parameters import StartError

_CANNOT_START = (StartError, FleetFileError, NameValidationException)
_WRONG_COMMAND_LINE = (rclpy_implementation.RCLError, rclpy_implementation.UnknownROSArgsError)


def run(make_node: Callable[[], Node], args: Sequence[str] | None = None) -> int:
    """Make a node and spin it until SIGINT or SIGTERM.

    Parameters
    ----------
    make_node : callable
        Called once ROS is up.
    args : sequence of str, optional
        The command line with the program's name first; default: that of this process.

    Returns
    -------
    int
        Exit status: 0 after a requested stop, 1 if the node could not start (one line on stderr says why), 2 if the
        command line was wrong.
    """
    command = list(sys.argv if args is None else args)
    try:
        rclpy.init(args=command)
    except _WRONG_COMMAND_LINE as error:
        return _fail(2, str(error))
    node = None
    try:
        if unknown := remove_ros_args(command)[1:]:
            return _fail(2, f"unknown argument {unknown[0]!r}; parameters follow --ros-args, e.g. -p name:=value")
        node = make_node()
        # All that is there now stays: looking through it again for garbage would hold everything up for tens of ms.
        gc.collect()
        gc.freeze()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except Exception as error:
        # A signal shuts ROS down at once, so that whatever a callback or the start was just doing fails: no fault.
        if rclpy.ok():
            if isinstance(error, _CANNOT_START):
                return _fail(1, str(error))
            raise
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _fail(status: int, why: str) -> int:
    sys.stderr.write(f"cannot start: {' '.join(why.split())}\n")
    return status

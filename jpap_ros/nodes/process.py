"""Run one node as a process: start, spin, end with a clear line and the right exit status."""

from __future__ import annotations

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

_EXPECTED = (StartError, FleetFileError, NameValidationException)


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
    node = None
    try:
        rclpy.init(args=command)
        if unknown := remove_ros_args(command)[1:]:
            return _fail(2, f"unknown argument {unknown[0]!r}; parameters follow --ros-args, e.g. -p name:=value")
        node = make_node()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        executor.spin()
    except _EXPECTED as error:
        return _fail(1, str(error))
    except (rclpy_implementation.RCLError, rclpy_implementation.UnknownROSArgsError) as error:
        if node is not None:
            raise
        return _fail(2, str(error))
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _fail(status: int, why: str) -> int:
    sys.stderr.write(f"cannot start: {' '.join(why.split())}\n")
    return status

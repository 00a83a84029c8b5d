"""Run one node as a process: start, spin, end with a clear line and the right exit status."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

from jpap_ros.fleet.config import FleetFileError
from jpap_ros.nodes.parameters import StartError


def run(make_node: Callable[[], Node], args: Sequence[str] | None = None) -> int:
    """Make a node and spin it until SIGINT or SIGTERM.

    Returns
    -------
    int
        Exit status: 0 after a requested stop, 1 if the node could not start (one line on stderr says why).
    """
    rclpy.init(args=None if args is None else list(args))
    node = None
    try:
        node = make_node()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        executor.spin()
    except (StartError, FleetFileError) as error:
        sys.stderr.write(f"cannot start: {error}\n")
        return 1
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0

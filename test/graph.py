"""A test's own place in the ROS graph: real nodes as processes, real topics and services, waiting on conditions."""

from __future__ import annotations

import ctypes
import json
import os
import signal
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import rclpy
from ament_index_python.packages import get_package_prefix
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile

#: Far beyond what anything here takes on an idle machine; only a failing test waits so long.
PATIENCE_S = 60.0

T = TypeVar("T")

_PR_SET_PDEATHSIG = 1
_libc = ctypes.CDLL(None)


class NodeProcess:
    """One installed executable of jpap_ros, run as `ros2 run` would, in a session of its own.

    Parameters
    ----------
    executable : str
        `planner`, `bridge` or `sim`.
    log : Path
        Where stdout and stderr go.
    parameters : mapping of str to object
        ROS parameters.
    namespace : str
        ROS namespace.
    arguments : sequence of str
        Further ROS arguments, e.g. `["--params-file", path]`.
    environment : mapping of str to str
        Added to this process's environment.
    """

    def __init__(
        self,
        executable: str,
        log: Path,
        parameters: Mapping[str, Any] | None = None,
        namespace: str = "",
        arguments: Sequence[str] = (),
        environment: Mapping[str, str] | None = None,
    ) -> None:
        command = [str(Path(get_package_prefix("jpap_ros")) / "lib" / "jpap_ros" / executable), "--ros-args"]
        for name, value in (parameters or {}).items():
            command += ["-p", f"{name}:={json.dumps(value)}"]
        if namespace:
            command += ["-r", f"__ns:={namespace}"]
        self._log = log
        parent = os.getpid()

        def die_with_parent() -> None:
            # A test session that is killed must leave nobody behind in its ROS domain and on its ports.
            _libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
            if os.getppid() != parent:
                os._exit(1)

        with log.open("w") as sink:
            self.process = subprocess.Popen(
                [*command, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=sink,
                stderr=subprocess.STDOUT,
                env={**os.environ, "ROS_LOG_DIR": str(log.parent / "ros_log"), **(environment or {})},
                start_new_session=True,
                preexec_fn=die_with_parent,
            )

    @property
    def output(self) -> str:
        """Everything that it printed so far."""
        return self._log.read_text(errors="replace")

    def wait(self, timeout_s: float = PATIENCE_S) -> int:
        """Wait for its end; return the exit status."""
        return self.process.wait(timeout_s)

    def stop(self, how: signal.Signals = signal.SIGINT, timeout_s: float = PATIENCE_S) -> int:
        """Send a signal and wait for the end; return the exit status."""
        if self.process.poll() is None:
            self.process.send_signal(how)
        return self.wait(timeout_s)

    def kill(self) -> None:
        """End it at once, whatever it does; nothing of it is left behind."""
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait(PATIENCE_S)


class Graph:
    """A node in the test's own process, spun only while the test waits."""

    def __init__(self, name: str = "tester", namespace: str = "") -> None:
        self._context = Context()
        rclpy.init(context=self._context)
        self.node = Node(name, context=self._context, namespace=namespace)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)

    def add_node(self, node: Node) -> None:
        """Spin another node of this context as well."""
        self._executor.add_node(node)

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)

    def wait(self, condition: Callable[[], T], what: str, timeout_s: float = PATIENCE_S) -> T:
        """Spin until a condition gives something true, and return that; fail with `what` was waited for."""
        deadline = time.monotonic() + timeout_s
        while not (result := condition()):
            if time.monotonic() > deadline:
                raise AssertionError(f"waited {timeout_s:g} s in vain for: {what}")
            self._executor.spin_once(timeout_sec=0.05)
        return result

    def spin(self, seconds: float) -> None:
        """Spin for a time: only to see that something does NOT happen."""
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=left)

    def collect(self, kind: type, topic: str, qos: QoSProfile | int = 10) -> list[Any]:
        """Subscribe; the list returned grows with every message."""
        messages: list[Any] = []
        self.node.create_subscription(kind, topic, messages.append, qos)
        return messages

    def publisher(self, kind: type, topic: str, qos: QoSProfile | int = 10, readers: int = 1) -> Publisher:
        """Make a publisher and wait until so many subscriptions match it."""
        publisher = self.node.create_publisher(kind, topic, qos)
        self.wait(lambda: publisher.get_subscription_count() >= readers, f"{readers} reader(s) of {topic}")
        return publisher

    def call(self, kind: type, service: str, request: Any = None, timeout_s: float = PATIENCE_S) -> Any:
        """Call a service once it is there; return its response."""
        client = self.node.create_client(kind, service)
        try:
            self.wait(client.service_is_ready, f"service {service}", timeout_s)
            future = client.call_async(kind.Request() if request is None else request)
            self.wait(future.done, f"answer of {service}", timeout_s)
            return future.result()
        finally:
            self.node.destroy_client(client)

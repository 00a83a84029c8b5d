"""Shared by all tests: isolation from every other ROS graph and socket on the machine."""

from __future__ import annotations

import fcntl
import os
import socket
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from graph import Graph, NodeProcess

# Above 101 the DDS ports reach the range that Linux hands out to clients.
DOMAINS = range(1, 102)


@pytest.fixture(scope="session")
def ros_domain() -> Iterator[int]:
    """A ROS_DOMAIN_ID that no other test session or worker uses now; set in the environment as well."""
    for domain in DOMAINS:
        lock = (Path(tempfile.gettempdir()) / f"jpap_ros_domain_{domain}.lock").open("w")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.close()
            continue
        os.environ["ROS_DOMAIN_ID"] = str(domain)
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        yield domain
        lock.close()
        return
    pytest.fail(f"every ROS domain from {DOMAINS[0]} to {DOMAINS[-1]} is in use")


@pytest.fixture
def free_ports() -> Callable[[int], list[int]]:
    """Return a function that finds n ports free for both UDP and TCP on loopback."""

    def find(count: int) -> list[int]:
        held, ports = [], []
        while len(ports) < count:
            tcp = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
            udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            held += [tcp, udp]
            tcp.bind(("127.0.0.1", 0))
            port = tcp.getsockname()[1]
            try:
                udp.bind(("127.0.0.1", port))
            except OSError:
                continue
            ports.append(port)
        for sock in held:
            sock.close()
        return ports

    return find


@pytest.fixture
def graph(ros_domain: int) -> Iterator[Graph]:
    """Return the test's own node in an isolated ROS graph."""
    from graph import Graph

    own = Graph()
    yield own
    own.close()


@pytest.fixture
def start_node(ros_domain: int, tmp_path: Path) -> Iterator[Callable[..., NodeProcess]]:
    """Return a function that starts an executable, as `NodeProcess` does; all end with the test."""
    from graph import NodeProcess

    started: list[NodeProcess] = []

    def start(executable: str, *args: Any, **kwargs: Any) -> NodeProcess:
        started.append(NodeProcess(executable, tmp_path / f"{len(started)}_{executable}.log", *args, **kwargs))
        return started[-1]

    yield start
    for process in started:
        process.kill()

"""Shared by all tests: isolation from every other ROS graph and socket on the machine."""

from __future__ import annotations

import itertools
import os
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from jpap_ros.demo.own_graph import DOMAINS, own_graph

if TYPE_CHECKING:
    from graph import Graph, NodeProcess

PORTS = range(61_000, 65_536)


@pytest.fixture(scope="session")
def ros_domain() -> Iterator[int]:
    """A ROS_DOMAIN_ID that no other test session or worker uses now; set in the environment as well."""
    os.environ.pop("ROS_DOMAIN_ID", None)
    with own_graph() as domain:
        yield domain


@pytest.fixture(scope="session")
def own_ports(ros_domain: int) -> Iterator[int]:
    """Ports that belong to this session, round and round.

    They lie above those that Linux hands out to clients, in a part for each domain: nobody else is given one between
    a test's look at it and its use.
    """
    each = len(PORTS) // len(DOMAINS)
    first = (ros_domain - DOMAINS[0]) * each
    return itertools.cycle(PORTS[first : first + each])


@pytest.fixture(scope="session")
def free_ports(own_ports: Iterator[int]) -> Callable[[int], list[int]]:
    """Return a function that finds n ports free for both UDP and TCP on loopback."""

    def is_free(port: int) -> bool:
        for kind in (socket.SOCK_STREAM, socket.SOCK_DGRAM):
            with socket.socket(socket.AF_INET, kind) as sock:
                try:
                    sock.bind(("127.0.0.1", port))
                except OSError:
                    return False
        return True

    def find(count: int) -> list[int]:
        found: list[int] = []
        for port in itertools.islice(own_ports, len(PORTS)):
            if len(found) == count:
                return found
            if port not in found and is_free(port):
                found.append(port)
        pytest.fail(f"found only {len(found)} of {count} free ports")

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

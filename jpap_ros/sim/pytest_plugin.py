"""Simulated vehicles for the tests of others: `pytest_plugins = ["jpap_ros.sim.pytest_plugin"]`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

from jpap_ros.sim.fleet import SimFleet


@pytest.fixture
def sim_fleet() -> Iterator[Callable[..., SimFleet]]:
    """Return a function that starts a `SimFleet` from its arguments; it is closed when the test ends."""
    with ExitStack() as running:
        yield lambda *args, **options: running.enter_context(SimFleet(*args, **options))

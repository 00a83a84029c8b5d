"""Transitions planned in another process. Oracle: `plan_transit`, called here with the same arguments."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import numpy as np
import pytest

from jpap_ros.fleet.transit import plan_transit
from jpap_ros.fleet.transit_plan import TransitLimits, TransitPlan
from jpap_ros.fleet.transit_worker import SMALL_FLEET, TransitWorker

LIMITS = TransitLimits()
PATIENCE_S = 60.0


@pytest.fixture
def worker() -> Iterator[TransitWorker]:
    made = TransitWorker()
    yield made
    made.close()


def line(count: int) -> tuple[dict[str, tuple[float, float, float]], dict[str, tuple[float, float, float]]]:
    places = {f"uav{i}": (30.0 * i, 0.0, 50.0) for i in range(count)}
    return places, {name: (east, 80.0, up) for name, (east, _, up) in places.items()}


def same(a: TransitPlan, b: TransitPlan) -> bool:
    return set(a.names) == set(b.names) and all(np.array_equal(a.path(name), b.path(name)) for name in a.names)


@pytest.mark.parametrize("count", [3, SMALL_FLEET + 3])
def test_the_plan_is_the_same_wherever_it_is_made(worker: TransitWorker, count: int) -> None:
    places, goals = line(count)
    expected = plan_transit(places, goals, LIMITS, (), [])
    assert set(expected.names) == set(places)
    # Twice: the process serves more than one request.
    for _ in range(2):
        assert same(worker.submit(places, goals, LIMITS, (), []).result(PATIENCE_S), expected)
    started = worker._process is not None
    assert started == (count > SMALL_FLEET)


def test_planning_goes_on_when_the_process_is_killed(worker: TransitWorker) -> None:
    places, goals = line(SMALL_FLEET + 1)
    expected = plan_transit(places, goals, LIMITS, (), [])
    assert same(worker.submit(places, goals, LIMITS, (), []).result(PATIENCE_S), expected)
    assert worker._process is not None
    os.kill(worker._process.pid, signal.SIGKILL)
    assert same(worker.submit(places, goals, LIMITS, (), []).result(PATIENCE_S), expected)


def test_wrong_input_is_told_and_does_not_end_the_process(worker: TransitWorker) -> None:
    places, goals = line(SMALL_FLEET + 1)
    with pytest.raises(RuntimeError, match="no transition"):
        worker.submit({**places, "uav0": (float("nan"), 0.0, 0.0)}, goals, LIMITS, (), []).result(PATIENCE_S)
    assert set(worker.submit(places, goals, LIMITS, (), []).result(PATIENCE_S).names) == set(places)

"""Plans from scratch in another process. Oracle: the same plan made in this one; the operating system for the rest."""

import os
import queue
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from jpap_ros.fleet.plan import full_deployment
from jpap_ros.fleet.plan_settings import PlanSettings
from jpap_ros.fleet.solver_process import Request, SolverError, SolverProcess
from jpap_ros.planning.devices import Device

PATIENCE_S = 60.0


def request(count=12, scheme="jpap", **settings):
    rng = np.random.default_rng(count)
    where, rates = rng.uniform(-500, 500, (count, 2)).tolist(), rng.uniform(15, 19, count).tolist()
    devices = tuple(Device(f"d{i}", (x, y), r) for i, ((x, y), r) in enumerate(zip(where, rates, strict=True)))
    return Request(devices, PlanSettings(scheme=scheme, **settings), 20)


@pytest.fixture
def solver():
    """Return a solver whose `answer()` waits for the next answer."""
    rung: queue.Queue[None] = queue.Queue()
    process = SolverProcess(lambda: rung.put(None))

    def answer():
        rung.get(timeout=PATIENCE_S)
        return process.take()

    process.answer = answer
    yield process
    process.close()


def children():
    """Process ids of this process's children that serve as solvers."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((path / "stat").read_text().rsplit(") ", 1)[1].split()[1])
            command = (path / "cmdline").read_text()
        except OSError:
            continue
        if parent == os.getpid() and "solver_process" in command:
            found.append(int(path.name))
    return found


def test_the_answer_is_the_plan_that_this_process_would_make(solver):
    asked = request()
    solver.submit(asked)
    answered, deployment = solver.answer()
    expected = full_deployment(asked.devices, asked.settings, asked.uavs)
    assert answered == asked and solver.take() is None
    assert np.array_equal(deployment.uav_positions, expected.uav_positions)
    assert np.array_equal(deployment.serving_uav, expected.serving_uav)
    assert np.array_equal(deployment.power_w, expected.power_w)
    assert deployment.uavs_needed == expected.uavs_needed


def test_one_process_answers_many_and_ends_when_closed(solver):
    pids = set()
    for count in (5, 6, 7):
        solver.submit(request(count))
        assert len(solver.answer()[1].serving_uav) == count
        pids |= set(children())
    assert len(pids) == 1
    solver.close()
    assert children() == []


def test_a_wrong_request_is_answered_with_the_error_and_the_next_one_works(solver):
    solver.submit(request(scheme="no_such_scheme"))
    error = solver.answer()[1]
    assert isinstance(error, SolverError) and "no_such_scheme" in str(error)
    solver.submit(request())
    assert not isinstance(solver.answer()[1], SolverError)


def test_a_killed_process_is_an_error_and_the_next_request_starts_another(solver):
    solver.submit(request())
    solver.answer()
    (first,) = children()
    solver.submit(request(100, scheme="optimal", time_limit_s=60.0))
    os.kill(first, signal.SIGKILL)
    assert isinstance(solver.answer()[1], SolverError)
    solver.submit(request())
    assert not isinstance(solver.answer()[1], SolverError)
    assert children() and first not in children()


def test_it_ends_in_the_middle_of_solving_when_its_parent_is_killed():
    """A parent that is killed cannot close anything: the end of its pipe must be enough."""
    parent = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import sys, time; sys.path.insert(0, 'test')\n"
            "from test_solver_process import request; from jpap_ros.fleet.solver_process import SolverProcess\n"
            "solver = SolverProcess(print)\n"
            "solver.submit(request(100, scheme='optimal', time_limit_s=300.0))\n"
            "print(solver._process.pid, flush=True); time.sleep(300)",
        ],
        stdout=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[1],
    )
    try:
        child = int(parent.stdout.readline())
    finally:
        parent.kill()
        parent.wait()
        parent.stdout.close()
    deadline = time.monotonic() + PATIENCE_S
    while running(child):
        assert time.monotonic() < deadline, "the solver lives on without its parent"
        time.sleep(0.05)


def running(pid):
    """Whether a process exists and is not merely waiting to be reaped."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(") ", 1)[1][0] != "Z"
    except OSError:
        return False

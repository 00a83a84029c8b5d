"""Plans from scratch in a process of its own, so that seconds of solving hold up nothing else.

A thread would not do: a solver's C code keeps Python's interpreter lock, and every callback would wait for it.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import queue
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, BinaryIO

from jpap_ros.fleet.plan import full_deployment
from jpap_ros.fleet.plan_settings import PlanSettings
from jpap_ros.planning import Deployment
from jpap_ros.planning.devices import Device

#: Solving may take all of a core; whoever flies the aircraft goes first.
_NICENESS = 10


class SolverError(Exception):
    """The solver failed; the message says how."""


@dataclass(frozen=True)
class Request:
    """What to plan for: the arguments of `full_deployment`. Equal requests have equal answers."""

    devices: tuple[Device, ...]
    settings: PlanSettings
    uavs: int


class SolverProcess:
    """Answers one request at a time; the process starts with the first, and ends with this one's.

    Parameters
    ----------
    done : callable
        Called in a thread when an answer waits to be taken.
    """

    def __init__(self, done: Callable[[], None]) -> None:
        self._done = done
        self._answers: queue.SimpleQueue[tuple[Request, Deployment | SolverError]] = queue.SimpleQueue()
        self._process: subprocess.Popen[bytes] | None = None
        self._closing = False

    def submit(self, request: Request) -> None:
        """Begin to solve; only when the last request was answered."""
        if self._process is None or self._process.poll() is not None:
            self._process = subprocess.Popen(
                [sys.executable, "-m", __name__],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                # Ctrl-C in a terminal is for the node, which then closes this process's input.
                start_new_session=True,
            )
        threading.Thread(target=self._ask, args=(self._process, request), name="solver", daemon=True).start()

    def take(self) -> tuple[Request, Deployment | SolverError] | None:
        """Return an answered request; None if there is none."""
        try:
            return self._answers.get_nowait()
        except queue.Empty:
            return None

    def close(self) -> None:
        """End the process, whatever it is doing."""
        self._closing = True
        if self._process is not None:
            _end(self._process)

    def _ask(self, process: subprocess.Popen[bytes], request: Request) -> None:
        answer: Deployment | SolverError
        try:
            assert process.stdin is not None and process.stdout is not None
            pickle.dump(request, process.stdin)
            process.stdin.flush()
            answer = _unpacked(pickle.load(process.stdout))
        except (OSError, EOFError, ValueError, pickle.UnpicklingError) as error:
            _end(process)
            answer = SolverError(f"the solver's process ended: {error!r}")
        if not self._closing:
            self._answers.put((request, answer))
            self._done()


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()
    for pipe in (process.stdin, process.stdout):
        # Closing flushes, and there is nobody left to read.
        with contextlib.suppress(OSError):
            if pipe is not None:
                pipe.close()


def _packed(deployment: Deployment) -> dict[str, Any]:
    # A read-only mapping cannot be pickled.
    return {f.name: getattr(deployment, f.name) for f in fields(deployment)} | {"unserved": dict(deployment.unserved)}


def _unpacked(answer: dict[str, Any] | str) -> Deployment | SolverError:
    return SolverError(answer) if isinstance(answer, str) else Deployment(**answer)


def serve(requests: BinaryIO, answers: BinaryIO) -> None:
    """Answer pickled requests until the input ends, and then exit even in the middle of one."""
    waiting: queue.SimpleQueue[Request] = queue.SimpleQueue()

    def read() -> None:
        with contextlib.suppress(EOFError, OSError):
            while True:
                waiting.put(pickle.load(requests))
        os._exit(0)

    threading.Thread(target=read, daemon=True).start()
    while True:
        request = waiting.get()
        answer: dict[str, Any] | str
        try:
            answer = _packed(full_deployment(request.devices, request.settings, request.uavs))
        except Exception as error:
            answer = f"{type(error).__name__}: {error}"
        pickle.dump(answer, answers)
        answers.flush()


def main() -> None:
    """Serve the parent process through stdin and stdout."""
    os.nice(_NICENESS)
    answers = os.fdopen(os.dup(1), "wb")
    # Whatever a solver prints must not get among the answers.
    os.dup2(2, 1)
    serve(sys.stdin.buffer, answers)


if __name__ == "__main__":
    main()

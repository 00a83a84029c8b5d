"""Transitions of a large fleet in a process of its own, so that planning them does not hold up the setpoints.

A thread alone would not do: planning is Python, and whoever sends setpoints would wait for the interpreter's lock at
every datagram.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import BinaryIO

from jpap_ros.fleet.transit import plan_transit
from jpap_ros.fleet.transit_plan import Convoy, Obstacle, TransitLimits, TransitPlan

Vector = tuple[float, float, float]
#: A fleet up to here is planned for in milliseconds, sooner than a process could be asked.
SMALL_FLEET = 12
#: Whoever flies the aircraft goes first.
_NICENESS = 5


class TransitWorker:
    """Answers `plan_transit` one request at a time; the process starts with `prepare`, or the first that needs it."""

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="traffic")
        self._process: subprocess.Popen[bytes] | None = None
        self._prepared = False

    def prepare(self) -> None:
        """Start the process, which takes a second, before it is needed."""
        if not self._prepared:
            self._prepared = True
            self._thread.submit(self._ask, pickle.dumps(({}, {}, TransitLimits())))

    def submit(
        self,
        places: Mapping[str, Vector],
        goals: Mapping[str, Vector],
        limits: TransitLimits,
        obstacles: Sequence[Obstacle],
        committed: Sequence[Convoy],
    ) -> Future[TransitPlan]:
        """Begin to plan a transition; arguments as for `plan_transit`."""
        request = dict(places), dict(goals), limits, tuple(obstacles), list(committed)
        if len(places) + len(committed) <= SMALL_FLEET:
            return self._thread.submit(plan_transit, *request)
        return self._thread.submit(self._ask, pickle.dumps(request))

    def close(self) -> None:
        """End the process, whatever it is doing, and the thread."""
        if self._process is not None:
            self._process.kill()
        self._thread.shutdown(wait=True, cancel_futures=True)
        if self._process is not None:
            _end(self._process)

    def _ask(self, request: bytes) -> TransitPlan:
        if self._process is None or self._process.poll() is not None:
            self._process = subprocess.Popen(
                [sys.executable, "-m", __name__],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                # Ctrl-C in a terminal is for the node, which then closes this one.
                start_new_session=True,
            )
        process = self._process
        assert process.stdin is not None and process.stdout is not None
        try:
            process.stdin.write(request)
            process.stdin.flush()
            plan, error = pickle.load(process.stdout)
        except (OSError, EOFError, ValueError, pickle.UnpicklingError):
            _end(process)
            # Slower for everybody, but the aircraft get on.
            return plan_transit(*pickle.loads(request))
        if error is not None:
            raise RuntimeError(f"no transition: {error}")
        return TransitPlan(plan.convoys, plan.held)


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()
    for pipe in (process.stdin, process.stdout):
        # Closing flushes, and there is nobody left to read.
        with contextlib.suppress(OSError):
            if pipe is not None:
                pipe.close()


def serve(requests: BinaryIO, answers: BinaryIO) -> None:
    """Answer pickled requests until the input ends."""
    while True:
        try:
            request = pickle.load(requests)
        except EOFError:
            return
        answer: tuple[TransitPlan | None, str | None]
        try:
            answer = plan_transit(*request), None
        except Exception as error:
            answer = None, f"{type(error).__name__}: {error}"
        pickle.dump(answer, answers)
        answers.flush()


def main() -> None:
    """Serve the parent process through stdin and stdout."""
    os.nice(_NICENESS)
    serve(sys.stdin.buffer, sys.stdout.buffer)


if __name__ == "__main__":
    main()

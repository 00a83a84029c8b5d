"""A thread that does one slow job at a time, so that callbacks stay short."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

Job = TypeVar("Job")
Result = TypeVar("Result")


class Worker(Generic[Job, Result]):
    """Runs `work(job)` in a thread of its own.

    Parameters
    ----------
    name : str
        Of the thread.
    work : callable
        Called in the thread with each job, in the order of submission.
    done : callable
        Called in the thread when a result waits to be taken; must be thread-safe.
    """

    def __init__(self, name: str, work: Callable[[Job], Result], done: Callable[[], None]) -> None:
        self._work = work
        self._done = done
        self._jobs: queue.SimpleQueue[Job | None] = queue.SimpleQueue()
        self._results: queue.SimpleQueue[tuple[Job, Result | Exception]] = queue.SimpleQueue()
        self._stopping = False
        # A daemon: an endless job must not keep the process from ending.
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def submit(self, job: Job) -> None:
        """Add a job; returns at once."""
        self._jobs.put(job)

    def take(self) -> tuple[Job, Result | Exception] | None:
        """Return a finished job with its result, or with what it raised; None if there is none."""
        try:
            return self._results.get_nowait()
        except queue.Empty:
            return None

    def stop(self, timeout_s: float) -> bool:
        """Let the present job finish, drop the others; return whether the thread ended in time."""
        self._stopping = True
        self._jobs.put(None)
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None and not self._stopping:
            result: Result | Exception
            try:
                result = self._work(job)
            except Exception as error:
                result = error
            self._results.put((job, result))
            if not self._stopping:
                self._done()

"""The procedure that one aircraft goes through step by step, and those who wait for its outcome."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass

#: A sequence of steps: yields whenever it has to wait, returns what was done, raises ProcedureFailed.
Procedure = Generator[None, None, str]
Done = Callable[[bool, str], None]


class ProcedureFailed(Exception):
    """A procedure ended without success; the message says why."""


@dataclass(eq=False)
class _Running:
    """A procedure under way, and who waits for its outcome."""

    procedure: Procedure
    name: str
    waiting: list[Done]
    answer: str = ""

    def end(self, success: bool, message: str) -> None:
        waiting, self.waiting = self.waiting, []
        for done in waiting:
            done(success, message)


class ProcedureRunner:
    """Goes on with one procedure at a time."""

    def __init__(self) -> None:
        self._running: _Running | None = None

    def run(self, procedure: Procedure, done: Done, name: str) -> None:
        """Begin a procedure; another one under way ends as superseded."""
        self.stop(f"superseded by {name}")
        self._running = _Running(procedure, name, [done])

    def join(self, done: Done, name: str) -> bool:
        """Wait for the procedure of this name too, if it is under way: to begin anew would lose its turn."""
        running = self._running
        if running is None or running.name != name:
            return False
        running.waiting.append(done)
        if running.answer:
            running.end(True, running.answer)
        return True

    def answer(self, message: str) -> None:
        """Of a procedure: tell those who wait that it succeeds; what is left to do goes on."""
        if self._running is not None:
            self._running.answer = message
            self._running.end(True, message)

    def stop(self, reason: str) -> None:
        """End the procedure under way, if any, without success."""
        running, self._running = self._running, None
        if running is not None:
            running.procedure.close()
            running.end(False, reason)

    def step(self) -> None:
        """Take the next step of the procedure under way, if any."""
        running = self._running
        if running is None:
            return
        try:
            next(running.procedure)
        except StopIteration as end:
            self._running = None
            running.end(True, end.value)
        except ProcedureFailed as failure:
            self._running = None
            running.end(False, str(failure))

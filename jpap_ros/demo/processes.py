"""The demo's child processes: started apart from the terminal, watched, and all gone at the end whatever happens."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType

_PR_SET_PDEATHSIG = 1
_libc = ctypes.CDLL(None)


class ChildDied(Exception):
    """A child ended before it was asked to; the message says which, how, and its last words."""


class Children:
    """Named child processes, each with a log file; a context manager that stops them on the way out.

    Parameters
    ----------
    log_dir : Path
        Where each child's output goes, as `<name>.log`.
    """

    def __init__(self, log_dir: Path) -> None:
        self.log_dir = log_dir
        self._children: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, name: str, command: Sequence[str], env: Mapping[str, str] | None = None) -> None:
        """Start a child; `env` adds to the present environment."""
        parent = os.getpid()

        def die_with_parent() -> None:
            # Even a SIGKILL of the demo must leave no aircraft controller behind.
            _libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
            if os.getppid() != parent:
                os._exit(1)

        with (self.log_dir / f"{name}.log").open("wb") as log:
            self._children[name] = subprocess.Popen(
                list(command),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env={**os.environ, **(env or {})},
                # Ctrl-C reaches the demo alone, which then stops the children in order.
                start_new_session=True,
                preexec_fn=die_with_parent,
            )

    def check(self) -> None:
        """Raise ChildDied if one has ended."""
        for name, child in self._children.items():
            if child.poll() is not None:
                raise ChildDied(f"{name} ended with status {child.returncode}: {self.last_words(name)}")

    def last_words(self, name: str, lines: int = 5) -> str:
        """Return the end of a child's log."""
        text = (self.log_dir / f"{name}.log").read_text(errors="replace")
        return " | ".join(text.strip().splitlines()[-lines:]) or "it said nothing"

    def stop(self, patience_s: float = 10.0) -> dict[str, int]:
        """Ask all to end, the last started first; kill those that do not. Returns exit statuses by name."""
        statuses = {}
        for child in reversed(self._children.values()):
            if child.poll() is None:
                child.send_signal(signal.SIGINT)
        deadline = time.monotonic() + patience_s
        for name, child in self._children.items():
            try:
                child.wait(max(0.1, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()
            statuses[name] = child.returncode
        self._children.clear()
        return statuses

    def __enter__(self) -> Children:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.stop()

"""The web server's own thread with its event loop."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable

from jpap_ros.dashboard.server import DashboardServer


class ServerThread:
    """Runs a server until it is stopped or fails.

    Parameters
    ----------
    server : DashboardServer
    failed : callable
        Called on the server's thread when the server ends by a fault.

    Attributes
    ----------
    failure : BaseException or None
        The fault.
    """

    def __init__(self, server: DashboardServer, failed: Callable[[], None]) -> None:
        self.failure: BaseException | None = None
        self._server = server
        self._failed = failed
        self._begun = threading.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._task: asyncio.Task[None] | None = None
        self._thread = threading.Thread(target=self._run, name="dashboard server", daemon=True)

    def start(self) -> None:
        """Return once the server listens; OSError if it cannot."""
        self._thread.start()
        self._begun.wait()
        if self.failure is not None:
            raise self.failure

    def stop(self) -> None:
        """Stop the server and wait for its end."""
        if self._loop is not None and self._task is not None:
            # The loop may have ended by a fault.
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._task.cancel)
        if self._thread.ident is not None:
            self._thread.join()

    def _run(self) -> None:
        try:
            with contextlib.suppress(asyncio.CancelledError):
                asyncio.run(self._serve())
        except BaseException as error:
            self.failure = error
            if self._begun.is_set():
                self._failed()
        finally:
            self._begun.set()

    async def _serve(self) -> None:
        self._loop, self._task = asyncio.get_running_loop(), asyncio.current_task()
        try:
            await self._server.start()
            self._begun.set()
            await self._server.run()
        finally:
            await self._server.close()

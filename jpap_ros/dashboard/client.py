"""One open page: a short queue of what it is to be told, and the end of a page that does not read."""

from __future__ import annotations

import asyncio
import contextlib
import time

from aiohttp import WSCloseCode, web

#: Messages that may wait for a page to read; with more it is dropped, and connects anew if it lives.
MAX_WAITING = 50
#: Messages a second that a page may send on average, and at once.
_RATE, _BURST = 20.0, 40.0


class Client:
    """Sends to one page without ever waiting for it.

    Parameters
    ----------
    socket : web.WebSocketResponse
        Prepared.
    request : web.Request
        What it came with.
    """

    def __init__(self, socket: web.WebSocketResponse, request: web.Request) -> None:
        self.address = request.remote or "?"
        self.dropped = False
        #: Requests of the page that are being carried out.
        self.under_way = 0
        self._socket = socket
        self._transport = request.transport
        self._waiting: asyncio.Queue[str] = asyncio.Queue(MAX_WAITING)
        self._allowance, self._counted_s = _BURST, time.monotonic()
        self._sender = asyncio.create_task(self._send_all())

    def send(self, text: str) -> None:
        """Queue a message; drop the page if it reads too slowly."""
        try:
            self._waiting.put_nowait(text)
        except asyncio.QueueFull:
            self.dropped = True
            # Not a closing handshake: that would wait in the same full buffer.
            if self._transport is not None:
                self._transport.abort()

    def may_ask(self) -> bool:
        """Whether it stays within its rate of messages."""
        now = time.monotonic()
        self._allowance = min(_BURST, self._allowance + _RATE * (now - self._counted_s)) - 1.0
        self._counted_s = now
        return self._allowance >= 0.0

    async def say_goodbye(self) -> None:
        """Tell the page that the server ends; it may try again later."""
        await self._socket.close(code=WSCloseCode.GOING_AWAY, message=b"the dashboard was stopped")

    async def close(self) -> None:
        """Stop sending."""
        self._sender.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await self._sender

    async def _send_all(self) -> None:
        # A page that goes away while it is written to is no fault.
        with contextlib.suppress(ConnectionError):
            while True:
                await self._socket.send_str(await self._waiting.get())

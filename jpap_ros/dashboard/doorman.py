"""Who may connect: so many connections in all, and from one address no more than leave room for others."""

from __future__ import annotations

import asyncio

from aiohttp import web

#: TCP connections for each page allowed: a browser opens six to load the files.
CONNECTIONS_EACH = 8

_BUSY = b"too many connections; try again later\n"
_REFUSAL = (
    b"HTTP/1.1 503 Service Unavailable\r\nRetry-After: 10\r\nConnection: close\r\n"
    b"Content-Type: text/plain; charset=utf-8\r\nContent-Length: %d\r\n\r\n%s" % (len(_BUSY), _BUSY)
)


class Doorman(asyncio.Protocol):
    """Hands a new connection to the web server, or tells it that it is one too many and closes it.

    Parameters
    ----------
    server : web.Server
    max_clients : int
        Pages that may be open at once. One address may have half of all connections: pages through an SSH tunnel, and
        all those of the machine itself, come from the same.
    """

    def __init__(self, server: web.Server, max_clients: int) -> None:
        self._server = server
        self._most = CONNECTIONS_EACH * max_clients
        self._most_of_one = max(CONNECTIONS_EACH, self._most // 2)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Let it in, or not."""
        assert isinstance(transport, asyncio.Transport)
        others = [connection.transport for connection in self._server.connections]
        address = _address(transport)
        of_one = sum(other is not None and _address(other) == address for other in others)
        if len(others) >= self._most or of_one >= self._most_of_one:
            transport.write(_REFUSAL)
            transport.close()
            return
        # Whoever waits for a write waits until the system has all of it: what lies in a buffer here would keep the
        # connection of a reader that does not read for ever.
        transport.set_write_buffer_limits(high=0)
        handler = self._server()
        transport.set_protocol(handler)
        handler.connection_made(transport)


async def send_within(request: web.Request, response: web.StreamResponse, timeout_s: float) -> None:
    """Send a whole response; cut the connection if its reader takes longer."""

    async def send() -> None:
        await response.prepare(request)
        await response.write_eof()

    try:
        await asyncio.wait_for(send(), timeout_s)
    except asyncio.TimeoutError:
        if request.transport is not None:
            request.transport.abort()


def _address(transport: asyncio.BaseTransport) -> str:
    # None once the other end is gone.
    return str((transport.get_extra_info("peername") or [""])[0])

"""The web server: the page's files, and a WebSocket that tells what changes and takes what the operator orders."""

from __future__ import annotations

import asyncio
import json
import logging
import time
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Protocol

from aiohttp import WSCloseCode, WSMsgType, web

from jpap_ros.dashboard.access import Access
from jpap_ros.dashboard.assets import Asset, load_assets
from jpap_ros.dashboard.client import Client
from jpap_ros.dashboard.doorman import Doorman, send_within
from jpap_ros.dashboard.event_log import ERROR, INFO, WARNING
from jpap_ros.dashboard.fleet_view import FleetView
from jpap_ros.dashboard.inbox import Inbox
from jpap_ros.dashboard.records import count
from jpap_ros.dashboard.requests import (
    MAX_MESSAGE,
    ORDERS,
    OrderRequest,
    PutDevice,
    RemoveDevice,
    ReplanRequest,
    Request,
    RequestError,
    number_of,
    read_hello,
    read_object,
    read_request,
)
from jpap_ros.planning.devices import Device

_LOGGER = logging.getLogger(__name__)

#: Close codes of our own (4000 to 4999 are free for applications, RFC 6455 section 7.4.2).
WRONG_TOKEN, NONSENSE = 4401, 4400

#: A page has to say who it is within this time [s].
_HELLO_PATIENCE_S = 10.0
#: A wrong token is answered no sooner than this [s].
_WRONG_TOKEN_PAUSE_S = 1.0
#: Even when nothing changes, pages hear that the server lives [s].
_SIGN_OF_LIFE_S = 1.0
#: A connection that asks for nothing is closed [s].
_IDLE_S = 15
#: Whoever has not taken a file within this time is cut off [s].
_RESPONSE_PATIENCE_S = 10.0
#: Requests of one page that may be under way at once.
_MAX_UNDER_WAY = 8
#: Wrong messages in a row that a page is told of before it is dropped.
_MAX_FAULTS = 20


@dataclass(frozen=True)
class UavOutcome:
    """What came of an order for one aircraft."""

    uav: str
    ok: bool
    message: str


@dataclass(frozen=True)
class Outcome:
    """What came of a request."""

    ok: bool
    message: str
    results: tuple[UavOutcome, ...] = ()


class Operations(Protocol):
    """What pages can have done."""

    async def order(self, service: str, uavs: tuple[str, ...]) -> Outcome:
        """Have the bridge do something with aircraft; `service` is one of the values of ORDERS."""

    async def replan(self) -> Outcome:
        """Have the planner plan anew."""

    async def report(self, device: Device | None, departed: str | None) -> Outcome:
        """Report a device that joined or changed, or one that left."""


@dataclass(frozen=True)
class ServerSettings:
    """How the server runs.

    Attributes
    ----------
    host : str
    port : int
        0 for any that is free.
    update_rate_hz : float
    max_clients : int
        Pages open at once.
    exercise : bool
        Devices may be added, changed and removed by hand.
    tile_url : str
        Template of a tile server; empty for a map in metres.
    page : mapping
        Told to each page as it is.
    """

    host: str
    port: int
    update_rate_hz: float = 5.0
    max_clients: int = 32
    exercise: bool = False
    tile_url: str = ""
    page: Mapping[str, Any] = field(default_factory=dict)


class DashboardServer:
    """Serves pages on an asyncio loop.

    Parameters
    ----------
    settings : ServerSettings
    access : Access
    view : FleetView
        Used on the loop's thread only.
    inbox : Inbox
        Emptied before each update.
    operations : Operations
    """

    def __init__(
        self, settings: ServerSettings, access: Access, view: FleetView, inbox: Inbox, operations: Operations
    ) -> None:
        self._settings = settings
        self._access = access
        self._view = view
        self._inbox = inbox
        self._operations = operations
        self._assets = load_assets()
        self._headers = _security_headers(settings.tile_url)
        self._clients: set[Client] = set()
        self._under_way: set[asyncio.Task[None]] = set()
        self._server: asyncio.Server | None = None
        self._runner: web.AppRunner | None = None

    @property
    def open_pages(self) -> int:
        """How many pages are connected; may be read from any thread."""
        return len(self._clients)

    @property
    def port(self) -> int:
        """The port that it listens on."""
        assert self._server is not None
        port: int = self._server.sockets[0].getsockname()[1]
        return port

    async def start(self) -> None:
        """Listen; OSError if that cannot be."""
        app = web.Application(middlewares=[self._guard])
        app.router.add_get("/ws", self._serve_page)
        app.router.add_get("/{path:.*}", self._serve_asset)
        self._runner = web.AppRunner(app, access_log=None, keepalive_timeout=_IDLE_S, shutdown_timeout=1.0)
        await self._runner.setup()
        server, most = self._runner.server, self._settings.max_clients
        assert server is not None
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(lambda: Doorman(server, most), self._settings.host, self._settings.port)

    async def run(self) -> None:
        """Tell the pages what changes, until cancelled."""
        period_s = 1.0 / self._settings.update_rate_hz
        told_s = 0.0
        while True:
            await asyncio.sleep(period_s)
            self._inbox.drain()
            if not self._clients:
                continue
            delta = self._view.delta()
            if len(delta) > 2 or time.monotonic() - told_s >= _SIGN_OF_LIFE_S:
                told_s = time.monotonic()
                self._tell(delta)

    async def close(self) -> None:
        """Stop listening and say goodbye to the pages."""
        if self._server is not None:
            self._server.close()
        await asyncio.gather(*(client.say_goodbye() for client in self._clients))
        if self._runner is not None:
            await self._runner.cleanup()

    # HTTP

    @web.middleware
    async def _guard(
        self, request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
    ) -> web.StreamResponse:
        """Refuse what comes by a foreign name; tell the browser to load nothing from elsewhere; wait for no reader."""
        if problem := self._access.host_problem(request.headers.get("Host")):
            response: web.StreamResponse = web.Response(status=421, text=f"{problem}\n")
        else:
            try:
                response = await handler(request)
            except web.HTTPException as error:
                response = web.Response(status=error.status, text=f"{error.reason}\n")
        # Not so a page that was let in: it may stay.
        if not response.prepared:
            response.headers.update(self._headers)
            await send_within(request, response, _RESPONSE_PATIENCE_S)
        return response

    async def _serve_asset(self, request: web.Request) -> web.Response:
        asset: Asset | None = self._assets.get(request.path)
        if asset is None:
            raise web.HTTPNotFound
        headers = {"ETag": asset.etag, "Cache-Control": "no-cache"}
        if request.headers.get("If-None-Match") == asset.etag:
            return web.Response(status=304, headers=headers)
        return web.Response(body=asset.body, headers={**headers, "Content-Type": asset.content_type})

    # Pages

    async def _serve_page(self, request: web.Request) -> web.StreamResponse:
        if problem := self._access.origin_problem(request.headers.get("Origin"), request.headers.get("Host")):
            return web.Response(status=403, text=f"{problem}\n")
        socket = web.WebSocketResponse(heartbeat=20.0, max_msg_size=MAX_MESSAGE, compress=False, timeout=1.0)
        if not socket.can_prepare(request):
            return web.Response(status=426, text="this address is for WebSockets\n", headers={"Upgrade": "websocket"})
        await socket.prepare(request)
        if await self._admit(socket):
            await self._attend(socket, request)
        return socket

    async def _admit(self, socket: web.WebSocketResponse) -> bool:
        """Take the page's first message; close unless it may be told and obeyed."""
        try:
            first = await socket.receive(timeout=_HELLO_PATIENCE_S)
        except asyncio.TimeoutError:
            await _close(socket, NONSENSE, f"no first message within {_HELLO_PATIENCE_S:g} s")
            return False
        if first.type is not WSMsgType.TEXT:
            await _close(socket, NONSENSE, "the first message must be text")
            return False
        try:
            hello = read_hello(first.data)
        except RequestError as error:
            await _close(socket, NONSENSE, str(error))
            return False
        if not self._access.token_is_right(hello.token):
            if hello.token is not None:
                await asyncio.sleep(_WRONG_TOKEN_PAUSE_S)
            await _close(socket, WRONG_TOKEN, "a token is needed" if hello.token is None else "wrong token")
            return False
        # Only now: who has no token must not take the place of who has.
        if len(self._clients) >= self._settings.max_clients:
            full = f"{count(len(self._clients), 'page')} are open already, the most allowed"
            await _close(socket, WSCloseCode.TRY_AGAIN_LATER, full)
            return False
        return True

    async def _attend(self, socket: web.WebSocketResponse, request: web.Request) -> None:
        if not self._clients:
            # Nobody was told of what happened up to now; the snapshot says it all.
            self._inbox.drain()
            self._view.delta()
        client = Client(socket, request)
        page = {**self._settings.page, "exercise": self._settings.exercise, "tile_url": self._settings.tile_url}
        client.send(_json({**self._view.snapshot(), "page": page}))
        self._clients.add(client)
        faults = 0
        try:
            async for message in socket:
                if not client.may_ask():
                    await _close(socket, WSCloseCode.POLICY_VIOLATION, "too many messages a second")
                elif message.type is WSMsgType.TEXT and self._take(client, message.data):
                    faults = 0
                else:
                    faults += 1
                    if faults > _MAX_FAULTS:
                        await _close(socket, NONSENSE, f"more than {_MAX_FAULTS} wrong messages")
        finally:
            self._clients.discard(client)
            if client.dropped:
                self._view.log.add(WARNING, "node", f"dropped the page at {client.address}: it does not read")
            await client.close()

    def _take(self, client: Client, text: str) -> bool:
        """Begin what a page asks for, or answer why not; False if it makes no sense at all."""
        number = None
        try:
            data = read_object(text)
            number = number_of(data)
            request = read_request(data, self._view.names, self._settings.exercise)
        except RequestError as error:
            self._answer(client, number, Outcome(False, str(error)))
            return False
        if problem := self._problem(client, request):
            self._answer(client, number, Outcome(False, problem))
            return True
        client.under_way += 1
        # Kept here, not with the page: a launch goes on when the page that ordered it goes away.
        task = asyncio.create_task(self._carry_out(client, number, request))
        self._under_way.add(task)
        task.add_done_callback(self._under_way.discard)
        return True

    def _problem(self, client: Client, request: Request) -> str | None:
        """Say why a well-formed request cannot be carried out as things are, or None."""
        if client.under_way >= _MAX_UNDER_WAY:
            return f"{_MAX_UNDER_WAY} requests are under way already"
        if isinstance(request, OrderRequest) and request.action == "give_back":
            for name in request.uavs:
                vehicle = self._view.vehicles.get(name)
                if vehicle is None or not vehicle.taken_over:
                    return f"{name} was not taken over: there is nothing to give back"
                # On the ground bridge/launch would make it take off.
                if vehicle.landed != "in air":
                    return f"{name} is not in the air ({vehicle.landed}): launch it instead"
        if isinstance(request, RemoveDevice) and request.id not in self._view.devices:
            return f"device {request.id!r} is not there"
        return None

    async def _carry_out(self, client: Client, number: int | None, request: Request) -> None:
        what = _words(request)
        self._view.log.add(INFO, "action", f"{what}: ordered from {client.address}")
        try:
            outcome = await self._outcome_of(request)
        except Exception as error:
            # Whatever it is, the page must hear of it; the traceback is for who mends it.
            _LOGGER.exception("%s failed", what)
            outcome = Outcome(False, f"it failed, and how far it was carried out is not known: {error!r}")
        finally:
            client.under_way -= 1
        self._view.log.add(INFO if outcome.ok else ERROR, "action", f"{what}: {outcome.message}")
        self._answer(client, number, outcome)

    async def _outcome_of(self, request: Request) -> Outcome:
        if isinstance(request, OrderRequest):
            return await self._operations.order(ORDERS[request.action], request.uavs)
        if isinstance(request, ReplanRequest):
            return await self._operations.replan()
        if isinstance(request, PutDevice):
            return await self._operations.report(request.device, None)
        return await self._operations.report(None, request.id)

    def _answer(self, client: Client, number: int | None, outcome: Outcome) -> None:
        client.send(_json({"type": "answer", "id": number, **asdict(outcome)}))

    def _tell(self, delta: Mapping[str, Any]) -> None:
        text = _json(delta)
        for client in list(self._clients):
            client.send(text)


async def _close(socket: web.WebSocketResponse, code: int, why: str) -> None:
    # A close frame carries at most 123 bytes of text.
    await socket.close(code=code, message=why.encode()[:123])


def _words(request: Request) -> str:
    if isinstance(request, OrderRequest):
        shown = ", ".join(request.uavs[:5]) + (f" and {len(request.uavs) - 5} more" if len(request.uavs) > 5 else "")
        return f"{request.action.replace('_', ' ')} {shown}"
    if isinstance(request, PutDevice):
        return f"device {request.device.id}"
    return f"remove device {request.id}" if isinstance(request, RemoveDevice) else "replan"


def _json(data: Mapping[str, Any]) -> str:
    return json.dumps(data, separators=(",", ":"), allow_nan=False)


def _security_headers(tile_url: str) -> dict[str, str]:
    tiles = ""
    if tile_url:
        scheme, _, rest = tile_url.partition("://")
        tiles = f" {scheme}://{rest.partition('/')[0].replace('{s}', '*')}"
    return {
        "Content-Security-Policy": (
            f"default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:{tiles}; "
            "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        ),
        "X-Content-Type-Options": "nosniff",
        # Tile servers ask for it; no more than the origin is told.
        "Referrer-Policy": "strict-origin",
        "Cross-Origin-Opener-Policy": "same-origin",
        "Cross-Origin-Resource-Policy": "same-origin",
    }

"""The dashboard's web server over real sockets: who is let in, what is refused, and readers that do not read.

Oracle: HTTP and WebSocket as aiohttp's client, or the test's own raw socket, speak them; and a book of what the server
had done to the fleet.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import resource
import socket
import time
from collections.abc import AsyncIterator, Callable, Coroutine
from typing import Any

import aiohttp
import pytest

from jpap_ros.dashboard import server as server_module
from jpap_ros.dashboard.access import Access
from jpap_ros.dashboard.assets import load_assets
from jpap_ros.dashboard.event_log import EventLog
from jpap_ros.dashboard.fleet_view import FleetView
from jpap_ros.dashboard.inbox import Inbox
from jpap_ros.dashboard.records import Vehicle
from jpap_ros.dashboard.server import DashboardServer, Outcome, ServerSettings, UavOutcome
from jpap_ros.dashboard.server_thread import ServerThread
from jpap_ros.planning.devices import Device

TOKEN = "correct horse battery"
PATIENCE_S = 60.0


class Book:
    """Stands where the ROS node stands, and notes what it is asked to do."""

    def __init__(self) -> None:
        self.done: list[Any] = []
        self.may_answer = asyncio.Event()
        self.may_answer.set()

    async def order(self, service: str, uavs: tuple[str, ...]) -> Outcome:
        self.done.append((service, uavs))
        await self.may_answer.wait()
        results = tuple(UavOutcome(name, name != "uav2", "prearm: no GPS" if name == "uav2" else "") for name in uavs)
        return Outcome("uav2" not in uavs, "words of the bridge", results)

    async def replan(self) -> Outcome:
        self.done.append("replan")
        return Outcome(True, "plan 2")

    async def report(self, device: Device | None, departed: str | None) -> Outcome:
        self.done.append(device or departed)
        return Outcome(True, "reported")


class Rig:
    """A running server, and a browser's side of it."""

    def __init__(self, server: DashboardServer, view: FleetView, book: Book, session: aiohttp.ClientSession) -> None:
        self.server, self.view, self.book, self.session = server, view, book, session

    @property
    def host(self) -> str:
        return f"127.0.0.1:{self.server.port}"

    def get(self, path: str, **headers: str) -> Any:
        return self.session.get(f"http://{self.host}{path}", headers=headers)

    async def knock(self, **headers: str) -> aiohttp.ClientWebSocketResponse:
        headers = {"Origin": f"http://{self.host}", **headers}
        return await self.session.ws_connect(f"ws://{self.host}/ws", headers=headers)

    async def enter(self, token: object = None) -> tuple[aiohttp.ClientWebSocketResponse, dict[str, Any]]:
        page = await self.knock()
        await page.send_json({"type": "hello", "token": token})
        return page, await page.receive_json(timeout=PATIENCE_S)

    async def ask(self, page: aiohttp.ClientWebSocketResponse, **fields: Any) -> dict[str, Any]:
        await page.send_json({"type": "request", "id": 5, **fields})
        return await answer(page)


async def answer(page: aiohttp.ClientWebSocketResponse) -> dict[str, Any]:
    while True:
        message = await page.receive_json(timeout=PATIENCE_S)
        if message["type"] == "answer":
            return message


async def until(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, f"waited in vain for {what}"
        await asyncio.sleep(0.02)


@contextlib.asynccontextmanager
async def running(token: str | None = None, **settings: Any) -> AsyncIterator[Rig]:
    settings = {"update_rate_hz": 10.0, **settings}
    view, book = FleetView(["uav1", "uav2", "uav3"], EventLog()), Book()
    server = DashboardServer(
        ServerSettings("127.0.0.1", 0, **settings), Access("127.0.0.1", token), view, Inbox(), book
    )
    await server.start()
    task = asyncio.create_task(server.run())
    async with aiohttp.ClientSession() as session:
        try:
            yield Rig(server, view, book, session)
            assert not task.done(), task
        finally:
            task.cancel()
            await server.close()


def play(story: Callable[[], Coroutine[Any, Any, None]]) -> None:
    asyncio.run(asyncio.wait_for(story(), 2 * PATIENCE_S))


def test_every_file_of_the_page_is_served_and_may_load_nothing_from_elsewhere() -> None:
    async def story() -> None:
        async with running() as rig:
            for path, asset in load_assets().items():
                async with rig.get(path) as response:
                    assert (response.status, await response.read()) == (200, asset.body), path
                    policy = response.headers["Content-Security-Policy"]
                    assert "default-src 'none'" in policy and "unsafe" not in policy and "http" not in policy
                    etag = response.headers["ETag"]
                async with rig.get(path, **{"If-None-Match": etag}) as response:
                    assert response.status == 304
            for path in ("/../server.py", "/%2e%2e/server.py", "/js", "/js/../../access.py", "/nothing"):
                async with rig.get(path) as response:
                    assert response.status == 404, path
            async with rig.session.post(f"http://{rig.host}/") as response:
                assert response.status == 405

    play(story)


def test_the_page_has_no_inline_script_nor_style_and_names_no_other_host() -> None:
    # Oracle: the policy above would block them, silently for the reader of the code.
    page = load_assets()["/"].body.decode()
    assert "<style" not in page and " style=" not in page and " onclick=" not in page
    assert page.count("<script") == page.count("<script src=")
    assert "//" not in page.replace("<!doctype", "")


def test_tiles_are_allowed_from_their_server_only() -> None:
    async def story() -> None:
        async with running(tile_url="https://{s}.tiles.example:8443/{z}/{x}/{y}.png") as rig, rig.get("/") as response:
            policy = response.headers["Content-Security-Policy"]
            assert "img-src 'self' data: https://*.tiles.example:8443;" in policy

    play(story)


def test_foreign_hosts_and_origins_are_refused() -> None:
    async def story() -> None:
        async with running() as rig:
            async with rig.get("/", Host="attacker.example") as response:
                assert response.status == 421
                assert "attacker.example" in await response.text()
            for headers in (
                {"Origin": "http://attacker.example"},
                {"Origin": "null"},
                {"Origin": "http://attacker.example", "Host": "attacker.example"},
            ):
                with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
                    await rig.knock(**headers)
                assert refused.value.status in (403, 421)
            async with rig.get("/ws") as response:
                assert response.status == 403
            async with rig.get("/ws", Origin=f"http://{rig.host}") as response:
                assert response.status == 426
            assert rig.book.done == []

    play(story)


def test_nobody_without_the_token_is_told_or_obeyed() -> None:
    async def story() -> None:
        async with running(TOKEN) as rig:
            for token, why in ((None, "a token is needed"), ("wrong", "wrong token"), (7, "wrong token")):
                page = await rig.knock()
                await page.send_json({"type": "hello", "token": token})
                await page.send_json({"type": "request", "id": 1, "action": "launch", "uavs": ["uav1"]})
                message = await page.receive(timeout=PATIENCE_S)
                assert (message.type, message.data, message.extra) == (aiohttp.WSMsgType.CLOSE, 4401, why)
            assert rig.book.done == []
            page, snapshot = await rig.enter(TOKEN)
            assert snapshot["type"] == "snapshot"
            assert (await rig.ask(page, action="replan"))["ok"]

    play(story)


def test_orders_are_done_answered_and_logged() -> None:
    async def story() -> None:
        async with running() as rig:
            page, snapshot = await rig.enter()
            assert list(snapshot["uavs"]) == ["uav1", "uav2", "uav3"]
            good = await rig.ask(page, action="hold", uavs=["uav1"])
            assert (good["id"], good["ok"], good["message"]) == (5, True, "words of the bridge")
            bad = await rig.ask(page, action="launch", uavs=["uav1", "uav2"])
            assert not bad["ok"]
            assert bad["results"][1] == {"uav": "uav2", "ok": False, "message": "prearm: no GPS"}
            assert rig.book.done == [("hold", ("uav1",)), ("launch", ("uav1", "uav2"))]
            told = [(event.level, event.text) for event in rig.view.log.since(0)]
            assert ("info", "hold uav1: ordered from 127.0.0.1") in told
            assert ("error", "launch uav1, uav2: words of the bridge") in told

    play(story)


def test_only_what_was_taken_over_in_the_air_is_given_back() -> None:
    async def story() -> None:
        async with running() as rig:
            taken = Vehicle("connected", landed="in air", goal="yielded", reason="mode became LOITER")
            rig.view.set_vehicle("uav1", taken)
            rig.view.set_vehicle("uav2", Vehicle("connected", landed="on ground", goal="yielded", reason="disarmed"))
            rig.view.set_vehicle("uav3", Vehicle("connected", landed="in air", goal="reached"))
            page, _ = await rig.enter()
            for names, why in (
                (["uav1", "uav3"], "uav3 was not taken over: there is nothing to give back"),
                (["uav2"], "uav2 is not in the air (on ground): launch it instead"),
            ):
                refused = await rig.ask(page, action="give_back", uavs=names)
                assert (refused["ok"], refused["message"]) == (False, why)
            assert rig.book.done == []
            assert (await rig.ask(page, action="give_back", uavs=["uav1"]))["ok"]
            assert rig.book.done == [("launch", ("uav1",))]

    play(story)


def test_nonsense_is_answered_then_shown_the_door_and_harms_nobody() -> None:
    async def story() -> None:
        async with running() as rig:
            other, _ = await rig.enter()
            page, _ = await rig.enter()
            for text in ("{", "[]", '{"type":"request","id":1,"action":"launch","uavs":["nobody"]}', '{"x":NaN}'):
                await page.send_str(text)
                refused = await answer(page)
                assert not refused["ok"] and refused["message"]
            for _ in range(30):
                await page.send_str("nonsense")
            assert await ends(page) == 4400
            # Before saying who it is, and in other ways.
            for first in ("nonsense", '{"type":"request"}', b"\x00" * 9):
                stranger = await rig.knock()
                await (stranger.send_bytes(first) if isinstance(first, bytes) else stranger.send_str(first))
                assert await ends(stranger) == 4400
            huge = await rig.knock()
            await huge.send_str("x" * 100_000)
            assert await ends(huge) == aiohttp.WSCloseCode.MESSAGE_TOO_BIG
            flood, _ = await rig.enter()
            for i in range(200):
                with contextlib.suppress(ConnectionError):
                    await flood.send_json({"type": "request", "id": i, "action": "replan"})
            assert await ends(flood) == aiohttp.WSCloseCode.POLICY_VIOLATION
            assert (await rig.ask(other, action="hold", uavs=["uav1"]))["ok"]

    play(story)


async def ends(page: aiohttp.ClientWebSocketResponse) -> int | None:
    """Read to the end; return the code that the server closed with."""
    while (await page.receive(timeout=PATIENCE_S)).type is aiohttp.WSMsgType.TEXT:
        pass
    return page.close_code


def test_a_page_may_not_have_everything_under_way_at_once() -> None:
    async def story() -> None:
        async with running() as rig:
            rig.book.may_answer.clear()
            page, _ = await rig.enter()
            for i in range(9):
                await page.send_json({"type": "request", "id": i, "action": "hold", "uavs": ["uav1"]})
            refused = await answer(page)
            assert (refused["id"], refused["message"]) == (8, "8 requests are under way already")
            # The page goes; what it ordered is carried out.
            await page.close()
            rig.book.may_answer.set()
            log = rig.view.log
            await until(lambda: sum("words of" in event.text for event in log.since(0)) == 8, "all orders' outcomes")

    play(story)


def test_pages_beyond_the_cap_are_refused_politely() -> None:
    async def story() -> None:
        async with running(max_clients=2) as rig:
            pages = [(await rig.enter())[0] for _ in range(2)]
            third = await rig.knock()
            await third.send_json({"type": "hello"})
            message = await third.receive(timeout=PATIENCE_S)
            assert (message.data, message.extra) == (
                aiohttp.WSCloseCode.TRY_AGAIN_LATER,
                "2 pages are open already, the most allowed",
            )
            await pages[0].close()
            _, snapshot = await rig.enter()
            assert snapshot["type"] == "snapshot"

    play(story)


def connections(rig: Rig) -> int:
    """The server's own count."""
    assert rig.server._runner is not None and rig.server._runner.server is not None
    return len(rig.server._runner.server.connections)


def test_a_thousand_connections_are_refused_and_the_page_that_is_open_goes_on() -> None:
    async def story() -> None:
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, 4096), hard))
        refused = 0
        # No more at a time than the system lets wait for the server: it would forget others.
        at_once = asyncio.Semaphore(60)

        async def knock(stack: contextlib.AsyncExitStack) -> None:
            nonlocal refused
            async with at_once:
                reader, writer = await asyncio.open_connection("127.0.0.1", rig.server.port)
                stack.callback(writer.close)
                words = await reader.read(1000)
            refused += words.startswith(b"HTTP/1.1 503 ") and b"Retry-After" in words

        async with running(max_clients=4) as rig, contextlib.AsyncExitStack() as stack:
            page, _ = await rig.enter()
            knocking = [asyncio.create_task(knock(stack)) for _ in range(1000)]
            # 8 for each of 4 pages, of which one address may have half; those that wait in vain are closed in the end,
            # and others take their places.
            await until(lambda: refused >= 1000 - 32, "all others to be refused")
            assert connections(rig) <= 16
            assert (await rig.ask(page, action="hold", uavs=["uav1"]))["ok"]
            for task in knocking:
                task.cancel()
            await asyncio.gather(*knocking, return_exceptions=True)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))

    play(story)


def test_readers_of_files_that_stop_lock_nobody_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server_module, "_RESPONSE_PATIENCE_S", 1.0)

    async def story() -> None:
        async with running(max_clients=1) as rig:
            loop = asyncio.get_running_loop()
            # More than the kernel keeps for a reader.
            asked = f"GET /vendor/leaflet/leaflet.js HTTP/1.1\r\nHost: {rig.host}\r\n\r\n".encode() * 60
            silent = []
            for _ in range(8):
                raw = socket.socket()
                raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
                raw.setblocking(False)
                await loop.sock_connect(raw, ("127.0.0.1", rig.server.port))
                await loop.sock_sendall(raw, asked)
                silent.append(raw)
            await until(lambda: connections(rig) == 8, "all places to be taken")
            async with rig.get("/") as response:
                assert response.status == 503
            await until(lambda: connections(rig) == 0, "those who do not read to be cut off")
            _, snapshot = await rig.enter()
            assert snapshot["type"] == "snapshot"
            for raw in silent:
                raw.close()

    play(story)


def test_an_order_that_fails_is_answered_and_leaves_its_place() -> None:
    async def story() -> None:
        async with running() as rig:
            page, _ = await rig.enter()

            async def broken(service: str, uavs: tuple[str, ...]) -> Outcome:
                raise OSError("no route to the bridge")

            rig.book.order = broken  # type: ignore[method-assign]
            # More than may be under way at once.
            for _ in range(10):
                refused = await rig.ask(page, action="hold", uavs=["uav1"])
                assert not refused["ok"] and "no route to the bridge" in refused["message"]
            assert "no route to the bridge" in rig.view.log.since(0)[-1].text

    play(story)


def test_a_reader_that_stops_is_dropped_and_memory_does_not_grow() -> None:
    async def story() -> None:
        async with running() as rig:
            page, _ = await rig.enter()
            loop = asyncio.get_running_loop()
            raw = socket.socket()
            raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            raw.setblocking(False)
            await loop.sock_connect(raw, ("127.0.0.1", rig.server.port))
            handshake = (
                f"GET /ws HTTP/1.1\r\nHost: {rig.host}\r\nOrigin: http://{rig.host}\r\nUpgrade: websocket\r\n"
                "Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
                "Sec-WebSocket-Version: 13\r\n\r\n"
            )
            # A hello, masked with zeros (RFC 6455, section 5.2).
            hello = b'{"type":"hello"}'
            await loop.sock_sendall(raw, handshake.encode() + bytes([0x81, 0x80 | len(hello), 0, 0, 0, 0]) + hello)
            await until(lambda: len(rig.server._clients) == 2, "the silent reader to be let in")
            began = time.monotonic()
            while len(rig.server._clients) == 2:
                assert time.monotonic() - began < PATIENCE_S, "it was never dropped"
                rig.view.log.add("info", "plan", "x" * 500)
                for name in rig.view.names:
                    rig.view.set_vehicle(name, Vehicle("connected", reason=str(time.monotonic()) + "y" * 50_000))
                # The one that reads is told all the while.
                await page.receive(timeout=PATIENCE_S)
            assert all(client._waiting.qsize() <= 50 for client in rig.server._clients)
            texts = [event.text for event in rig.view.log.since(0)]
            assert "dropped the page at 127.0.0.1: it does not read" in texts
            assert (await rig.ask(page, action="replan"))["ok"]
            raw.close()

    play(story)


def test_pages_hear_that_the_server_lives_when_nothing_changes() -> None:
    async def story() -> None:
        async with running() as rig:
            page, _ = await rig.enter()
            first = await page.receive_json(timeout=PATIENCE_S)
            second = await page.receive_json(timeout=PATIENCE_S)
            assert (first["type"], second["type"]) == ("delta", "delta")
            assert second["now"] > first["now"]

    play(story)


def test_nothing_of_a_token_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    async def story() -> None:
        async with running(TOKEN) as rig:
            await rig.enter(TOKEN)
            page = await rig.knock()
            await page.send_json({"type": "hello", "token": TOKEN + "!"})
            await ends(page)
            assert TOKEN not in json.dumps([event.text for event in rig.view.log.since(0)])

    with caplog.at_level(logging.DEBUG):
        play(story)
    assert TOKEN not in caplog.text


def test_a_port_that_is_taken_and_a_fault_in_the_thread_come_to_light() -> None:
    failed = asyncio.Event()

    def thread(port: int, view: FleetView) -> ServerThread:
        settings = ServerSettings("127.0.0.1", port, update_rate_hz=10.0)
        return ServerThread(DashboardServer(settings, Access("127.0.0.1", None), view, inbox, Book()), failed.set)

    inbox = Inbox()
    view = FleetView(["uav1"], EventLog())
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        second = thread(taken.getsockname()[1], view)
        with pytest.raises(OSError, match="address already in use"):
            second.start()
        second.stop()
    faulty = thread(0, view)
    faulty.start()
    inbox.put(lambda: 1 / 0)
    deadline = time.monotonic() + PATIENCE_S
    while faulty.failure is None:
        assert time.monotonic() < deadline
        time.sleep(0.02)
    assert isinstance(faulty.failure, ZeroDivisionError)
    faulty.stop()
    assert failed.is_set()
    fine = thread(0, view)
    fine.start()
    fine.stop()
    assert fine.failure is None

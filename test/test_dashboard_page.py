"""The dashboard's page in a real browser, over real planner, bridge and simulated aircraft.

Oracle: what the test's own node in the graph hears from planner and bridge, apart from the dashboard; and what a person
would read on the page.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from browser import launched
from geometry_msgs.msg import Point
from graph import PATIENCE_S, Graph, NodeProcess
from jpap_msgs.msg import Deployment, Device, DeviceUpdate, VehicleState
from playwright.sync_api import Browser, Page, expect
from std_msgs.msg import String

from jpap_ros.fleet.config import MapOrigin
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.nodes.qos import DEVICES, LATCHED

ARGUMENTS = [
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]

UAVS = ["uav1", "uav2", "uav3"]
ORIGIN = MapOrigin(-37.8136, 144.9631, 20.0)
#: Two places too far apart for one UAV, at the demands below.
SITES = {"school": (-300.0, 0.0), "clinic": (300.0, 20.0)}
TOKEN = "correct horse battery staple"

DESKTOP, TABLET, TABLET_UPRIGHT = (1440, 900), (1024, 768), (768, 1024)

expect.set_options(timeout=1000 * PATIENCE_S)


class System:
    """Everything that runs, and what the test hears of it."""

    def __init__(self, folder: Path, graph: Graph, ports: list[int]) -> None:
        *links, self.port, self.guarded_port = ports
        self.graph = graph
        fleet = {
            "version": 1,
            "origin": {"latitude": ORIGIN.latitude, "longitude": ORIGIN.longitude, "altitude_amsl_m": 20},
            "defaults": {"autopilot": "ardupilot"},
            "uavs": [
                {"name": n, "sysid": i + 1, "url": f"udpin:127.0.0.1:{links[i]}", "home_m": [20.0 * i, 0.0]}
                for i, n in enumerate(UAVS)
            ],
        }
        path = folder / "fleet.yaml"
        path.write_text(yaml.safe_dump(fleet))
        token_file = folder / "token"
        token_file.write_text(TOKEN + "\n")
        token_file.chmod(0o600)
        self.deployments = graph.collect(Deployment, "deployment", LATCHED)
        self.states = {n: graph.collect(VehicleState, f"{n}/state", LATCHED) for n in UAVS}
        # Any picture will do for a tile.
        address = f"http://127.0.0.1:{self.guarded_port}/favicon.svg?{{z}}-{{x}}-{{y}}"
        tiles = {"tile_url": address, "tile_attribution": "tiles of <b>the test</b>"}
        own: dict[str, tuple[str, dict[str, Any]]] = {
            "sim": ("sim", {"speedup": 6.0}),
            "bridge": (
                "bridge",
                {
                    "simulated_clock": True,
                    "transit_speed_m_s": 20.0,
                    "transit_climb_m_s": 10.0,
                    "transit_acceleration_m_s2": 5.0,
                },
            ),
            "planner": ("planner", {}),
            "dashboard": ("dashboard", {"port": self.port, "exercise": True}),
            "guarded": ("dashboard", {"port": self.guarded_port, "token_file": str(token_file), **tiles}),
        }
        self.nodes = {
            name: NodeProcess(executable, folder / f"{name}.log", {"fleet_file": str(path), **parameters})
            for name, (executable, parameters) in own.items()
        }

    def output(self) -> str:
        return "\n".join(f"--- {name}\n{node.output[-1500:]}" for name, node in self.nodes.items())

    def in_air(self) -> set[str]:
        heard = {name: states[-1] for name, states in self.states.items() if states}
        return {name for name, state in heard.items() if state.landed_state == VehicleState.LANDED_IN_AIR}

    def served(self) -> set[str]:
        return {d for cell in self.deployments[-1].cells for d in cell.device_ids} if self.deployments else set()


@pytest.fixture(scope="module")
def system(
    ros_domain: int, free_ports: Callable[[int], list[int]], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[System]:
    graph = Graph()
    made = System(tmp_path_factory.mktemp("dashboard"), graph, free_ports(5))
    try:
        for name in ("dashboard", "guarded"):
            graph.wait(lambda name=name: "open http://" in made.nodes[name].output, f"{name} to listen")
        graph.wait(lambda: all(made.states.values()), "every aircraft's state")
        reports = graph.publisher(DeviceUpdate, "devices", DEVICES, readers=3)
        update = DeviceUpdate()
        update.header.frame_id = "map"
        update.devices = [
            Device(id=name, position=Point(x=x, y=y), rate_demand=16.0, weight=1.0) for name, (x, y) in SITES.items()
        ]
        reports.publish(update)
        graph.wait(lambda: made.served() == set(SITES), "a plan for the devices")
        yield made
    finally:
        # Shown with a test that fails.
        sys.stdout.write(made.output())
        for node in made.nodes.values():
            node.kill()
        graph.close()


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with launched(*ARGUMENTS) as browser:
        yield browser


def opened(browser: Browser, port: int) -> Page:
    page = browser.new_page(viewport={"width": DESKTOP[0], "height": DESKTOP[1]})
    page.goto(f"http://127.0.0.1:{port}/")
    expect(page.locator("#chip-page")).to_have_text("Page live")
    return page


@pytest.fixture
def page(system: System, browser: Browser) -> Iterator[Page]:
    """Return the page of the dashboard, open; whatever the browser complains of fails the test."""
    page = opened(browser, system.port)
    complaints: list[str] = []
    page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: complaints.append(str(error)))
    # Once more, now that it is listened to.
    page.reload()
    expect(page.locator("#chip-page")).to_have_text("Page live")
    yield page
    page.close()
    assert complaints == []


def row(page: Page, name: str):
    return page.locator("#aircraft tr", has=page.get_by_role("button", name=name, exact=True))


def test_the_page_shows_plan_devices_and_every_aircraft(page: Page, system: System) -> None:
    # Oracle: by construction each place needs a UAV of its own, and the planner proves it.
    expect(page.locator("#proof")).to_have_text("2 UAVs, proven minimum")
    # Nobody has taken off.
    expect(page.locator("#served")).to_have_text("0 served now · 2 planned")
    expect(page.locator("#chip-planner")).to_have_text("Planner ok")
    expect(page.locator("#chip-links")).to_have_text("Links 3/3")
    expect(page.locator("#aircraft tr")).to_have_count(3)
    page.get_by_role("tab", name="Devices").click()
    expect(page.locator("#devices tr")).to_have_count(2)
    expect(page.locator("#devices")).to_contain_text("16 bit/s")
    expect(page.locator('#devices tr[data-service="planned"]')).to_have_count(2)
    page.get_by_role("tab", name="Events").click()
    expect(page.locator("#events")).to_contain_text("2 devices joined")


def test_an_order_is_carried_out_only_after_it_was_confirmed(page: Page, system: System) -> None:
    page.get_by_role("button", name="Launch", exact=True).click()
    expect(page.get_by_role("dialog")).to_contain_text("Launch ALL 3 aircraft?")
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog")).to_be_hidden()
    # For all because none is selected, or to land: Enter alone orders nothing.
    for key, title in (("l", "Launch ALL 3 aircraft?"), ("d", "Land ALL 3 aircraft?")):
        page.keyboard.press(key)
        expect(page.get_by_role("dialog")).to_contain_text(title)
        expect(page.get_by_role("button", name="Cancel")).to_be_focused()
        page.keyboard.press("Enter")
        expect(page.get_by_role("dialog")).to_be_hidden()
    assert not system.states[UAVS[0]][-1].armed and not page.locator(".toast").count()
    # By keyboard alone, for one aircraft that has a cell.
    wanted = system.deployments[-1].cells[0].uav
    row(page, wanted).get_by_role("checkbox").focus()
    page.keyboard.press("Space")
    expect(page.locator("#selection")).to_have_text("1 aircraft selected")
    page.keyboard.press("l")
    expect(page.get_by_role("dialog")).to_contain_text(f"Launch {wanted}?")
    page.keyboard.press("Enter")
    expect(page.locator(".toast")).to_contain_text("Launch: 1 of 1 UAVs")
    system.graph.wait(lambda: wanted in system.in_air(), f"{wanted} in the air")
    assert system.in_air() == {wanted}, "only what was selected and confirmed may fly"
    # The page shows it moving: the distance to go shrinks to nothing.
    expect(row(page, wanted).locator("td").nth(6)).to_have_text("0.0 m")
    expect(row(page, wanted)).to_contain_text("reached")
    expect(page.locator("#reached")).to_have_text("1 of 2")
    expect(page.locator("#served")).to_have_text("1 served now · 1 planned")
    page.get_by_role("tab", name="Events").click()
    expect(page.locator("#events")).to_contain_text(f"launch {wanted}: ordered from 127.0.0.1")
    expect(page.locator("#events")).to_contain_text(f"{wanted} is in the air")


def test_an_aircraft_that_a_pilot_took_over_is_given_back(page: Page, system: System) -> None:
    (flown,) = system.in_air()
    give_back = page.get_by_role("button", name="Give back")
    expect(give_back).to_be_disabled()
    faults = system.graph.publisher(String, "sim/fault")
    faults.publish(String(data=f"{flown} pilot LOITER"))
    expect(row(page, flown)).to_contain_text("taken over")
    expect(row(page, flown)).to_contain_text("without the bridge asking")
    system.graph.wait(lambda: system.states[flown][-1].goal_state == VehicleState.GOAL_YIELDED, "the bridge to yield")
    expect(give_back).to_have_text("Give back (1)")
    give_back.click()
    page.get_by_role("dialog").get_by_role("button", name="Give back").click()
    expect(page.locator(".toast")).to_contain_text("Give back: 1 of 1 UAVs")
    # Another aircraft may have its cell by now: what counts is that the bridge has it, in the mode of its goals.
    system.graph.wait(
        lambda: (
            system.states[flown][-1].goal_state != VehicleState.GOAL_YIELDED
            and system.states[flown][-1].mode == "GUIDED"
        ),
        "the bridge to have it back",
    )
    expect(row(page, flown)).not_to_contain_text("taken over")
    page.get_by_role("tab", name="Events").click()
    expect(page.locator("#events")).to_contain_text(f"{flown} was taken over")


def test_a_device_added_changed_and_removed_by_hand_reaches_the_plan(page: Page, system: System) -> None:
    page.get_by_role("tab", name="Exercise").click()
    form = page.locator("#exercise")
    for label, text in {"Id": "by hand", "East [m]": "290", "North [m]": "40", "Demand [bit/s]": "13"}.items():
        form.get_by_label(label, exact=True).fill(text)
    form.get_by_role("button", name="Add or change").click()
    expect(page.locator(".toast").last).to_contain_text("Device by hand reported")
    system.graph.wait(lambda: "by hand" in system.served(), "the device to be served")
    page.get_by_role("tab", name="Devices").click()
    expect(page.locator("#devices tr")).to_have_count(3)
    page.get_by_role("tab", name="Exercise").click()
    # Nonsense is refused in words, and the plan stays.
    form.get_by_label("Id", exact=True).fill("odd")
    form.get_by_label("Demand [bit/s]").fill("-4")
    form.get_by_role("button", name="Add or change").click()
    expect(page.locator(".toast.bad")).to_contain_text("rate_demand must be finite and > 0, got -4.0")
    form.get_by_label("Id", exact=True).fill("by hand")
    form.get_by_role("button", name="Remove").click()
    page.get_by_role("dialog").get_by_role("button", name="Remove").click()
    system.graph.wait(lambda: system.served() == set(SITES), "the device to have left the plan")
    page.get_by_role("tab", name="Devices").click()
    expect(page.locator("#devices tr")).to_have_count(2)


def test_a_wrong_token_shows_nothing_and_orders_nothing(system: System, browser: Browser) -> None:
    page = browser.new_page()
    page.goto(f"http://127.0.0.1:{system.guarded_port}/")
    dialog = page.get_by_role("dialog", name="This dashboard needs a token")
    expect(dialog).to_be_visible()
    dialog.get_by_label("Token").fill("a wrong guess of it")
    page.keyboard.press("Enter")
    expect(dialog).to_contain_text("That token was wrong")
    assert page.locator("#aircraft tr").count() == 0
    # Past the page's own care, straight over the socket: an order before or instead of the right token.
    closed = page.evaluate(
        """(messages) => new Promise((resolve) => {
            const socket = new WebSocket(`ws://${location.host}/ws`);
            const heard = [];
            socket.onmessage = (event) => heard.push(event.data);
            socket.onopen = () => messages.forEach((message) => socket.send(JSON.stringify(message)));
            socket.onclose = (event) => resolve([event.code, event.reason, heard]);
        })""",
        [{"type": "hello", "token": "x" * 28}, {"type": "request", "id": 1, "action": "launch", "uavs": UAVS}],
    )
    assert closed == [4401, "wrong token", []]
    assert "launch" not in system.nodes["guarded"].output
    dialog.get_by_label("Token").fill(TOKEN)
    page.keyboard.press("Enter")
    expect(page.locator("#chip-page")).to_have_text("Page live")
    expect(page.locator("#aircraft tr")).to_have_count(3)
    assert TOKEN not in page.url
    # This dashboard shows tiles, and the devices of the map in metres lie on them.
    expect(page.locator(".leaflet-tile-loaded").first).to_be_attached()
    expect(page.locator(".leaflet-control-attribution")).to_have_text("tiles of <b>the test</b>")
    page.get_by_role("tab", name="Devices").click()
    page.get_by_role("button", name="school").click()
    expect(page.locator("#details")).to_contain_text("-300 E, 0 N")
    page.close()


def test_it_fits_desktop_and_tablet(page: Page, tmp_path: Path) -> None:
    # Oracle: the browser's own layout; nothing is to be scrolled sideways and every order is in sight.
    for width, height in (DESKTOP, TABLET, TABLET_UPRIGHT):
        page.set_viewport_size({"width": width, "height": height})
        expect(page.get_by_role("button", name="Return")).to_be_in_viewport()
        assert page.evaluate("document.scrollingElement.scrollWidth") <= width
        assert page.evaluate("document.scrollingElement.scrollHeight") <= height
        for box in (page.locator("#map").bounding_box(), page.locator("#panel").bounding_box()):
            assert box is not None and box["width"] > 300 and box["height"] > 300
        picture = tmp_path / f"dashboard_{width}x{height}.png"
        page.screenshot(path=picture)
        assert picture.read_bytes().startswith(b"\x89PNG")


def test_places_on_tiles_are_those_of_the_rest_of_the_product(page: Page) -> None:
    # Oracle: LocalFrame, which the bridge flies by. 1e-8 degrees are about a millimetre.
    points = [(0.0, 0.0), (1234.5, -987.6), (-20_000.0, 15_000.0)]
    found = page.evaluate(
        """async ([origin, points]) => {
            const { GeodeticFrame } = await import("/js/frame.js");
            const frame = new GeodeticFrame(origin);
            return points.map(([east, north]) => {
              const place = frame.toLatLng(east, north);
              return [place.lat, place.lng, ...frame.toMap(place)];
            });
        }""",
        [[ORIGIN.latitude, ORIGIN.longitude], points],
    )
    frame = LocalFrame(ORIGIN)
    for point, (latitude, longitude, east, north) in zip(points, found, strict=True):
        assert (latitude, longitude) == pytest.approx(frame.to_geodetic(*point), abs=1e-8)
        assert (east, north) == pytest.approx(point, abs=1e-3)


def test_everything_on_the_page_has_a_name_for_screen_readers(page: Page) -> None:
    # Oracle: the browser's own accessibility tree.
    page.get_by_role("tab", name="Exercise").click()
    nameless = page.evaluate(
        """() => [...document.querySelectorAll("button, input, canvas[role], dialog, [role=tab], [role=tabpanel]")]
            .filter((element) => element.checkVisibility())
            .filter((element) => !(element.ariaLabel || element.textContent.trim() || element.labels?.length
                || element.getAttribute("aria-labelledby") || element.title))
            .map((element) => element.outerHTML)"""
    )
    assert nameless == []
    page.keyboard.press("?")
    expect(page.get_by_role("dialog", name="Keyboard")).to_be_visible()
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog", name="Keyboard")).to_be_hidden()


def test_silence_is_said_in_a_banner(system: System, browser: Browser) -> None:
    # The last test: what it stops is not started again.
    page = opened(browser, system.port)
    system.nodes["planner"].kill()
    expect(page.get_by_role("alert")).to_contain_text("The planner is silent")
    assert system.nodes["dashboard"].stop() == 0
    expect(page.get_by_role("alert")).to_contain_text("No connection to the dashboard")
    assert "Traceback" not in system.nodes["dashboard"].output
    assert system.in_air(), "the fleet flies on without the page"
    page.close()

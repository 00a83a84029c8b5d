"""The report's arithmetic on a flight made up by hand, and what it does with recordings that are none.

The recordings are written by the public MCAP library and rclpy's serialisation. Every expected figure is worked out in
a comment from the made-up flight.
"""

from __future__ import annotations

import base64
import html
import json
import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from browser import launched
from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Point, Pose, PoseStamped
from jpap_msgs.msg import (
    Cell,
    Deployment,
    Device,
    DeviceUpdate,
    GeoDevice,
    GeoDeviceUpdate,
    UnservedDevice,
    VehicleState,
)
from mcap.writer import CompressionType, Writer
from rcl_interfaces.msg import Log
from rclpy.serialization import serialize_message
from std_msgs.msg import Header

from jpap_ros.nodes.recorder_definitions import full_definition
from jpap_ros.report.__main__ import main
from jpap_ros.report.flight import Flight
from jpap_ros.report.flight_reader import is_of_flight, read_flight
from jpap_ros.report.page import Figures, compute
from jpap_ros.report.recording import RecordingError, RecordingReader, read_recording

BEGAN_NS = 1_800_000_000 * 10**9
FLEET = {
    "version": 1,
    "origin": {"latitude": -37.8136, "longitude": 144.9631},
    "uavs": [{"name": f"uav{i}", "sysid": i, "url": f"udpin:127.0.0.1:{14550 + i}"} for i in (1, 2)],
}
NASTY = "<script>alert(1)</script>$_$"


class Tape:
    """Writes a recording; times are seconds after its beginning."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}

    def say(self, at_s: float, topic: str, message: Any) -> None:
        kind = f"{type(message).__module__.split('.')[0]}/msg/{type(message).__name__}"
        if kind not in self._schemas:
            self._schemas[kind] = self._writer.register_schema(kind, "ros2msg", full_definition(kind).encode())
        if topic not in self._channels:
            self._channels[topic] = self._writer.register_channel(topic, "cdr", self._schemas[kind])
        at_ns = BEGAN_NS + round(at_s * 1e9)
        self._writer.add_message(self._channels[topic], at_ns, serialize_message(message), at_ns)

    def pose(self, at_s: float, uav: str, *place: float) -> None:
        x, y, z = place
        message = PoseStamped(pose=Pose(position=Point(x=x, y=y, z=z)))
        whole, rest = divmod(BEGAN_NS + round(at_s * 1e9), 10**9)
        message.header.stamp.sec, message.header.stamp.nanosec = whole, rest
        self.say(at_s, f"/{uav}/pose", message)


@contextmanager
def tape(path: Path, fleet: bool = True, parameters: dict[str, Any] | None = None) -> Iterator[Tape]:
    with path.open("wb") as file:
        # Small chunks: a file that is cut off keeps what came before.
        writer = Writer(file, chunk_size=400, compression=CompressionType.NONE)
        writer.start(profile="ros2", library="test")
        if fleet:
            writer.add_attachment(0, 0, "fleet.yaml", "application/yaml", yaml.safe_dump(FLEET).encode())
        if parameters is not None:
            writer.add_metadata("parameters of /planner", {k: json.dumps(v) for k, v in parameters.items()})
        yield Tape(writer)
        writer.finish()


def state(uav: str, landed: int = VehicleState.LANDED_IN_AIR, battery: float = 0.9, **fields: Any) -> VehicleState:
    return VehicleState(
        uav=uav, link=VehicleState.LINK_CONNECTED, landed_state=landed, battery_remaining=battery, **fields
    )


def update(frame: str = "map", **fields: Any) -> DeviceUpdate:
    return DeviceUpdate(header=Header(frame_id=frame), **fields)


def deployment(plan_id: int, planning_s: float, reason: str, bound: int, **fields: Any) -> Deployment:
    cell = Cell(uav="uav1", goal_pose=Pose(position=Point(z=50.0)), device_ids=["a", "b"], power_w=[4.0, 6.0])
    cell.rate = [34.0, 30.0]
    return Deployment(
        plan_id=plan_id,
        reason=reason,
        cells=[cell],
        uavs_needed=1,
        min_uavs_bound=bound,
        proven_optimal=bound == 1,
        planning_time=Duration(sec=0, nanosec=round(planning_s * 1e9)),
        **fields,
    )


def diagnostic(level: bytes, message: str) -> DiagnosticArray:
    return DiagnosticArray(status=[DiagnosticStatus(level=level, name="/bridge: uav1", message=message)])


def write_flight(path: Path, **more: Any) -> Path:
    """Twenty seconds of two devices, one cell, and a second aircraft that flies past."""
    with tape(
        path, parameters={"bandwidth_hz": 2.0, "scheme": "optimal", "fleet_file": "/elsewhere.yaml"}, **more
    ) as t:
        a = Device(id="a", position=Point(), rate_demand=32.0)
        b = Device(id="b", position=Point(x=100.0), rate_demand=30.0)
        t.say(0.0, "/devices", update(devices=[a, b]))
        t.say(0.0, "/uav1/state", state("uav1", VehicleState.LANDED_ON_GROUND))
        t.say(0.0, "/uav2/state", state("uav2", battery=math.nan))
        for at_s in (0.0, 3.0, 3.7):
            t.pose(at_s, "uav1", 0.0, 0.0, 0.0)
        t.say(2.0, "/deployment", deployment(1, 0.5, "2 devices joined", -1))
        t.say(3.75, "/uav1/state", state("uav1", mode="GUIDED", armed=True))
        # It hovers at its goal, and from 9.75 s on 50 m above it.
        for at_s in (3.75, 6.0, 8.0, 9.7):
            t.pose(at_s, "uav1", 0.0, 0.0, 50.0)
        for at_s in (9.75, 12.0, 14.0, 16.0, 18.0, 20.0):
            t.pose(at_s, "uav1", 0.0, 0.0, 100.0)
        # It flies past from north to south, abeam of the other at 6.1 s, 30 m east of it.
        for at_s, north in (
            (0.0, 40.0),
            (4.0, 40.0),
            (5.1, 40.0),
            (7.1, -40.0),
            (10.0, -40.0),
            (15.0, -40.0),
            (20.0, -40.0),
        ):
            t.pose(at_s, "uav2", 30.0, north, 50.0)
        t.say(7.8, "/devices", update(devices=[Device(id="a", position=Point(), rate_demand=33.0)]))
        unserved = [UnservedDevice(id=NASTY, reason="too far")]
        t.say(8.0, "/deployment", deployment(2, 0.1, "1 device changed demand", 1, unserved=unserved))
        t.say(11.0, "/diagnostics", diagnostic(DiagnosticStatus.OK, "goal reached"))
        t.say(12.0, "/diagnostics", diagnostic(DiagnosticStatus.ERROR, "link lost for 0 s"))
        t.say(12.5, "/diagnostics", diagnostic(DiagnosticStatus.ERROR, "link lost for 1 s"))
        t.say(13.0, "/diagnostics", diagnostic(DiagnosticStatus.OK, "goal reached"))
        t.say(14.0, "/rosout", Log(level=30, name="bridge", msg="a warning"))
        t.say(14.1, "/rosout", Log(level=20, name="bridge", msg="nothing of importance"))
        t.say(14.75, "/devices", update(departed=["b", "never there"]))
        t.say(20.0, "/uav1/state", state("uav1", battery=0.5, mode="GUIDED", armed=True))
    return path


def flight_of(*paths: Path) -> Flight:
    return read_flight(RecordingReader(paths, is_of_flight))


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_flight(tmp_path_factory.mktemp("flight") / "flight.mcap")


@pytest.fixture(scope="module")
def flight(path: Path) -> Flight:
    return flight_of(path)


@pytest.fixture(scope="module")
def found(flight: Flight) -> Figures:
    return compute(flight)


def test_the_course_of_the_flight(flight: Flight) -> None:
    assert flight.duration_s == pytest.approx(20.0, abs=1e-5)
    assert flight.bandwidth_hz == 2.0
    assert flight.notes == ()
    assert list(flight.tracks) == ["uav1", "uav2"]
    assert [(round(c.at_s, 3), c.what) for c in flight.changes] == [
        (0.0, "2 joined: a, b"),
        (7.8, "1 changed demand: a"),
        (14.75, "1 left: b"),
    ]


def test_rates_follow_from_where_the_aircraft_was(flight: Flight, found: Figures) -> None:
    a, b = found.services
    grid = found.grid

    def at(moment: float) -> int:
        return int(np.argmin(abs(grid - moment)))

    # On the ground: nothing, though the plan is in force.
    assert a.rate[at(3.5)] == b.rate[at(3.5)] == 0.0
    # At the goal: what the plan says.
    assert (a.rate[at(5.0)], b.rate[at(5.0)]) == (pytest.approx(34.0), pytest.approx(30.0))
    # At twice the height over `a`, a quarter of the power arrives. For `b`, 100 m away: 100^2 + 50^2 = 12,500 m^2 at
    # the goal, 100^2 + 100^2 = 20,000 m^2 now. Two hertz each.
    assert a.rate[at(12.0)] == pytest.approx(2.0 * math.log2(1.0 + (2.0**17 - 1.0) / 4.0))
    assert b.rate[at(12.0)] == pytest.approx(2.0 * math.log2(1.0 + (2.0**15 - 1.0) * 12_500 / 20_000))
    assert (a.demand[at(7.0)], a.demand[at(8.0)], b.demand[at(14.5)], b.demand[at(15.0)]) == (32.0, 33.0, 30.0, 0.0)


def test_availability_is_the_share_of_a_devices_time(found: Figures) -> None:
    a, b = found.services
    # Moments every 0.5 s. Enough from 4.0 to 9.5 s: 12 moments. `a` is there for all 41, `b` from 0 to 14.5 s for 30.
    assert len(found.grid) == 41
    assert a.availability == pytest.approx(12 / 41)
    assert b.availability == pytest.approx(12 / 30)
    assert found.availability == pytest.approx(24 / 71)


def test_metres_and_separation(found: Figures) -> None:
    # 0 to 50 m up, 50 to 100 m up; and 40 m north to 40 m south.
    assert found.metres == {"uav1": pytest.approx(100.0), "uav2": pytest.approx(80.0)}
    # The second climb, at 9.75 s, was under the plan of 8 s.
    assert found.metres_by_plan == (pytest.approx(130.0), pytest.approx(50.0))
    # Abeam between two moments of the grid, and found there.
    nearest = found.separation
    assert (nearest.ever_m, nearest.pair) == (pytest.approx(30.0, abs=1e-4), ("uav1", "uav2"))
    assert 5.5 <= nearest.at_s <= 6.1
    # 30 m east, 40 m south and 50 m below.
    assert nearest.least_m[-1] == pytest.approx(math.sqrt(30.0**2 + 40.0**2 + 50.0**2))
    assert math.isnan(nearest.least_m[0]), "one of the two is on the ground"


def test_latencies(flight: Flight, found: Figures) -> None:
    assert [round(plan.planning_s, 6) for plan in flight.plans] == [0.5, 0.1]
    # No plan answers the report of 14.75 s.
    assert [(a.plan_id, round(a.latency_s, 3)) for a in found.answers] == [(1, 2.0), (2, 0.2)]


def test_every_event_is_told(found: Figures) -> None:
    lines = [(round(e.at_s, 2), e.kind, e.source, e.level) for e in found.events]
    assert lines == [
        (0.0, "device", "", "ok"),
        (0.0, "aircraft", "uav1", "ok"),
        (0.0, "aircraft", "uav2", "ok"),
        (2.0, "plan", "plan 1", "ok"),
        (3.75, "aircraft", "uav1", "ok"),
        (7.8, "device", "", "ok"),
        (8.0, "plan", "plan 2", "warning"),
        (12.0, "diagnostic", "/bridge: uav1", "error"),
        (13.0, "diagnostic", "/bridge: uav1", "ok"),
        (14.0, "log", "bridge", "warning"),
        (14.75, "device", "", "ok"),
    ]
    text = {round(e.at_s, 2): e.text for e in found.events}
    assert text[3.75] == "mode GUIDED, armed, in the air"
    assert "no bound proven; planned in 500.0 ms; 130 m flown" in text[2.0]
    assert "proven minimum" in text[8.0] and "too far" in text[8.0]
    assert text[13.0] == "all right again: goal reached"


def test_the_page_holds_everything_and_works_without_a_network(path: Path, tmp_path: Path) -> None:
    page = tmp_path / "out" / "report.html"
    assert main([str(path), "-o", str(page)]) == 0
    text = page.read_text()
    assert text.count("data:image/svg+xml;base64,") == 9
    assert NASTY not in text and "&lt;script&gt;alert(1)" in text
    assert not re.findall(r"""(?:src|href)=["'](?!data:|#)""", text)
    # 24 / 71; 30 m; 0.18 km.
    for figure in ("33.8 %", "30.0 m", "0.18 km", "uav1 and uav2", "50 %"):
        assert figure in text, figure
    asked: list[str] = []
    with launched() as browser:
        view = browser.new_page()
        view.on("request", lambda request: asked.append(request.url))
        view.on("pageerror", lambda error: pytest.fail(str(error)))
        view.goto(page.as_uri())
        rows = view.locator("#table tbody tr:visible")
        assert rows.count() == 11
        view.get_by_label("only warnings and errors").check()
        assert rows.count() == 3
        view.get_by_label("Search").fill("link lost")
        assert rows.count() == 1
        broken = "[...document.images].filter((image) => !image.naturalWidth).length"
        assert view.evaluate(broken) == 0
    assert {url.partition(":")[0] for url in asked} <= {"file", "data"}


def test_devices_count_as_the_planner_counts_them(tmp_path: Path) -> None:
    # Oracle: README, parameters map_frame and device_timeout_s of the planner.
    path = tmp_path / "flight.mcap"
    with tape(path, parameters={"bandwidth_hz": 1.0, "map_frame": "map", "device_timeout_s": 5.0}) as t:
        a, b = (Device(id=name, rate_demand=1.0) for name in "ab")
        t.say(0.0, "/devices", update(devices=[a, b]))
        t.say(0.0, "/deployment", deployment(1, 0.1, "2 devices joined", -1))
        t.say(1.0, "/devices", update("odom", devices=[Device(id="elsewhere", rate_demand=1.0)]))
        # Wrong, but still there: it is the other one that falls silent.
        t.say(4.0, "/devices", update(devices=[Device(id="a", rate_demand=math.nan)]))
        t.say(8.0, "/devices", update(devices=[Device(id=f"d{i}", rate_demand=1.0) for i in range(8)]))
        t.say(8.5, "/deployment", deployment(2, 0.1, "1 device fell silent, 8 joined", -1))
        t.say(8.6, "/devices", update(devices=[a]))
    flight = flight_of(path)
    assert [(round(c.at_s, 3), c.what) for c in flight.changes] == [
        (0.0, "2 joined: a, b"),
        (5.0, "1 not reported for 5 s, taken as left: b"),
        (8.0, "8 joined: d0, d1, d2, d3, d4 and 3 more"),
    ]
    assert "elsewhere" not in flight.devices and len(flight.devices["a"]) == 1
    assert flight.device_at("b", 4.9) is not None and flight.device_at("b", 5.1) is None
    assert "frame 'odom'" in " ".join(flight.notes)
    # The first plan began before the first report. Nobody sent a report when `b` fell silent.
    assert [round(answer.at_s, 3) for answer in compute(flight).answers] == [0.0, 8.0]


def test_events_are_those_of_one_fleet_and_tell_when_a_trouble_becomes_another(tmp_path: Path) -> None:
    two = tmp_path / "two.mcap"
    with tape(two) as t:
        for space in ("", "/north"):
            t.say(0.0, f"{space}/deployment", deployment(1, 0.1, "", -1))
            for at_s, words in (
                (1.0, "battery low: 20 %"),
                (2.0, "battery low: 19 %"),
                (3.0, "goal rejected: fence"),
            ):
                status = DiagnosticStatus(level=DiagnosticStatus.WARN, name=f"{space}/bridge: uav1", message=words)
                t.say(at_s, "/diagnostics", DiagnosticArray(status=[status]))
            for logger in ("bridge", "bridge.link"):
                t.say(4.0, "/rosout", Log(level=30, name=f"{space}/{logger}".strip("/").replace("/", "."), msg="w"))
    for namespace, space, logger in (("/", "", ""), ("north", "/north", "north.")):
        flight = read_flight(RecordingReader([two], is_of_flight), namespace)
        assert [(round(at_s, 3), name, words) for at_s, name, _, words in flight.diagnostics] == [
            (1.0, f"{space}/bridge: uav1", "battery low: 20 %"),
            (3.0, f"{space}/bridge: uav1", "goal rejected: fence"),
        ]
        assert [line.name for _, line in flight.log] == [f"{logger}bridge", f"{logger}bridge.link"]


def test_an_id_is_no_formula(tmp_path: Path) -> None:
    # Oracle: Matplotlib's documentation of mathtext: text between two dollar signs is a formula, and these are wrong.
    names = ["$_$", r"$\frac$", "a$b", NASTY]
    file, page = tmp_path / "flight.mcap", tmp_path / "report.html"
    with tape(file) as t:
        devices = [Device(id=name, position=Point(x=100.0 * i), rate_demand=1.0) for i, name in enumerate(names)]
        t.say(0.0, "/devices", update(devices=devices))
        t.say(1.0, "/deployment", deployment(1, 0.1, "4 devices joined", 1))
        t.say(20.0, "/uav1/state", state("uav1"))
    assert main([str(file), "-o", str(page)]) == 0
    pictures = [base64.b64decode(data).decode() for data in re.findall(r"svg\+xml;base64,([\w+/=]+)", page.read_text())]
    shown = html.unescape("".join(pictures))
    assert all(f">{name}<" in shown for name in names[:3]) and "mathdefault" not in shown


def test_a_recording_cut_off_anywhere_is_read_as_far_as_it_goes(path: Path, tmp_path: Path) -> None:
    whole = read_recording([path], is_of_flight).told
    data, counts = path.read_bytes(), []
    torn = tmp_path / "torn.mcap"
    for length in range(0, len(data), len(data) // 40):
        torn.write_bytes(data[:length])
        try:
            recording = read_recording([torn], is_of_flight)
        except RecordingError as error:
            assert "torn.mcap" in str(error) and "\n" not in str(error)
            counts.append(0)
            continue
        assert {t.data for t in recording.told} <= {t.data for t in whole}
        counts.append(len(recording.told))
        if len(recording.told) < len(whole):
            assert "read as far as it goes" in recording.notes[0]
    assert counts == sorted(counts) and counts[0] == 0 and counts[-1] > 0.9 * len(whole)


def test_a_recording_damaged_in_the_middle_is_read_up_to_there(path: Path, tmp_path: Path) -> None:
    data, damaged = path.read_bytes(), tmp_path / "damaged.mcap"
    # Within a chunk, whose checksum no longer fits.
    damaged.write_bytes(data.replace(b"1 device changed demand", b"9 device changed demand"))
    recording = read_recording([damaged], is_of_flight)
    assert 0 < len(recording.told) < len(read_recording([path], is_of_flight).told)
    (note,) = flight_of(damaged).notes
    assert note.startswith("damaged.mcap is damaged in the middle")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "cannot be read: No such file or directory"),
        (b"", "it is empty"),
        (b"\x89MCAP0\r\n", "no message of a flight"),
        (b"PK\x03\x04 something else altogether", "it is no MCAP file"),
    ],
)
def test_what_is_no_recording_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes | None, said: str
) -> None:
    file, page = tmp_path / "file.mcap", tmp_path / "report.html"
    if content is not None:
        file.write_bytes(content)
    assert main([str(file), "-o", str(page)]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "file.mcap" in error and said in error
    assert not page.exists()


def test_a_recording_of_something_else_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = tmp_path / "other.mcap"
    with tape(other) as t:
        t.say(0.0, "/rosout", Log(level=20, name="robot", msg="hello"))
    assert main([str(other), "-o", str(tmp_path / "report.html")]) == 1
    assert "no deployment was recorded" in capsys.readouterr().err


def test_which_fleet_must_be_clear(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    two, page = tmp_path / "two.mcap", tmp_path / "report.html"
    with tape(two) as t:
        t.say(0.0, "/north/deployment", deployment(1, 0.1, "north", -1))
        t.say(1.0, "/south/deployment", deployment(1, 0.1, "south", -1))
    assert main([str(two), "-o", str(page)]) == 1
    assert "/north, /south" in capsys.readouterr().err
    assert main([str(two), "-o", str(page), "--namespace", "south"]) == 0
    assert "south" in page.read_text() and "north" not in page.read_text().replace("north [m]", "")
    assert main([str(two), "-o", str(page), "--namespace", "west"]) == 1


def test_a_split_recording_is_one_flight(tmp_path: Path) -> None:
    first, second = tmp_path / "1.mcap", tmp_path / "2.mcap"
    with tape(first) as t:
        t.say(
            0.0,
            "/geo_devices",
            GeoDeviceUpdate(devices=[GeoDevice(id="g", latitude=-37.8136, longitude=144.9631, rate_demand=1.0)]),
        )
    with tape(second) as t:
        t.say(5.0, "/deployment", deployment(1, 0.1, "1 device joined", -1))
    # In any order.
    flight = flight_of(second, first)
    (report,) = flight.devices["g"]
    assert report.position == pytest.approx((0.0, 0.0), abs=1e-6), "at the map's origin"
    assert flight.duration_s == pytest.approx(5.0)
    assert "bandwidth_hz is taken as 1" in " ".join(flight.notes)


def test_what_was_flown_with_can_be_taken_out(path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(path), "--extract", str(tmp_path / "setup")]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 2
    assert yaml.safe_load((tmp_path / "setup" / "fleet.yaml").read_text()) == FLEET
    parameters = yaml.safe_load((tmp_path / "setup" / "planner.yaml").read_text())
    # Where the fleet file was on the other machine is of no use.
    assert parameters == {"/**": {"ros__parameters": {"bandwidth_hz": 2.0, "scheme": "optimal"}}}

"""The fleet file. Oracle: the keys as `config/fleet_example.yaml` explains them, and YAML's own rules."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from jpap_ros.fleet.config import FleetFileError, LinkUrl, load_fleet, parse_fleet
from jpap_ros.fleet.fence import Fence

EXAMPLE = Path(__file__).parents[1] / "config" / "fleet_example.yaml"

MINIMAL = """
version: 1
origin: {latitude: -37.8, longitude: 144.9}
uavs:
  - {name: a, sysid: 1, url: "udpin:0.0.0.0:14550"}
"""


def with_lines(*lines: str) -> str:
    return MINIMAL + "\n".join(lines) + "\n"


def with_uavs(*entries: str) -> str:
    return MINIMAL[: MINIMAL.index("  - ")] + "".join(f"  - {{{entry}}}\n" for entry in entries)


def test_the_example_is_what_it_says() -> None:
    fleet = load_fleet(EXAMPLE)
    assert fleet.names == tuple(f"uav{i}" for i in range(1, 13))
    assert [uav.sysid for uav in fleet.uavs] == list(range(1, 13))
    assert [str(uav.urls[0]) for uav in fleet.uavs] == [f"udpin:127.0.0.1:{14600 + i}" for i in range(1, 13)]
    assert (fleet.origin.latitude, fleet.origin.longitude, fleet.origin.altitude_amsl_m) == (-37.8136, 144.9631, 20.0)
    assert {uav.autopilot for uav in fleet.uavs} == {"ardupilot"}
    assert fleet.fence == Fence(center_m=(0.0, 0.0), radius_m=3000.0, min_height_m=5.0, max_height_m=120.0)
    homes = [uav.home_m for uav in fleet.uavs]
    gaps = [math.dist(a, b) for i, a in enumerate(homes) for b in homes[:i]]
    assert min(gaps) >= 10.0
    assert max(map(math.hypot, *zip(*homes, strict=True))) < 30.0


def test_every_key_that_the_example_comments_out_works(tmp_path: Path) -> None:
    text = EXAMPLE.read_text()
    for line in ('gcs_urls: ["udpout:127.0.0.1:14550"]', "signing_key_file: fleet.key", "  max_bytes_per_s: 4000"):
        commented = f"  # {line.strip()}" if line.startswith("  ") else f"# {line}"
        assert text.count(f"\n{commented}\n") == 1
        text = text.replace(f"\n{commented}\n", f"\n{line}\n")
    path = tmp_path / "fleet.yaml"
    path.write_text(text)
    fleet = load_fleet(path)
    assert fleet.gcs_urls == (LinkUrl("udpout", "127.0.0.1", 14550),)
    assert fleet.signing_key_file == tmp_path / "fleet.key"
    assert {uav.signing_key_file for uav in fleet.uavs} == {tmp_path / "fleet.key"}
    assert {uav.max_bytes_per_s for uav in fleet.uavs} == {4000.0}


def test_defaults_hold_unless_a_uav_says_otherwise() -> None:
    fleet = parse_fleet(
        "signing_key_file: /keys/all\ndefaults: {autopilot: px4, max_bytes_per_s: 2000}\n"
        + with_uavs(
            'name: a, sysid: 1, url: "tcp:h:1"',
            'name: b, sysid: 2, url: "tcp:h:2", autopilot: ardupilot, max_bytes_per_s: null, signing_key_file: null',
            'name: c, sysid: 3, url: "tcp:h:3", signing_key_file: /keys/own, max_bytes_per_s: 500',
        )
    )
    assert [uav.autopilot for uav in fleet.uavs] == ["px4", "ardupilot", "px4"]
    assert [uav.max_bytes_per_s for uav in fleet.uavs] == [2000.0, None, 500.0]
    assert [uav.signing_key_file for uav in fleet.uavs] == [Path("/keys/all"), None, Path("/keys/own")]


def test_links_are_listed_once_with_those_who_share_them() -> None:
    fleet = parse_fleet(
        with_uavs(
            'name: a, sysid: 1, url: ["serial:/dev/ttyUSB0:57600", "udpin:0.0.0.0:14550"]',
            'name: b, sysid: 2, url: "serial:/dev/ttyUSB0:57600"',
        )
    )
    assert [(str(link.url), link.uavs) for link in fleet.vehicle_links] == [
        ("serial:/dev/ttyUSB0:57600", ("a", "b")),
        ("udpin:0.0.0.0:14550", ("a",)),
    ]


@pytest.mark.parametrize(
    ("url", "parts"),
    [
        ("udpin:0.0.0.0:14550", ("udpin", "0.0.0.0", 14550)),
        ("udpout:192.168.1.7:14540", ("udpout", "192.168.1.7", 14540)),
        ("tcp:sitl.local:5760", ("tcp", "sitl.local", 5760)),
        ("udpin:::1:14550", ("udpin", "::1", 14550)),
        ("serial:/dev/serial/by-id/usb-FTDI:57600", ("serial", "/dev/serial/by-id/usb-FTDI", 57600)),
        ("serial:/dev/ttyACM0:921600", ("serial", "/dev/ttyACM0", 921600)),
    ],
)
def test_urls(url: str, parts: tuple[str, str, int]) -> None:
    parsed = LinkUrl.parse(url)
    assert (parsed.kind, parsed.host, parsed.port) == parts
    assert str(parsed) == url


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file must be a mapping, got None"),
        ("[1]", "the file must be a mapping"),
        ("a: [", "not valid YAML"),
        ("{? [1] : 2}", "key .* is not text"),
        ("{1: 2}", "key 1 is not text"),
        ("when: 2020-13-45", "not valid YAML"),
        ("[" * 5000, "not valid YAML"),
        (MINIMAL.replace("version: 1", "version: 2"), "version must be 1, got 2"),
        (MINIMAL.replace("version: 1", "version: true"), "version must be 1, got True"),
        (MINIMAL.replace("version: 1\n", ""), "lacks the key 'version'"),
        (with_lines("version: 1"), "duplicate key 'version'"),
        (with_lines("colour: red"), "unknown key 'colour'"),
        (with_lines("defaults: {sysid: 3}"), "defaults has the unknown key 'sysid'"),
        (with_lines("defaults: 3"), "defaults must be a mapping, got 3"),
        (with_lines("defaults: {autopilot: inav}"), "autopilot must be one of auto, ardupilot, px4, got 'inav'"),
        (with_lines("defaults: {max_bytes_per_s: 0}"), "max_bytes_per_s must be at least 100 .* got 0"),
        (with_lines("defaults: {max_bytes_per_s: .inf}"), "max_bytes_per_s must be a number .* got inf"),
        (MINIMAL.replace("-37.8", ".nan"), r"origin\.latitude must be a number from -89 to 89, got nan"),
        (MINIMAL.replace("-37.8", "-89.5"), r"origin\.latitude .* got -89.5"),
        (MINIMAL.replace("144.9", "200"), r"origin\.longitude .* got 200"),
        (MINIMAL.replace("144.9", "9" * 400), r"origin\.longitude must be a number .* got 999"),
        (MINIMAL.replace("144.9", "true"), r"origin\.longitude .* got True"),
        (MINIMAL.replace("144.9", "'144.9'"), r"origin\.longitude .* got '144.9'"),
        (MINIMAL.replace("uavs:", "uavs: []\nrest:"), "unknown key 'rest'"),
        (MINIMAL[: MINIMAL.index("uavs")] + "uavs: []", "uavs must be a list with at least one entry"),
        (with_uavs('name: 1a, sysid: 1, url: "tcp:h:1"'), r"uavs\[0\]\.name must be letters.* got '1a'"),
        (with_uavs('name: a/b, sysid: 1, url: "tcp:h:1"'), r"uavs\[0\]\.name .* got 'a/b'"),
        (with_uavs('name: a, sysid: 0, url: "tcp:h:1"'), r"uavs\[0\]\.sysid must be .* got 0"),
        (with_uavs('name: a, sysid: 255, url: "tcp:h:1"'), r"uavs\[0\]\.sysid must be .* got 255"),
        (with_uavs('name: a, sysid: 1.0, url: "tcp:h:1"'), r"uavs\[0\]\.sysid must be .* got 1.0"),
        (with_uavs('name: a, sysid: 1, url: "tcp:h:1", speed: 3'), r"uavs\[0\] has the unknown key 'speed'"),
        (with_uavs("name: a, sysid: 1"), r"uavs\[0\] lacks the key 'url'"),
        (with_uavs("name: a, sysid: 1, url: []"), r"uavs\[0\]\.url must be a url or a list"),
        (with_uavs("name: a, sysid: 1, url: 14550"), r"uavs\[0\]\.url must be <kind>.* got 14550"),
        (with_uavs('name: a, sysid: 1, url: "udp:h:1"'), r"uavs\[0\]\.url must be <kind>.* got 'udp:h:1'"),
        (with_uavs('name: a, sysid: 1, url: "tcp:h:65536"'), r"port from 1 to 65535, got 'tcp:h:65536'"),
        (with_uavs('name: a, sysid: 1, url: "tcp:h:0"'), "port from 1 to 65535"),
        (with_uavs('name: a, sysid: 1, url: "tcp:h:-1"'), "must be <kind>"),
        (with_uavs('name: a, sysid: 1, url: "tcp: :1"'), "must be <kind>"),
        (with_uavs('name: a, sysid: 1, url: "tcp:h\\0:1"'), "must be <kind>"),
        (with_uavs('name: a, sysid: 1, url: "serial:/dev/ttyUSB0:99999999"'), "baud rate from 1 to"),
        (with_uavs('name: a, sysid: 1, url: ["tcp:h:1", "tcp:h:1"]'), r"uavs\[0\]\.url must not name a url twice"),
        (with_uavs('name: a, sysid: 1, url: "tcp:h:1", home_m: [1]'), r"uavs\[0\]\.home_m must be \[east, north\]"),
        (with_uavs('name: a, sysid: 1, url: "tcp:h:1", home_m: [1, .inf]'), r"home_m\[1\] .* got inf"),
        (with_uavs('name: a, sysid: 1, url: "tcp:h:1", signing_key_file: 3'), "signing_key_file must be the name"),
        (
            with_uavs('name: a, sysid: 1, url: "tcp:h:1"', 'name: a, sysid: 2, url: "tcp:h:2"'),
            r"uavs\[1\]\.name: 'a' is already that of uavs\[0\]",
        ),
        (
            with_uavs('name: a, sysid: 7, url: "tcp:h:1"', 'name: b, sysid: 7, url: "tcp:h:2"'),
            r"uavs\[1\]\.sysid: 7 is already that of uavs\[0\]",
        ),
        (
            with_uavs('name: a, sysid: 1, url: "tcp:h:1", max_bytes_per_s: 500', 'name: b, sysid: 2, url: "tcp:h:1"'),
            r"uavs\[1\]\.max_bytes_per_s: None differs from 500\.0 of uavs\[0\], which shares the link tcp:h:1",
        ),
        (
            with_uavs('name: a, sysid: 1, url: "tcp:h:1"', 'name: b, sysid: 2, url: "tcp:h:1", signing_key_file: k'),
            r"uavs\[1\]\.signing_key_file: 'k' differs from None of uavs\[0\]",
        ),
        (with_lines('gcs_urls: ["udpin:0.0.0.0:14550"]'), r"gcs_urls: .* is already a url of uavs\[0\]"),
        (with_lines('gcs_urls: ["tcp:h:1", "tcp:h:1"]'), "gcs_urls must not name a url twice"),
        (with_lines("gcs_urls: {}"), "gcs_urls must be <kind>"),
        (with_lines("signing_key_file: ''"), "signing_key_file must be the name of a file, got ''"),
        (with_lines("signing_key_file: ~nobody_here_/k"), "signing_key_file names an unknown home folder"),
        (with_lines("fence: {}"), "fence must have"),
        (with_lines("fence: 3"), "fence must be a mapping, got 3"),
        (with_lines("fence: {circle: {radius_m: 5}}"), r"fence\.circle lacks the key 'center'"),
        (with_lines("fence: {circle: {center: [0, 0], radius_m: -5}}"), r"fence: circle\.radius_m .* got -5"),
        (with_lines("fence: {circle: {center: [0, .nan], radius_m: 5}}"), r"fence\.circle\.center\[1\] .* got nan"),
        (with_lines("fence: {min_height_m: 50, max_height_m: 40}"), "fence: max_height_m must be above .* got 40"),
        (with_lines("fence: {min_height_m: -1}"), "fence: min_height_m .* got -1"),
        (with_lines("fence: {polygon: []}"), r"fence\.polygon must be a list"),
        (with_lines("fence: {polygon: [[0, 0], [1, 0]]}"), "polygon must have at least 3 corners, got 2"),
        (with_lines("fence: {polygon: [[0, 0], [1, 1], [1, 0], [0, 1]]}"), "polygon must not cross itself"),
        (with_lines("fence: {polygon: [[0, 0], [9, 0], [9, 9], [0, 0]]}"), "same corner twice"),
        (with_lines("fence: {polygon: [[0, 0], [9, 0], [4, 0]]}"), "polygon must not turn back on itself"),
        (
            with_lines("fence: {polygon: [[0, 0], [9, 0], [4, 5]], circle: {center: [0, 0], radius_m: 5}}"),
            "a circle or a polygon, not both",
        ),
    ],
)
def test_what_is_wrong_is_named(text: str, message: str) -> None:
    with pytest.raises(FleetFileError, match=message) as caught:
        parse_fleet(text, source="my.yaml")
    assert str(caught.value).startswith("my.yaml: ")
    assert "\n" not in str(caught.value)


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(FleetFileError, match=r"none\.yaml: cannot be read"):
        load_fleet(tmp_path / "none.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FleetFileError, match=r"binary\.yaml: cannot be read"):
        load_fleet(tmp_path / "binary.yaml")


def test_merge_keys_work() -> None:
    fleet = parse_fleet(
        with_uavs('&base name: a, sysid: 1, url: "tcp:h:1", autopilot: px4').replace("{&base ", "&base {")
        + '  - {<<: *base, name: b, sysid: 2, url: "tcp:h:2"}\n'
    )
    assert [(uav.name, uav.autopilot) for uav in fleet.uavs] == [("a", "px4"), ("b", "px4")]


scalars = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-10, 300),
    st.floats(),
    st.text(max_size=8),
    st.sampled_from(["a", "udpin:0.0.0.0:14550", "serial:x:9", "px4", "amsl"]),
)
keys = st.sampled_from(
    [
        "version",
        "origin",
        "uavs",
        "defaults",
        "fence",
        "gcs_urls",
        "signing_key_file",
        "latitude",
        "longitude",
        "altitude_amsl_m",
        "name",
        "sysid",
        "url",
        "autopilot",
        "altitude_datum",
        "home_m",
        "max_bytes_per_s",
        "circle",
        "polygon",
        "center",
        "radius_m",
        "min_height_m",
        "max_height_m",
    ]
)
trees = st.recursive(scalars, lambda t: st.lists(t, max_size=4) | st.dictionaries(keys, t, max_size=6), max_leaves=20)


@given(st.dictionaries(keys, trees, max_size=8))
@settings(deadline=None, max_examples=60)
def test_any_tree_of_values_is_read_or_refused_in_one_line(changes: dict[str, object]) -> None:
    text = yaml.safe_dump({**yaml.safe_load(MINIMAL), **changes})
    try:
        fleet = parse_fleet(text)
    except FleetFileError as error:
        assert "\n" not in str(error)
    else:
        assert len(set(fleet.names)) == len(fleet.uavs) > 0


class TestFence:
    def test_circle_and_heights(self) -> None:
        fence = Fence(center_m=(100.0, 0.0), radius_m=50.0, min_height_m=10.0, max_height_m=60.0)
        # 30² + 40² = 50²: on the edge.
        assert fence.breach(130.0, 40.0, 10.0) is None
        assert fence.breach(130.0, 40.1, 30.0) == "50.1 m from the fence's centre is outside its radius of 50.0 m"
        assert fence.breach(100.0, 0.0, 9.9) == "height 9.9 m is below the fence's minimum of 10.0 m"
        assert fence.breach(100.0, 0.0, 60.1) == "height 60.1 m is above the fence's maximum of 60.0 m"

    @pytest.mark.parametrize("position", [(math.nan, 0.0, 1.0), (0.0, math.inf, 1.0), (0.0, 0.0, math.nan)])
    def test_what_is_not_finite_is_outside(self, position: tuple[float, float, float]) -> None:
        assert "is not finite" in Fence(max_height_m=5.0).breach(*position)

    # An L: the square from 0 to 20 without its upper right quarter.
    CORNERS = ((0.0, 0.0), (20.0, 0.0), (20.0, 10.0), (10.0, 10.0), (10.0, 20.0), (0.0, 20.0))

    @given(st.floats(-5, 25), st.floats(-5, 25), st.integers(0, 5), st.booleans())
    @settings(deadline=None)
    def test_polygon_whatever_its_first_corner_and_direction(
        self, east: float, north: float, turn: int, backwards: bool
    ) -> None:
        corners = self.CORNERS[turn:] + self.CORNERS[:turn]
        fence = Fence(polygon_m=corners[::-1] if backwards else corners)
        inside = (0 <= east <= 20 and 0 <= north <= 10) or (0 <= east <= 10 and 0 <= north <= 20)
        assert (fence.breach(east, north, 1.0) is None) == inside

    @pytest.mark.parametrize("point", [*CORNERS, (5.0, 0.0), (20.0, 5.0), (10.0, 15.0)])
    def test_edges_and_corners_are_inside(self, point: tuple[float, float]) -> None:
        assert Fence(polygon_m=self.CORNERS).breach(*point, 0.0) is None

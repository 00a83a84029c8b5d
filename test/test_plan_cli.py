"""The command line: what files hold is what is planned, and what is written is what was planned.

Oracles: `solve` called with the same numbers; the formats' own parsers and a schema written from RFC 7946; the
positions that the test itself put in.
"""

from __future__ import annotations

import csv
import json
import math
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Sequence
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.image import imread

from jpap_ros.cli.device_file import DeviceFileError, read_devices
from jpap_ros.cli.plan import main
from jpap_ros.cli.proof import proof_line
from jpap_ros.fleet.config import MapOrigin
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.planning import SCHEMES, LinkBudget, solve

ROOT = Path(__file__).parent.parent
SCHEMA = json.loads((Path(__file__).parent / "geojson.schema.json").read_text())
ORIGIN = MapOrigin(-37.8136, 144.9631, 20.0)

RNG = np.random.default_rng(11)
POSITIONS = RNG.uniform(-400.0, 400.0, (14, 2))
RATES = RNG.uniform(15.0, 20.0, 14)
WEIGHTS = RNG.integers(1, 5, 14).astype(float)
IDS = [f"device {k}" for k in range(14)]


def metres_csv(path: Path) -> Path:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["id", "x", "y", "rate_demand", "weight"])
        writer.writerows(
            [i, *map(float, p), float(r), float(w)] for i, p, r, w in zip(IDS, POSITIONS, RATES, WEIGHTS, strict=True)
        )
    return path


def degrees_geojson(path: Path) -> Path:
    frame = LocalFrame(ORIGIN)
    features = []
    for name, position, rate, weight in zip(IDS, POSITIONS, RATES, WEIGHTS, strict=True):
        latitude, longitude = frame.to_geodetic(*map(float, position))
        features.append(
            {
                "type": "Feature",
                "geometry": {"type": "Point", "coordinates": [longitude, latitude]},
                "properties": {"id": name, "rate_demand": rate, "weight": weight},
            }
        )
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path


def run(*arguments: object, cwd: Path = ROOT) -> subprocess.CompletedProcess[str]:
    """Run the module that scripts/plan runs, as a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "jpap_ros.cli.plan", *map(str, arguments)],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=120,
    )


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


# Whole runs


def test_csv_round_trip_is_what_solve_says(tmp_path: Path) -> None:
    # Oracle: solve() called with the numbers that went into the file.
    out = tmp_path / "made" / "plan.csv"
    result = run(metres_csv(tmp_path / "devices.csv"), "--scheme", "jpap", "--output", out)
    assert (result.returncode, result.stderr) == (0, "")
    expected = solve(POSITIONS, RATES, "jpap", weights=WEIGHTS)
    assert f"{proof_line(expected)}; 14 of 14 devices served" in result.stdout
    assert result.stdout.endswith(f"{out}\n")
    rows = rows_of(out)
    assert [row["id"] for row in rows] == IDS
    assert [int(row["uav"].removeprefix("uav")) - 1 for row in rows] == expected.serving_uav.tolist()
    goals = [[float(row["uav_x"]), float(row["uav_y"])] for row in rows]
    assert np.array_equal(goals, expected.uav_positions[expected.serving_uav])
    assert [float(row["power_w"]) for row in rows] == expected.power_w.tolist()
    assert [float(row["rate"]) for row in rows] == expected.rate.tolist()
    assert "latitude" not in rows[0], "nothing says where on the earth the metres are"


def test_by_default_the_fleet_is_proven_to_be_the_smallest(tmp_path: Path) -> None:
    # Oracle: solve(); its UAVs may be numbered otherwise from run to run, and its rate is known to 1e-3 bit/s/Hz.
    out = tmp_path / "plan.csv"
    result = run(metres_csv(tmp_path / "devices.csv"), "--output", out)
    assert (result.returncode, result.stderr) == (0, "")
    expected = solve(POSITIONS, RATES, "optimal", weights=WEIGHTS)
    assert f"{len(expected.uav_positions)} UAVs, proven minimum; 14 of 14 devices served" in result.stdout
    rates = [float(row["rate"]) for row in rows_of(out)]
    assert sum(rates) / len(expected.uav_positions) == pytest.approx(expected.average_uav_rate, abs=2e-3)


def test_every_format_of_a_geodetic_plan(tmp_path: Path) -> None:
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text(
        "version: 1\n"
        f"origin: {{latitude: {ORIGIN.latitude}, longitude: {ORIGIN.longitude}, altitude_amsl_m: 20}}\n"
        "defaults: {autopilot: px4}\n"
        "fence: {circle: {center: [0, 0], radius_m: 2000}}\n"
        "uavs:\n"
        + "".join(f"  - {{name: bird{i}, sysid: {i}, url: 'udpin:127.0.0.1:{15000 + i}'}}\n" for i in range(1, 13))
    )
    devices = degrees_geojson(tmp_path / "devices.geojson")
    outputs = [tmp_path / f"plan.{suffix}" for suffix in ("geojson", "kml", "plan", "csv", "png", "svg")]
    result = run(devices, "--fleet", fleet, "--altitude", 60, "--scheme", "jpap", "--output", *outputs)
    assert (result.returncode, result.stderr) == (0, "")
    geojson, kml, plan, table, png, svg = outputs

    # The origin is the fleet's, so solve() in its metres gives the same plan to the micrometre of the conversion.
    expected = solve(POSITIONS, RATES, "jpap", LinkBudget(altitude_m=60.0), weights=WEIGHTS, max_uavs=12)
    data = json.loads(geojson.read_text())
    jsonschema.validate(data, SCHEMA)
    kinds = [feature["properties"]["kind"] for feature in data["features"]]
    count = len(expected.uav_positions)
    assert [kinds.count(kind) for kind in ("uav", "device", "link", "fence")] == [count, 14, 14, 1]
    frame = LocalFrame(ORIGIN)
    goals = {
        feature["properties"]["name"]: frame.to_map(*reversed(feature["geometry"]["coordinates"][:2]))
        for feature in data["features"]
        if feature["properties"]["kind"] == "uav"
    }
    assert set(goals) <= {f"bird{i}" for i in range(1, 13)}
    placed = np.array(sorted(goals.values()))
    assert placed == pytest.approx(np.array(sorted(map(tuple, expected.uav_positions.tolist()))), abs=0.02)

    space = {"k": "http://www.opengis.net/kml/2.2"}
    root = ElementTree.parse(kml).getroot()
    uavs = root.find("k:Document/k:Folder", space)
    assert uavs is not None
    assert {mark.findtext("k:name", namespaces=space) for mark in uavs.findall("k:Placemark", space)} == set(goals)

    mission = json.loads(plan.read_text())
    assert {"fileType", "version", "groundStation", "mission", "geoFence", "rallyPoints"} == set(mission)
    assert mission["mission"]["firmwareType"] == 12, "the fleet flies PX4"
    assert [item["params"][6] for item in mission["mission"]["items"]] == [60.0] * count
    assert mission["geoFence"]["circles"][0]["circle"]["radius"] == 2000.0

    rows = rows_of(table)
    for row in rows:
        there = frame.to_map(float(row["uav_latitude"]), float(row["uav_longitude"]))
        assert there == pytest.approx((float(row["uav_x"]), float(row["uav_y"])), abs=1e-3)
        assert goals[row["uav"]] == pytest.approx(there, abs=0.02)

    pixels = imread(png)
    assert min(pixels.shape[:2]) > 600
    assert pixels.std() > 0.05, "something is drawn"
    assert proof_line(expected) in "".join(ElementTree.parse(svg).getroot().itertext())


def test_a_fleet_too_small_says_who_is_left_out(tmp_path: Path) -> None:
    out = tmp_path / "plan.csv"
    result = run(metres_csv(tmp_path / "devices.csv"), "--max-uavs", 2, "--scheme", "jpap", "--output", out)
    expected = solve(POSITIONS, RATES, "jpap", weights=WEIGHTS, max_uavs=2)
    assert result.returncode == 1
    assert result.stderr == ""
    unserved = [row for row in rows_of(out) if not row["uav"]]
    assert [row["id"] for row in unserved] == [IDS[k] for k in expected.unserved]
    assert all("more UAV" in row["unserved_because"] and row["rate"] == "" for row in unserved)
    # Names for numbers: the second UAV is uav2, not 1.
    assert "UAV 1" not in result.stdout
    assert "uav2" in result.stdout


def test_comparison_has_every_scheme_as_solve_says(tmp_path: Path) -> None:
    out, picture = tmp_path / "schemes.csv", tmp_path / "schemes.png"
    result = run(metres_csv(tmp_path / "devices.csv"), "--compare", "--output", out, picture)
    assert (result.returncode, result.stderr) == (0, "")
    rows = rows_of(out)
    assert [row["scheme"] for row in rows] == list(SCHEMES)
    for row in rows:
        expected = solve(POSITIONS, RATES, row["scheme"], weights=WEIGHTS)
        assert int(row["uavs"]) == len(expected.uav_positions)
        assert float(row["average_uav_rate"]) == pytest.approx(expected.average_uav_rate, abs=2e-3)
        assert row["scheme"] in result.stdout
    best = min(int(row["uavs"]) for row in rows)
    assert f"at least {best} UAVs" in result.stdout
    assert imread(picture).std() > 0.05


def test_help_shows_examples_and_exit_status() -> None:
    result = run("--help")
    assert result.returncode == 0
    for words in ("scripts/plan devices.csv --compare", "exit status", "latitude,longitude", "--min-separation"):
        assert words in result.stdout


def test_a_file_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("a file, not a folder")
    result = run(metres_csv(tmp_path / "devices.csv"), "--output", tmp_path / "taken" / "plan.csv")
    assert result.returncode == 3
    assert result.stderr.startswith(f"plan: {tmp_path}/taken/plan.csv: cannot be written")
    assert len(result.stderr.splitlines()) == 1


def test_the_script_takes_names_relative_to_where_the_user_stands(tmp_path: Path) -> None:
    metres_csv(tmp_path / "devices.csv")
    result = subprocess.run(
        [ROOT / "scripts" / "plan", "devices.csv", "--scheme", "jpap", "--output", "plan.csv"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert "14 of 14 devices served" in result.stdout
    assert (tmp_path / "plan.csv").exists()


# Options, in this process: the same function, without a second for each interpreter


def test_limits_and_radio_reach_the_solver(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # Oracle: Deployment.violations with the same limits.
    out = tmp_path / "plan.csv"
    options = (
        "--scheme jpap --max-devices-per-uav 2 --min-separation 80 --power 43 --noise -92 --gain -31 --altitude 70"
    )
    assert main([str(metres_csv(tmp_path / "d.csv")), *options.split(), "--output", str(out)]) == 0
    link = LinkBudget(43.0, -92.0, -31.0, 70.0)
    expected = solve(POSITIONS, RATES, "jpap", link, max_devices_per_uav=2, min_separation_m=80.0, weights=WEIGHTS)
    assert expected.violations(POSITIONS, RATES, link, 2, None, 80.0) == []
    assert [float(row["power_w"]) for row in rows_of(out)] == expected.power_w.tolist()
    assert "of 20" in capsys.readouterr().out, "43 dBm are 20 W"


def test_absurd_demands_are_told_and_nothing_else(tmp_path: Path) -> None:
    # 2^5000 - 1 is beyond every number that a computer has.
    (tmp_path / "d.csv").write_text("id,x,y,rate_demand\nhuge,1,2,5000\nfine,3,4,16\n")
    result = run(tmp_path / "d.csv", "--scheme", "jpap")
    assert (result.returncode, result.stderr) == (1, "")
    assert "demands 5000 bit/s/Hz; the most that one UAV can give" in result.stdout


def test_goals_outside_the_fence_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text(
        "version: 1\norigin: {latitude: -37.8, longitude: 145}\nfence: {max_height_m: 40}\n"
        "uavs: [{name: bird, sysid: 1, url: 'udpin:127.0.0.1:15001'}]\n"
    )
    devices = tmp_path / "devices.csv"
    devices.write_text("id,x,y,rate_demand\na,10,20,16\n")
    assert main([str(devices), "--fleet", str(fleet)]) == 1
    assert "goal of bird: height 50.0 m is above the fence's maximum of 40.0 m" in capsys.readouterr().err


def test_origin_is_the_middle_of_devices_across_the_180th_meridian(tmp_path: Path) -> None:
    # Oracle: two devices 0.002 deg apart have their middle at the meridian itself.
    path = tmp_path / "devices.csv"
    path.write_text("id,latitude,longitude,rate_demand\na,-17,179.999,16\nb,-17,-179.999,16\n")
    found = read_devices(path)
    origin = found.centroid()
    assert abs(origin.longitude) == pytest.approx(180.0)
    east, west = (device.position for device in found.devices(LocalFrame(origin)))
    # 0.001 deg of longitude at latitude -17: 111.32 km/deg * cos 17 deg * 0.001 = 106.5 m.
    assert (east[0], west[0]) == pytest.approx((-106.5, 106.5), abs=0.5)


# Bad input

GOOD = "id,x,y,rate_demand,weight\na,1,2,16,1\n"


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("d.csv", "", "d.csv: is empty"),
        ("d.csv", "id,x,y,rate_demand\n", "d.csv: has no devices"),
        ("d.csv", GOOD + "b,1,two,16,1\n", "d.csv:3: column y: must be a number, got 'two'"),
        ("d.csv", GOOD + "b,1,2,nan,1\n", "d.csv:3: column rate_demand: must be a number, got 'nan'"),
        ("d.csv", GOOD + "b,1_0,2,16,1\n", "d.csv:3: column x: must be a number, got '1_0'"),
        ("d.csv", GOOD + "b,1,2,0,1\n", "d.csv:3: rate_demand must be finite and > 0, got 0.0"),
        ("d.csv", GOOD + "b,1,2,16,-1\n", "d.csv:3: weight must be finite and > 0, got -1.0"),
        ("d.csv", GOOD + "b,1e9,2,16,1\n", "d.csv:3: x must be from -100000 to 100000 m, got 1000000000.0"),
        ("d.csv", GOOD + ",1,2,16,1\n", "d.csv:3: id must not be empty"),
        ("d.csv", GOOD + "\n\na,5,6,16,1\n", "d.csv:5: id: 'a' is already that of"),
        ("d.csv", GOOD + "b,1,2,16\n", "d.csv:3: has 4 columns, the first line 5, got 'b,1,2,16'"),
        ("d.csv", GOOD + 'b,"1,2,16,1\n', "d.csv:3: not valid CSV"),
        ("d.csv", "id;x;y;rate_demand\na;1;2;16\n", "d.csv:1: lacks the column 'id', got 'id;x;y;rate_demand'"),
        ("d.csv", "id,latitude,rate_demand\na,1,16\n", "d.csv:1: lacks the column 'longitude'"),
        ("d.csv", "id,x,y,latitude,longitude,rate_demand\n", "d.csv:1: has x or y and latitude or longitude"),
        ("d.csv", "id,x,y,x,rate_demand\n", "d.csv:1: column 'x' stands twice"),
        ("d.csv", "id,latitude,longitude,rate_demand\na,95,0,16\n", "d.csv:2: latitude must be from -90 to 90 degrees"),
        ("d.csv", b"id,x,y,rate_demand\na,1,2,16\n\xff,1,2,16\n", "d.csv:3: not UTF-8: byte 0xff"),
        ("d.geojson", '{"type": "FeatureCollection",\n "features": [,]}', "d.geojson:2:15: not valid JSON"),
        ("d.geojson", "[" * 100_000, "d.geojson: not valid JSON"),
        ("d.geojson", "[]", "d.geojson: type must be 'FeatureCollection', got 'list'"),
        ("d.geojson", '{"type": "Feature"}', "type must be 'FeatureCollection', got 'Feature'"),
        ("d.geojson", '{"type": "FeatureCollection"}', "features must be a list, got None"),
        ("d.geojson", '{"type": "FeatureCollection", "features": []}', "d.geojson: has no devices"),
    ],
)
def test_bad_files(tmp_path: Path, name: str, text: str | bytes, message: str) -> None:
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(DeviceFileError) as caught:
        read_devices(path).devices(LocalFrame(ORIGIN))
    assert message in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def point(**changes: object) -> dict[str, object]:
    return {
        "type": "Feature",
        "geometry": {"type": "Point", "coordinates": [144.96, -37.81]},
        "properties": {"id": "a", "rate_demand": 16},
        **changes,
    }


@pytest.mark.parametrize(
    ("feature", "message"),
    [
        (point(type="Point"), "features[1]: must be a Feature"),
        (point(geometry=None), "features[1].geometry: must be a Point, got None"),
        (point(geometry={"type": "Polygon"}), "features[1].geometry: must be a Point"),
        (point(geometry={"type": "Point", "coordinates": [1]}), "coordinates: must be [longitude, latitude], got [1]"),
        (point(geometry={"type": "Point", "coordinates": ["1", 2]}), "coordinates[0]: must be a number, got '1'"),
        (point(geometry={"type": "Point", "coordinates": [-37.81, 144.96]}), "latitude must be from -90 to 90"),
        (
            point(geometry={"type": "Point", "coordinates": [0, 0]}, properties={"id": "b", "rate_demand": 16}),
            "features[1]: latitude 0.0, longitude 0.0 is off the map around",
        ),
        (point(properties=None), "features[1].properties: must be an object, got None"),
        (point(properties={"id": "b"}), "properties.rate_demand: must be a number, got None"),
        (point(properties={"id": "b", "rate_demand": True}), "rate_demand: must be a number, got True"),
        (point(properties={"id": "b", "rate_demand": 10**400}), "rate_demand: must be a number, got 1000"),
        (point(properties={"id": "b", "rate_demand": math.inf}), "rate_demand: must be a number, got inf"),
        (point(properties={"id": [], "rate_demand": 16}), "properties.id: must be text or a whole number, got []"),
        (point(properties={"rate_demand": 16}), "features[1].id: must be text or a whole number, got None"),
        (point(), "features[1]: id: 'a' is already that of"),
    ],
)
def test_bad_features(tmp_path: Path, feature: dict[str, object], message: str) -> None:
    path = tmp_path / "d.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [point(), feature]}))
    with pytest.raises(DeviceFileError) as caught:
        read_devices(path).devices(LocalFrame(ORIGIN))
    assert message in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["missing.csv"], "missing.csv: cannot be read: No such file or directory"),
        (["{good}", "--output", "plan.pdf"], "--output: a plan is written as .png, .svg, .csv, .geojson, .kml, .plan"),
        (["{good}", "--compare", "--output", "plan.kml"], "--output: a comparison is written as .png, .svg, .csv"),
        (["{good}", "--output", "plan.kml"], "need a place on the earth: give --origin or --fleet"),
        (["{good}", "--fleet", "{fleet}", "--max-uavs", "13"], "--max-uavs 13: {fleet} has 12"),
        (["{good}", "--fleet", "none.yaml"], "none.yaml: cannot be read"),
    ],
)
def test_bad_options(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: Sequence[str], message: str
) -> None:
    good = tmp_path / "good.csv"
    good.write_text(GOOD)
    names = {"good": good, "fleet": ROOT / "config" / "fleet_example.yaml"}
    assert main([argument.format(**names) for argument in arguments]) == 2
    captured = capsys.readouterr()
    assert message.format(**names) in captured.err
    assert captured.err.startswith("plan: ")
    assert len(captured.err.splitlines()) == 1
    assert captured.out == ""
    assert not (tmp_path / "plan.kml").exists()


@pytest.mark.parametrize("option", [["--origin", "-37.81,144.96"], ["--origin=-37.81,144.96"]])
def test_an_origin_south_of_the_equator(tmp_path: Path, option: list[str]) -> None:
    # Oracle: the origin itself is where the device at (0, 0) is.
    devices, out = tmp_path / "devices.csv", tmp_path / "plan.csv"
    devices.write_text("id,x,y,rate_demand\na,0,0,16\n")
    assert main([str(devices), "--scheme", "jpap", *option, "--output", str(out)]) == 0
    (row,) = csv.DictReader(out.read_text().splitlines())
    assert (float(row["latitude"]), float(row["longitude"])) == (pytest.approx(-37.81), pytest.approx(144.96))


@pytest.mark.parametrize(
    "arguments",
    [
        ["--origin", "north pole"],
        ["--origin", "90,0"],
        ["--origin", "-90,0"],
        ["--max-uavs", "0"],
        ["--max-devices-per-uav", "1.5"],
        ["--min-separation", "-1"],
        ["--time-limit", "inf"],
        ["--power", "nan"],
        ["--noise", "1"],
        ["--gain", "1e400"],
        ["--altitude", "0"],
        ["--scheme", "best"],
    ],
)
def test_bad_numbers(tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["devices.csv", *arguments])
    assert stopped.value.code == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert arguments[0] in last
    assert arguments[1] in last


def test_columns_in_any_order_and_case_with_others_between(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # As spreadsheets write it: a byte order mark, carriage returns, a blank weight, and columns of their own.
    path = tmp_path / "d.csv"
    path.write_bytes("\ufeffRate_Demand, Y ,X,note,ID,Weight\r\n16,2,1,roof,a,\r\n17,4,3,,b,2\r\n".encode())
    assert [(d.id, d.position, d.rate_demand, d.weight) for d in read_devices(path).devices(None)] == [
        ("a", (1.0, 2.0), 16.0, 1.0),
        ("b", (3.0, 4.0), 17.0, 2.0),
    ]
    assert main([str(path), "--scheme", "jpap"]) == 0
    assert capsys.readouterr().err == "plan: columns not used: note\n"


def test_a_suffix_in_capitals_and_a_character_that_only_looks_like_a_new_line(tmp_path: Path) -> None:
    devices, out = tmp_path / "D.CSV", tmp_path / "MAP.PNG"
    devices.write_text("id,x,y,rate_demand\nroof\u2028top,1,2,16\n", encoding="utf-8")
    assert [device.id for device in read_devices(devices).devices(None)] == ["roof\u2028top"]
    assert main([str(devices), "--scheme", "jpap", "--output", str(out)]) == 0
    assert imread(out).std() > 0


@pytest.fixture(scope="module")
def scratch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("scratch")


@settings(max_examples=150, deadline=None)
@given(st.binary(max_size=200) | st.text(alphabet='id,xy\n"rate_demand.0123456789e-', max_size=120).map(str.encode))
def test_no_csv_is_too_strange(scratch: Path, content: bytes) -> None:
    """Whatever the bytes, either devices come out or one line that names the file."""
    check_any(scratch / "any.csv", content)


@settings(max_examples=100, deadline=None)
@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(max_size=5) | st.sampled_from(["Feature", "Point"]),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(
                st.sampled_from(["type", "features", "geometry", "coordinates", "properties", "id", "rate_demand"]),
                inner,
                max_size=4,
            )
        ),
        max_leaves=12,
    )
)
def test_no_feature_is_too_strange(scratch: Path, feature: object) -> None:
    check_any(
        scratch / "any.geojson", json.dumps({"type": "FeatureCollection", "features": [feature, point()]}).encode()
    )


def check_any(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    convert: Callable[[], object] = lambda: read_devices(path).devices(LocalFrame(ORIGIN))  # noqa: E731
    try:
        convert()
    except DeviceFileError as error:
        assert str(path) in str(error)
        assert len(str(error).splitlines()) == 1

"""The documentation says what the product does: its commands run or fit the product, its tables are those of the code.

What can run here runs (`scripts/plan`, `scripts/report`, Python); commands of ROS 2's tools, which are not installed
here, are checked word by word against executables, parameters, launch files, topics, services and message definitions.
Dead links are looked for in test_readme.py.
"""

from __future__ import annotations

import importlib
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from graph import Graph, NodeProcess
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from test_launch_files import executables
from test_report import write_flight

from jpap_ros.cli.plan import main as plan
from jpap_ros.fleet.config import FleetFileError, parse_fleet
from jpap_ros.nodes.parameter_tables import tables
from jpap_ros.report.__main__ import main as report

ROOT = Path(__file__).parent.parent
README = ROOT / "README.md"
PAGES = [README, *sorted((ROOT / "docs").glob("*.md"))]


def blocks(page: Path, *languages: str) -> Iterator[str]:
    """Fenced code of a page in one of the languages."""
    for language, body in re.findall(r"^ *```(\w*)\n(.*?)^ *```", page.read_text(encoding="utf-8"), re.DOTALL | re.M):
        if language in languages:
            yield body


def commands(page: Path) -> Iterator[str]:
    """Every command that a page tells the reader to type: fenced `sh`, and indented code in the README."""
    text = page.read_text(encoding="utf-8")
    bodies = list(blocks(page, "sh"))
    if page == README:
        plain = re.sub(r"^ *```.*?^ *```", "", text, flags=re.DOTALL | re.M)
        bodies += re.findall(r"(?:^    .*\n)+", plain, re.M)
    for body in bodies:
        for line in body.replace("\\\n", " ").splitlines():
            command = re.sub(r"\s+#.*", "", line).strip()
            if command:
                yield command


#: With the first page of each: what stands on several pages is checked once.
COMMANDS = sorted({command: page.name for page in reversed(PAGES) for command in commands(page)}.items())


def rows(text: str, columns: int) -> list[list[str]]:
    """Cells of every row of Markdown tables with so many columns; headings and rules left out."""
    found = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("| ")
    ]
    return [row for row in found if len(row) == columns]


def section(page: Path, heading: str) -> str:
    match = re.search(rf"^## {heading}\n(.*?)(?=^## |\Z)", page.read_text(encoding="utf-8"), re.DOTALL | re.M)
    assert match, f"{page.name} has no section {heading}"
    return match[1]


def contract() -> dict[str, tuple[str, str]]:
    """Type and quality of service of each topic and service in the README's table."""
    table: dict[str, tuple[str, str]] = {}
    for names, kind, _, qos in rows(section(README, "Topics and services"), 4)[1:]:
        match = re.search(r"`(\w+/\w+)`", kind)
        assert match, kind
        for name in re.findall(r"`([^`]+)`", names):
            table[name] = match[1], qos
    return table


CONTRACT = contract()


# Commands


def run_plan(arguments: list[str], tmp_path: Path) -> None:
    assert plan(arguments) in (0, 1), "served, or told who is not"
    for name in arguments[arguments.index("--output") + 1 :] if "--output" in arguments else []:
        assert (tmp_path / name).stat().st_size > 100


@cache
def demo_help() -> str:
    command = [sys.executable, "-m", "jpap_ros.demo", "--help"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def check_demo(arguments: list[str]) -> None:
    for argument in arguments:
        if argument.startswith("--"):
            assert argument in demo_help()
    if "--scenario" in arguments:
        assert (ROOT / "config" / "scenarios" / f"{arguments[arguments.index('--scenario') + 1]}.yaml").exists()


def check_run(arguments: list[str]) -> None:
    package, executable, *rest = arguments
    assert package == "jpap_ros"
    assert executable in executables()
    known = tables().partition(f"### `{executable}`")[2].partition("### ")[0]
    for flag, setting in zip(rest[1::2], rest[2::2], strict=True):
        assert rest[0] == "--ros-args"
        if flag == "--params-file":
            continue
        assert flag == "-p"
        assert f"| `{setting.partition(':=')[0]}`" in known, f"{executable} has no parameter {setting}"


def check_bag(arguments: list[str]) -> None:
    verb, *rest = arguments
    assert verb in ("info", "play")
    assert rest[:2] == ["-s", "mcap"] and rest[2].endswith(".mcap") and len(rest) == 3


def check_launch(arguments: list[str]) -> None:
    package, name, *rest = arguments
    assert package == "jpap_ros"
    text = (ROOT / "launch" / name).read_text()
    for setting in rest:
        assert re.search(rf'DeclareLaunchArgument\(\s*"{setting.partition(":=")[0]}"', text), setting


def check_topic(arguments: list[str]) -> None:
    verb, *rest = [argument for argument in arguments if argument != "--once"]
    name = re.sub(r"^(uav\d+|kestrel)/", "<uav>/", rest[0])
    assert name in CONTRACT, f"no topic {name}"
    if verb == "pub":
        kind, text = rest[1:]
        assert kind.replace("/msg/", "/") == CONTRACT[name][0]
        fill(message(kind)(), yaml.safe_load(text))
    else:
        assert verb == "echo" and len(rest) == 1


def check_service(arguments: list[str]) -> None:
    verb, name, kind, *text = arguments
    assert verb == "call"
    assert CONTRACT[name][0] == kind.replace("/srv/", "/")
    fill(message(kind).Request(), yaml.safe_load(text[0]) if text else {})


def message(kind: str) -> Any:
    package, group, name = kind.split("/")
    return getattr(importlib.import_module(f"{package}.{group}"), name)


def fill(target: Any, values: dict[str, Any]) -> None:
    """Set fields as `ros2 topic pub` does; rclpy's own setters refuse what does not fit."""
    kinds = target.get_fields_and_field_types()
    for name, value in values.items():
        assert name in kinds, f"{type(target).__name__} has no field {name}"
        kind = kinds[name]
        if isinstance(value, dict):
            fill(getattr(target, name), value)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            package, item = re.fullmatch(r"sequence<(\w+)/(\w+)>", kind).groups()
            for entry in value:
                fill(message(f"{package}/msg/{item}")(), entry)
        else:
            setattr(target, name, value)


#: Set-up of the reader's own machines: only the shell has a look at it.
ELSEWHERE = ("source", "colcon", "pip", "rosdep", "ssh", "(umask")


@pytest.mark.parametrize(
    ("command", "page"), COMMANDS, ids=lambda value: value if len(value) < 60 else value[:57] + "..."
)
def test_commands(command: str, page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program, *arguments = shlex.split(command)
    if program in ELSEWHERE:
        subprocess.run(["bash", "-n", "-c", command], check=True)
        return
    if program == "scripts/plan" and page != "README.md":
        # Where the reader stands, without writing into the repository.
        for name in ("devices_example.csv", "fleet_example.yaml"):
            (tmp_path / "config").mkdir(exist_ok=True)
            shutil.copy(ROOT / "config" / name, tmp_path / "config")
        monkeypatch.chdir(tmp_path)
        run_plan(arguments, tmp_path)
    elif program == "scripts/report" and page != "README.md":
        monkeypatch.chdir(tmp_path)
        recording = Path(arguments[0])
        recording.parent.mkdir(parents=True)
        write_flight(recording)
        assert report(arguments) == 0
    elif program.startswith("scripts/"):
        assert os.access(ROOT / program, os.X_OK)
        if program == "scripts/demo":
            check_demo(arguments)
    else:
        assert program == "ros2", f"nobody checks {command!r}"
        checks: dict[str, Callable[[list[str]], None]] = {
            "bag": check_bag,
            "run": check_run,
            "launch": check_launch,
            "topic": check_topic,
            "service": check_service,
        }
        checks[arguments[0]](arguments[1:])


def test_commands_were_found() -> None:
    # Otherwise the tests above would pass by checking nothing.
    found = {command.split()[0] for command, _ in COMMANDS}
    assert {"scripts/plan", "scripts/demo", "ros2"} <= found
    assert len(COMMANDS) > 30


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_python_blocks(page: Path) -> None:
    for body in blocks(page, "python"):
        code = compile(body, str(page), "exec")
        if page.name in ("README.md", "how-planning-works.md"):
            exec(code, {})


# Files shown


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_yaml_blocks_are_fleet_files_or_parts_of_one(page: Path) -> None:
    whole = "version: 1\norigin: {latitude: 0, longitude: 0}\nuavs: [{name: a, sysid: 1, url: 'udpin:0.0.0.0:1'}]\n"
    for body in blocks(page, "yaml"):
        text = "\n".join(line.removeprefix("   ") if body.startswith("   ") else line for line in body.splitlines())
        parse_fleet(text if "version:" in text else whole + text)


def test_the_table_of_keys_is_that_of_the_reader() -> None:
    # Oracle: the reader's own words about a key that it does not know.
    page = ROOT / "docs" / "fleet-file.md"
    documented = {key for row in rows(section(page, "Keys"), 3)[1:] for key in re.findall(r"`([^`]+)`", row[0])}
    base: dict[str, Any] = {
        "version": 1,
        "origin": {"latitude": 0, "longitude": 0},
        "fence": {"circle": {"center": [0, 0], "radius_m": 1}},
        "defaults": {},
        "uavs": [{"name": "a", "sysid": 1, "url": "udpin:0.0.0.0:1"}],
    }

    def known(*path: str | int) -> list[str]:
        data = json.loads(json.dumps(base))
        place = data
        for step in path:
            place = place[step]
        place["nonsense"] = 1
        with pytest.raises(FleetFileError, match="unknown key 'nonsense'; known are") as caught:
            parse_fleet(yaml.safe_dump(data))
        return str(caught.value).partition("known are ")[2].split(", ")

    keys = {key for key in known() if key not in ("origin", "fence", "uavs")} | {"uavs"}
    keys |= {f"origin.{key}" for key in known("origin")}
    keys |= {f"fence.{key}" for key in known("fence") if key != "circle"}
    keys |= {f"fence.circle.{key}" for key in known("fence", "circle")}
    keys |= {f"uavs[].{key}" for key in known("uavs", 0)}
    assert documented == keys
    shared = section(page, "Keys").partition("| `defaults` |")[2].splitlines()[0]
    assert set(re.findall(r"`(\w+)`", shared)) == set(known("defaults"))


def test_the_script_shown_is_the_one_in_the_layout() -> None:
    layout = json.loads((ROOT / "config" / "foxglove" / "jpap.json").read_text())
    (script,) = layout["userNodes"].values()
    (shown,) = blocks(ROOT / "docs" / "with-rviz-and-foxglove.md", "ts")
    assert shown in script["sourceCode"]


def test_every_page_is_reached_from_the_readme() -> None:
    seen, left = set(), [README]
    while left:
        page = left.pop()
        if page in seen:
            continue
        seen.add(page)
        links = re.findall(r"\]\((?!http)([^)\s#]+\.md)", page.read_text(encoding="utf-8"))
        left += [(page.parent / link).resolve() for link in links]
    assert set(PAGES) <= seen, f"no link to {set(PAGES) - seen}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_topics_of_an_aircraft_are_those_of_the_contract(page: Path) -> None:
    for name in re.findall(r"`(<uav>/\w+)`", page.read_text(encoding="utf-8")):
        assert name in CONTRACT, name


# The running product

#: What every node has by itself.
OF_ROS = re.compile(r"/(rosout|parameter_events|clock)|.*/(transition_event|\w*parameters?\w*|get_type_description)|"
                    r".*/(change_state|get_state|get_available_\w+|get_transition_graph)")  # fmt: skip
QOS = {
    "latched": (ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL),
    "reliable, transient local, depth 100": (ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL),
    "sensor data": (ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.VOLATILE),
    "default": (ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE),
}


def test_topics_services_and_diagnostics_are_those_of_the_running_graph(
    graph: Graph,
    start_node: Callable[..., NodeProcess],
    free_ports: Callable[[int], list[int]],
    tmp_path: Path,
) -> None:
    """Oracle: what rclpy tells of the nodes as they run."""
    (port,) = free_ports(1)
    path = tmp_path / "fleet.yaml"
    path.write_text(
        "version: 1\norigin: {latitude: -37.8, longitude: 145}\ndefaults: {autopilot: px4}\n"
        f"uavs: [{{name: kestrel, sysid: 1, url: 'udpin:127.0.0.1:{port}'}}]\n"
    )
    diagnostics = graph.collect(DiagnosticArray, "/diagnostics", 10)
    nodes: dict[str, dict[str, Any]] = {
        "planner": {},
        "bridge": {"tlog_dir": str(tmp_path / "tlog")},
        "sim": {},
        "markers": {},
        "recorder": {"folder": str(tmp_path / "recordings")},
        "dashboard": {"port": 0, "exercise": True},
    }
    for name, parameters in nodes.items():
        start_node(name, {"fleet_file": str(path), **parameters})

    def named(name: str) -> str:
        return name if name == "/diagnostics" else name.removeprefix("/").replace("kestrel/", "<uav>/")

    def offered() -> dict[str, str]:
        found = {}
        for node in nodes:
            for look in (
                graph.node.get_publisher_names_and_types_by_node,
                graph.node.get_subscriber_names_and_types_by_node,
                graph.node.get_service_names_and_types_by_node,
            ):
                for name, (kind,) in look(node, "/"):
                    if not OF_ROS.fullmatch(name):
                        found[named(name)] = re.sub("/(msg|srv)/", "/", kind)
        return found

    wanted = {name: kind for name, (kind, _) in CONTRACT.items()}

    def complete() -> bool:
        there = {node for node, _ in graph.node.get_node_names_and_namespaces()}
        return there >= set(nodes) and offered().keys() >= wanted.keys()

    try:
        graph.wait(complete, "every topic and service of the README")
    except AssertionError:
        assert offered() == wanted
        raise
    assert offered() == wanted
    for name, (_, qos) in CONTRACT.items():
        topic = name.replace("<uav>", "kestrel")
        ends = [
            info
            for look in (graph.node.get_publishers_info_by_topic, graph.node.get_subscriptions_info_by_topic)
            for info in look(topic if topic.startswith("/") else f"/{topic}")
            # The recorder listens to whatever is offered.
            if info.node_name in nodes and info.node_name != "recorder"
        ]
        for info in ends:
            assert (info.qos_profile.reliability, info.qos_profile.durability) == QOS[qos], (name, info.node_name)

    def statuses() -> set[str]:
        names = {status.name for array in diagnostics for status in array.status}
        return {re.sub(r"link udpin.*", "link <url>", re.sub("kestrel", "<uav>", name)) for name in names}

    table = rows((ROOT / "docs" / "diagnostics.md").read_text(), 5)[1:]
    documented = {name for row in table for name in re.findall(r"`([^`]+)`", row[0])}
    graph.wait(lambda: statuses() >= documented, "every status of docs/diagnostics.md")
    assert statuses() == documented
    nameless = [status.name for array in diagnostics for status in array.status if not status.hardware_id]
    assert not nameless, "every status says what it is about"

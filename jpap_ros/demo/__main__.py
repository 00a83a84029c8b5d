"""Play a scenario with a simulated fleet: by default, devices of a real city join in two waves and are served.

Planner, bridge and simulated aircraft run as separate ROS 2 processes on this machine. Ends by itself; exit status 0
means that everything came about that the scenario asks for.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import rclpy
from ament_index_python.packages import get_package_prefix, get_package_share_directory
from rclpy.signals import SignalHandlerOptions
from rich.console import Console
from rich.live import Live

from jpap_ros.demo.devices import SiteSource
from jpap_ros.demo.fleet_file import write_fleet
from jpap_ros.demo.own_graph import own_graph
from jpap_ros.demo.processes import ChildDied, Children
from jpap_ros.demo.run import Failure, Run
from jpap_ros.demo.scenario import Scenario, ScenarioError, load_scenario
from jpap_ros.fleet.availability import FleetPolicy
from jpap_ros.fleet.config import load_fleet
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.planning import SCHEMES

#: Flinders and Elizabeth Street, Melbourne; the ground there is about 20 m above mean sea level.
ORIGIN = (-37.8142, 144.9632, 20.0)


def main(arguments: list[str] | None = None) -> int:
    """Run the demo; see the module's text. Returns the exit status."""
    share = Path(get_package_share_directory("jpap_ros"))
    options = _parse(arguments, share)
    console = Console()
    try:
        scenario = _scenario(options, share)
    except ScenarioError as error:
        console.print(f"demo: {error}", style="red", highlight=False, soft_wrap=True)
        return 2
    signal.signal(signal.SIGTERM, _interrupt)
    out = Path(options.out).resolve()
    out.mkdir(parents=True, exist_ok=True)
    try:
        # Nothing here is meant for another machine.
        with own_graph(), tempfile.TemporaryDirectory(prefix="jpap_demo_") as work:
            return _play(scenario, Path(work), out, share, console, _watchers(options, out))
    except KeyboardInterrupt:
        console.print("stopped", highlight=False)
        return 130


def _play(
    scenario: Scenario, work: Path, out: Path, share: Path, console: Console, watchers: Mapping[str, Mapping[str, Any]]
) -> int:
    started = time.monotonic()
    fleet_file = work / "fleet.yaml"
    write_fleet(fleet_file, ORIGIN, scenario.uavs)
    fleet = load_fleet(fleet_file)
    source = SiteSource(share / "config/data/eua/users-melbcbd.csv", LocalFrame(fleet.origin), scenario.seed)
    console.print(f"{scenario.title}; ROS_DOMAIN_ID {os.environ['ROS_DOMAIN_ID']}", highlight=False, soft_wrap=True)
    with Children(work) as children:
        # Ctrl-C is Python's: it ends the scenario, not the graph under it.
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        try:
            _start_nodes(children, fleet_file, scenario, watchers)
            if "dashboard" in watchers:
                page = f"http://127.0.0.1:{watchers['dashboard']['port']}/"
                console.print(f"dashboard: {page}", highlight=False, soft_wrap=True)
            with Live(console=console, refresh_per_second=8, transient=not console.is_terminal) as live:
                run = Run(scenario, fleet, source, children, live)
                run.play()
            picture = out / "demo.png"
            run.draw(picture)
            took = f"{time.monotonic() - started:.0f} s in all; picture: {os.path.relpath(picture)}"
            console.print(f"{run.summary()}\n{took}", highlight=False, soft_wrap=True)
        except (Failure, ChildDied, ValueError) as error:
            for log in work.glob("*.log"):
                shutil.copy(log, out)
            failed = f"demo failed: {error}\nlogs of the nodes: {os.path.relpath(out)}"
            console.print(failed, style="red", highlight=False, soft_wrap=True)
            return 1
        finally:
            rclpy.try_shutdown()
            statuses = children.stop()
    if unclean := {name: status for name, status in statuses.items() if status != 0}:
        console.print(f"demo failed: nodes ended with status {unclean}", style="red", highlight=False)
        return 1
    if "recorder" in watchers:
        newest = max(Path(watchers["recorder"]["folder"]).glob("*.mcap"))
        console.print(f"recording: {os.path.relpath(newest)}", highlight=False, soft_wrap=True)
    return 0


def _watchers(options: argparse.Namespace, out: Path) -> dict[str, Mapping[str, Any]]:
    """Nodes that look on, with their parameters."""
    watchers: dict[str, Mapping[str, Any]] = {}
    if options.record:
        watchers["recorder"] = {"folder": str(out / "recordings")}
    if options.dashboard is not None:
        watchers["dashboard"] = {"port": options.dashboard, "exercise": True}
    return watchers


def _start_nodes(
    children: Children, fleet_file: Path, scenario: Scenario, watchers: Mapping[str, Mapping[str, Any]]
) -> None:
    programs = Path(get_package_prefix("jpap_ros")) / "lib" / "jpap_ros"
    settings: dict[str, Mapping[str, Any]] = {
        **watchers,
        "sim": {"speedup": scenario.speedup, **scenario.sim},
        "bridge": {"simulated_clock": True, **scenario.bridge},
        "planner": {**_hastened(scenario.speedup), **scenario.planner},
    }
    for name, parameters in settings.items():
        command = [str(programs / name), "--ros-args", "-p", f"fleet_file:={fleet_file}"]
        for key, value in parameters.items():
            command += ["-p", f"{key}:={json.dumps(value)}"]
        children.start(name, command)


def _hastened(speedup: float) -> dict[str, float]:
    """What the planner has to know of batteries and ways where simulated time runs faster than its clock."""
    life, speedup = FleetPolicy(), max(speedup, 0.1)
    return {
        "endurance_s": life.endurance_s / speedup,
        "cruise_m_s": life.cruise_m_s * speedup,
        "climb_m_s": life.climb_m_s * speedup,
        "relief_slack_s": life.relief_slack_s / speedup,
    }


def _scenario(options: argparse.Namespace, share: Path) -> Scenario:
    named = share / "config" / "scenarios" / f"{options.scenario}.yaml"
    scenario = load_scenario(named if named.is_file() else Path(options.scenario))
    if options.scheme:
        scenario = replace(scenario, planner={**scenario.planner, "scheme": options.scheme})
    if options.seed is not None:
        scenario = replace(scenario, seed=options.seed)
    if options.speedup is not None:
        scenario = replace(scenario, speedup=options.speedup)
    return scenario


def _parse(arguments: list[str] | None, share: Path) -> argparse.Namespace:
    shipped = ", ".join(sorted(path.stem for path in (share / "config" / "scenarios").glob("*.yaml")))
    parser = argparse.ArgumentParser(
        prog="scripts/demo",
        description=(__doc__ or "").split("\n\n")[0],
        epilog="example: scripts/demo --scenario convoy --scheme optimal",
    )
    parser.add_argument("--scenario", default="two_waves", help=f"a scenario file, or one of {shipped}")
    parser.add_argument("--scheme", choices=list(SCHEMES), help="plan with this scheme instead of the scenario's")
    parser.add_argument("--seed", type=int, help="draw other devices and demands than the scenario's")
    parser.add_argument("--speedup", type=float, help="simulated seconds a second, instead of the scenario's")
    parser.add_argument(
        "--dashboard",
        nargs="?",
        type=int,
        const=8080,
        metavar="PORT",
        help="show the fleet in a browser at this port of 127.0.0.1 (default: 8080)",
    )
    parser.add_argument("--record", action="store_true", help="record the flight under the folder of --out")
    parser.add_argument("--out", default="out", help="folder for the picture and, on failure, logs (default: out)")
    return parser.parse_args(arguments)


def _interrupt(*_: object) -> None:
    raise KeyboardInterrupt


if __name__ == "__main__":
    sys.exit(main())

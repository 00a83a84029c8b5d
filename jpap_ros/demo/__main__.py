"""The main job: devices of a real city join in two waves, and a simulated fleet flies out to serve them.

Planner, bridge and simulated aircraft run as separate ROS 2 processes on this machine. Ends by itself; exit status 0
means that every device is served and every aircraft reached its goal.
"""

from __future__ import annotations

import argparse
import itertools
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import rclpy
from ament_index_python.packages import get_package_prefix, get_package_share_directory
from rclpy.executors import SingleThreadedExecutor
from rich.console import Console
from rich.live import Live

from jpap_ros.demo import picture, table
from jpap_ros.demo.devices import GeoSite, sample_users
from jpap_ros.demo.fleet_file import write_fleet
from jpap_ros.demo.operator import Operator
from jpap_ros.demo.processes import ChildDied, Children
from jpap_ros.fleet.config import FleetConfig, load_fleet
from jpap_ros.mavlink.geodesy import LocalFrame

#: Flinders and Elizabeth Street, Melbourne; the ground there is about 20 m above mean sea level.
ORIGIN = (-37.8142, 144.9632, 20.0)
DEMAND = (12.0, 17.0)


class Failure(Exception):
    """The demo did not reach its end; the message says what was missing."""


class Demo:
    """One run: what is shown, what is waited for, and what is written."""

    def __init__(self, options: argparse.Namespace, fleet: FleetConfig, children: Children, live: Live) -> None:
        self.options = options
        self.fleet = fleet
        self.children = children
        self.live = live
        self.operator = Operator(fleet.names)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.operator)
        self.sites: list[GeoSite] = []
        self.launched: set[str] = set()
        self.phase = ""

    def fly(self, waves: list[list[GeoSite]]) -> None:
        """Report wave after wave; after each, wait until the fleet serves all devices from its goals."""
        self.phase = "Waiting for planner, bridge and aircraft"
        self.until(lambda: self.operator.ready, "planner and bridge to start", 30)
        for number, wave in enumerate(waves, 1):
            self.phase = f"Wave {number} of {len(waves)}: {len(wave)} devices join"
            self.sites += wave
            self.operator.report(wave)
            ids = {site.id for site in self.sites}
            self.until(lambda ids=ids: self.operator.serves(ids), "a plan that serves every device", 20, self.plan_text)
            self.launch()
            self.until(self.operator.all_reached, "every aircraft to reach its goal", 90, self.goals_text)

    def launch(self) -> None:
        """Ask for take-off of the aircraft that the plan needs and that are still on the ground."""
        assert self.operator.deployment is not None
        needed = {cell.uav for cell in self.operator.deployment.cells} - self.launched
        if not needed:
            return
        self.launched |= needed
        answer = self.operator.launch(needed)
        self.until(answer.done, "the bridge to answer bridge/launch", 60)
        refused = [f"{r.uav}: {r.message}" for r in answer.result().results if not r.success]
        if refused:
            raise Failure("launch refused: " + "; ".join(refused))

    def until(
        self, condition: Callable[[], bool], what: str, timeout_s: float, detail: Callable[[], str] = lambda: ""
    ) -> None:
        """Spin and redraw until a condition holds."""
        deadline = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > deadline:
                raise Failure(f"waited {timeout_s:.0f} s in vain for {what}{detail()}")
            self.children.check()
            self.executor.spin_once(timeout_sec=0.05)
            self.live.update(table.render(self.operator, self.fleet.names, len(self.sites), self.phase))

    def plan_text(self) -> str:
        """What the last plan lacks."""
        plan = self.operator.deployment
        if plan is None:
            return ": no deployment was published"
        return "".join(f"; {item.id}: {item.reason}" for item in plan.unserved)

    def goals_text(self) -> str:
        """Which aircraft are not at their goals."""
        assert self.operator.deployment is not None
        late = [cell.uav for cell in self.operator.deployment.cells if not self.operator.reached(cell.uav)]
        return ": " + ", ".join(f"{u} ({self.operator.states[u].goal_reason or 'on its way'})" for u in late)

    def draw(self, path: Path) -> None:
        """Write the picture of the fleet as it stands."""
        assert self.operator.deployment is not None
        frame = LocalFrame(self.fleet.origin)
        devices = {s.id: (*frame.to_map(s.latitude, s.longitude), s.rate_demand) for s in self.sites}
        picture.draw(path, self.operator.deployment, devices, self.operator.states, self.operator.tracks)

    def summary(self, started: float) -> str:
        """Figures of the run, in a few lines."""
        plan = self.operator.deployment
        assert plan is not None
        states = [self.operator.states[cell.uav] for cell in plan.cells]
        flown = sum(
            sum(((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2) ** 0.5 for a, b in itertools.pairwise(t))
            for t in self.operator.tracks.values()
        )
        demands = {site.id: site.rate_demand for site in self.sites}
        low, high = min(demands.values()), max(demands.values())
        margins = [
            rate - demands[device]
            for cell in plan.cells
            for device, rate in zip(cell.device_ids, cell.rate, strict=True)
        ]
        planning_s = plan.planning_time.sec + 1e-9 * plan.planning_time.nanosec
        return (
            f"{len(demands)} devices with demands of {low:.2f} to {high:.2f} bit/s/Hz"
            f" are served by {len(plan.cells)} UAVs; the tightest has {min(margins):+.3f} bit/s/Hz to spare\n"
            f"average UAV rate {plan.average_uav_rate:.2f} bit/s/Hz; last plan made in {1000 * planning_s:.1f} ms\n"
            f"worst distance to goal {max(s.goal_distance_m for s in states):.2f} m;"
            f" {flown / 1000:.1f} km flown; {time.monotonic() - started:.0f} s in all"
        )


def main(arguments: list[str] | None = None) -> int:
    """Run the demo; see the module's text. Returns the exit status."""
    options = _parse(arguments)
    signal.signal(signal.SIGTERM, _interrupt)
    # Nothing here is meant for another machine.
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    out = Path(options.out).resolve()
    out.mkdir(parents=True, exist_ok=True)
    console = Console()
    started = time.monotonic()
    share = Path(get_package_share_directory("jpap_ros"))
    sites = sample_users(share / "config/data/eua/users-melbcbd.csv", options.devices, DEMAND, seed=options.seed)
    first = (len(sites) * 3 + 4) // 5
    with tempfile.TemporaryDirectory(prefix="jpap_demo_") as work:
        fleet_file = Path(work) / "fleet.yaml"
        write_fleet(fleet_file, ORIGIN, options.uavs)
        with Children(Path(work)) as children:
            rclpy.init(args=[])
            try:
                _start_nodes(children, fleet_file, options.speedup)
                with Live(console=console, refresh_per_second=8, transient=not console.is_terminal) as live:
                    demo = Demo(options, load_fleet(fleet_file), children, live)
                    demo.fly([sites[:first], sites[first:]])
                picture_file = out / "demo.png"
                demo.draw(picture_file)
                console.print(demo.summary(started), highlight=False)
                console.print(f"picture: {_relative(picture_file)}", highlight=False)
            except (Failure, ChildDied) as error:
                for log in Path(work).glob("*.log"):
                    shutil.copy(log, out)
                console.print(f"demo failed: {error}\nlogs: {_relative(out)}", style="red", highlight=False)
                return 1
            except KeyboardInterrupt:
                console.print("stopped", highlight=False)
                return 130
            finally:
                rclpy.try_shutdown()
                statuses = children.stop()
            unclean = {name: status for name, status in statuses.items() if status != 0}
            if unclean:
                console.print(f"demo failed: not shut down cleanly: {unclean}", style="red")
                return 1
    return 0


def _start_nodes(children: Children, fleet_file: Path, speedup: float) -> None:
    programs = Path(get_package_prefix("jpap_ros")) / "lib" / "jpap_ros"
    fleet = ["--ros-args", "-p", f"fleet_file:={fleet_file}"]
    children.start("sim", [str(programs / "sim"), *fleet, "-p", f"speedup:={speedup}"])
    children.start("bridge", [str(programs / "bridge"), *fleet])
    children.start("planner", [str(programs / "planner"), *fleet])


def _parse(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="scripts/demo", description=__doc__.split("\n\n")[0])
    parser.add_argument("--devices", type=_whole(2, 816), default=40, help="how many devices (default: %(default)s)")
    parser.add_argument("--uavs", type=_whole(1, 200), default=15, help="size of the fleet (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="draws devices and demands (default: %(default)s)")
    parser.add_argument("--speedup", type=float, default=5.0, help="simulated seconds a second (default: %(default)s)")
    parser.add_argument(
        "--out", default="out", help="folder for the picture and, on failure, logs (default: %(default)s)"
    )
    return parser.parse_args(arguments)


def _whole(low: int, high: int) -> Callable[[str], int]:
    def parse(text: str) -> int:
        if not text.isdigit() or not low <= int(text) <= high:
            raise argparse.ArgumentTypeError(f"must be a whole number from {low} to {high}, got {text!r}")
        return int(text)

    return parse


def _relative(path: Path) -> str:
    return os.path.relpath(path)


def _interrupt(*_: object) -> None:
    raise KeyboardInterrupt


if __name__ == "__main__":
    sys.exit(main())

"""Play a scenario: report devices, strike faults, wait, and hold the fleet to what the file expects."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from rich.live import Live

from jpap_ros.demo import picture, table
from jpap_ros.demo.devices import Site, SiteSource
from jpap_ros.demo.operator import Operator
from jpap_ros.demo.processes import Children
from jpap_ros.demo.scenario import Scenario
from jpap_ros.fleet.config import FleetConfig
from jpap_ros.mavlink.geodesy import LocalFrame

START_PATIENCE_S = 30.0
LAUNCH_PATIENCE_S = 120.0
MOVE_PERIOD_S = 1.0


class Failure(Exception):
    """The scenario did not come to its end as it should; the message says what was missing."""


class Run:
    """One run of a scenario.

    Parameters
    ----------
    scenario : Scenario
    fleet : FleetConfig
    source : SiteSource
        Where devices that the scenario does not place come from.
    children : Children
        The nodes; the run fails when one of them dies.
    live : Live
        Where the table is drawn.
    """

    def __init__(
        self, scenario: Scenario, fleet: FleetConfig, source: SiteSource, children: Children, live: Live
    ) -> None:
        self.scenario = scenario
        self.fleet = fleet
        self.operator = Operator(fleet.names, LocalFrame(fleet.origin))
        self.sites: dict[str, Site] = {}
        self._source = source
        self._children = children
        self._live = live
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.operator)
        self._launched: set[str] = set()
        self._phase = ""
        self._plan_before = 0
        self._struck = ""

    def play(self) -> None:
        """Take every step in turn; Failure if one does not come about."""
        self._say("waiting for planner, bridge and aircraft")
        self._until(self.operator.ready, "planner, bridge and aircraft to start", START_PATIENCE_S)
        for step in self.scenario.steps:
            getattr(self, f"_{step.kind}")(**step.options)

    # Steps, named as in the file

    def _join(self, **options: Any) -> None:
        if "devices" in options:
            sites = [Site(d["id"], *d["at_m"], d["demand"], d["weight"]) for d in options["devices"]]
        else:
            sites = self._source.draw(options["count"], options["demand"])
        self._say("1 device joins" if len(sites) == 1 else f"{len(sites)} devices join")
        self._report(sites)

    def _leave(self, count: int = 0, ids: Iterable[str] = ()) -> None:
        gone = list(ids) or list(self.sites)[:count]
        self._say("1 device leaves" if len(gone) == 1 else f"{len(gone)} devices leave")
        for name in gone:
            if self.sites.pop(name, None) is None:
                raise Failure(f"device {name!r} cannot leave: it is not there")
        self.operator.report([], gone)

    def _move(self, ids: Iterable[str] | None, by_m: tuple[float, float], over_s: float) -> None:
        moving = [self._site(name) for name in (self.sites if ids is None else ids)]
        self._say(f"{len(moving)} devices move by {by_m[0]:g} m east and {by_m[1]:g} m north")
        legs = math.ceil(over_s / MOVE_PERIOD_S)
        for leg in range(1, legs + 1):
            share = leg / legs
            self._report(
                replace(site, east_m=site.east_m + share * by_m[0], north_m=site.north_m + share * by_m[1])
                for site in moving
            )
            self._spin(over_s / legs)

    def _demand(self, ids: Iterable[str], demand: float) -> None:
        changed = [replace(self._site(name), rate_demand=demand) for name in ids]
        self._say(f"{len(changed)} devices now demand {demand:g} bit/s/Hz")
        self._report(changed)

    def _fault(self, uav: str, fault: str, argument: str) -> None:
        if uav == "any":
            cells = self.operator.deployment.cells if self.operator.deployment else []
            uav = next((cell.uav for cell in cells if self.operator.flies(cell.uav)), "")
            if not uav:
                raise Failure("a fault was to strike any aircraft with a cell, but none flies")
        self._say(f"fault: {uav} {fault} {argument}".rstrip())
        self._plan_before = self.operator.plan_id()
        self._struck = uav
        self.operator.strike(uav, fault, argument)

    def _launch(self, uavs: str | Iterable[str]) -> None:
        if uavs == "needed":
            plan = self.operator.deployment
            if plan is None:
                raise Failure("a launch of the aircraft needed was asked for before there was a plan")
            names = {cell.uav for cell in plan.cells if cell.uav} - self._launched
        else:
            names = set(self.fleet.names) if uavs == "all" else set(uavs)
        if not names:
            return
        self._say(f"launch of {len(names)} aircraft")
        self._launched |= names
        answer = self.operator.launch(names)
        self._until(answer.done, "the bridge to answer bridge/launch", LAUNCH_PATIENCE_S)
        refused = [f"{r.uav}: {r.message}" for r in answer.result().results if not r.success]
        if refused:
            raise Failure("launch refused: " + "; ".join(refused))

    def _wait(self, timeout_s: float, **options: str) -> None:
        what = options["for"]
        conditions: dict[str, tuple[Callable[[], bool], str]] = {
            "planned": (lambda: self.operator.knows(set(self.sites)), "a plan that knows every device"),
            "replanned": (lambda: self.operator.plan_id() > self._plan_before, "a new plan after the fault"),
            "relieved": (lambda: not self.operator.has_cell(self._struck), f"a relief of {self._struck}"),
            "served": (lambda: self.operator.serves(set(self.sites)), "a plan that serves every device"),
            "reached": (self.operator.all_reached, "every aircraft to reach its goal"),
            "served_and_reached": (
                lambda: self.operator.serves(set(self.sites)) and self.operator.all_reached(),
                "every device to be served from a reached goal",
            ),
        }
        condition, words = conditions[what]
        self._until(condition, words, timeout_s)

    def _pause(self, seconds: float) -> None:
        self._spin(seconds)

    def _expect(self, **limits: Any) -> None:
        plan = self.operator.deployment
        if plan is None:
            raise Failure("there is no plan to hold to the scenario's expectations")
        served = sum(len(cell.device_ids) for cell in plan.cells)
        figures: dict[str, tuple[float, Callable[[float, float], bool], str]] = {
            "served_at_least": (served, float.__ge__, "devices served, at least {}"),
            "unserved_at_least": (len(plan.unserved), float.__ge__, "devices unserved, at least {}"),
            "uavs_at_most": (len(plan.cells), float.__le__, "UAVs in the plan, at most {}"),
            "separation_at_least_m": (
                self.operator.least_separation_m,
                float.__ge__,
                "m between aircraft, at least {}",
            ),
        }
        for name, (value, holds, words) in figures.items():
            if name in limits and not holds(float(value), limits[name]):
                raise Failure(f"expected {words.format(limits[name])}, but it is {value:g}")
        left_out = set(limits.get("served", ())) - self.operator.served()
        if left_out:
            raise Failure(f"expected to be served, but left out: {', '.join(sorted(left_out))}")

    # What is shown and written

    def draw(self, path: Path) -> None:
        """Write the picture of the fleet as it stands."""
        assert self.operator.deployment is not None
        devices = {s.id: (s.east_m, s.north_m, s.rate_demand) for s in self.sites.values()}
        picture.draw(path, self.operator.deployment, devices, self.operator.states, self.operator.tracks)

    def summary(self) -> str:
        """Figures of the run, in a few lines."""
        plan = self.operator.deployment
        assert plan is not None
        demands = {site.id: site.rate_demand for site in self.sites.values()}
        margins = [
            rate - demands[device]
            for cell in plan.cells
            for device, rate in zip(cell.device_ids, cell.rate, strict=True)
        ]
        distances = [self.operator.states[cell.uav].goal_distance_m for cell in plan.cells if cell.uav]
        flown = sum(math.dist(a, b) for track in self.operator.tracks.values() for a, b in itertools.pairwise(track))
        planning_s = plan.planning_time.sec + 1e-9 * plan.planning_time.nanosec
        return (
            f"{len(margins)} of {len(demands)} devices, with demands of {min(demands.values()):.2f} to"
            f" {max(demands.values()):.2f} bit/s/Hz, are served by {len(plan.cells)} UAVs;"
            f" least margin {round(min(margins, default=0.0), 6) + 0.0:.3f} bit/s/Hz\n"
            f"average UAV rate {plan.average_uav_rate:.2f} bit/s/Hz; last plan made in {1000 * planning_s:.1f} ms\n"
            f"worst distance to goal {max(distances, default=0.0):.2f} m; {flown / 1000:.1f} km flown;"
            f" aircraft never nearer than {self.operator.least_separation_m:.1f} m in the air"
        )

    # The rest

    def _site(self, name: str) -> Site:
        if name not in self.sites:
            raise Failure(f"there is no device {name!r}")
        return self.sites[name]

    def _report(self, sites: Iterable[Site]) -> None:
        sites = list(sites)
        self.sites.update((site.id, site) for site in sites)
        self.operator.report(sites)

    def _say(self, phase: str) -> None:
        self._phase = phase
        if not self._live.console.is_terminal:
            self._live.console.print(phase, highlight=False)

    def _spin(self, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self._turn()

    def _until(self, condition: Callable[[], bool], what: str, timeout_s: float) -> None:
        deadline = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > deadline:
                raise Failure(f"waited {timeout_s:.0f} s in vain for {what}{self.operator.troubles()}")
            self._turn()

    def _turn(self) -> None:
        self._children.check()
        self._executor.spin_once(timeout_sec=0.05)
        self._live.update(table.render(self.operator, self.fleet.names, len(self.sites), self._phase))

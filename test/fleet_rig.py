"""Simulated vehicles and a fleet controller that begin and end with a test, and what they did.

The vehicles' own record of where they are (`position`, which the bridge does not see) and of what reached them
(`received`) are the oracle of the tests that use this.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import ExitStack
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.fleet.config import FleetConfig, LinkUrl, MapOrigin, UavConfig
from jpap_ros.mavlink.aircraft_settings import AircraftSettings
from jpap_ros.mavlink.fleet_controller import ControllerSettings, FleetController, FleetOrder, OrderResult
from jpap_ros.mavlink.goals import Goal, GoalState
from jpap_ros.mavlink.snapshot import AircraftSnapshot
from jpap_ros.sim import SimFleet, SimVehicle

ORIGIN = MapOrigin(-37.8136, 144.9631, 20.0)
GROUND = (0.0, 0.0)
#: Far beyond what anything here takes on an idle machine.
PATIENCE_S = 60.0
SPEEDUP = 10.0
ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
TAKEOFF = mavlink.MAV_CMD_NAV_TAKEOFF


class Watch:
    """Keeps every snapshot and waits for conditions."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self.history: dict[str, list[AircraftSnapshot]] = {}

    def __call__(self, snapshot: AircraftSnapshot) -> None:
        with self._changed:
            self.history.setdefault(snapshot.name, []).append(snapshot)
            self._changed.notify_all()

    def now(self, name: str) -> AircraftSnapshot:
        with self._changed:
            return self.history[name][-1]

    def until(
        self, name: str, condition: Callable[[AircraftSnapshot], bool], patience_s: float = PATIENCE_S
    ) -> AircraftSnapshot:
        """Wait until an aircraft's newest snapshot satisfies a condition."""
        with self._changed:
            satisfied = self._changed.wait_for(
                lambda: bool(self.history.get(name)) and condition(self.history[name][-1]), patience_s
            )
            newest = self.history.get(name, [None])[-1]
            others = {n: (s[-1].mode, s[-1].goal_state.name, s[-1].goal_reason) for n, s in self.history.items()}
        assert satisfied, f"waited in vain; newest: {newest}; all: {others}"
        assert newest is not None
        return newest

    def until_goal(self, name: str, state: GoalState, plan_id: int | None = None) -> AircraftSnapshot:
        """Wait for a state of the goal, of a certain plan or of any."""
        return self.until(name, lambda s: s.goal_state is state and plan_id in (None, s.goal_plan_id))

    def goal_states(self, name: str) -> list[GoalState]:
        """Goal states in the order they were seen, repetitions left out."""
        with self._changed:
            states = [s.goal_state for s in self.history[name]]
        return [state for i, state in enumerate(states) if i == 0 or states[i - 1] is not state]


class Rig:
    """A controller and simulated vehicles that begin and end with the test."""

    def __init__(self, stack: ExitStack, free_ports: Callable[[int], list[int]]) -> None:
        self._stack = stack
        self._free_ports = free_ports
        self.watch = Watch()

    def ports(self, count: int) -> list[int]:
        return self._free_ports(count)

    def fleet(self, count: int = 1, kind: str = "udpin", autopilot: str = "ardupilot", **uav: Any) -> FleetConfig:
        ports = self._free_ports(count)
        return FleetConfig(
            ORIGIN,
            tuple(
                UavConfig(
                    f"uav{i}",
                    i,
                    (LinkUrl(kind, "127.0.0.1", port),),
                    autopilot,
                    **{"home_m": (20.0 * (i - 1), 0.0), **uav},
                )
                for i, port in enumerate(ports, 1)
            ),
        )

    def mixed(self, **uavs: dict[str, Any]) -> FleetConfig:
        """A fleet of aircraft by name, each with keys of the fleet file; 50 m apart unless said otherwise."""
        made = []
        for i, ((name, keys), port) in enumerate(zip(uavs.items(), self._free_ports(len(uavs)), strict=True)):
            defaults = {"urls": (LinkUrl("udpin", "127.0.0.1", port),), "home_m": (50.0 * i, 0.0)}
            made.append(UavConfig(name, i + 1, **{**defaults, **keys}))
        return FleetConfig(ORIGIN, tuple(made))

    def fly(self, fleet: FleetConfig, options: Any = None, speedup: float = SPEEDUP) -> SimFleet:
        return self._stack.enter_context(SimFleet(fleet, speedup=speedup, options=options))

    def control(
        self, fleet: FleetConfig, settings: ControllerSettings | None = None, **aircraft: Any
    ) -> FleetController:
        made = AircraftSettings(**{"simulated_clock": True, **aircraft})
        settings = settings or ControllerSettings(aircraft=made, launch_stagger_s=0.0)
        return self._stack.enter_context(FleetController(fleet, settings, self.watch))

    def launched(self, fleet: FleetConfig, options: Any = None, **aircraft: Any) -> tuple[SimFleet, FleetController]:
        sim = self.fly(fleet, options)
        controller = self.control(fleet, **aircraft)
        results = order(controller, FleetOrder.LAUNCH, fleet.names)
        assert all(result.success for result in results.values()), results
        return sim, controller


def order(controller: FleetController, what: FleetOrder, names: tuple[str, ...]) -> dict[str, OrderResult]:
    futures: dict[str, Future[OrderResult]] = controller.order(what, list(names))
    return {name: future.result(2 * PATIENCE_S) for name, future in futures.items()}


def commands(vehicle: SimVehicle, command: int | None = None) -> list[Any]:
    """Commands that reached a vehicle, requests for telemetry left out."""
    chatter = (mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_REQUEST_MESSAGE)
    with vehicle.lock:
        heard = [r.message for r in vehicle.received if r.kind in ("COMMAND_LONG", "COMMAND_INT")]
    return [m for m in heard if m.command not in chatter and command in (None, m.command)]


def distinct(vehicle: SimVehicle, command: int | None = None) -> list[Any]:
    """The same without repetitions: on a busy machine an answer may take longer than a command waits for it."""
    return [m for m in commands(vehicle, command) if getattr(m, "confirmation", 0) == 0]


def setpoints(vehicle: SimVehicle) -> list[Any]:
    with vehicle.lock:
        return [r.message for r in vehicle.received if r.kind == "SET_POSITION_TARGET_GLOBAL_INT"]


def distance(vehicle: SimVehicle, goal: Goal) -> float:
    with vehicle.lock:
        return math.dist(vehicle.position, (goal.east_m, goal.north_m, goal.up_m))


def velocity(vehicle: SimVehicle) -> tuple[float, float, float]:
    with vehicle.lock:
        return vehicle.body.vx, vehicle.body.vy, vehicle.body.vz


def until(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, f"waited in vain until {what}"
        time.sleep(0.05)

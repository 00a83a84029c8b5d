"""Four aircraft of both autopilots under traffic control, on links that lose three frames of ten each way.

Oracle: the simulated vehicles' own record of where they are and of every command that reached them, with the number of
the frame, its confirmation and its time. A frame that the link itself doubled has the same sequence number.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest
from fleet_rig import ARM, PATIENCE_S, TAKEOFF, Rig, commands, distance, order, until
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.fleet.transit_plan import TransitLimits
from jpap_ros.mavlink.aircraft_settings import AircraftSettings
from jpap_ros.mavlink.commands import ORDER_ATTEMPTS, PROMPT_S
from jpap_ros.mavlink.fleet_controller import ControllerSettings, FleetOrder
from jpap_ros.mavlink.goals import Goal, GoalState
from jpap_ros.mavlink.procedures import ARM_PROMPT_S
from jpap_ros.sim import LinkFaults, SimFleet, SimVehicle, VehicleOptions

FAULTS = LinkFaults(loss=0.3, duplicate=0.1, reorder=0.1, delay_s=0.2, jitter_s=0.05)
#: Of the slowest frame: delay, jitter and the hold of a reordered one, with room for a busy machine [s].
SLOWEST_FRAME_S = 1.5
SEPARATION_M = 8.0
GOALS = {
    "ap1": Goal(30.0, 15.0, 22.0),
    "px1": Goal(0.0, 15.0, 20.0),
    "ap2": Goal(20.0, -10.0, 24.0),
    "px2": Goal(5.0, 45.0, 22.0),
}


@pytest.fixture
def rig(free_ports: Callable[[int], list[int]]) -> Iterator[Rig]:
    with ExitStack() as stack:
        yield Rig(stack, free_ports)


class Flights:
    """Watches how often each vehicle is armed and leaves the ground."""

    def __init__(self, sim: SimFleet) -> None:
        self._sim = sim
        self._stop = threading.Event()
        self.times: dict[str, list[float]] = {name: [] for name in sim.vehicles}
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._was = dict.fromkeys(sim.vehicles, False)

    def __enter__(self) -> Flights:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._stop.wait(0.01):
            for name, vehicle in self._sim.vehicles.items():
                with vehicle.lock:
                    flies, now = not vehicle.on_ground, vehicle.now
                if flies and not self._was[name]:
                    self.times[name].append(now)
                self._was[name] = flies


def arrivals(vehicle: SimVehicle, command: int, param1: float | None = None) -> dict[int, tuple[float, int]]:
    """Time of the first arrival, and confirmation, of each frame with a command, by its sequence number."""
    found: dict[int, tuple[float, int]] = {}
    for entry in vehicle.received:
        message = entry.message
        if entry.kind == "COMMAND_LONG" and message.command == command and param1 in (None, message.param1):
            found.setdefault(message.get_seq(), (entry.time, message.confirmation))
    return found


# Every wait below is bounded; on a busy machine they add up.
@pytest.mark.timeout(480)
def test_all_reach_their_goals_after_one_launch_and_nothing_dangerous_comes_twice(rig: Rig) -> None:
    fleet = rig.mixed(
        ap1={"autopilot": "ardupilot", "home_m": (0.0, 0.0)},
        px1={"autopilot": "px4", "home_m": (30.0, 0.0)},
        ap2={"autopilot": "ardupilot", "home_m": (0.0, 30.0)},
        px2={"autopilot": "px4", "home_m": (30.0, 30.0)},
    )
    settings = ControllerSettings(
        # PX4's OFFBOARD ends after a second without a target: with three of ten lost, twenty in a row never are.
        aircraft=AircraftSettings(
            setpoint_rate_hz=20.0,
            link_timeout_s=8.0,
            arrival_radius_m=1.5,
            takeoff_height_m=12.0,
            simulated_clock=True,
        ),
        launch_stagger_s=0.0,
        traffic=TransitLimits(min_separation_m=SEPARATION_M, tracking_error_m=3.0, speed_m_s=2.0, min_altitude_m=15.0),
    )
    # Mostly climbs and descents, hastened; across, 8 m a second is what a position a quarter of a second old bears.
    sim = rig.fly(fleet, VehicleOptions(link_faults=FAULTS), speedup=4.0)
    controller = rig.control(fleet, settings)
    for name, goal in GOALS.items():
        controller.set_goal(name, goal)
    with Flights(sim) as flights:
        results = order(controller, FleetOrder.LAUNCH, fleet.names)
        assert all(result.success for result in results.values()), results
        for name, goal in GOALS.items():
            # Each in turn where their ways cross, and some seconds for what is lost on the way.
            rig.watch.until(name, lambda s: s.goal_state is GoalState.REACHED, 3 * PATIENCE_S)
            assert distance(sim[name], goal) < 3.0
        assert sim.least_separation_m > SEPARATION_M
        landing = sim["ap1"].now
        results = order(controller, FleetOrder.LAND, fleet.names)
        assert all(result.success for result in results.values()), results
        for name in fleet.names:
            rig.watch.until(name, lambda s: not s.armed)
        until(lambda: not any(vehicle.armed for vehicle in sim), "all are down")
        # What is still on its way must not wake them again.
        time.sleep(SLOWEST_FRAME_S)
        assert not any(vehicle.armed or not vehicle.on_ground for vehicle in sim)
    for name in fleet.names:
        vehicle = sim[name]
        (lifted,) = flights.times[name]
        arms, takeoffs = arrivals(vehicle, ARM, 1.0), arrivals(vehicle, TAKEOFF)
        assert arms and takeoffs
        for sent, prompt_s in ((arms, ARM_PROMPT_S), (takeoffs, PROMPT_S)):
            times, confirmations = zip(*sent.values(), strict=True)
            # Each is the next repetition of one and the same command, none is late, and none comes to one that flies.
            assert len(set(confirmations)) == len(confirmations)
            assert max(times) - min(times) < prompt_s + SLOWEST_FRAME_S
            assert max(times) < min(lifted + SLOWEST_FRAME_S, landing)
        assert commands(vehicle, ARM) and {m.param1 for m in commands(vehicle, ARM)} == {1.0}
        for harmless in (mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_CMD_NAV_LAND):
            assert {c for _, c in arrivals(vehicle, harmless).values()} <= set(range(ORDER_ATTEMPTS))

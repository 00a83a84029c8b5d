"""Take-offs from pads close together, one after the other.

Oracle: the simulator's own record of how near vehicles came in the air (`SimFleet.least_separation_m`), which the
bridge does not see; heights by hand from the planned separation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace

import pytest
from fleet_rig import Rig, order

from jpap_ros.fleet.config import FleetConfig
from jpap_ros.fleet.transit_plan import TransitLimits
from jpap_ros.mavlink.aircraft import AircraftSettings
from jpap_ros.mavlink.fleet_controller import ControllerSettings, FleetController, FleetOrder
from jpap_ros.sim import SimFleet, VehicleOptions

LIMITS = TransitLimits(min_separation_m=10.0, tracking_error_m=2.0)


@pytest.fixture
def rig(free_ports: Callable[[int], list[int]]) -> Iterator[Rig]:
    with ExitStack() as stack:
        yield Rig(stack, free_ports)


def close_pads(rig: Rig, count: int) -> FleetConfig:
    fleet = rig.fleet(count)
    return replace(fleet, uavs=tuple(replace(uav, home_m=(5.0 * i, 0.0)) for i, uav in enumerate(fleet.uavs)))


def ready(rig: Rig, fleet: FleetConfig, **options: VehicleOptions) -> tuple[SimFleet, FleetController]:
    """Simulated vehicles on their pads, heard by a bridge with traffic control."""
    sim = rig.fly(fleet, options)
    settings = ControllerSettings(aircraft=AircraftSettings(), launch_stagger_s=0.0, traffic=LIMITS)
    controller = rig.control(fleet, settings)
    for name in fleet.names:
        rig.watch.until(name, lambda s: s.enu_m is not None and s.landed_state == 1)
    return sim, controller


def test_neighbours_climb_one_after_the_other_the_first_one_highest(rig: Rig) -> None:
    fleet = close_pads(rig, 3)
    sim, controller = ready(rig, fleet)
    results = order(controller, FleetOrder.LAUNCH, fleet.names)
    assert all(result.success for result in results.values()), results
    # 10 m, and 10 + 2 * 2 m more for each that is below.
    assert [result.message.split(";")[0] for result in results.values()] == [
        "in the air at 38 m",
        "in the air at 24 m",
        "in the air at 10 m",
    ]
    assert sim.least_separation_m >= LIMITS.min_separation_m


def test_one_that_cannot_take_off_lets_the_next_one_go(rig: Rig) -> None:
    fleet = close_pads(rig, 2)
    sim, controller = ready(rig, fleet, uav1=VehicleOptions(refuse_arming=True))
    results = order(controller, FleetOrder.LAUNCH, fleet.names)
    assert [result.success for result in results.values()] == [False, True], results
    assert sim["uav2"].position[2] > 5.0

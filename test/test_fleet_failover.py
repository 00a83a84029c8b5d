"""One aircraft, two links: one dies, everything goes on over the other; it comes back and is used again.

Oracle: plain sockets between vehicle and bridge, which count what passes and can be cut; and the simulated vehicle's
own record of its mode and place.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace

import pytest
from fleet_rig import ARM, TAKEOFF, Rig, distance, distinct, order, until
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from udp_wire import UdpWire

from jpap_ros.fleet.config import LinkUrl
from jpap_ros.mavlink.fleet_controller import FleetOrder
from jpap_ros.mavlink.goals import Goal, GoalState
from jpap_ros.mavlink.vehicle import LinkState
from jpap_ros.sim import SimFleet

TARGET = mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT
NAMES = ("ardupilot", "px4")


class Cable(UdpWire):
    """Two UDP sockets that pass on what comes, until cut.

    Attributes
    ----------
    to_vehicle : Counter of int
        Frames passed on to the vehicle, by message id.
    """

    def __init__(self, vehicle_sends_to: int, bridge_listens_on: int) -> None:
        super().__init__(vehicle_sends_to, bridge_listens_on)
        self.cut = False
        self.to_vehicle: Counter[int] = Counter()

    def from_vehicle(self, data: bytes) -> bool:
        return not self.cut

    def from_bridge(self, data: bytes, heard: bool) -> bool:
        if self.cut or not heard:
            return False
        self.to_vehicle[int.from_bytes(data[7:10], "little")] += 1
        return True


class Alone:
    """Whether one cable carries eight targets while the other carries none."""

    def __init__(self, used: Cable, rests: Cable) -> None:
        self._used, self._rests = used, rests
        self._began = self._counts()

    def _counts(self) -> tuple[int, int]:
        return self._used.to_vehicle[TARGET], self._rests.to_vehicle[TARGET]

    def for_a_while(self) -> bool:
        used, rests = self._counts()
        if rests != self._began[1]:
            self._began = used, rests
        return used - self._began[0] >= 8


@pytest.fixture
def rig(free_ports: Callable[[int], list[int]]) -> Iterator[Rig]:
    with ExitStack() as stack:
        yield Rig(stack, free_ports)


def test_everything_goes_on_over_the_other_link(rig: Rig) -> None:
    with ExitStack() as stack:
        fleet = rig.mixed(**{name: {"autopilot": name} for name in NAMES})
        ports = iter(rig.ports(8))
        bridge_side, vehicle_side, cables = [], [], {}
        for uav in fleet.uavs:
            bridge, vehicle = [[next(ports), next(ports)] for _ in range(2)]
            cables[uav.name] = [stack.enter_context(Cable(*ends)) for ends in zip(vehicle, bridge, strict=True)]
            bridge_side.append(replace(uav, urls=tuple(LinkUrl("udpin", "127.0.0.1", port) for port in bridge)))
            vehicle_side.append(replace(uav, urls=tuple(LinkUrl("udpin", "127.0.0.1", port) for port in vehicle)))
        # Slow enough for the change of links to happen on the way.
        sim = stack.enter_context(SimFleet(replace(fleet, uavs=tuple(vehicle_side)), speedup=4.0))
        controller = rig.control(replace(fleet, uavs=tuple(bridge_side)), link_timeout_s=3.0, setpoint_rate_hz=5.0)
        results = order(controller, FleetOrder.LAUNCH, NAMES)
        assert all(result.success for result in results.values()), results
        goals = {name: Goal(250.0, 30.0 * i, 30.0, plan_id=1) for i, name in enumerate(NAMES)}
        for name, goal in goals.items():
            controller.set_goal(name, goal)
            rig.watch.until_goal(name, GoalState.EN_ROUTE)
        assert all(cable.to_vehicle[TARGET] == 0 for _, cable in cables.values()), "one link is in use"

        for first, _ in cables.values():
            first.cut = True
        seen = {name: len(rig.watch.history[name]) for name in NAMES}
        for name, goal in goals.items():
            rig.watch.until_goal(name, GoalState.REACHED, plan_id=1)
            assert distance(sim[name], goal) < 1.5
            assert cables[name][1].to_vehicle[TARGET] > 0
        assert sim["px4"].mode == "OFFBOARD", "no gap of a second, or its failsafe would have it"
        # A command too, once the first link counts as lost; and telemetry all the while.
        for name in NAMES:
            until(lambda cable=cables[name][1]: cable.to_vehicle[TARGET] > 25, "the second link is in use for good")
        assert all(result.success for result in order(controller, FleetOrder.HOLD, NAMES).values())
        assert all(result.success for result in order(controller, FleetOrder.LAUNCH, NAMES).values())
        for name in NAMES:
            since = rig.watch.history[name][seen[name] :]
            assert {snapshot.link for snapshot in since} == {LinkState.CONNECTED}
            assert GoalState.YIELDED not in {snapshot.goal_state for snapshot in since}
            assert all(snapshot.position is not None for snapshot in since)

        for first, _ in cables.values():
            first.cut = False
        for name in NAMES:
            first, second = cables[name]
            before = first.to_vehicle[TARGET]
            until(
                lambda cable=first, count=before: cable.to_vehicle[TARGET] > count + 5, "the first link is used again"
            )
            controller.set_goal(name, Goal(280.0, 10.0, 30.0, plan_id=2))
            rig.watch.until_goal(name, GoalState.REACHED, plan_id=2)
            # A busy machine can make the first link look doubtful for a moment, but not for long.
            alone = Alone(first, second)
            until(alone.for_a_while, "the second one rests")
            assert len(distinct(sim[name], ARM)) == len(distinct(sim[name], TAKEOFF)) == 1

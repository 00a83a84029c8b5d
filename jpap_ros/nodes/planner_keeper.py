"""The fleet's life in the planner: who crews which cell, and the orders to the bridge that follow."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from typing import Any

from jpap_msgs.msg import VehicleState
from jpap_msgs.srv import FleetCommand
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node
from rclpy.task import Future

from jpap_ros.fleet.availability import (
    Action,
    Charge,
    FleetLife,
    FleetPolicy,
    Link,
    Order,
    Roster,
    Station,
    Vehicle,
)
from jpap_ros.fleet.cells import FleetPlan
from jpap_ros.fleet.config import FleetConfig
from jpap_ros.nodes.parameters import StartError
from jpap_ros.nodes.planner_conversions import is_in_air
from jpap_ros.planning.devices import Device

#: How often the bridge is asked how far it keeps aircraft apart [s]; another one may have been started.
_ASK_EVERY_S = 10.0

_SERVICES = {Order.LAUNCH: "bridge/launch", Order.RETURN: "bridge/return_home"}

_CHARGE_LOW, _CHARGE_CRITICAL = 2, 3
_BUSY = (VehicleState.LANDED_TAKEOFF, VehicleState.LANDED_LANDING)


class FleetKeeper:
    """Steps `FleetLife` with what the bridge reports, and passes its orders on to the bridge.

    Parameters
    ----------
    node : Node
    uavs : iterable of str
        Names in the fleet file.
    policy : FleetPolicy
    crew : mapping of int to str
        Who flies for which cell already, after a restart.
    sent_home : iterable of str
        Whom the planner before this one has sent home.
    """

    def __init__(
        self,
        node: Node,
        uavs: Iterable[str],
        policy: FleetPolicy,
        crew: Mapping[int, str],
        sent_home: Iterable[str] = (),
    ) -> None:
        self._node = node
        self._uavs = tuple(uavs)
        self._policy = policy
        self._life = FleetLife(policy, crew)
        self._clients = {order: node.create_client(FleetCommand, name) for order, name in _SERVICES.items()}
        self._separation = node.create_client(GetParameters, "bridge/get_parameters")
        self._asked_s = -math.inf
        #: What stands in the way of every hand-over, and what to do about it; empty where nothing does.
        self.problem = ""
        #: Whom this planner sent home, and whether the bridge has said so since.
        self._sent_home: dict[str, bool] = dict.fromkeys(sent_home, True)

    @property
    def sent_home(self) -> frozenset[str]:
        """Aircraft that the planner, and nobody else, has sent home since they were launched."""
        return frozenset(self._sent_home)

    def step(
        self,
        now_s: float,
        states: Mapping[str, VehicleState],
        plan: FleetPlan | None,
        devices: Iterable[Device],
        altitude_m: float,
    ) -> Roster:
        """Decide, and order what follows."""
        self._note_launches(states)
        self._ask_separation(now_s)
        weight = {device.id: device.weight for device in devices}
        stations = {}
        if plan is not None:
            holding = plan.holding
            for cell in plan.cells:
                value = sum(weight.get(name, 0.0) for name in cell.device_ids)
                stations[cell.id] = Station((*cell.position, altitude_m), value, holding.get(cell.id, ""))
        vehicles = [vehicle_of(name, states.get(name), name in self._sent_home) for name in self._uavs]
        roster = self._life.step(now_s, vehicles, stations)
        for action in roster.actions:
            self._order(action)
        return roster

    def forget_crew(self) -> None:
        """Find out anew who flies for which cell."""
        self._life = FleetLife(self._policy, {})

    def assign_by(self, objective: str) -> None:
        """Choose aircraft by another objective of `assign` from now on."""
        self._life.policy = replace(self._life.policy, objective=objective)

    def close(self) -> None:
        """Leave the bridge's services alone from now on."""
        for client in (*self._clients.values(), self._separation):
            self._node.destroy_client(client)

    def _ask_separation(self, now_s: float) -> None:
        """Find out whether the bridge would let a relief come as near as it is to wait."""
        if now_s - self._asked_s < _ASK_EVERY_S or not self._separation.service_is_ready():
            return
        self._asked_s = now_s

        def answered(future: Future) -> None:
            # Nothing where the node of that name is no bridge.
            found = future.result().values
            wanted_m, above_m = found[0].double_value if found else 0.0, self._policy.station_above_m
            problem = ""
            if above_m < wanted_m:
                problem = (
                    f"reliefs cannot wait {above_m:g} m above their cells, since the bridge's min_separation_m is "
                    f"{wanted_m:g} m: start the planner with station_above_m {wanted_m:g} or more"
                )
            if problem and not self.problem:
                self._node.get_logger().warning(problem)
            self.problem = problem

        request = GetParameters.Request(names=["min_separation_m"])
        self._separation.call_async(request).add_done_callback(answered)

    def _note_launches(self, states: Mapping[str, VehicleState]) -> None:
        """Forget whom somebody else has launched again: if he gives it away now, a pilot has it."""
        for name, told in list(self._sent_home.items()):
            state = states.get(name)
            if state is None or state.link != VehicleState.LINK_CONNECTED:
                continue
            if state.goal_state == VehicleState.GOAL_YIELDED:
                self._sent_home[name] = True
            elif told:
                del self._sent_home[name]

    def _order(self, action: Action) -> None:
        client, logger = self._clients[action.order], self._node.get_logger()
        what = f"{action.order.value} {action.uav}"
        if not client.service_is_ready():
            logger.warning(f"{what}: {client.srv_name} is not there", throttle_duration_sec=10.0)
            return
        logger.info(f"{what}: {action.reason}")
        if action.order is Order.RETURN:
            self._sent_home[action.uav] = False
        else:
            self._sent_home.pop(action.uav, None)

        def answered(future: Future) -> None:
            if not future.result().success:
                logger.warning(f"{what}: {future.result().message}")

        client.call_async(FleetCommand.Request(uavs=[action.uav])).add_done_callback(answered)


def vehicle_of(name: str, state: VehicleState | None, sent_home: bool) -> Vehicle:
    """Return an aircraft as the fleet's life sees it.

    The bridge reports one that it sent home as given away until it is launched again. Where this planner wanted that,
    it is on its way until it has landed, and a reserve from then on; where somebody else did, it stays theirs.
    """
    if state is None:
        return Vehicle(name)
    in_air = is_in_air(state)
    yielded = state.goal_state == VehicleState.GOAL_YIELDED
    position = state.position
    return Vehicle(
        name,
        link=Link(state.link),
        in_air=in_air,
        position=(position.x, position.y, position.z) if state.position_valid else None,
        battery=state.battery_remaining,
        charge=_charge(state.battery_charge_state),
        yielded=yielded and not sent_home,
        busy=state.landed_state in _BUSY or (sent_home and (in_air or state.armed)),
    )


def fleet_policy(values: Mapping[str, Any]) -> FleetPolicy:
    """Fleet policy of parameter values by name; StartError if they contradict each other."""
    names = {item.name for item in fields(FleetPolicy)} & values.keys()
    try:
        return FleetPolicy(objective=values["assignment"], **{name: values[name] for name in names})
    except ValueError as error:
        raise StartError(f"parameters of the fleet's life: {error}") from None


def relief_problem(values: Mapping[str, Any], fleet: FleetConfig) -> str | None:
    """Why reliefs could not wait above their cells, by parameter values; None if they can."""
    top_m = values["altitude_m"] + values["station_above_m"]
    if fleet.fence is None or top_m <= fleet.fence.max_height_m:
        return None
    return (
        f"altitude_m + station_above_m must not exceed the fence's max_height_m ({fleet.fence.max_height_m:g} m), got "
        f"{top_m:g} m: no relief could wait above its cell"
    )


def _charge(state: int) -> Charge:
    if state >= _CHARGE_CRITICAL:
        return Charge.CRITICAL
    return Charge.LOW if state == _CHARGE_LOW else Charge.OK if state else Charge.UNKNOWN

"""The fleet's life in the planner: who crews which cell, and the orders to the bridge that follow."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from typing import Any

from jpap_msgs.msg import VehicleState
from jpap_msgs.srv import FleetCommand
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
from jpap_ros.nodes.parameters import StartError
from jpap_ros.nodes.planner_conversions import is_in_air
from jpap_ros.planning.devices import Device

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
    """

    def __init__(self, node: Node, uavs: Iterable[str], policy: FleetPolicy, crew: Mapping[int, str]) -> None:
        self._node = node
        self._uavs = tuple(uavs)
        self._policy = policy
        self._life = FleetLife(policy, crew)
        self._clients = {order: node.create_client(FleetCommand, name) for order, name in _SERVICES.items()}
        self._sent_home: set[str] = set()

    def step(
        self,
        states: Mapping[str, VehicleState],
        plan: FleetPlan | None,
        devices: Iterable[Device],
        altitude_m: float,
    ) -> Roster:
        """Decide, and order what follows."""
        weight = {device.id: device.weight for device in devices}
        stations = {
            cell.id: Station((*cell.position, altitude_m), sum(weight.get(name, 0.0) for name in cell.device_ids))
            for cell in (plan.cells if plan is not None else ())
        }
        vehicles = [vehicle_of(name, states.get(name), name in self._sent_home) for name in self._uavs]
        roster = self._life.step(time.monotonic(), vehicles, stations)
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
        for client in self._clients.values():
            self._node.destroy_client(client)

    def _order(self, action: Action) -> None:
        client, logger = self._clients[action.order], self._node.get_logger()
        what = f"{action.order.value} {action.uav}"
        if not client.service_is_ready():
            logger.warning(f"{what}: {client.srv_name} is not there", throttle_duration_sec=10.0)
            return
        logger.info(f"{what}: {action.reason}")
        if action.order is Order.RETURN:
            self._sent_home.add(action.uav)
        else:
            self._sent_home.discard(action.uav)

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


def _charge(state: int) -> Charge:
    if state >= _CHARGE_CRITICAL:
        return Charge.CRITICAL
    return Charge.LOW if state == _CHARGE_LOW else Charge.OK if state else Charge.UNKNOWN

"""The demo's operator: reports devices, launches aircraft, and keeps what planner and bridge say."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from jpap_msgs.msg import Deployment, GeoDevice, GeoDeviceUpdate, VehicleState
from jpap_msgs.srv import FleetCommand
from rclpy.node import Node
from rclpy.task import Future

from jpap_ros.demo.devices import GeoSite
from jpap_ros.nodes.qos import DEVICES, LATCHED


class Operator(Node):
    """A person with a ground station, in code.

    Parameters
    ----------
    uavs : iterable of str
        Names in the fleet file.
    """

    def __init__(self, uavs: Iterable[str]) -> None:
        super().__init__("operator")
        self.deployment: Deployment | None = None
        self.states: dict[str, VehicleState] = {}
        self.tracks: dict[str, list[tuple[float, float]]] = {}
        self._devices = self.create_publisher(GeoDeviceUpdate, "geo_devices", DEVICES)
        self.create_subscription(Deployment, "deployment", self._on_deployment, LATCHED)
        for name in uavs:
            self.create_subscription(VehicleState, f"{name}/state", self._on_state, LATCHED)
        self._launch = self.create_client(FleetCommand, "bridge/launch")

    def report(self, sites: Iterable[GeoSite]) -> None:
        """Report that devices have joined."""
        update = GeoDeviceUpdate()
        update.header.stamp = self.get_clock().now().to_msg()
        update.devices = [
            GeoDevice(
                id=site.id, latitude=site.latitude, longitude=site.longitude, rate_demand=site.rate_demand, weight=1.0
            )
            for site in sites
        ]
        self._devices.publish(update)

    def launch(self, uavs: Iterable[str]) -> Future:
        """Ask the bridge to arm and take off."""
        return self._launch.call_async(FleetCommand.Request(uavs=sorted(uavs)))

    @property
    def ready(self) -> bool:
        """Whether the planner listens and the bridge serves."""
        return self._devices.get_subscription_count() > 0 and self._launch.service_is_ready()

    def serves(self, device_ids: set[str]) -> bool:
        """Whether the present deployment knows exactly these devices and serves every one."""
        return self.deployment is not None and device_ids == {
            device for cell in self.deployment.cells for device in cell.device_ids
        }

    def all_reached(self) -> bool:
        """Whether every cell's aircraft hovers at its goal of the present deployment."""
        assert self.deployment is not None
        return all(self.reached(cell.uav) for cell in self.deployment.cells)

    def reached(self, uav: str) -> bool:
        """Whether an aircraft hovers at its goal of the present deployment."""
        state = self.states.get(uav)
        return (
            state is not None
            and self.deployment is not None
            and state.goal_state == VehicleState.GOAL_REACHED
            and state.goal_plan_id == self.deployment.plan_id
        )

    def _on_deployment(self, message: Deployment) -> None:
        self.deployment = message

    def _on_state(self, message: VehicleState) -> None:
        self.states[message.uav] = message
        if message.position_valid:
            track = self.tracks.setdefault(message.uav, [])
            here = (message.position.x, message.position.y)
            if not track or np.hypot(here[0] - track[-1][0], here[1] - track[-1][1]) > 1.0:
                track.append(here)

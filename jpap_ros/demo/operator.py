"""The demo's operator: reports devices, launches aircraft, and keeps what planner and bridge say."""

from __future__ import annotations

import math
from collections.abc import Iterable

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from jpap_msgs.msg import Deployment, GeoDevice, GeoDeviceUpdate, VehicleState
from jpap_msgs.srv import FleetCommand
from rclpy.node import Node
from rclpy.task import Future
from std_msgs.msg import String

from jpap_ros.demo.devices import Site
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.nodes.qos import DEVICES, LATCHED, SENSOR_DATA

#: Below this height an aircraft is on or near its pad, where it stands beside others.
FLYING_ABOVE_M = 2.0
_TRACK_STEP_M = 1.0


class Operator(Node):
    """A person with a ground station, in code.

    Parameters
    ----------
    uavs : iterable of str
        Names in the fleet file.
    frame : LocalFrame
        Where the map lies; devices are reported in latitude and longitude.
    """

    def __init__(self, uavs: Iterable[str], frame: LocalFrame) -> None:
        super().__init__("operator")
        self.deployment: Deployment | None = None
        self.states: dict[str, VehicleState] = {}
        self.tracks: dict[str, list[tuple[float, float]]] = {}
        self.least_separation_m = math.inf
        self._frame = frame
        self._flying: set[str] = set()
        self._devices = self.create_publisher(GeoDeviceUpdate, "geo_devices", DEVICES)
        self._faults = self.create_publisher(String, "sim/fault", 10)
        self.create_subscription(Deployment, "deployment", self._on_deployment, LATCHED)
        self._uavs = tuple(uavs)
        for name in self._uavs:
            self.create_subscription(VehicleState, f"{name}/state", self._on_state, LATCHED)
            self.create_subscription(
                PoseStamped, f"{name}/pose", lambda message, name=name: self._on_pose(name, message), SENSOR_DATA
            )
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self._launch = self.create_client(FleetCommand, "bridge/launch")

    def report(self, sites: Iterable[Site], departed: Iterable[str] = ()) -> None:
        """Report devices that joined or changed, and ids that left."""
        update = GeoDeviceUpdate(departed=list(departed))
        update.header.stamp = self.get_clock().now().to_msg()
        for site in sites:
            latitude, longitude = self._frame.to_geodetic(site.east_m, site.north_m)
            update.devices.append(
                GeoDevice(
                    id=site.id,
                    latitude=latitude,
                    longitude=longitude,
                    rate_demand=site.rate_demand,
                    weight=site.weight,
                )
            )
        self._devices.publish(update)

    def launch(self, uavs: Iterable[str]) -> Future:
        """Ask the bridge to arm and take off."""
        return self._launch.call_async(FleetCommand.Request(uavs=sorted(uavs)))

    def strike(self, uav: str, fault: str, argument: str) -> None:
        """Let a fault strike a simulated vehicle."""
        self._faults.publish(String(data=f"{uav} {fault} {argument}".rstrip()))

    def ready(self) -> bool:
        """Whether the planner listens, the bridge serves and every aircraft has been seen."""
        return (
            # By name: a recorder listens to devices, too.
            any(info.node_name == "planner" for info in self.get_subscriptions_info_by_topic(self._devices.topic_name))
            and self._faults.get_subscription_count() > 0
            and self._launch.service_is_ready()
            and all(
                name in self.states and self.states[name].link == VehicleState.LINK_CONNECTED for name in self._uavs
            )
        )

    def knows(self, device_ids: set[str]) -> bool:
        """Whether the present deployment speaks of exactly these devices, served or not."""
        plan = self.deployment
        if plan is None:
            return False
        return device_ids == self.served() | {item.id for item in plan.unserved}

    def plan_id(self) -> int:
        """Number of the present deployment; 0 before the first."""
        return 0 if self.deployment is None else self.deployment.plan_id

    def serves(self, device_ids: set[str]) -> bool:
        """Whether the present deployment serves exactly these devices and leaves none out."""
        return self.deployment is not None and not self.deployment.unserved and device_ids == self.served()

    def all_reached(self) -> bool:
        """Whether there are cells, and the aircraft of each hovers at its goal of the present deployment."""
        cells = [] if self.deployment is None else self.deployment.cells
        return bool(cells) and all(self.reached(cell.uav) for cell in cells)

    def reached(self, uav: str) -> bool:
        """Whether an aircraft hovers at its goal of the present deployment."""
        state = self.states.get(uav)
        return (
            state is not None
            and self.deployment is not None
            and state.goal_state == VehicleState.GOAL_REACHED
            and state.goal_plan_id == self.deployment.plan_id
        )

    def has_cell(self, uav: str) -> bool:
        """Whether the present deployment has a cell for an aircraft."""
        return self.deployment is not None and any(cell.uav == uav for cell in self.deployment.cells)

    def flies(self, uav: str) -> bool:
        """Whether an aircraft is in the air."""
        return uav in self._flying

    def troubles(self) -> str:
        """Say what stands in the way: devices left out, aircraft that are not at their goals."""
        plan = self.deployment
        if plan is None:
            return ": no deployment was published"
        left_out = [f"{item.id}: {item.reason}" for item in plan.unserved]
        late = [
            f"{cell.uav}: {self.states[cell.uav].goal_reason or 'on its way'}"
            for cell in plan.cells
            if cell.uav in self.states and not self.reached(cell.uav)
        ]
        return "".join(f"; {trouble}" for trouble in left_out + late)

    def served(self) -> set[str]:
        """Ids of the devices that the present deployment serves."""
        return {device for cell in self.deployment.cells for device in cell.device_ids} if self.deployment else set()

    def _on_deployment(self, message: Deployment) -> None:
        self.deployment = message

    def _on_state(self, message: VehicleState) -> None:
        self.states[message.uav] = message

    def _on_pose(self, name: str, message: PoseStamped) -> None:
        point = message.pose.position
        here = (point.x, point.y)
        track = self.tracks.setdefault(name, [])
        if not track or math.dist(here, track[-1]) > _TRACK_STEP_M:
            track.append(here)
        if point.z < FLYING_ABOVE_M:
            self._flying.discard(name)
            return
        self._flying.add(name)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        # The simulator's own word: positions by telemetry are of different moments.
        for status in message.status:
            if status.name == "/sim: fleet":
                self.least_separation_m = float(status.values[0].value)

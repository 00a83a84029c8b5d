"""The markers node: the deployment and the fleet as standard markers and GeoJSON, for RViz, Foxglove and others."""

from __future__ import annotations

import sys
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from jpap_msgs.msg import Deployment, DeviceUpdate, GeoDeviceUpdate, VehicleState
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from std_msgs.msg import Header, String
from visualization_msgs.msg import Marker, MarkerArray

from jpap_ros.fleet.config import load_fleet
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.nodes.diagnostics import hardware_of, status_name
from jpap_ros.nodes.markers_conversions import MarkerBook, Scene, draw_fleet, draw_plan
from jpap_ros.nodes.markers_geojson import deployment_geojson
from jpap_ros.nodes.parameters import Param, declare, fleet_file, values
from jpap_ros.nodes.planner_intake import DeviceIntake
from jpap_ros.nodes.process import run
from jpap_ros.nodes.qos import DEVICES, LATCHED, SENSOR_DATA


def markers_parameters() -> tuple[Param, ...]:
    """Return every parameter of the node."""
    return (
        fleet_file(),
        Param("map_frame", "map", "Frame of positions: ENU, origin as in the fleet file", fixed=True),
        Param("rate_hz", 2.0, "Most messages a second; none where nothing changes [Hz]", 0.1, 30.0, fixed=True),
        Param("size_m", 20.0, "Diameter of a UAV's marker; the others follow from it [m]", 0.1, 1000.0, fixed=True),
    )


class MarkersNode(Node):
    """Keeps what it hears, and publishes the picture of it when something has changed, not too often.

    Every message holds the whole picture, so that a viewer that comes late gets all of it from the latched topic.
    """

    def __init__(self) -> None:
        super().__init__("markers")
        params = markers_parameters()
        declare(self, params)
        settings = values(self, params)
        self._fleet_file: str = settings["fleet_file"]
        fleet = load_fleet(self._fleet_file)
        self._frame: str = settings["map_frame"]
        self._local = LocalFrame(fleet.origin)
        # What is wrong in a report the planner tells; once is enough.
        self._intake = DeviceIntake(self._frame, self._local, self.get_logger().debug)
        self._scene = Scene(fleet.names, fleet.fence, settings["size_m"])
        self._book = MarkerBook()
        self._scene_changed = self._plan_changed = True
        self._plan_markers: list[Marker] = []
        self._drawn = 0
        self._problem = ""

        self._markers_out = self.create_publisher(MarkerArray, "markers", LATCHED)
        self._geojson_out = self.create_publisher(String, "deployment_geojson", LATCHED)
        self._diagnostics_out = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_subscription(DeviceUpdate, "devices", self._on_devices, DEVICES)
        self.create_subscription(GeoDeviceUpdate, "geo_devices", self._on_geo_devices, DEVICES)
        self.create_subscription(Deployment, "deployment", self._on_deployment, LATCHED)
        scene = self._scene
        for name in fleet.names:
            keep = partial(self._keep, name)
            self.create_subscription(VehicleState, f"{name}/state", partial(keep, scene.states), LATCHED)
            self.create_subscription(PoseStamped, f"{name}/pose", partial(keep, scene.poses), SENSOR_DATA)
            self.create_subscription(PoseStamped, f"{name}/goal_pose", partial(keep, scene.goals), LATCHED)
        # Steady time: the picture goes on while a simulated clock stands still.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0 / settings["rate_hz"], self._on_turn, clock=steady)
        self.create_timer(1.0, self._on_second, clock=steady)
        self.get_logger().info(
            f"drawing on {self.resolve_topic_name('markers')} and {self.resolve_topic_name('deployment_geojson')}; "
            f"{len(fleet.names)} UAVs of {settings['fleet_file']}"
        )

    # In

    def _on_devices(self, message: DeviceUpdate) -> None:
        self._devices_changed(bool(self._intake.take(message)))

    def _on_geo_devices(self, message: GeoDeviceUpdate) -> None:
        self._devices_changed(bool(self._intake.take_geo(message)))

    def _devices_changed(self, changed: bool) -> None:
        if changed:
            self._scene.devices = self._intake.devices
            self._scene_changed = self._plan_changed = True

    def _on_deployment(self, message: Deployment) -> None:
        self._scene.plan = message
        self._scene_changed = self._plan_changed = True

    def _keep(self, name: str, where: dict[str, Any], message: VehicleState | PoseStamped) -> None:
        # A position in another frame is at another place.
        if isinstance(message, PoseStamped) and message.header.frame_id != self._frame:
            return
        where[name] = message
        self._scene_changed = True

    # Out

    def _on_turn(self) -> None:
        if self._plan_changed:
            self._plan_changed = False
            self._plan_markers = draw_plan(self._scene)
            self._publish_geojson()
        if self._scene_changed or self._book.unfinished:
            self._scene_changed = False
            self._publish_markers()

    def _publish_markers(self) -> None:
        header = self._header()
        markers = self._book.with_deletions([*self._plan_markers, *draw_fleet(self._scene)])
        for marker in markers:
            marker.header = header
        self._drawn = len(markers)
        self._markers_out.publish(MarkerArray(markers=markers))

    def _publish_geojson(self) -> None:
        try:
            self._geojson_out.publish(String(data=deployment_geojson(self._scene, self._local)))
            self._problem = ""
        except ValueError as error:
            self._problem = f"no GeoJSON of this deployment: {error}; give markers and planner the same fleet file"
            self.get_logger().warning(self._problem)

    def _on_second(self) -> None:
        figures = {
            "markers in the last message": self._drawn,
            "viewers of markers": self._markers_out.get_subscription_count(),
            "viewers of GeoJSON": self._geojson_out.get_subscription_count(),
            "devices": len(self._scene.devices),
            "UAVs with a position": len(self._scene.poses),
        }
        status = DiagnosticStatus(
            level=DiagnosticStatus.WARN if self._problem else DiagnosticStatus.OK,
            name=status_name(self.get_fully_qualified_name(), "picture"),
            hardware_id=hardware_of(self._fleet_file),
            message=self._problem or f"{self._drawn} markers",
            values=[KeyValue(key=key, value=str(value)) for key, value in figures.items()],
        )
        self._diagnostics_out.publish(DiagnosticArray(header=self._header(), status=[status]))

    def _header(self) -> Header:
        return Header(stamp=self.get_clock().now().to_msg(), frame_id=self._frame)


def main() -> None:
    """Draw, as a process."""
    sys.exit(run(MarkersNode))

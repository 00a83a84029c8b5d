"""The dashboard node: what the graph says to a page in the browser, and the operator's orders back."""

from __future__ import annotations

import asyncio
import contextlib
import sys
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from jpap_msgs.msg import Deployment, DeviceUpdate, GeoDeviceUpdate, VehicleState
from jpap_msgs.srv import FleetCommand
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.task import Future
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from jpap_ros.dashboard.access import Access, AccessError, load_token
from jpap_ros.dashboard.event_log import WARNING, EventLog
from jpap_ros.dashboard.fleet_view import FleetView
from jpap_ros.dashboard.inbox import Inbox
from jpap_ros.dashboard.requests import ORDERS
from jpap_ros.dashboard.server import DashboardServer, Outcome, ServerSettings
from jpap_ros.dashboard.server_thread import ServerThread
from jpap_ros.fleet.config import FleetConfig, load_fleet
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.nodes.dashboard_conversions import (
    device_update,
    outcome_of,
    plan_of,
    point_of,
    pose_of,
    status_of,
    vehicle_of,
)
from jpap_ros.nodes.dashboard_parameters import dashboard_parameters
from jpap_ros.nodes.diagnostics import hardware_of, status_name
from jpap_ros.nodes.parameters import StartError, declare, values
from jpap_ros.nodes.planner_intake import DeviceIntake
from jpap_ros.nodes.process import run
from jpap_ros.nodes.qos import DEVICES, LATCHED, SENSOR_DATA
from jpap_ros.planning.devices import Device

#: An order to many aircraft ends within this; the bridge bounds each by itself [s].
_ORDER_PATIENCE_S = 300.0
#: A plan from the planner's own time limit and a bit [s].
_REPLAN_PATIENCE_S = 60.0


class DashboardNode(Node):
    """Hands messages to the web server's thread, and its orders to the bridge and the planner."""

    def __init__(self) -> None:
        # First, because rclpy destroys a node whose making was refused.
        self._thread: ServerThread | None = None
        super().__init__("dashboard")
        params = dashboard_parameters()
        declare(self, params)
        settings = values(self, params)
        self._fleet_file: str = settings["fleet_file"]
        fleet = load_fleet(self._fleet_file)
        self._map_frame: str = settings["map_frame"]
        self._inbox = Inbox()
        self._log = EventLog()
        self._view = FleetView(fleet.names, self._log)
        self._intake = DeviceIntake(self._map_frame, LocalFrame(fleet.origin), self._warn)
        self._bridge = {name: self.create_client(FleetCommand, f"bridge/{name}") for name in set(ORDERS.values())}
        self._replan = self.create_client(Trigger, "planner/replan")
        self._devices_out = self.create_publisher(DeviceUpdate, "devices", DEVICES) if settings["exercise"] else None
        self._serve(settings, fleet)
        self._listen(fleet)

    def _serve(self, settings: dict[str, Any], fleet: FleetConfig) -> None:
        try:
            token = load_token(Path(settings["token_file"]).expanduser()) if settings["token_file"] else None
            access = Access(settings["host"], token)
        except AccessError as error:
            raise StartError(f"parameter {error}") from None
        server_settings = ServerSettings(
            host=settings["host"],
            port=settings["port"],
            update_rate_hz=settings["update_rate_hz"],
            max_clients=settings["max_clients"],
            exercise=settings["exercise"],
            tile_url=settings["tile_url"],
            page=_page(fleet, settings),
        )
        self._server = server = DashboardServer(server_settings, access, self._view, self._inbox, self)
        self._max_clients: int = settings["max_clients"]
        self._failed = self.create_guard_condition(self._on_failure)
        self._thread = ServerThread(server, self._failed.trigger)
        try:
            self._thread.start()
        except OSError as error:
            raise StartError(f"cannot listen on {settings['host']} port {settings['port']}: {error.strerror}") from None
        self.get_logger().info(f"open http://{_url_host(settings['host'])}:{server.port}/ in a browser")

    def _listen(self, fleet: FleetConfig) -> None:
        self.create_subscription(DeviceUpdate, "devices", self._on_devices, DEVICES)
        self.create_subscription(GeoDeviceUpdate, "geo_devices", self._on_devices, DEVICES)
        self.create_subscription(Deployment, "deployment", self._on_deployment, LATCHED)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        # Each subscription's event handlers are waited for as well: with those of 300 topics, waiting costs twice.
        quiet = SubscriptionEventCallbacks(use_default_callbacks=False)
        for name in fleet.names:
            for kind, topic, callback, qos in (
                (VehicleState, "state", self._on_state, LATCHED),
                (PoseStamped, "pose", self._on_pose, SENSOR_DATA),
                (PoseStamped, "goal_pose", self._on_goal, LATCHED),
            ):
                self.create_subscription(kind, f"{name}/{topic}", partial(callback, name), qos, event_callbacks=quiet)
        self._diagnostics_out = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._states_topic = self.resolve_topic_name(f"{fleet.names[0]}/state")
        self.create_timer(1.0, self._look_round, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def destroy_node(self) -> None:
        """Close the pages and leave the graph."""
        if self._thread is not None:
            self._thread.stop()
        super().destroy_node()

    # From the graph to the pages

    def _on_devices(self, message: DeviceUpdate | GeoDeviceUpdate) -> None:
        geo = isinstance(message, GeoDeviceUpdate)
        changes = self._intake.take_geo(message) if geo else self._intake.take(message)
        if changes:
            self._inbox.put(partial(self._view.set_devices, self._intake.devices, changes))

    def _on_deployment(self, message: Deployment) -> None:
        self._inbox.put(partial(self._view.set_plan, plan_of(message)))

    def _on_state(self, name: str, message: VehicleState) -> None:
        self._inbox.put(partial(self._view.set_vehicle, name, vehicle_of(message)))

    def _on_pose(self, name: str, message: PoseStamped) -> None:
        self._inbox.put_newest(name, partial(self._view.set_pose, name, pose_of(message)))

    def _on_goal(self, name: str, message: PoseStamped) -> None:
        self._inbox.put(partial(self._view.set_goal, name, point_of(message.pose.position)))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        # /diagnostics is shared by all fleets of the graph.
        ours = self.get_namespace().rstrip("/") + "/"
        statuses = [status_of(status) for status in message.status]
        statuses = [status for status in statuses if status.node.rpartition("/")[0] + "/" == ours]
        if statuses:
            self._inbox.put(partial(self._view.set_statuses, statuses))

    def _look_round(self) -> None:
        """Find out who plans and who flies, whatever these nodes are called."""

        def publishers(topic: str) -> list[str]:
            infos = self.get_publishers_info_by_topic(topic)
            return [f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in infos]

        planners = publishers(self.resolve_topic_name("deployment"))
        self._inbox.put(partial(self._view.set_roles, planners, publishers(self._states_topic)))
        self._diagnostics_out.publish(self._diagnostics())

    def _diagnostics(self) -> DiagnosticArray:
        pages, most = self._server.open_pages, self._max_clients
        full = pages >= most
        status = DiagnosticStatus(
            level=DiagnosticStatus.WARN if full else DiagnosticStatus.OK,
            name=status_name(self.get_fully_qualified_name(), "page"),
            hardware_id=hardware_of(self._fleet_file),
            message="no more pages are let in: close some, or raise max_clients" if full else f"{pages} pages open",
            values=[KeyValue(key="pages open", value=str(pages)), KeyValue(key="pages at most", value=str(most))],
        )
        header = Header(stamp=self.get_clock().now().to_msg(), frame_id=self._map_frame)
        return DiagnosticArray(header=header, status=[status])

    def _warn(self, text: str) -> None:
        self.get_logger().warning(text)
        self._inbox.put(partial(self._log.add, WARNING, "devices", text))

    def _on_failure(self) -> None:
        assert self._thread is not None
        if self._thread.failure is not None:
            raise self._thread.failure

    # From the pages to the graph, on the server's thread

    async def order(self, service: str, uavs: tuple[str, ...]) -> Outcome:
        """Call a service of the bridge."""
        answer = await self._call(self._bridge[service], FleetCommand.Request(uavs=list(uavs)), _ORDER_PATIENCE_S)
        return answer if isinstance(answer, Outcome) else outcome_of(answer)

    async def replan(self) -> Outcome:
        """Call the planner."""
        answer = await self._call(self._replan, Trigger.Request(), _REPLAN_PATIENCE_S)
        return answer if isinstance(answer, Outcome) else Outcome(answer.success, answer.message)

    async def report(self, device: Device | None, departed: str | None) -> Outcome:
        """Report a device by hand; it comes back by the topic, as everybody's reports do."""
        assert self._devices_out is not None
        header = Header(stamp=self.get_clock().now().to_msg(), frame_id=self._map_frame)
        self._devices_out.publish(device_update(device, departed, header))
        return Outcome(True, "reported to the planner")

    async def _call(self, client: Any, request: Any, patience_s: float) -> Any:
        """Call a service; return its response, or an Outcome that says why there is none."""
        name = self.resolve_service_name(client.srv_name)
        if not client.service_is_ready():
            return Outcome(False, f"{name} is not there: is its node running?")
        loop = asyncio.get_running_loop()
        answer: asyncio.Future[Any] = loop.create_future()

        def keep(done: Future[Any]) -> None:
            if answer.done():
                return
            if done.cancelled():
                answer.set_result(Outcome(False, f"{name} did not answer: the dashboard stops"))
            elif error := done.exception():
                answer.set_result(Outcome(False, f"{name} failed: {error}"))
            else:
                answer.set_result(done.result())

        def tell(done: Future[Any]) -> None:
            # On the executor's thread, which may complete the call when the server's loop has already ended.
            with contextlib.suppress(RuntimeError):
                loop.call_soon_threadsafe(keep, done)

        pending = client.call_async(request)
        pending.add_done_callback(tell)
        try:
            return await asyncio.wait_for(answer, patience_s)
        except asyncio.TimeoutError:
            client.remove_pending_request(pending)
            return Outcome(False, f"no answer from {name} within {patience_s:g} s")


def _page(fleet: FleetConfig, settings: dict[str, Any]) -> dict[str, Any]:
    """What the page knows from the start."""
    fence = fleet.fence
    return {
        "origin": [fleet.origin.latitude, fleet.origin.longitude],
        "circle": [*fence.center_m, fence.radius_m] if fence is not None and fence.center_m is not None else None,
        "polygon": [list(corner) for corner in fence.polygon_m] if fence is not None else [],
        "tile_attribution": settings["tile_attribution"],
        "update_s": 1.0 / settings["update_rate_hz"],
    }


def _url_host(host: str) -> str:
    return f"[{host}]" if ":" in host else host


def main() -> None:
    """Run the dashboard as a process."""
    sys.exit(run(DashboardNode))

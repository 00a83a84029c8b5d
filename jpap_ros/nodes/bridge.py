"""The bridge node: goals of the planner to MAVLink aircraft, and what they do back to ROS."""

from __future__ import annotations

import sys
import time
from concurrent.futures import Future as Outcome
from functools import partial
from pathlib import Path

from builtin_interfaces.msg import Time as Stamp
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from jpap_msgs.msg import Deployment, FleetCommandResult, VehicleState
from jpap_msgs.srv import FleetCommand
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.task import Future
from rclpy.time import Time
from sensor_msgs.msg import NavSatFix
from std_msgs.msg import Header

from jpap_ros.fleet.config import load_fleet
from jpap_ros.mavlink.fleet_controller import FleetController, FleetOrder, OrderResult
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.mavlink.plan_files import PlanPicture
from jpap_ros.mavlink.plan_folder import write_plan
from jpap_ros.mavlink.snapshot import AircraftSnapshot
from jpap_ros.mavlink.tlog import TlogFolder
from jpap_ros.nodes.bridge_conversions import fix_of, goal_marks, goal_of, pose_of, state_message
from jpap_ros.nodes.bridge_diagnostics import aircraft_status, link_status, tlog_status
from jpap_ros.nodes.bridge_parameters import bridge_parameters, controller_settings
from jpap_ros.nodes.bridge_succession import Succession
from jpap_ros.nodes.goal_book import GoalBook
from jpap_ros.nodes.parameters import StartError, declare, values
from jpap_ros.nodes.process import run
from jpap_ros.nodes.qos import LATCHED, SENSOR_DATA

#: Outcomes by UAV that one service call waits for.
_Outcomes = dict[str, "Outcome[OrderResult]"]


#: Longest time that telling what aircraft do waits for new targets to be on their way [s].
_DIRECTED_PATIENCE_S = 0.05


class BridgeNode(Node):
    """Hands goals and orders down to the fleet controller's thread, and its snapshots up to topics.

    The controller calls back on its own thread; what it says is kept by aircraft, newest only, and published by the
    executor when a guard condition wakes it.
    """

    def __init__(self) -> None:
        # First, because rclpy destroys a node whose making was refused.
        self._controller: FleetController | None = None
        self._tlog: TlogFolder | None = None
        self._succession: Succession | None = None
        super().__init__("bridge")
        params = bridge_parameters()
        declare(self, params)
        settings = values(self, params)
        fleet = load_fleet(settings["fleet_file"])
        self._map_frame: str = settings["map_frame"]
        self._use_yaw: bool = settings["use_goal_yaw"]
        self._announce_plans: bool = settings["announce_plans"]
        self._plan_dir = Path(settings["plan_dir"]).expanduser() if settings["plan_dir"] else None
        self._plan_dir_problem = ""
        self._fleet = fleet
        self._plan_id: int | None = None
        self._plan_timeout = Duration(seconds=settings["plan_timeout_s"])
        self._names = fleet.names
        self._book = GoalBook()
        self._fresh: dict[str, AircraftSnapshot] = {}
        self._snapshots: dict[str, AircraftSnapshot] = {}
        self._calls: list[tuple[_Outcomes, Future]] = []

        self._states_out = {n: self.create_publisher(VehicleState, f"{n}/state", LATCHED) for n in self._names}
        self._poses_out = {n: self.create_publisher(PoseStamped, f"{n}/pose", SENSOR_DATA) for n in self._names}
        self._fixes_out = {n: self.create_publisher(NavSatFix, f"{n}/fix", SENSOR_DATA) for n in self._names}
        self._diagnostics_out = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._wake = self.create_guard_condition(self._on_wake)
        try:
            if settings["tlog_dir"]:
                self._tlog = TlogFolder(Path(settings["tlog_dir"]).expanduser(), self.get_logger().warning)
            self._controller = FleetController(
                fleet,
                controller_settings(settings, fleet),
                self._on_snapshot,
                self._wake.trigger,
                None if self._tlog is None else self._tlog.keep,
            )
        except (ValueError, OSError) as error:
            raise StartError(str(error)) from None
        self._controller.start()
        self._succession = Succession(settings["state_file"], self.get_logger())
        self._succession.take_over(self._controller)

        self._goals_in = {
            name: self.create_subscription(PoseStamped, f"{name}/goal_pose", partial(self._on_goal, name), LATCHED)
            for name in self._names
        }
        self.create_subscription(Deployment, "deployment", self._on_deployment, LATCHED)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        # An answer waits for aircraft: in a group of its own it holds up nothing else, not even the next order.
        group = ReentrantCallbackGroup()
        for order in FleetOrder:
            name = f"bridge/{order.value}"
            self.create_service(FleetCommand, name, partial(self._on_order, order), callback_group=group)
        self.create_timer(1.0, self._on_second, clock=Clock(clock_type=ClockType.STEADY_TIME))
        goals = self.resolve_topic_name("<uav>/goal_pose".replace("<uav>", self._names[0]))
        self.get_logger().info(
            f"listening to {goals} and so on, {self.resolve_topic_name('deployment')}, and MAVLink on "
            f"{', '.join(dict.fromkeys(str(url) for uav in fleet.uavs for url in uav.urls))}; "
            f"{len(self._names)} UAVs of {settings['fleet_file']}; takes off only on bridge/launch"
        )

    def destroy_node(self) -> None:
        """Part from the aircraft as their autopilots need it, and leave the graph."""
        if self._controller is not None:
            self._controller.close()
        if self._succession is not None:
            self._succession.end()
        if self._tlog is not None:
            self._tlog.close()
        super().destroy_node()

    # From the planner

    def _on_goal(self, name: str, message: PoseStamped) -> None:
        assert self._controller is not None
        frame = message.header.frame_id
        if frame != self._map_frame:
            why = f"goal_pose header.frame_id must be {self._map_frame!r}, got {frame!r}"
            self.get_logger().warning(f"{name}: {why}; it holds")
            self._book.drop_goal(name)
            self._controller.clear_goal(name, why, refused=True)
            return
        stamp = message.header.stamp
        if stamp.sec == 0 and stamp.nanosec == 0:
            # Unset, as from a hand-written message: now.
            stamp = self.get_clock().now().to_msg()
        self._look_for_planner(stamp)
        self._book.put_goal(name, (stamp.sec, stamp.nanosec), goal_of(message, self._use_yaw))
        self._follow_book(name)

    def _on_deployment(self, message: Deployment) -> None:
        assert self._controller is not None
        stamp = message.header.stamp
        self._look_for_planner(stamp)
        self._book.put_plan((stamp.sec, stamp.nanosec), message.plan_id, [cell.uav for cell in message.cells])
        for name in self._names:
            self._follow_book(name)
        self._take_goals()
        new, self._plan_id = message.plan_id != self._plan_id, message.plan_id
        if new and self._announce_plans:
            for cell in message.cells:
                if cell.uav in self._names:
                    goal = cell.goal_pose.position
                    where = f"{goal.x:.0f} E {goal.y:.0f} N {goal.z:.0f} m up"
                    devices = len(cell.device_ids)
                    self._controller.announce(cell.uav, f"Plan {message.plan_id}: {devices} devices, {where}")
        if self._plan_dir is not None:
            self._write_plan(self._plan_dir, message)

    def _take_goals(self) -> None:
        """Take the goals that came right behind a deployment: the executor's next round begins milliseconds later."""
        for name, subscription in self._goals_in.items():
            with subscription.handle:
                while (taken := subscription.handle.take_message(subscription.msg_type, subscription.raw)) is not None:
                    self._on_goal(name, taken[0])

    def _look_for_planner(self, stamp: Stamp) -> None:
        """What was said just now shows that the planner lives; a latched message may be of one that hangs."""
        assert self._controller is not None
        if self.get_clock().now() - Time.from_msg(stamp) <= self._plan_timeout:
            self._controller.planner_alive()

    def _write_plan(self, folder: Path, message: Deployment) -> None:
        """Show the plan in files; the same trouble is told once, and flying goes on."""
        picture = PlanPicture(LocalFrame(self._fleet.origin), goal_marks(message, self._names), (), self._fleet.fence)
        autopilot = "px4" if all(uav.autopilot == "px4" for uav in self._fleet.uavs) else "ardupilot"
        try:
            write_plan(folder, picture, autopilot)
            problem = ""
        except (OSError, ValueError) as error:
            problem = f"plan_dir: plan {message.plan_id} cannot be written: {error}"
        kind = problem.partition(" cannot")[2]
        if kind and kind != self._plan_dir_problem:
            self.get_logger().warning(problem)
        self._plan_dir_problem = kind

    def _follow_book(self, name: str) -> None:
        assert self._controller is not None
        entry = self._book.entry(name)
        if entry is None:
            return
        if entry.goal is None:
            self._controller.clear_goal(name, entry.reason)
        else:
            self._controller.set_goal(name, entry.goal)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        """Whoever publishes the deployment and says how it is, lives."""
        assert self._controller is not None
        planners = [
            f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            for info in self.get_publishers_info_by_topic(self.resolve_topic_name("deployment"))
        ]
        if any(status.name.partition(":")[0] in planners for status in message.status):
            self._controller.planner_alive()

    # From an operator

    async def _on_order(
        self, order: FleetOrder, request: FleetCommand.Request, response: FleetCommand.Response
    ) -> FleetCommand.Response:
        assert self._controller is not None
        names = list(dict.fromkeys(request.uavs)) or list(self._names)
        self.get_logger().info(f"{order.value}: {', '.join(names)}")
        outcomes = self._controller.order(order, names)
        answer: Future = Future()
        self._calls.append((outcomes, answer))
        for outcome in outcomes.values():
            outcome.add_done_callback(lambda _: self._wake.trigger())
        self._wake.trigger()
        await answer
        for name, outcome in outcomes.items():
            result = outcome.result()
            response.results.append(FleetCommandResult(uav=name, success=result.success, message=result.message))
            if not result.success:
                self.get_logger().warning(f"{order.value}: {name}: {result.message}")
        failed = [f"{r.uav}: {r.message}" for r in response.results if not r.success]
        response.success = not failed
        done = len(response.results) - len(failed)
        response.message = f"{done} of {len(response.results)} UAVs" + (f"; {'; '.join(failed)}" if failed else "")
        return response

    # From the aircraft

    def _on_snapshot(self, snapshot: AircraftSnapshot) -> None:
        """On the controller's thread."""
        self._fresh[snapshot.name] = snapshot
        # Where others wait, the executor has been woken and takes this one with them.
        if len(self._fresh) == 1:
            self._wake.trigger()

    def _on_wake(self) -> None:
        if self._controller is not None:
            if self._controller.failure is not None:
                raise self._controller.failure
            # Telling can wait for the aircraft's targets, with which it would share the interpreter.
            self._controller.directed.wait(_DIRECTED_PATIENCE_S)
        while self._fresh:
            name, snapshot = self._fresh.popitem()
            before = self._snapshots.get(name)
            self._snapshots[name] = snapshot
            if snapshot.position is not None and (before is None or before.position is not snapshot.position):
                self._publish_pose(snapshot)
            if before is None or before.condition != snapshot.condition:
                self._publish_state(snapshot)
                self._log_change(before, snapshot)
        if self._succession is not None:
            # Before an order is answered: what an operator was told must survive a kill.
            self._succession.keep(self._names, self._snapshots)
        finished = [call for call in self._calls if all(outcome.done() for outcome in call[0].values())]
        for call in finished:
            self._calls.remove(call)
            call[1].set_result(None)

    def _publish_pose(self, snapshot: AircraftSnapshot) -> None:
        assert snapshot.position is not None
        age = Duration(seconds=max(0.0, time.monotonic() - snapshot.position.received_at))
        header = Header(stamp=(self.get_clock().now() - age).to_msg(), frame_id=self._map_frame)
        if pose := pose_of(snapshot, header):
            self._poses_out[snapshot.name].publish(pose)
        if fix := fix_of(snapshot, header.stamp):
            self._fixes_out[snapshot.name].publish(fix)

    def _publish_state(self, snapshot: AircraftSnapshot) -> None:
        self._states_out[snapshot.name].publish(state_message(snapshot, self._header()))

    def _log_change(self, before: AircraftSnapshot | None, snapshot: AircraftSnapshot) -> None:
        if before is not None and before.link is not snapshot.link:
            self.get_logger().info(f"{snapshot.name}: link {snapshot.link.name.lower().replace('_', ' ')}")
        for problem in snapshot.problems:
            if before is None or problem not in before.problems:
                self.get_logger().error(f"{snapshot.name}: {problem}")
        told = None if before is None else (before.goal_state, before.goal_reason)
        if told is not None and told != (snapshot.goal_state, snapshot.goal_reason):
            reason = f": {snapshot.goal_reason}" if snapshot.goal_reason else ""
            self.get_logger().info(
                f"{snapshot.name}: goal {snapshot.goal_state.name.lower().replace('_', ' ')}{reason}"
            )

    def _on_second(self) -> None:
        for snapshot in self._snapshots.values():
            self._publish_state(snapshot)
        node = self.get_fully_qualified_name()
        reports, now = self._controller.link_reports, time.monotonic()
        heard = [self._snapshots[name] for name in self._names if name in self._snapshots]
        status = [aircraft_status(node, snapshot, reports, now) for snapshot in heard]
        status += [link_status(node, report) for report in reports]
        if self._tlog is not None:
            status.append(tlog_status(node, self._tlog))
        self._diagnostics_out.publish(DiagnosticArray(header=self._header(), status=status))

    def _header(self) -> Header:
        return Header(stamp=self.get_clock().now().to_msg(), frame_id=self._map_frame)


def main() -> None:
    """Run the bridge as a process."""
    # The thread that sends targets waits for the interpreter this long, not the usual 5 ms, while messages are handled.
    sys.setswitchinterval(5e-4)
    sys.exit(run(BridgeNode))

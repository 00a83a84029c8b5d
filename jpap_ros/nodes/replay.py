"""The replay node: what a recorded planner was told, told to a planner again, and whether it plans the same."""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from jpap_msgs.msg import Deployment, DeviceUpdate, GeoDeviceUpdate, VehicleState
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from std_msgs.msg import Header

from jpap_ros.nodes.diagnostics import hardware_of, status_name
from jpap_ros.nodes.parameters import Param, StartError, declare, values
from jpap_ros.nodes.process import run
from jpap_ros.nodes.qos import DEVICES, LATCHED
from jpap_ros.nodes.replay_debounce import LongDebounce
from jpap_ros.nodes.replay_steps import Step, differences, is_planners, namespace_of, state_rounds, steps_of
from jpap_ros.report.flight_reader import DEVICES as DEVICES_TYPE
from jpap_ros.report.flight_reader import GEO_DEVICES, STATE
from jpap_ros.report.recording import RecordingError, Told, read_recording

_KINDS = {
    DEVICES_TYPE: (DeviceUpdate, DEVICES),
    GEO_DEVICES: (GeoDeviceUpdate, DEVICES),
    STATE: (VehicleState, LATCHED),
}
#: Every plan, also those that come while this node is busy.
_DEPLOYMENTS = QoSProfile(depth=1000, reliability=LATCHED.reliability, durability=LATCHED.durability)
_START_PATIENCE_S = 60.0
_ACK_PATIENCE_S = 10.0
_POLL_S = 0.02
#: Of an aircraft's states a planner keeps the newest until it gets round to it: time for that [s].
_ROUND_S = 0.05

#: Exit status when a plan was not the same.
DIFFERENT = 3


def replay_parameters() -> tuple[Param, ...]:
    """Return every parameter of the node."""
    return (
        Param("recording", [""], "Files of the recording (.mcap), in any order", fixed=True),
        Param(
            "rate",
            0.0,
            "Recorded seconds a second, at most; 0: as fast as the planner answers",
            0.0,
            1000.0,
            fixed=True,
        ),
        Param("states", True, "Tell the planner where aircraft were and which could fly, too", fixed=True),
        Param("patience_s", 10.0, "How long to wait for a plan that is the recorded one [s]", 0.1, 3600.0, fixed=True),
    )


class ReplayNode(Node):
    """Tells a planner what a recording says, step by step, and compares its plans.

    The telling is a thread of its own; the node ends by itself. `status` is the process's exit status then.
    """

    def __init__(self) -> None:
        super().__init__("replay")
        params = replay_parameters()
        declare(self, params)
        self._settings = values(self, params)
        files = [Path(name).expanduser() for name in self._settings["recording"] if name]
        if not files:
            raise StartError("parameter recording: must name a file, e.g. -p recording:=[flight.mcap]")
        try:
            recording = read_recording(files, is_planners)
            self._steps = steps_of(recording)
            self._prefix = namespace_of(recording)
        except (RecordingError, ValueError) as error:
            raise StartError(f"parameter recording: {error}") from None
        for note in recording.notes:
            self.get_logger().warning(note)
        self.status = 0
        self._first_s = min((item.sent_s for step in self._steps for item in step.inputs), default=0.0)
        self._began = 0.0
        self._heard: list[Deployment] = []
        self._news = threading.Condition()
        self._outs: dict[str, Publisher[Any]] = {}
        for step in self._steps:
            for item in step.inputs:
                if item.topic not in self._outs and (item.type_name != STATE or self._settings["states"]):
                    kind, qos = _KINDS[item.type_name]
                    self._outs[item.topic] = self.create_publisher(kind, item.topic.removeprefix(self._prefix), qos)
        self.create_subscription(Deployment, "deployment", self._on_deployment, _DEPLOYMENTS)
        self._played = self._same = 0
        self._different = ""
        self._diagnostics_out = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_timer(1.0, self._on_second, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._done = self.create_guard_condition(self._on_done)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="replay", daemon=True)
        self._thread.start()

    def destroy_node(self) -> None:
        """Stop telling and leave the graph."""
        self._stopping.set()
        super().destroy_node()

    def _on_deployment(self, message: Deployment) -> None:
        with self._news:
            self._heard.append(message)
            self._news.notify_all()

    def _on_second(self) -> None:
        figures = {"steps": len(self._steps), "steps told": self._played, "plans that are the same": self._same}
        status = DiagnosticStatus(
            level=DiagnosticStatus.WARN if self._different else DiagnosticStatus.OK,
            name=status_name(self.get_fully_qualified_name(), "replay"),
            hardware_id=hardware_of(""),
            message=f"{self._different}; plan with the recorded fleet file and parameters (scripts/report --extract)"
            if self._different
            else f"step {self._played} of {len(self._steps)}",
            values=[KeyValue(key=key, value=str(value)) for key, value in figures.items()],
        )
        header = Header(stamp=self.get_clock().now().to_msg())
        self._diagnostics_out.publish(DiagnosticArray(header=header, status=[status]))

    def _on_done(self) -> None:
        self.context.try_shutdown()

    # On the telling thread

    def _run(self) -> None:
        try:
            self._tell_all()
        finally:
            if not self._stopping.is_set():
                self._done.trigger()

    def _tell_all(self) -> None:
        if not self._planner_is_there():
            self.status = 1
            self.get_logger().error(f"no planner listens to {', '.join(self._outs)} within {_START_PATIENCE_S:g} s")
            return
        if self._heard:
            self.get_logger().warning("the planner has a plan already: start with a fresh one to get the same plans")
        plans = [step.plan for step in self._steps if step.plan is not None]
        planner = self.get_publishers_info_by_topic(self.resolve_topic_name("deployment"))[0]
        debounce = LongDebounce(self, f"{planner.node_namespace.rstrip('/')}/{planner.node_name}")
        if not debounce.hold():
            self.get_logger().warning("the planner's debounce_s cannot be raised: what belongs together may come apart")
        same = self._play()
        if self._stopping.is_set():
            return
        if not debounce.release():
            self.get_logger().warning("the planner's debounce_s and debounce_max_s could not be set back: restart it")
        self.status = 0 if same == len(plans) else DIFFERENT
        self.get_logger().info(f"replayed: {same} of {len(plans)} plans are the same")

    def _planner_is_there(self) -> bool:
        deadline = time.monotonic() + _START_PATIENCE_S
        while time.monotonic() < deadline and not self._stopping.is_set():
            listened = all(publisher.get_subscription_count() for publisher in self._outs.values())
            if listened and self.count_publishers(self.resolve_topic_name("deployment")):
                return True
            time.sleep(_POLL_S)
        return False

    def _play(self) -> int:
        """Tell what came before a plan, wait for the planner's, and so on; return how many were the same."""
        taken = len(self._heard)
        self._began = time.monotonic()
        for step in self._steps:
            self._tell_step(step)
            self._played += 1
            if self._stopping.is_set():
                break
            if step.plan is not None:
                found = self._await_same(step.plan, taken)
                self._same += found is not None
                taken = len(self._heard) if found is None else found + 1
        return self._same

    def _tell_step(self, step: Step) -> None:
        """Tell the states, then the reports together.

        States first: what the planner knows of the fleet when a device event comes must be what it knew then. Reports
        together, at recorded times too: how the planner gathers events into plans depends on milliseconds that a busy
        machine does not keep. The planner's debounce is long enough for both (see `LongDebounce`).
        """
        states = [item for item in step.inputs if item.type_name == STATE]
        for told in [[item] for item in states] if self._settings["rate"] else state_rounds(states):
            for item in told:
                self._wait_for_time_of(item)
                self._tell(item)
            if not self._settings["rate"]:
                self._await_heard()
                self._stopping.wait(_ROUND_S)
        self._await_heard()
        reports = [item for item in step.inputs if item.type_name != STATE]
        for item in reports:
            self._wait_for_time_of(reports[-1])
            self._tell(item)

    def _wait_for_time_of(self, item: Told) -> None:
        rate = self._settings["rate"]
        if rate and not self._stopping.is_set():
            self._stopping.wait(max(0.0, self._began + (item.sent_s - self._first_s) / rate - time.monotonic()))

    def _await_heard(self) -> None:
        for topic, publisher in self._outs.items():
            if not publisher.wait_for_all_acked(Duration(seconds=_ACK_PATIENCE_S)) and not self._stopping.is_set():
                self.get_logger().warning(f"{topic}: not everybody has acknowledged it within {_ACK_PATIENCE_S:g} s")

    def _tell(self, item: Told) -> None:
        if item.topic in self._outs:
            self._outs[item.topic].publish(item.data)

    def _await_same(self, plan: Any, taken: int) -> int | None:
        """Wait for a plan that is the recorded one; return its place among those heard, None if there is none."""
        deadline = time.monotonic() + self._settings["patience_s"]
        name = f"plan {plan.plan_id} ({plan.reason})"
        looked_at = taken
        with self._news:
            while not self._stopping.is_set():
                for index in range(looked_at, len(self._heard)):
                    if not differences(plan, self._heard[index]):
                        self.get_logger().info(f"{name}: the same, {len(plan.cells)} cells")
                        return index
                looked_at = len(self._heard)
                if not self._news.wait(max(0.0, deadline - time.monotonic())) and time.monotonic() >= deadline:
                    break
        if looked_at == taken:
            self._different = f"{name}: the planner made none"
        else:
            self._different = f"{name}: another: {'; '.join(differences(plan, self._heard[-1]))}"
        self.get_logger().warning(self._different)
        return None


def main() -> None:
    """Run the replay as a process; exit status 3 says that a plan was not the same."""
    made: list[ReplayNode] = []

    def make() -> ReplayNode:
        made.append(ReplayNode())
        return made[-1]

    status = run(make)
    sys.exit(status or (made[0].status if made else 0))

"""The recorder node: everything that tells a flight, into an MCAP file that ROS 2 tools and Foxglove read."""

from __future__ import annotations

import json
import sys
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.subscription import Subscription
from std_msgs.msg import Header

from jpap_ros.fleet.config import load_fleet
from jpap_ros.nodes.parameters import StartError, declare, values
from jpap_ros.nodes.process import run
from jpap_ros.nodes.recorder_definitions import full_definition
from jpap_ros.nodes.recorder_diagnostics import recording_status
from jpap_ros.nodes.recorder_file import Channel, Entry
from jpap_ros.nodes.recorder_parameters import recorder_parameters, writer_settings
from jpap_ros.nodes.recorder_topics import TopicFilter, listening_qos, message_class, offered_qos_profiles
from jpap_ros.nodes.recorder_writer import RecordingWriter

#: Between two looks at the subscriptions [s].
_TAKE_PERIOD_S = 0.1


class _NotExecuted(CallbackGroup):
    """Subscriptions that the executor leaves alone.

    An executor in Python is woken for each message and then looks at every subscription of the node: with a hundred
    aircraft that costs more than the rest of the recorder ten times over. The node looks at them all now and then.
    """

    def can_execute(self, entity: Any) -> bool:
        return False

    def beginning_execution(self, entity: Any) -> bool:
        return False

    def ending_execution(self, entity: Any) -> None:
        """Nothing is executed."""


class RecorderNode(Node):
    """Subscribes to topics as they appear and hands their messages, as they are, to the writer's thread."""

    def __init__(self) -> None:
        # First, because rclpy destroys a node whose making was refused.
        self._writer: RecordingWriter | None = None
        super().__init__("recorder")
        params = recorder_parameters()
        declare(self, params)
        settings = values(self, params)
        self._fleet_file: str = settings["fleet_file"]
        fleet = load_fleet(self._fleet_file)
        self._filter = TopicFilter(settings["topics"], self.get_namespace(), fleet.names)
        self._planner_topic = self.resolve_topic_name("deployment")
        self._group = _NotExecuted()
        self._channels: dict[str, tuple[Subscription[Any], Channel]] = {}
        self._newest_ns: dict[str, int] = {}
        self._unreadable: set[str] = set()
        self._asked: set[str] = set()
        self._dropped = 0
        try:
            self._writer = RecordingWriter(writer_settings(settings), self.get_logger().info, self.get_logger().error)
        except OSError as error:
            raise StartError(f"parameter folder: cannot record: {error}") from None
        self._diagnostics_out = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_TAKE_PERIOD_S, self._take, clock=steady)
        self.create_timer(1.0, self._on_second, clock=steady)
        self._discover()

    def destroy_node(self) -> None:
        """Write what was heard, end the file and leave the graph."""
        if self._writer is not None:
            self._take()
            self._writer.close()
        super().destroy_node()

    # Topics

    def _discover(self) -> None:
        for topic, types in self.get_topic_names_and_types():
            if topic not in self._channels and topic not in self._unreadable and self._filter.wants(topic):
                self._listen(topic, types)

    def _listen(self, topic: str, types: list[str]) -> None:
        publishers = self.get_publishers_info_by_topic(topic)
        if not publishers:
            # How to listen follows from how it is published.
            return
        try:
            if len(types) > 1:
                raise LookupError(f"it has several types: {', '.join(types)}")
            kind, definition = message_class(types[0]), full_definition(types[0])
        except LookupError as error:
            self._unreadable.add(topic)
            self.get_logger().warning(f"{topic} is not recorded: {error}")
            return
        offered = [publisher.qos_profile for publisher in publishers]
        channel = Channel(
            topic, types[0], definition, offered_qos_profiles(offered), str(publishers[0].topic_type_hash)
        )
        subscription = self.create_subscription(
            kind, topic, lambda _: None, listening_qos(offered), callback_group=self._group, raw=True
        )
        self._channels[topic] = subscription, channel

    def _take(self) -> None:
        assert self._writer is not None
        entries = []
        for subscription, channel in self._channels.values():
            handle = subscription.handle
            with handle:
                while (taken := handle.take_message(subscription.msg_type, True)) is not None:
                    data, info = taken
                    entries.append(
                        Entry(
                            channel,
                            self._log_ns(channel.topic, info["received_timestamp"]),
                            info["source_timestamp"],
                            data,
                        )
                    )
        if entries:
            self._writer.put(entries)

    def _log_ns(self, topic: str, received_ns: int) -> int:
        """Return the time to log a message at: later than the one taken before it, since readers order by it.

        What a publisher sends while it still repeats its latched messages arrives before them, and is taken after them.
        """
        self._newest_ns[topic] = max(received_ns, self._newest_ns.get(topic, 0) + 1)
        return self._newest_ns[topic]

    # The planner's parameters: without them, nobody could tell later what it was asked to do

    def _ask_planners(self) -> None:
        for publisher in self.get_publishers_info_by_topic(self._planner_topic):
            node = f"{publisher.node_namespace.rstrip('/')}/{publisher.node_name}"
            if node not in self._asked and self.executor is not None:
                self._asked.add(node)
                self.executor.create_task(self._keep_parameters, node)

    async def _keep_parameters(self, node: str) -> None:
        listed = await self._call(ListParameters, f"{node}/list_parameters", ListParameters.Request())
        if listed is not None:
            names = list(listed.result.names)
            got = await self._call(GetParameters, f"{node}/get_parameters", GetParameters.Request(names=names))
            if got is not None and self._writer is not None:
                given = {n: parameter_value_to_python(v) for n, v in zip(names, got.values, strict=True)}
                self._writer.add_metadata(f"parameters of {node}", {n: json.dumps(v) for n, v in given.items()})
                return
        self._asked.discard(node)

    async def _call(self, kind: type[Any], service: str, request: Any) -> Any:
        """Return the service's response, or None if it is not there yet."""
        client = self.create_client(kind, service)
        try:
            return await client.call_async(request) if client.service_is_ready() else None
        finally:
            self.destroy_client(client)

    def _on_second(self) -> None:
        assert self._writer is not None
        if not self._writer.running:
            raise RuntimeError("the writing thread has stopped; the traceback above says why")
        self._discover()
        self._ask_planners()
        report = self._writer.report
        dropping, self._dropped = report.dropped > self._dropped, report.dropped
        if dropping:
            self.get_logger().warning(
                f"the disk is too slow: {report.dropped} messages dropped so far", throttle_duration_sec=60.0
            )
        node = self.get_fully_qualified_name()
        status = recording_status(node, self._fleet_file, report, len(self._channels), dropping)
        header = Header(stamp=self.get_clock().now().to_msg())
        self._diagnostics_out.publish(DiagnosticArray(header=header, status=[status]))


def main() -> None:
    """Run the recorder as a process."""
    sys.exit(run(RecorderNode))

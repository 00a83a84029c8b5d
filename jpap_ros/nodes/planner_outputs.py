"""A plan on its topics: the deployment, and each aircraft's goal and power allocation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from typing import Any

from geometry_msgs.msg import PoseStamped
from jpap_msgs.msg import Deployment, PowerAllocation
from rclpy.lifecycle import LifecycleNode, LifecyclePublisher
from std_msgs.msg import Header

from jpap_ros.fleet.cells import FleetPlan
from jpap_ros.nodes import planner_conversions as conversions
from jpap_ros.nodes.qos import LATCHED


class PlannerOutputs:
    """The planner's latched publishers.

    Parameters
    ----------
    node : LifecycleNode
    uavs : iterable of str
        Names in the fleet file.
    """

    def __init__(self, node: LifecycleNode, uavs: Iterable[str]) -> None:
        self._node = node
        self._made = ExitStack()
        self._deployment = self._publisher(Deployment, "deployment")
        self._goals = {name: self._publisher(PoseStamped, f"{name}/goal_pose") for name in uavs}
        self._powers = {name: self._publisher(PowerAllocation, f"{name}/power_allocation") for name in uavs}

    def publish(
        self,
        plan: FleetPlan,
        before: FleetPlan | None,
        header: Header,
        plan_id: int,
        reason: str,
        altitude_m: float,
        planning_time_s: float,
        reliefs: Mapping[str, tuple[float, float, float]],
    ) -> None:
        """Publish a plan; aircraft that had a cell `before` and have none now get an empty allocation.

        Those of `reliefs` get a goal of their own [m], east, north and up, though they have no cell.
        """
        # The deployment first: whoever gets a goal can look up what it belongs to.
        self._deployment.publish(
            conversions.deployment_message(plan, header, plan_id, reason, altitude_m, planning_time_s)
        )
        # Then those that have something new to do; the others only learn that their goal belongs to this plan.
        known = {(cell.uav, cell.position, cell.device_ids) for cell in before.cells} if before is not None else set()
        for cell in sorted(plan.cells, key=lambda cell: (cell.uav, cell.position, cell.device_ids) in known):
            if cell.uav:
                self._goals[cell.uav].publish(conversions.goal_pose(cell, header, altitude_m))
                self._powers[cell.uav].publish(conversions.power_allocation(cell.uav, cell, header, plan_id))
        for name, place in reliefs.items():
            self._goals[name].publish(conversions.relief_pose(place, header))
        freed = set(before.names.values()) - set(plan.names.values()) if before is not None else set()
        for name in sorted(freed):
            self._powers[name].publish(conversions.power_allocation(name, None, header, plan_id))

    def close(self) -> None:
        """Destroy the publishers."""
        self._made.close()

    def _publisher(self, kind: type, topic: str) -> LifecyclePublisher[Any]:
        publisher = self._node.create_lifecycle_publisher(kind, topic, LATCHED)
        self._made.callback(self._node.destroy_lifecycle_publisher, publisher)
        return publisher

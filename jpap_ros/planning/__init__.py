"""How many UAVs, where each hovers and how much power each device gets. Knows neither ROS nor MAVLink."""

from jpap_ros.planning.deployment import Deployment
from jpap_ros.planning.link_budget import LinkBudget
from jpap_ros.planning.schemes import SCHEMES
from jpap_ros.planning.solver import solve

__all__ = ["SCHEMES", "Deployment", "LinkBudget", "solve"]

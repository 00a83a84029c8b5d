"""Which topics a recording has, and how to listen to them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from fnmatch import translate
from importlib import import_module
from typing import Any

import yaml
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

#: Kept by DDS between two looks.
_DEPTH = 200


class TopicFilter:
    """Tells the topics that are to be recorded.

    Parameters
    ----------
    patterns : iterable of str
        Names, in which `*` stands for anything and `<uav>` for each UAV; relative ones are in `namespace`.
    namespace : str
    uavs : iterable of str
    """

    def __init__(self, patterns: Iterable[str], namespace: str, uavs: Iterable[str]) -> None:
        prefix = namespace.rstrip("/") + "/"
        names = [
            name if name.startswith("/") else prefix + name
            for pattern in patterns
            for name in ([pattern.replace("<uav>", uav) for uav in uavs] if "<uav>" in pattern else [pattern])
        ]
        # One expression for all: hundreds of patterns meet hundreds of topics.
        self._expression = re.compile("|".join(translate(name) for name in names))
        self._known: dict[str, bool] = {}

    def wants(self, topic: str) -> bool:
        """Whether to record a topic, by its full name."""
        if topic not in self._known:
            self._known[topic] = self._expression.match(topic) is not None
        return self._known[topic]


def message_class(type_name: str) -> type[Any]:
    """Return the class of a message type, e.g. `std_msgs/msg/String`; LookupError if it is not installed."""
    package, _, kind = type_name.partition("/msg/")
    try:
        found: type[Any] = getattr(import_module(f"{package}.msg"), kind)
    except (ImportError, AttributeError) as error:
        raise LookupError(f"message type {type_name} is not installed: {error}") from None
    return found


def listening_qos(offered: Iterable[QoSProfile]) -> QoSProfile:
    """Return the profile that hears all publishers, and what they latched where all of them latch."""
    profiles = list(offered)
    reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in profiles)
    latched = all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in profiles)
    return QoSProfile(
        depth=_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def offered_qos_profiles(offered: Iterable[QoSProfile]) -> str:
    """Return publishers' profiles as rosbag2 (metadata version 9, Jazzy and later) writes them."""
    return yaml.safe_dump(
        [
            {
                "history": profile.history.name.lower(),
                "depth": profile.depth,
                "reliability": profile.reliability.name.lower(),
                "durability": profile.durability.name.lower(),
                "deadline": _time(profile.deadline),
                "lifespan": _time(profile.lifespan),
                "liveliness": profile.liveliness.name.lower(),
                "liveliness_lease_duration": _time(profile.liveliness_lease_duration),
                "avoid_ros_namespace_conventions": profile.avoid_ros_namespace_conventions,
            }
            for profile in offered
        ],
        sort_keys=False,
    )


def _time(duration: Duration) -> dict[str, int]:
    seconds, nanoseconds = divmod(duration.nanoseconds, 1_000_000_000)
    return {"sec": seconds, "nsec": nanoseconds}

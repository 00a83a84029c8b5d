"""The deployment and the fleet as standard markers: what every ROS viewer can draw."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion, Vector3
from jpap_msgs.msg import Cell, Deployment, VehicleState
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker

from jpap_ros.fleet.fence import Fence
from jpap_ros.planning.devices import Device

#: Corners of a circle.
CIRCLE_CORNERS = 48
#: A UAV within this distance of its goal is not on its way [m].
ARRIVED_M = 1.0
#: Unserved devices that are named; with more of them names would hide one another.
MAX_LABELS = 200

_COLOURS = {  # Okabe and Ito's palette, which colour-blind readers tell apart
    "blue": (0.337, 0.706, 0.914),
    "orange": (0.902, 0.624, 0.0),
    "vermillion": (0.835, 0.369, 0.0),
    "purple": (0.8, 0.475, 0.655),
    "grey": (0.54, 0.54, 0.54),
    "white": (1.0, 1.0, 1.0),
}
#: Points of the colour map viridis, from the least to the greatest demand, without its dark end: viewers are dark.
_VIRIDIS = np.array(
    [
        (0.230, 0.322, 0.546),
        (0.128, 0.567, 0.551),
        (0.369, 0.789, 0.383),
        (0.993, 0.906, 0.144),
    ]
)
_GOAL_COLOURS = {
    VehicleState.GOAL_SENT: "orange",
    VehicleState.GOAL_ACCEPTED: "orange",
    VehicleState.GOAL_EN_ROUTE: "orange",
    VehicleState.GOAL_REACHED: "blue",
    VehicleState.GOAL_REJECTED: "vermillion",
    VehicleState.GOAL_YIELDED: "purple",
    VehicleState.GOAL_LOST: "vermillion",
}
_TROUBLE = {
    VehicleState.GOAL_REJECTED: "rejected",
    VehicleState.GOAL_YIELDED: "yielded",
    VehicleState.GOAL_LOST: "lost",
}

Place = tuple[float, float, float]


@dataclass
class Scene:
    """What is to be drawn; positions in the map frame [m].

    Attributes
    ----------
    uavs : sequence of str
        Names in the fleet file; the place in it is the id of a UAV's markers.
    fence : Fence or None
    size_m : float
        Diameter of a UAV's marker; the others follow from it.
    devices : sequence of Device
    plan : Deployment or None
    states : mapping of str to VehicleState
    poses, goals : mapping of str to PoseStamped
        Where UAVs are, and where they should be.
    """

    uavs: Sequence[str]
    fence: Fence | None
    size_m: float
    devices: Sequence[Device] = ()
    plan: Deployment | None = None
    states: dict[str, VehicleState] = field(default_factory=dict)
    poses: dict[str, PoseStamped] = field(default_factory=dict)
    goals: dict[str, PoseStamped] = field(default_factory=dict)

    def position(self, uav: str) -> Place | None:
        """Where a UAV is, or was when it was last heard."""
        pose = self.poses.get(uav)
        return _finite(pose.pose.position) if pose is not None else None

    def goal(self, uav: str) -> Place | None:
        """Where a UAV should be: one of a plan before the present one is in force no more."""
        goal = self.goals.get(uav)
        if goal is None or (self.plan is not None and _stamp(goal.header) < _stamp(self.plan.header)):
            return None
        return _finite(goal.pose.position)


def draw_plan(scene: Scene) -> list[Marker]:
    """Return the markers that change only with the plan, the devices and their demands; headers are left out."""
    return [*_fence(scene), *_devices(scene), *_cells(scene)]


def draw_fleet(scene: Scene) -> list[Marker]:
    """Return the markers that follow the aircraft: where they are, their goals, their ways and links."""
    return [
        *_links(scene),
        *(marker for index, uav in enumerate(scene.uavs) for marker in _uav(scene, index, uav)),
    ]


def _devices(scene: Scene) -> list[Marker]:
    """Devices by service (shape) and demand (colour): served, unserved, and those that no plan knows yet."""
    plan = scene.plan or Deployment()
    served = {name for cell in plan.cells if cell.uav for name in cell.device_ids}
    # A cell without an aircraft serves nobody.
    unserved = {item.id for item in plan.unserved}.union(*[cell.device_ids for cell in plan.cells if not cell.uav])
    groups: dict[str, list[Device]] = {"devices_served": [], "devices_unserved": [], "devices_waiting": []}
    for device in scene.devices:
        kind = "served" if device.id in served else "unserved" if device.id in unserved else "waiting"
        groups[f"devices_{kind}"].append(device)
    diameter = 0.5 * scene.size_m
    looks = {
        "devices_served": (Marker.SPHERE_LIST, "white"),
        "devices_unserved": (Marker.CUBE_LIST, "vermillion"),
        "devices_waiting": (Marker.SPHERE_LIST, "grey"),
    }
    markers = []
    for ns, devices in groups.items():
        if not devices:
            continue
        shape, colour = looks[ns]
        marker = _marker(ns, 0, shape, (diameter, diameter, diameter), colour)
        marker.points = [_point((*device.position, 0.0)) for device in devices]
        if ns == "devices_served":
            marker.colors = _demand_colours(devices, scene.devices)
        markers.append(marker)
    for index, device in enumerate(groups["devices_unserved"][:MAX_LABELS]):
        label = f"{device.id}: {device.rate_demand:g} not served"
        markers.append(_text("device_names", index, (*device.position, scene.size_m), label, 0.6 * scene.size_m))
    return markers


class MarkerBook:
    """Remembers what viewers show, so that what has vanished is deleted and nothing else flickers.

    Parameters
    ----------
    repeats : int
        In how many messages a deletion stands: a viewer may miss one.
    """

    def __init__(self, repeats: int = 5) -> None:
        self._repeats = repeats
        self._shown: set[tuple[str, int]] = set()
        self._deletions: dict[tuple[str, int], int] = {}

    @property
    def unfinished(self) -> bool:
        """Whether deletions are still to be repeated."""
        return bool(self._deletions)

    def with_deletions(self, markers: Iterable[Marker]) -> list[Marker]:
        """Return the markers, and a deletion for each that stood in a message before and does not in this one."""
        listed = list(markers)
        now = {(marker.ns, marker.id) for marker in listed}
        self._deletions.update(dict.fromkeys(self._shown - now, self._repeats))
        self._shown = now
        for key in now & self._deletions.keys():
            del self._deletions[key]
        # A deletion is drawn by nobody; its pose and scale are valid all the same.
        listed += [_marker(ns, index, Marker.CUBE, action=Marker.DELETE) for ns, index in self._deletions]
        self._deletions = {key: left - 1 for key, left in self._deletions.items() if left > 1}
        return listed


def _fence(scene: Scene) -> list[Marker]:
    fence = scene.fence
    if fence is None:
        return []
    if fence.center_m is not None and fence.radius_m is not None:
        ring = _circle((*fence.center_m, 0.0), fence.radius_m)
    elif fence.polygon_m:
        ring = [_point((*corner, 0.0)) for corner in (*fence.polygon_m, fence.polygon_m[0])]
    else:
        return []
    return [_line("fence", 0, Marker.LINE_STRIP, ring, 0.2 * scene.size_m, "vermillion")]


def _cells(scene: Scene) -> Iterator[Marker]:
    """Coverage circle of each cell that has an aircraft; the goal of each that has none."""
    for number, (cell, centre, devices) in enumerate(_cells_on_the_map(scene)):
        if cell.uav not in scene.uavs:
            size = 0.7 * scene.size_m
            yield _marker("open_cells", number, Marker.CUBE, (size, size, size), "vermillion", 0.4, centre)
        elif radius := _radius(cell, centre, devices):
            ring = _circle((centre[0], centre[1], 0.0), radius)
            index = scene.uavs.index(cell.uav)
            yield _line("coverage", index, Marker.LINE_STRIP, ring, 0.12 * scene.size_m, "blue", 0.6)


def _links(scene: Scene) -> Iterator[Marker]:
    """Lines from each aircraft that has a cell, where it is, to its devices; faint until it is at its goal."""
    for cell, centre, devices in _cells_on_the_map(scene):
        if cell.uav not in scene.uavs or not devices:
            continue
        here = scene.position(cell.uav) or centre
        ends = [_point(end) for place in devices for end in (here, (*place, 0.0))]
        state = scene.states.get(cell.uav)
        there = state is not None and state.goal_state == VehicleState.GOAL_REACHED
        colour, alpha = ("blue", 0.8) if there else ("grey", 0.5)
        index = scene.uavs.index(cell.uav)
        yield _line("links", index, Marker.LINE_LIST, ends, 0.1 * scene.size_m, colour, alpha)


def _cells_on_the_map(scene: Scene) -> Iterator[tuple[Cell, Place, list[tuple[float, float]]]]:
    """Each cell with its goal and the places of its devices, as far as they are known."""
    if scene.plan is None:
        return
    places = {device.id: device.position for device in scene.devices}
    for cell in scene.plan.cells:
        centre = _finite(cell.goal_pose.position)
        if centre is not None:
            yield cell, centre, [places[name] for name in cell.device_ids if name in places]


def _uav(scene: Scene, index: int, name: str) -> Iterator[Marker]:
    """The aircraft (faint where it was last seen), its name, its goal, and the line to it while it is on its way."""
    size, here, goal = scene.size_m, scene.position(name), scene.goal(name)
    if goal is not None:
        flat = (0.7 * size, 0.7 * size, 0.1 * size)
        yield _marker("goals", index, Marker.CUBE, flat, "blue", 0.35, goal)
    if here is None:
        return
    state = scene.states.get(name)
    colour, lost = _condition(state)
    stale = lost or (state is not None and not state.position_valid)
    yield _marker("uavs", index, Marker.CYLINDER, (size, size, 0.3 * size), colour, 0.4 if stale else 1.0, here)
    trouble = "lost" if lost else _TROUBLE.get(state.goal_state, "") if state is not None else ""
    label = f"{name}: {trouble}" if trouble else name
    yield _text("uav_names", index, (here[0], here[1], here[2] + size), label, 0.8 * size)
    if goal is not None and math.dist(here, goal) > ARRIVED_M:
        ends = [_point(here), _point(goal)]
        yield _line("transits", index, Marker.LINE_LIST, ends, 0.2 * size, "orange", 0.9)


def _condition(state: VehicleState | None) -> tuple[str, bool]:
    """Colour of an aircraft, and whether it is lost."""
    if state is None:
        return "grey", False
    if state.link == VehicleState.LINK_LOST:
        return "vermillion", True
    return _GOAL_COLOURS.get(state.goal_state, "grey"), False


def _radius(cell: Cell, centre: Place, devices: Sequence[tuple[float, float]]) -> float:
    """Common coverage radius where the scheme has one, else the distance to the farthest device [m]."""
    if math.isfinite(cell.coverage_radius_m):
        return float(cell.coverage_radius_m)
    return max((math.dist(place, centre[:2]) for place in devices), default=0.0)


def _demand_colours(devices: Sequence[Device], everybody: Sequence[Device]) -> list[ColorRGBA]:
    """Colours by demand, on a scale from the least to the greatest of all devices."""
    demands = [device.rate_demand for device in everybody]
    low, high = min(demands), max(demands)
    share = (np.array([device.rate_demand for device in devices]) - low) / ((high - low) or 1.0)
    steps = np.linspace(0.0, 1.0, len(_VIRIDIS))
    channels = [np.interp(share, steps, _VIRIDIS[:, channel]).tolist() for channel in range(3)]
    return [ColorRGBA(r=r, g=g, b=b, a=1.0) for r, g, b in zip(*channels, strict=True)]


def _marker(
    ns: str,
    index: int,
    shape: int,
    scale: Place = (1.0, 1.0, 1.0),
    colour: str = "white",
    alpha: float = 1.0,
    place: Place = (0.0, 0.0, 0.0),
    action: int = Marker.ADD,
) -> Marker:
    red, green, blue = _COLOURS[colour]
    return Marker(
        ns=ns,
        id=index,
        type=shape,
        action=action,
        pose=Pose(position=_point(place), orientation=Quaternion(w=1.0)),
        scale=Vector3(x=scale[0], y=scale[1], z=scale[2]),
        color=ColorRGBA(r=red, g=green, b=blue, a=alpha),
    )


def _line(
    ns: str, index: int, shape: int, points: list[Point], width: float, colour: str, alpha: float = 1.0
) -> Marker:
    # Of a line's scale only x, the width, counts; zero elsewhere would look like a mistake to a strict viewer.
    marker = _marker(ns, index, shape, (width, width, width), colour, alpha)
    marker.points = points
    return marker


def _text(ns: str, index: int, place: Place, text: str, height: float) -> Marker:
    marker = _marker(ns, index, Marker.TEXT_VIEW_FACING, (height, height, height), "white", place=place)
    marker.text = text
    return marker


def _circle(centre: Place, radius: float) -> list[Point]:
    angles = [2.0 * math.pi * corner / CIRCLE_CORNERS for corner in range(CIRCLE_CORNERS + 1)]
    return [_point((centre[0] + radius * math.cos(a), centre[1] + radius * math.sin(a), centre[2])) for a in angles]


def _point(place: Place) -> Point:
    return Point(x=place[0], y=place[1], z=place[2])


def _finite(point: Point) -> Place | None:
    place = (point.x, point.y, point.z)
    return place if all(map(math.isfinite, place)) else None


def _stamp(header: Header) -> tuple[int, int]:
    return header.stamp.sec, header.stamp.nanosec

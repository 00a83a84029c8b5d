"""What the page is told about, as plain values: aircraft, plans, and how each part says it is doing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

Point = tuple[float, float, float]

#: Levels of diagnostic_msgs/DiagnosticStatus, https://docs.ros.org/en/kilted/p/diagnostic_msgs/
OK, WARN, ERROR, STALE = range(4)


@dataclass(frozen=True)
class Pose:
    """Where an aircraft is.

    Attributes
    ----------
    position : (float, float, float)
        East, north, up [m] in the map frame.
    heading_deg : float
        Clockwise from north [deg].
    """

    position: Point
    heading_deg: float


@dataclass(frozen=True)
class Vehicle:
    """What the bridge knows of one aircraft.

    Attributes
    ----------
    link : str
        `never seen`, `connected` or `lost`.
    autopilot, mode : str
        Empty while unknown.
    armed : bool
    landed : str
        `undefined`, `on ground`, `in air`, `taking off` or `landing`.
    emergency : bool
        The autopilot reports a critical state or an emergency.
    battery : float or None
        Share left, 0 to 1.
    battery_low : bool
        It is low or worse, by its share or by the autopilot's word.
    position : (float, float, float) or None
        East, north, up [m] in the map frame.
    goal : str
        Life of its goal: `none`, `sent`, `accepted`, `en route`, `reached`, `rejected`, `yielded` or `lost`.
    plan_id : int
        Deployment that the goal belongs to; 0: none known.
    reason : str
        Why the goal is in this state.
    distance_m : float or None
        From the aircraft to its goal [m].
    """

    link: str
    autopilot: str = ""
    mode: str = ""
    armed: bool = False
    landed: str = "undefined"
    emergency: bool = False
    battery: float | None = None
    battery_low: bool = False
    position: Point | None = None
    goal: str = "none"
    plan_id: int = 0
    reason: str = ""
    distance_m: float | None = None

    @property
    def taken_over(self) -> bool:
        """Whether a pilot, a ground station or a failsafe has it.

        What the operator's own order took from the planner has yielded too; only the reason tells the two apart.
        """
        return self.goal == "yielded" and "operator" not in self.reason


@dataclass(frozen=True)
class PlannedCell:
    """One UAV of a plan with the devices it serves.

    Attributes
    ----------
    uav : str
        Empty if the fleet has no aircraft for this cell.
    position : (float, float, float)
        Where it should hover: east, north, up [m].
    rates : mapping of str to float
        What each device gets [bit/s], by id.
    uav_rate : float
        Sum of the rates [bit/s].
    radius_m : float or None
        The scheme's common coverage radius [m].
    """

    uav: str
    position: Point
    rates: Mapping[str, float]
    uav_rate: float
    radius_m: float | None = None


@dataclass(frozen=True)
class Plan:
    """The deployment in force.

    Attributes
    ----------
    id : int
    reason : str
        What made the planner plan.
    scheme : str
    cells : tuple of PlannedCell
    unserved : mapping of str to str
        Why each device left out is left out, by id.
    needed : int
        UAVs it takes to serve every servable device.
    bound : int or None
        Proven lower bound on `needed`.
    proven : bool
        `needed` is proven to be the least possible.
    average_rate, average_rate_bound : float or None
        Mean rate of a UAV and a proven upper bound on it [bit/s].
    interrupted : tuple of str
        Devices whose rate falls below their demand while aircraft move.
    planning_s : float
        Time that planning took [s].
    """

    id: int
    reason: str
    scheme: str
    cells: tuple[PlannedCell, ...] = ()
    unserved: Mapping[str, str] = field(default_factory=dict)
    needed: int = 0
    bound: int | None = None
    proven: bool = False
    average_rate: float | None = None
    average_rate_bound: float | None = None
    interrupted: tuple[str, ...] = ()
    planning_s: float = 0.0

    @property
    def planned(self) -> int:
        """Number of devices that an aircraft is to serve; whether it does yet, its state tells."""
        return sum(len(cell.rates) for cell in self.cells if cell.uav)

    @property
    def left_out(self) -> dict[str, str]:
        """Why each device that no aircraft is to serve is left out, by id."""
        no_aircraft = {
            device: "no aircraft for its cell" for cell in self.cells if not cell.uav for device in cell.rates
        }
        return {**self.unserved, **no_aircraft}

    def proof(self) -> str:
        """Say in words how many UAVs it takes, and what is proven about that."""
        if not self.needed:
            return "no UAV needed"
        uavs, bound = count(self.needed, "UAV"), f"at least {self.bound} needed"
        if len(self.cells) < self.needed:
            uavs, bound = f"{len(self.cells)} of the {uavs} needed", f"at least {self.bound}"
        if self.proven:
            return f"{uavs}, proven minimum"
        return f"{uavs}, {bound}" if self.bound is not None else f"{uavs}, no proof of the minimum"


@dataclass(frozen=True)
class Status:
    """One entry of /diagnostics.

    Attributes
    ----------
    node : str
        The node's name, with its namespace.
    part : str
        What of the node it speaks of, e.g. `deployment` or a UAV's name.
    level : int
        OK, WARN, ERROR or STALE.
    message : str
    values : mapping of str to str
    """

    node: str
    part: str
    level: int
    message: str
    values: Mapping[str, str] = field(default_factory=dict)


def count(number: int, noun: str) -> str:
    """Number and noun, e.g. `1 UAV`, `3 devices`."""
    return f"{number} {noun}{'' if number == 1 else 's'}"

"""The life of a fleet: who flies for which cell, who is launched, relieved, sent home or given up."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from enum import Enum

from jpap_ros.fleet.assignment import OBJECTIVES, assign
from jpap_ros.fleet.endurance import Endurance, EndurancePolicy
from jpap_ros.fleet.transit_plan import Obstacle

#: One that is back must be nearer to its former cell than its heir by so much [m].
_NEARER_M = 20.0


class Link(Enum):
    """Whether a vehicle is heard."""

    NEVER_SEEN = 0
    CONNECTED = 1
    LOST = 2


class Charge(Enum):
    """What the autopilot says of its battery, as MAV_BATTERY_CHARGE_STATE."""

    UNKNOWN = 0
    OK = 1
    LOW = 2
    CRITICAL = 3


@dataclass(frozen=True)
class Vehicle:
    """One aircraft as it was last reported.

    Attributes
    ----------
    name : str
    link : Link
    in_air : bool
        Whether it flies, as far as known.
    position : tuple of float or None
        (east, north, up) [m]; None where unknown.
    battery : float
        Share left, 0 to 1; NaN where unknown.
    charge : Charge
    yielded : bool
        Whether a pilot, a ground station or a failsafe has taken it over.
    busy : bool
        Whether it takes off, lands, flies home or carries out another command: it is not commanded now.
    """

    name: str
    link: Link = Link.NEVER_SEEN
    in_air: bool = False
    position: tuple[float, float, float] | None = None
    battery: float = math.nan
    charge: Charge = Charge.UNKNOWN
    yielded: bool = False
    busy: bool = False


@dataclass(frozen=True)
class FleetPolicy(EndurancePolicy):
    """When aircraft are relieved (see EndurancePolicy too), sent home and given up.

    Attributes
    ----------
    lost_after_s : float
        Time for which an aircraft may be silent or taken over before its cell is given to another [s].
    idle_return_s : float
        Time after which an aircraft in the air without a cell is sent home [s].
    repeat_s : float
        Time after which a command that has shown no effect is given again [s].
    launch_timeout_s : float
        Time after which an aircraft that has not taken off for its cell is given up, for as long again [s].
    arrival_radius_m : float
        Distance from its station at which a relief is there [m].
    reserve_handicap_m : float
        Metres by which a reserve on the ground counts as farther away than it is.
    obstacle_radius_m : float
        How far from its last position an aircraft that does not obey may be [m].
    objective : str
        Of `assign`.
    """

    lost_after_s: float = 5.0
    idle_return_s: float = 20.0
    repeat_s: float = 5.0
    launch_timeout_s: float = 120.0
    arrival_radius_m: float = 2.0
    reserve_handicap_m: float = 200.0
    obstacle_radius_m: float = 5.0
    objective: str = "distance2"

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name != "objective" and not (isinstance(value, (int, float)) and 0 <= value < math.inf):
                raise ValueError(f"{item.name} must be finite and >= 0, got {value!r}")
        if self.objective not in OBJECTIVES:
            raise ValueError(f"objective must be one of {', '.join(OBJECTIVES)}, got {self.objective!r}")
        super().__post_init__()


class Order(Enum):
    """What an aircraft is to do."""

    LAUNCH = "launch"
    RETURN = "return"


@dataclass(frozen=True)
class Action:
    """One command for one aircraft, and why."""

    order: Order
    uav: str
    reason: str


@dataclass(frozen=True)
class Station:
    """A place to be crewed: a cell of the plan.

    Attributes
    ----------
    position : tuple of float
        (east, north, up) of the goal [m].
    weight : float
        Which stations come first where aircraft are too few.
    held_by : str
        Aircraft that stays there until others serve, after which the station is given up: nobody else is sent there.
    """

    position: tuple[float, float, float]
    weight: float = 1.0
    held_by: str = ""


@dataclass(frozen=True)
class Roster:
    """Who does what now.

    Attributes
    ----------
    crew : mapping of int to str
        Aircraft of each cell that has one.
    reliefs : mapping of int to str
        Aircraft that waits above a cell, or is on its way there, to take it over.
    goals : mapping of str to tuple of float
        Where each aircraft of the two should be, (east, north, up) [m].
    actions : tuple of Action
        What to command now.
    uncrewed : tuple of int
        Cells for which there is no aircraft: their devices have to go to the neighbours.
    usable : int
        Aircraft that can serve a cell, the crew and those that are free: what the planner may plan with.
    free : tuple of str
        Aircraft without a duty that can be given one.
    reserves : tuple of str
        Aircraft on the ground that could be launched.
    obstacles : tuple of Obstacle
        Aircraft in the air that do not obey.
    events : tuple of str
        What has changed since the last step, in words.
    """

    crew: Mapping[int, str]
    reliefs: Mapping[int, str]
    goals: Mapping[str, tuple[float, float, float]]
    actions: tuple[Action, ...]
    uncrewed: tuple[int, ...]
    usable: int
    free: tuple[str, ...]
    reserves: tuple[str, ...]
    obstacles: tuple[Obstacle, ...]
    events: tuple[str, ...]


class FleetLife:
    """Decides, step by step, from what is reported; the only clock is the time that is passed in.

    Parameters
    ----------
    policy : FleetPolicy
    crew : mapping of int to str, optional
        Who flies for which cell already, after a restart.

    Notes
    -----
    A cell keeps its aircraft as long as that one can fly. It loses it when the aircraft has been silent or taken over
    for `lost_after_s`, has landed, or is at its critical battery; it gets it back when it obeys again before its heir
    is there. A tired aircraft (low battery) stays until its
    relief waits above it; then the two change roles in one step, and the tired one goes home.
    """

    def __init__(self, policy: FleetPolicy, crew: Mapping[int, str] | None = None) -> None:
        #: Its objective may be replaced at any time.
        self.policy = policy
        self._endurance = Endurance(policy)
        self._crew: dict[int, str] = dict(crew or {})
        self._reliefs: dict[int, str] = {}
        self._away_since: dict[str, float] = {}
        self._told_absent: set[str] = set()
        self._given_up: set[str] = set()
        self._left: dict[str, int] = {}
        self._idle_since: dict[str, float] = {}
        self._ordered: dict[str, tuple[Order, float]] = {}
        self._grounded_since: dict[str, float] = {}
        self._barred_until: dict[str, float] = {}
        self._flown: set[str] = set()
        self._tired: set[str] = set()
        self._events: list[str] = []

    def step(self, now_s: float, vehicles: Sequence[Vehicle], stations: Mapping[int, Station]) -> Roster:
        """Take in the state of the whole fleet and the cells of the plan in force, and decide.

        Parameters
        ----------
        now_s : float
            Time on a clock that never goes back [s].
        vehicles : sequence of Vehicle
            The whole fleet.
        stations : mapping of int to Station
            Cells by id.

        Returns
        -------
        Roster
        """
        self._events = []
        fleet = {vehicle.name: vehicle for vehicle in vehicles}
        self._observe(now_s, fleet, stations)
        self._dismiss(now_s, fleet, stations)
        self._take_back(now_s, fleet, stations)
        self._hand_over(fleet, stations)
        free = [vehicle for vehicle in vehicles if self._is_free(now_s, vehicle)]
        self._fill(free, stations)
        free = [vehicle for vehicle in free if vehicle.name not in self._crew.values()]
        self._send_reliefs(now_s, fleet, free, stations)
        goals = {uav: stations[cell].position for cell, uav in self._crew.items()}
        goals |= {uav: self._waiting_place(stations[cell]) for cell, uav in self._reliefs.items()}
        free = [vehicle for vehicle in vehicles if self._is_free(now_s, vehicle)]
        return Roster(
            crew=dict(self._crew),
            reliefs=dict(self._reliefs),
            goals=goals,
            actions=self._actions(now_s, fleet),
            uncrewed=tuple(cell for cell in stations if cell not in self._crew and not stations[cell].held_by),
            usable=len(self._crew) + len(free),
            free=tuple(vehicle.name for vehicle in free),
            reserves=tuple(vehicle.name for vehicle in free if not vehicle.in_air),
            obstacles=tuple(
                Obstacle(v.name, v.position, radius_m=self.policy.obstacle_radius_m)
                for v in vehicles
                if v.in_air and v.position is not None and not _obeys(v)
            ),
            events=tuple(self._events),
        )

    def _observe(self, now_s: float, fleet: Mapping[str, Vehicle], stations: Mapping[int, Station]) -> None:
        """Keep what a single report does not say: since when, and whether it was tired before."""
        places = {uav: stations[cell].position for cell, uav in self._crew.items() if cell in stations}
        reliefs = [
            vehicle.position
            for vehicle in fleet.values()
            if vehicle.position is not None and self._is_free(now_s, vehicle) and self._is_charged(vehicle)
        ]
        for name, vehicle in fleet.items():
            if _obeys(vehicle):
                self._away_since.pop(name, None)
            else:
                self._away_since.setdefault(name, now_s)
            self._note_absence(now_s, vehicle)
            if vehicle.link is not Link.CONNECTED:
                continue
            self._endurance.observe(now_s, name, vehicle.in_air, vehicle.battery, vehicle.position)
            low = self.policy.low_battery
            if name in places:
                low = self._endurance.low(now_s, name, vehicle.battery, places[name], reliefs)
            # A battery recovers a little when the load falls; tired is tired until it stands on the ground.
            if self._is_low(vehicle, low):
                if vehicle.in_air and name not in self._tired:
                    self._events.append(f"{name} is low on battery")
                self._tired.add(name)
            elif not vehicle.in_air:
                self._tired.discard(name)

    def _note_absence(self, now_s: float, vehicle: Vehicle) -> None:
        """Tell at once when an aircraft does not obey any more, and when it is back; act on it only after a while."""
        name = vehicle.name
        if _obeys(vehicle):
            self._given_up.discard(name)
            if name in self._told_absent:
                self._told_absent.remove(name)
                self._events.append(f"{name} is back")
        elif vehicle.link is not Link.NEVER_SEEN:
            if name not in self._told_absent:
                self._told_absent.add(name)
                self._events.append(f"{name} {'was taken over' if vehicle.link is Link.CONNECTED else 'is lost'}")
            if self._absent(now_s, vehicle):
                self._given_up.add(name)

    def _absent(self, now_s: float, vehicle: Vehicle) -> str:
        """In which way an aircraft has not obeyed for too long; empty if it has."""
        if _obeys(vehicle) or now_s - self._away_since.get(vehicle.name, now_s) < self.policy.lost_after_s:
            return ""
        how = "taken over" if vehicle.link is Link.CONNECTED else "lost"
        return f"has been {how} for {self.policy.lost_after_s:g} s"

    def _dismiss(self, now_s: float, fleet: Mapping[str, Vehicle], stations: Mapping[int, Station]) -> None:
        """Take those off their cells that cannot or need not serve them any more."""
        on_duty = {*self._crew.values(), *self._reliefs.values()}
        self._flown = {name for name in on_duty if name in fleet and (fleet[name].in_air or name in self._flown)}
        self._grounded_since = {
            name: self._grounded_since.get(name, now_s)
            for name in on_duty
            if name in fleet and not fleet[name].in_air and not fleet[name].busy
        }
        for duty in (self._crew, self._reliefs):
            for cell, name in list(duty.items()):
                if reason := self._unfit(now_s, fleet.get(name), name, stations.get(cell)):
                    self._events.append(f"{name} {reason}")
                    if duty is self._crew and name in self._given_up:
                        self._left[name] = cell
                if reason or cell not in stations:
                    del duty[cell]
        for cell in [cell for cell in self._reliefs if cell not in self._crew]:
            relief = self._reliefs.pop(cell)
            if cell in stations:
                self._crew[cell] = relief

    def _unfit(self, now_s: float, vehicle: Vehicle | None, name: str, station: Station | None) -> str:
        """Why an aircraft cannot stay on duty; empty where it can."""
        if vehicle is None:
            return "is not in the fleet"
        if reason := self._absent(now_s, vehicle):
            return reason
        if not _obeys(vehicle):
            return ""
        if self._is_critical(now_s, vehicle, station):
            return "is at its critical battery"
        if not vehicle.in_air and name in self._flown and not vehicle.busy:
            # Nobody wanted that: whoever comes down from its station by itself is not sent up again at once.
            self._barred_until[name] = now_s + self.policy.launch_timeout_s
            return "has landed"
        if not vehicle.in_air and name in self._tired:
            return "is too low on battery to take off"
        if now_s - self._grounded_since.get(name, now_s) >= self.policy.launch_timeout_s:
            self._barred_until[name] = now_s + self.policy.launch_timeout_s
            return "has not taken off"
        return ""

    def _take_back(self, now_s: float, fleet: Mapping[str, Vehicle], stations: Mapping[int, Station]) -> None:
        """Give one that is back the cell that it had lost, if whoever got that is not there yet."""
        for name, cell in list(self._left.items()):
            vehicle = fleet.get(name)
            landed = vehicle is not None and vehicle.link is Link.CONNECTED and not vehicle.in_air
            if vehicle is None or landed or cell not in stations:
                del self._left[name]
            elif _obeys(vehicle) and not vehicle.busy:
                del self._left[name]
                place, heir = stations[cell].position, self._crew.get(cell)
                nearer = _distance(vehicle, place) < _distance(fleet.get(heir or ""), place) - _NEARER_M
                on_duty = name in (*self._crew.values(), *self._reliefs.values())
                if nearer and not on_duty and not self._is_critical(now_s, vehicle, stations[cell]):
                    self._events.append(f"{name} takes cell {cell} back")
                    self._crew[cell] = name
                    if heir is not None and name in self._tired:
                        self._reliefs[cell] = heir

    def _hand_over(self, fleet: Mapping[str, Vehicle], stations: Mapping[int, Station]) -> None:
        """Change the roles of a tired aircraft and its relief once that one is in place."""
        for cell, relief in list(self._reliefs.items()):
            if self._crew[cell] not in self._tired or stations[cell].held_by:
                del self._reliefs[cell]
            elif self._is_at(fleet[relief], self._waiting_place(stations[cell])):
                self._events.append(f"{relief} relieves {self._crew[cell]}")
                self._crew[cell] = self._reliefs.pop(cell)

    def _is_at(self, vehicle: Vehicle, place: tuple[float, float, float]) -> bool:
        if vehicle.position is None or not vehicle.in_air or vehicle.busy or not _obeys(vehicle):
            return False
        return math.dist(vehicle.position, place) <= self.policy.arrival_radius_m

    def _fill(self, free: Sequence[Vehicle], stations: Mapping[int, Station]) -> None:
        """Give cells without an aircraft one of those that are free."""
        names = {vehicle.name for vehicle in free}
        held = {cell: station.held_by for cell, station in stations.items() if cell not in self._crew}
        self._crew |= {cell: name for cell, name in held.items() if name in names}
        free = [vehicle for vehicle in free if vehicle.name not in held.values()]
        places = {
            cell: station.position
            for cell, station in stations.items()
            if cell not in self._crew and not station.held_by
        }
        weights = {cell: stations[cell].weight for cell in places}
        for cell, name in self._nearest(free, places, weights).items():
            self._crew[cell] = name
            self._events.append(f"{name} takes cell {cell}")

    def _send_reliefs(
        self, now_s: float, fleet: Mapping[str, Vehicle], free: Sequence[Vehicle], stations: Mapping[int, Station]
    ) -> None:
        """Send one of those that are free to each tired aircraft without a relief: first to who must go home first."""
        places = {
            cell: self._waiting_place(stations[cell])
            for cell, name in self._crew.items()
            if name in self._tired and cell not in self._reliefs and not stations[cell].held_by
        }
        weights = {
            cell: 1.0 / (1.0 + self._endurance.left_s(now_s, name, fleet[name].battery, stations[cell].position))
            for cell, name in self._crew.items()
            if cell in places
        }
        # One that would soon be tired itself is no relief, even if it flies already.
        charged = [vehicle for vehicle in free if self._is_charged(vehicle)]
        for cell, name in self._nearest(charged, places, weights).items():
            self._reliefs[cell] = name
            self._events.append(f"{name} goes to relieve {self._crew[cell]}")

    def _nearest(
        self,
        free: Sequence[Vehicle],
        places: Mapping[int, tuple[float, float, float]],
        weights: Mapping[int, float],
    ) -> dict[int, str]:
        chosen = assign(
            [place[:2] for place in places.values()],
            [vehicle.position[:2] for vehicle in free if vehicle.position is not None],
            objective=self.policy.objective,
            handicap_m=[0.0 if vehicle.in_air else self.policy.reserve_handicap_m for vehicle in free],
            weights=[weights[cell] for cell in places],
        )
        return {cell: free[k].name for cell, k in zip(places, chosen.tolist(), strict=True) if k >= 0}

    def _actions(self, now_s: float, fleet: Mapping[str, Vehicle]) -> tuple[Action, ...]:
        reasons = {name: f"needed for cell {cell}" for cell, name in self._crew.items()}
        reasons |= {name: f"to relieve {self._crew[cell]}" for cell, name in self._reliefs.items()}
        actions = []
        for name, vehicle in fleet.items():
            idle = vehicle.in_air and name not in reasons
            since = self._idle_since.setdefault(name, now_s) if idle else self._idle_since.pop(name, now_s)
            if not _obeys(vehicle) or vehicle.busy:
                continue
            if name in reasons and not vehicle.in_air:
                action = Action(Order.LAUNCH, name, reasons[name])
            elif idle and name in self._tired:
                action = Action(Order.RETURN, name, "low on battery")
            elif idle and now_s - since >= self.policy.idle_return_s:
                action = Action(Order.RETURN, name, "no longer needed")
            else:
                self._ordered.pop(name, None)
                continue
            order, when = self._ordered.get(name, (None, -math.inf))
            if order is not action.order or now_s - when >= self.policy.repeat_s:
                self._ordered[name] = action.order, now_s
                actions.append(action)
        return tuple(actions)

    def _is_free(self, now_s: float, vehicle: Vehicle) -> bool:
        """Whether it has no duty and can be given one."""
        if vehicle.name in self._crew.values() or vehicle.name in self._reliefs.values():
            return False
        if not _obeys(vehicle) or vehicle.busy or vehicle.position is None or vehicle.name in self._tired:
            return False
        if vehicle.in_air:
            return True
        return self._is_charged(vehicle) and now_s >= self._barred_until.get(vehicle.name, now_s)

    def _is_charged(self, vehicle: Vehicle) -> bool:
        return math.isnan(vehicle.battery) or vehicle.battery >= self.policy.ready_battery

    def _waiting_place(self, station: Station) -> tuple[float, float, float]:
        east, north, up = station.position
        return east, north, up + self.policy.station_above_m

    def _is_low(self, vehicle: Vehicle, low: float) -> bool:
        return vehicle.battery <= low or vehicle.charge in (Charge.LOW, Charge.CRITICAL)

    def _is_critical(self, now_s: float, vehicle: Vehicle, station: Station | None) -> bool:
        critical = self.policy.critical_battery
        if station is not None:
            critical = self._endurance.critical(now_s, vehicle.name, vehicle.battery, station.position)
        return vehicle.battery <= critical or vehicle.charge is Charge.CRITICAL


def _distance(vehicle: Vehicle | None, place: tuple[float, float, float]) -> float:
    """How far an aircraft is from a place [m]; infinite where there is none."""
    return math.inf if vehicle is None or vehicle.position is None else math.dist(vehicle.position, place)


def _obeys(vehicle: Vehicle) -> bool:
    return vehicle.link is Link.CONNECTED and not vehicle.yielded

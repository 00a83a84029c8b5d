"""What the bridge knows of one aircraft at one moment, to be handed to another thread."""

from __future__ import annotations

from dataclasses import dataclass, replace

from jpap_ros.mavlink.aircraft import Aircraft
from jpap_ros.mavlink.goals import GoalState
from jpap_ros.mavlink.problems import problems_of
from jpap_ros.mavlink.vehicle import Battery, LinkState, Position


@dataclass(frozen=True)
class AircraftSnapshot:
    """One aircraft; units as in the parts it is taken from.

    Attributes
    ----------
    name, sysid : str, int
    link : LinkState
    heartbeat_at : float
        When a heartbeat was last heard, monotonic [s]; minus infinity: never.
    autopilot, mode : str
        Names; empty while unknown.
    armed : bool
    landed_state, system_status : int
        MAV_LANDED_STATE, MAV_STATE.
    battery : Battery
    position : Position or None
    enu_m : (east, north, up) or None
        In the map frame [m].
    geoid_separation_m : float or None
        Height of mean sea level above the ellipsoid [m]; None: unknown.
    setpoint_rate_hz : float
        Position targets sent to it a second, over the last seconds.
    goal_state : GoalState
    goal_reason : str
    goal_plan_id : int
    goal_distance_m : float
        NaN: unknown.
    problems : tuple of str
        What an operator should look into.
    reboots : int
        Since the bridge started.
    flown : bool
        The bridge flies it to its goals, or is about to.
    line_m : tuple of (east, north, up)
        Corners of the line in the air on which it is until it is heard again [m]; empty: on the ground, or unknown.
    condition : tuple
        What makes a change worth telling at once; see `condition_of`.
    """

    name: str
    sysid: int
    link: LinkState
    heartbeat_at: float
    autopilot: str
    mode: str
    armed: bool
    landed_state: int
    system_status: int
    battery: Battery
    position: Position | None
    enu_m: tuple[float, float, float] | None
    geoid_separation_m: float | None
    setpoint_rate_hz: float
    goal_state: GoalState
    goal_reason: str
    goal_plan_id: int
    goal_distance_m: float
    problems: tuple[str, ...]
    reboots: int
    flown: bool
    line_m: tuple[tuple[float, float, float], ...] = ()
    condition: tuple[object, ...] = ()


def condition_of(aircraft: Aircraft) -> tuple[object, ...]:
    """What makes a change worth telling at once: everything but the figures that always move."""
    vehicle, life = aircraft.vehicle, aircraft.life
    return (
        vehicle.link,
        aircraft.autopilot,
        vehicle.custom_mode,
        vehicle.armed,
        vehicle.landed_state,
        vehicle.system_status,
        vehicle.battery.charge_state,
        life.state,
        life.reason,
        aircraft.assigned.goal.plan_id if aircraft.assigned.goal else 0,
        tuple(problems_of(aircraft)),
        aircraft.flown,
        aircraft.whereabouts.lost_m,
        aircraft.whereabouts.left_m,
    )


def position_of(aircraft: Aircraft) -> Position | None:
    """Where it is; None if that was heard too long ago."""
    vehicle = aircraft.vehicle
    return vehicle.position if vehicle.position_fresh(aircraft.now) else None


def snapshot_of(aircraft: Aircraft, condition: tuple[object, ...]) -> AircraftSnapshot:
    """Copy the present state, of which `condition` is a part."""
    vehicle, life = aircraft.vehicle, aircraft.life
    position = position_of(aircraft)
    return AircraftSnapshot(
        name=aircraft.config.name,
        sysid=aircraft.config.sysid,
        link=vehicle.link,
        heartbeat_at=vehicle.heartbeat_at,
        autopilot=aircraft.autopilot.name if aircraft.autopilot else "",
        mode=aircraft.mode,
        armed=vehicle.armed,
        landed_state=vehicle.landed_state,
        system_status=vehicle.system_status,
        battery=replace(vehicle.battery),
        position=position,
        enu_m=None if position is None else aircraft.whereabouts.enu_m,
        geoid_separation_m=vehicle.geoid_separation_m,
        setpoint_rate_hz=aircraft.sender.traffic.rates(aircraft.now)[0],
        goal_state=life.state,
        goal_reason=life.reason,
        goal_plan_id=aircraft.assigned.goal.plan_id if aircraft.assigned.goal else 0,
        goal_distance_m=life.distance_m,
        problems=tuple(problems_of(aircraft)),
        reboots=vehicle.reboots,
        flown=aircraft.flown,
        line_m=aircraft.whereabouts.line_m(aircraft.setpoint),
        condition=condition,
    )

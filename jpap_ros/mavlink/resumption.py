"""Going on with an aircraft that a bridge before this one flew until it was killed."""

from __future__ import annotations

import math

from jpap_ros.mavlink.aircraft import Aircraft
from jpap_ros.mavlink.procedure_runner import Procedure, ProcedureFailed
from jpap_ros.mavlink.vehicle import LinkState

#: How long an aircraft may take to be heard, to say where it is, and to end its climb [s].
PATIENCE_S = 60.0
#: Slower than this it hovers [m/s].
AT_REST_M_S = 0.5


def resume(aircraft: Aircraft) -> Procedure:
    """Take an aircraft back without an operator, if it is in the air in the very mode in which it was left.

    Nothing is sent to it before that is known, and no mode is changed, nothing armed. ArduPilot stays in GUIDED when
    the bridge dies, so any other mode means that a pilot, a station or a failsafe has it. PX4 leaves OFFBOARD for its
    failsafe, which looks like a pilot's choice: it has to be taken back by an operator.

    One that still coasts after the last target of its convoy is left alone until it rests: its neighbours coast on
    the same clock, and keep apart only as long as nobody brakes alone.
    """
    aircraft.resuming = True
    try:
        deadline = aircraft.now + PATIENCE_S
        while not _resumable(aircraft):
            if aircraft.now >= deadline:
                raise ProcedureFailed(
                    f"not resumed: for {PATIENCE_S:.0f} s it was not heard in the air, position known"
                )
            yield
    finally:
        aircraft.resuming = False
    aircraft.begin_hold()
    aircraft.authority.take({aircraft.mode}, aircraft.now)
    aircraft.streaming = aircraft.goals_open = True
    return "in the air as it was left; flies its goals again"


def _resumable(aircraft: Aircraft) -> bool:
    """Whether it can be taken back now; ProcedureFailed if that must not be done any more."""
    vehicle = aircraft.vehicle
    if vehicle.link is not LinkState.CONNECTED or aircraft.autopilot is None or aircraft.identity_problem:
        return False
    if not vehicle.armed:
        raise ProcedureFailed("not resumed: it is disarmed")
    if aircraft.mode != aircraft.goal_mode:
        aircraft.authority.lose(f"found in {aircraft.mode} after a restart, left in {aircraft.goal_mode}")
        raise ProcedureFailed(aircraft.authority.reason)
    position = vehicle.position
    if position is None or not vehicle.position_fresh(aircraft.now) or math.hypot(*position.velocity_ned) > AT_REST_M_S:
        return False
    return vehicle.in_air and vehicle.home is not None and not vehicle.critical

"""What an operator should look into at one aircraft, each problem with what to do about it."""

from __future__ import annotations

from jpap_ros.mavlink.aircraft import Aircraft
from jpap_ros.mavlink.autopilots import AltitudeDatum
from jpap_ros.mavlink.goals import GoalState
from jpap_ros.mavlink.guards import datum_problem, echo_problem
from jpap_ros.mavlink.vehicle import LinkState

#: Commands in a row without an answer, while the vehicle is heard well, before that is reported.
UNANSWERED_SUSPICIOUS = 3
#: An echo sooner than this after its target was changed may still be of the one before [s].
ECHO_SETTLED_S = 3.0


def problems_of(aircraft: Aircraft) -> list[str]:
    """Tell what is wrong now, in words; empty in good order."""
    vehicle, unanswered = aircraft.vehicle, aircraft.commands.unanswered_in_row
    found = [problem for problem in (aircraft.fault, aircraft.identity_problem, aircraft.link_problem) if problem]
    if vehicle.link is not LinkState.CONNECTED:
        return found
    if unanswered >= UNANSWERED_SUSPICIOUS:
        found.append(
            f"heard but does not obey: {unanswered} commands in a row without an answer; "
            "check that the link works both ways and, on ArduPilot, that SYSID_ENFORCE is 0 or MAV_GCS_SYSID "
            "(SYSID_MYGCS before 4.7) is the bridge's sysid"
        )
    if vehicle.position is not None and vehicle.home is None:
        found.append("home is not set: heights above home cannot be flown; set home or wait for a better fix")
    if problem := datum_problem(vehicle, aircraft.datum, aircraft.frame.origin.altitude_amsl_m):
        found.append(problem)
    if problem := _echo_problem(aircraft):
        found.append(problem)
    return found


def _echo_problem(aircraft: Aircraft) -> str | None:
    life, sender = aircraft.life, aircraft.sender
    target, home, echo = aircraft.assigned.target, aircraft.vehicle.home, aircraft.vehicle.echo
    echoed = life.state in (GoalState.ACCEPTED, GoalState.EN_ROUTE, GoalState.REACHED)
    if not echoed or target is None or home is None or echo is None or not life.is_target(echo):
        return None
    if sender.sent is not target or echo.received_at < sender.changed_at + ECHO_SETTLED_S:
        return None
    relative = aircraft.datum is AltitudeDatum.RELATIVE
    return echo_problem(echo, home.amsl_m + target.height_m if relative else target.amsl_m, home)

"""What an operator can ask of one aircraft, step by step: launch, hold, return home, land."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterable
from functools import partial

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.fleet.tower import CLIMB_TOLERANCE_M, Hindrance, Tower, Turn
from jpap_ros.mavlink.aircraft import Aircraft
from jpap_ros.mavlink.authority import Holder
from jpap_ros.mavlink.autopilots import Autopilot, TargetError, Transport
from jpap_ros.mavlink.commands import ANSWER_TIMEOUT_S, Command, Outcome
from jpap_ros.mavlink.muster import PLACES_WITHIN_S, Muster
from jpap_ros.mavlink.procedure_runner import Procedure, ProcedureFailed
from jpap_ros.mavlink.vehicle import LinkState

#: A mode asked for must show in the heartbeat within this [s].
MODE_TIMEOUT_S = 5.0
#: Arming must show in the heartbeat within this [s].
ARMED_TIMEOUT_S = 5.0
#: A heartbeat so long after ARM must show it: a beat's time, and the way there and back. One that shows it disarmed
#: then ends the repeating, because somebody may have disarmed it; in any case it ends after so long [s].
ARM_SHOWS_S, ARM_PROMPT_S = 1.5, 3.0
#: STATUSTEXT that explains a refusal may come this long after the answer [s].
WORDS_AFTER_S = 1.0
#: A climb or a landing may take this long, plus a time that grows with the height [s], [m/s].
CLIMB_TIMEOUT_S = 30.0
CLIMB_SPEED_M_S = 0.5
#: Time given to somebody to get out of the way of a take-off or a landing, who does not take off or land himself [s].
WAY_TIMEOUT_S = 45.0

_LEFT_THE_GROUND = "it left the ground while it waited: somebody else flies it"

Wait = Generator[None, None, None]
Place = tuple[float, float, float]


def launch(
    aircraft: Aircraft, delay_s: float = 0.0, tower: Tower | None = None, muster: Muster | None = None
) -> Procedure:
    """Take an aircraft from the ground into the air, or back from a pilot, and open it to the planner's goals.

    Without an answer to arming or take-off the heartbeat and the landed state decide, so that nothing is sent late:
    arming is sent again until a heartbeat must have shown it, and never after it was seen; take-off only while they
    show that it was not done, and only for some seconds. Neither is sent unless the newest heartbeat is in a mode that
    the bridge asked for.

    Parameters
    ----------
    aircraft : Aircraft
    delay_s : float
        Wait before the first step, so that neighbours do not rise together [s].
    tower : Tower, optional
        Says when the way up is free; without it take-offs are not kept apart.
    muster : Muster, optional
        Says whose turn it is and how high to climb; given together with a tower.
    """
    name = aircraft.config.name
    try:
        aircraft.held_because = ""
        aircraft.recalled = False
        if problem := _takeoff_problem(aircraft, aircraft.settings.takeoff_height_m):
            raise ProcedureFailed(problem)
        stood = aircraft.vehicle.link is LinkState.CONNECTED and aircraft.vehicle.on_ground
        if not aircraft.vehicle.in_air:
            yield from _pause(aircraft, delay_s)
        timeout_s = aircraft.settings.ready_timeout_s
        if not (yield from _until(aircraft, lambda: not _not_ready(aircraft), timeout_s, needs_link=False)):
            raise ProcedureFailed(f"not ready: {_not_ready(aircraft)}")
        if stood and not aircraft.vehicle.on_ground:
            raise ProcedureFailed(_LEFT_THE_GROUND)
        if aircraft.vehicle.in_air:
            if aircraft.authority.ours and aircraft.goals_open and aircraft.mode == aircraft.goal_mode:
                return "in the air and flying its goals already"
            yield from _open_to_goals(aircraft)
            return "in the air already; flies its goals now"
        if not aircraft.vehicle.on_ground:
            raise ProcedureFailed("it is taking off or landing; call again when it is in the air or on the ground")
        height_m = aircraft.settings.takeoff_height_m
        if tower is not None and muster is not None:
            yield from _until(aircraft, lambda: muster.turn(name, aircraft.now) is not None, 2 * PLACES_WITHIN_S)
            if (turn := muster.turn(name, aircraft.now)) is None:
                raise ProcedureFailed("where it stands is not on the map")
            height_m = tower.climb_m(turn)
            yield from _wait_for_turn(aircraft, partial(_climb_hindrance, aircraft, tower, turn), "take off")
        yield from _rise(aircraft, height_m)
        yield from _open_to_goals(aircraft)
        return f"in the air at {height_m:.3g} m; flies its goals now"
    finally:
        if muster is not None:
            muster.leave(name)


def _climb_hindrance(aircraft: Aircraft, tower: Tower, turn: Turn) -> Hindrance | None:
    problem = _not_ready(aircraft)
    return Hindrance(problem) if problem else tower.may_climb(turn, aircraft.now)


def _landing_hindrance(aircraft: Aircraft, tower: Tower, turn: Turn) -> Hindrance | None:
    if aircraft.vehicle.link is not LinkState.CONNECTED:
        return Hindrance("link lost")
    return tower.may_land(turn, _here(aircraft), aircraft.now)


def _rise(aircraft: Aircraft, height_m: float) -> Wait:
    autopilot = _autopilot(aircraft)
    if not aircraft.vehicle.on_ground:
        raise ProcedureFailed(_LEFT_THE_GROUND)
    yield from _take(aircraft)
    try:
        if autopilot.mode_before_takeoff is not None:
            yield from _set_mode(aircraft, autopilot.mode_before_takeoff)
        yield from _arm(aircraft)
        yield from _take_off(aircraft, height_m)
    except ProcedureFailed:
        if aircraft.vehicle.on_ground:
            _stand_down(aircraft)
        raise


def hold(aircraft: Aircraft) -> Procedure:
    """Stay where it is until the next launch; takes an aircraft back from a pilot."""
    aircraft.held_because = "held by the operator; call bridge/launch to fly goals again"
    aircraft.recalled = False
    autopilot = _autopilot(aircraft)
    if aircraft.vehicle.on_ground:
        # A target must not make it take off.
        _stand_down(aircraft)
        return "on the ground; stays there"
    if aircraft.vehicle.position is None:
        raise ProcedureFailed("its position is not known")
    aircraft.begin_hold()
    if autopilot.hold_mode == aircraft.goal_mode:
        yield from _open_to_goals(aircraft)
    else:
        yield from _set_mode(aircraft, autopilot.hold_mode)
        aircraft.streaming = aircraft.goals_open = False
    return f"holds in {aircraft.mode}"


def return_home(aircraft: Aircraft, tower: Tower | None = None, turn: Turn | None = None) -> Procedure:
    """Bring an aircraft home and land it there.

    With a tower it flies to above its home under traffic control, waits there for its turn and lands; the answer comes
    when it is on its way. One that a pilot or a failsafe has, that is in a critical state or does not tell its home,
    and any aircraft without a tower, is sent home by the autopilot's own return mode, straight and at once.

    Parameters
    ----------
    aircraft : Aircraft
    tower : Tower, optional
    turn : Turn, optional
        Its turn, where several were told to come home together.
    """
    words = "returns home"
    home = aircraft.whereabouts.home_m
    try:
        autopilot = _autopilot(aircraft)
        direct = aircraft.authority.holder is Holder.OTHERS or aircraft.mode == autopilot.return_mode
        if tower is None or home is None or direct or aircraft.vehicle.critical or not aircraft.vehicle.in_air:
            return (yield from _leave(aircraft, autopilot.return_home(), autopilot.return_mode, words))
        because = _recall(aircraft, words)
        yield from _open_to_goals(aircraft)
        name = aircraft.config.name
        turn = turn or tower.arrivals({name: (_here(aircraft), home)})[name]
        aircraft.procedure.answer("flies home under traffic control and lands there in its turn")
        while not _is_at(aircraft, place := tower.waiting_place(turn)):
            aircraft.way_home = place
            aircraft.held_because = because + (f"; waits: {aircraft.way_closed}" if aircraft.way_closed else "")
            yield
        while hindrance := _landing_hindrance(aircraft, tower, turn):
            aircraft.held_because = f"{because}; waits above its home: {hindrance.words}"
            yield
        aircraft.held_because = because
        return (yield from _touch_down(aircraft, words))
    except ProcedureFailed as failure:
        aircraft.held_because = f"{words} by the operator's command, but {failure}; holds until the next command"
        raise
    finally:
        aircraft.way_home = None
        if tower is not None and turn is not None:
            tower.leave(turn)


def land(aircraft: Aircraft, tower: Tower | None = None) -> Procedure:
    """Land where it is; with a tower, when nobody is in the way."""
    words = "lands"
    autopilot = _autopilot(aircraft)
    here = aircraft.whereabouts.enu_m
    if tower is None or here is None or not aircraft.vehicle.in_air:
        return (yield from _leave(aircraft, autopilot.land(), autopilot.land_mode, words))
    _recall(aircraft, words)
    home = aircraft.whereabouts.home_m
    turn = tower.landing(aircraft.config.name, (*here[:2], 0.0 if home is None else min(home[2], 0.0)))
    try:
        yield from _wait_for_turn(aircraft, partial(_landing_hindrance, aircraft, tower, turn), "land")
        return (yield from _touch_down(aircraft, words))
    finally:
        tower.leave(turn)


def _is_at(aircraft: Aircraft, place: Place | None) -> bool:
    here = aircraft.whereabouts.enu_m
    return here is not None and place is not None and math.dist(here, place) <= aircraft.settings.arrival_radius_m


def _here(aircraft: Aircraft) -> Place:
    if aircraft.whereabouts.enu_m is None:
        raise ProcedureFailed("its position is not known")
    return aircraft.whereabouts.enu_m


def _touch_down(aircraft: Aircraft, words: str) -> Procedure:
    """Land by the autopilot's own mode, and see it to the ground."""
    autopilot = _autopilot(aircraft)
    height_m = _here(aircraft)[2]
    answer = yield from _leave(aircraft, autopilot.land(), autopilot.land_mode, words)
    aircraft.procedure.answer(answer)
    timeout_s = CLIMB_TIMEOUT_S + max(height_m, 0.0) / CLIMB_SPEED_M_S
    yield from _until(
        aircraft,
        lambda: aircraft.vehicle.on_ground or aircraft.mode != autopilot.land_mode,
        timeout_s,
        needs_link=False,
    )
    return answer


def _wait_for_turn(aircraft: Aircraft, hindrance: Callable[[], Hindrance | None], what: str) -> Wait:
    """Wait for those who take off or land themselves, which ends; for others only so long."""
    deadline = math.inf
    while found := hindrance():
        deadline = math.inf if found.passes else min(deadline, aircraft.now + WAY_TIMEOUT_S)
        if aircraft.now >= deadline:
            raise ProcedureFailed(f"cannot {what} for {WAY_TIMEOUT_S:g} s: {found.words}")
        yield
        _check_link(aircraft)


def _recall(aircraft: Aircraft, words: str) -> str:
    """Take an aircraft out of the planner's hands."""
    aircraft.held_because = f"{words} by the operator's command; call bridge/launch to fly goals again"
    aircraft.recalled = True
    return aircraft.held_because


def _leave(aircraft: Aircraft, command: Command, mode: str, words: str) -> Procedure:
    because = _recall(aircraft, words)
    if aircraft.vehicle.on_ground:
        _stand_down(aircraft)
        return "on the ground already"
    aircraft.goals_open = False
    aircraft.begin_hold()
    yield from _change_mode(aircraft, command, mode)
    aircraft.streaming = False
    aircraft.authority.release(because)
    return f"{words} ({mode})"


def _stand_down(aircraft: Aircraft) -> None:
    """Give up an aircraft on the ground; what the bridge armed it disarms."""
    aircraft.streaming = aircraft.goals_open = False
    if aircraft.authority.ours:
        aircraft.authority.release("stands on the ground; call bridge/launch")
        if aircraft.vehicle.armed:
            aircraft.commands.start(_autopilot(aircraft).disarm(), aircraft.now)


def _autopilot(aircraft: Aircraft) -> Autopilot:
    if aircraft.vehicle.link is LinkState.NEVER_SEEN:
        raise ProcedureFailed("never heard")
    if aircraft.vehicle.link is LinkState.LOST:
        raise ProcedureFailed("link lost")
    if aircraft.identity_problem or aircraft.autopilot is None:
        raise ProcedureFailed(aircraft.identity_problem or "the autopilot is not identified yet")
    return aircraft.autopilot


def _takeoff_problem(aircraft: Aircraft, height_m: float) -> str | None:
    fence = aircraft.settings.limits.fence
    if fence is not None and height_m > fence.max_height_m:
        return f"takeoff_height_m {height_m:g} is above the fence's max_height_m {fence.max_height_m:g}"
    return None


def _not_ready(aircraft: Aircraft) -> str:
    """What an aircraft lacks for a launch; empty if nothing."""
    vehicle = aircraft.vehicle
    if vehicle.link is LinkState.NEVER_SEEN:
        return "never heard"
    if vehicle.link is LinkState.LOST:
        return "link lost"
    if aircraft.identity_problem:
        return aircraft.identity_problem
    if aircraft.autopilot is None:
        return "the autopilot is not identified yet"
    if not vehicle.position_fresh(aircraft.now):
        return "its position is not known (no GPS fix?)"
    if vehicle.home is None:
        return "home is not set"
    if vehicle.in_air:
        # PX4 stays critical until somebody takes it out of its failsafe; as long as it is, it holds.
        return ""
    if vehicle.critical:
        return f"the autopilot reports MAV_STATE {vehicle.system_status}"
    if not vehicle.health_known:
        return "its health is not known (no SYS_STATUS)"
    if vehicle.prearm_ok is False:
        words = vehicle.words_since(aircraft.now - aircraft.settings.ready_timeout_s)
        return f"the pre-arm check fails{': ' + words if words else ''}"
    return ""


def _in_hand(aircraft: Aircraft) -> Wait:
    """Wait while the newest heartbeat is in a mode from before: the next one shows that it was late, or a pilot's."""
    while aircraft.authority.ours and not aircraft.authority.expects(aircraft.mode):
        yield
        _check_link(aircraft)


def _take(aircraft: Aircraft, modes: Iterable[str] = ()) -> Wait:
    """Expect these modes from now on, besides the present one.

    The first time in an order, what others have is taken in whatever mode it is. Later their mode ends the order.
    """
    yield from _in_hand(aircraft)
    aircraft.authority.take({aircraft.mode, *modes}, aircraft.now)


def _arm(aircraft: Aircraft) -> Wait:
    vehicle = aircraft.vehicle
    yield from _in_hand(aircraft)
    if vehicle.armed:
        return
    began = aircraft.now

    def enough(sent_at: float) -> bool:
        """Whether it is not sent again."""
        shown = vehicle.armed or vehicle.heartbeat_at > began + ARM_SHOWS_S
        return shown or aircraft.now > began + ARM_PROMPT_S or not aircraft.authority.expects(aircraft.mode)

    outcome = yield from _command(aircraft, _autopilot(aircraft).arm(), enough)
    if outcome.accepted or outcome.result is None:
        armed = yield from _until(aircraft, lambda: vehicle.armed, ARMED_TIMEOUT_S)
        if armed:
            return
        if outcome.accepted:
            raise ProcedureFailed("arm: accepted, but the heartbeat shows it disarmed")
    yield from _refused(aircraft, outcome, began)


def _take_off(aircraft: Aircraft, height_m: float) -> Wait:
    autopilot = _autopilot(aircraft)
    vehicle = aircraft.vehicle
    began = aircraft.now
    try:
        command = autopilot.takeoff(vehicle, height_m)
    except TargetError as error:
        raise ProcedureFailed(f"take off: {error}") from None
    yield from _take(aircraft, autopilot.takeoff_modes)
    rising = (mavlink.MAV_LANDED_STATE_TAKEOFF, mavlink.MAV_LANDED_STATE_IN_AIR)
    mode_before = aircraft.mode

    def begun(sent_at: float) -> bool | None:
        """Whether it takes off; the heartbeat or the landed state must be younger than what was sent."""
        if vehicle.landed_state in rising or aircraft.mode != mode_before:
            return True
        certain = vehicle.armed and vehicle.on_ground and vehicle.landed_at > sent_at + ANSWER_TIMEOUT_S
        return False if certain else None

    outcome = yield from _command(aircraft, command, begun)
    if not outcome.accepted:
        left = outcome.result is None and (
            yield from _until(aircraft, lambda: vehicle.landed_state in rising, MODE_TIMEOUT_S)
        )
        if not left:
            yield from _refused(aircraft, outcome, began)
    enough_m = height_m - min(max(0.5, 0.05 * height_m), CLIMB_TOLERANCE_M)

    def arrived() -> bool:
        return vehicle.in_air and vehicle.position is not None and vehicle.position.relative_m >= enough_m

    timeout_s = CLIMB_TIMEOUT_S + height_m / CLIMB_SPEED_M_S
    if not (yield from _until(aircraft, arrived, timeout_s)):
        words = vehicle.words_since(began)
        raise ProcedureFailed(f"did not reach {height_m:g} m within {timeout_s:.0f} s{': ' + words if words else ''}")


def _open_to_goals(aircraft: Aircraft) -> Wait:
    """Bring an aircraft in the air into the mode that takes goals; it holds until a goal flows."""
    autopilot = _autopilot(aircraft)
    aircraft.begin_hold()
    # A take-off may end by itself in another mode, meanwhile.
    own_modes = autopilot.takeoff_modes if aircraft.authority.ours else frozenset()
    yield from _take(aircraft, own_modes)
    streams = aircraft.settings.transport is Transport.SETPOINT
    if streams and autopilot.stream_lead_s > 0.0:
        aircraft.streaming = True
        yield from _pause(aircraft, autopilot.stream_lead_s)
    yield from _set_mode(aircraft, aircraft.goal_mode, own_modes)
    aircraft.streaming = aircraft.goals_open = True


def _set_mode(aircraft: Aircraft, mode: str, meanwhile: frozenset[str] = frozenset()) -> Wait:
    yield from _change_mode(aircraft, _autopilot(aircraft).set_mode(mode), mode, meanwhile)


def _change_mode(aircraft: Aircraft, command: Command, mode: str, meanwhile: frozenset[str] = frozenset()) -> Wait:
    """Send what changes the mode and believe the heartbeat, not the answer.

    Parameters
    ----------
    meanwhile : frozenset of str
        Modes on the way that are no sign of a pilot.
    """
    yield from _take(aircraft, {mode, *meanwhile})
    began = aircraft.now
    if aircraft.mode != mode:
        outcome = yield from _command(aircraft, command)
        if outcome.accepted or outcome.result is None:
            changed = yield from _until(aircraft, lambda: aircraft.mode == mode, MODE_TIMEOUT_S)
            if not changed and outcome.accepted:
                raise ProcedureFailed(f"{command.words}: accepted, but the heartbeat still shows {aircraft.mode}")
            if not changed:
                yield from _refused(aircraft, outcome, began)
        else:
            yield from _refused(aircraft, outcome, began)
    aircraft.authority.expect({mode}, aircraft.now)


def _command(
    aircraft: Aircraft, command: Command, done: Callable[[float], bool | None] | None = None
) -> Generator[None, None, Outcome]:
    pending = aircraft.commands.start(command, aircraft.now, done)
    try:
        while pending.outcome is None:
            yield
    finally:
        # Another order may have ended this one: nothing of it goes out any more.
        aircraft.commands.withdraw(pending)
    if pending.outcome.result is None:
        _check_link(aircraft)
    return pending.outcome


def _refused(aircraft: Aircraft, outcome: Outcome, began: float) -> Wait:
    """Fail with the answer and the autopilot's own words."""
    yield from _pause(aircraft, WORDS_AFTER_S)
    words = aircraft.vehicle.words_since(began)
    raise ProcedureFailed(f"{outcome.reason}: {words}" if words else outcome.reason)


def _pause(aircraft: Aircraft, seconds: float) -> Wait:
    end = aircraft.now + seconds
    while aircraft.now < end:
        yield


def _until(
    aircraft: Aircraft, condition: Callable[[], bool], timeout_s: float, needs_link: bool = True
) -> Generator[None, None, bool]:
    """Wait for a condition; False if it did not come in time."""
    deadline = aircraft.now + timeout_s
    while not condition():
        if aircraft.now >= deadline:
            return False
        yield
        if needs_link:
            _check_link(aircraft)
    return True


def _check_link(aircraft: Aircraft) -> None:
    if aircraft.vehicle.link is not LinkState.CONNECTED:
        raise ProcedureFailed("link lost")

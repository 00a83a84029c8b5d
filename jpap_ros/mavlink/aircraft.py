"""One aircraft in the bridge's care: what it hears, who commands it, and whether its goal is flown now."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.fleet.config import UavConfig
from jpap_ros.fleet.traffic import Setpoint, Traveller, Vector
from jpap_ros.mavlink.aircraft_settings import AircraftSettings
from jpap_ros.mavlink.assigned_goal import AssignedGoal
from jpap_ros.mavlink.authority import Authority, Holder
from jpap_ros.mavlink.autopilots import AltitudeDatum, Autopilot, TargetError
from jpap_ros.mavlink.coasting import coasting
from jpap_ros.mavlink.commands import CommandChannel, Outcome, Pending
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.mavlink.goals import Goal, GoalLife, GoalState
from jpap_ros.mavlink.guards import PlanDeadman
from jpap_ros.mavlink.identity import identify, mismatch
from jpap_ros.mavlink.procedure_runner import Done, Procedure, ProcedureRunner
from jpap_ros.mavlink.steering import steers
from jpap_ros.mavlink.streams import StreamRequests
from jpap_ros.mavlink.target_choice import TargetChoice
from jpap_ros.mavlink.target_sender import TargetSender
from jpap_ros.mavlink.vehicle import AUTOPILOT_COMPONENT, LinkState, Vehicle
from jpap_ros.mavlink.whereabouts import Whereabouts

#: This near to a moving setpoint an aircraft follows it [m].
FOLLOWING_M = 5.0
#: Without a position for so long a goal under way is set aside; a shorter gap turns nobody back [s].
POSITION_GAP_S = 10.0
#: The autopilot's words from this long before a takeover belong to it [s].
WORDS_BEFORE_S = 5.0


class Aircraft:
    """Glue of the parts that concern one aircraft. No thread, no clock and no socket of its own.

    Parameters
    ----------
    config : UavConfig
    frame : LocalFrame
    settings : AircraftSettings
    own : (int, int)
        System and component id of the bridge.
    send : callable
        Puts a message on the way to this aircraft.
    deadman : PlanDeadman
        Shared by the fleet.
    rates_hz : mapping of int to float
        Telemetry to ask for [Hz], by message id.
    """

    def __init__(
        self,
        config: UavConfig,
        frame: LocalFrame,
        settings: AircraftSettings,
        own: tuple[int, int],
        send: Callable[[Any], object],
        deadman: PlanDeadman,
        rates_hz: Mapping[int, float],
    ) -> None:
        self.config = config
        self.settings = settings
        self.frame = frame
        self.datum = AltitudeDatum(config.altitude_datum)
        self.vehicle = Vehicle(config.sysid, settings.link_timeout_s, settings.simulated_clock)
        self.whereabouts = Whereabouts(self.vehicle, frame, self.datum)
        self.autopilot: Autopilot | None = None
        self.commands = CommandChannel(send, own, (config.sysid, AUTOPILOT_COMPONENT))
        self.authority = Authority()
        self.procedure = ProcedureRunner()
        self.life = GoalLife(settings.arrival_radius_m)
        self.assigned = AssignedGoal(self.vehicle, self.whereabouts, self.life, frame, self.datum)
        self.sender = TargetSender(self.vehicle, self.commands, send)
        self._choice = TargetChoice(self.vehicle, self.whereabouts, self.assigned, self.sender, frame, self.datum)
        #: Local clock at the last call of `hear` or `tick` [s].
        self.now = 0.0
        #: Procedures set these: targets flow; they carry the planner's goals and not only the place to hold.
        self.streaming = False
        self.goals_open = False
        #: Why the operator wants no goals flown; empty: goals may be flown.
        self.held_because = ""
        #: The operator took it out of the planner's hands: it flies home or lands.
        self.recalled = False
        #: It is looked at whether it can be taken back, after a restart.
        self.resuming = False
        #: Set by who knows the links: the system id is heard from several addresses; something else is wrong there.
        self.duplicates = ""
        self.link_problem = ""
        #: What went wrong in the bridge itself, until the next order; empty: nothing did.
        self.fault = ""
        #: Where traffic control wants it now; None: it has no part in it. And why it has to wait there.
        self.setpoint: Setpoint | None = None
        self.way_closed = ""
        #: Place above its home where it waits to land, while an operator's order takes it there.
        self.way_home: Vector | None = None
        #: Whether it flies nowhere but where traffic control wants it.
        self.under_traffic_control = False
        self._deadman = deadman
        self._streams = StreamRequests(self.commands, send, (config.sysid, AUTOPILOT_COMPONENT), rates_hz)
        self._parting: Pending | None = None

    # --- what the planner wants

    def set_goal(self, goal: Goal) -> None:
        """Give it a goal; what must not be flown is refused here, before anything is sent."""
        if self.assigned.give(goal, self.settings.limits):
            self._measure()
            # Not at the next regular time: a new goal goes out at once.
            self.sender.hurry()

    def clear_goal(self, reason: str = "", refused: bool = False) -> None:
        """It has no goal any more, or (`refused`) was given one that must not be flown; in the air it holds."""
        self.assigned.clear(reason, refused)

    @property
    def flown(self) -> bool:
        """Whether the bridge flies it to its goals, or is about to: what one that comes after it may go on with."""
        return self.resuming or (self.authority.ours and not self.held_because and not self.recalled)

    def traveller(self) -> Traveller:
        """How traffic control should see it now.

        It obeys only from where it said itself that it is, since its link is there; later, a gap in telemetry does not
        take it out of control again.
        """
        where = self.whereabouts
        in_hand = self.streaming and self.goals_open and self._can_send() and self.vehicle.in_air
        heard = self.vehicle.link is LinkState.CONNECTED
        obeys = in_hand and where.enu_m is not None and (where.known(self.now) or self.setpoint is not None)
        goal = self.way_home
        if goal is None and self.assigned.goal is not None and self._obstacle() is None:
            goal = self.assigned.place
        position = self.vehicle.position
        heard_at = -math.inf if position is None else position.received_at
        keeps_s = 0.0 if self.autopilot is None else self.autopilot.keeps_velocity_s / self.vehicle.clock_rate
        if where.enu_m is None and where.left_m:
            return Traveller(where.left_m[0], False, where.flies, goal, heard=heard, way=where.left_m[1:])
        return Traveller(where.enu_m, obeys, where.flies, goal, heard_at, heard, keeps_s)

    # --- what an operator wants

    def run(self, procedure: Procedure, done: Done, name: str) -> None:
        """Begin a procedure; another one under way ends as superseded."""
        self.fault = ""
        self.procedure.run(procedure, done, name)

    def begin_hold(self) -> None:
        """Hold where it is now, not where it held before."""
        self._choice.forget_hold()
        self.sender.hurry()

    def part(self, now: float) -> None:
        """The bridge stops: tell the autopilot what it must know."""
        self.now = now
        command = self.autopilot.parting(self.mode) if self.autopilot and self._can_send() else None
        if command is not None:
            self.authority.release("the bridge stops")
            self._parting = self.commands.start(command, now)

    @property
    def parting(self) -> bool:
        """True while the answer to a last command is awaited."""
        return self._parting is not None and self._parting.outcome is None

    # --- what is heard

    def hear(self, message: Any, source: tuple[int, int], now: float) -> None:
        """Take one message from the aircraft's system, `source` being (system, component)."""
        self.now = now
        kind = message.get_type()
        if kind == "COMMAND_ACK":
            self.commands.hear(message, source, now)
            return
        if source[1] != AUTOPILOT_COMPONENT:
            return
        if kind == "HEARTBEAT":
            if message.autopilot == mavlink.MAV_AUTOPILOT_INVALID:
                return
            if self.vehicle.link is not LinkState.CONNECTED:
                self.whereabouts.link_at = now
            known = self.vehicle.link is LinkState.CONNECTED and self.vehicle.autopilot is not None
            self.vehicle.hear(message, now)
            if not known:
                self._identify()
            self._look_at_mode()
            return
        if self.vehicle.autopilot is None:
            return
        if self.vehicle.hear(message, now):
            self._rebooted()
        if kind == "GLOBAL_POSITION_INT":
            self._measure()
        elif kind == "POSITION_TARGET_GLOBAL_INT" and self.vehicle.echo is not None:
            self.life.echoed(self.vehicle.echo)

    @property
    def mode(self) -> str:
        """Name of the present mode; empty while unknown."""
        if self.autopilot is None or self.vehicle.autopilot is None:
            return ""
        return self.autopilot.mode_name(self.vehicle.custom_mode)

    @property
    def goal_mode(self) -> str:
        """Mode in which it takes goals; empty while the autopilot is unknown."""
        return "" if self.autopilot is None else self.autopilot.goal_mode[self.settings.transport]

    def _identify(self) -> None:
        self.autopilot = identify(self.vehicle, self.config.autopilot)
        if self.autopilot is not None:
            self._streams.restart()

    @property
    def identity_problem(self) -> str:
        """Why this vehicle is not served although it is heard; empty in good order."""
        if self.duplicates:
            return self.duplicates
        if self.vehicle.autopilot is None or self.autopilot is not None:
            return ""
        return mismatch(self.vehicle, self.config.autopilot)

    def want_telemetry(self, rates_hz: Mapping[int, float]) -> None:
        """Ask for messages at other rates [Hz], by message id."""
        self._streams.want(rates_hz)

    def want_telemetry_anew(self, rates_hz: Mapping[int, float]) -> None:
        """Ask for all messages, at these rates [Hz]: nothing is known of what comes over the link used from now on."""
        self._streams.want(rates_hz)
        self._streams.restart()

    def _look_at_mode(self) -> None:
        if self.authority.observe(self.mode, self.vehicle.armed, self.now):
            self._yield()

    def _yield(self) -> None:
        self.streaming = self.goals_open = False
        if words := self.vehicle.words_since(self.now - WORDS_BEFORE_S):
            self.authority.reason += f" (autopilot: {words})"
        self.commands.cancel("somebody else took over")
        self.procedure.stop(self.authority.reason)

    def overhear(self, message: Any, now: float) -> None:
        """Take what a ground station sent to it: whoever steers it has it, even where no mode will show that."""
        self.now = now
        if self.authority.ours and self.autopilot is not None and steers(message, self.autopilot, self.mode):
            station = message.get_srcSystem()
            self.authority.lose(f"the ground station with sysid {station} steers it ({message.get_type()})")
            self._yield()

    def fail(self, error: Exception, now: float) -> bool:
        """Give it up after an error that nobody foresaw: it is in no clear state, and the others must be served.

        It is left as when the bridge stops. What went wrong stays among its problems until the next order.

        Returns
        -------
        bool
            False if that is known already.
        """
        fault = f"error in the bridge, {type(error).__name__}: {error}; it is left to its autopilot"
        if fault == self.fault:
            return False
        self.fault = fault
        self.procedure.stop(fault)
        self.part(now)
        self.streaming = self.goals_open = False
        self.authority.lose(fault)
        return True

    def _rebooted(self) -> None:
        self.commands.cancel("the autopilot rebooted")
        self.authority.release("the autopilot rebooted; call bridge/launch")
        self.streaming = self.goals_open = False
        self.whereabouts.rebooted()
        if self.life.flying or self.life.state is GoalState.YIELDED:
            self.life.set_aside(GoalState.LOST, self.authority.reason)
        self.procedure.stop("the autopilot rebooted")

    def _measure(self) -> None:
        self.whereabouts.measure()
        self.assigned.measure()

    # --- what time brings

    def tick(self, now: float) -> None:
        """Do what is due; to be called several times a second."""
        self.now = now
        was = self.vehicle.link
        self.vehicle.update(now)
        if was is LinkState.CONNECTED and self.vehicle.link is LinkState.LOST:
            self.commands.cancel("link lost")
        self.commands.tick(now)
        self.procedure.step()
        if self.autopilot is not None and self.vehicle.link is LinkState.CONNECTED and not self.duplicates:
            position = self.vehicle.position
            position_at = -math.inf if position is None else position.received_at
            self._streams.tick(now, self.vehicle.home is not None, position_at, self.vehicle.landed_at)
        self._fly()

    def _fly(self) -> None:
        under_way = False
        obstacle = self._obstacle()
        if obstacle is None and self.way_closed:
            obstacle = GoalState.NONE, f"waiting for a free way: {self.way_closed}"
        if obstacle is None and self.under_traffic_control and self.setpoint is None:
            obstacle = GoalState.NONE, "waiting for traffic control"
        setpoint = self._setpoint_to_send()
        if setpoint is not None and self._choice.leaves(self.settings.limits.fence, setpoint.position):
            setpoint = None
            obstacle = obstacle or (GoalState.REJECTED, "its way leads out of the fence: it holds")
        if obstacle is not None:
            self.life.set_aside(*obstacle)
            under_way, self.assigned.begun = self.assigned.begun, False
        elif answer := self.sender.take_answer():
            self._take_reposition_answer(answer)
        if self.autopilot is None or not self.streaming or not self._can_send():
            # Where it held before may be far away when it is commanded again.
            self.sender.sent = None
            self._choice.forget_hold()
            return
        if setpoint is not None:
            target = self._choice.at(setpoint, self.now)
        else:
            target = self.assigned.target if obstacle is None else self._choice.hold(self.now, under_way)
        if target is None:
            return
        if obstacle is None:
            self._choice.forget_hold()
            if self.assigned.begun and self.setpoint is not None:
                self.life.moves((target.lat_e7, target.lon_e7))
                self._follow(self.setpoint)
            else:
                self.life.sent((target.lat_e7, target.lon_e7), self.now)
            self.assigned.begun = True
            self.life.tick(self.now, self.vehicle.words_since(self.life.sent_at))
        try:
            replaced = self.sender.put(target, self.autopilot, self._choice.datum(target), self.settings, self.now)
        except TargetError as error:
            self.life.set_aside(GoalState.REJECTED, str(error))
            self.sender.sent = None
            return
        if replaced and target is self.assigned.target and self.setpoint is None:
            self.life.resent(self.now)

    def _take_reposition_answer(self, answer: Outcome) -> None:
        if self.sender.sent is not self.assigned.target:
            return
        if answer.accepted:
            self.life.answered(self.now)
        else:
            words = self.vehicle.words_since(self.life.sent_at)
            self.life.refused(f"{answer.reason}: {words}" if words else answer.reason)

    def _follow(self, setpoint: Setpoint) -> None:
        """Whoever is where traffic control wants it obeys, though it may not come nearer to its goal meanwhile."""
        if self.whereabouts.enu_m is not None and math.dist(self.whereabouts.enu_m, setpoint.position) <= FOLLOWING_M:
            self.life.follows(self.now)

    def _setpoint_to_send(self) -> Setpoint | None:
        """What traffic control wants, so that it may be the last target."""
        if self.setpoint is None or self.autopilot is None or self.vehicle.clock_rate != 1.0:
            # A simulation faster than the clock gets too few targets to do without their full velocity.
            return self.setpoint
        return coasting(self.setpoint, self.autopilot.keeps_velocity_s)

    def _can_send(self) -> bool:
        return (
            self.authority.ours
            and self.autopilot is not None
            and self.vehicle.link is LinkState.CONNECTED
            and not self.duplicates
        )

    def _obstacle(self) -> tuple[GoalState, str] | None:
        """Why the planner's goal is not on the wire now; None if it may be."""
        vehicle = self.vehicle
        if self.authority.holder is Holder.OTHERS:
            return GoalState.YIELDED, self.authority.reason
        if self.recalled:
            return GoalState.YIELDED, self.held_because
        if vehicle.link is LinkState.LOST and (self.life.flying or self.life.state is GoalState.LOST):
            return GoalState.LOST, f"no heartbeat for more than {vehicle.link_timeout_s:g} s"
        if self.assigned.refused:
            return GoalState.REJECTED, self.assigned.refused
        if self.assigned.goal is None:
            return GoalState.NONE, self.held_because or self.assigned.none_because
        if vehicle.link is not LinkState.CONNECTED:
            return GoalState.NONE, "waiting: no heartbeat"
        if problem := self.identity_problem:
            return GoalState.REJECTED, problem
        if not self.authority.ours:
            state = self.life.state if self.life.state is GoalState.LOST else GoalState.NONE
            return state, self.authority.reason
        if self.held_because:
            return GoalState.NONE, self.held_because
        if not self.goals_open or not vehicle.in_air:
            return GoalState.NONE, "waiting: not in the air yet"
        if vehicle.critical:
            return GoalState.REJECTED, f"the autopilot reports MAV_STATE {vehicle.system_status}: it holds"
        # A gap in telemetry must not turn back an aircraft that is on its way, unless it lasts.
        silent = vehicle.position is None or self.now - vehicle.position.received_at > POSITION_GAP_S
        if silent or (not self.assigned.begun and not self.whereabouts.known(self.now)):
            return GoalState.NONE, "waiting: its position is not known"
        silence_s = self._deadman.silence_s(self.now)
        if silence_s is not None:
            return GoalState.NONE, f"planner silent for {silence_s:.0f} s: it holds"
        if problem := self.assigned.problem(self.autopilot, self.settings.limits, not self.under_traffic_control):
            return GoalState.REJECTED, problem
        return None

"""The whole fleet on one I/O thread: links in, aircraft ticked, targets out, snapshots to whoever watches."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import Enum
from functools import partial
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.fleet.config import FleetConfig, LinkUrl
from jpap_ros.fleet.tower import Tower
from jpap_ros.fleet.traffic import TrafficControl, Vector
from jpap_ros.fleet.transit_plan import TransitLimits
from jpap_ros.mavlink import procedures
from jpap_ros.mavlink.aircraft import Aircraft
from jpap_ros.mavlink.aircraft_settings import AircraftSettings
from jpap_ros.mavlink.autopilots import Transport
from jpap_ros.mavlink.fleet_links import open_links
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.mavlink.goals import Goal
from jpap_ros.mavlink.guards import PlanDeadman
from jpap_ros.mavlink.link_rates import LinkRates
from jpap_ros.mavlink.link_report import LinkReport
from jpap_ros.mavlink.links import COMPONENT_ID, Link, LinkHub, Packet, Peer
from jpap_ros.mavlink.muster import Muster
from jpap_ros.mavlink.procedure_runner import Done, Procedure
from jpap_ros.mavlink.resumption import resume
from jpap_ros.mavlink.routing import Forwarder, target_of
from jpap_ros.mavlink.sightings import Sightings
from jpap_ros.mavlink.snapshot import AircraftSnapshot, condition_of, position_of, snapshot_of
from jpap_ros.mavlink.strangers import Strangers
from jpap_ros.mavlink.twins import Twins
from jpap_ros.mavlink.vehicle import AUTOPILOT_COMPONENT, LinkState

_LOG = logging.getLogger(__name__)

HEARTBEAT_S = 1.0
#: Least rate at which every aircraft is looked after [Hz].
TICK_HZ = 10.0
#: Room in one STATUSTEXT.
STATUSTEXT_BYTES = 50
#: Messages taken in before a look at what is due.
PACKETS_AT_ONCE = 50
#: Goals of one plan come one after another: what follows within so long is planned for together, up to a limit [s].
GATHER_S, GATHER_MOST_S = 0.003, 0.03
#: What goes over all links of a vehicle while the one in use is doubtful: a gap would end PX4's OFFBOARD.
GAPLESS = frozenset({mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT})
#: How long an orderly stop waits for PX4 to answer the switch to Hold [s].
PARTING_S = 2.0


class FleetOrder(Enum):
    """What an operator can ask of an aircraft."""

    LAUNCH = "launch"
    HOLD = "hold"
    RETURN_HOME = "return_home"
    LAND = "land"


@dataclass(frozen=True)
class OrderResult:
    """What came of an order for one aircraft, in words."""

    success: bool
    message: str


@dataclass(frozen=True)
class ControllerSettings:
    """How the fleet is run.

    Attributes
    ----------
    sysid : int
        The bridge's own MAVLink system id.
    aircraft : AircraftSettings
    plan_timeout_s : float
        Goals are in force for this long after the last sign of the planner; 0: for ever [s].
    launch_stagger_s : float
        Between the take-offs of one order [s].
    traffic : TransitLimits or None
        How aircraft keep apart on their way to their goals; None: each flies straight to its own.
    """

    sysid: int = 245
    aircraft: AircraftSettings = field(default_factory=AircraftSettings)
    plan_timeout_s: float = 0.0
    launch_stagger_s: float = 1.0
    traffic: TransitLimits | None = None


Route = tuple[Link, Peer]


class _Member:
    """One aircraft with the places where it is heard."""

    def __init__(self, aircraft: Aircraft, links: list[Link], silent_after_s: float) -> None:
        self.aircraft = aircraft
        self.links = links
        self.sightings: Sightings[Route] = Sightings(silent_after_s)
        self.twins: Twins[Route] = Twins()
        self.route: Route | None = None
        self.tick_at = 0.0
        self.told: tuple[object, ...] = ()
        self.told_position: object = None


class FleetController:
    """All aircraft of a fleet file, served by a thread of its own between `start` and `close`.

    Every method may be called from any thread. `on_snapshot` is called on the I/O thread, whenever something about
    an aircraft changed, and must return soon.

    Parameters
    ----------
    config : FleetConfig
    settings : ControllerSettings
    on_snapshot : callable, optional
    on_failure : callable, optional
        Called on the I/O thread as its last act if it fails; see `failure`.
    on_frame : callable, optional
        Called on the I/O thread with the url and the bytes of every frame of any link; must return at once.

    Raises
    ------
    ValueError
        If the bridge's own system id is that of a vehicle, the fence leaves no height for ways, or a signing key
        cannot be used.
    OSError
        If a port cannot be listened on.

    Notes
    -----
    `close` leaves aircraft in the air as their autopilot's rule says: ArduPilot goes on to its last target and hovers
    there; PX4 is switched from OFFBOARD to Hold, because its failsafe for a stream that ends may fly home.
    """

    def __init__(
        self,
        config: FleetConfig,
        settings: ControllerSettings,
        on_snapshot: Callable[[AircraftSnapshot], None] = lambda snapshot: None,
        on_failure: Callable[[], None] = lambda: None,
        on_frame: Callable[[LinkUrl, bytes | bytearray], None] | None = None,
    ) -> None:
        for uav in config.uavs:
            if uav.sysid == settings.sysid:
                raise ValueError(f"the bridge's sysid {settings.sysid} is that of {uav.name}: choose another")
        self._settings = settings
        self._limits = settings.traffic and settings.traffic.within(settings.aircraft.limits.fence)
        self._on_snapshot = on_snapshot
        self._on_failure = on_failure
        self._hub = LinkHub(settings.sysid, on_frame=on_frame)
        self._deadman = PlanDeadman(settings.plan_timeout_s)
        self._calls: deque[Callable[[float], None]] = deque()
        self._stopping = threading.Event()
        #: What ended the I/O thread against expectation: its heartbeats have stopped then.
        self.failure: Exception | None = None
        self._thread = threading.Thread(target=self._run, name="mavlink", daemon=True)
        self._heartbeat_at = 0.0
        self._tick_due_at = 0.0
        self._link_reports: tuple[LinkReport, ...] = ()
        self._tick_s = 1.0 / max(TICK_HZ, settings.aircraft.setpoint_rate_hz)
        self._traffic_at = math.inf
        self._gathering_since: float | None = None
        #: Set unless new goals are waiting for traffic control: by another thread to be looked at, or waited for.
        self.directed = threading.Event()
        self.directed.set()
        self._clock_rate = 1.0
        try:
            links = open_links(self._hub, config)
        except (OSError, ValueError):
            self._hub.close()
            raise
        own = (settings.sysid, COMPONENT_ID)
        self._stations = links.stations
        self._announced = 0
        self._forwarder = Forwarder(self._hub, own, links.stations, [uav.sysid for uav in config.uavs])
        self._rates = {
            links.vehicles[link.url]: LinkRates(link, settings.aircraft.setpoint_rate_hz)
            for link in config.vehicle_links
        }
        frame = LocalFrame(config.origin)
        self._members: dict[str, _Member] = {}
        for i, uav in enumerate(config.uavs):
            aircraft = Aircraft(
                uav,
                frame,
                settings.aircraft,
                own,
                partial(self._send, uav.name),
                self._deadman,
                self._rates[links.vehicles[uav.urls[0]]].rates_hz(None),
            )
            member = _Member(aircraft, [links.vehicles[url] for url in uav.urls], settings.aircraft.link_timeout_s)
            # Spread over the period, so that targets do not leave in a burst.
            member.tick_at = time.monotonic() + self._tick_s * i / len(config.uavs)
            self._members[uav.name] = member
        self._strangers: Strangers[Route] = Strangers(settings.aircraft.link_timeout_s)
        # Targets that move need a stream of setpoints.
        streams = settings.aircraft.transport is Transport.SETPOINT
        self._traffic = None
        if self._limits and streams:
            self._traffic = TrafficControl(self._limits, on_plan=lambda: self._call(self._look_soon))
            self._traffic_at = 0.0
        for member in self._members.values():
            member.aircraft.under_traffic_control = self._traffic is not None
        self._tower = None if self._traffic is None else _tower(self._traffic, settings.aircraft)
        self._by_sysid = {member.aircraft.config.sysid: member for member in self._members.values()}

    # --- for any thread

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()

    def close(self) -> None:
        """Part from the aircraft, end the thread and close the links."""
        if self._thread.is_alive():
            self._stopping.set()
            self._hub.wake()
            self._thread.join()
        if self._traffic is not None:
            self._traffic.close()
        self._hub.close()

    def __enter__(self) -> FleetController:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def set_goal(self, name: str, goal: Goal) -> None:
        """Give an aircraft a goal; KeyError if there is no such aircraft."""
        member = self._members[name]
        self._call(self._deadman.start)
        self._call(lambda now: self._change(member, lambda: member.aircraft.set_goal(goal), now))

    def clear_goal(self, name: str, reason: str = "", refused: bool = False) -> None:
        """Take an aircraft's goal away, or refuse one that could not be read: in the air it holds."""
        member = self._members[name]
        self._call(lambda now: self._change(member, lambda: member.aircraft.clear_goal(reason, refused), now))

    @property
    def link_reports(self) -> tuple[LinkReport, ...]:
        """How each link was doing at the last heartbeat."""
        return self._link_reports

    def planner_alive(self) -> None:
        """The planner gave a sign of life."""
        self._call(self._deadman.feed)

    def announce(self, name: str, text: str) -> None:
        """Tell the ground stations something about an aircraft, in words; KeyError if there is no such aircraft.

        It goes out as STATUSTEXT from the onboard computer (component 191) of the aircraft's own system: ground
        stations show no text of a system that is no vehicle. What is longer than 50 bytes is cut.
        """
        sysid = self._members[name].aircraft.config.sysid
        self._call(lambda now: self._announce(sysid, text))

    def order(self, order: FleetOrder, names: list[str]) -> dict[str, Future[OrderResult]]:
        """Give an operator's order to some aircraft.

        Returns
        -------
        dict of str to Future
            By name, each done when the outcome is known; every order ends in bounded time. A name that is not in
            the fleet has its failure at once.
        """
        futures: dict[str, Future[OrderResult]] = {name: Future() for name in names}
        for name in futures.keys() - self._members.keys():
            known = ", ".join(self._members)
            futures[name].set_result(OrderResult(False, f"no UAV named {name!r} in the fleet file; there are {known}"))
        meant = {name: future for name, future in futures.items() if name in self._members}
        self._call(lambda now: self._begin(order, meant, now))
        return futures

    def resume(self, names: Iterable[str], left: Mapping[str, tuple[Vector, ...]]) -> dict[str, Future[OrderResult]]:
        """Go on with aircraft that a bridge before this one flew until it was killed.

        Parameters
        ----------
        names : iterable of str
            Those it flew.
        left : mapping of str to tuple of (east, north, up)
            Where it left those in the air, flown or not, as `AircraftSnapshot.line_m`: others keep away until each
            says itself where it is.

        Returns
        -------
        dict of str to Future
            As `order`; those that are not in the fleet any more are left out.
        """
        for name in left.keys() & self._members.keys():
            self._call(partial(self._leave, self._members[name].aircraft, left[name]))
        futures: dict[str, Future[OrderResult]] = {name: Future() for name in names if name in self._members}
        for name, future in futures.items():
            self._call(partial(self._resume, self._members[name], partial(_report, future)))
        return futures

    # --- on the I/O thread

    def _call(self, function: Callable[[float], None]) -> None:
        self._calls.append(function)
        # Where others wait, the thread has been woken and takes this one with them.
        if len(self._calls) == 1:
            self._hub.wake()

    def _change(self, member: _Member, change: Callable[[], None], now: float) -> None:
        before = member.aircraft.assigned.goal
        change()
        goal = member.aircraft.assigned.goal
        if self._traffic is None:
            self._tick(member, now)
        elif goal is before or (goal is not None and goal.same_place(before)):
            self._tell(member)
        else:
            self.directed.clear()
            since = self._gathering_since = now if self._gathering_since is None else self._gathering_since
            self._traffic_at = min(now + GATHER_S, since + GATHER_MOST_S)

    def _look_soon(self, now: float) -> None:
        self._traffic_at = min(self._traffic_at, now)

    def _begin(self, order: FleetOrder, futures: Mapping[str, Future[OrderResult]], now: float) -> None:
        begun: dict[str, Done] = {}
        for name, future in futures.items():
            done: Done = partial(_report, future)
            self._members[name].aircraft.now = now
            if not self._members[name].aircraft.procedure.join(done, order.value):
                begun[name] = done
        procedure = self._procedures(order, {name: self._members[name].aircraft for name in begun}, now)
        for rank, (name, done) in enumerate(begun.items()):
            member = self._members[name]
            member.aircraft.run(procedure(member.aircraft, rank), done, order.value)
            self._tick(member, now)

    def _procedures(
        self, order: FleetOrder, fleet: Mapping[str, Aircraft], now: float
    ) -> Callable[[Aircraft, int], Procedure]:
        """What those do who get an order together, each by its rank among them."""
        tower = self._tower
        if order is FleetOrder.LAUNCH:
            muster = None if tower is None else Muster(tower, fleet, now)
            stagger_s = self._settings.launch_stagger_s
            return lambda aircraft, rank: procedures.launch(aircraft, rank * stagger_s, tower, muster)
        if order is FleetOrder.RETURN_HOME:
            flying = {
                name: (one.whereabouts.enu_m, home)
                for name, one in fleet.items()
                if one.vehicle.in_air
                and one.whereabouts.enu_m is not None
                and (home := one.whereabouts.home_m) is not None
            }
            turns = {} if tower is None else tower.arrivals(flying)
            return lambda aircraft, _: procedures.return_home(aircraft, tower, turns.get(aircraft.config.name))
        if order is FleetOrder.HOLD:
            return lambda aircraft, _: procedures.hold(aircraft)
        return lambda aircraft, _: procedures.land(aircraft, tower)

    def _leave(self, aircraft: Aircraft, line_m: tuple[Vector, ...], now: float) -> None:
        aircraft.whereabouts.left_m = line_m

    def _resume(self, member: _Member, done: Done, now: float) -> None:
        member.aircraft.now = now
        member.aircraft.run(resume(member.aircraft), done, "resume")

    def _run(self) -> None:
        try:
            while not self._stopping.is_set():
                self._cycle()
            self._part()
        except Exception as error:
            self.failure = error
            self._on_failure()

    def _cycle(self) -> None:
        wait_s = 0.0 if self._calls else max(0.0, self._next_due() - time.monotonic())
        packets = self._hub.poll(wait_s)
        for start in range(0, len(packets), PACKETS_AT_ONCE):
            # What is due does not wait for a heap of telemetry.
            self._serve()
            for packet in packets[start : start + PACKETS_AT_ONCE]:
                self._receive(packet)
        self._serve()

    def _next_due(self) -> float:
        return min(self._tick_due_at, self._traffic_at, self._heartbeat_at)

    def _serve(self) -> None:
        """Do what was asked for by other threads, and what time asks for."""
        while self._calls:
            self._calls.popleft()(time.monotonic())
        now = time.monotonic()
        if now >= self._heartbeat_at:
            self._heartbeat_at = now + HEARTBEAT_S
            self._beat()
            self._link_reports = tuple(LinkReport.of(link, now) for link in self._hub.links)
            self._adapt(now)
        if self._traffic is not None and now >= self._traffic_at:
            self._traffic_at, self._gathering_since = now + self._tick_s, None
            self._direct(self._traffic, now)
            self.directed.set()
        if now < self._tick_due_at:
            return
        for member in self._members.values():
            if now >= member.tick_at:
                member.tick_at = max(member.tick_at + self._tick_s, now)
                self._tick(member, now)
        self._tick_due_at = min(m.tick_at for m in self._members.values())

    def _direct(self, traffic: TrafficControl, now: float) -> None:
        """Let traffic control see where everybody is, and tell everybody what it says."""
        fleet = {name: member.aircraft.traveller() for name, member in self._members.items()}
        rates = [self._members[name].aircraft.vehicle.clock_rate for name, one in fleet.items() if one.obeys]
        rate = min(rates, default=1.0)
        limits = self._limits
        if limits is not None and abs(rate - self._clock_rate) > 0.1 * self._clock_rate:
            self._clock_rate = rate
            traffic.limits = limits.faster(rate)
        turned = traffic.step(now, fleet)
        for name, member in self._members.items():
            member.aircraft.way_closed = traffic.held(name)
            member.aircraft.whereabouts.lost_m = traffic.lost(name)
        # They do not wait for their regular turns, which stay spread over the period.
        for name in turned:
            self._tick(self._members[name], now)

    def _adapt(self, now: float) -> None:
        """Fit the telemetry of each link to what is measured on it."""
        served_on: dict[Link, list[Aircraft]] = {link: [] for link in self._rates}
        for member in self._members.values():
            served_on[member.links[0] if member.route is None else member.route[0]].append(member.aircraft)
        reports = dict(zip(self._hub.links, self._link_reports, strict=True))
        for link, served in served_on.items():
            report, rates = reports[link], self._rates[link]
            bytes_per_s = report.received_bytes_per_s + report.sent_bytes_per_s
            autopilots = [aircraft.autopilot for aircraft in served if aircraft.autopilot is not None]
            changed = rates.adapt(bytes_per_s, report.loss, autopilots, now)
            for aircraft in served:
                aircraft.link_problem = rates.problem(bytes_per_s)
                if changed:
                    aircraft.want_telemetry(rates.rates_hz(aircraft.autopilot))
        self._report_strangers(now)

    def _report_strangers(self, now: float) -> None:
        """Tell those on whose links another of the fleet is heard; its own side is told in `_contest`."""
        for sysid in self._strangers.sysids:
            for link, peer in self._strangers.addresses(sysid, now):
                relays = self._strangers.relays((link, peer))
                for aircraft in (member.aircraft for member in self._members.values() if link in member.links):
                    if relays and aircraft.vehicle.link is LinkState.CONNECTED:
                        continue
                    words = f"sysid {sysid} is heard from {peer} on {link}; expected {aircraft.config.sysid} here"
                    aircraft.link_problem = "; ".join(filter(None, (words, aircraft.link_problem)))

    def _beat(self) -> None:
        beat = mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
            mavlink.MAV_AUTOPILOT_INVALID,
            0,
            0,
            mavlink.MAV_STATE_ACTIVE,
            3,
        )
        for link in self._hub.links:
            self._hub.send(link, beat)

    def _announce(self, sysid: int, text: str) -> None:
        words = mavlink.MAVLink_statustext_message(mavlink.MAV_SEVERITY_INFO, text.encode()[:STATUSTEXT_BYTES])
        packer = mavlink.MAVLink(None, srcSystem=sysid, srcComponent=COMPONENT_ID)
        self._announced += 1
        for link in self._stations:
            if link.options.signer is not None:
                link.options.signer.sign(packer, link.index)
            packer.seq = self._announced % 256
            self._hub.forward(link, words.pack(packer), urgent=True)

    def _receive(self, packet: Packet) -> None:
        passed_on = self._forwarder.forwarded
        if not self._forwarder.on_packet(packet):
            return
        message = packet.message
        if packet.link in self._stations and self._forwarder.forwarded > passed_on:
            self._overhear(message, packet.received_at)
        member = self._by_sysid.get(message.get_srcSystem())
        if member is None or packet.link in self._stations:
            return
        source = message.get_srcSystem(), message.get_srcComponent()
        now = packet.received_at
        route = packet.link, packet.peer
        expected = packet.link in member.links
        beats = (
            message.get_type() == "HEARTBEAT"
            and source[1] == AUTOPILOT_COMPONENT
            and message.autopilot != mavlink.MAV_AUTOPILOT_INVALID
        )
        if beats:
            self._strangers.heard(source[0], route, expected, now)
        if not expected:
            return
        member.sightings.alive(route, now)
        if len(member.links) > 1 and source[1] == AUTOPILOT_COMPONENT:
            member.twins.heard(route, message, now)
        if beats:
            member.sightings.heard(member.links.index(packet.link), route, now)
            self._reroute(member, now)
        if route != member.route and packet.link is (member.route or route)[0]:
            # Another vehicle with the same system id, or not known to be the same yet.
            return
        reboots = member.aircraft.vehicle.reboots
        with self._shielded(member, now):
            member.aircraft.hear(message, source, now)
        if member.aircraft.vehicle.reboots != reboots:
            member.sightings.forget()
            member.sightings.heard(member.links.index(packet.link), route, now)
        if message.get_type() in ("COMMAND_ACK", "HEARTBEAT", "GLOBAL_POSITION_INT"):
            self._tell(member)

    def _overhear(self, message: Any, now: float) -> None:
        """Look at what a ground station sent to vehicles."""
        system, component = target_of(message)
        for member in self._members.values() if system == 0 else filter(None, [self._by_sysid.get(system)]):
            if component in (0, AUTOPILOT_COMPONENT):
                member.aircraft.overhear(message, now)

    def _reroute(self, member: _Member, now: float) -> None:
        member.aircraft.duplicates = self._contest(member, now)
        before = member.route
        member.route = None if member.aircraft.duplicates else member.sightings.route(now)
        if before is not None and member.route is not None and before[0] is not member.route[0]:
            member.aircraft.want_telemetry_anew(self._rates[member.route[0]].rates_hz(member.aircraft.autopilot))

    def _contest(self, member: _Member, now: float) -> str:
        """Why several vehicles seem to have a member's system id, and what to do; empty in good order."""
        sysid = member.aircraft.config.sysid
        if sharing := member.sightings.duplicates(now) or member.twins.addresses(now):
            return f"sysid {sysid} is used by several vehicles ({_places(sharing)}): none is served; give each its own"
        if rivals := self._strangers.rivals(sysid, now):
            urls = ", ".join(str(link) for link in member.links)
            return (
                f"sysid {sysid} is heard from {_places(rivals)}, and expected on {urls} alone: none is served; give "
                "each vehicle its own sysid, or list that url for this one too"
            )
        return ""

    def _tick(self, member: _Member, now: float) -> None:
        self._reroute(member, now)
        if self._traffic is not None:
            # Where it should be in the middle of the time for which the target holds.
            member.aircraft.setpoint = self._traffic.setpoint(member.aircraft.config.name, now + self._tick_s / 2)
        with self._shielded(member, now):
            member.aircraft.tick(now)
        self._tell(member)

    @contextmanager
    def _shielded(self, member: _Member, now: float) -> Iterator[None]:
        """Let an error with one aircraft end the service to that one, and not to the others."""
        try:
            yield
        except Exception as error:
            if member.aircraft.fail(error, now):
                _LOG.exception("%s: error in the bridge", member.aircraft.config.name)

    def _tell(self, member: _Member) -> None:
        # Looked at often, and copied only where there is something to tell.
        condition, position = condition_of(member.aircraft), position_of(member.aircraft)
        if condition != member.told or position is not member.told_position:
            member.told = condition
            member.told_position = position
            self._on_snapshot(snapshot_of(member.aircraft, condition))

    def _send(self, name: str, message: Any) -> bool:
        member = self._members[name]
        route = member.route
        if len(member.links) > 1 and message.get_msgId() in GAPLESS:
            for link, peer in member.sightings.stand_ins(time.monotonic()):
                self._hub.send(link, message, peer)
        return route is not None and self._hub.send(route[0], message, route[1])

    def _part(self) -> None:
        """Tell those aircraft that need it that the stream ends, and wait for their answers for a moment."""
        for member in self._members.values():
            now = time.monotonic()
            with self._shielded(member, now):
                member.aircraft.procedure.stop("the bridge stops")
                member.aircraft.part(now)
        deadline = time.monotonic() + PARTING_S
        while time.monotonic() < deadline and any(m.aircraft.parting for m in self._members.values()):
            for packet in self._hub.poll(0.1):
                self._receive(packet)
            for member in self._members.values():
                now = time.monotonic()
                with self._shielded(member, now):
                    member.aircraft.tick(now)


def _tower(traffic: TrafficControl, settings: AircraftSettings) -> Tower:
    return Tower(traffic, settings.takeoff_height_m, traffic.limits.max_altitude_m)


def _places(routes: Iterable[Route]) -> str:
    return ", ".join(f"{peer} on {link}" for link, peer in routes)


def _report(future: Future[OrderResult], success: bool, message: str) -> None:
    future.set_result(OrderResult(success, message))

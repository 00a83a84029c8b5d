"""An hour in the life of a large fleet, simulated: devices come and go, batteries run low, aircraft fail.

Planner, fleet life and traffic control are the product's; only ROS, MAVLink and the autopilots are left out: aircraft
are where traffic control wants them. The same history of devices and failures is lived through twice: with the smallest
change at every event and a weighed plan from scratch behind it, and with a plan from scratch at every event.

What is measured does not come from the planner: rates from equation (3) with the aircraft's true places, distances
between all aircraft in the air at every moment, straight lines between the steps.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from jpap_ros.fleet.availability import FleetLife, FleetPolicy, Link, Order, Roster, Station, Vehicle
from jpap_ros.fleet.cells import Aircraft, FleetPlan
from jpap_ros.fleet.handover import handed_over
from jpap_ros.fleet.plan import full_deployment, plan_change, plan_from_scratch, weigh, with_crew
from jpap_ros.fleet.plan_settings import PlanSettings
from jpap_ros.fleet.tower import Tower, Turn
from jpap_ros.fleet.traffic import TrafficControl, Traveller
from jpap_ros.fleet.transit_plan import TransitLimits
from jpap_ros.mavlink.autopilots.ardupilot import ArduPilot
from jpap_ros.planning.devices import Device
from jpap_ros.planning.replanning_decision import ReplanningPolicy

LIMITS = TransitLimits(min_separation_m=10.0, tracking_error_m=1.0, speed_m_s=8.0)
SETTINGS = PlanSettings(min_separation_m=15.0)
STEP_S = 0.5
LIFE_EVERY = 2
SIDE_M = 1200.0
PADS_M = 25.0
#: Height above its pad that an aircraft is told to climb to [m].
TAKEOFF_HEIGHT_M = 10.0
FLIGHT_TIME_S = 1500.0
BATTERY_SWAP_S = 180.0
POLICY = FleetPolicy(
    endurance_s=FLIGHT_TIME_S,
    cruise_m_s=LIMITS.speed_m_s,
    climb_m_s=LIMITS.vertical_speed_m_s,
    arrival_radius_m=2.0,
    station_above_m=LIMITS.planned_separation_m,
)
#: The bridge takes a link for lost after this long without a heartbeat [s].
SILENT_AFTER_S = 4.0
#: With its last velocity an aircraft flies on for so long when it hears nothing more, braking included [s].
RUNS_ON_S = ArduPilot.keeps_velocity_s
#: Below this an aircraft is not counted as in the air [m].
AIRBORNE_M = 2.0

# The paper's parameters in SI units, apart from the product's: P_T 40 dBm, sigma^2 -90 dBm, rho_0 -30 dB.
GAIN_OVER_NOISE = 1e-3 / 1e-12


class Phase(Enum):
    """Where an aircraft is in its flight."""

    GROUND = 0
    CLIMB = 1
    FLY = 2
    DESCEND = 3
    GONE = 4


@dataclass
class Craft:
    """One simulated aircraft."""

    name: str
    home: tuple[float, float]
    place: tuple[float, float, float]
    battery: float
    phase: Phase = Phase.GROUND
    #: Its turn to take off, or to come home and land.
    turn: Turn | None = None
    homing: bool = False
    landed_at: float = -math.inf
    silent_until: float = -math.inf
    #: Whether it hears nothing either while it is silent.
    deaf: bool = False
    heard_at: float = 0.0
    heard_place: tuple[float, float, float] = field(init=False)
    #: Way that it flies on by itself, from its last setpoint on [m], and its velocity there [m/s].
    runs_on_m: float = 0.0
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pilot_until: float = -math.inf
    flown_m: float = 0.0
    #: Powers by device that it transmits with, and those it changes to within a distance of its goal [W, m].
    powers: dict[str, float] = field(default_factory=dict)
    wanted: dict[str, float] = field(default_factory=dict)
    goal: tuple[float, float, float] = (0.0, 0.0, 0.0)
    apply_within_m: float = 0.0

    def __post_init__(self) -> None:
        self.heard_place = self.place

    @property
    def in_air(self) -> bool:
        return self.phase in (Phase.CLIMB, Phase.FLY, Phase.DESCEND)

    def connected(self, now: float) -> bool:
        return self.phase is not Phase.GONE and now - self.heard_at <= SILENT_AFTER_S

    def hears(self, now: float) -> bool:
        """Whether what is published now reaches it."""
        return self.phase is not Phase.GONE and now >= self.silent_until

    def obeys(self, now: float) -> bool:
        """Whether the bridge believes that it follows its setpoints."""
        return self.phase is Phase.FLY and self.connected(now) and now >= self.pilot_until

    def follows(self, now: float) -> bool:
        """Whether it really does."""
        deaf = self.deaf and now < self.silent_until
        return self.phase is Phase.FLY and not deaf and now >= self.pilot_until

    def follow(self, place: tuple[float, float, float], velocity: tuple[float, float, float], ahead_m: float) -> None:
        """Be at a setpoint, whose leg has so much left."""
        self.place, self.velocity = place, velocity
        self.runs_on_m = min(math.hypot(*velocity) * RUNS_ON_S, ahead_m)

    def run_on(self) -> None:
        """Hear no setpoint: fly on as the last one said, and no farther than the end of its leg."""
        if self.runs_on_m > 0.0:
            speed = math.hypot(*self.velocity)
            step_m = min(speed * STEP_S, self.runs_on_m)
            east, north, up = (x + v / speed * step_m for x, v in zip(self.place, self.velocity, strict=True))
            self.place, self.runs_on_m = (east, north, up), self.runs_on_m - step_m


@dataclass(frozen=True)
class Happening:
    """Something that befalls the devices or the fleet; `draw` is a random number in [0, 1) that says to whom."""

    at: float
    kind: str
    draw: float
    place: tuple[float, float]
    rate: float


def history(seconds: float, seed: int) -> list[Happening]:
    """Events of an hour, in order: devices every 5 s on average, failures of aircraft every 100 s."""
    rng = np.random.default_rng(seed)

    def drawn(mean_s: float, kinds: list[str], shares: list[float]) -> Iterator[Happening]:
        now = 0.0
        while (now := now + rng.exponential(mean_s)) < seconds:
            place = tuple(rng.uniform(0, SIDE_M, 2).tolist())
            yield Happening(now, str(rng.choice(kinds, p=shares)), rng.random(), place, rng.uniform(12, 17))

    devices = drawn(5.0, ["join", "leave", "move", "demand"], [0.25] * 4)
    failures = drawn(100.0, ["silence", "pilot", "crash"], [0.75, 0.17, 0.08])
    return sorted([*devices, *failures], key=lambda happening: happening.at)


class World:
    """A fleet, its devices, and the product that keeps them together."""

    def __init__(self, devices: int, uavs: int, seed: int, scratch: bool) -> None:
        rng = np.random.default_rng(seed)
        self.scratch = scratch
        # Where everything changes at every event, whoever waits for others may never go.
        self.settings = replace(SETTINGS, hold_factor=0.0) if scratch else SETTINGS
        self.now = 0.0
        self.devices = {
            f"d{k}": Device(f"d{k}", tuple(rng.uniform(0, SIDE_M, 2).tolist()), rng.uniform(12, 17))
            for k in range(devices)
        }
        self.most = devices
        side = math.ceil(math.sqrt(uavs))
        pads = [(PADS_M * (i % side), -100.0 - PADS_M * (i // side)) for i in range(uavs)]
        self.fleet = {
            f"uav{i + 1}": Craft(f"uav{i + 1}", pad, (*pad, 0.0), rng.uniform(0.6, 1.0)) for i, pad in enumerate(pads)
        }
        self.traffic = TrafficControl(LIMITS, waits_for_plans=True)
        self.tower = Tower(self.traffic, TAKEOFF_HEIGHT_M, LIMITS.max_altitude_m)
        self.life = FleetLife(POLICY)
        self.plan: FleetPlan | None = None
        #: What the aircraft were last told.
        self.published: FleetPlan | None = None
        self.roster: Roster | None = None
        self.planned_for = 0
        self.latency_s: list[float] = []
        self.separation_m = math.inf
        self.closest = ""
        self.served_s: dict[str, float] = {}
        self.present_s: dict[str, float] = {}
        #: Devices that were not served yet since they joined, moved or changed their demand, and for how long in all.
        self.fresh: dict[str, Device] = {}
        self.told: dict[str, Device] = {}
        self.waiting_s = 0.0
        self.interrupted = 0
        #: Hand-overs to a relief, and departures at the critical battery before there was one.
        self.relieved = self.critical = 0
        self.uavs_s: list[int] = []

    # --- what happens

    def befall(self, event: Happening) -> bool:
        """Let it happen; True if it is an event for the planner."""
        if event.kind in ("silence", "pilot", "crash"):
            flying = [c for c in self.fleet.values() if c.follows(self.now) and self.now >= c.silent_until]
            if flying:
                self._fail(flying[int(event.draw * len(flying))], event)
            return False
        names = list(self.devices)
        name = names[int(event.draw * len(names))]
        kind = event.kind
        if len(names) < 0.9 * self.most:
            kind = "join"
        elif len(names) > 1.1 * self.most:
            kind = "leave"
        if kind == "join":
            joined = f"j{event.at:.3f}"
            self.devices[joined] = Device(joined, event.place, event.rate)
        elif kind == "leave":
            del self.devices[name]
        elif kind == "move":
            east, north = self.devices[name].position
            step = (event.place[0] / SIDE_M - 0.5) * 100, (event.place[1] / SIDE_M - 0.5) * 100
            self.devices[name] = replace(self.devices[name], position=(east + step[0], north + step[1]))
        else:
            self.devices[name] = replace(self.devices[name], rate_demand=event.rate)
        return True

    def _fail(self, craft: Craft, event: Happening) -> None:
        if event.kind == "silence":
            craft.silent_until, craft.deaf = self.now + 5.0 + 55.0 * event.draw, event.place[0] < SIDE_M / 2
        elif event.kind == "pilot":
            craft.pilot_until, craft.runs_on_m = self.now + 60.0, 0.0
        else:
            craft.phase, craft.powers, craft.wanted = Phase.GONE, {}, {}
            self._leave(craft)

    # --- the planner

    def _aircraft(self) -> list[Aircraft]:
        assert self.roster is not None
        usable = {*self.roster.crew.values(), *self.roster.free}
        return [
            Aircraft(
                c.name,
                c.place[:2],
                c.connected(self.now),
                c.in_air,
                "" if c.name in usable else "cannot be given a cell now",
                located=c.obeys(self.now),
                up_m=c.place[2],
            )
            for c in self.fleet.values()
        ]

    def replan(self) -> None:
        """Answer events as the planner node does."""
        devices, aircraft = list(self.devices.values()), self._aircraft()
        present = None if self.plan is None else with_crew(self.plan, self.roster.crew if self.roster else {})
        self.planned_for = sum(craft.available for craft in aircraft)
        started = time.perf_counter()
        if present is None or self.scratch:
            plan = plan_from_scratch(devices, self.settings, aircraft, present)
        else:
            plan = plan_change(devices, self.settings, aircraft, present)
        self.latency_s.append(time.perf_counter() - started)
        self._put_in_force(plan)
        if self.scratch or present is None:
            return
        full = full_deployment(devices, SETTINGS, self.planned_for)
        assert self.plan is not None
        weighed = weigh(full, devices, SETTINGS, aircraft, self.plan, ReplanningPolicy())
        if weighed.adopted:
            self._put_in_force(weighed.plan)

    def _put_in_force(self, plan: FleetPlan) -> None:
        self.plan = plan
        self.keep_fleet()

    def keep_fleet(self) -> bool:
        """Step the fleet's life; True if a plan is needed for what became of it."""
        stations = {}
        if self.plan is not None:
            holding = self.plan.holding
            for cell in self.plan.cells:
                goal = (*cell.position, SETTINGS.link.altitude_m)
                stations[cell.id] = Station(goal, len(cell.device_ids), holding.get(cell.id, ""))
        self.roster = self.life.step(self.now, [self._vehicle(craft) for craft in self.fleet.values()], stations)
        self.relieved += sum(" relieves " in event for event in self.roster.events)
        self.critical += sum("critical battery" in event for event in self.roster.events)
        for action in self.roster.actions:
            self._order(self.fleet[action.uav], action.order)
        if self.plan is None:
            return False
        before = self.published
        crewed = with_crew(self.plan, self.roster.crew)
        self.plan = self.published = handed_over(before, crewed, self._aircraft(), self.settings)
        self.interrupted += len(self.plan.interrupted.keys() - (before.interrupted if before is not None else {}))
        of_uav = {cell.uav: cell for cell in self.plan.cells}
        for craft in self.fleet.values():
            if not craft.hears(self.now):
                continue
            craft.wanted, craft.apply_within_m = {}, 0.0
            if (told := of_uav.get(craft.name)) is not None:
                craft.wanted = dict(zip(told.device_ids, told.power_w, strict=True))
                craft.goal, craft.apply_within_m = (*told.position, SETTINGS.link.altitude_m), told.apply_within_m
        needed, usable, cells = self.plan.uavs_needed, self.roster.usable, len(self.plan.target)
        return usable != self.planned_for and (needed > cells or usable < cells)

    def _order(self, craft: Craft, order: Order) -> None:
        """Carry out an order as the bridge does; one that is under way is not begun again."""
        pad = (*craft.home, 0.0)
        if order is Order.LAUNCH and craft.phase is Phase.GROUND and craft.turn is None:
            craft.turn = self.tower.departures({craft.name: pad})[craft.name]
        elif order is Order.RETURN and craft.phase is Phase.FLY and not craft.homing:
            craft.turn, craft.homing = self.tower.arrivals({craft.name: (craft.place, pad)})[craft.name], True

    def _vehicle(self, craft: Craft) -> Vehicle:
        return Vehicle(
            craft.name,
            link=Link.CONNECTED if craft.connected(self.now) else Link.LOST,
            in_air=craft.in_air,
            position=craft.heard_place,
            battery=craft.battery,
            yielded=self.now < craft.pilot_until,
            busy=craft.phase in (Phase.CLIMB, Phase.DESCEND) or craft.homing,
        )

    # --- time

    def step(self) -> None:
        """Let everybody fly for one step."""
        goals = self.roster.goals if self.roster else {}
        travellers = {}
        for craft in self.fleet.values():
            if craft.phase is Phase.GONE:
                continue
            if self.now >= craft.silent_until:
                craft.heard_at, craft.heard_place = self.now, craft.place
            goal = self.tower.waiting_place(craft.turn) if craft.homing and craft.turn else goals.get(craft.name)
            obeys = craft.obeys(self.now)
            heard = craft.connected(self.now)
            travellers[craft.name] = Traveller(
                craft.heard_place, obeys, craft.in_air, goal, craft.heard_at, heard, RUNS_ON_S
            )
        self.traffic.step(self.now, travellers)
        before = {craft.name: craft.place for craft in self.fleet.values() if craft.in_air}
        self.now += STEP_S
        for craft in self.fleet.values():
            self._fly(craft)
        self._watch_separation(before)
        self._watch_rates()

    def _fly(self, craft: Craft) -> None:
        here = craft.place
        east, north, up = here
        if craft.phase is Phase.GROUND:
            if craft.battery < 1 and self.now - craft.landed_at >= BATTERY_SWAP_S and craft.landed_at > -math.inf:
                craft.battery = 1.0
            if craft.turn and self.tower.may_climb(craft.turn, self.now) is None:
                craft.phase = Phase.CLIMB
        elif craft.phase is Phase.CLIMB:
            assert craft.turn is not None
            top_m = self.tower.climb_m(craft.turn)
            craft.place = east, north, min(up + LIMITS.vertical_speed_m_s * STEP_S, top_m)
            if craft.place[2] == top_m:
                craft.phase = Phase.FLY
                self._leave(craft)
        elif craft.phase is Phase.DESCEND:
            craft.place = east, north, max(up - LIMITS.vertical_speed_m_s * STEP_S, 0.0)
            if craft.place[2] == 0.0:
                craft.phase, craft.homing, craft.landed_at = Phase.GROUND, False, self.now
                self._leave(craft)
        elif craft.phase is Phase.FLY and self.now >= craft.pilot_until:
            setpoint = self.traffic.setpoint(craft.name, self.now) if craft.follows(self.now) else None
            if setpoint is None:
                craft.run_on()
            else:
                craft.follow(setpoint.position, setpoint.velocity, setpoint.ahead_m)
            if craft.homing and craft.turn is not None:
                place = self.tower.waiting_place(craft.turn)
                there = place is not None and math.dist(craft.place, place) < 0.1
                if there and craft.hears(self.now) and self.tower.may_land(craft.turn, craft.place, self.now) is None:
                    craft.phase = Phase.DESCEND
        if craft.in_air:
            craft.battery = max(craft.battery - STEP_S / FLIGHT_TIME_S, 0.0)
            craft.flown_m += math.dist(here, craft.place)

    def _leave(self, craft: Craft) -> None:
        if craft.turn is not None:
            self.tower.leave(craft.turn)
            craft.turn = None

    # --- what is measured

    def _watch_separation(self, before: dict[str, tuple[float, float, float]]) -> None:
        flying = [c for c in self.fleet.values() if c.in_air and c.name in before and c.place[2] > AIRBORNE_M]
        if len(flying) < 2:
            return
        start, end = np.array([before[c.name] for c in flying]), np.array([c.place for c in flying])
        first, second = np.triu_indices(len(flying), k=1)
        gap = start[first] - start[second]
        change = end[first] - end[second] - gap
        length2 = np.maximum((change**2).sum(axis=1), 1e-12)
        share = np.clip(-(gap * change).sum(axis=1) / length2, 0.0, 1.0)
        apart = np.linalg.norm(gap + share[:, None] * change, axis=1)
        if (least := float(apart.min())) < self.separation_m:
            pair = [flying[int(index[apart.argmin()])] for index in (first, second)]
            self.separation_m = least
            self.closest = f"{' and '.join(c.name + ' (' + c.phase.name.lower() + ')' for c in pair)} at {self.now:g} s"

    def _watch_rates(self) -> None:
        served: set[str] = set()
        for craft in self.fleet.values():
            if not craft.in_air:
                craft.powers = {}
                continue
            if craft.apply_within_m == 0 or math.dist(craft.place, craft.goal) <= craft.apply_within_m:
                craft.powers = craft.wanted
            served |= self._fed(craft)
        for name, device in self.devices.items():
            if self.told.get(name) is not device:
                self.told[name] = self.fresh[name] = device
            if name in served:
                self.fresh.pop(name, None)
            self.waiting_s += STEP_S * (name in self.fresh)
            self.present_s[name] = self.present_s.get(name, 0.0) + STEP_S
            self.served_s[name] = self.served_s.get(name, 0.0) + STEP_S * (name in served)
        self.uavs_s.append(sum(craft.in_air for craft in self.fleet.values()))

    def _fed(self, craft: Craft) -> set[str]:
        """Devices whose demand an aircraft meets from where it is, equation (3)."""
        found = set()
        for name, power in craft.powers.items():
            if (device := self.devices.get(name)) is not None:
                distance2 = math.dist(craft.place, (*device.position, 0.0)) ** 2
                if math.log2(1 + power * GAIN_OVER_NOISE / distance2) >= device.rate_demand - 1e-6:
                    found.add(name)
        return found


def live(name: str, options: argparse.Namespace, seed: int, scratch: bool) -> tuple[float, float]:
    """Live through the history of a seed and print what came of it.

    Returns the share of all device time for which the guaranteed rate was available, and the least separation [m].
    """
    began = time.perf_counter()
    world = World(options.devices, options.uavs, seed, scratch)
    end = options.warmup + options.minutes * 60.0
    events = [replace(e, at=e.at + options.warmup) for e in history(options.minutes * 60.0, seed + 1)]
    warm, flown, count, steps = False, 0.0, 0, 0
    world.keep_fleet()
    while world.now < end:
        wanted = world.plan is None
        while events and events[0].at <= world.now:
            wanted |= world.befall(events.pop(0))
        if steps % LIFE_EVERY == 0:
            wanted |= world.keep_fleet()
        if wanted:
            world.replan()
            count += warm
        if not warm and world.now >= options.warmup:
            warm = True
            world.served_s, world.present_s, world.latency_s, world.uavs_s, world.interrupted = {}, {}, [], [], 0
            world.waiting_s, world.relieved, world.critical = 0.0, 0, 0
            flown = sum(craft.flown_m for craft in world.fleet.values())
        world.step()
        steps += 1
    world.traffic.close()
    share = np.array([world.served_s[k] / world.present_s[k] for k in world.present_s if world.present_s[k] >= 60.0])
    present_s = sum(world.present_s.values())
    total, waiting = sum(world.served_s.values()) / present_s, world.waiting_s / present_s
    metres = sum(craft.flown_m for craft in world.fleet.values()) - flown
    p50, p99 = (1e3 * np.quantile(world.latency_s, q) for q in (0.5, 0.99))
    gone = sum(craft.phase is Phase.GONE for craft in world.fleet.values())
    print(
        f"{name}, seed {seed}: {count} plans for events; guaranteed rate available {total:.2%} of all device time,"
        f" {waiting:.2%} waited for since a device joined, moved or changed its demand,"
        f" {1 - total - waiting:.2%} lost after that; per device"
        f" (present for a minute or more, n={len(share)}): median {np.median(share):.2%}, p5"
        f" {np.quantile(share, 0.05):.2%}, least {share.min():.2%}; re-plan p50 {p50:.1f} ms, p99 {p99:.1f} ms;"
        f" {metres / max(count, 1):.0f} m flown and {world.interrupted / max(count, 1):.2f} interruptions an event;"
        f" {world.relieved} hand-overs to a relief, {world.critical} at the critical battery without;"
        f" {np.mean(world.uavs_s):.1f} UAVs in the air on average, {gone} crashed; least separation"
        f" {world.separation_m:.2f} m ({world.closest}); simulated in {time.perf_counter() - began:.0f} s",
        flush=True,
    )
    return total, world.separation_m


def main() -> None:
    """Run both ways through the same history; fail if aircraft came nearer to each other than they may."""
    parser = argparse.ArgumentParser(prog="scripts/bench soak", description=__doc__.split("\n\n")[0])
    parser.add_argument("--minutes", type=float, default=60.0, help="simulated (default: %(default)g)")
    parser.add_argument(
        "--warmup", type=float, default=300.0, help="for the first deployment [s] (default: %(default)g)"
    )
    parser.add_argument("--devices", type=int, default=100, help="(default: %(default)s)")
    parser.add_argument("--uavs", type=int, default=30, help="(default: %(default)s)")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1], help="an hour each (default: 1)")
    options = parser.parse_args()
    least = math.inf
    for name, scratch in (("smallest change", False), ("from scratch   ", True)):
        shares, separations = zip(*(live(name, options, seed, scratch) for seed in options.seeds), strict=True)
        least = min(least, *separations)
        print(f"{name}: available {np.mean(shares):.2%} of all device time, least separation {min(separations):.2f} m")
    if least < LIMITS.min_separation_m - 1e-6:
        raise SystemExit(f"aircraft came within {least:.2f} m; the limit is {LIMITS.min_separation_m:g} m")


if __name__ == "__main__":
    main()

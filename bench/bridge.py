"""What the bridge costs: one fleet controller with 200 vehicles, and MAVSDK's Python binding beside it in the same run.

Four processes at the same time: the bridge's fleet controller (as in the node, without DDS) and its simulated vehicles,
MAVSDK with a few vehicles of its own, which gets the same telemetry and streams targets at the same rate, and those
vehicles. CPU and memory are those of a process with its children (the bridge plans some transitions in one), shares are
of one core. The time of a goal is from `set_goal` to the first target that differs from the one before, handed to the
socket.
"""

from __future__ import annotations

import argparse
import contextlib
import cProfile
import math
import multiprocessing
import os
import pstats
import random
import socket
import sys
import time
from collections import defaultdict
from concurrent.futures import wait
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.action import Action
from mavsdk.plugins.action.action import ActionError
from mavsdk.plugins.offboard import Offboard
from mavsdk.plugins.offboard.offboard import OffboardError, PositionGlobalYaw
from mavsdk.plugins.telemetry import Telemetry
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.fleet.config import FleetConfig, LinkUrl, MapOrigin, UavConfig
from jpap_ros.fleet.transit_plan import TransitLimits
from jpap_ros.mavlink.aircraft_settings import AircraftSettings
from jpap_ros.mavlink.fleet_controller import ControllerSettings, FleetController, FleetOrder
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.mavlink.goals import Goal
from jpap_ros.mavlink.links import LinkHub
from jpap_ros.sim import SimFleet

ORIGIN = MapOrigin(-37.8136, 144.9631, 20.0)
PITCH_M = 20.0
#: No target has changed for so long: nobody is on the way any more [s].
HOVER_S = 3.0
TARGET_HZ, TELEMETRY_HZ = 10.0, 20.0
HEIGHT_M, STEP_UP_M, SHIFT_M = 50.0, 4.0, 200.0
#: Everything that may be waited for [s].
PATIENCE_S = 120.0


def free_ports(count: int) -> list[int]:
    """UDP ports below those that the system hands out by itself, as to the vehicles."""
    found: list[int] = []
    port = random.randrange(10_000, 25_000)
    while len(found) < count:
        port += 1
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, contextlib.suppress(OSError):
            probe.bind(("127.0.0.1", port))
            found.append(port)
    return found


def fleet_of(count: int, links: int) -> FleetConfig:
    """Vehicles on a square grid, shared out over links."""
    urls = [LinkUrl("udpin", "127.0.0.1", port) for port in free_ports(links)]
    columns = math.ceil(math.sqrt(count))
    pads = [(PITCH_M * (i % columns), PITCH_M * (i // columns)) for i in range(count)]
    uavs = [UavConfig(f"uav{i + 1}", i + 1, (urls[i % links],), "ardupilot", home_m=pad) for i, pad in enumerate(pads)]
    return FleetConfig(ORIGIN, tuple(uavs))


def simulate(fleets: list[FleetConfig], pipe: Connection) -> None:
    """Child: fly all vehicles; `even` brings each to the telemetry rate, `count` answers messages sent so far."""
    with contextlib.ExitStack() as stack:
        sims = [stack.enter_context(SimFleet(fleet, speedup=2.0)) for fleet in fleets]
        pipe.send("up")
        while (order := pipe.recv()) != "stop":
            if order == "even":
                for vehicle in (vehicle for sim in sims for vehicle in sim):
                    with vehicle.lock:
                        for channel in vehicle.channels:
                            rates = (channel.interval(i) for i in range(400) if i != mavlink.MAVLINK_MSG_ID_ATTITUDE)
                            known = sum(1.0 / interval for interval in rates if interval)
                            missing = 1.0 / max(TELEMETRY_HZ - known, 0.1)
                            channel.set_interval(mavlink.MAVLINK_MSG_ID_ATTITUDE, missing, time.monotonic())
            pipe.send(([sum(c.sent for v in sim for c in v.channels) for sim in sims], cpu_s(), time.monotonic()))


def family() -> list[Path]:
    """Entries in /proc of this process and its children."""
    own = Path("/proc/self")
    children = [child for task in own.glob("task/*/children") for child in task.read_text().split()]
    return [own, *(Path("/proc") / child for child in children)]


def cpu_s() -> float:
    """CPU time of this process and its children [s]."""
    ticks = 0
    for process in family():
        # After the name, which may hold spaces: utime and stime are fields 14 and 15 of proc(5)'s stat.
        fields = (process / "stat").read_text().rpartition(")")[2].split()
        ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK")


def peak_mib() -> float:
    """Most memory that this process and its children ever had [MiB]; together no more than this sum."""
    lines = [line for process in family() for line in (process / "status").read_text().splitlines()]
    return sum(int(line.split()[1]) for line in lines if line.startswith("VmHWM:")) / 1024


class Wire:
    """When each target that differs from the one before was handed to a socket, by system id."""

    def __init__(self) -> None:
        self.changes: dict[int, list[float]] = defaultdict(list)
        self.last_at: dict[int, float] = {}
        self.gaps: list[float] = []
        self._last: dict[int, tuple[Any, ...]] = {}
        original = LinkHub.send

        def send(hub: LinkHub, link: Any, message: Any, peer: Any = None) -> bool:
            sent = original(hub, link, message, peer)
            if message.get_msgId() == mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT:
                self._note(message)
            return sent

        LinkHub.send = send  # type: ignore[method-assign]

    def _note(self, message: Any) -> None:
        now, sysid = time.monotonic(), message.target_system
        target = message.lat_int, message.lon_int, message.alt, message.type_mask
        if sysid in self.last_at:
            self.gaps.append(now - self.last_at[sysid])
        self.last_at[sysid] = now
        if target != self._last.get(sysid):
            self._last[sysid] = target
            self.changes[sysid].append(now)

    def wait_for_hover(self) -> None:
        """Wait until no target has changed for a while."""
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < max(max(at) for at in self.changes.values()) + HOVER_S:
            if time.monotonic() > deadline:
                raise TimeoutError("targets keep moving")
            time.sleep(0.1)

    def first_change(self, sysid: int, after: float) -> float:
        """When the target first differed after a moment; waits for it."""
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            at = next((at for at in list(self.changes[sysid]) if at >= after), None)
            if at is not None:
                return at
            time.sleep(0.01)
        raise TimeoutError(f"no new target for system {sysid}")


def percentiles(values: list[float]) -> str:
    p50, p99 = (1e3 * float(np.percentile(values, q)) for q in (50, 99))
    return f"p50 {p50:.1f} ms, p99 {p99:.1f} ms, worst {1e3 * max(values):.1f} ms"


def serve(fleet: FleetConfig, traffic: bool, seconds: float, profile: bool, pipe: Connection) -> None:
    """Child: the bridge's controller; prints its figures and sends its CPU share."""
    settings = ControllerSettings(
        aircraft=AircraftSettings(
            setpoint_rate_hz=TARGET_HZ, takeoff_height_m=HEIGHT_M, ready_timeout_s=60.0, simulated_clock=True
        ),
        launch_stagger_s=0.0,
        traffic=TransitLimits(tracking_error_m=2.0, max_altitude_m=120.0) if traffic else None,
    )
    wire = Wire()
    snapshots: dict[str, Any] = {}
    controller = FleetController(fleet, settings, lambda snapshot: snapshots.update({snapshot.name: snapshot}))
    # CPU time: what other processes take is not the bridge's.
    profiler = cProfile.Profile(time.thread_time)
    if profile:
        run = controller._run
        controller._thread._target = lambda: profiler.runcall(run)  # type: ignore[attr-defined]

    def until_settled(what: str) -> float:
        start = time.monotonic()
        while not all(snapshots[n].goal_state.name == "REACHED" for n in fleet.names):
            if time.monotonic() > start + PATIENCE_S:
                missing = [(n, snapshots[n].goal_state.name, snapshots[n].goal_reason) for n in fleet.names]
                bad = [m for m in missing if m[1] != "REACHED"]
                raise TimeoutError(f"{what}: {len(bad)} of {len(fleet.names)} not there: {bad[:3]}")
            time.sleep(0.1)
        wire.wait_for_hover()
        return time.monotonic() - start

    def share(what: str, run_s: float) -> float:
        pipe.recv()
        start, cpu = time.monotonic(), cpu_s()
        wire.gaps.clear()
        time.sleep(run_s)
        used = (cpu_s() - cpu) / (time.monotonic() - start)
        print(f"  {what}: {100 * used:.1f} % of a core; targets to one vehicle apart: {percentiles(wire.gaps)}")
        pipe.send(used)
        return used

    label = f"bridge, {len(fleet.names)} vehicles, traffic control {'on' if traffic else 'off'}"
    print(label, flush=True)
    with controller:
        futures = controller.order(FleetOrder.LAUNCH, list(fleet.names))
        wait(futures.values(), PATIENCE_S)
        refused = [f"{n}: {f.result().message}" for n, f in futures.items() if not f.done() or not f.result().success]
        if refused:
            raise RuntimeError(f"{len(refused)} launches failed, first {refused[0]}")
        goals = {u.name: Goal(*(u.home_m or (0.0, 0.0)), HEIGHT_M) for u in fleet.uavs}
        for name, goal in goals.items():
            controller.set_goal(name, goal)
        until_settled("first goals")
        pipe.send("even")
        share("all hover at their goals", seconds)

        generator, delays = random.Random(1), []
        sysids = {u.name: u.sysid for u in fleet.uavs}
        for name in generator.sample(fleet.names, min(100, len(fleet.names))):
            goal = goals[name] = Goal(goals[name].east_m, goals[name].north_m, HEIGHT_M + STEP_UP_M)
            given = time.monotonic()
            controller.set_goal(name, goal)
            delays.append(wire.first_change(sysids[name], given) - given)
        print(f"  one goal after another, {len(delays)} of them: {percentiles(delays)}", flush=True)
        until_settled("single goals")

        def plan_for_all(what: str) -> None:
            given = time.monotonic()
            for name, goal in goals.items():
                controller.set_goal(name, goal)
            handed = time.monotonic() - given
            delays = [wire.first_change(sysid, given) - given for sysid in sysids.values()]
            print(f"  {what} (given within {1e3 * handed:.1f} ms): {percentiles(delays)}", flush=True)

        goals = {name: Goal(goal.east_m, goal.north_m + SHIFT_M, HEIGHT_M) for name, goal in goals.items()}
        plan_for_all("a plan for all")
        pipe.send("even")
        share("all on their way", min(seconds, 10.0))
        until_settled("plan for all")

        pairs = list(zip(fleet.names[::2], fleet.names[1::2], strict=False))
        goals |= {one: goals[other] for pair in pairs for one, other in (pair, pair[::-1])}
        plan_for_all("all exchange places in pairs")
        until_settled("exchange")
        print(f"  peak memory {peak_mib():.0f} MiB", flush=True)
    if profile:
        pstats.Stats(profiler).sort_stats("tottime").print_stats(25)


def stream_by_mavsdk(fleet: FleetConfig, seconds: float, pipe: Connection) -> None:
    """Child: MAVSDK does the same for a few vehicles, through its API."""
    # Its library tells every step on the standard error; what fails here is still told there.
    sys.stderr = os.fdopen(os.dup(2), "w")
    with Path(os.devnull).open("w") as nowhere:
        os.dup2(nowhere.fileno(), 2)
    client = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    (port,) = {uav.urls[0].port for uav in fleet.uavs}
    client.add_any_connection(f"udpin://127.0.0.1:{port}")

    def until(condition: Any) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            if time.monotonic() > deadline:
                raise TimeoutError("MAVSDK waited in vain")
            time.sleep(0.1)

    def succeeds(call: Any) -> bool:
        try:
            call()
        except (ActionError, OffboardError):
            return False
        return True

    until(lambda: len(client.get_systems()) == len(fleet.uavs))
    systems = client.get_systems()
    telemetry = [Telemetry(system) for system in systems]
    offboard = [Offboard(system) for system in systems]
    frame = LocalFrame(ORIGIN)
    for system in systems:
        action = Action(system)
        action.set_takeoff_altitude(HEIGHT_M)
        until(lambda action=action: succeeds(action.arm))
        until(lambda action=action: succeeds(action.takeoff))
    for one in telemetry:
        # ArduPilot streams only what it is asked for.
        one.set_rate_position(4.0)
        until(lambda one=one: one.position().relative_altitude_m > HEIGHT_M - 1.0)
    lat, lon = frame.to_geodetic(0.0, SHIFT_M)

    def send(height_m: float) -> None:
        setpoint = PositionGlobalYaw(lat, lon, height_m, 0.0, PositionGlobalYaw.AltitudeType.REL_HOME)
        for one in offboard:
            one.set_position_global(setpoint)

    send(HEIGHT_M)
    for one in offboard:
        until(lambda one=one: succeeds(one.start))
    pipe.send("even")
    while not pipe.poll():
        # The stream must not end while the bridge gets ready.
        send(HEIGHT_M)
        time.sleep(1 / TARGET_HZ)
    pipe.recv()
    start, cpu, sent = time.monotonic(), cpu_s(), 0
    while time.monotonic() - start < seconds:
        # A new target each time, as when it moves.
        send(HEIGHT_M + 0.01 * (sent % 2))
        sent += 1
        time.sleep(max(0.0, start + sent / TARGET_HZ - time.monotonic()))
    pipe.send((cpu_s() - cpu) / (time.monotonic() - start))
    client.destroy()


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="scripts/bench bridge", description=__doc__.split("\n\n")[0])
    parser.add_argument("--vehicles", type=int, default=200)
    parser.add_argument("--links", type=int, default=200, help="UDP ports that the bridge's vehicles share")
    parser.add_argument("--mavsdk-vehicles", type=int, default=4, help="0: without MAVSDK")
    parser.add_argument("--seconds", type=float, default=15.0, help="of each measurement [s]")
    parser.add_argument("--traffic", choices=["on", "off", "both"], default="both")
    parser.add_argument("--profile", action="store_true", help="profile the bridge's I/O thread; costs CPU itself")
    args = parser.parse_args()
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}", flush=True)
    context = multiprocessing.get_context("spawn")
    for traffic in {"both": [False, True], "on": [True], "off": [False]}[args.traffic]:
        with contextlib.ExitStack() as stack:
            fleet = fleet_of(args.vehicles, min(args.links, args.vehicles))
            bridge = stack.enter_context(Side(context, fleet, serve, traffic, args.seconds, args.profile))
            sides = [bridge]
            if args.mavsdk_vehicles:
                fleet = fleet_of(args.mavsdk_vehicles, 1)
                sides.append(stack.enter_context(Side(context, fleet, stream_by_mavsdk, args.seconds)))
            shares = measure(sides)
            if args.mavsdk_vehicles:
                ours, theirs = (100 * share / len(side.names) for share, side in zip(shares, sides, strict=True))
                print(
                    f"  at the same time MAVSDK, {args.mavsdk_vehicles} vehicles: {100 * shares[1]:.1f} % of a core; "
                    f"a vehicle: bridge {ours:.3f} %, MAVSDK {theirs:.3f} %, ratio {theirs / ours:.1f}",
                    flush=True,
                )
            measure([bridge])
            bridge.finish()


class Side:
    """A client in a process of its own, and its vehicles in another."""

    def __init__(self, context: Any, fleet: FleetConfig, job: Any, *arguments: Any) -> None:
        self.names = fleet.names
        self.sim, sim_far = context.Pipe()
        self.client, client_far = context.Pipe()
        self._vehicles = context.Process(target=simulate, args=([fleet], sim_far), daemon=True)
        self._vehicles.start()
        self.sim.recv()
        self._job = context.Process(target=job, args=(fleet, *arguments, client_far), daemon=True)
        self._job.start()
        client_far.close()

    def ask_vehicles(self, order: str) -> Any:
        self.sim.send(order)
        return self.sim.recv()

    def finish(self) -> None:
        """Wait until the client has told all its figures."""
        self._job.join()

    def __enter__(self) -> Side:
        return self

    def __exit__(self, *_: object) -> None:
        for process in (self._job, self._vehicles):
            process.terminate()
            process.join()


def measure(sides: list[Side]) -> list[float]:
    """Let clients measure their share of a core at the same time, each with even telemetry."""
    try:
        for side in sides:
            side.client.recv()
        for side in sides:
            side.ask_vehicles("even")
        before = [side.ask_vehicles("count") for side in sides]
        for side in sides:
            side.client.send("go")
        shares = [side.client.recv() for side in sides]
    except EOFError:
        raise SystemExit("a client failed") from None
    for side, ((sent,), cpu, start) in zip(sides, before, strict=True):
        (sent_now,), cpu_now, end = side.ask_vehicles("count")
        print(
            f"    (telemetry {(sent_now - sent) / (end - start) / len(side.names):.1f} messages/s of each of "
            f"{len(side.names)}; the vehicles themselves {100 * (cpu_now - cpu) / (end - start):.0f} % of a core)",
            flush=True,
        )
    return shares


if __name__ == "__main__":
    main()

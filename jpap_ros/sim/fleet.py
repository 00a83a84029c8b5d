"""All simulated vehicles of a fleet file, in one thread."""

from __future__ import annotations

import heapq
import itertools
import math
import selectors
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from types import TracebackType
from typing import Any

import numpy as np
from scipy.spatial.distance import pdist

from jpap_ros.fleet.config import FleetConfig, LinkUrl, UavConfig
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.mavlink.signing import SigningError, SigningKey
from jpap_ros.sim.ardupilot import ArduPilotVehicle
from jpap_ros.sim.channel import Channel
from jpap_ros.sim.dynamics import MAX_STEP_S
from jpap_ros.sim.faults import fate
from jpap_ros.sim.options import VehicleOptions
from jpap_ros.sim.px4 import Px4Vehicle
from jpap_ros.sim.transport import Port, SimError, open_port
from jpap_ros.sim.vehicle import SimVehicle

PERSONALITIES: dict[str, type[SimVehicle]] = {"ardupilot": ArduPilotVehicle, "px4": Px4Vehicle}

#: Messages go out at this rhythm, so none is sent more often than 25 times a second.
TICK_S = 0.04
MAX_SPEEDUP = 100.0
GRID_M = 10.0
#: Lower than this a vehicle is on or near its pad, where it may stand beside others [m].
AIRBORNE_M = 2.0
#: A process that was stopped for longer does not make up for it [s].
_LONGEST_TICK_S = 0.5


@dataclass
class _Station:
    """A port with the vehicles that use it, by system id."""

    port: Port
    members: dict[int, tuple[SimVehicle, Channel]] = field(default_factory=dict)


class SimFleet:
    """Simulated vehicles, each a MAVLink endpoint at the far end of its url.

    Use it as a context manager, which runs it in a thread of its own, or call `pump` again and again.

    Parameters
    ----------
    config : FleetConfig
    speedup : float
        Simulated seconds per second, for flight, battery and GPS start-up. Message rates and all time-outs between
        the vehicle and its peers stay on the wall clock.
    seed : int
        Of everything random: faults of the links and the phases of messages.
    options : VehicleOptions or mapping of str to VehicleOptions
        For all vehicles, or by name (others get the defaults).

    Raises
    ------
    SimError
        If a url cannot be served; names the vehicle, the url and the reason.
    ValueError
        If an argument is wrong.
    """

    def __init__(
        self,
        config: FleetConfig,
        *,
        speedup: float = 1.0,
        seed: int = 0,
        options: VehicleOptions | Mapping[str, VehicleOptions] | None = None,
    ) -> None:
        if not 0.0 < speedup <= MAX_SPEEDUP:
            raise ValueError(f"speedup must be above 0 and at most {MAX_SPEEDUP:g}, got {speedup!r}")
        by_name = options if isinstance(options, Mapping) else {name: options for name in config.names if options}
        for name in by_name:
            if name not in config.names:
                raise ValueError(f"options name {name!r}, which is not in the fleet: {', '.join(config.names)}")
        self.speedup = speedup
        #: Least distance in space that two vehicles higher than `AIRBORNE_M` ever had [m].
        self.least_separation_m = math.inf
        self.config = config
        self.lock = threading.RLock()
        self._selector = selectors.DefaultSelector()
        self._stations: dict[Port, _Station] = {}
        self._later: list[tuple[float, int, Callable[[float], None]]] = []
        self._order = itertools.count()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._last_tick: float | None = None
        self._next_tick = 0.0
        frame = LocalFrame(config.origin)
        columns = math.ceil(math.sqrt(len(config.uavs)))
        self.vehicles: dict[str, SimVehicle] = {}
        shared: dict[LinkUrl, _Station] = {}
        try:
            for i, uav in enumerate(config.uavs):
                start = uav.home_m or (GRID_M * (i % columns), GRID_M * (i // columns))
                personality = PERSONALITIES["ardupilot" if uav.autopilot == "auto" else uav.autopilot]
                vehicle = personality(uav, frame, start, _options(uav, by_name), seed, self.lock)
                vehicle.speedup = speedup
                self.vehicles[uav.name] = vehicle
                for link_id, url in enumerate(uav.urls):
                    station = self._station(url, vehicle, shared)
                    station.members[vehicle.sysid] = (vehicle, vehicle.attach(link_id))
        except SimError:
            self.close()
            raise

    def _station(self, url: LinkUrl, vehicle: SimVehicle, shared: dict[LinkUrl, _Station]) -> _Station:
        key = vehicle.options.signing_key
        station = shared.get(url)
        if station is None:
            try:
                station = _Station(open_port(url, key))
            except SimError as error:
                raise SimError(f"{vehicle.name}: {error}") from None
            station.port.register(self._selector)
            self._stations[station.port] = station
            # Only a socket that listens has to be shared; otherwise each aircraft speaks from an address of its own.
            if url.kind != "udpin":
                shared[url] = station
        elif station.port.signing_key != key:
            raise SimError(f"{vehicle.name}: {url}: vehicles that share a link must share the signing key")
        return station

    def __getitem__(self, name: str) -> SimVehicle:
        return self.vehicles[name]

    def __iter__(self) -> Iterator[SimVehicle]:
        return iter(self.vehicles.values())

    def __enter__(self) -> SimFleet:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def rejected(self) -> int:
        """Frames dropped for a bad checksum or signature, on all links."""
        return sum(station.port.rejected for station in self._stations.values())

    def start(self) -> None:
        """Run in a thread until `close`."""
        if self._thread is not None:
            return
        self._thread = threading.Thread(target=self._run, name="simulated vehicles", daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether the thread started by `start` works; it ends early only by a defect, with a traceback."""
        return self._thread is not None and self._thread.is_alive()

    def close(self) -> None:
        """Stop, and close all sockets."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        for station in self._stations.values():
            station.port.close()
        self._stations.clear()
        self._selector.close()

    def _run(self) -> None:
        while not self._stop.is_set():
            self.pump(TICK_S)

    def pump(self, timeout: float) -> None:
        """Serve the sockets and let time pass, for at most `timeout` seconds or until the next step is done."""
        now = time.monotonic()
        wait = min(timeout, max(0.0, self._next_tick - now))
        for key, _ in self._selector.select(wait):
            port, read = key.data
            self._take(port, read())
        now = time.monotonic()
        if now >= self._next_tick:
            self._next_tick = max(self._next_tick + TICK_S, now)
            with self.lock:
                self._step(now)

    def _take(self, port: Port, messages: Iterator[Any]) -> None:
        station = self._stations[port]
        now = time.monotonic()
        with self.lock:
            for message in messages:
                target = getattr(message, "target_system", 0)
                if target == 0:
                    members = list(station.members.values())
                else:
                    members = [station.members[target]] if target in station.members else []
                for vehicle, channel in members:
                    self._deliver(vehicle, channel, message, now)
            for vehicle, channel in station.members.values():
                self._flush(station.port, vehicle, channel, now)

    def _deliver(self, vehicle: SimVehicle, channel: Channel, message: Any, now: float) -> None:
        if vehicle.link_faults.clean:
            vehicle.receive(message, channel, now)
            return
        for delay in fate(vehicle.link_faults, vehicle.random):
            self._at(now + delay, partial(vehicle.receive, message, channel))

    def _flush(self, port: Port, vehicle: SimVehicle, channel: Channel, now: float) -> None:
        frames = channel.take()
        if not frames or vehicle.silent:
            return
        if vehicle.link_faults.clean:
            port.send(b"".join(frames))
            return
        for frame in frames:
            for delay in fate(vehicle.link_faults, vehicle.random):
                self._at(now + delay, partial(_send, port, frame))

    def _at(self, when: float, action: Callable[[float], None]) -> None:
        heapq.heappush(self._later, (when, next(self._order), action))

    def _step(self, now: float) -> None:
        elapsed = 0.0 if self._last_tick is None else min(now - self._last_tick, _LONGEST_TICK_S)
        self._last_tick = now
        simulated = elapsed * self.speedup
        steps = math.ceil(simulated / MAX_STEP_S)
        while self._later and self._later[0][0] <= now:
            heapq.heappop(self._later)[2](now)
        for vehicle in self.vehicles.values():
            for _ in range(steps):
                vehicle.advance(simulated / steps)
            vehicle.tick(now)
        self._watch_separation()
        for station in self._stations.values():
            for vehicle, channel in station.members.values():
                self._flush(station.port, vehicle, channel, now)

    def _watch_separation(self) -> None:
        flying = [v.position for v in self.vehicles.values() if v.position[2] > AIRBORNE_M and not v.crashed]
        if len(flying) > 1:
            self.least_separation_m = min(self.least_separation_m, float(pdist(np.array(flying)).min()))


def _options(uav: UavConfig, by_name: Mapping[str, VehicleOptions]) -> VehicleOptions:
    options = by_name.get(uav.name, VehicleOptions())
    if options.signing_key is None and uav.signing_key_file is not None:
        try:
            return options.but(signing_key=SigningKey.load(uav.signing_key_file).secret)
        except SigningError as error:
            raise SimError(f"{uav.name}: {error}") from None
    return options


def _send(port: Port, frame: bytes, now: float) -> None:
    port.send(frame)

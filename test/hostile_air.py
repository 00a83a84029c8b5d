"""A fleet in the air, and hostile frames that reach the bridge from the aircraft's own addresses.

Three simulated ArduCopters fly behind taps: UDP sockets that pass on what comes, keep it, and put frames of an attacker
between. `flying` is on its way to a goal, `taken` was taken over by its pilot, and `signed` flies to a goal on a link
with a key. What leaves the bridge is read at the taps.

What must change nothing, whatever its content (`harmless`, `unsigned`):

- noise, and frames whose checksum is wrong. Up to three flipped bits outside start, length, flags and message id are
  always found by the CRC, so that even the autopilot's own frames may be damaged so;
- frames of anybody but the aircraft's autopilot: its other components, other aircraft, ground stations, the bridge;
- frames in the autopilot's own name that tell nothing of its state;
- on the link with a key: everything that is not signed with it, and what was said before.

The rest is what an autopilot tells of itself (`TELLING`), and has to be believed: a forged HEARTBEAT in LOITER cannot
be told from a pilot who takes over. Such frames may make the bridge do less (yield, hold), and never more.
"""

from __future__ import annotations

import random
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from fleet_rig import Rig, order
from mavlink_frames import frame_v2, heartbeat, signature_block
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from udp_wire import UdpWire

from jpap_ros.fleet.config import LinkUrl
from jpap_ros.mavlink.aircraft_settings import AircraftSettings
from jpap_ros.mavlink.fleet_controller import ControllerSettings, FleetController, FleetOrder
from jpap_ros.mavlink.goals import Goal, GoalState
from jpap_ros.sim import VehicleOptions

NAMES = ("flying", "taken", "signed")
GOALS = {"flying": Goal(2000.0, 0.0, 40.0), "taken": Goal(2000.0, 50.0, 40.0), "signed": Goal(2000.0, 100.0, 40.0)}
KEY, OTHER_KEY = bytes(range(32)), bytes(32)
LOITER = 5
PATIENCE_S = 60.0
#: System and component id of frames that show how far the bridge has come.
MARK = 99
#: Frames to one aircraft before the bridge is waited for.
BATCH = 50
KINDS = sorted(mavlink.mavlink_map.items())
#: What the bridge is to believe of an autopilot: everything about its state, its clock, its place and its target.
TELLING = {
    id_
    for id_, kind in KINDS
    if "time_boot_ms" in kind.fieldnames
    or kind.msgname
    in ("HEARTBEAT", "SYS_STATUS", "EXTENDED_SYS_STATE", "BATTERY_STATUS", "HOME_POSITION", "GPS_RAW_INT")
}
QUESTIONS = (mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_REQUEST_MESSAGE)
FLOWN = {GoalState.SENT, GoalState.ACCEPTED, GoalState.EN_ROUTE, GoalState.REACHED}
TARGET = "SET_POSITION_TARGET_GLOBAL_INT"


class Tap(UdpWire):
    """Passes on and keeps what goes between an aircraft and the bridge, and sends frames in the aircraft's place.

    Attributes
    ----------
    said : deque of bytes
        The last frames of the aircraft.
    targets : list of message
        Position targets that came from the bridge.
    beats : int
        Heartbeats that came from there.
    others : list of message
        What else came from there but heartbeats and questions for telemetry.
    """

    def __init__(self, vehicle_sends_to: int, bridge_listens_on: int) -> None:
        super().__init__(vehicle_sends_to, bridge_listens_on)
        self.said: deque[bytes] = deque(maxlen=200)
        self.beats = 0
        self.targets: list[Any] = []
        self.others: list[Any] = []
        self.port = bridge_listens_on
        self._parser = mavlink.MAVLink(None)

    def inject(self, frame: bytes) -> None:
        self._bridge_end.send(frame)

    def from_vehicle(self, data: bytes) -> bool:
        self.said.extend(frames_of(data))
        return True

    def from_bridge(self, data: bytes, heard: bool) -> bool:
        for message in self._parser.parse_buffer(data) or ():
            self._note(message)
        return True

    def _note(self, message: Any) -> None:
        kind = message.get_type()
        question = kind == "REQUEST_DATA_STREAM" or (kind.startswith("COMMAND_") and message.command in QUESTIONS)
        self.beats += kind == "HEARTBEAT"
        if kind == TARGET:
            self.targets.append(message)
        elif kind != "HEARTBEAT" and not question:
            self.others.append(message)


def frames_of(datagram: bytes) -> Iterator[bytes]:
    """The MAVLink 2 frames of a datagram: 10 bytes of header, 2 of checksum, and 13 of signature where there is one."""
    while datagram:
        size = 12 + datagram[1] + 13 * (datagram[2] & 1)
        yield datagram[:size]
        datagram = datagram[size:]


class Attacker:
    """Makes frames, the same ones for a seed but for what the aircraft themselves said."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)

    def harmless(self, sysid: int, said: deque[bytes]) -> bytes:
        """A frame that must change nothing on the link of an aircraft; see the module."""
        kind = self.random.randrange(5)
        if kind == 0:
            return b"\xfd" + self.random.randbytes(self.random.randrange(60))
        if kind == 1:
            return self.damaged(self.random.choice(said))
        if kind == 2:
            return self.damaged(self.any_message(sysid, 1, TELLING))
        if kind == 3:
            others = [(sysid, 154), (sysid, 191), (sysid, 0), (sysid % 3 + 1, 1), (245, 191), (255, 190)]
            return self.any_message(*self.random.choice(others))
        return self.any_message(sysid, 1, {id_ for id_, _ in KINDS} - TELLING)

    def unsigned(self, sysid: int, said: deque[bytes]) -> bytes:
        """A frame that must change nothing on a link with a key."""
        kind = self.random.randrange(4)
        if kind == 0:
            return self.damaged(self.random.choice(said))
        if kind == 1:
            return said[0]
        if kind == 2:
            return self.any_message(sysid, 1, TELLING)
        frame = self.any_message(sysid, 1, TELLING, flags=1)
        return frame + signature_block(frame, OTHER_KEY, 0, (1 << 47) + self.random.randrange(1 << 40))

    def any_message(self, sysid: int, component: int, ids: set[int] | None = None, flags: int = 0) -> bytes:
        """A message of the dialect with a random payload, or with zeros or ones alone, and a right checksum."""
        id_, kind = self.random.choice(KINDS if ids is None else [entry for entry in KINDS if entry[0] in ids])
        size = kind.unpacker.size
        noise = self.random.randbytes(size)
        payload = self.random.choice([noise, noise, bytes(size), b"\xff" * size])
        return frame_v2(id_, kind.crc_extra, payload, sysid, component, self.random.randrange(256), flags)

    def damaged(self, frame: bytes) -> bytes:
        """A frame with up to three bits flipped, none of them in start, length, flags or message id."""
        damaged = bytearray(frame)
        places = [at for at in range(3, 10 + frame[1] + 2) if at not in (7, 8, 9)]
        for at in self.random.sample(places, self.random.randint(1, 3)):
            damaged[at] ^= 1 << self.random.randrange(8)
        return bytes(damaged)


class HostileAir:
    """The fleet in the air as the module says."""

    def __init__(self, rig: Rig, controller: FleetController, taps: dict[str, Tap]) -> None:
        self.rig, self.controller, self.taps = rig, controller, taps
        self.mark = 0
        self.marks_seen: dict[int, int] = {}

    def on_frame(self, url: LinkUrl, frame: bytes | bytearray) -> None:
        if frame[5] == frame[6] == MARK:
            self.marks_seen[url.port] = int.from_bytes(frame[10:14], "little")

    def settle(self) -> None:
        """Wait until the bridge has taken everything that was injected before."""
        self.mark += 1
        for tap in (self.taps["flying"], self.taps["taken"]):
            deadline = time.monotonic() + PATIENCE_S
            # Noise before it may swallow one or two.
            while self.marks_seen.get(tap.port) != self.mark:
                assert time.monotonic() < deadline, "the bridge does not take what is sent any more"
                tap.inject(heartbeat(MARK, MARK, custom_mode=self.mark))
                time.sleep(0.005)

    def catch_up(self) -> None:
        """Wait until the taps have seen all that left the bridge so far: two heartbeats later they have."""
        beats = {tap: tap.beats for tap in self.taps.values()}
        wait(lambda: all(tap.beats >= before + 2 for tap, before in beats.items()), "two heartbeats of the bridge")

    def attack(self, frames: int, make: Callable[[str], bytes], names: tuple[str, ...] = NAMES) -> None:
        """Send so many frames, to the aircraft in turn."""
        for number in range(frames):
            name = names[number % len(names)]
            self.taps[name].inject(make(name))
            if number % (BATCH * len(names)) == 0:
                self.settle()
        self.settle()
        self.catch_up()

    def assert_goals_alone_are_flown(self) -> None:
        """Nothing left but the goals' own targets, for those that fly to one."""
        assert self.controller.failure is None, self.controller.failure
        for name, tap in self.taps.items():
            assert tap.others == [], f"{name} was sent {tap.others}"
            places = {(m.lat_int, m.lon_int, m.alt, m.type_mask, m.target_system) for m in tap.targets}
            assert places <= ({self.places[name]} if name != "taken" else set()), f"{name} was sent to {places}"
            lives = {(s.goal_state, s.goal_reason) for s in self.rig.watch.history[name][self.seen[name] :]}
            allowed = {GoalState.YIELDED} if name == "taken" else FLOWN
            assert {state for state, _ in lives} <= allowed, f"{name}: {lives}"

    def begin(self) -> None:
        """Look at what leaves from here on."""
        self.catch_up()
        self.seen = {name: max(0, len(history) - 1) for name, history in self.rig.watch.history.items()}
        self.places = {
            name: (m.lat_int, m.lon_int, m.alt, m.type_mask, m.target_system)
            for name, tap in self.taps.items()
            for m in tap.targets[-1:]
        }
        for tap in self.taps.values():
            tap.targets.clear()
            tap.others.clear()


def wait(condition: Callable[[], object], what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, f"waited in vain for {what}"
        time.sleep(0.001)


@contextmanager
def hostile_air(free_ports: Callable[[int], list[int]], folder: Path) -> Iterator[HostileAir]:
    """Bring the fleet into the air."""
    (folder / "fleet.key").write_text(KEY.hex())
    (folder / "fleet.key").chmod(0o600)
    with ExitStack() as stack:
        rig = Rig(stack, free_ports)
        ports = iter(free_ports(2 * len(NAMES)))
        fleet = rig.mixed(**{name: {"autopilot": "ardupilot"} for name in NAMES})
        taps, inside, outside = {}, [], []
        for uav in fleet.uavs:
            bridge, vehicle = next(ports), next(ports)
            key = folder / "fleet.key" if uav.name == "signed" else None
            taps[uav.name] = stack.enter_context(Tap(vehicle, bridge))
            inside.append(replace(uav, urls=(LinkUrl("udpin", "127.0.0.1", bridge),), signing_key_file=key))
            outside.append(replace(uav, urls=(LinkUrl("udpin", "127.0.0.1", vehicle),), signing_key_file=key))
        # A million frames take longer than a battery lasts.
        sim = rig.fly(replace(fleet, uavs=tuple(outside)), VehicleOptions(endurance_s=1e6))
        settings = ControllerSettings(aircraft=AircraftSettings(), launch_stagger_s=0.0)
        air = HostileAir(rig, None, taps)
        air.controller = stack.enter_context(
            FleetController(replace(fleet, uavs=tuple(inside)), settings, rig.watch, on_frame=air.on_frame)
        )
        results = order(air.controller, FleetOrder.LAUNCH, NAMES)
        assert all(result.success for result in results.values()), results
        for name, goal in GOALS.items():
            air.controller.set_goal(name, goal)
            rig.watch.until_goal(name, GoalState.EN_ROUTE)
        sim["taken"].pilot_takes("LOITER")
        rig.watch.until_goal("taken", GoalState.YIELDED)
        air.begin()
        yield air


def attack(air: HostileAir, frames: int, seed: int = 7) -> None:
    """Attack a fleet in the air; raises AssertionError if anything leaves the bridge that must not."""
    attacker = Attacker(seed)
    sysids = {name: i for i, name in enumerate(NAMES, 1)}

    def nothing_new(name: str) -> bytes:
        make = attacker.unsigned if name == "signed" else attacker.harmless
        return make(sysids[name], air.taps[name].said)

    air.attack(frames * 3 // 4, nothing_new)
    air.assert_goals_alone_are_flown()
    for name in ("flying", "signed"):
        flown = len(air.taps[name].targets)
        wait(lambda tap=air.taps[name], flown=flown: len(tap.targets) > flown + 5, f"more targets for {name}")
    air.assert_goals_alone_are_flown()
    wait(lambda: all(report.bad_frames for report in air.controller.link_reports), "the count of damaged frames")
    signed = air.controller.link_reports[NAMES.index("signed")]
    assert signed.unsigned and signed.badly_signed and signed.replayed, f"not all kinds came: {signed}"

    # The other half of the rule: a mode that the bridge did not ask for is a takeover.
    air.taps["flying"].inject(heartbeat(sysids["flying"], custom_mode=LOITER))
    air.rig.watch.until_goal("flying", GoalState.YIELDED)
    air.settle()
    air.begin()
    air.attack(frames // 4, lambda name: attacker.any_message(sysids[name], 1, TELLING), ("flying", "taken"))
    for name in ("flying", "taken"):
        tap = air.taps[name]
        assert tap.others == [] and not tap.targets, f"{name} was sent {tap.others}, {tap.targets}"
    assert air.controller.failure is None, air.controller.failure

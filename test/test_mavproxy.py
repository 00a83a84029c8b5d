"""MAVProxy, a real ground station, beside the bridge on the same links.

Oracle: what MAVProxy itself prints, and what reached the simulated vehicles, which the bridge does not see.
"""

from __future__ import annotations

import os
import pty
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from jpap_ros.fleet.config import FleetConfig, parse_fleet
from jpap_ros.mavlink.fleet_controller import ControllerSettings, FleetController, FleetOrder
from jpap_ros.mavlink.goals import Goal, GoalState
from jpap_ros.mavlink.snapshot import AircraftSnapshot
from jpap_ros.sim import SimFleet, SimVehicle

PATIENCE_S = 60.0
FLEET = """
version: 1
origin: {{latitude: -37.8136, longitude: 144.9631, altitude_amsl_m: 20}}
gcs_urls: ["udpin:127.0.0.1:{0}"]
uavs:
  - {{name: a, sysid: 1, url: "udpin:127.0.0.1:{1}", autopilot: ardupilot, home_m: [0, 0]}}
  - {{name: b, sysid: 2, url: "tcp:127.0.0.1:{2}", autopilot: ardupilot, home_m: [20, 0]}}
"""


class MavProxy:
    """MAVProxy as a process, typed at through a pseudo-terminal."""

    def __init__(self, port: int, folder: Path) -> None:
        self._keyboard, terminal = pty.openpty()
        self._lines: list[str] = []
        self._process = subprocess.Popen(
            [
                sys.executable,
                "-u",
                str(Path(sys.executable).with_name("mavproxy.py")),
                f"--master=udpout:127.0.0.1:{port}",
                "--force-connected",
                "--default-modules=mode",
                f"--state-basedir={folder}",
            ],
            cwd=folder,
            env={**os.environ, "HOME": str(folder), "TERM": "dumb"},
            stdin=terminal,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        os.close(terminal)
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        self._lines.extend(self._process.stdout)

    def type(self, line: str) -> None:
        os.write(self._keyboard, f"{line}\n".encode())

    def until(self, words: str) -> None:
        """Wait until MAVProxy prints something."""
        wait(lambda: words in "".join(self._lines), lambda: f"MAVProxy never said {words!r}: {self._lines}")

    def close(self) -> None:
        self._process.kill()
        self._process.wait()
        self._reader.join()
        self._process.stdout.close()
        os.close(self._keyboard)


def wait(condition: Callable[[], object], complaint: Callable[[], str]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, complaint()
        time.sleep(0.05)


def targets(vehicle: SimVehicle) -> int:
    with vehicle.lock:
        return sum(r.kind == "SET_POSITION_TARGET_GLOBAL_INT" for r in vehicle.received)


@pytest.fixture
def fleet(free_ports: Callable[[int], list[int]]) -> FleetConfig:
    return parse_fleet(FLEET.format(*free_ports(3)))


@pytest.fixture
def snapshots() -> dict[str, AircraftSnapshot]:
    return {}


@pytest.fixture
def sim(fleet: FleetConfig) -> Iterator[SimFleet]:
    with SimFleet(fleet, speedup=10.0) as sim:
        yield sim


@pytest.fixture
def bridge(fleet: FleetConfig, sim: SimFleet, snapshots: dict[str, AircraftSnapshot]) -> Iterator[FleetController]:
    with FleetController(fleet, ControllerSettings(), lambda s: snapshots.update({s.name: s})) as controller:
        yield controller


@pytest.fixture
def mavproxy(fleet: FleetConfig, bridge: FleetController, tmp_path: Path) -> Iterator[MavProxy]:
    proxy = MavProxy(fleet.gcs_urls[0].port, tmp_path)
    yield proxy
    proxy.close()


def test_it_takes_one_vehicle_over_and_the_bridge_yields(
    bridge: FleetController, sim: SimFleet, mavproxy: MavProxy, snapshots: dict[str, AircraftSnapshot]
) -> None:
    launches = bridge.order(FleetOrder.LAUNCH, ["a", "b"])
    assert all(future.result(2 * PATIENCE_S).success for future in launches.values())
    for name, east in (("a", 5.0), ("b", 25.0)):
        bridge.set_goal(name, Goal(east, 10.0, 30.0, plan_id=1))
    wait(
        lambda: all(snapshots[name].goal_state is GoalState.REACHED for name in "ab"),
        lambda: f"goals not reached: {snapshots}",
    )
    for sysid in (1, 2):
        mavproxy.until(f"Detected vehicle {sysid}:1")
    mavproxy.type("vehicle 2")
    mavproxy.until("Set vehicle 2")
    mavproxy.type("mode LOITER")
    wait(lambda: snapshots["b"].goal_state is GoalState.YIELDED, lambda: f"not yielded: {snapshots['b']}")
    assert snapshots["b"].mode == "LOITER"
    # The other vehicle goes on being served, and nothing more is sent to the one taken over.
    seen = targets(sim["a"])
    wait(lambda: targets(sim["a"]) >= seen + 3, lambda: "vehicle a is not served any more")
    # What was under way to b when its pilot took over has arrived by now.
    last = targets(sim["b"])
    wait(lambda: targets(sim["a"]) >= seen + 10, lambda: "vehicle a is not served any more")
    assert targets(sim["b"]) == last > 0
    assert snapshots["a"].goal_state is GoalState.REACHED
    assert snapshots["a"].mode == "GUIDED"

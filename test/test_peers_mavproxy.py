"""MAVProxy as the ground station: through the bridge's forwarder it sees a vehicle and takes it over.

Oracle: MAVProxy, a ground station of its own making; and the simulated vehicle's record of who commanded it.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from fleet_rig import Watch, distinct, order, setpoints

from jpap_ros.fleet.config import FleetConfig, LinkUrl, MapOrigin, UavConfig
from jpap_ros.mavlink.aircraft_settings import AircraftSettings
from jpap_ros.mavlink.fleet_controller import ControllerSettings, FleetController, FleetOrder
from jpap_ros.mavlink.goals import Goal, GoalState
from jpap_ros.sim import SimFleet

PATIENCE_S = 60.0
GCS_SYSID = 255


class MavProxy:
    """MAVProxy on a pipe."""

    def __init__(self, master: str, folder: Path) -> None:
        self._log = folder / "mavproxy.log"
        program = Path(sys.executable).with_name("mavproxy.py")
        with self._log.open("w") as sink:
            self._process = subprocess.Popen(
                [sys.executable, str(program), f"--master={master}", f"--source-system={GCS_SYSID}", "--nowait"],
                stdin=subprocess.PIPE,
                stdout=sink,
                stderr=subprocess.STDOUT,
                cwd=folder,
                env={**os.environ, "HOME": str(folder), "TERM": "dumb", "PYTHONUNBUFFERED": "1"},
                start_new_session=True,
                text=True,
            )

    @property
    def output(self) -> str:
        return self._log.read_text(errors="replace")

    def type(self, line: str) -> None:
        """Type a line at its prompt."""
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()

    def close(self) -> None:
        os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait(PATIENCE_S)


@pytest.fixture
def fleet(free_ports: Callable[[int], list[int]]) -> FleetConfig:
    vehicle, station = free_ports(2)
    uav = UavConfig("uav1", 1, (LinkUrl("udpin", "127.0.0.1", vehicle),), "ardupilot", home_m=(0.0, 0.0))
    return FleetConfig(MapOrigin(-37.8136, 144.9631, 20.0), (uav,), gcs_urls=(LinkUrl("udpin", "127.0.0.1", station),))


@pytest.fixture
def mavproxy(fleet: FleetConfig, tmp_path: Path) -> Iterator[MavProxy]:
    station = MavProxy(f"udpout:127.0.0.1:{fleet.gcs_urls[0].port}", tmp_path)
    yield station
    station.close()


def until(condition: Callable[[], bool], what: Callable[[], str]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, f"waited in vain: {what()}"
        time.sleep(0.1)


def test_a_ground_station_takes_a_vehicle_over_and_the_bridge_yields(fleet: FleetConfig, mavproxy: MavProxy) -> None:
    watch = Watch()
    settings = ControllerSettings(aircraft=AircraftSettings())
    with SimFleet(fleet, speedup=10.0) as sim, FleetController(fleet, settings, watch) as controller:
        assert order(controller, FleetOrder.LAUNCH, ("uav1",))["uav1"].success
        controller.set_goal("uav1", Goal(2000.0, 0.0, 50.0))
        watch.until_goal("uav1", GoalState.EN_ROUTE)
        until(lambda: "GUIDED>" in mavproxy.output, lambda: mavproxy.output)

        mavproxy.type("mode BRAKE")
        yielded = watch.until_goal("uav1", GoalState.YIELDED)
        assert "BRAKE" in yielded.goal_reason
        vehicle = sim["uav1"]
        with vehicle.lock:
            who = {r.source[0] for r in vehicle.received if r.kind in ("COMMAND_LONG", "SET_MODE", "COMMAND_INT")}
            vehicle.received.clear()
        assert GCS_SYSID in who
        controller.set_goal("uav1", Goal(0.0, 100.0, 50.0))
        time.sleep(2.0)  # only to see that nothing happens
        with vehicle.lock:
            ours = [r for r in vehicle.received if r.source[0] == settings.sysid and r.kind != "HEARTBEAT"]
        assert ours == [] and setpoints(vehicle) == [] and vehicle.mode == "BRAKE"

        assert order(controller, FleetOrder.LAUNCH, ("uav1",))["uav1"].success
        watch.until_goal("uav1", GoalState.REACHED)
        # MAVProxy asks questions of its own when it pleases.
        assert [m.command for m in distinct(vehicle) if m.get_srcSystem() == settings.sysid] == [176]

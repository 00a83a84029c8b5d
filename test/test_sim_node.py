"""The sim node as a process: MAVLink on its sockets, diagnostics on DDS, clear ends."""

from __future__ import annotations

import signal
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from graph import Graph, NodeProcess
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from sim_peer import Peer

StartNode = Callable[..., NodeProcess]


@pytest.fixture
def ports(free_ports: Callable[[int], list[int]]) -> list[int]:
    return free_ports(2)


@pytest.fixture
def fleet_file(tmp_path: Path, ports: list[int]) -> Path:
    uavs = [
        {"name": "uav1", "sysid": 1, "url": f"tcp:127.0.0.1:{ports[0]}", "home_m": [100.0, -50.0]},
        {"name": "uav2", "sysid": 2, "url": f"udpout:127.0.0.1:{ports[1]}", "autopilot": "px4"},
    ]
    path = tmp_path / "fleet.yaml"
    origin = {"latitude": -37.8136, "longitude": 144.9631, "altitude_amsl_m": 20.0}
    path.write_text(yaml.safe_dump({"version": 1, "origin": origin, "uavs": uavs}))
    return path


class Reports:
    """The newest diagnostic status of each simulated vehicle."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.arrays = graph.collect(DiagnosticArray, "/diagnostics", 10)

    def until(self, uav: str, wanted: Callable[[dict[str, str], DiagnosticStatus], Any], what: str) -> None:
        """Wait until a vehicle's newest status is as wanted."""

        def newest() -> Any:
            for array in reversed(self.arrays):
                for status in array.status:
                    if status.name == f"/sim: {uav}":
                        return wanted({item.key: item.value for item in status.values}, status)
            return None

        self.graph.wait(newest, what)


def test_it_serves_every_vehicle_of_the_file_and_reports_on_each(
    graph: Graph, start_node: StartNode, fleet_file: Path, ports: list[int]
) -> None:
    """Oracle: two views of the same aircraft, its MAVLink and its diagnostics, and the home of the fleet file."""
    reports = Reports(graph)
    node = start_node("sim", {"fleet_file": str(fleet_file), "speedup": 5.0})
    reports.until("uav1", lambda v, _: (v["east_m"], v["north_m"], v["armed"]) == ("100.00", "-50.00", "false"), "home")
    with Peer.tcp(ports[0]) as one, Peer.udp(to=("127.0.0.1", ports[1])) as two:
        assert one.wait_for("HEARTBEAT", 1).autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
        assert one.command(1, mavlink.MAV_CMD_DO_SET_MODE, 1, 4) == 0
        assert one.command(1, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0
        assert one.command(1, mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 12) == 0
        reports.until("uav1", lambda v, _: v["mode"] == "GUIDED" and float(v["up_m"]) > 11.9, "uav1 in the air")
        two.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 0, 3))
        assert two.wait_for("HEARTBEAT", 2).autopilot == mavlink.MAV_AUTOPILOT_PX4
        assert two.command(2, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0
        reports.until("uav2", lambda v, _: v["armed"] == "true", "uav2 armed")
    assert node.stop(signal.SIGTERM) == 0
    assert "Traceback" not in node.output


def test_faults_strike_at_their_time(graph: Graph, start_node: StartNode, fleet_file: Path) -> None:
    reports = Reports(graph)
    faults = ["0.5 uav2 pilot POSCTL", "0.5 uav1 prearm Compass not calibrated", "1 uav2 battery 0.3"]
    node = start_node("sim", {"fleet_file": str(fleet_file), "faults": faults})
    reports.until("uav2", lambda v, _: (v["mode"], v["battery"]) == ("POSCTL", "0.30"), "uav2 in its pilot's hands")
    reports.until(
        "uav1", lambda _, s: s.level == DiagnosticStatus.WARN and s.message == "Compass not calibrated", "the check"
    )
    assert node.stop() == 0
    assert "fault: uav2 pilot POSCTL" in node.output


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"speedup": 0.0}, "speedup"),
        ({"loss": 1.5}, "loss"),
        ({"fleet_file": "/nowhere/fleet.yaml"}, "/nowhere/fleet.yaml: cannot be read"),
        ({"faults": ["5 uav9 reboot"]}, "parameter faults: a fault names 'uav9', which is not in the fleet"),
        ({"faults": ["5 uav1 explode"]}, "a fault must be one of silence, battery"),
        ({"faults": ["soon uav1 reboot"]}, "a fault's time must be a number of seconds from 0, got 'soon'"),
        ({"faults": ["5 uav1 pilot UPSIDE_DOWN"]}, "must be one of STABILIZE"),
        ({"faults": ["5 uav1 battery full"]}, "battery needs a charge from 0 to 1, got 'full'"),
    ],
)
def test_wrong_parameters_end_it_with_one_clear_line(
    start_node: StartNode, fleet_file: Path, parameters: dict[str, Any], message: str
) -> None:
    node = start_node("sim", {"fleet_file": str(fleet_file), **parameters})
    assert node.wait() == 1
    assert message in node.output
    assert len(node.output.strip().splitlines()) == 1


def test_an_occupied_port_ends_it_with_one_clear_line(
    start_node: StartNode, fleet_file: Path, ports: list[int]
) -> None:
    with socket.create_server(("127.0.0.1", ports[0])):
        node = start_node("sim", {"fleet_file": str(fleet_file)})
        assert node.wait() == 1
    assert node.output.strip() == f"cannot start: uav1: tcp:127.0.0.1:{ports[0]}: Address already in use"

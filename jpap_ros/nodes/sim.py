"""The sim node: the fleet file's aircraft, simulated, each at the far end of its url."""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from std_msgs.msg import String

from jpap_ros.fleet.config import load_fleet
from jpap_ros.nodes.diagnostics import hardware_of, status_name
from jpap_ros.nodes.parameters import Param, StartError, declare, fleet_file, values
from jpap_ros.nodes.process import run
from jpap_ros.sim import LinkFaults, SimError, SimFleet, SimVehicle, VehicleOptions
from jpap_ros.sim.fleet import MAX_SPEEDUP
from jpap_ros.sim.schedule import FAULTS, FaultSchedule

_FAULT_PERIOD_S = 0.1


def sim_parameters() -> tuple[Param, ...]:
    """Return every parameter of the node."""
    faults = f"Faults to strike: '<seconds> <uav> <fault> [argument]'; fault: {', '.join(FAULTS)}"
    return (
        fleet_file(),
        Param("speedup", 1.0, "Simulated seconds a second, for flight and battery", 0.01, MAX_SPEEDUP, fixed=True),
        Param("seed", 0, "Of everything random", 0, 2**31 - 1, fixed=True),
        Param("gps_delay_s", 0.0, "From boot to a position that is good enough to arm [s]", 0.0, 3600.0, fixed=True),
        Param("loss", 0.0, "Share of frames lost, each way", 0.0, 1.0, fixed=True),
        Param("duplicate", 0.0, "Share of frames that come twice", 0.0, 1.0, fixed=True),
        Param("reorder", 0.0, "Share of frames held back behind later ones", 0.0, 1.0, fixed=True),
        Param("delay_s", 0.0, "Delay of every frame [s]", 0.0, 60.0, fixed=True),
        Param("jitter_s", 0.0, "Greatest random addition to the delay [s]", 0.0, 60.0, fixed=True),
        Param("faults", [""], faults, fixed=True),
    )


class SimNode(Node):
    """Runs the simulated vehicles in a thread of their own and reports on them."""

    def __init__(self) -> None:
        # First, because rclpy destroys a node whose making was refused.
        self._fleet: SimFleet | None = None
        super().__init__("sim")
        params = sim_parameters()
        declare(self, params)
        settings = values(self, params)
        self._fleet_file: str = settings["fleet_file"]
        config = load_fleet(Path(self._fleet_file))
        bad_link = {name: settings[name] for name in ("loss", "duplicate", "reorder", "delay_s", "jitter_s")}
        options = VehicleOptions(gps_delay_s=settings["gps_delay_s"], link_faults=LinkFaults(**bad_link))
        try:
            fleet = SimFleet(config, speedup=settings["speedup"], seed=settings["seed"], options=options)
            self._fleet = fleet
            self._faults = FaultSchedule(fleet, [line for line in settings["faults"] if line])
        except SimError as error:
            raise StartError(str(error)) from None
        except ValueError as error:
            raise StartError(f"parameter faults: {error}") from None
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._started = time.monotonic()
        self.create_timer(1.0, self._report)
        self.create_timer(_FAULT_PERIOD_S, self._strike)
        self.create_subscription(String, "sim/fault", self._on_fault, 10)
        fleet.start()
        self.get_logger().info(f"{len(config.uavs)} simulated vehicles fly at {settings['speedup']:g} times real time")

    def destroy_node(self) -> None:
        """Stop the vehicles, then the node."""
        if self._fleet is not None:
            self._fleet.close()
        super().destroy_node()

    def _on_fault(self, message: String) -> None:
        """`<uav> <fault> [argument]`, to strike now."""
        try:
            self._faults.add(f"0 {message.data}")
        except ValueError as error:
            self.get_logger().error(f"sim/fault: {error}")

    def _strike(self) -> None:
        for fault in self._faults.strike(time.monotonic() - self._started):
            self.get_logger().warning(f"fault: {fault.uav} {fault.fault} {fault.argument}".rstrip())

    def _report(self) -> None:
        if self._fleet is not None and not self._fleet.running:
            raise RuntimeError("the simulated vehicles have stopped; the traceback above says why")
        array = DiagnosticArray()
        array.header.stamp = self.get_clock().now().to_msg()
        array.status = [self._status(vehicle) for vehicle in self._fleet or ()]
        array.status.append(self._fleet_status())
        self._diagnostics.publish(array)

    def _fleet_status(self) -> DiagnosticStatus:
        least_m = math.inf if self._fleet is None else self._fleet.least_separation_m
        return DiagnosticStatus(
            level=DiagnosticStatus.OK,
            name=status_name(self.get_fully_qualified_name(), "fleet"),
            hardware_id=hardware_of(self._fleet_file),
            message=f"aircraft were never nearer to each other than {least_m:.1f} m in the air",
            values=[KeyValue(key="least_separation_m", value=f"{least_m:.3f}")],
        )

    def _status(self, vehicle: SimVehicle) -> DiagnosticStatus:
        east, north, up = vehicle.position
        shown = {
            "mode": vehicle.mode,
            "armed": str(vehicle.armed).lower(),
            "east_m": f"{east:.2f}",
            "north_m": f"{north:.2f}",
            "up_m": f"{up:.2f}",
            "battery": f"{vehicle.battery:.2f}",
        }
        problem = vehicle.failsafe or vehicle.prearm_problem()
        return DiagnosticStatus(
            level=DiagnosticStatus.WARN if problem else DiagnosticStatus.OK,
            name=status_name(self.get_fully_qualified_name(), vehicle.name),
            message=problem or ("armed" if vehicle.armed else "ready"),
            hardware_id=vehicle.name,
            values=[KeyValue(key=key, value=value) for key, value in shown.items()],
        )


def main() -> None:
    """Run the simulated vehicles as a process."""
    sys.exit(run(SimNode))

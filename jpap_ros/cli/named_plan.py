"""A deployment with the names of its devices and UAVs, and where on the earth it lies."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from jpap_ros.fleet.assignment import assign
from jpap_ros.fleet.config import FleetConfig
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.mavlink.plan_files import DeviceMark, GoalMark, PlanPicture
from jpap_ros.planning import Deployment
from jpap_ros.planning.devices import Device


@dataclass(frozen=True, eq=False)
class NamedPlan:
    """What one run of a scheme came to.

    Attributes
    ----------
    devices : sequence of Device
        In the order of the deployment.
    deployment : Deployment
    uavs : sequence of str
        Name of each UAV of the deployment.
    altitude_m : float
        Height of every UAV above the ground [m].
    frame : LocalFrame or None
        Where the map lies; None where nothing said so.
    fleet : FleetConfig or None
    """

    devices: Sequence[Device]
    deployment: Deployment
    uavs: Sequence[str]
    altitude_m: float
    frame: LocalFrame | None = None
    fleet: FleetConfig | None = None

    def serving(self, device: int) -> str | None:
        """Name of the UAV that serves a device, by the device's index; None where it is unserved."""
        uav = int(self.deployment.serving_uav[device])
        return self.uavs[uav] if uav >= 0 else None

    @property
    def unserved(self) -> dict[int, str]:
        """Why each unserved device is not served, by the device's index, with the names of UAVs for their numbers."""
        return {
            k: re.sub(r"\bUAV (\d+)\b", lambda number: self.uavs[int(number[1])], why)
            for k, why in self.deployment.unserved.items()
        }

    def breaches(self) -> list[str]:
        """Each goal that lies outside the fleet's fence, in words; the bridge would refuse it."""
        fence = self.fleet.fence if self.fleet else None
        if fence is None:
            return []
        found = [
            (name, fence.breach(float(east), float(north), self.altitude_m))
            for name, (east, north) in zip(self.uavs, self.deployment.uav_positions, strict=True)
        ]
        return [f"goal of {name}: {why}" for name, why in found if why]

    def picture(self) -> PlanPicture:
        """Return what plan files show; ValueError without a place on the earth, or if a goal is off the map."""
        if self.frame is None:
            raise ValueError("the map has no place on the earth: give --origin or --fleet")
        goals = [
            GoalMark(name, (float(east), float(north)), self.altitude_m)
            for name, (east, north) in zip(self.uavs, self.deployment.uav_positions, strict=True)
        ]
        devices = [
            DeviceMark(device.id, device.position, device.rate_demand, self.serving(k))
            for k, device in enumerate(self.devices)
        ]
        return PlanPicture(self.frame, goals, devices, self.fleet.fence if self.fleet else None)


def name_uavs(deployment: Deployment, fleet: FleetConfig | None) -> list[str]:
    """Name the UAVs of a deployment.

    Those of a fleet are taken such that the sum of squared distances from their homes is least; without a fleet they
    are uav1, uav2 and so on.
    """
    if fleet is None:
        return [f"uav{i}" for i in range(1, len(deployment.uav_positions) + 1)]
    homes = [uav.home_m or (0.0, 0.0) for uav in fleet.uavs]
    return [fleet.names[uav] for uav in assign(deployment.uav_positions, homes)]

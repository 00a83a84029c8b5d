"""How good a number of UAVs is, in one line."""

from __future__ import annotations

from jpap_ros.planning import Deployment


def proof_line(deployment: Deployment) -> str:
    """Say how many UAVs there are and what is proven, e.g. "14 UAVs, proven minimum" or "15 UAVs, at least 14"."""
    count = len(deployment.uav_positions)
    text = f"{count} UAV{'s' * (count != 1)}"
    if deployment.uavs_needed > count:
        text += f" of the {deployment.uavs_needed} that it takes to serve every device"
    if deployment.proven_optimal:
        return f"{text}, proven minimum"
    if deployment.min_uavs_bound is not None:
        return f"{text}, at least {deployment.min_uavs_bound}"
    return f"{text}, no bound known"

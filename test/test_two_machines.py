"""Planner and bridge on different hosts, over a wire that loses frames, delays them and breaks for a while."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from ament_index_python.packages import get_package_share_directory

HERE = Path(__file__).parent


def test_a_fleet_flies_over_a_lossy_slow_and_interrupted_link(ros_domain: int) -> None:
    # Oracle: the story in two_machines_scenario.py, told by what reaches the operator's host. Ten per cent of all
    # frames are lost and each takes 50 ms; the namespaces are the kernel's, the wire is two_hosts.py's.
    profile = Path(get_package_share_directory("jpap_ros")) / "config" / "dds" / "lossy_link.xml"
    own_network = ["unshare", "--user", "--map-root-user", "--net"]
    assert subprocess.run([*own_network, "true"], check=False).returncode == 0, (
        "this test needs root, or a kernel that lets users make network namespaces (unprivileged user namespaces)"
    )
    run = subprocess.run(
        [*own_network, sys.executable, str(HERE / "two_machines_scenario.py"), "0.1", "0.05"],
        env={**os.environ, "FASTDDS_DEFAULT_PROFILES_FILE": str(profile)},
        capture_output=True,
        text=True,
        check=False,
        timeout=380,
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert "the fleet flew" in run.stdout

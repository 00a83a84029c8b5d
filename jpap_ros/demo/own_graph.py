"""A ROS graph of one's own on this machine: a domain that nobody else uses, and DDS on loopback alone."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ament_index_python.packages import get_package_share_directory

#: Above 101 the DDS ports reach the range that Linux hands out to clients.
DOMAINS = range(1, 102)


@contextmanager
def own_graph() -> Iterator[int]:
    """Set the environment of this process, and so of its children, for a graph of its own; return the ROS domain.

    The domain is kept by a lock as long as this lasts, so that two that run at once never meet. One that the
    environment names already is left as it is.

    Raises
    ------
    OSError
        If every domain is in use.
    """
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SYSTEM_DEFAULT"
    share = Path(get_package_share_directory("jpap_ros"))
    os.environ["FASTDDS_DEFAULT_PROFILES_FILE"] = str(share / "config" / "dds" / "loopback.xml")
    given = os.environ.get("ROS_DOMAIN_ID")
    if given:
        yield int(given)
        return
    for domain in DOMAINS:
        with (Path(tempfile.gettempdir()) / f"jpap_ros_domain_{domain}.lock").open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            os.environ["ROS_DOMAIN_ID"] = str(domain)
            try:
                yield domain
            finally:
                del os.environ["ROS_DOMAIN_ID"]
            return
    raise OSError(f"every ROS domain from {DOMAINS[0]} to {DOMAINS[-1]} is in use")

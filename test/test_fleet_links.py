"""Links as a fleet file describes them, opened for real on loopback."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from jpap_ros.fleet.config import parse_fleet
from jpap_ros.mavlink.fleet_links import open_links
from jpap_ros.mavlink.links import LinkHub
from jpap_ros.mavlink.signing import SigningError

FLEET = """
version: 1
origin: {{latitude: -37.8, longitude: 144.9}}
signing_key_file: fleet.key
gcs_urls: ["udpin:127.0.0.1:{0}"]
uavs:
  - {{name: a, sysid: 1, url: "udpin:127.0.0.1:{1}", max_bytes_per_s: 900}}
  - {{name: b, sysid: 2, url: "udpin:127.0.0.1:{1}", max_bytes_per_s: 900}}
  - {{name: c, sysid: 3, url: "tcp:127.0.0.1:{2}", signing_key_file: null}}
"""


def test_each_link_gets_its_key_and_budget(tmp_path: Path, free_ports: Callable[[int], list[int]]) -> None:
    (tmp_path / "fleet.key").write_text("words")
    (tmp_path / "fleet.key").chmod(0o600)
    fleet = parse_fleet(FLEET.format(*free_ports(3)), folder=tmp_path)
    with LinkHub(245) as hub:
        links = open_links(hub, fleet)
        shared, single = links.vehicles.values()
        (station,) = links.stations
        assert hub.links == (shared, single, station)
        assert shared.options.max_bytes_per_s == 900
        assert shared.options.signer is station.options.signer is not None
        assert single.options.signer is None
        assert station.options.max_bytes_per_s is None


def test_a_key_that_others_can_read_stops_the_start(tmp_path: Path, free_ports: Callable[[int], list[int]]) -> None:
    (tmp_path / "fleet.key").write_text("words")
    (tmp_path / "fleet.key").chmod(0o644)
    fleet = parse_fleet(FLEET.format(*free_ports(3)), folder=tmp_path)
    with LinkHub(245) as hub, pytest.raises(SigningError, match="0644"):
        open_links(hub, fleet)

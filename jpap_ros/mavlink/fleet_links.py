"""Opens the links that a fleet file describes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from jpap_ros.fleet.config import FleetConfig, LinkConfig, LinkUrl
from jpap_ros.mavlink.link import Link, LinkOptions
from jpap_ros.mavlink.links import LinkHub
from jpap_ros.mavlink.signing import Signer


@dataclass(frozen=True)
class FleetLinks:
    """Open links of a fleet.

    Attributes
    ----------
    vehicles : mapping of LinkUrl to Link
        As many as there are different urls.
    stations : tuple of Link
        To ground stations.
    """

    vehicles: Mapping[LinkUrl, Link]
    stations: tuple[Link, ...]


def open_links(hub: LinkHub, fleet: FleetConfig) -> FleetLinks:
    """Open every link of a fleet with its key and byte budget.

    Raises
    ------
    OSError
        If a port cannot be listened on.
    SigningError
        If a signing key or its state file cannot be used.
    """
    signers: dict[Path, Signer] = {}

    def open_one(config: LinkConfig) -> Link:
        key_file = config.signing_key_file
        if key_file is not None and key_file not in signers:
            signers[key_file] = Signer.load(key_file)
        signer = None if key_file is None else signers[key_file]
        return hub.open(config.url, LinkOptions(signer=signer, max_bytes_per_s=config.max_bytes_per_s))

    return FleetLinks(
        {config.url: open_one(config) for config in fleet.vehicle_links},
        tuple(open_one(config) for config in fleet.gcs_links),
    )

"""The dashboard's parameters."""

from __future__ import annotations

import re

from jpap_ros.nodes.parameters import Param, fleet_file

_TILE_URL = re.compile(r"https?://[A-Za-z0-9.{}:-]+/[^\s;,'\"]*")


def dashboard_parameters() -> tuple[Param, ...]:
    """Return every parameter of the dashboard."""
    return (
        fleet_file(),
        Param("map_frame", "map", "Frame of device positions: ENU, origin as in the fleet file", fixed=True),
        Param("host", "127.0.0.1", "Address to listen on; one that other machines reach needs token_file", fixed=True),
        Param("port", 8080, "TCP port to listen on; 0: any that is free", 0, 65535, fixed=True),
        Param(
            "token_file",
            "",
            "File with the token that every page has to give, 16 characters or more, mode 600; empty: none",
            fixed=True,
        ),
        Param(
            "tile_url",
            "",
            "Map tiles, e.g. http://tiles.local/{z}/{x}/{y}.png; empty: a map in metres, no tiles",
            check=_tile_url,
            fixed=True,
        ),
        Param("tile_attribution", "", "Whose tiles they are, shown on the map", fixed=True),
        Param("update_rate_hz", 5.0, "Updates a second to each page [Hz]", 0.5, 10.0, fixed=True),
        Param("max_clients", 32, "Pages open at once; more are refused", 1, 1000, fixed=True),
        Param("exercise", False, "Let pages add, change and remove devices by hand", fixed=True),
    )


def _tile_url(value: str) -> str | None:
    if not value or (_TILE_URL.fullmatch(value) and all(part in value for part in ("{z}", "{x}", "{y}"))):
        return None
    return f"must be an http or https address with {{z}}, {{x}} and {{y}}, got {value!r}"

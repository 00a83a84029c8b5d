"""The registry of schemes: name to algorithm."""

from __future__ import annotations

from jpap_ros.planning.solver import Scheme

#: Every scheme by its name, in the order in which comparisons show them.
SCHEMES: dict[str, Scheme] = {}

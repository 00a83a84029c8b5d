"""Tables of every node's parameters in Markdown, made from the declarations themselves.

`scripts/docs` writes them into the README; a test holds the two together.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path

from jpap_ros.nodes.bridge_parameters import bridge_parameters
from jpap_ros.nodes.dashboard_parameters import dashboard_parameters
from jpap_ros.nodes.markers import markers_parameters
from jpap_ros.nodes.parameters import Param
from jpap_ros.nodes.planner_parameters import planner_parameters
from jpap_ros.nodes.recorder_parameters import recorder_parameters
from jpap_ros.nodes.replay import replay_parameters
from jpap_ros.nodes.sim import sim_parameters

BEGIN = "<!-- parameters: written by scripts/docs, do not edit -->"
END = "<!-- end of parameters -->"


def tables() -> str:
    """Return the tables of all nodes."""
    nodes = {
        "planner": planner_parameters(),
        "bridge": bridge_parameters(),
        "sim": sim_parameters(),
        "markers": markers_parameters(),
        "dashboard": dashboard_parameters(),
        "recorder": recorder_parameters(),
        "replay": replay_parameters(),
    }
    return "\n".join(f"### `{node}`\n\n{_table(params)}" for node, params in nodes.items())


def with_tables(text: str) -> str:
    """Return a page with the part between the two marks made anew; ValueError if a mark is missing."""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"the page must have the marks {BEGIN!r} and {END!r}")
    return f"{before}{BEGIN}\n\n{tables()}\n{END}{after}"


def _table(params: Iterable[Param]) -> str:
    lines = ["| parameter | default | meaning | range |", "|---|---|---|---|"]
    for param in sorted(params, key=lambda param: (param.name != "fleet_file", param.name)):
        name = f"`{param.name}`" + ("" if param.fixed else " *")
        lines.append(
            f"| {name} | {_default(param)} | {param.description.replace('|', chr(92) + '|')} | {_range(param)} |"
        )
    return "\n".join(lines) + "\n"


def _default(param: Param) -> str:
    if param.name == "fleet_file":
        return "the shipped example"
    if isinstance(param.default, bool):
        return str(param.default).lower()
    if isinstance(param.default, float):
        return f"{param.default:g}"
    return f"`{param.default}`" if param.default not in ("", [""]) else "empty"


def _range(param: Param) -> str:
    if param.choices:
        return ", ".join(f"`{choice}`" for choice in param.choices)
    if param.low is None or param.high is None:
        return ""
    return f"{param.low:g} to {param.high:g}"


def main() -> None:
    """Write the tables into the pages named on the command line."""
    for name in sys.argv[1:]:
        page = Path(name)
        page.write_text(with_tables(page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()

"""A deployment, or several beside each other, as tables for the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.table import Table
from rich.text import Text

from jpap_ros.cli.named_plan import NamedPlan
from jpap_ros.planning import Deployment
from jpap_ros.planning.link_budget import LinkBudget


def cell_table(plan: NamedPlan, link: LinkBudget) -> Table:
    """Return a table with a row for each UAV: where it hovers, whom it serves, its power and its rate."""
    table = Table()
    for title, unit in (("UAV", ""), ("east", "m"), ("north", "m")):
        _column(table, title, unit, right=bool(unit))
    if plan.frame:
        _column(table, "latitude", "deg")
        _column(table, "longitude", "deg")
    for title, unit in (("devices", ""), ("power", "W"), ("rate", "bit/s/Hz")):
        _column(table, title, unit)
    table.add_column("serves", overflow="fold", ratio=1)
    deployment = plan.deployment
    for uav, (name, (east, north)) in enumerate(zip(plan.uavs, deployment.uav_positions.tolist(), strict=True)):
        cell = deployment.cell(uav)
        place = [f"{degrees:.6f}" for degrees in plan.frame.to_geodetic(east, north)] if plan.frame else []
        power = float(deployment.power_w[cell].sum())
        table.add_row(
            Text(name),
            f"{east:.1f}",
            f"{north:.1f}",
            *place,
            str(len(cell)),
            f"{power:.3g} of {link.transmit_power_w:.3g}",
            f"{deployment.uav_rate[uav]:.2f}",
            Text(", ".join(plan.devices[k].id for k in cell)),
        )
    return table


def unserved_table(plan: NamedPlan) -> Table:
    """Return a table with a row for each device that no UAV serves, and the reason."""
    table = Table()
    table.add_column("not served")
    _column(table, "demand", "bit/s/Hz")
    table.add_column("why", overflow="fold", ratio=1)
    for k, why in plan.unserved.items():
        table.add_row(Text(plan.devices[k].id), f"{plan.devices[k].rate_demand:g}", Text(why))
    return table


def comparison_table(deployments: Sequence[Deployment]) -> Table:
    """Return a table with a row for each scheme; the fewest UAVs that any needs to serve all are in bold."""
    table = Table()
    table.add_column("scheme")
    for title in ("UAVs", "needed", "at least", "served"):
        _column(table, title)
    _column(table, "average rate", "bit/s/Hz")
    _column(table, "at most", "bit/s/Hz")
    _column(table, "time", "s")
    fewest = min(deployment.uavs_needed for deployment in deployments)
    for deployment in deployments:
        bound, rate_bound = deployment.min_uavs_bound, deployment.average_uav_rate_bound
        needed = str(deployment.uavs_needed)
        table.add_row(
            deployment.scheme,
            str(len(deployment.uav_positions)),
            f"[bold]{needed}[/]" if deployment.uavs_needed == fewest else needed,
            "-" if bound is None else str(bound),
            str(int((deployment.serving_uav >= 0).sum())),
            rate_text(deployment.average_uav_rate),
            rate_text(math.nan if rate_bound is None else rate_bound),
            f"{deployment.runtime_s:.3f}",
        )
    return table


def rate_text(rate: float) -> str:
    """A rate for a table; a dash where there is none."""
    return "-" if math.isnan(rate) else f"{rate:.2f}"


def _column(table: Table, title: str, unit: str = "", right: bool = True) -> None:
    table.add_column(f"{title}\n[dim]{unit}[/]" if unit else title, justify="right" if right else "left", no_wrap=True)

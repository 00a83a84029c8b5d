"""The live table in the terminal."""

from __future__ import annotations

import math

from jpap_msgs.msg import VehicleState
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from jpap_ros.demo.operator import Operator

_LINK = {VehicleState.LINK_CONNECTED: "connected", VehicleState.LINK_LOST: "[red]lost[/]"}
_GOAL = {
    VehicleState.GOAL_NONE: "-",
    VehicleState.GOAL_SENT: "sent",
    VehicleState.GOAL_ACCEPTED: "accepted",
    VehicleState.GOAL_EN_ROUTE: "[yellow]en route[/]",
    VehicleState.GOAL_REACHED: "[green]reached[/]",
    VehicleState.GOAL_REJECTED: "[red]rejected[/]",
    VehicleState.GOAL_YIELDED: "[red]yielded[/]",
    VehicleState.GOAL_LOST: "[red]lost[/]",
}
_LANDED = {
    VehicleState.LANDED_ON_GROUND: "ground",
    VehicleState.LANDED_IN_AIR: "air",
    VehicleState.LANDED_TAKEOFF: "taking off",
    VehicleState.LANDED_LANDING: "landing",
}


def render(operator: Operator, uavs: tuple[str, ...], reported: int, phase: str) -> RenderableType:
    """Draw the fleet as it is now: a headline with the plan, and a row for each aircraft."""
    plan = operator.deployment
    head = Text(phase, style="bold")
    cells = {} if plan is None else {cell.uav: cell for cell in plan.cells}
    if plan is not None:
        served = sum(len(cell.device_ids) for cell in plan.cells)
        head.append(
            f"\nplan {plan.plan_id} ({plan.scheme}): {served} of {reported} devices served,"
            f" {plan.uavs_needed} UAVs needed, average UAV rate {plan.average_uav_rate:.1f} bit/s/Hz",
            style="not bold",
        )
    table = Table(expand=False)
    for title in ("UAV", "link", "mode", "where", "battery", "devices", "goal", "distance"):
        table.add_column(title, justify="right" if title in ("battery", "devices", "distance") else "left")
    for name in uavs:
        state = operator.states.get(name)
        devices = str(len(cells[name].device_ids)) if name in cells else "-"
        if state is None:
            table.add_row(name, "-", "-", "-", "-", devices, "-", "-")
            continue
        table.add_row(
            name,
            _LINK.get(state.link, "never seen"),
            state.mode or "-",
            _LANDED.get(state.landed_state, "-"),
            "-" if math.isnan(state.battery_remaining) else f"{100 * state.battery_remaining:.0f} %",
            devices,
            _GOAL[state.goal_state],
            "-" if math.isnan(state.goal_distance_m) else f"{state.goal_distance_m:.1f} m",
        )
    return Group(head, table)

"""One HTML page of a flight, with everything in it."""

from __future__ import annotations

import base64
import math
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from jpap_ros.report import figures
from jpap_ros.report.events import Event, events, proof
from jpap_ros.report.flight import Flight, Floats
from jpap_ros.report.latency import Answer, answers
from jpap_ros.report.motion import Separation, metres_by_plan, metres_flown, separation
from jpap_ros.report.service import RATE_TOLERANCE, DeviceService, overall_availability, served_rates

_TEMPLATES = Environment(
    loader=FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=StrictUndefined, trim_blocks=True
)


@dataclass(frozen=True)
class Figures:
    """What is computed of a flight.

    Attributes
    ----------
    grid : (T,) ndarray
        Moments [s].
    services : tuple of DeviceService
    separation : Separation
    answers : tuple of Answer
    metres : mapping of str to float
        Flown by each aircraft [m].
    metres_by_plan : tuple of float
    events : tuple of Event
    """

    grid: Floats
    services: tuple[DeviceService, ...]
    separation: Separation
    answers: tuple[Answer, ...]
    metres: dict[str, float]
    metres_by_plan: tuple[float, ...]
    events: tuple[Event, ...]

    @property
    def availability(self) -> float:
        """Share of all device time for which devices got what they demand."""
        return overall_availability(list(self.services))


def compute(flight: Flight) -> Figures:
    """Compute everything that the page shows."""
    grid = flight.grid()
    return Figures(
        grid=grid,
        services=tuple(served_rates(flight, grid)),
        separation=separation(flight, grid),
        answers=tuple(answers(flight)),
        metres={name: metres_flown(track) for name, track in flight.tracks.items()},
        metres_by_plan=tuple(metres_by_plan(flight)),
        events=tuple(events(flight)),
    )


def render(flight: Flight, found: Figures, files: Sequence[Path], step: Callable[[], object] = lambda: None) -> str:
    """Return the page.

    Parameters
    ----------
    flight : Flight
    found : Figures
    files : sequence of Path
        Where the recording is.
    step : callable
        Called before each picture and once before the text: `STEPS` times.
    """
    grid, services = found.grid, found.services
    pictures: dict[str, Callable[[], str]] = {
        "totals": lambda: figures.totals(flight, grid, services),
        "service_map": lambda: figures.service_map(flight, grid, services),
        "worst_devices": lambda: figures.worst_devices(flight, grid, services),
        "fleet_size": lambda: figures.fleet_size(flight, grid),
        "latencies": lambda: figures.latencies(flight, found.answers),
        "tracks": lambda: figures.tracks(flight, grid, found.metres),
        "separations": lambda: figures.separations(flight, found.separation),
        "batteries": lambda: figures.batteries(flight, found.metres),
        "metres": lambda: figures.metres(found.metres),
    }
    assert len(pictures) + 1 == STEPS

    def picture(name: str, words: str) -> Markup:
        step()
        data = base64.b64encode(pictures[name]().encode()).decode()
        return Markup('<figure><img alt="{}" src="data:image/svg+xml;base64,{}"></figure>').format(words, data)

    step()
    began = time.gmtime(flight.began_s)
    clock = _Clock(flight.began_s)
    counts = Counter(event.kind for event in found.events)
    fleet = f"{len(flight.tracks)} aircraft" + ("" if flight.fleet is None else " in the fleet file")
    return _TEMPLATES.get_template("page.html.j2").render(
        title=f"Flight of {time.strftime('%Y-%m-%d %H:%M', began)} UTC",
        subtitle=f"{_duration(flight.duration_s)}, {fleet}; {', '.join(path.name for path in files)}",
        notes=flight.notes,
        cards=_cards(flight, found),
        tolerance=f"{100 * (1 - RATE_TOLERANCE):.0f} %",
        services=_service_rows(found),
        plans=_plan_rows(flight, found, clock),
        aircraft=_aircraft_rows(flight, found),
        separation_words=_separation_words(found.separation),
        events=[
            {"at": clock(e.at_s), "kind": e.kind, "source": e.source, "text": e.text, "level": e.level}
            for e in found.events
        ],
        kinds=sorted(counts),
        counts=counts,
        picture=picture,
        footer=(
            f"Times are seconds since the recording began, {time.strftime('%Y-%m-%d %H:%M:%S', began)} UTC. "
            "Made by jpap_ros from the recording alone."
        ),
    )


#: Calls of `step` that `render` makes.
STEPS = 10


class _Clock:
    """Moments as text: seconds since the beginning, and the time of day."""

    def __init__(self, began_s: float) -> None:
        self._began_s = began_s

    def __call__(self, at_s: float) -> Markup:
        day = time.strftime("%H:%M:%S", time.gmtime(self._began_s + at_s))
        return Markup('<span title="{} UTC">{}</span>').format(day, f"{at_s:.2f}" if at_s >= 0.0 else "before")


def _cards(flight: Flight, found: Figures) -> list[dict[str, str]]:
    last = flight.plans[-1].message
    present = np.sum([s.present for s in found.services], axis=0) if found.services else np.zeros(1)
    planning = [1000.0 * plan.planning_s for plan in flight.plans]
    waited = [1000.0 * answer.latency_s for answer in found.answers]
    charge = [(min(track.charge), name) for name, track in flight.tracks.items() if track.charge]
    troubles = Counter(event.level for event in found.events)
    nearest = found.separation
    lowest = min(charge, default=(math.nan, ""))
    flown = sum(found.metres.values())
    return [
        {
            "what": "Availability",
            "value": _percent(found.availability),
            "more": "of all device time at the demanded rate",
        },
        {
            "what": "Devices",
            "value": str(len(found.services)),
            "more": f"at most {int(present.max())} at a time; {len(last.unserved)} left out at the end",
        },
        {
            "what": "UAVs in use at the end",
            "value": str(len(last.cells)),
            "more": proof(last),
        },
        {
            "what": "Plans",
            "value": str(len(flight.plans)),
            "more": f"planned in {np.median(planning):.1f} ms (median), {max(planning):.1f} ms (longest)",
        },
        {
            "what": "Report to plan",
            "value": f"{np.median(waited):.0f} ms" if waited else "none",
            "more": f"median of {len(waited)}; longest {max(waited):.0f} ms" if waited else "no device report answered",
        },
        {
            "what": "Flown",
            "value": f"{flown / 1000.0:.2f} km",
            "more": f"by {sum(length > 0.0 for length in found.metres.values())} aircraft",
        },
        {
            "what": "Least separation",
            "value": f"{nearest.ever_m:.1f} m" if math.isfinite(nearest.ever_m) else "none",
            "more": " and ".join(nearest.pair) if nearest.pair else "never two in the air",
        },
        {
            "what": "Lowest battery",
            "value": _percent(lowest[0], 0),
            "more": lowest[1] or "no battery was reported",
        },
        {
            "what": "Warnings and errors",
            "value": f"{troubles['warning']} + {troubles['error']}",
            "more": "among the events below",
        },
    ]


def _service_rows(found: Figures) -> list[dict[str, str]]:
    step_s = float(found.grid[1] - found.grid[0]) if len(found.grid) > 1 else 0.0
    rows = []
    for service in sorted(found.services, key=lambda service: (service.availability, service.name)):
        there = service.present
        rows.append(
            {
                "name": service.name,
                "availability": _percent(service.availability),
                "there_s": f"{step_s * np.count_nonzero(there):.1f}",
                "demand": f"{service.demand[there][-1]:.4g}" if there.any() else "",
                "rate": f"{service.rate[there].mean():.4g}" if there.any() else "",
            }
        )
    return rows


def _plan_rows(flight: Flight, found: Figures, clock: Callable[[float], Markup]) -> list[dict[str, object]]:
    longest: dict[int, float] = {}
    for answer in found.answers:
        longest[answer.plan_id] = max(longest.get(answer.plan_id, 0.0), 1000.0 * answer.latency_s)
    return [
        {
            "at": clock(plan.at_s),
            "id": plan.message.plan_id,
            "reason": plan.message.reason,
            "uavs": len(plan.message.cells),
            "proof": proof(plan.message),
            "served": sum(len(cell.device_ids) for cell in plan.message.cells),
            "unserved": len(plan.message.unserved),
            "planning_ms": f"{1000.0 * plan.planning_s:.1f}",
            "latency_ms": f"{longest[plan.message.plan_id]:.1f}" if plan.message.plan_id in longest else "",
            "metres": f"{metres:.0f}",
        }
        for plan, metres in zip(flight.plans, found.metres_by_plan, strict=True)
    ]


def _aircraft_rows(flight: Flight, found: Figures) -> list[dict[str, str]]:
    step_s = float(found.grid[1] - found.grid[0]) if len(found.grid) > 1 else 0.0
    rows = []
    for name, track in flight.tracks.items():
        last = track.states[-1][1] if track.states else None
        rows.append(
            {
                "name": name,
                "metres": f"{found.metres[name]:.0f}",
                "airborne_s": f"{step_s * np.count_nonzero(track.airborne(found.grid)):.1f}",
                "battery_first": _percent(track.charge[0], 0) if track.charge else "",
                "battery_least": _percent(min(track.charge), 0) if track.charge else "",
                "autopilot": last.autopilot if last is not None else "",
                "mode": last.mode if last is not None else "",
            }
        )
    return rows


def _separation_words(nearest: Separation) -> str:
    if not nearest.pair:
        return "Never two aircraft were in the air at once."
    first, second = nearest.pair
    return f"Least of all: {nearest.ever_m:.1f} m, {first} and {second}, {nearest.at_s:.1f} s after the beginning."


def _percent(share: float, digits: int = 1) -> str:
    return f"{100.0 * share:.{digits}f} %" if math.isfinite(share) else "unknown"


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s" if minutes else f"{rest} s"

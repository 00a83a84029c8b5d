"""Who may take off or land at the same time, and at which height the columns above the homes are used."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from jpap_ros.fleet.arrays import Floats, point, points
from jpap_ros.fleet.separation_check import polyline_distance
from jpap_ros.fleet.transit_plan import Obstacle, TransitLimits


@dataclass(frozen=True)
class Waves:
    """Climbs or descents one after the other.

    Attributes
    ----------
    waves : tuple of mapping of str to float
        For each wave the altitude [m] of each of its aircraft: where it climbs to, or waits until it descends. A
        wave starts when all of the one before have arrived.
    held : mapping of str to str
        Aircraft that cannot go yet, and why. Ask again when the sky has changed.
    """

    waves: tuple[Mapping[str, float], ...]
    held: Mapping[str, str]

    @property
    def altitude_m(self) -> dict[str, float]:
        """Altitude of every aircraft of every wave [m]."""
        return {name: height for wave in self.waves for name, height in wave.items()}


def takeoff_waves(
    homes: Mapping[str, ArrayLike],
    altitude_m: float,
    limits: TransitLimits,
    airborne: Mapping[str, ArrayLike] | None = None,
    obstacles: Sequence[Obstacle] = (),
) -> Waves:
    """Order the take-offs of aircraft that stand on the ground, perhaps close together.

    Parameters
    ----------
    homes : mapping of str to (2,) array_like
        Where each stands [m]; the most urgent first.
    altitude_m : float
        Least altitude to climb to [m].
    limits : TransitLimits
    airborne : mapping of str to (k, 3) array_like, optional
        Corners of the path of each aircraft in the air [m]; one corner where it hovers. See `TransitPlan.path`.
    obstacles : sequence of Obstacle

    Returns
    -------
    Waves
        Aircraft whose homes are nearer than the planned separation climb one after the other, the first one highest,
        each a planned separation below the one before: whoever climbs ends below all that hover above it.

    Raises
    ------
    ValueError
        On a home that is not two finite numbers, or an altitude outside the range of the limits.
    """
    return _waves(homes, altitude_m, limits, airborne or {}, obstacles, first_is_highest=True)


def landing_waves(
    homes: Mapping[str, ArrayLike],
    altitude_m: float,
    limits: TransitLimits,
    airborne: Mapping[str, ArrayLike] | None = None,
    obstacles: Sequence[Obstacle] = (),
) -> Waves:
    """Order the landings of aircraft that come home; parameters as for `takeoff_waves`.

    Returns
    -------
    Waves
        Each aircraft flies to above its home at the altitude given here. Where homes are close the first is the
        lowest, and descends first: those that wait are a planned separation above it, or more.
    """
    return _waves(homes, altitude_m, limits, airborne or {}, obstacles, first_is_highest=False)


def _waves(
    homes: Mapping[str, ArrayLike],
    altitude_m: float,
    limits: TransitLimits,
    airborne: Mapping[str, ArrayLike],
    obstacles: Sequence[Obstacle],
    *,
    first_is_highest: bool,
) -> Waves:
    if not limits.min_altitude_m <= altitude_m <= limits.max_altitude_m:
        raise ValueError(
            f"altitude_m must be from {limits.min_altitude_m:g} to {limits.max_altitude_m:g}, got {altitude_m!r}"
        )
    place = {name: point(f"homes[{name!r}]", home, 2) for name, home in homes.items()}
    paths = {name: points(f"airborne[{name!r}]", path, 3) for name, path in airborne.items()}
    step = max(limits.planned_separation_m, 1.0)
    layers = math.floor((limits.max_altitude_m - altitude_m) / step) + 1
    turn: dict[str, int] = {}
    held: dict[str, str] = {}
    for group in _close_together(place, limits.planned_separation_m):
        for name in group:
            blocker = _in_column(place[name], limits, paths, obstacles)
            taken = {
                turn[other]: other
                for other in group
                if other in turn and _apart(place[name], place[other]) < limits.planned_separation_m
            }
            free = next(number for number in range(len(group)) if number not in taken)
            if blocker:
                held[name] = blocker
            elif free >= layers:
                held[name] = f"waits for {taken[layers - 1]}: no altitude layer is left above its home"
            else:
                turn[name] = free
    height = {}
    for group in _close_together(place, limits.planned_separation_m):
        most = max((turn[name] for name in group if name in turn), default=0)
        for name in group:
            if name in turn:
                height[name] = altitude_m + step * (most - turn[name] if first_is_highest else turn[name])
    count = max(turn.values(), default=-1) + 1
    waves = tuple({name: height[name] for name in place if turn.get(name) == number} for number in range(count))
    return Waves(waves, held)


def _apart(a: Floats, b: Floats) -> float:
    return float(np.hypot(*(a - b)))


def _close_together(place: Mapping[str, Floats], separation_m: float) -> list[list[str]]:
    """Groups of aircraft whose homes are linked by gaps smaller than the separation, in the given order."""
    left, groups = list(place), []
    while left:
        group = [left.pop(0)]
        for member in group:
            near = [name for name in left if _apart(place[member], place[name]) < separation_m]
            group += near
            left = [name for name in left if name not in near]
        groups.append([name for name in place if name in group])
    return groups


def _in_column(
    home: Floats, limits: TransitLimits, paths: Mapping[str, Floats], obstacles: Sequence[Obstacle]
) -> str | None:
    """What is too near to the column above a home, up to the highest layer; None where it is clear."""
    column = np.array([[*home, 0.0], [*home, limits.max_altitude_m]])
    for name, path in paths.items():
        if polyline_distance(column, path) < limits.planned_separation_m:
            return f"{name} is above its home"
    for obstacle in obstacles:
        if polyline_distance(column, obstacle.column) < limits.planned_separation_m + obstacle.radius_m:
            return f"{obstacle.name} is above its home"
    return None

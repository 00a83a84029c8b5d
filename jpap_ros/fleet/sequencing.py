"""In which order aircraft climb from pads that are close together, and at which heights they wait above their homes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from jpap_ros.fleet.arrays import Floats, point


@dataclass(frozen=True)
class Waves:
    """Climbs or descents one after the other.

    Attributes
    ----------
    waves : tuple of mapping of str to float
        For each wave the altitude [m], z of the map frame, of each of its aircraft: where it climbs to, or waits until
        it descends. One goes when all of the waves before that are near it have arrived.
    held : mapping of str to str
        Aircraft for which no height is left, and why.
    """

    waves: tuple[Mapping[str, float], ...]
    held: Mapping[str, str]

    @property
    def altitude_m(self) -> dict[str, float]:
        """Altitude of every aircraft of every wave [m]."""
        return {name: height for wave in self.waves for name, height in wave.items()}


def takeoff_waves(pads: Mapping[str, ArrayLike], height_m: float, separation_m: float, top_m: float) -> Waves:
    """Order the take-offs of aircraft that stand on the ground, perhaps close together.

    Parameters
    ----------
    pads : mapping of str to (3,) array_like
        Where each stands, (east, north, up) [m]; the most urgent first.
    height_m : float
        Least height to climb to above the pad, > 0 [m].
    separation_m : float
        Distance to keep, > 0 [m]; pads that are nearer to each other horizontally are close together.
    top_m : float
        Highest altitude to use [m]; one layer there is in any case.

    Returns
    -------
    Waves
        Aircraft on pads close together climb one after the other, the first one highest, each a separation below the
        one before: whoever climbs ends below all that hover above it.

    Raises
    ------
    ValueError
        On a pad that is not three finite numbers, a height or a separation that is not a positive number.
    """
    return _waves(pads, height_m, separation_m, top_m, {}, first_is_highest=True)


def landing_waves(
    homes: Mapping[str, ArrayLike],
    height_m: float,
    separation_m: float,
    top_m: float,
    waiting: Mapping[str, ArrayLike] | None = None,
) -> Waves:
    """Order the landings of aircraft that come home; parameters as for `takeoff_waves`.

    Parameters
    ----------
    waiting : mapping of str to (3,) array_like, optional
        Places above their homes [m] of those who were sent home earlier; others near them wait above them.

    Returns
    -------
    Waves
        Each aircraft flies to above its home at the altitude given here. Where homes are close together the first is
        the lowest, and descends first: those that wait are a separation above it, or more.
    """
    return _waves(homes, height_m, separation_m, top_m, waiting or {}, first_is_highest=False)


def _waves(
    pads: Mapping[str, ArrayLike],
    height_m: float,
    separation_m: float,
    top_m: float,
    waiting: Mapping[str, ArrayLike],
    *,
    first_is_highest: bool,
) -> Waves:
    for argument, value in (("height_m", height_m), ("separation_m", separation_m)):
        if not 0 < value < math.inf:
            raise ValueError(f"{argument} must be finite and > 0, got {value!r}")
    place = {name: point(f"pads[{name!r}]", pad, 3) for name, pad in pads.items()}
    earlier = {name: point(f"waiting[{name!r}]", spot, 3) for name, spot in waiting.items()}
    turn: dict[str, int] = {}
    held: dict[str, str] = {}
    altitude: dict[str, float] = {}
    for group in _close_together(place, separation_m):
        base = max(float(place[name][2]) for name in group) + height_m
        layers = max(math.floor((top_m - base) / separation_m), 0) + 1
        for name in group:
            taken = {
                turn[other]: other
                for other in group
                if other in turn and _apart(place[name], place[other]) < separation_m
            }
            lowest = 0
            for other, spot in earlier.items():
                if _apart(place[name], spot) < separation_m:
                    above = math.ceil((spot[2] - base) / separation_m) + 1
                    if above > lowest:
                        lowest, taken[above - 1] = above, other
            free = next(number for number in range(lowest, lowest + len(group) + 1) if number not in taken)
            if free < layers:
                turn[name] = free
            else:
                held[name] = f"waits for {taken[free - 1]}: no height is left above its home"
        most = max((turn[name] for name in group if name in turn), default=0)
        for name in group:
            if name in turn:
                altitude[name] = base + separation_m * (most - turn[name] if first_is_highest else turn[name])
    numbers = sorted(set(turn.values()))
    return Waves(
        tuple({name: altitude[name] for name in place if turn.get(name) == number} for number in numbers), held
    )


def _apart(a: Floats, b: Floats) -> float:
    """Horizontal distance [m]."""
    return float(np.hypot(*(a - b)[:2]))


def _close_together(place: Mapping[str, Floats], separation_m: float) -> list[list[str]]:
    """Groups of aircraft whose pads are linked by gaps smaller than the separation, in the given order."""
    left, groups = list(place), []
    while left:
        group = [left.pop(0)]
        for member in group:
            near = [name for name in left if _apart(place[member], place[name]) < separation_m]
            group += near
            left = [name for name in left if name not in near]
        groups.append([name for name in place if name in group])
    return groups

"""The shipped real input: users of Melbourne's central business district, with demands drawn from a stated seed."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class GeoSite:
    """A device as the demo reports it.

    Attributes
    ----------
    id : str
    latitude, longitude : float
        WGS-84 [deg].
    rate_demand : float
        [bit/s] at the planner's default bandwidth of 1 Hz.
    """

    id: str
    latitude: float
    longitude: float
    rate_demand: float


def sample_users(path: Path, count: int, demand: tuple[float, float], seed: int) -> list[GeoSite]:
    """Draw users from the EUA data set, without replacement, with uniform demands.

    Parameters
    ----------
    path : Path
        CSV with the columns Latitude and Longitude.
    count : int
        How many; at most as many as the file has.
    demand : (float, float)
        Least and largest rate demand [bit/s/Hz].
    seed : int
        The same seed gives the same devices.

    Raises
    ------
    ValueError
        If the file has fewer users than asked for.
    """
    with path.open(newline="", encoding="utf-8") as file:
        users = [(float(row["Latitude"]), float(row["Longitude"])) for row in csv.DictReader(file)]
    if count > len(users):
        raise ValueError(f"{path.name} has {len(users)} users, {count} were asked for")
    rng = np.random.default_rng(seed)
    chosen = rng.choice(len(users), size=count, replace=False)
    demands = rng.uniform(*demand, size=count)
    return [
        GeoSite(f"user{index:03d}", *users[index], rate_demand=round(float(rate), 3))
        for index, rate in zip(chosen, demands, strict=True)
    ]

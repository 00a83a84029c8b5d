"""Means over draws with their confidence intervals, and the tables that show them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from jpap_ros.study.rows import Row

#: Two-sided level of every confidence interval.
CONFIDENCE = 0.95

Metric = Callable[[Row], float]


class Mean(NamedTuple):
    """A mean over draws and the half-width of its confidence interval (NaN for fewer than two draws)."""

    value: float
    half_width: float
    draws: int

    def __format__(self, spec: str) -> str:
        """Format as 'mean ± half-width'."""
        return f"{self.value:{spec}} ± {self.half_width:{spec.lstrip('+')}}"


def mean(values: Sequence[float]) -> Mean:
    """Mean with Student's t confidence interval."""
    sample = np.asarray(values, float)
    count = len(sample)
    if count < 2:
        return Mean(float(sample.mean()) if count else math.nan, math.nan, count)
    quantile = float(stats.t.ppf((1 + CONFIDENCE) / 2, count - 1))
    return Mean(float(sample.mean()), quantile * float(sample.std(ddof=1)) / math.sqrt(count), count)


def mean_of(rows: Iterable[Row], metric: Metric, **where: object) -> Mean:
    """Mean of a metric over the rows whose columns have the values `where`."""
    return mean([metric(row) for row in rows if all(getattr(row, name) == value for name, value in where.items())])


def mean_difference(rows: Sequence[Row], metric: Metric, scheme: str, other: str, **where: object) -> Mean:
    """Mean of `scheme` minus `other`, paired draw by draw: both saw the same fields of devices."""

    def by_draw(name: str) -> dict[tuple[int, int, float], float]:
        return {
            (row.devices, row.draw, row.gain_db): metric(row)
            for row in rows
            if row.scheme == name and all(getattr(row, column) == value for column, value in where.items())
        }

    ours, theirs = by_draw(scheme), by_draw(other)
    return mean([ours[key] - theirs[key] for key in sorted(ours.keys() & theirs.keys())])


def markdown_table(header: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """A Markdown table; all columns but the first aligned right."""
    rule = ["---", *["---:"] * (len(header) - 1)]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in (header, rule, *lines))

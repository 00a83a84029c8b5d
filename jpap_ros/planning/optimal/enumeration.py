"""All servable sets, level by level, and which of them are maximal.

Subsets of servable sets are servable, so a set of m + 1 devices is found by joining two servable sets of m devices
that differ in their last member only; each set is made once, in index order, with one O(1) test.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from jpap_ros.planning.optimal.servability import Bools, Ints, Servability, Sets

#: Candidates tested at a time; bounds the memory of a level.
BLOCK = 500_000


class TooManySets(Exception):
    """There are more servable sets than asked for, or it takes longer."""


@dataclass(frozen=True, eq=False)
class Level:
    """All servable sets of one size.

    Attributes
    ----------
    members : (n, m) int
        Device indices of each set, ascending.
    sets : Sets
    maximal : (n,) bool
        Whether no further device can join.
    """

    members: Ints
    sets: Sets
    maximal: Bools


def servable_levels(servability: Servability, most: int = 2_000_000, deadline: float = float("inf")) -> Iterator[Level]:
    """Yield all servable sets of size 1, 2, … until there are none.

    Every device must be servable alone.

    Raises
    ------
    TooManySets
        Where there are more than `most`, or `time.monotonic()` passes `deadline`.
    """
    near = servability.neighbours()
    members: Ints = np.arange(len(servability), dtype=np.int64)[:, None]
    sets = servability.singles()
    group_end = np.full(len(members), len(members))
    total = 0
    while len(members):
        total += len(members)
        if members.shape[1] == servability.cell_limit:
            yield Level(members, sets, np.ones(len(members), dtype=bool))
            return
        parent, other = _joins(servability, members, sets, group_end, most - total, deadline)
        maximal = np.ones(len(members), dtype=bool)
        maximal[parent] = False
        leaves = np.flatnonzero(maximal)
        maximal[leaves] = ~_extensible(servability, near, members[leaves], sets[leaves], deadline)
        yield Level(members, sets, maximal)
        last = members[other, -1]
        members = np.column_stack([members[parent], last])
        sets = servability.joined(sets[parent], last)
        group_end = np.searchsorted(parent, parent, side="right")


def maximal_sets(
    servability: Servability, most: int = 2_000_000, deadline: float = float("inf")
) -> tuple[list[Ints], Sets]:
    """All maximal servable sets, and their measures; see `servable_levels`."""
    members: list[Ints] = []
    parts: list[Sets] = []
    for level in servable_levels(servability, most, deadline):
        members += list(level.members[level.maximal])
        parts.append(level.sets[level.maximal])
    return members, _concatenate(parts)


def all_sets(
    servability: Servability, most: int = 2_000_000, deadline: float = float("inf")
) -> tuple[list[Ints], Sets]:
    """All servable sets, and their measures; see `servable_levels`."""
    members: list[Ints] = []
    parts: list[Sets] = []
    for level in servable_levels(servability, most, deadline):
        members += list(level.members)
        parts.append(level.sets)
    return members, _concatenate(parts)


def _concatenate(parts: list[Sets]) -> Sets:
    return Sets(
        np.concatenate([part.weight for part in parts]),
        np.concatenate([part.centroid for part in parts]),
        np.concatenate([part.load for part in parts]),
    )


def _joins(
    servability: Servability, members: Ints, sets: Sets, group_end: Ints, most: int, deadline: float
) -> tuple[Ints, Ints]:
    """Pairs of sets of one group (all but the last member in common) whose union is servable."""
    left, right = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for first, second in _pairs(group_end - np.arange(len(members)) - 1):
        other = first + 1 + second
        good = servability.fits(sets[first], members[other, -1])
        left.append(first[good])
        right.append(other[good])
        most -= int(good.sum())
        if most < 0 or time.monotonic() > deadline:
            raise TooManySets
    return np.concatenate(left), np.concatenate(right)


def _extensible(servability: Servability, near: list[Ints], members: Ints, sets: Sets, deadline: float) -> Bools:
    """Whether a device before a set's last member can join it (one after it cannot: the set has no child)."""
    degree = np.array([len(row) for row in near])
    start = np.cumsum(degree) - degree
    flat = np.concatenate(near)
    rarest = np.take_along_axis(members, degree[members].argmin(axis=1)[:, None], axis=1)[:, 0]
    extensible = np.zeros(len(members), dtype=bool)
    for which, offset in _pairs(degree[rarest]):
        device = flat[start[rarest[which]] + offset]
        before = device < members[which, -1]
        which, device = which[before], device[before]
        good = servability.fits(sets[which], device)
        which, device = which[good], device[good]
        extensible[which[~(members[which] == device[:, None]).any(axis=1)]] = True
        if time.monotonic() > deadline:
            raise TooManySets
    return extensible


def _pairs(counts: Ints) -> Iterator[tuple[Ints, Ints]]:
    """All (i, j) with j < counts[i], in blocks of about BLOCK."""
    ends = np.cumsum(counts)
    row = 0
    while row < len(counts):
        done = ends[row - 1] if row else 0
        stop = max(row + 1, int(np.searchsorted(ends, done + BLOCK, side="right")))
        block = counts[row:stop]
        first = np.repeat(np.arange(row, stop), block)
        yield first, np.arange(len(first)) - np.repeat(np.cumsum(block) - block, block)
        row = stop

"""What becomes of one frame on a bad link."""

from __future__ import annotations

import random

from jpap_ros.sim.options import LinkFaults

#: How long a reordered frame is held back [s]: later frames of a 5 Hz stream overtake it.
REORDER_HOLD_S = 0.3


def fate(faults: LinkFaults, rng: random.Random) -> list[float]:
    """Delay [s] of each copy of a frame that arrives; empty if it is lost."""
    if rng.random() < faults.loss:
        return []
    copies = 2 if rng.random() < faults.duplicate else 1
    delays = []
    for _ in range(copies):
        delay = faults.delay_s + rng.random() * faults.jitter_s
        if rng.random() < faults.reorder:
            delay += REORDER_HOLD_S
        delays.append(delay)
    return delays

"""A million hostile frames to a bridge that flies aircraft: what `test_hostile_frames.py` does, for long.

The fleet, the frames and what must not happen are those of `test/hostile_air.py`. Ends with exit status 1, and says
why, if the bridge dies, does not fly a goal any more, or sends anything that it must not.
"""

from __future__ import annotations

import argparse
import socket
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "test"))

from hostile_air import attack, hostile_air


def free_ports(count: int) -> list[int]:
    """UDP ports on loopback, all held at once, or the system may give one twice."""
    with ExitStack() as held:
        probes = [held.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(count)]
        for probe in probes:
            probe.bind(("127.0.0.1", 0))
        return [probe.getsockname()[1] for probe in probes]


def main() -> None:
    """Attack and print."""
    parser = argparse.ArgumentParser(prog="scripts/bench fuzz", description=__doc__.split("\n\n")[0])
    parser.add_argument("--frames", type=int, default=1_000_000, help="random, mutated, forged and replayed frames")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, hostile_air(free_ports, Path(folder)) as air:
        start = time.monotonic()
        try:
            attack(air, args.frames, args.seed)
        except AssertionError as failure:
            sys.exit(f"fuzz: {failure}")
        print(
            f"fuzz: {args.frames:,} frames in {time.monotonic() - start:.0f} s at three aircraft in the air: no crash; "
            f"{len(air.taps['signed'].targets)} targets went out, all for the goals of those that fly to one, and no "
            "command"
        )


if __name__ == "__main__":
    main()

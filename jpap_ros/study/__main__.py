"""Monte-Carlo comparison of the schemes and the paper's figures; run by scripts/study."""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from jpap_ros.planning import SCHEMES
from jpap_ros.study.deployment_map import plot_map
from jpap_ros.study.figures import average_rate, plot_over_devices, plot_over_gain, uav_number
from jpap_ros.study.monte_carlo import run_study
from jpap_ros.study.rows import Row, Trial
from jpap_ros.study.scenario import Scenario
from jpap_ros.study.tables import report

EXAMPLES = """examples:
  scripts/study                                 10 draws a point of every scheme: minutes
  scripts/study --draws 200                     more of it (docs/reproduction.md); continues what is in out/study
  scripts/study --schemes jpap spiral_qdpa --devices 20 100 --workers 1
  scripts/study --devices 40 --gain-db 0 1 2 3 4 5 6 --out out/gain
  scripts/study --max-devices 4 --out out/four  with a limit of four devices a UAV (6e)

Interrupt at will: a second run does only what is missing. The results are results.csv (one row a trial), report.md and
the figures (PNG and SVG); report and figures show all that results.csv holds, from earlier runs as well."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study; return the exit status."""
    console = Console(stderr=True)
    options = _parse(arguments)
    scenario = Scenario(seed=options.seed, max_devices_per_uav=options.max_devices)
    trials = [
        Trial(devices, draw, gain, scheme)
        for gain in options.gain_db
        for devices in options.devices
        for draw in range(options.draws)
        for scheme in options.schemes
    ]
    results = options.out / "results.csv"
    try:
        with _Bar(console) as bar:
            rows = run_study(
                results,
                scenario,
                trials,
                workers=options.workers,
                time_limit_s=options.time_limit,
                progress=bar,
            )
    except ValueError as error:
        console.print(f"study: {error}", style="red", highlight=False, soft_wrap=True)
        return 2
    except KeyboardInterrupt:
        console.print(f"study: interrupted; finished trials are in {results}, the same command continues")
        return 130
    for path in [results, *_write(options.out, scenario, rows)]:
        print(path)  # noqa: T201 (the files made are the output)
    wrong = [row for row in rows if row.violations]
    for row in wrong[:10]:
        console.print(
            f"study: {row.violations} broken constraints in {row.trial}", style="red", highlight=False, soft_wrap=True
        )
    return 1 if wrong else 0


def _write(out: Path, scenario: Scenario, rows: Sequence[Row]) -> list[Path]:
    """Write the report and every figure that the rows have data for; return the paths."""
    path = out / "report.md"
    path.write_text(report(scenario, rows))
    paths = [path]
    if len({row.devices for row in rows if row.gain_db == 0}) > 1:
        paths += plot_over_devices(rows, average_rate, "Average UAV data rate [bit/s/Hz]", out / "figure1")
        paths += plot_over_devices(rows, uav_number, "Number of UAVs", out / "figure3")
    if len({row.gain_db for row in rows if row.devices == 40}) > 1:
        paths += plot_over_gain(rows, out / "link_budget")
    if any(row.devices == 40 and row.gain_db == 0 for row in rows):
        paths += plot_map(scenario, out / "figure2")
    return paths


class _Bar:
    """Progress bar on the terminal; silent elsewhere."""

    def __init__(self, console: Console) -> None:
        self._progress = Progress(
            TextColumn("trials"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
        )
        self._task = self._progress.add_task("trials", total=None)

    def __enter__(self) -> Callable[[int, int], None]:
        self._progress.start()
        return lambda done, total: self._progress.update(self._task, completed=done, total=total)

    def __exit__(self, *_: object) -> None:
        self._progress.stop()


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        "scripts/study", description=__doc__, epilog=EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--schemes", nargs="+", choices=list(SCHEMES), default=list(SCHEMES), metavar="NAME",
                        help=f"schemes to compare (default: all: {', '.join(SCHEMES)})")  # fmt: skip
    parser.add_argument("--devices", nargs="+", type=whole_number, default=[20, 40, 60, 80, 100], metavar="K",
                        help="numbers of devices (default: 20 40 60 80 100)")  # fmt: skip
    parser.add_argument("--draws", type=whole_number, default=10, help="random fields a point (default: 10)")
    parser.add_argument("--gain-db", nargs="+", type=gain_db, default=[0.0], metavar="DB",
                        help="transmit power above the stated 40 dBm [dB] (default: 0)")  # fmt: skip
    parser.add_argument(
        "--max-devices", type=whole_number, metavar="K_MAX", help="most devices a UAV (default: no limit)"
    )
    parser.add_argument("--seed", type=seed, default=Scenario.seed, help="seed of all draws (default: %(default)s)")
    parser.add_argument("--time-limit", type=seconds, default=60.0, help="of each solve [s] (default: 60)")
    parser.add_argument("--workers", type=whole_number, default=len(os.sched_getaffinity(0)),
                        help="processes (default: the cores there are)")  # fmt: skip
    parser.add_argument("--out", type=Path, default=Path("out/study"), help="folder of results (default: out/study)")
    return parser.parse_args(arguments)


def whole_number(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"must be at least 1, got {text}")
    return number


def seed(text: str) -> int:
    number = int(text)
    if number < 0:
        raise argparse.ArgumentTypeError(f"must be at least 0, got {text}")
    return number


def seconds(text: str) -> float:
    number = float(text)
    if not 0 < number < math.inf:
        raise argparse.ArgumentTypeError(f"must be finite and > 0, got {text}")
    return number


def gain_db(text: str) -> float:
    number = float(text)
    try:
        Scenario().with_gain(number)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text} leads to a link budget that cannot be: {error}") from None
    return number


if __name__ == "__main__":
    sys.exit(main())

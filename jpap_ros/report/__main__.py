"""Make one HTML page of a recorded flight: service, fleet size, planning, tracks, separation, every event."""

from __future__ import annotations

import argparse
import sys
from collections import deque
from collections.abc import Sequence
from pathlib import Path

import yaml
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from jpap_ros.report.flight_reader import is_of_flight, read_flight
from jpap_ros.report.page import STEPS, compute, render
from jpap_ros.report.recording import RecordingError, RecordingReader

_EXAMPLES = """examples:
  scripts/report recordings/2026-11-22T05-36-12Z.mcap            writes report.html
  scripts/report recordings/*.mcap -o out/flight.html            a recording that was split
  scripts/report FILE.mcap --extract setup                       the fleet file and the planner's parameters

exit status: 0 done, 1 the recording cannot be used, 2 the command line is wrong"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return the exit status."""
    options = _parse(arguments)
    console = Console(stderr=True)
    try:
        total = sum(path.stat().st_size for path in options.files if path.is_file())
        with _progress(console) as progress:
            task = progress.add_task("reading", total=total)
            reader = RecordingReader(options.files, is_of_flight, lambda done: progress.update(task, completed=done))
            if options.extract is not None:
                for path in extract(reader, options.extract):
                    sys.stdout.write(f"{path}\n")
                return 0
            flight = read_flight(reader, options.namespace)
        with _progress(console) as progress:
            task = progress.add_task("drawing", total=STEPS)
            page = render(flight, compute(flight), options.files, lambda: progress.advance(task))
        options.output.parent.mkdir(parents=True, exist_ok=True)
        options.output.write_text(page, encoding="utf-8")
    except (RecordingError, OSError) as error:
        sys.stderr.write(f"report: {error}\n")
        return 1
    for note in flight.notes:
        sys.stderr.write(f"report: {note}\n")
    sys.stdout.write(f"{options.output}\n")
    return 0


def extract(reader: RecordingReader, folder: Path) -> list[Path]:
    """Write the fleet file and the planner's parameters, to plan again under the same conditions; return the paths.

    Raises
    ------
    RecordingError
        If the recording has neither.
    """
    # All else is known when the messages have been read.
    deque(reader, maxlen=0)
    files = {} if reader.fleet_text is None else {"fleet.yaml": reader.fleet_text}
    for node, values in reader.parameters.items():
        # Of another machine and another time.
        kept = {name: value for name, value in values.items() if name not in ("fleet_file", "state_file")}
        name = node.strip("/").replace("/", "_")
        files[f"{name}.yaml"] = yaml.safe_dump({"/**": {"ros__parameters": kept}})
    if not files:
        raise RecordingError("there is neither a fleet file nor a planner's parameters in the recording")
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    return [folder / name for name in files]


def _progress(console: Console) -> Progress:
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:3.0f} %"))
    return Progress(*columns, TimeRemainingColumn(), console=console, transient=True, disable=not console.is_terminal)


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="scripts/report",
        description=__doc__,
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "files", nargs="+", type=Path, metavar="FILE", help="recording (.mcap); several if it was split"
    )
    parser.add_argument("-o", "--output", type=Path, default=Path("report.html"), help="default: report.html")
    parser.add_argument("--namespace", help="of the fleet, where the recording has several")
    parser.add_argument("--extract", type=Path, metavar="FOLDER", help="write what was flown with here instead")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    sys.exit(main())

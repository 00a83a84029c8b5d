"""Plan a deployment for the devices of a file, without ROS; run by scripts/plan."""

from __future__ import annotations

import argparse
import math
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from jpap_ros.cli.device_file import DeviceFileError, read_devices
from jpap_ros.cli.named_plan import NamedPlan, name_uavs
from jpap_ros.cli.plan_outputs import (
    COMPARISON_SUFFIXES,
    GEODETIC_SUFFIXES,
    PLAN_SUFFIXES,
    write_comparison,
    write_plan,
)
from jpap_ros.cli.plan_tables import cell_table, comparison_table, rate_text, unserved_table
from jpap_ros.cli.proof import proof_line
from jpap_ros.fleet.config import FleetConfig, FleetFileError, MapOrigin, load_fleet
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.planning import SCHEMES, Deployment, LinkBudget, solve
from jpap_ros.planning.devices import Device

ALL_SERVED, SOME_UNSERVED, WRONG_INPUT, NOT_WRITTEN, INTERRUPTED = 0, 1, 2, 3, 130

#: Width of a table that goes to a file or a pipe, where no terminal says how wide it may be.
_PIPE_WIDTH = 140

DESCRIPTION = """Plan a deployment for the devices of a file, without ROS: how many UAVs, where each hovers, and how
much power each device gets.

DEVICES is a CSV file whose first line names its columns, in any order:
  id,x,y,rate_demand[,weight]                    metres east and north
  id,latitude,longitude,rate_demand[,weight]     degrees, WGS-84
or GeoJSON (.geojson, .json): a FeatureCollection of Points with the properties id, rate_demand and, if wanted, weight.
Demands are bit/s/Hz; the weight, 1 if not given, says who comes first where the fleet is too small."""

EPILOG = """examples:
  scripts/plan devices.csv                                  the smallest fleet, with its proof
  scripts/plan devices.csv --compare                        every scheme beside the others
  scripts/plan devices.csv --output plan.png plan.csv       a map, and a row a device
  scripts/plan devices.geojson --output plan.kml plan.plan  for Google Earth and QGroundControl
  scripts/plan devices.csv --origin -37.81,144.96 --output plan.kml   metres, put on the map there
  scripts/plan devices.csv --fleet fleet.yaml               for the aircraft of a fleet file, by their names
  scripts/plan devices.csv --max-uavs 5 --scheme jpap       the best that five UAVs can do, by the paper's scheme

exit status:
  0  every device is served (and, with --fleet, every goal lies inside the fence)
  1  the plan is made, but leaves out a device or a goal lies outside the fence
  2  the command line, the file of devices or the fleet file is wrong; one line on stderr says what
  3  an output file could not be written
  130  interrupted"""


class _OptionError(ValueError):
    """An option does not fit the input; the message is the one line that the user sees."""


@dataclass(frozen=True)
class _Task:
    """What is to be planned for."""

    devices: tuple[Device, ...]
    link: LinkBudget
    fleet: FleetConfig | None
    frame: LocalFrame | None


def main(arguments: Sequence[str] | None = None) -> int:
    """Plan as the command line says; return the exit status."""
    errors = Console(stderr=True)
    options = _parser().parse_args(_joined(sys.argv[1:] if arguments is None else arguments))
    try:
        task = _task(options, errors)
        schemes = list(SCHEMES) if options.compare else [options.scheme]
        deployments = _solve_all(task, schemes, options, errors)
    except (DeviceFileError, FleetFileError, _OptionError) as error:
        return _fail(errors, WRONG_INPUT, str(error))
    except KeyboardInterrupt:
        return _fail(errors, INTERRUPTED, "interrupted")
    if options.compare:
        return _show_comparison(task, deployments, options, errors)
    return _show_plan(task, deployments[0], options, errors)


def _task(options: argparse.Namespace, errors: Console) -> _Task:
    """Read what the options name, and see that the output files can be made from it."""
    suffixes = COMPARISON_SUFFIXES if options.compare else PLAN_SUFFIXES
    for path in options.output:
        if path.suffix.lower() not in suffixes:
            what = "a comparison" if options.compare else "a plan"
            raise _OptionError(f"--output: {what} is written as {', '.join(suffixes)}, got {str(path)!r}")
    link = LinkBudget(options.power, options.noise, options.gain, options.altitude)
    found = read_devices(options.devices)
    if found.ignored:
        errors.print(f"plan: columns not used: {', '.join(found.ignored)}", style="yellow", markup=False)
    fleet = load_fleet(options.fleet) if options.fleet else None
    if fleet is not None and options.max_uavs is not None and options.max_uavs > len(fleet.uavs):
        raise _OptionError(f"--max-uavs {options.max_uavs}: {options.fleet} has {len(fleet.uavs)}")
    origin = options.origin or (fleet.origin if fleet else None) or (found.centroid() if found.geodetic else None)
    if origin is None and (path := next((p for p in options.output if p.suffix.lower() in GEODETIC_SUFFIXES), None)):
        raise _OptionError(f"--output {path}: devices in metres need a place on the earth: give --origin or --fleet")
    try:
        frame = LocalFrame(origin) if origin else None
    except ValueError as error:
        raise _OptionError(f"origin: {error}") from None
    return _Task(found.devices(frame), link, fleet, frame)


def _solve_all(task: _Task, schemes: Sequence[str], options: argparse.Namespace, errors: Console) -> list[Deployment]:
    """Run the schemes one by one, with a progress bar on a terminal."""
    fleet_size = len(task.fleet.uavs) if task.fleet else None
    progress = Progress(
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=errors,
        transient=True,
        disable=not errors.is_terminal,
    )
    deployments = []
    with progress:
        bar = progress.add_task("", total=len(schemes))
        for scheme in schemes:
            progress.update(bar, description=f"{scheme}, {len(task.devices)} devices")
            deployments.append(
                solve(
                    [device.position for device in task.devices],
                    [device.rate_demand for device in task.devices],
                    scheme,
                    task.link,
                    max_devices_per_uav=options.max_devices_per_uav,
                    max_uavs=fleet_size if options.max_uavs is None else options.max_uavs,
                    weights=[device.weight for device in task.devices],
                    min_separation_m=options.min_separation,
                    time_limit_s=options.time_limit,
                    seed=options.seed,
                )
            )
            progress.advance(bar)
    return deployments


def _show_plan(task: _Task, deployment: Deployment, options: argparse.Namespace, errors: Console) -> int:
    uavs = name_uavs(deployment, task.fleet)
    plan = NamedPlan(task.devices, deployment, uavs, task.link.altitude_m, task.frame, task.fleet)
    out = _output()
    out.print(cell_table(plan, task.link))
    if deployment.unserved:
        out.print(unserved_table(plan))
    served = int((deployment.serving_uav >= 0).sum())
    bound = deployment.average_uav_rate_bound
    out.print(f"{proof_line(deployment)}; {served} of {len(task.devices)} devices served")
    out.print(
        f"average UAV rate {rate_text(deployment.average_uav_rate)} bit/s/Hz"
        + (f", at most {rate_text(bound)}" if bound is not None else "")
        + f"; {deployment.scheme}, {deployment.runtime_s:.3f} s"
    )
    breaches = plan.breaches()
    for breach in breaches:
        errors.print(f"plan: {breach}", style="yellow", soft_wrap=True, markup=False)
    written = _write(options.output, partial(write_plan, plan=plan), errors)
    return written or (SOME_UNSERVED if deployment.unserved or breaches else ALL_SERVED)


def _show_comparison(
    task: _Task, deployments: Sequence[Deployment], options: argparse.Namespace, errors: Console
) -> int:
    out = _output()
    out.print(comparison_table(deployments))
    bounds = [each.min_uavs_bound for each in deployments if each.min_uavs_bound is not None]
    if bounds:
        least = max(bounds)
        out.print(f"proven: it takes at least {least} UAV{'s' * (least != 1)} to serve every device")
    written = _write(options.output, partial(write_comparison, devices=task.devices, deployments=deployments), errors)
    return written or (SOME_UNSERVED if any(each.unserved for each in deployments) else ALL_SERVED)


def _output() -> Console:
    console = Console(highlight=False, emoji=False)
    # Where no terminal says how wide it is, rich would take 80 columns.
    return console if console.is_terminal else Console(highlight=False, emoji=False, width=_PIPE_WIDTH)


def _write(paths: Sequence[Path], write: Callable[[Path], None], errors: Console) -> int:
    """Write the files and name them on stdout; return the exit status."""
    for path in paths:
        try:
            write(path)
        except (OSError, ValueError) as error:
            return _fail(errors, NOT_WRITTEN, f"{path}: cannot be written: {error}")
        print(path)  # noqa: T201 (the files made are the output)
    return ALL_SERVED


def _fail(errors: Console, status: int, why: str) -> int:
    errors.print(f"plan: {why}", style="red", soft_wrap=True, markup=False, highlight=False)
    return status


def _joined(arguments: Sequence[str]) -> list[str]:
    """Join `--origin` and a place south of the equator, which argparse would take for another option."""
    joined: list[str] = []
    for argument in arguments:
        if joined and joined[-1] == "--origin" and re.match(r"-[\d.]", argument):
            joined[-1] += f"={argument}"
        else:
            joined.append(argument)
    return joined


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        "scripts/plan", description=DESCRIPTION, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    link = LinkBudget()
    parser.add_argument("devices", type=Path, metavar="DEVICES", help="CSV or GeoJSON file")
    parser.add_argument("--scheme", choices=list(SCHEMES), default="optimal", metavar="NAME",
                        help=f"one of {', '.join(SCHEMES)} (default: optimal)")  # fmt: skip
    parser.add_argument("--compare", action="store_true", help="run every scheme and compare them")
    parser.add_argument("--output", nargs="+", type=Path, default=[], metavar="FILE",
                        help=f"files to write, the suffix decides: {' '.join(PLAN_SUFFIXES)};"
                        f" with --compare: {' '.join(COMPARISON_SUFFIXES)}")  # fmt: skip
    place = parser.add_argument_group("where on the earth")
    place.add_argument("--origin", type=_origin, metavar="LAT,LON[,ALT]",
                       help="origin of the map: degrees, and metres above sea level"
                       " (default: the fleet file's, or the middle of the devices in degrees)")  # fmt: skip
    place.add_argument("--fleet", type=Path, metavar="YAML",
                       help="fleet file: gives the origin, the UAVs' names and number, and the fence")  # fmt: skip
    limits = parser.add_argument_group("limits")
    limits.add_argument(
        "--max-uavs", type=_whole, metavar="N", help="UAVs there are (default: the fleet's, or no limit)"
    )
    limits.add_argument("--max-devices-per-uav", type=_whole, metavar="K", help="devices a UAV (default: no limit)")
    limits.add_argument("--min-separation", type=_between(0, 10_000), default=0.0, metavar="M",
                        help="least horizontal distance between two UAVs [m] (default: 0)")  # fmt: skip
    limits.add_argument("--time-limit", type=_time, default=10.0, metavar="S",
                        help="of each scheme [s]; 0: none (default: 10)")  # fmt: skip
    limits.add_argument("--seed", type=int, default=0, help="of the schemes that draw at random (default: 0)")
    radio = parser.add_argument_group("radio link")
    radio.add_argument("--power", type=_between(-50, 100), default=link.transmit_power_dbm, metavar="DBM",
                       help="total transmit power of a UAV [dBm] (default: %(default)g)")  # fmt: skip
    radio.add_argument("--noise", type=_between(-200, 0), default=link.noise_power_dbm, metavar="DBM",
                       help="noise power at a device [dBm] (default: %(default)g)")  # fmt: skip
    radio.add_argument("--gain", type=_between(-150, 0), default=link.reference_gain_db, metavar="DB",
                       help="channel gain at 1 m [dB] (default: %(default)g)")  # fmt: skip
    radio.add_argument("--altitude", type=_between(1, 5000), default=link.altitude_m, metavar="M",
                       help="height of the UAVs above the ground [m] (default: %(default)g)")  # fmt: skip
    return parser


def _origin(text: str) -> MapOrigin:
    try:
        origin = MapOrigin(*map(float, text.split(",")))
        LocalFrame(origin)
    except (TypeError, ValueError):
        raise argparse.ArgumentTypeError(
            f"must be LAT,LON or LAT,LON,ALT with a latitude from -89 to 89, got {text!r}"
        ) from None
    return origin


def _whole(text: str) -> int:
    number = int(text) if text.isascii() and text.isdigit() else 0
    if number < 1:
        raise argparse.ArgumentTypeError(f"must be a whole number, at least 1, got {text!r}")
    return number


def _between(low: float, high: float) -> Callable[[str], float]:
    """Type of an option: a number in a range, those of the planner's parameters."""

    def number(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"must be a number from {low:g} to {high:g}, got {text!r}")
        return value

    return number


def _time(text: str) -> float | None:
    return _between(0, 3600)(text) or None


if __name__ == "__main__":
    sys.exit(main())

"""The study: the same results however it is run, nothing lost when interrupted, and figures that show the results."""

from __future__ import annotations

import csv
import json
import math
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from scipy.optimize import brentq
from scipy.special import gammaln

from jpap_ros.planning import solve
from jpap_ros.study.__main__ import main
from jpap_ros.study.deployment_map import circle_radii
from jpap_ros.study.monte_carlo import run_study
from jpap_ros.study.rows import Row, RowWriter, Trial, read_rows
from jpap_ros.study.scenario import Scenario
from jpap_ros.study.summary import markdown_table, mean, mean_difference, mean_of
from jpap_ros.study.tables import report

SCENARIO = Scenario(seed=7)
TRIALS = [
    Trial(devices, draw, 0.0, scheme)
    for devices in (4, 8)
    for draw in range(3)
    for scheme in ("spiral_qdpa", "kmeans_epa")
]


def row(devices: int = 20, draw: int = 0, scheme: str = "jpap", uavs: int = 12) -> Row:
    return Row(devices, draw, 0.0, scheme, uavs, 30.5, None, False, 0, 0, 0.01)


def without_runtime(rows: list[Row]) -> list[Row]:
    return [replace(each, runtime_s=0.0) for each in rows]


def test_a_draw_depends_on_seed_devices_and_index_alone() -> None:
    positions, rates = SCENARIO.draw(30, 4)
    again = Scenario(seed=7).draw(30, 4)
    assert np.array_equal(positions, again[0])
    assert np.array_equal(rates, again[1])
    for other in (Scenario(seed=8).draw(30, 4), SCENARIO.draw(30, 5)):
        assert not np.array_equal(positions, other[0])


def test_draws_are_the_papers() -> None:
    """Oracle: section V: uniform on 1500 m x 1500 m and [15, 20]; mean and spread of a uniform variable."""
    fields = [SCENARIO.draw(100, draw) for draw in range(100)]
    for values, low, high in (
        (np.concatenate([positions for positions, _ in fields]).ravel(), 0, 1500),
        (np.concatenate([rates for _, rates in fields]), 15, 20),
    ):
        assert low <= values.min() < values.max() <= high
        assert values.mean() == pytest.approx((low + high) / 2, abs=0.01 * (high - low))
        assert values.std() == pytest.approx((high - low) / math.sqrt(12), rel=0.02)


def test_rows_agree_with_the_solver(tmp_path: Path) -> None:
    """Oracle: the same trial solved by hand."""
    rows = run_study(tmp_path / "r.csv", SCENARIO, TRIALS, workers=1)
    assert [each.trial for each in rows] == sorted(TRIALS)
    for each in rows:
        deployment = solve(
            *SCENARIO.draw(each.devices, each.draw), each.scheme, seed=SCENARIO.scheme_seed(each.devices, each.draw)
        )
        assert each.uavs == len(deployment.uav_positions)
        assert each.average_uav_rate == deployment.average_uav_rate
        assert each.violations == each.unserved == 0


def test_results_do_not_depend_on_the_number_of_workers(tmp_path: Path) -> None:
    alone = run_study(tmp_path / "1.csv", SCENARIO, TRIALS, workers=1)
    together = run_study(tmp_path / "2.csv", SCENARIO, TRIALS, workers=2)
    assert without_runtime(together) == without_runtime(alone)


def test_an_interrupted_run_is_continued(tmp_path: Path) -> None:
    """A run that stopped after five rows, the last of them torn, runs what is missing and nothing else."""
    path = tmp_path / "r.csv"
    whole = run_study(path, SCENARIO, TRIALS, workers=1)
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:6]) + lines[6][:9])
    calls: list[tuple[int, int]] = []
    again = run_study(path, SCENARIO, TRIALS, workers=1, progress=lambda done, total: calls.append((done, total)))
    assert calls == [(done, 12) for done in range(5, 13)]
    assert without_runtime(again) == without_runtime(whole)
    # The rows that were there were not run again: even their run time is the same.
    assert read_rows(path)[:5] == whole[:5]


def test_a_rerun_runs_nothing(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    first = run_study(path, SCENARIO, TRIALS, workers=1)
    content = path.read_bytes()
    calls: list[tuple[int, int]] = []
    assert run_study(path, SCENARIO, TRIALS, workers=2, progress=lambda *call: calls.append(call)) == first
    assert calls == [(12, 12)]
    assert path.read_bytes() == content


def test_results_of_two_scenarios_are_not_mixed(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    run_study(path, SCENARIO, TRIALS[:1], workers=1)
    with pytest.raises(ValueError, match="seed 7 -> 8"):
        run_study(path, Scenario(seed=8), TRIALS[:1], workers=1)


def test_a_scenario_without_results_is_replaced(tmp_path: Path) -> None:
    """A run that was stopped before its first result leaves a scenario that nothing depends on."""
    path = tmp_path / "r.csv"
    run_study(path, SCENARIO, [], workers=1)
    run_study(path, Scenario(seed=8), TRIALS[:1], workers=1)
    assert json.loads((tmp_path / "r.json").read_text())["seed"] == 8


def test_the_report_of_another_link_budget_alone() -> None:
    """Oracle by hand: 12 and 14 UAVs in two draws are 13 on average; nothing is said of the stated link budget."""
    rows = [replace(row(draw=draw, uavs=uavs), gain_db=3.0) for draw, uavs in enumerate((12, 14))]
    text = report(Scenario(), rows)
    assert "## UAVs for 20 devices by link budget above the stated one\n\n| Scheme | +3 dB |" in text
    assert "| JPAP (QDPA) | 13.00 ± " in text
    assert "| JPAP (QDPA) | 30.50 ± 0.00 |" in text
    assert "## UAVs\n" not in text
    assert "draw by draw" not in text


def test_the_report_has_no_empty_table() -> None:
    # The only scheme is the one that the others are compared with.
    assert "draw by draw" not in report(Scenario(), [row()])
    assert "+0 dB" not in report(Scenario(), [row()])


def test_a_broken_line_is_named(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    with RowWriter(path) as writer:
        writer.write(row())
        writer.write(row(draw=1))
    path.write_text(path.read_text().replace("20,1,", "20,one,"))
    with pytest.raises(ValueError, match=r"r\.csv, line 3: .*'one'"):
        read_rows(path)
    path.write_text("a,b\n1,2\n")
    with pytest.raises(ValueError, match=r"line 1: expected the columns devices,draw"):
        read_rows(path)


def test_rows_survive_the_file(tmp_path: Path) -> None:
    rows = [row(), replace(row(draw=1), average_uav_rate=1 / 3, min_uavs_bound=11, proven_optimal=True)]
    with RowWriter(tmp_path / "r.csv") as writer:
        for each in rows:
            writer.write(each)
    assert read_rows(tmp_path / "r.csv") == rows


def test_confidence_interval_is_students() -> None:
    """Oracle: the 97.5 % point of the t density with 4 degrees of freedom, integrated here."""

    def outside(t: float) -> float:
        scale = math.exp(gammaln(2.5) - gammaln(2.0)) / math.sqrt(4 * math.pi)
        x = np.linspace(0, t, 20001)
        return float(0.5 - np.trapezoid(scale * (1 + x * x / 4) ** -2.5, x)) - 0.025

    values = [12.0, 15.0, 11.0, 14.0, 18.0]
    found = mean(values)
    assert found.value == 14.0
    # Sum of squared deviations 30, so s^2 = 7.5 and the standard error sqrt(7.5 / 5).
    assert found.half_width == pytest.approx(brentq(outside, 1, 5) * math.sqrt(1.5), rel=1e-5)
    assert math.isnan(mean([1.0]).half_width)


def test_differences_are_paired_by_draw() -> None:
    """Oracle by hand: 2, 2 and 2 in every draw, however much the draws differ; an unpaired draw is left out."""
    rows = [row(draw=draw, uavs=count) for draw, count in enumerate((10, 20, 60))]
    rows += [row(draw=draw, scheme="optimal", uavs=count) for draw, count in enumerate((8, 18, 58, 1))]
    found = mean_difference(rows, lambda each: each.uavs, "optimal", "jpap", devices=20)
    assert (found.value, found.half_width, found.draws) == (-2.0, 0.0, 3)
    assert mean_of(rows, lambda each: each.uavs, scheme="jpap").value == 30


def test_markdown_table() -> None:
    assert markdown_table(["a", "b"], [["1", "2"]]) == "| a | b |\n| --- | ---: |\n| 1 | 2 |\n"


def test_circles_of_own_radii_reach_the_farthest_device() -> None:
    positions, rates = SCENARIO.draw(20, 0)
    common, own = solve(positions, rates, "spiral_qdpa"), solve(positions, rates, "spiral_epa")
    assert np.array_equal(circle_radii(common, positions), common.coverage_radius_m)
    radii = circle_radii(own, positions)
    for device, uav in enumerate(own.serving_uav):
        assert math.dist(positions[device], own.uav_positions[uav]) <= radii[uav] + 1e-9


def test_the_command_writes_results_report_and_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One pass through the command line: every file is there, complete, and holds what it should."""
    arguments = ["--draws", "2", "--devices", "5", "40", "--gain-db", "0", "3", "--workers", "1", "--seed", "5"]
    arguments += ["--schemes", "jpap", "spiral_epa", "--out", str(tmp_path)]
    assert main(arguments) == 0
    names = ["results.csv", "report.md"]
    names += [f"{name}.{kind}" for name in ("figure1", "figure3", "link_budget", "figure2") for kind in ("png", "svg")]
    assert capsys.readouterr().out.split() == [str(tmp_path / name) for name in names]
    with (tmp_path / "results.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * 2 * 2 * 2
    assert json.loads((tmp_path / "results.json").read_text())["seed"] == 5
    counts = [int(each["uavs"]) for each in rows if each["devices"] == "5" and each["scheme"] == "jpap"]
    assert len(counts) == 4
    assert "| JPAP (QDPA) |" in (tmp_path / "report.md").read_text()
    labels = {
        "figure1": ["Average UAV data rate [bit/s/Hz]", "JPAP (QDPA)", "Spiral, EPA"],
        "figure3": ["Number of UAVs", "JPAP (QDPA)", "Spiral, EPA"],
        "link_budget": ["Link budget above the stated one [dB]", "paper: JPAP 14"],
        "figure2": ["East [m]", "North [m]", "JPAP (QDPA)", "EPA-JPAP, common radius"],
    }
    for name, expected in labels.items():
        image = imread(tmp_path / f"{name}.png")
        assert min(image.shape[:2]) > 400
        assert image[..., :3].std() > 0.03
        text = "".join(ElementTree.parse(tmp_path / f"{name}.svg").getroot().itertext())
        assert [label for label in expected if label not in text] == []


@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("--draws", "0", "must be at least 1, got 0"),
        ("--seed", "-1", "must be at least 0, got -1"),
        ("--time-limit", "0", "must be finite and > 0, got 0"),
        ("--time-limit", "nan", "must be finite and > 0, got nan"),
        ("--gain-db", "nan", "nan leads to a link budget that cannot be: transmit_power_dbm must be a finite number"),
        ("--gain-db", "1000", "1000 leads to a link budget that cannot be: transmit_power_dbm must be from -300 to"),
    ],
)
def test_a_wrong_argument_is_one_clear_line_and_leaves_nothing_behind(
    tmp_path: Path, name: str, value: str, problem: str
) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-m", "jpap_ros.study", f"{name}={value}", "--out", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert f"argument {name}: {problem}" in done.stderr
    assert not out.exists()

"""The benchmarks that need no ROS still run. Oracle: their exit codes and the figures that they are to print."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize(
    ("name", "arguments", "figures"),
    [
        (
            "soak",
            "--minutes 5 --seeds 2 3",
            ["smallest change", "from scratch", "least separation"],
        ),
        (
            "replanning",
            "--transitions 20 --assignments 2 --events 10 --devices 20",
            ["full service", "straight flights would have broken"],
        ),
        ("planning", "--instances 1 --largest 100", ["jpap", "all cells identical in 1 of 1 instances"]),
        ("optimal", "--never-worse --instances 2", ["0 exceptions"]),
    ],
)
def test_it_runs_on_a_small_case(name, arguments, figures):
    done = subprocess.run(
        [sys.executable, f"bench/{name}.py", *arguments.split()], cwd=ROOT, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    for figure in figures:
        assert figure in done.stdout

"""`solve`: bad input, and demands that nobody can meet. Oracle: the contract, and equation (3) from straight above."""

from __future__ import annotations

import math

import numpy as np
import pytest

from jpap_ros.planning import SCHEMES, LinkBudget, solve
from jpap_ros.planning.solver import MIN_RATE

GOOD = [[0.0, 0.0], [50.0, 0.0]]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"positions": [[0, 0], [math.nan, 0]], "rates": [15, 15]}, r"positions\[1, 0\] must be finite, got nan"),
        (
            {"positions": [[0, 0], [1, -2e9]], "rates": [15, 15]},
            r"positions\[1, 1\] must be within 1e\+09 m .*, got -2000000000",
        ),
        ({"positions": [[0, 1j]], "rates": [15]}, "positions must be an array of numbers: complex"),
        ({"positions": [[0, 0, 0]], "rates": [15]}, r"positions must have shape \(K, 2\), got \(1, 3\)"),
        ({"positions": GOOD, "rates": [15]}, r"rates must have shape \(2,\) to match positions, got \(1,\)"),
        ({"positions": GOOD, "rates": [15, math.inf]}, r"rates\[1\] must be finite and > 0, got inf"),
        ({"positions": GOOD, "rates": [0, 15]}, r"rates\[0\] must be finite and > 0, got 0.0"),
        ({"positions": GOOD, "rates": [15, -2]}, r"rates\[1\] must be finite and > 0, got -2.0"),
        ({"positions": GOOD, "rates": [15, 1e-300]}, r"rates\[1\] must be >= 1e-06, got 1e-300"),
        ({"positions": GOOD, "rates": ["a", 1]}, "rates must be an array of numbers"),
        ({"positions": GOOD, "rates": [15, 15], "weights": [1, 0]}, r"weights\[1\] must be finite and > 0, got 0.0"),
        ({"positions": GOOD, "rates": [15, 15], "scheme": "best"}, "scheme must be one of .*jpap.*, got 'best'"),
        ({"positions": GOOD, "rates": [15, 15], "scheme": ["jpap"]}, r"scheme must be one of .*, got \['jpap'\]"),
        ({"positions": GOOD, "rates": [15, 15], "seed": 1.5}, "seed must be a whole number, got 1.5"),
        ({"positions": GOOD, "rates": [15, 15], "seed": -1}, "seed must be >= 0, got -1"),
        ({"positions": GOOD, "rates": [15, 15], "link": 40}, "link must be a LinkBudget, got 40"),
        ({"positions": GOOD, "rates": [15, 15], "max_devices_per_uav": 0}, "max_devices_per_uav must be >= 1, got 0"),
        ({"positions": GOOD, "rates": [15, 15], "max_uavs": 1.5}, "max_uavs must be a whole number or None, got 1.5"),
        ({"positions": GOOD, "rates": [15, 15], "min_separation_m": -1}, "min_separation_m must be .*, got -1"),
        ({"positions": GOOD, "rates": [15, 15], "time_limit_s": 0}, "time_limit_s must be > 0 or None, got 0"),
    ],
)
def test_bad_input_is_named(arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        solve(**arguments)


@pytest.mark.parametrize("scheme", ["jpap", "jpap_epa", "jpap_epa_common"])
def test_an_impossible_demand_is_reported_and_affects_nobody_else(scheme: str) -> None:
    # From straight above a UAV gives log2(1 + 1e10 / 2500) = 21.9316 bit/s/Hz.
    positions, rates = [[0.0, 0.0], [10.0, 0.0], [50.0, 0.0]], [16.0, 22.0, 16.0]
    found = solve(positions, rates, scheme)
    assert found.serving_uav.tolist() == [0, -1, 0]
    assert found.power_w[1] == 0 and found.rate[1] == 0
    assert dict(found.unserved).keys() == {1}
    assert "demands 22 bit/s/Hz" in found.unserved[1] and "21.9316" in found.unserved[1]
    assert found.violations(positions, rates, LinkBudget()) == []
    alone = solve([positions[0], positions[2]], [16.0, 16.0], scheme)
    assert found.uav_positions == pytest.approx(alone.uav_positions)


def test_only_impossible_demands() -> None:
    found = solve([[0.0, 0.0]], [1000.0])
    assert len(found.uav_positions) == 0
    assert math.isnan(found.average_uav_rate)
    assert list(found.unserved) == [0]


def test_the_largest_possible_demand_is_served_from_straight_above() -> None:
    link = LinkBudget()
    found = solve([[3.0, 4.0]], [link.max_rate], link=link)
    assert found.uav_positions == pytest.approx(np.array([[3.0, 4.0]]))
    assert found.violations([[3.0, 4.0]], [link.max_rate], link) == []


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("power_dbm", [-100.0, 40.0, 300.0])
def test_the_least_demand_is_served_however_strong_the_link(scheme: str, power_dbm: float) -> None:
    positions = np.random.default_rng(0).uniform(0, 1500, (8, 2))
    link = LinkBudget(transmit_power_dbm=power_dbm)
    found = solve(positions, np.full(8, MIN_RATE), scheme, link)
    assert np.isfinite(found.uav_positions).all()
    assert found.violations(positions, np.full(8, MIN_RATE), link) == []

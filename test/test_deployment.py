"""The check of every constraint. Oracle: a good deployment with one thing broken at a time, worked out by hand."""

from __future__ import annotations

import pickle
from dataclasses import fields, replace

import numpy as np
import pytest

from jpap_ros.planning import Deployment, LinkBudget, solve

LINK = LinkBudget()
POSITIONS = np.array([[0.0, 0.0], [60.0, 0.0], [900.0, 0.0]])
RATES = np.array([16.0, 16.0, 18.0])


@pytest.fixture(scope="module")
def good() -> Deployment:
    found = solve(POSITIONS, RATES)
    assert sorted(len(found.cell(uav)) for uav in range(2)) == [1, 2]
    return found


def broken(good: Deployment, limits: dict | None = None, **changes) -> list[str]:
    return replace(good, **changes).violations(POSITIONS, RATES, LINK, **(limits or {}))


def changed(array: np.ndarray, index, value: float) -> np.ndarray:
    copy = array.copy()
    copy[index] = value
    return copy


def test_a_good_deployment_has_none(good: Deployment) -> None:
    assert good.violations(POSITIONS, RATES, LINK, max_devices_per_uav=2, max_uavs=2, min_separation_m=500.0) == []


def test_arrays_are_read_only(good: Deployment) -> None:
    for name in ("uav_positions", "serving_uav", "power_w", "rate", "uav_rate"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(good, name)[0] = 1
    with pytest.raises(TypeError):
        good.unserved[0] = "no"  # type: ignore[index]


def test_a_pickled_copy_is_the_same_and_as_immutable(good: Deployment) -> None:
    """Researchers send deployments between processes. Oracle: the original, field by field."""
    copy = pickle.loads(pickle.dumps(replace(good, unserved={2: "why"})))
    for field in fields(good):
        if field.name != "unserved":
            np.testing.assert_array_equal(getattr(copy, field.name), getattr(good, field.name))
    assert dict(copy.unserved) == {2: "why"}
    assert not copy.uav_positions.flags.writeable and not copy.power_w.flags.writeable


def test_power_sum(good: Deployment) -> None:
    # 5 W each; a device that gets 6 W makes 11 W.
    found = broken(good, power_w=changed(good.power_w, 0, 6.0))
    assert any("(6c)" in line and "sum to 11 W" in line and "P_T is 10 W" in line for line in found)


def test_negative_power(good: Deployment) -> None:
    power = changed(changed(good.power_w, 0, -1.0), 1, 11.0)
    assert any("device 0 has the negative power -1 W" in line for line in broken(good, power_w=power))


def test_demand_not_met(good: Deployment) -> None:
    # Device 0 gets 1 W at 30 m or so: log2(1 + 1e9 / 3400) = 18.2 of 16: met; with 1 mW: log2(1 + 1e6 / 3400) = 8.2.
    power = changed(changed(good.power_w, 0, 1e-3), 1, 10 - 1e-3)
    found = broken(good, power_w=power)
    assert any("(6b) device 0 gets 8.2" in line and "16 demanded" in line for line in found)
    assert any("(3) device 0: reported rate" in line for line in found)


def test_a_moved_uav_breaks_what_was_reported(good: Deployment) -> None:
    found = broken(good, uav_positions=good.uav_positions + np.array([0.0, 5000.0]))
    assert sum("(6b)" in line for line in found) == 3
    assert sum("(4) UAV" in line for line in found) == 2


def test_device_left_out(good: Deployment) -> None:
    serving = changed(good.serving_uav, 2, -1)
    found = broken(good, serving_uav=serving)
    assert any("(6d) device 2 is served by no UAV, and no reason" in line for line in found)
    assert any("serves no device" in line for line in found)
    assert any("device 2 is unserved, but has the power 10 W" in line for line in found)


def test_device_both_served_and_unserved(good: Deployment) -> None:
    assert any("(6d) device 1 is listed as unserved (why)" in x for x in broken(good, unserved={1: "why"}))
    assert any("device 9 is listed as unserved, but there are 3" in x for x in broken(good, unserved={9: "why"}))


def test_limits(good: Deployment) -> None:
    limits = {"max_devices_per_uav": 1, "max_uavs": 1, "min_separation_m": 1000.0}
    found = broken(good, limits)
    assert any("(6e) UAV" in line and "serves 2 devices, K_max is 1" in line for line in found)
    assert "2 UAVs are deployed, the fleet has 1" in found
    assert any("m apart, at least 1000 m wanted" in line for line in found)


def test_values_that_are_no_numbers_and_uavs_that_do_not_exist(good: Deployment) -> None:
    assert broken(good, power_w=changed(good.power_w, 1, np.nan)) == ["power_w[1] is nan"]
    assert "device 0: its serving UAV 7 does not exist, there are 2" in broken(
        good, serving_uav=changed(good.serving_uav, 0, 7)
    )


def test_shapes(good: Deployment) -> None:
    for positions, rates in ((POSITIONS[:2], RATES[:2]), (POSITIONS.T, RATES), (POSITIONS, RATES[:, None])):
        (line,) = good.violations(positions, rates, LINK)
        shapes = f"positions of shape {positions.shape} and rates of shape {rates.shape}"
        assert line == f"shapes: the deployment is for 3 devices, there are {shapes}"

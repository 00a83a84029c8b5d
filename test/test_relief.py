"""What a hand-over from above costs. Oracle: equation (3) with the powers of the plan, worked out here."""

import math
from dataclasses import replace

import pytest

from jpap_ros.fleet.cells import Aircraft
from jpap_ros.fleet.plan import PlanSettings, plan_from_scratch
from jpap_ros.fleet.relief import short_from_above
from jpap_ros.planning.devices import Device

SETTINGS = PlanSettings(scheme="jpap")
#: P_T 10 W over noise 1e-12 W with a gain of 1e-3 at 1 m: the greatest rate from a height, straight below.
GAIN = 1e-3 / 1e-12
FLEET = [Aircraft("u1", (0.0, 0.0)), Aircraft("u2", (900.0, 0.0))]


def greatest_rate(height_m):
    return math.log2(1 + 10.0 * GAIN / height_m**2)


@pytest.mark.parametrize(("above_m", "loss"), [(12.0, 0.62), (15.0, 0.76)])
def test_straight_below_a_relief_so_much_rate_is_missing(above_m, loss):
    assert greatest_rate(50.0) - greatest_rate(50.0 + above_m) == pytest.approx(loss, abs=0.005)
    for spare, short in ((loss - 0.02, {"a"}), (loss + 0.02, set())):
        devices = [Device("a", (0.0, 0.0), greatest_rate(50.0) - spare), Device("b", (900.0, 0.0), 10.0)]
        plan = plan_from_scratch(devices, SETTINGS, FLEET)
        # Alone in its cell it gets all power.
        assert [cell.power_w for cell in plan.cells if "a" in cell.device_ids] == [pytest.approx((10.0,))]
        cells = {cell.id for cell in plan.cells}
        told = short_from_above(plan, cells, SETTINGS.link, above_m)
        assert told.keys() == short
        assert all(f"{above_m:g} m above" in why for why in told.values())


def test_only_cells_that_are_handed_over_count():
    devices = [Device("a", (0.0, 0.0), greatest_rate(50.0) - 0.1), Device("b", (900.0, 0.0), greatest_rate(50.0) - 0.1)]
    plan = plan_from_scratch(devices, SETTINGS, FLEET)
    one = next(cell.id for cell in plan.cells if "b" in cell.device_ids)
    assert short_from_above(plan, {one}, SETTINGS.link, 15.0).keys() == {"b"}
    assert short_from_above(plan, (), SETTINGS.link, 15.0) == {}
    assert short_from_above(replace(plan, cells=()), {one}, SETTINGS.link, 15.0) == {}

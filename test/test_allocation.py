"""Power allocation, equations (5) and (8) to (11). Oracle: hand-worked figures, and the equations' own statements."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jpap_ros.planning import LinkBudget
from jpap_ros.planning.allocation import EPA, EPA_COMMON, QDPA, Allocation
from jpap_ros.planning.link_budget import snr_demand

LINK = LinkBudget()
RULES = (QDPA, EPA, EPA_COMMON)


def test_hand_worked_cell() -> None:
    # w = 2^15 - 1, 2^16 - 1 = 32767, 65535; their sum is 98302. P_T = 10 W, P_T eta = 1e10 m^2, H^2 = 2500 m^2.
    w = snr_demand([15.0, 16.0])
    assert QDPA.powers(w, LINK) == pytest.approx([10 * 32767 / 98302, 10 * 65535 / 98302], rel=1e-12)
    assert QDPA.squared_radii(w, LINK) == pytest.approx([1e10 / 98302 - 2500] * 2, rel=1e-12)
    assert EPA.powers(w, LINK) == pytest.approx([5.0, 5.0], rel=1e-12)
    assert EPA.squared_radii(w, LINK) == pytest.approx([5e9 / 32767 - 2500, 5e9 / 65535 - 2500], rel=1e-12)
    assert EPA_COMMON.powers(w, LINK) == pytest.approx([5.0, 5.0], rel=1e-12)
    assert EPA_COMMON.squared_radii(w, LINK) == pytest.approx([5e9 / 65535 - 2500] * 2, rel=1e-12)


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.name)
@given(rates=st.lists(st.floats(0.01, 21.9), min_size=1, max_size=20))
def test_the_powers_sum_to_the_total_and_give_equation_5(rule: Allocation, rates: list[float]) -> None:
    w = snr_demand(rates)
    powers, radii = rule.powers(w, LINK), rule.squared_radii(w, LINK)
    assert powers.sum() == pytest.approx(LINK.transmit_power_w, rel=1e-12)
    own = powers * LINK.eta / w - LINK.altitude_m**2  # equation (5)
    expected = np.full(len(w), own.min()) if rule.common_radius else own
    assert radii == pytest.approx(expected, rel=1e-9, abs=1e-8)


@given(rates=st.lists(st.floats(0.01, 21.9), min_size=1, max_size=20))
def test_qdpa_gives_one_radius_equation_8(rates: list[float]) -> None:
    w = snr_demand(rates)
    own = QDPA.powers(w, LINK) * LINK.eta / w
    assert own == pytest.approx(np.full(len(w), own[0]), rel=1e-12)


def test_a_demand_that_takes_all_the_power_from_straight_above_has_radius_zero() -> None:
    for rule in RULES:
        squared = rule.squared_radii(snr_demand([LINK.max_rate]), LINK)
        assert 0 <= squared[0] < 1e-8


def test_a_share_that_serves_from_nowhere_is_negative() -> None:
    assert (QDPA.squared_radii(snr_demand([21.5, 21.5]), LINK) < 0).all()

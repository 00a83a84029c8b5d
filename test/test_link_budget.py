"""The channel, equations (1) to (5). Oracle: figures worked out by hand from the equations."""

from __future__ import annotations

import math
import re

import pytest

from jpap_ros.planning import LinkBudget
from jpap_ros.planning.link_budget import snr_demand

LINK = LinkBudget()


def test_constants_of_the_paper() -> None:
    # 40 dBm is 10 W; rho_0 / sigma^2 = 1e-3 / 1e-12 W = 1e9 m^2/W; hence P_T eta = 1e10 m^2.
    assert LINK.transmit_power_w == pytest.approx(10.0, rel=1e-12)
    assert LINK.eta == pytest.approx(1e9, rel=1e-12)
    assert LINK.power_eta == pytest.approx(1e10, rel=1e-12)


def test_gain_and_rate_at_a_distance() -> None:
    # 120 m aside and 50 m below is 130 m away: g = 1e-3 / 16900; with 10 W the SNR is 1e10 / 16900.
    assert LINK.channel_gain(120.0**2) == pytest.approx(1e-3 / 16900, rel=1e-12)
    assert LINK.rate(10.0, 120.0**2) == pytest.approx(math.log2(1 + 1e10 / 16900), rel=1e-12)
    # From straight above: log2(1 + 1e10 / 2500) = log2(4000001).
    assert LINK.max_rate == pytest.approx(math.log2(4_000_001), rel=1e-12)


def test_coverage_radius() -> None:
    # w = 2^15 - 1 = 32767: d = sqrt(1e10 / 32767 - 2500) = sqrt(302684.957...) = 550.168...
    assert LINK.coverage_radius(10.0, 15.0) == pytest.approx(math.sqrt(1e10 / 32767 - 2500), rel=1e-12)
    assert LINK.coverage_radius(10.0, 15.0) == pytest.approx(550.168, abs=1e-3)
    # With 1 mW, 2^15 - 1 needs a distance of 5.5 m, less than the altitude.
    assert math.isnan(LINK.coverage_radius(1e-3, 15.0))


def test_at_the_coverage_radius_the_rate_is_the_demand() -> None:
    radius = LINK.coverage_radius(2.5, 16.5)
    assert LINK.rate(2.5, radius**2) == pytest.approx(16.5, rel=1e-12)


def test_small_demands_lose_no_digits() -> None:
    # 2^r - 1 = r ln 2 (1 + r ln 2 / 2 + ...) for a small r.
    r = 1e-12
    assert snr_demand(r) == pytest.approx(r * math.log(2), rel=1e-11)
    power = snr_demand(r) * LINK.altitude_m**2 / LINK.eta
    assert LINK.rate(power, 0.0) == pytest.approx(r, rel=1e-12)


@pytest.mark.parametrize("value", [math.nan, math.inf, "40", None, True, -1e5])
def test_a_bad_value_is_named(value: object) -> None:
    with pytest.raises(ValueError, match=rf"noise_power_dbm must be .*, got {value!r}"):
        LinkBudget(noise_power_dbm=value)  # type: ignore[arg-type]


@pytest.mark.parametrize("altitude", [0.0, -5.0])
def test_the_altitude_is_positive(altitude: float) -> None:
    with pytest.raises(ValueError, match=f"altitude_m must be > 0, got {altitude}"):
        LinkBudget(altitude_m=altitude)


@pytest.mark.parametrize("altitude", [1e-200, 1e200])
def test_an_altitude_whose_square_is_no_number_is_named(altitude: float) -> None:
    with pytest.raises(ValueError, match=f"altitude_m must be from .*, got {re.escape(repr(altitude))}"):
        LinkBudget(altitude_m=altitude)

"""Two vehicles with one system id, told from one that is heard in two places.

Oracle: what each address tells is made here, second by second, from one vehicle or from two.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.mavlink.strangers import Strangers
from jpap_ros.mavlink.twins import Twins

DEGREES_E7_PER_M = 1e7 / 111_319.0


def place(boot_s: float, north_m: float, speed_m_s: float = 0.0) -> Any:
    lat = round(-37.8e7 + north_m * DEGREES_E7_PER_M)
    return mavlink.MAVLink_global_position_int_message(
        int(boot_s * 1e3), lat, 1_449_631_000, 70_000, 50_000, round(100 * speed_m_s), 0, 0, 0
    )


def beat(mode: int = 4, armed: bool = False) -> Any:
    return mavlink.MAVLink_heartbeat_message(2, 3, 0x81 if armed else 0x01, mode, 4, 3)


def found(a: Callable[[float], Any], b: Callable[[float], Any], seconds: float = 20.0, lag_s: float = 0.1) -> bool:
    """Whether two addresses, each telling something twice a second, are ever taken for two vehicles."""
    twins: Twins[str] = Twins()
    ever = False
    for step in range(int(2 * seconds)):
        twins.heard("a", a(step / 2), step / 2)
        twins.heard("b", b(step / 2), step / 2 + lag_s)
        ever |= bool(twins.addresses(step / 2 + lag_s))
    return ever


class TestTwins:
    """What one vehicle can tell on two links, and what only two can."""

    @pytest.mark.parametrize(
        ("a", "b"),
        [
            (lambda t: place(100 + t, 0.0), lambda t: place(900 + t, 0.0)),
            (lambda t: place(100 + t, 0.0), lambda t: place(100 + t, 20.0)),
            (lambda t: place(100 + t, 15 * t, 15.0), lambda t: place(100 + t, 15 * t + 50, 15.0)),
            (lambda t: beat(armed=True), lambda t: beat()),
            (lambda t: beat(4), lambda t: beat(5)),
        ],
        ids=["clocks", "places", "flying behind one another", "arming", "modes"],
    )
    def test_two_vehicles(self, a: Callable[[float], Any], b: Callable[[float], Any]) -> None:
        assert found(a, b)
        assert not found(a, a) and not found(b, b)

    @pytest.mark.parametrize("delay_s", [0.0, 0.5, 3.0])
    @pytest.mark.parametrize("pace", [1.0, 50.0])
    def test_one_vehicle_over_a_slow_link(self, delay_s: float, pace: float) -> None:
        def flying(t: float) -> Any:
            return place(1000 + pace * t, 20 * pace * t, 20.0)

        assert not found(flying, lambda t: flying(t - delay_s))

    def test_one_vehicle_that_reboots_or_changes_its_mode(self) -> None:
        def rebooting(t: float) -> Any:
            return place(900 + t if t < 8 else t - 8, 0.0)

        def changing(t: float) -> Any:
            return beat(4 if t % 8 < 4 else 5, armed=t > 4)

        for story in (rebooting, changing):
            assert not found(story, lambda t, story=story: story(t - 2.0))

    def test_order_is_restored_when_one_goes(self) -> None:
        twins: Twins[str] = Twins()
        for t in range(10):
            twins.heard("a", beat(4), t)
            twins.heard("b", beat(5), t + 0.5)
        assert set(twins.addresses(9.6)) == {"a", "b"}
        for t in range(10, 20):
            twins.heard("a", beat(4), t)
        assert twins.addresses(19.0) == ()


class TestStrangers:
    """Vehicle 1 heard on the link of vehicle 2."""

    def test_a_stranger_is_a_rival_after_its_third_heartbeat_until_it_is_silent(self) -> None:
        strangers: Strangers[str] = Strangers(4.0)
        seen = []
        for t in range(4):
            strangers.heard(1, "link2", False, t)
            seen.append(strangers.rivals(1, t))
        assert seen == [(), (), ("link2",), ("link2",)]
        assert strangers.rivals(2, 3.0) == ()
        assert strangers.rivals(1, 7.1) == ()
        # Heartbeats that come now and then, of a frame gone astray, make none.
        for t in range(10, 100, 5):
            strangers.heard(1, "link2", False, t)
            assert strangers.rivals(1, t) == ()

    def test_what_relays_a_vehicle_is_no_rival_even_when_its_own_falls_silent(self) -> None:
        strangers: Strangers[str] = Strangers(4.0)
        for t in range(100):
            if t < 10:
                strangers.heard(2, "mesh", True, t)
            strangers.heard(1, "mesh", False, t)
            strangers.heard(1, f"other{t}", False, t)
        assert strangers.rivals(1, 99.0) == ()
        assert strangers.addresses(1, 99.0) == ("mesh",)

    def test_addresses_that_went_are_forgotten(self) -> None:
        strangers: Strangers[str] = Strangers(4.0)
        strangers.heard(1, "link2", False, 0.0)
        strangers.heard(2, "link2b", True, 100.0)
        assert strangers.sysids == ()

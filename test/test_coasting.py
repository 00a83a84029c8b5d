"""Targets that may be the last ones.

Oracle: where ArduPilot's documented rule takes an aircraft after a target (on with its velocity for GUID_TIMEOUT, 3 s,
then to rest with WPNAV_ACCEL, 2.5 m/s^2), and a follower that closes in on its target at 0.95 (PX4's MPC_XY_P) to 2 per
second (ArduPilot's shaping).
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jpap_ros.fleet.time_law import leg_law
from jpap_ros.fleet.traffic import Setpoint
from jpap_ros.fleet.transit_plan import Convoy
from jpap_ros.mavlink.autopilots.ardupilot import ArduPilot
from jpap_ros.mavlink.coasting import coasting

GUID_TIMEOUT_S, WPNAV_ACCEL = 3.0, 2.5
KEEPS_S = ArduPilot.keeps_velocity_s
SPEED, CLIMB, ACCELERATION = 8.0, 1.5, 1.5
lengths = st.floats(1.0, 500.0)


def convoy_of(*legs: float) -> Convoy:
    """Aircraft 20 m apart that fly legs of so many metres east, on one clock."""
    start = np.array([[0.0, 20.0 * i, 50.0] for i in range(len(legs))])
    along = np.array([[length, 0.0, 0.0] for length in legs])
    names = tuple(f"uav{i}" for i in range(len(legs)))
    return Convoy(names, np.stack([start, start + along]), (leg_law(along, SPEED, CLIMB, ACCELERATION),))


@settings(max_examples=50)
@given(lengths, lengths, st.floats(0.0, 1.0))
def test_whoever_hears_nothing_more_stays_on_its_leg_and_on_the_common_clock(a: float, b: float, part: float) -> None:
    convoy = convoy_of(a, b)
    time_s = part * convoy.duration_s
    ends = []
    for index, length in enumerate((a, b)):
        sent = coasting(Setpoint(*convoy.place(index, time_s)), KEEPS_S)
        ends.append((sent.position[0] + GUID_TIMEOUT_S * sent.velocity[0]) / length)
        assert ends[-1] * length + sent.velocity[0] ** 2 / (2 * WPNAV_ACCEL) <= length + 1e-6
        assert sent.position[0] >= convoy.place(index, time_s)[0][0]
    assert ends[0] == pytest.approx(ends[1], abs=1e-9)


@pytest.mark.parametrize("gain", [0.95, 1.5, 2.0])
def test_who_follows_closely_still_does(gain: float) -> None:
    # Targets at 5 Hz, ahead of the middle of the time for which they hold; 2 m is the default tracking_error_m.
    convoy = convoy_of(200.0)
    here, worst, step_s = 0.0, 0.0, 0.02
    for i in range(round((convoy.duration_s + 5.0) / step_s)):
        now = i * step_s
        if i % 10 == 0:
            sent, sent_at = coasting(Setpoint(*convoy.place(0, now + 0.1)), KEEPS_S), now + 0.1
        target = sent.position[0] + sent.velocity[0] * (now - sent_at)
        here += step_s * (sent.velocity[0] + gain * (target - here))
        worst = max(worst, abs(here - convoy.place(0, now)[0][0]))
    assert worst < 2.0
    assert here == pytest.approx(200.0, abs=0.2)


def test_far_from_the_end_and_at_rest_nothing_changes() -> None:
    cruise = Setpoint((0.0, 0.0, 50.0), (8.0, 0.0, 0.0), 36.9)
    assert coasting(cruise, KEEPS_S) == cruise, "8 m/s for 3 s, and 8^2 / (2 * 2.5) m to brake: 36.8 m"
    rest = Setpoint((1.0, 2.0, 50.0))
    assert coasting(rest, KEEPS_S) == rest


def test_near_the_end_the_way_that_is_left_is_never_passed() -> None:
    # By hand: v = 4.5 m/s, d = 6.75 m: w = (6.75 - 4.5/1.5) / (4.6 - 1/1.5) = 0.953 m/s, lead (4.5 - w) / 1.5 = 2.364.
    sent = coasting(Setpoint((0.0, 0.0, 50.0), (0.0, 4.5, 0.0), 6.75), KEEPS_S)
    assert sent.velocity == pytest.approx((0.0, 0.953, 0.0), abs=1e-3)
    assert sent.position == pytest.approx((0.0, 2.364, 50.0), abs=1e-3)
    assert math.isclose(sent.position[1] + KEEPS_S * sent.velocity[1], 6.75)

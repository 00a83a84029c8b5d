"""Byte budget of a slow link. Oracles: instances worked by hand, and the properties an allocation must have."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jpap_ros.mavlink.budget import Budget, Stream, frame_size

SETPOINT = Stream(86, rate_hz=10.0, size_bytes=65, priority=0)
POSITION = Stream(33, rate_hz=5.0, size_bytes=40, priority=1, min_rate_hz=1.0)
ECHO = Stream(87, rate_hz=2.0, size_bytes=63, priority=1, min_rate_hz=1.0)
BATTERY = Stream(147, rate_hz=1.0, size_bytes=50, priority=2, min_rate_hz=0.1)
ALL = [SETPOINT, POSITION, ECHO, BATTERY]


def test_without_a_limit_everything_is_as_wanted() -> None:
    allocation = Budget().allocate(ALL)
    assert allocation.rates_hz == (10.0, 5.0, 2.0, 1.0)
    assert allocation.bytes_per_s == 650 + 200 + 126 + 50
    assert not allocation.overloaded


@pytest.mark.parametrize(
    ("capacity", "rates"),
    [
        # Everything fits.
        (1026, (10.0, 5.0, 2.0, 1.0)),
        # 1026 - 22.5 wanted too much: the battery gives way, down to 0.1 + (1 - 0.1) / 2.
        (1003.5, (10.0, 5.0, 2.0, 0.55)),
        # Least rates take 650 + 40 + 63 + 5 = 758; of the 111.5 left, position and echo (160 + 63 = 223 more) get half.
        (869.5, (10.0, 3.0, 1.5, 0.1)),
        # Not even the least rates fit: half of 40 + 63 for priority 1, nothing for 2.
        (701.5, (10.0, 0.5, 0.5, 0.0)),
        # Setpoints go out whole, whatever the capacity.
        (100, (10.0, 0.0, 0.0, 0.0)),
    ],
)
def test_worked_instances(capacity: float, rates: tuple[float, ...]) -> None:
    allocation = Budget(capacity).allocate(ALL)
    assert allocation.rates_hz == pytest.approx(rates)
    assert allocation.overloaded == (capacity < 650)


streams = st.builds(
    lambda rate, share, size, priority: Stream(33, rate, size, priority, rate * share),
    st.floats(0, 50),
    st.floats(0, 1),
    st.integers(12, 280),
    st.integers(0, 4),
)


@given(st.lists(streams, max_size=12), st.floats(100, 20_000))
@settings(deadline=None)
def test_properties(wanted: list[Stream], capacity: float) -> None:
    allocation = Budget(capacity).allocate(wanted)
    essential = sum(s.rate_hz * s.size_bytes for s in wanted if s.priority == 0)
    assert allocation.bytes_per_s <= max(capacity, essential) * (1 + 1e-9)
    for stream, rate in zip(wanted, allocation.rates_hz, strict=True):
        assert -1e-9 <= rate <= stream.rate_hz * (1 + 1e-9)
        if stream.priority == 0:
            assert rate == stream.rate_hz
    full = sum(s.rate_hz * s.size_bytes for s in wanted)
    # Nothing is held back without need.
    assert allocation.bytes_per_s >= min(full, capacity) * (1 - 1e-9)
    # A stream above its least rate means that every more important one has its whole rate.
    raised = [s.priority for s, r in zip(wanted, allocation.rates_hz, strict=True) if r > s.min_rate_hz * 1.001 + 1e-9]
    for stream, rate in zip(wanted, allocation.rates_hz, strict=True):
        if any(stream.priority < other for other in raised if other > 0):
            assert rate == pytest.approx(stream.rate_hz)


def test_frame_sizes() -> None:
    # GLOBAL_POSITION_INT: 7 fields of 4 bytes … time, lat, lon, alt, relative_alt (20) and vx, vy, vz, hdg (8).
    assert frame_size(33) == 28 + 12
    assert frame_size(33, signed=True) == 28 + 12 + 13


@pytest.mark.parametrize(
    ("rate", "size", "priority", "least"),
    [(-1.0, 20, 1, 0.0), (1.0, 20, 1, 2.0), (float("nan"), 20, 1, 0.0), (1.0, 0, 1, 0.0), (1.0, 20, -1, 0.0)],
)
def test_streams_that_make_no_sense(rate: float, size: int, priority: int, least: float) -> None:
    with pytest.raises(ValueError, match="must be"):
        Stream(33, rate, size, priority, least)

"""Telemetry rates that follow the load of a link.

Oracles: instances worked by hand from the frame sizes of the message definitions, and a model of the link that is told
the rates and answers with the bytes that flow; it shares nothing with the controller but the rates.
"""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.fleet.config import LinkConfig, LinkUrl
from jpap_ros.mavlink.autopilots import REGISTRY, Autopilot
from jpap_ros.mavlink.link_rates import LinkRates
from jpap_ros.mavlink.streams import WANTED

ARDUPILOT, PX4 = REGISTRY["ardupilot"], REGISTRY["px4"]
POSITION = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
FULL = {message_id: wanted.rate_hz for message_id, wanted in WANTED.items()}
LEAST = {message_id: wanted.min_rate_hz for message_id, wanted in WANTED.items()}
#: Both heartbeats (21 bytes) and two targets (65 bytes) a second for one aircraft.
NEVER_SLOWED = 2 * 21 + 2 * 65


def link(max_bytes_per_s: float | None, aircraft: int = 1) -> LinkRates:
    names = tuple(f"uav{i}" for i in range(aircraft))
    return LinkRates(LinkConfig(LinkUrl("udpin", "127.0.0.1", 14550), names, max_bytes_per_s), 2.0)


class Plant:
    """The link: bytes/s from rates. Frames are a little shorter than they might be; others use the link as well."""

    def __init__(self, rates: LinkRates, autopilots: list[Autopilot], share: float = 0.9) -> None:
        self.rates, self.autopilots, self.share = rates, autopilots, share
        self.others = 0.0
        self.now = 0.0
        self.changes = 0

    @property
    def load(self) -> float:
        total = float(len(self.autopilots) * NEVER_SLOWED)
        for autopilot in self.autopilots:
            for message_id, rate_hz in self.rates.rates_hz(autopilot).items():
                # Payload by pymavlink's struct of the definition, and 12 bytes of header and checksum.
                total += self.share * rate_hz * (mavlink.mavlink_map[message_id].unpacker.size + 12)
        return total + self.others

    def run(self, seconds: int, noise: float = 0.0, generator: random.Random | None = None) -> None:
        """Let time pass, a look each second; the measurement is the mean over the last 5 s."""
        loads = [self.load] * 5
        for _ in range(seconds):
            self.now += 1.0
            loads = [*loads[1:], self.load]
            wobble = 1.0 + noise * (2.0 * generator.random() - 1.0) if generator else 1.0
            self.changes += self.rates.adapt(wobble * sum(loads) / 5, 0.0, self.autopilots, self.now)


def test_without_a_budget_nothing_is_adapted() -> None:
    rates = link(None, 4)
    assert rates.rates_hz(PX4) == FULL
    assert not rates.adapt(1e9, 0.0, [PX4] * 4, 1.0)
    assert rates.problem(1e9) == ""


def test_a_slow_radio_gets_slower_telemetry_and_a_hopeless_one_is_told() -> None:
    slow = link(1500.0, 4).rates_hz(None)
    assert all(slow[i] <= FULL[i] for i in FULL) and slow != FULL
    # Least rates first: a position every other second at least.
    assert slow[POSITION] >= 0.5
    assert link(1500.0, 4).problem(1000.0) == ""
    # 4 aircraft * 2 Hz * 65 bytes of targets alone are 520 byte/s: payload 53, header and checksum 12.
    hopeless = link(500.0, 4).problem(1000.0)
    assert "carries 500 byte/s, too little" in hopeless and "lower setpoint_rate_hz" in hopeless


def test_what_px4_sends_unasked_gives_way_first() -> None:
    # ATTITUDE at 15 Hz alone is 15 * (28 + 12) = 600 byte/s.
    rates = link(1000.0)
    assert mavlink.MAVLINK_MSG_ID_ATTITUDE not in rates.rates_hz(PX4), "not before such an autopilot is heard"
    assert rates.adapt(900.0, 0.0, [PX4], 1.0)
    asked = rates.rates_hz(PX4)
    assert asked[mavlink.MAVLINK_MSG_ID_ATTITUDE] < 15.0
    assert {i: asked[i] for i in WANTED} == FULL
    assert rates.rates_hz(ARDUPILOT) == FULL, "ArduPilot is not asked for what it does not send"


def test_rates_fall_when_others_use_the_link_and_rise_when_they_leave() -> None:
    rates = link(1100.0, 2)
    plant = Plant(rates, [ARDUPILOT, ARDUPILOT])
    plant.run(60)
    calm = rates.rates_hz(ARDUPILOT)
    assert plant.load <= 1100.0
    plant.others = 400.0
    plant.run(60)
    busy = rates.rates_hz(ARDUPILOT)
    assert plant.load <= 1100.0 and rates.problem(plant.load) == ""
    assert busy[POSITION] < calm[POSITION] and all(busy[i] <= calm[i] for i in busy)
    plant.others = 0.0
    plant.run(120)
    again = rates.rates_hz(ARDUPILOT)
    assert again[POSITION] > 1.5 * busy[POSITION]
    assert 0.75 * 1100.0 <= plant.load <= 1100.0


def test_somebody_elses_flood_does_not_take_the_least_telemetry_and_is_told() -> None:
    rates = link(1500.0)
    plant = Plant(rates, [ARDUPILOT])
    plant.others = 5000.0
    plant.run(120)
    assert rates.rates_hz(ARDUPILOT) == pytest.approx(LEAST)
    told = rates.problem(plant.load)
    assert "with telemetry at its least" in told and "ask for less" in told


def test_lost_frames_count_as_load() -> None:
    # 740 byte/s come, two in ten are lost: 925 were sent, which leaves no room for more on a link of 1000.
    rates = link(1000.0, 2)
    assert rates.adapt(1200.0, 0.0, [ARDUPILOT] * 2, 0.0) is False, "those are heard for the first time"
    assert rates.adapt(1200.0, 0.0, [ARDUPILOT] * 2, 1.0)
    before = rates.rates_hz(ARDUPILOT)
    assert not rates.adapt(740.0, 0.2, [ARDUPILOT] * 2, 100.0)
    assert rates.adapt(740.0, 0.0, [ARDUPILOT] * 2, 100.0), "without loss there is room"
    assert rates.rates_hz(ARDUPILOT)[POSITION] > before[POSITION]


def test_a_steady_load_changes_nothing_after_a_while() -> None:
    """Hysteresis: five per cent of noise does not make the rates hunt."""
    generator = random.Random(3)
    plant = Plant(link(2000.0, 3), [ARDUPILOT, ARDUPILOT, PX4])
    plant.others = 300.0
    plant.run(120)
    settled = plant.changes
    plant.run(600, noise=0.05, generator=generator)
    assert plant.changes == settled


@given(
    st.floats(300.0, 6000.0),
    st.lists(st.sampled_from([ARDUPILOT, PX4]), min_size=1, max_size=6),
    st.floats(0.5, 1.0),
    st.lists(st.floats(0.0, 5000.0), min_size=1, max_size=4),
)
@settings(deadline=None, max_examples=60)
def test_properties(budget: float, autopilots: list[Autopilot], share: float, others: list[float]) -> None:
    rates = link(budget, len(autopilots))
    plant = Plant(rates, autopilots, share)
    for load in others:
        plant.others = load
        plant.run(100)
        for autopilot in autopilots:
            asked = rates.rates_hz(autopilot)
            for message_id, rate_hz in asked.items():
                most = FULL.get(message_id, autopilot.unasked_hz.get(message_id, 0.0))
                assert -1e-9 <= rate_hz <= most * (1 + 1e-9)
        at_least = all(rates.rates_hz(ARDUPILOT)[i] <= LEAST[i] + 1e-9 for i in WANTED)
        at_most = all(
            rates.rates_hz(autopilot).get(message_id, rate_hz) >= rate_hz * (1 - 1e-9)
            for autopilot in autopilots
            for message_id, rate_hz in (FULL | dict(autopilot.unasked_hz)).items()
        )
        # In the end there is either room to spare with nothing held back, or the load is right, or nothing is left
        # to take away.
        assert plant.load <= budget * 1.001 or at_least
        assert plant.load >= 0.74 * budget or at_most

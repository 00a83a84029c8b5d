"""What is made of a vehicle's telemetry. Oracle: the field definitions of https://mavlink.io/en/messages/common.html."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from jpap_ros.mavlink.sightings import Sightings
from jpap_ros.mavlink.vehicle import LinkState, Vehicle


def heartbeat(mode: int = 4, armed: bool = True, status: int = mavlink.MAV_STATE_ACTIVE) -> Any:
    base_mode = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0)
    return mavlink.MAVLink_heartbeat_message(2, 3, base_mode, mode, status, 3)


def position(boot_ms: int, lat: int = -378136000, lon: int = 1449631000) -> Any:
    return mavlink.MAVLink_global_position_int_message(boot_ms, lat, lon, 70_500, 50_250, 150, -200, 30, 9_000)


def text(words: str, severity: int = 3, chunk: int = 0, number: int = 0) -> Any:
    return mavlink.MAVLink_statustext_message(severity, words.encode(), number, chunk)


def test_position_in_si_units() -> None:
    vehicle = Vehicle(1)
    vehicle.hear(position(1000), 5.0)
    # By hand: 1e-7 deg, mm, cm/s, cdeg.
    assert vehicle.position is not None
    assert vehicle.position.latitude == pytest.approx(-37.8136, abs=1e-12)
    assert vehicle.position.longitude == pytest.approx(144.9631, abs=1e-12)
    assert (vehicle.position.amsl_m, vehicle.position.relative_m) == (70.5, 50.25)
    assert vehicle.position.velocity_ned == (1.5, -2.0, 0.3)
    assert vehicle.position.yaw_ned == pytest.approx(math.pi / 2)


@pytest.mark.parametrize(("lat", "lon"), [(0, 0), (900_000_001, 0), (0, -1_800_000_001), (-(2**31), 2**31 - 1)])
def test_what_cannot_be_a_position_is_none(lat: int, lon: int) -> None:
    vehicle = Vehicle(1)
    vehicle.hear(position(1000, lat, lon), 5.0)
    assert vehicle.position is None
    for altitude_mm in (0, 2**31 - 1):
        home = mavlink.MAVLink_home_position_message(lat, lon, altitude_mm, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0)
        vehicle.hear(home, 5.0)
    assert vehicle.home is None


def test_a_position_gets_old() -> None:
    vehicle = Vehicle(1)
    vehicle.hear(position(1000), 5.0)
    assert vehicle.position_fresh(9.9)
    assert not vehicle.position_fresh(10.1)


def test_link_is_lost_between_3_5_and_5_s_and_comes_back() -> None:
    vehicle = Vehicle(1)
    assert vehicle.link is LinkState.NEVER_SEEN
    vehicle.update(100.0)
    assert vehicle.link is LinkState.NEVER_SEEN
    vehicle.hear(heartbeat(), 100.0)
    vehicle.update(103.5)
    assert vehicle.link is LinkState.CONNECTED
    vehicle.update(105.0)
    assert vehicle.link is LinkState.LOST
    vehicle.hear(heartbeat(), 106.0)
    assert vehicle.link is LinkState.CONNECTED


def test_boot_time_going_back_is_a_reboot_and_everything_is_forgotten() -> None:
    vehicle = Vehicle(1)
    vehicle.hear(heartbeat(), 0.0)
    assert not vehicle.hear(position(60_000), 0.0)
    vehicle.hear(mavlink.MAVLink_home_position_message(1, 2, 3, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0), 0.0)
    assert vehicle.hear(mavlink.MAVLink_system_time_message(0, 1_500), 8.0)
    assert vehicle.reboots == 1
    assert vehicle.home is None and vehicle.position is None and not vehicle.armed
    assert not vehicle.hear(position(2_000), 8.5)
    assert vehicle.reboots == 1


def test_packets_that_overtake_one_another_are_no_reboot() -> None:
    vehicle = Vehicle(1)
    vehicle.hear(position(60_000), 0.0)
    assert not vehicle.hear(position(59_000), 0.1)
    assert not vehicle.hear(position(60_100), 0.2)
    assert vehicle.reboots == 0


@pytest.mark.parametrize(
    ("landed", "armed", "height_m", "in_air", "on_ground"),
    [
        (mavlink.MAV_LANDED_STATE_ON_GROUND, True, 0.0, False, True),
        (mavlink.MAV_LANDED_STATE_TAKEOFF, True, 3.0, False, False),
        (mavlink.MAV_LANDED_STATE_IN_AIR, True, 10.0, True, False),
        (mavlink.MAV_LANDED_STATE_LANDING, True, 3.0, False, False),
        (mavlink.MAV_LANDED_STATE_UNDEFINED, False, 0.0, False, True),
        (mavlink.MAV_LANDED_STATE_UNDEFINED, True, 10.0, True, False),
    ],
)
def test_in_the_air_or_on_the_ground(landed: int, armed: bool, height_m: float, in_air: bool, on_ground: bool) -> None:
    vehicle = Vehicle(1)
    vehicle.hear(heartbeat(armed=armed), 0.0)
    vehicle.hear(mavlink.MAVLink_extended_sys_state_message(0, landed), 0.0)
    height_mm = round(height_m * 1e3)
    vehicle.hear(mavlink.MAVLink_global_position_int_message(0, 1, 1, height_mm, height_mm, 0, 0, 0, 0), 0.0)
    assert (vehicle.in_air, vehicle.on_ground) == (in_air, on_ground)


def test_battery_and_prearm_check() -> None:
    vehicle = Vehicle(1)
    assert math.isnan(vehicle.battery.remaining) and vehicle.prearm_ok is None
    bit = 0x10000000
    vehicle.hear(mavlink.MAVLink_sys_status_message(bit, bit, 0, 0, 15_900, -1, 87, 0, 0, 0, 0, 0, 0), 0.0)
    assert (vehicle.battery.voltage_v, vehicle.battery.remaining, vehicle.prearm_ok) == (15.9, 0.87, False)
    # 65535 and -1: not known.
    vehicle.hear(mavlink.MAVLink_sys_status_message(bit, bit, bit, 0, 65_535, -1, -1, 0, 0, 0, 0, 0, 0), 0.0)
    assert (vehicle.battery.voltage_v, vehicle.battery.remaining, vehicle.prearm_ok) == (15.9, 0.87, True)
    low = mavlink.MAVLink_battery_status_message(0, 0, 0, 0, [65_535] * 10, -1, -1, -1, 15, 0, 2)
    vehicle.hear(low, 0.0)
    assert (vehicle.battery.remaining, vehicle.battery.charge_state) == (0.15, 2)


def test_geoid_separation() -> None:
    vehicle = Vehicle(1)
    raw = mavlink.MAVLink_gps_raw_int_message(0, 3, 1, 1, 20_000, 0, 0, 0, 0, 9, alt_ellipsoid=25_000)
    vehicle.hear(raw, 0.0)
    assert vehicle.geoid_separation_m == 5.0


def test_words_of_the_autopilot_severe_ones_only_each_once() -> None:
    vehicle = Vehicle(1)
    vehicle.hear(text("Old news"), 1.0)
    vehicle.hear(text("PreArm: GPS 1: Bad fix"), 5.0)
    vehicle.hear(text("PreArm: GPS 1: Bad fix"), 6.0)
    vehicle.hear(text("EKF3 IMU0 initialised", severity=mavlink.MAV_SEVERITY_INFO), 6.0)
    assert vehicle.words_since(4.0) == "PreArm: GPS 1: Bad fix"


def test_words_in_several_chunks() -> None:
    # STATUSTEXT: 50 characters a chunk, one id for all, the last one shorter.
    whole = "Arm: " + "x" * 60 + " end"
    vehicle = Vehicle(1)
    vehicle.hear(text(whole[:50], chunk=0, number=9), 1.0)
    assert vehicle.words_since(0.0) == ""
    vehicle.hear(text(whole[50:], chunk=1, number=9), 1.1)
    assert vehicle.words_since(0.0) == whole


@pytest.mark.parametrize(
    ("boot_s", "rate"),
    [
        # At the pace of ours; and frames that come late by a third.
        ([0.0, 1.0, 2.0, 3.0], 1.0),
        ([0.0, 0.6, 2.7, 3.2], 1.0),
        # Simulations that run faster, the last with frames that come late.
        ([0.0, 5.0, 10.0, 15.0], 5.0),
        ([0.0, 1.6, 3.2, 4.8], 1.6),
        ([0.0, 4.0, 11.0, 15.0], 5.0),
        # Not yet three seconds: not judged.
        ([0.0, 20.0, 40.0], 1.0),
        # A link that stalled for a moment and made it up.
        ([0.0, 0.2, 0.4, 3.0, 4.0, 5.0], 1.0),
        ([0.0, 5.0, 10.0, 10.1, 20.0, 25.0], 1.0),
    ],
)
def test_how_fast_its_clock_runs(boot_s: list[float], rate: float) -> None:
    """Oracle: seconds since its boot per second of ours, by hand over 3 s, each of which must bring 1.5 or more."""
    vehicle = Vehicle(1, simulated_clock=True)
    for second, boot in enumerate(boot_s):
        vehicle.hear(position(1000 + round(boot * 1e3)), 50.0 + second)
    assert vehicle.clock_rate == pytest.approx(rate)


def test_its_clock_is_judged_anew_all_the_time_and_after_a_reboot() -> None:
    vehicle = Vehicle(1, simulated_clock=True)
    for second in range(4):
        vehicle.hear(position(10_000 + 8000 * second), 50.0 + second)
    assert vehicle.clock_rate == 8.0
    vehicle.hear(position(35_000), 54.0)
    assert vehicle.clock_rate == 1.0
    for second in range(4):
        vehicle.hear(position(36_000 + 8000 * second), 55.0 + second)
    assert vehicle.clock_rate == 8.0
    assert vehicle.hear(position(100), 59.0)
    assert vehicle.clock_rate == 1.0


def test_a_real_autopilots_clock_is_never_believed_to_be_fast() -> None:
    """Whatever comes: even ten seconds of frames that come three times as fast, as after a long stall."""
    vehicle = Vehicle(1)
    for quarter in range(40):
        vehicle.hear(position(10_000 + 750 * quarter), 50.0 + quarter / 4)
        assert vehicle.clock_rate == 1.0


def test_a_landed_state_counts_while_it_is_heard() -> None:
    """Oracle: 10 s by hand; without it, armed and 1 m off the ground is in the air."""
    vehicle = Vehicle(1)
    beat = mavlink.MAVLink_heartbeat_message(2, 3, mavlink.MAV_MODE_FLAG_SAFETY_ARMED, 4, 4, 3)
    vehicle.hear(beat, 50.0)
    vehicle.hear(mavlink.MAVLink_extended_sys_state_message(0, mavlink.MAV_LANDED_STATE_IN_AIR), 50.0)
    vehicle.hear(mavlink.MAVLink_global_position_int_message(1000, 1, 1, 300, 300, 0, 0, 0, 0), 50.0)
    for second in (51.0, 59.0):
        vehicle.hear(beat, second)
        vehicle.update(second + 1.0)
        assert vehicle.in_air
    vehicle.update(60.1)
    assert not vehicle.in_air and not vehicle.on_ground
    vehicle.hear(mavlink.MAVLink_global_position_int_message(2000, 1, 1, 5000, 5000, 0, 0, 0, 0), 60.2)
    assert vehicle.in_air


class TestSightings:
    """Oracle: the rule in the class's notes, followed by hand."""

    def test_one_address_is_the_route_until_it_falls_silent(self) -> None:
        sightings: Sightings[str] = Sightings(4.0)
        assert sightings.route(0.0) is None
        sightings.heard(0, "a", 0.0)
        assert sightings.route(3.9) == "a"
        assert sightings.route(4.1) is None

    def test_the_preferred_link_is_used_while_it_is_heard(self) -> None:
        sightings: Sightings[str] = Sightings(4.0)
        sightings.heard(1, "radio", 0.0)
        assert sightings.route(0.0) == "radio"
        sightings.heard(0, "wifi", 0.5)
        assert sightings.route(0.5) == "wifi"
        sightings.heard(1, "radio", 4.0)
        assert sightings.route(4.6) == "radio"
        assert sightings.duplicates(4.6) == ()

    def test_two_addresses_that_beat_in_turn_are_two_vehicles(self) -> None:
        sightings: Sightings[str] = Sightings(4.0)
        for second in range(3):
            sightings.heard(0, "a", second)
            sightings.heard(0, "b", second + 0.5)
        assert set(sightings.duplicates(2.5)) == {"a", "b"}
        assert sightings.route(2.5) is None
        # One of them goes: order is restored.
        for second in range(3, 8):
            sightings.heard(0, "b", second + 0.5)
        assert sightings.duplicates(7.5) == ()
        assert sightings.route(7.5) == "b"

    def test_a_vehicle_that_moves_is_served_at_its_new_address_once_the_old_one_is_silent(self) -> None:
        sightings: Sightings[str] = Sightings(4.0)
        sightings.heard(0, "old", 0.0)
        routes = []
        for second in range(1, 7):
            sightings.heard(0, "new", second)
            routes.append(sightings.route(second))
        assert routes == ["old"] * 4 + ["new"] * 2
        assert sightings.duplicates(7.0) == ()

    def test_while_the_route_is_doubtful_the_other_links_stand_in(self) -> None:
        sightings: Sightings[str] = Sightings(4.0)
        sightings.heard(0, "wifi", 0.0)
        sightings.heard(1, "radio", 0.0)
        sightings.alive("wifi", 0.8)
        assert sightings.stand_ins(1.2) == ()
        # Silent for more than half a second, but not lost yet.
        assert sightings.route(1.4) == "wifi"
        assert sightings.stand_ins(1.4) == ("radio",)
        sightings.alive("wifi", 1.5)
        assert sightings.stand_ins(1.6) == ()
        # The other link was silent all the while, and is forgotten after 4 s; so is the first one.
        assert sightings.stand_ins(3.9) == ("radio",)
        sightings.heard(0, "wifi", 4.1)
        assert sightings.stand_ins(5.0) == ()

    def test_what_does_not_beat_does_not_stand_in(self) -> None:
        sightings: Sightings[str] = Sightings(4.0)
        sightings.heard(0, "wifi", 0.0)
        sightings.alive("stranger", 0.0)
        assert sightings.stand_ins(2.0) == ()

"""Faults of simulated vehicles and of their links."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from sim_bench import ARDUPILOT_MODES, Bench, ardupilot_in_the_air, px4_in_the_air

from jpap_ros.sim import LinkFaults, VehicleOptions
from jpap_ros.sim.ardupilot import ArduPilotVehicle
from jpap_ros.sim.faults import REORDER_HOLD_S, fate
from jpap_ros.sim.px4 import Px4Vehicle

ACCEPTED, TEMPORARILY_REJECTED, FAILED = 0, 1, 4
ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
REQUEST = mavlink.MAV_CMD_REQUEST_MESSAGE
PREARM = mavlink.MAV_SYS_STATUS_PREARM_CHECK


def prearm_is_good(bench: Bench) -> bool:
    """The bit of SYS_STATUS that tells whether the aircraft could be armed."""
    assert bench.command(REQUEST, mavlink.MAVLINK_MSG_ID_SYS_STATUS) == ACCEPTED
    status = bench.last("SYS_STATUS")
    assert status.onboard_control_sensors_present & PREARM
    return bool(status.onboard_control_sensors_health & PREARM)


@pytest.mark.parametrize(("kind", "refusal"), [(ArduPilotVehicle, FAILED), (Px4Vehicle, TEMPORARILY_REJECTED)])
def test_until_gps_is_ready_there_is_no_position_no_home_and_no_arming(kind: type, refusal: int) -> None:
    bench = Bench(kind, gps_delay_s=8.0)
    bench.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 500_000)
    bench.run(5.0)
    assert not prearm_is_good(bench)
    assert bench.command(ARM, 1) == refusal
    assert any("osition" in text for text in bench.texts()), "it says why"
    assert bench.command(REQUEST, mavlink.MAVLINK_MSG_ID_HOME_POSITION) == FAILED
    assert bench.command(REQUEST, mavlink.MAVLINK_MSG_ID_GPS_RAW_INT) == ACCEPTED
    assert bench.last("GPS_RAW_INT").fix_type == mavlink.GPS_FIX_TYPE_NO_FIX
    position = bench.last("GLOBAL_POSITION_INT")
    assert position is None or (position.lat, position.lon) == (0, 0)
    bench.run(4.0)
    assert prearm_is_good(bench)
    assert bench.command(REQUEST, mavlink.MAVLINK_MSG_ID_HOME_POSITION) == ACCEPTED
    assert bench.command(ARM, 1) == ACCEPTED


@pytest.mark.parametrize(("kind", "refusal"), [(ArduPilotVehicle, FAILED), (Px4Vehicle, TEMPORARILY_REJECTED)])
def test_a_failing_prearm_check_refuses_arming_in_its_own_words(kind: type, refusal: int) -> None:
    bench = Bench(kind, prearm_failure="Compass not calibrated")
    assert not prearm_is_good(bench)
    assert bench.command(ARM, 1) == refusal
    assert any("Compass not calibrated" in text for text in bench.texts())
    bench.vehicle.prearm_failure = None
    assert bench.command(ARM, 1) == ACCEPTED


def test_arming_can_be_refused_with_all_checks_good() -> None:
    bench = Bench(ArduPilotVehicle, refuse_arming=True)
    assert prearm_is_good(bench)
    assert bench.command(ARM, 1) == FAILED


def test_arducopter_can_be_armed_by_force() -> None:
    bench = Bench(ArduPilotVehicle, prearm_failure="Compass not calibrated")
    assert bench.command(ARM, 1, 21196) == ACCEPTED


@pytest.mark.parametrize(("make", "mode"), [(ardupilot_in_the_air, "LOITER"), (px4_in_the_air, "POSCTL")])
def test_when_the_pilot_takes_over_the_aircraft_stays_where_it_is(make: object, mode: str) -> None:
    bench: Bench = make()  # type: ignore[operator]
    bench.vehicle.pilot_takes(mode)
    assert bench.vehicle.mode == mode
    bench.send(bench.target(100.0, 0.0, 40.0, 5))
    bench.run(10.0)
    assert bench.at(0.0, 0.0, 20.0)


def test_a_pilot_cannot_choose_a_mode_that_does_not_exist() -> None:
    bench = Bench(ArduPilotVehicle)
    with pytest.raises(ValueError, match=r"mode must be one of .* got 'POSCTL'"):
        bench.vehicle.pilot_takes("POSCTL")


@pytest.mark.parametrize(
    ("make", "charge", "mode", "state"),
    [
        (ardupilot_in_the_air, 0.19, "RTL", mavlink.MAV_BATTERY_CHARGE_STATE_LOW),
        (ardupilot_in_the_air, 0.09, "LAND", mavlink.MAV_BATTERY_CHARGE_STATE_CRITICAL),
        (px4_in_the_air, 0.09, "RTL", mavlink.MAV_BATTERY_CHARGE_STATE_CRITICAL),
        (px4_in_the_air, 0.04, "LAND", mavlink.MAV_BATTERY_CHARGE_STATE_EMERGENCY),
    ],
)
def test_a_low_battery_brings_the_aircraft_down(make: object, charge: float, mode: str, state: int) -> None:
    bench: Bench = make()  # type: ignore[operator]
    bench.vehicle.set_battery(charge)
    bench.run(1.1)
    assert bench.vehicle.mode == mode
    assert bench.command(REQUEST, mavlink.MAVLINK_MSG_ID_BATTERY_STATUS) == ACCEPTED
    assert bench.last("BATTERY_STATUS").charge_state == state
    bench.command(REQUEST, mavlink.MAVLINK_MSG_ID_HEARTBEAT)
    assert bench.last("HEARTBEAT").system_status == mavlink.MAV_STATE_CRITICAL
    bench.run_until(lambda: not bench.vehicle.armed)
    assert bench.vehicle.on_ground


def test_a_low_battery_is_reported_once_and_a_pilot_may_overrule_it() -> None:
    bench = ardupilot_in_the_air()
    bench.vehicle.set_battery(0.19)
    bench.run(1.0)
    bench.vehicle.pilot_takes("LOITER")
    bench.run(5.0)
    assert bench.vehicle.mode == "LOITER"
    assert bench.texts().count("Battery Failsafe") == 1


def test_a_reboot_on_the_ground_forgets_everything_and_starts_the_clock_again() -> None:
    bench = Bench(ArduPilotVehicle)
    kind = mavlink.MAVLINK_MSG_ID_SYSTEM_TIME
    bench.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, kind, 100_000)
    bench.command(mavlink.MAV_CMD_DO_SET_MODE, 1, ARDUPILOT_MODES["GUIDED"])
    bench.run(20.0)
    before = bench.last("SYSTEM_TIME").time_boot_ms
    assert bench.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1) == ACCEPTED
    bench.heard.clear()
    bench.run(2.0)
    assert {m.get_type() for m in bench.heard} == {"HEARTBEAT"}, "the interval asked for is gone"
    assert bench.vehicle.mode == "STABILIZE"
    bench.command(REQUEST, kind)
    assert bench.last("SYSTEM_TIME").time_boot_ms < before


def test_armed_it_does_not_reboot_on_command() -> None:
    bench = ardupilot_in_the_air()
    assert bench.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1) == FAILED
    assert bench.vehicle.armed


@pytest.mark.parametrize("fault", ["reboot", "crash"])
def test_without_its_autopilot_or_a_motor_the_aircraft_falls(fault: str) -> None:
    """Oracle: 20 m of free fall take 2.02 s."""
    bench = ardupilot_in_the_air()
    getattr(bench.vehicle, fault)()
    assert bench.run_until(lambda: bench.vehicle.on_ground) == pytest.approx(2.02, abs=0.05)
    assert not bench.vehicle.armed
    bench.run(1.1)
    emergency = bench.last("HEARTBEAT").system_status == mavlink.MAV_STATE_EMERGENCY
    assert emergency == (fault == "crash")


def test_a_silent_vehicle_neither_hears_nor_acts() -> None:
    bench = Bench(ArduPilotVehicle)
    bench.vehicle.silent = True
    assert bench.command(ARM, 1) is None
    bench.vehicle.silent = False
    assert bench.command(ARM, 1) == ACCEPTED


# Links


def test_the_share_of_frames_lost_doubled_and_late_is_as_asked_for() -> None:
    """Oracle: 20,000 draws; a share p has a standard deviation of sqrt(p(1-p)/n) < 0.0036, here taken five times."""
    faults = LinkFaults(loss=0.3, duplicate=0.1, reorder=0.2, delay_s=0.2, jitter_s=0.1)
    rng, n = random.Random(3), 20_000
    fates = [fate(faults, rng) for _ in range(n)]
    arrived = [copies for copies in fates if copies]
    assert 1 - len(arrived) / n == pytest.approx(0.3, abs=0.018)
    assert sum(len(copies) == 2 for copies in arrived) / len(arrived) == pytest.approx(0.1, abs=0.018)
    delays = [delay for copies in arrived for delay in copies]
    late = sum(delay >= 0.2 + REORDER_HOLD_S for delay in delays) / len(delays)
    assert late == pytest.approx(0.2, abs=0.018)
    assert min(delays) >= 0.2
    assert max(delays) <= 0.3 + REORDER_HOLD_S


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**31), st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_the_same_seed_gives_the_same_faults(seed: int, loss: float, reorder: float) -> None:
    faults = LinkFaults(loss=loss, duplicate=0.5, reorder=reorder, jitter_s=0.1)
    one, two = random.Random(seed), random.Random(seed)
    assert [fate(faults, one) for _ in range(50)] == [fate(faults, two) for _ in range(50)]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"battery": 1.5}, "battery must be from 0 to 1, got 1.5"),
        ({"endurance_s": 0.0}, "endurance_s must be positive, got 0.0"),
        ({"gps_delay_s": -1.0}, "gps_delay_s must not be negative, got -1.0"),
        ({"offboard_loss_mode": "FLY"}, "offboard_loss_mode must be HOLD, RTL or LAND, got 'FLY'"),
        ({"signing_key": b"short"}, "signing_key must have 32 bytes, got 5"),
    ],
)
def test_options_that_make_no_sense_are_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        VehicleOptions(**options)  # type: ignore[arg-type]


@pytest.mark.parametrize("bad", [{"loss": -0.1}, {"duplicate": 1.1}, {"delay_s": -1.0}, {"reorder": float("nan")}])
def test_link_faults_that_make_no_sense_are_refused(bad: dict[str, float]) -> None:
    (name,) = bad
    with pytest.raises(ValueError, match=f"{name} must be"):
        LinkFaults(**bad)

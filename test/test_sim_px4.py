"""The simulated PX4 keeps PX4's rules; `docs/simulated-vehicles.md` gives the source of each."""

from __future__ import annotations

import math
import struct

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from sim_bench import (
    GCS,
    ORIGIN,
    POSITION_ONLY,
    PX4_HOLD,
    PX4_LAND,
    PX4_OFFBOARD,
    PX4_RTL,
    PX4_TAKEOFF,
    STEP_S,
    SYSID,
    VELOCITY_ONLY,
    Bench,
    px4_in_the_air,
)

from jpap_ros.sim.options import Fence
from jpap_ros.sim.px4 import Px4Vehicle

ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED = 0, 1, 2, 3
ARM, TAKEOFF, SET_MODE = mavlink.MAV_CMD_COMPONENT_ARM_DISARM, mavlink.MAV_CMD_NAV_TAKEOFF, mavlink.MAV_CMD_DO_SET_MODE
REPOSITION = mavlink.MAV_CMD_DO_REPOSITION
GLOBAL_INT, RELATIVE_INT, TERRAIN_INT = 5, 6, 11
NAN = math.nan
GROUND = ORIGIN.altitude_amsl_m


class Stream:
    """Sends the same target at a fixed rate while the bench runs."""

    def __init__(self, bench: Bench, message: object, rate_hz: float) -> None:
        self.bench, self.message, self.every = bench, message, round(1 / rate_hz / STEP_S)
        self.steps = 0

    def __call__(self) -> None:
        if self.steps % self.every == 0:
            self.bench.send(self.message)
        self.steps += 1


def offboard(bench: Bench, message: object) -> Stream:
    """Stream for 1.5 s, then switch to OFFBOARD."""
    stream = Stream(bench, message, 5.0)
    bench.run(1.5, stream)
    assert bench.command(SET_MODE, 1, *PX4_OFFBOARD) == ACCEPTED
    return stream


# What it tells


def test_after_boot_it_streams_and_says_what_it_is() -> None:
    """Oracle: HEARTBEAT: quadrotor 2, PX4 12, custom mode main << 16 | sub << 24, which for Hold is 4 and 3."""
    bench = Bench(Px4Vehicle)
    bench.run(4.0)
    beat = bench.last("HEARTBEAT")
    assert (beat.type, beat.autopilot, beat.custom_mode) == (2, 12, 4 << 16 | 3 << 24)
    kinds = {m.get_type() for m in bench.heard}
    assert {"GLOBAL_POSITION_INT", "SYS_STATUS", "EXTENDED_SYS_STATE", "HOME_POSITION", "BATTERY_STATUS"} <= kinds
    assert sum(m.get_type() == "GLOBAL_POSITION_INT" for m in bench.heard) == pytest.approx(20, abs=1)


@pytest.mark.parametrize(
    ("name", "numbers"), [("HOLD", PX4_HOLD), ("RTL", PX4_RTL), ("LAND", PX4_LAND), ("TAKEOFF", PX4_TAKEOFF)]
)
def test_disarmed_every_mode_is_to_be_had_and_shown(name: str, numbers: tuple[int, int]) -> None:
    bench = Bench(Px4Vehicle)
    assert bench.command(SET_MODE, 1, *numbers) == ACCEPTED
    assert bench.vehicle.mode == name
    bench.run(1.1)
    assert bench.last("HEARTBEAT").custom_mode == numbers[0] << 16 | numbers[1] << 24


def test_whole_number_parameters_travel_as_bits() -> None:
    """Oracle: MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE: the float's bits are those of the int32."""
    bench = Bench(Px4Vehicle)
    bench.send(mavlink.MAVLink_param_request_read_message(SYSID, 1, b"MAV_SYS_ID", -1))
    value = bench.last("PARAM_VALUE")
    assert value.param_type == mavlink.MAV_PARAM_TYPE_INT32
    assert struct.pack("<f", value.param_value) == struct.pack("<i", 1)


# Arming and take-off


def test_take_off_altitude_is_above_mean_sea_level_and_it_ends_in_hold() -> None:
    bench = Bench(Px4Vehicle)
    assert bench.command(ARM, 1) == ACCEPTED
    assert bench.command(TAKEOFF, 0, 0, 0, NAN, NAN, NAN, GROUND + 12.0) == ACCEPTED
    bench.run(2.0)
    assert bench.vehicle.mode == "TAKEOFF"
    bench.run_until(lambda: bench.vehicle.mode == "HOLD")
    assert bench.at(0.0, 0.0, 12.0)


@pytest.mark.parametrize("altitude", [NAN, 12.0, GROUND + 1.0])
def test_a_take_off_altitude_too_low_or_missing_becomes_the_least_one(altitude: float) -> None:
    """Oracle: MIS_TAKEOFF_ALT 2.5 m above home. 12 m is what a relative altitude looks like: underground here."""
    bench = Bench(Px4Vehicle)
    bench.command(ARM, 1)
    assert bench.command(TAKEOFF, 0, 0, 0, NAN, NAN, NAN, altitude) == ACCEPTED
    bench.run_until(lambda: bench.vehicle.mode == "HOLD")
    assert bench.at(0.0, 0.0, 2.5)


def test_take_off_asked_for_first_begins_with_arming() -> None:
    bench = Bench(Px4Vehicle)
    assert bench.command(TAKEOFF, 0, 0, 0, NAN, NAN, NAN, GROUND + 12.0) == ACCEPTED
    bench.run(3.0)
    assert bench.vehicle.on_ground
    assert bench.command(ARM, 1) == ACCEPTED
    bench.run_until(lambda: bench.at(0.0, 0.0, 12.0))


def test_it_disarms_itself_after_ten_seconds_on_the_ground() -> None:
    """Oracle: COM_DISARM_PRFLT, 10 s."""
    bench = Bench(Px4Vehicle)
    bench.command(ARM, 1)
    bench.run(9.9)
    assert bench.vehicle.armed
    bench.run(0.2)
    assert not bench.vehicle.armed


def test_in_the_air_it_does_not_disarm() -> None:
    bench = px4_in_the_air()
    assert bench.command(ARM, 0) == TEMPORARILY_REJECTED
    assert bench.vehicle.armed


def test_force_does_not_override_a_failing_check() -> None:
    bench = Bench(Px4Vehicle, prearm_failure="Preflight Fail: Compass not calibrated")
    assert bench.command(ARM, 1, 21196) == TEMPORARILY_REJECTED
    assert not bench.vehicle.armed


# OFFBOARD


def test_in_flight_offboard_is_refused_without_a_stream() -> None:
    bench = px4_in_the_air()
    assert bench.command(SET_MODE, 1, *PX4_OFFBOARD) == TEMPORARILY_REJECTED
    assert bench.vehicle.mode == "HOLD"


def test_a_stream_must_have_lasted_a_second() -> None:
    bench = px4_in_the_air()
    stream = Stream(bench, bench.target(50.0, 0.0, GROUND + 20.0, GLOBAL_INT), 5.0)
    bench.run(0.96, stream)
    assert bench.command(SET_MODE, 1, *PX4_OFFBOARD) == TEMPORARILY_REJECTED
    bench.run(0.1, stream)
    assert bench.command(SET_MODE, 1, *PX4_OFFBOARD) == ACCEPTED


def test_a_stream_with_gaps_over_a_second_is_none() -> None:
    bench = px4_in_the_air()
    stream = Stream(bench, bench.target(50.0, 0.0, GROUND + 20.0, GLOBAL_INT), 0.8)
    bench.run(6.0, stream)
    assert bench.command(SET_MODE, 1, *PX4_OFFBOARD) == TEMPORARILY_REJECTED


def test_on_the_ground_offboard_without_a_stream_is_shown_but_cannot_be_armed_in() -> None:
    bench = Bench(Px4Vehicle)
    assert bench.command(SET_MODE, 1, *PX4_OFFBOARD) == ACCEPTED
    assert bench.command(ARM, 1) == TEMPORARILY_REJECTED
    assert bench.texts() == ["Arming denied: No offboard signal"]


@pytest.mark.parametrize(
    ("frame", "altitude"), [(GLOBAL_INT, GROUND + 45.0), (RELATIVE_INT, 45.0), (TERRAIN_INT, 45.0)]
)
def test_frames_5_6_and_11_are_flown(frame: int, altitude: float) -> None:
    bench = px4_in_the_air()
    stream = offboard(bench, bench.target(60.0, -80.0, altitude, frame))
    while not bench.at(60.0, -80.0, 45.0):
        bench.run(0.2, stream)
        assert bench.now < 1200.0


@pytest.mark.parametrize(
    ("frame", "mask"),
    [(0, POSITION_ONLY), (3, POSITION_ONLY), (10, POSITION_ONLY), (GLOBAL_INT, POSITION_ONLY | 1)],
    ids=["frame 0", "frame 3", "frame 10", "x ignored"],
)
def test_other_frames_and_masks_do_not_even_count_as_a_stream(frame: int, mask: int) -> None:
    bench = px4_in_the_air()
    bench.run(2.0, Stream(bench, bench.target(60.0, -80.0, GROUND + 45.0, frame, mask), 5.0))
    assert bench.command(SET_MODE, 1, *PX4_OFFBOARD) == TEMPORARILY_REJECTED


def test_frame_6_errs_by_twice_the_step_between_home_and_the_estimators_origin() -> None:
    """Oracle: by PX4's own formula z = home - alt - ref; the right one is ref - (home + alt). Home moved up by 10 m."""
    bench = px4_in_the_air()
    bench.vehicle.home = (0.0, 0.0, 10.0)
    stream = offboard(bench, bench.target(0.0, 0.0, 45.0, RELATIVE_INT))
    bench.run(30.0, stream)
    assert bench.vehicle.position[2] == pytest.approx(10.0 + 45.0 - 2 * 10.0)


@pytest.mark.parametrize("after", ["HOLD", "RTL", "LAND"])
def test_a_second_after_the_stream_stopped_the_failsafe_takes_over(after: str) -> None:
    """Oracle: COM_OF_LOSS_T 1 s; MAV_STATE_CRITICAL."""
    bench = px4_in_the_air(offboard_loss_mode=after)
    stream = offboard(bench, bench.target(500.0, 0.0, GROUND + 20.0, GLOBAL_INT))
    bench.run(5.0, stream)
    bench.send(stream.message)
    bench.run(0.9)
    assert bench.vehicle.mode == "OFFBOARD"
    bench.run(0.2)
    assert bench.vehicle.mode == after
    bench.run(1.1)
    assert bench.last("HEARTBEAT").system_status == mavlink.MAV_STATE_CRITICAL
    assert "Failsafe activated: No offboard signal" in bench.texts()
    bench.run(5.0, stream)
    assert bench.vehicle.mode == after, "the stream alone does not bring OFFBOARD back"


def test_offboard_may_resume_with_the_stream_unless_another_mode_was_chosen() -> None:
    bench = px4_in_the_air(offboard_resumes=True)
    stream = offboard(bench, bench.target(500.0, 0.0, GROUND + 20.0, GLOBAL_INT))
    bench.run(2.0)
    assert bench.vehicle.mode == "HOLD"
    bench.run(2.0, stream)
    assert bench.vehicle.mode == "OFFBOARD"
    assert bench.vehicle.failsafe is None
    bench.run(2.0)
    assert bench.command(SET_MODE, 1, *PX4_HOLD) == ACCEPTED
    bench.run(2.0, stream)
    assert bench.vehicle.mode == "HOLD"


def test_in_offboard_the_echo_is_local_and_not_global() -> None:
    """Oracle: the global one is the navigator's, which rests in OFFBOARD; local is north, east, down."""
    bench = px4_in_the_air()
    stream = offboard(bench, bench.target(60.0, 80.0, GROUND + 30.0, GLOBAL_INT))
    bench.run(1.0, stream)
    bench.heard.clear()
    bench.run(4.0, stream)
    assert bench.last("POSITION_TARGET_GLOBAL_INT") is None
    local = bench.last("POSITION_TARGET_LOCAL_NED")
    assert (local.x, local.y, local.z) == pytest.approx((80.0, 60.0, -30.0), abs=0.02)


def test_armed_on_the_ground_a_target_in_offboard_lifts_off() -> None:
    bench = Bench(Px4Vehicle)
    stream = Stream(bench, bench.target(0.0, 0.0, GROUND + 10.0, GLOBAL_INT), 5.0)
    bench.run(1.5, stream)
    assert bench.command(SET_MODE, 1, *PX4_OFFBOARD) == ACCEPTED
    assert bench.command(ARM, 1) == ACCEPTED
    bench.run(15.0, stream)
    assert bench.at(0.0, 0.0, 10.0)


def test_a_velocity_in_offboard_is_flown_while_it_streams() -> None:
    """Oracle: NED: vx is north. 5 m/s for 10 s, less v²/(2a) = 5 m of acceleration."""
    bench = px4_in_the_air()
    message = bench.target(0.0, 0.0, 0.0, GLOBAL_INT, VELOCITY_ONLY)
    message.vx = 5.0
    stream = offboard(bench, message)
    bench.run(10.0, stream)
    assert bench.vehicle.position == pytest.approx((0.0, 45.0, 20.0), abs=2.0)


def test_a_moving_target_is_overrun_by_what_the_position_controller_allows() -> None:
    """Oracle: a standing target with velocity v is balanced by the error v / MPC_XY_P: 5 / 0.95 = 5.26 m."""
    bench = px4_in_the_air(offboard_loss_s=60.0)
    offboard(bench, bench.target(0.0, 0.0, GROUND + 20.0, GLOBAL_INT))
    message = bench.target(0.0, 0.0, GROUND + 20.0, GLOBAL_INT, POSITION_ONLY & ~0b111000)
    message.vy = 5.0
    bench.send(message)
    bench.run(30.0)
    assert bench.vehicle.mode == "OFFBOARD"
    assert bench.vehicle.position == pytest.approx((5.26, 0.0, 20.0), abs=0.01)


# DO_REPOSITION


def reposition(bench: Bench, east: float, north: float, amsl: float, flags: int = 1) -> int | None:
    there = bench.target(east, north, amsl, GLOBAL_INT)
    return bench.command_int(REPOSITION, GLOBAL_INT, -1, flags, 0, NAN, x=there.lat_int, y=there.lon_int, z=amsl)


def test_reposition_flies_in_hold_persists_and_is_echoed() -> None:
    bench = px4_in_the_air()
    assert reposition(bench, 300.0, 400.0, GROUND + 50.0) == ACCEPTED
    bench.run(2.0)
    wanted, echo = bench.target(300.0, 400.0, 0.0, 5), bench.last("POSITION_TARGET_GLOBAL_INT")
    assert (echo.lat_int, echo.lon_int) == (wanted.lat_int, wanted.lon_int)
    assert echo.alt == pytest.approx(GROUND + 50.0)
    assert bench.vehicle.mode == "HOLD"
    bench.run_until(lambda: bench.at(300.0, 400.0, 50.0))


def test_reposition_without_the_mode_flag_is_not_supported() -> None:
    bench = px4_in_the_air()
    assert reposition(bench, 30.0, 40.0, GROUND + 50.0, flags=0) == UNSUPPORTED


def test_reposition_out_of_the_fence_is_accepted_and_yet_not_flown() -> None:
    bench = px4_in_the_air(fence=Fence(radius_m=100.0))
    assert reposition(bench, 300.0, 400.0, GROUND + 50.0) == ACCEPTED
    bench.run(20.0)
    assert bench.at(0.0, 0.0, 20.0)
    assert "Reposition is outside geofence" in bench.texts()


# Going home


@pytest.mark.parametrize(("distance", "height"), [(200.0, 60.0), (30.0, 30.0), (10.0, 20.0)])
def test_return_flies_home_as_high_as_its_cone_demands(distance: float, height: float) -> None:
    """Oracle: RTL_RETURN_ALT 60 m, under a cone of 45° (as high as home is far), never lower than it is."""
    bench = px4_in_the_air()
    reposition(bench, distance, 0.0, GROUND + 20.0)
    bench.run_until(lambda: bench.at(distance, 0.0, 20.0))
    assert bench.command(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH) == ACCEPTED
    highest = 0.0

    def watch() -> None:
        nonlocal highest
        highest = max(highest, bench.vehicle.position[2])

    while bench.vehicle.armed:
        bench.run(0.2, watch)
    assert highest == pytest.approx(height, abs=0.1)
    assert bench.vehicle.position == pytest.approx((0.0, 0.0, 0.0), abs=0.01)
    assert bench.vehicle.mode == "HOLD"


def test_the_data_link_failsafe_returns_home() -> None:
    bench = px4_in_the_air(gcs_failsafe_s=10.0)
    beat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, 8, 0, 0, 0, 3)
    bench.send(beat, GCS)
    bench.run(9.9)
    assert bench.vehicle.mode == "HOLD"
    bench.run(0.2)
    assert bench.vehicle.mode == "RTL"

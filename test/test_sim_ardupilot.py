"""The simulated ArduCopter keeps ArduCopter's rules; `docs/simulated-vehicles.md` gives the source of each."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from sim_bench import (
    ARDUPILOT_MODES,
    BRIDGE,
    GCS,
    ORIGIN,
    POSITION_ONLY,
    SYSID,
    VELOCITY_ONLY,
    Bench,
    ardupilot_in_the_air,
)

from jpap_ros.sim.ardupilot import ArduPilotVehicle
from jpap_ros.sim.options import Fence

ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4
COMMAND_LONG_ONLY, COMMAND_INT_ONLY = 7, 8
ARM, TAKEOFF, SET_MODE = mavlink.MAV_CMD_COMPONENT_ARM_DISARM, mavlink.MAV_CMD_NAV_TAKEOFF, mavlink.MAV_CMD_DO_SET_MODE
INTERVAL, REPOSITION = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_DO_REPOSITION
GLOBAL, RELATIVE, GLOBAL_INT, RELATIVE_INT, TERRAIN_INT = 0, 3, 5, 6, 11
ECHO = mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT


def set_mode(bench: Bench, mode: str) -> int | None:
    return bench.command(SET_MODE, 1, ARDUPILOT_MODES[mode])


# Before flight


def test_after_boot_only_the_heartbeat_is_sent_and_says_what_it_is() -> None:
    """Oracle: MAVLink HEARTBEAT: quadrotor 2, ArduPilot 3, custom mode enabled 1; STABILIZE 0; STANDBY 3; 1 Hz."""
    bench = Bench(ArduPilotVehicle)
    bench.run(10.0)
    assert {m.get_type() for m in bench.heard} == {"HEARTBEAT"}
    assert len(bench.heard) == pytest.approx(10, abs=1)
    beat = bench.last("HEARTBEAT")
    assert (beat.type, beat.autopilot, beat.custom_mode, beat.system_status) == (2, 3, 0, 3)
    assert beat.base_mode & 1
    assert not beat.base_mode & 128
    assert (beat.get_srcSystem(), beat.get_srcComponent()) == (SYSID, 1)
    assert beat.get_msgbuf()[0] == 0xFD, "MAVLink 2"


def test_take_off_needs_guided_and_arming_and_is_relative_to_home() -> None:
    bench = Bench(ArduPilotVehicle)
    assert bench.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 15) == FAILED
    assert bench.command(ARM, 1) == ACCEPTED
    assert bench.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 15) == FAILED, "armed, but in STABILIZE"
    assert set_mode(bench, "GUIDED") == ACCEPTED
    assert bench.command(TAKEOFF, 0, 0, 0, 0, 0, 0, -1) == FAILED
    assert bench.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 15) == ACCEPTED
    bench.run(3.0)
    assert bench.vehicle.landed_state() == mavlink.MAV_LANDED_STATE_TAKEOFF
    bench.run_until(lambda: bench.at(0.0, 0.0, 15.0))
    assert bench.vehicle.landed_state() == mavlink.MAV_LANDED_STATE_IN_AIR
    assert bench.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 30) == FAILED, "already in the air"


def test_take_off_as_command_int_takes_only_a_relative_frame() -> None:
    bench = Bench(ArduPilotVehicle)
    set_mode(bench, "GUIDED")
    bench.command(ARM, 1)
    assert bench.command_int(TAKEOFF, GLOBAL, 0, 0, 0, 0, x=0, y=0, z=15) == DENIED
    assert bench.command_int(TAKEOFF, RELATIVE, 0, 0, 0, 0, x=0, y=0, z=15) == ACCEPTED


@pytest.mark.parametrize("mode", ["RTL", "LAND"])
def test_some_modes_cannot_be_armed_in(mode: str) -> None:
    bench = Bench(ArduPilotVehicle)
    assert set_mode(bench, mode) == ACCEPTED, "disarmed, every mode is to be had"
    assert bench.command(ARM, 1) == FAILED
    assert bench.texts() == [f"Arm: {mode} mode not armable"]


def test_it_disarms_itself_after_ten_seconds_on_the_ground() -> None:
    """Oracle: DISARM_DELAY, 10 s."""
    bench = Bench(ArduPilotVehicle)
    bench.command(ARM, 1)
    bench.run(9.9)
    assert bench.vehicle.armed
    bench.run(0.2)
    assert not bench.vehicle.armed


def test_in_the_air_it_does_not_disarm_unless_forced() -> None:
    bench = ardupilot_in_the_air()
    assert bench.command(ARM, 0) == FAILED
    assert bench.vehicle.armed
    assert bench.command(ARM, 0, 21196) == ACCEPTED
    bench.run_until(lambda: bench.vehicle.on_ground, 10.0)


def test_an_unknown_mode_and_an_unknown_command_are_refused() -> None:
    bench = Bench(ArduPilotVehicle)
    assert bench.command(SET_MODE, 1, 99) == FAILED
    assert bench.command(SET_MODE, 0, 4) == UNSUPPORTED, "base modes alone are not supported"
    assert bench.command(mavlink.MAV_CMD_NAV_VTOL_TAKEOFF) == UNSUPPORTED
    assert bench.vehicle.mode == "STABILIZE"


def test_commands_for_another_system_or_component_are_not_for_it() -> None:
    bench = Bench(ArduPilotVehicle)
    assert bench.command(ARM, 1, target=SYSID + 1) is None
    gimbal = mavlink.MAVLink_command_long_message(SYSID, 154, ARM, 0, 1, 0, 0, 0, 0, 0, 0)
    bench.send(gimbal)
    assert not bench.vehicle.armed
    assert bench.last("COMMAND_ACK") is None
    assert bench.command(ARM, 1, target=0) == ACCEPTED, "0 is for all"


# Position targets


@pytest.mark.parametrize(
    ("frame", "altitude"),
    # 45 m above home at 20 m above mean sea level.
    [(GLOBAL, 65.0), (GLOBAL_INT, 65.0), (RELATIVE, 45.0), (RELATIVE_INT, 45.0), (TERRAIN_INT, 45.0)],
)
def test_both_families_of_frames_are_flown(frame: int, altitude: float) -> None:
    """Oracle: the definition of each MAV_FRAME's altitude."""
    bench = ardupilot_in_the_air()
    bench.send(bench.target(120.0, -50.0, altitude, frame))
    took = bench.run_until(lambda: bench.at(120.0, -50.0, 45.0))
    assert took == pytest.approx(130 / 10 + 10 / 2.5, abs=0.2), "trapezoidal profile over 130 m"


def test_a_target_is_echoed_as_it_was_sent_with_its_altitude_above_mean_sea_level() -> None:
    bench = ardupilot_in_the_air()
    assert bench.command(INTERVAL, ECHO, 500_000) == ACCEPTED
    bench.run(2.0)
    assert bench.last("POSITION_TARGET_GLOBAL_INT") is None, "nobody has sent a target yet"
    target = bench.target(120.0, -50.0, 45.0, RELATIVE_INT)
    bench.send(target)
    bench.run(1.0)
    echo = bench.last("POSITION_TARGET_GLOBAL_INT")
    assert (echo.lat_int, echo.lon_int) == (target.lat_int, target.lon_int)
    assert echo.alt == pytest.approx(65.0)
    assert (echo.coordinate_frame, echo.type_mask & 0b110111111111) == (GLOBAL, POSITION_ONLY)
    set_mode(bench, "LOITER")
    bench.heard.clear()
    bench.run(2.0)
    assert bench.last("POSITION_TARGET_GLOBAL_INT") is None, "LOITER has no waypoint"


@pytest.mark.parametrize("mode", ["LOITER", "RTL", "LAND"])
def test_outside_guided_a_target_is_dropped_without_a_word(mode: str) -> None:
    bench = ardupilot_in_the_air()
    set_mode(bench, mode)
    doing = bench.vehicle.manoeuvre
    heard = len(bench.heard)
    bench.send(bench.target(120.0, -50.0, 45.0, RELATIVE_INT))
    assert bench.vehicle.manoeuvre is doing
    assert len(bench.heard) == heard
    assert bench.vehicle.received[-1].kind == "SET_POSITION_TARGET_GLOBAL_INT", "it did arrive"


@pytest.mark.parametrize(
    ("frame", "mask"),
    [
        (mavlink.MAV_FRAME_LOCAL_NED, POSITION_ONLY),
        (mavlink.MAV_FRAME_MISSION, POSITION_ONLY),
        (RELATIVE_INT, POSITION_ONLY | 1),
        (RELATIVE_INT, POSITION_ONLY | 4),
        (RELATIVE_INT, 0b111111111111),
        (RELATIVE_INT, 0b001000111000 | 512),
    ],
    ids=["local frame", "mission frame", "x ignored", "z ignored", "all ignored", "force"],
)
def test_a_target_that_cannot_be_flown_stops_the_aircraft(frame: int, mask: int) -> None:
    """Oracle: it comes to rest v²/(2a) = 20 m after the bad target, far from either goal."""
    bench = ardupilot_in_the_air()
    bench.send(bench.target(500.0, 0.0, 20.0, RELATIVE_INT))
    bench.run_until(lambda: bench.vehicle.body.speed == pytest.approx(10.0))
    began = bench.vehicle.position[0]
    bench.send(bench.target(0.0, 500.0, 20.0, frame, mask))
    bench.run(10.0)
    assert bench.at(began + 20.0, 0.0, 20.0, within=0.3)


@pytest.mark.parametrize("altitude", [math.nan, math.inf])
def test_an_altitude_that_is_no_number_stops_the_aircraft(altitude: float) -> None:
    bench = ardupilot_in_the_air()
    bench.send(bench.target(500.0, 0.0, altitude, RELATIVE_INT))
    bench.run(5.0)
    assert bench.at(0.0, 0.0, 20.0)


def test_outside_its_fence_the_old_goal_stays() -> None:
    bench = ardupilot_in_the_air(fence=Fence(radius_m=100.0, max_height_m=60.0))
    bench.send(bench.target(80.0, 0.0, 30.0, RELATIVE_INT))
    bench.send(bench.target(101.0, 0.0, 30.0, RELATIVE_INT))
    bench.send(bench.target(50.0, 0.0, 61.0, RELATIVE_INT))
    bench.run_until(lambda: bench.at(80.0, 0.0, 30.0))


def test_a_position_target_is_flown_to_the_end_after_its_sender_died() -> None:
    """Oracle: GUID_TIMEOUT is for velocities. One target, then silence for the whole 100 s flight."""
    bench = ardupilot_in_the_air()
    bench.send(bench.target(900.0, 0.0, 20.0, RELATIVE_INT))
    bench.run_until(lambda: bench.at(900.0, 0.0, 20.0), 100.0)


def test_a_velocity_target_lasts_three_seconds() -> None:
    """Oracle: GUID_TIMEOUT 3 s. 5 m/s after 2 s, braked from 3 s on: 5·3 - 5·2/2 + 5²/(2·2.5) = 15 m."""
    bench = ardupilot_in_the_air()
    message = bench.target(0.0, 0.0, 0.0, RELATIVE_INT, VELOCITY_ONLY)
    message.vx = 5.0
    bench.send(message)
    bench.run(10.0)
    assert bench.vehicle.body.speed == 0.0
    assert bench.vehicle.position == pytest.approx((0.0, 15.0, 20.0), abs=0.2)


@pytest.mark.parametrize(("speedup", "metres"), [(1.0, 15.0), (4.0, 15.0), (10.0, 30.0)])
def test_a_moving_target_moves_on_for_three_seconds_and_is_held_there(speedup: float, metres: float) -> None:
    """Oracle: 5 m/s of the aircraft's own time for GUID_TIMEOUT, 3 s of it; at ten times the speed 0.6 s of the wall
    clock, which are 6 s of its own.
    """
    bench = ardupilot_in_the_air()
    bench.vehicle.speedup = speedup
    message = bench.target(0.0, 0.0, 20.0, RELATIVE_INT, POSITION_ONLY & ~0b111000)
    message.vy = 5.0 * speedup
    bench.send(message)
    bench.run(30.0)
    assert bench.at(metres, 0.0, 20.0)


def test_a_change_of_mode_is_told_at_once() -> None:
    bench = ardupilot_in_the_air()
    before = len(bench.heard)
    bench.vehicle.pilot_takes("LOITER")
    bench.run(0.02)
    beats = [m.custom_mode for m in bench.heard[before:] if m.get_type() == "HEARTBEAT"]
    assert beats[:1] == [ARDUPILOT_MODES["LOITER"]]


def test_a_yaw_in_the_target_is_held() -> None:
    """Oracle: MAVLink yaw is clockwise from north; without one the aircraft looks where it flies (east: 90°)."""
    bench = ardupilot_in_the_air()
    bench.send(bench.target(100.0, 0.0, 20.0, RELATIVE_INT))
    bench.run(5.0)
    assert math.degrees(bench.vehicle.body.yaw) == pytest.approx(90.0, abs=0.01)
    message = bench.target(100.0, 0.0, 20.0, RELATIVE_INT, POSITION_ONLY & ~1024)
    message.yaw = math.radians(-60.0)
    bench.send(message)
    bench.run(5.0)
    assert math.degrees(bench.vehicle.body.yaw) == pytest.approx(-60.0, abs=0.01)


def test_a_target_on_the_ground_takes_the_take_off_away() -> None:
    bench = Bench(ArduPilotVehicle)
    set_mode(bench, "GUIDED")
    bench.command(ARM, 1)
    bench.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 15)
    bench.run(0.5)
    bench.send(bench.target(50.0, 0.0, 20.0, RELATIVE_INT))
    bench.run(5.0)
    assert bench.vehicle.on_ground
    assert bench.vehicle.position == (0.0, 0.0, 0.0)


def test_a_local_target_counts_from_the_estimators_origin() -> None:
    """Oracle: LOCAL_NED, north 30, east 40, down -25, for an aircraft that booted at (100, 200)."""
    bench = Bench(ArduPilotVehicle, start=(100.0, 200.0))
    set_mode(bench, "GUIDED")
    bench.command(ARM, 1)
    bench.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 15)
    bench.run_until(lambda: bench.at(100.0, 200.0, 15.0))
    bench.send(
        mavlink.MAVLink_set_position_target_local_ned_message(
            0, SYSID, 1, mavlink.MAV_FRAME_LOCAL_NED, POSITION_ONLY, 30.0, 40.0, -25.0, *(0.0,) * 8
        )
    )
    bench.run_until(lambda: bench.at(140.0, 230.0, 25.0))


# DO_REPOSITION


def test_reposition_is_acknowledged_flown_and_needs_the_flag_to_leave_another_mode() -> None:
    bench = ardupilot_in_the_air()
    set_mode(bench, "LOITER")
    wanted = bench.target(60.0, 80.0, 40.0, RELATIVE)
    there = {"x": wanted.lat_int, "y": wanted.lon_int, "z": 40.0}
    assert bench.command_int(REPOSITION, RELATIVE, -1, 0, 0, 0, **there) == DENIED
    assert bench.vehicle.mode == "LOITER"
    assert bench.command_int(REPOSITION, RELATIVE, -1, 1, 0, 0, **there) == ACCEPTED
    assert bench.vehicle.mode == "GUIDED"
    bench.run_until(lambda: bench.at(60.0, 80.0, 40.0))


def test_reposition_as_command_long_is_above_mean_sea_level() -> None:
    """Oracle: 60 m above mean sea level are 40 m above the ground; float32 degrees are good to a metre here."""
    bench = ardupilot_in_the_air()
    lat, lon = bench.frame.to_geodetic(60.0, 80.0)
    assert bench.command(REPOSITION, -1, 1, 0, 0, lat, lon, 60) == ACCEPTED
    bench.run_until(lambda: bench.at(60.0, 80.0, 40.0, within=1.5))


def test_old_firmware_takes_a_command_in_one_kind_only() -> None:
    bench = Bench(ArduPilotVehicle, int_only=frozenset({REPOSITION}), long_only=frozenset({TAKEOFF}))
    assert bench.command(REPOSITION, -1, 1, 0, 0, -37.8, 144.9, 40) == COMMAND_INT_ONLY
    assert bench.command_int(TAKEOFF, RELATIVE, 0, 0, 0, 0, x=0, y=0, z=15) == COMMAND_LONG_ONLY


def test_reposition_out_of_the_fence_fails_and_changes_nothing() -> None:
    bench = ardupilot_in_the_air(fence=Fence(radius_m=100.0))
    set_mode(bench, "LOITER")
    wanted = bench.target(200.0, 0.0, 40.0, RELATIVE)
    there = {"x": wanted.lat_int, "y": wanted.lon_int, "z": 40.0}
    assert bench.command_int(REPOSITION, RELATIVE, -1, 1, 0, 0, **there) == FAILED
    assert bench.vehicle.mode == "LOITER"


# Going home


def test_return_climbs_flies_home_waits_lands_and_disarms() -> None:
    """Oracle: RTL_ALT 15 m and RTL_LOIT_TIME 5 s; profile times for each leg; LAND_SPEED 0.5 m/s below 10 m."""
    bench = ardupilot_in_the_air(height=10.0)
    bench.send(bench.target(200.0, 0.0, 10.0, RELATIVE_INT))
    bench.run_until(lambda: bench.at(200.0, 0.0, 10.0))
    assert bench.command(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH) == ACCEPTED
    assert bench.vehicle.mode == "RTL"
    highest = 0.0

    def watch() -> None:
        nonlocal highest
        highest = max(highest, bench.vehicle.position[2])

    began = bench.now
    while bench.vehicle.armed:
        bench.run(0.1, watch)
    assert highest == pytest.approx(15.0)
    assert bench.vehicle.position == pytest.approx((0.0, 0.0, 0.0), abs=0.01)
    climb, leg = 2 * math.sqrt(5.0), 200 / 10 + 4
    descent = 5 / 1.5 + 1.5 + 10 / 0.5
    assert bench.now - began == pytest.approx(climb + leg + 5 + descent + 1, abs=3.0)


def test_land_comes_down_where_it_is_and_disarms() -> None:
    bench = ardupilot_in_the_air()
    assert bench.command(mavlink.MAV_CMD_NAV_LAND) == ACCEPTED
    bench.run(2.0)
    assert bench.vehicle.landed_state() == mavlink.MAV_LANDED_STATE_LANDING
    bench.run_until(lambda: not bench.vehicle.armed, 120.0)
    assert bench.vehicle.position == (0.0, 0.0, 0.0)
    assert bench.vehicle.landed_state() == mavlink.MAV_LANDED_STATE_ON_GROUND


# Who may command


def test_with_sysid_enforce_others_are_heard_and_never_obeyed() -> None:
    bench = Bench(ArduPilotVehicle, sysid_enforce=True, gcs_sysid=GCS[0])
    assert bench.command(ARM, 1, source=BRIDGE) is None
    assert not bench.vehicle.armed
    assert bench.vehicle.received[-1].source == BRIDGE
    assert bench.command(ARM, 1, source=GCS) == ACCEPTED


def test_the_ground_station_failsafe_returns_home_once_a_known_one_is_gone() -> None:
    """Oracle: FS_GCS_TIMEOUT 5 s; without ever a heartbeat there is no failsafe."""
    bench = ardupilot_in_the_air(gcs_failsafe_s=5.0)
    bench.run(10.0)
    assert bench.vehicle.mode == "GUIDED"
    beat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, 8, 0, 0, 0, 3)
    bench.send(beat, GCS)
    bench.run(4.9)
    assert bench.vehicle.mode == "GUIDED"
    bench.run(0.2)
    assert bench.vehicle.mode == "RTL"
    bench.run(1.0)
    assert bench.last("HEARTBEAT").system_status == mavlink.MAV_STATE_CRITICAL


# What it tells


def test_what_it_tells_of_its_position_agrees_with_where_it_is() -> None:
    """Oracle: message definitions: mm, cm/s, cdeg, NED; MSL from the origin's 20 m; ellipsoid 25 m further."""
    bench = ardupilot_in_the_air()
    bench.send(bench.target(400.0, 300.0, 50.0, RELATIVE_INT))
    bench.run(8.0)
    wanted = ["GLOBAL_POSITION_INT", "GPS_RAW_INT", "LOCAL_POSITION_NED", "HOME_POSITION", "GPS_GLOBAL_ORIGIN"]
    for name in wanted:
        kind = getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
        assert bench.command(mavlink.MAV_CMD_REQUEST_MESSAGE, kind) == ACCEPTED
    east, north, up = bench.vehicle.position
    position, gps = bench.last("GLOBAL_POSITION_INT"), bench.last("GPS_RAW_INT")
    for message in (position, gps):
        assert bench.frame.to_map(message.lat / 1e7, message.lon / 1e7) == pytest.approx((east, north), abs=0.02)
        assert message.alt / 1000 == pytest.approx(20.0 + up, abs=0.001)
    assert position.relative_alt / 1000 == pytest.approx(up, abs=0.001)
    assert gps.alt_ellipsoid - gps.alt == 25_000
    assert (position.vx, position.vy) == pytest.approx((600, 800), abs=1), "10 m/s towards (0.8 east, 0.6 north)"
    assert position.hdg == pytest.approx(5313, abs=1), "atan(400/300)"
    local = bench.last("LOCAL_POSITION_NED")
    assert (local.x, local.y, local.z) == pytest.approx((north, east, -up), abs=1e-3)
    home, origin = bench.last("HOME_POSITION"), bench.last("GPS_GLOBAL_ORIGIN")
    assert (home.latitude, home.longitude) == (round(ORIGIN.latitude * 1e7), round(ORIGIN.longitude * 1e7))
    assert home.altitude == origin.altitude == 20_000


def test_message_intervals_are_kept_reported_and_taken_back() -> None:
    """Oracle: the interval asked for, in µs; -1 stops, 0 is the default, which for ArduCopter is silence."""
    bench = Bench(ArduPilotVehicle)
    kind = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT

    def count() -> int:
        return sum(m.get_type() == "GLOBAL_POSITION_INT" for m in bench.heard)

    assert bench.command(INTERVAL, kind, 200_000) == ACCEPTED
    bench.run(10.0)
    assert count() == pytest.approx(50, abs=2)
    assert bench.command(mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, kind) == ACCEPTED
    assert bench.last("MESSAGE_INTERVAL").interval_us == 200_000
    for stop in (-1, 0):
        assert bench.command(INTERVAL, kind, stop) == ACCEPTED
        before = count()
        bench.run(5.0)
        assert count() == before
        assert bench.command(INTERVAL, kind, 200_000) == ACCEPTED
    assert bench.command(INTERVAL, 9999, 200_000) == DENIED
    assert bench.command(INTERVAL, kind, math.nan) == DENIED


def test_data_streams_are_the_older_way_to_ask() -> None:
    bench = Bench(ArduPilotVehicle)
    bench.send(mavlink.MAVLink_request_data_stream_message(SYSID, 1, mavlink.MAV_DATA_STREAM_POSITION, 4, 1))
    bench.run(5.0)
    positions = sum(m.get_type() == "GLOBAL_POSITION_INT" for m in bench.heard)
    assert positions == pytest.approx(20, abs=2)


def test_the_battery_drains_with_flight_time() -> None:
    """Oracle: endurance 1000 s, so 100 s of hovering take a tenth."""
    bench = ardupilot_in_the_air(endurance_s=1000.0)
    before = bench.vehicle.battery
    bench.run(100.0)
    assert before - bench.vehicle.battery == pytest.approx(0.1, abs=1e-6)
    bench.command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_BATTERY_STATUS)
    battery = bench.last("BATTERY_STATUS")
    assert battery.battery_remaining == round(100 * bench.vehicle.battery)
    assert battery.charge_state == mavlink.MAV_BATTERY_CHARGE_STATE_OK
    assert sum(v for v in battery.voltages if v != 0xFFFF) / 1000 == pytest.approx(4 * (3.5 + 0.7 * 0.9), abs=0.1)


def test_what_a_ground_station_asks_for_is_answered() -> None:
    """Oracle: parameter protocol, mission protocol and TIMESYNC as the MAVLink guide describes them."""
    bench = Bench(ArduPilotVehicle)
    bench.send(mavlink.MAVLink_param_request_list_message(SYSID, 1))
    values = [m for m in bench.heard if m.get_type() == "PARAM_VALUE"]
    assert [v.param_index for v in values] == list(range(values[0].param_count))
    bench.send(mavlink.MAVLink_param_set_message(SYSID, 1, b"RTL_ALT", 2500.0, mavlink.MAV_PARAM_TYPE_REAL32))
    assert (bench.last("PARAM_VALUE").param_id, bench.last("PARAM_VALUE").param_value) == ("RTL_ALT", 2500.0)
    bench.send(mavlink.MAVLink_mission_request_list_message(SYSID, 1))
    assert bench.last("MISSION_COUNT").count == 0
    bench.send(mavlink.MAVLink_timesync_message(0, 123456789))
    assert bench.last("TIMESYNC").ts1 == 123456789
    assert bench.last("TIMESYNC").tc1 > 0 or bench.vehicle.clock_s == 0.0
    assert bench.command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION) == ACCEPTED
    assert bench.last("AUTOPILOT_VERSION").capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2

"""Both personalities. Oracle: values worked out by hand from the message definitions and the autopilots' mode tables

(https://ardupilot.org/copter/docs/parameters.html#fltmode1, https://docs.px4.io/main/en/mavlink/standard_modes,
https://mavlink.io/en/messages/common.html#POSITION_TARGET_TYPEMASK).
"""

from __future__ import annotations

import math

import pytest

from jpap_ros.mavlink.autopilots import (
    REGISTRY,
    AltitudeDatum,
    Autopilot,
    Target,
    TargetError,
    Transport,
    by_heartbeat,
)
from jpap_ros.mavlink.vehicle import Home, Vehicle

ARDUPILOT, PX4 = REGISTRY["ardupilot"], REGISTRY["px4"]
TARGET = Target(-37.8136, 144.9631, height_m=50.0, amsl_m=70.0)


def vehicle(home_amsl_m: float | None = 33.0) -> Vehicle:
    made = Vehicle(7)
    if home_amsl_m is not None:
        made.home = Home(-37.8136, 144.9631, home_amsl_m)
    return made


def test_the_heartbeat_decides() -> None:
    assert by_heartbeat(3) is ARDUPILOT
    assert by_heartbeat(12) is PX4
    assert by_heartbeat(0) is None


@pytest.mark.parametrize(
    ("autopilot", "name", "number"),
    [
        (ARDUPILOT, "STABILIZE", 0),
        (ARDUPILOT, "GUIDED", 4),
        (ARDUPILOT, "LOITER", 5),
        (ARDUPILOT, "RTL", 6),
        (ARDUPILOT, "LAND", 9),
        (ARDUPILOT, "BRAKE", 17),
        (PX4, "POSCTL", 3 << 16),
        (PX4, "OFFBOARD", 6 << 16),
        (PX4, "AUTO.TAKEOFF", 0x02040000),
        (PX4, "AUTO.LOITER", 0x03040000),
        (PX4, "AUTO.RTL", 0x05040000),
        (PX4, "AUTO.LAND", 0x06040000),
    ],
)
def test_mode_numbers_both_ways(autopilot: Autopilot, name: str, number: int) -> None:
    assert autopilot.modes[name] == number
    assert autopilot.mode_name(number) == name


def test_an_unknown_mode_is_named_by_its_number() -> None:
    assert ARDUPILOT.mode_name(99) == "mode 0x63"


def test_set_mode_parameters() -> None:
    assert (ARDUPILOT.set_mode("GUIDED").id, ARDUPILOT.set_mode("GUIDED").params) == (176, (1.0, 4.0))
    assert (PX4.set_mode("OFFBOARD").id, PX4.set_mode("OFFBOARD").params) == (176, (1.0, 6.0, 0.0))
    assert PX4.set_mode("AUTO.LOITER").params == (1.0, 4.0, 3.0)


@pytest.mark.parametrize(
    ("autopilot", "datum", "frame", "altitude"),
    [
        (ARDUPILOT, AltitudeDatum.RELATIVE, 6, 50.0),
        (ARDUPILOT, AltitudeDatum.AMSL, 5, 70.0),
        (PX4, AltitudeDatum.RELATIVE, 5, 83.0),  # home at 33 m AMSL + 50 m
        (PX4, AltitudeDatum.AMSL, 5, 70.0),
    ],
)
def test_position_target(autopilot: Autopilot, datum: AltitudeDatum, frame: int, altitude: float) -> None:
    message = autopilot.position_target(TARGET, vehicle(), datum, 2**32 + 5)
    assert message.get_msgId() == 86
    assert (message.target_system, message.target_component, message.time_boot_ms) == (7, 1, 5)
    assert (message.coordinate_frame, message.alt) == (frame, altitude)
    assert (message.lat_int, message.lon_int) == (-378136000, 1449631000)
    # Ignore VX 8, VY 16, VZ 32, AX 64, AY 128, AZ 256, YAW 1024, YAW_RATE 2048; keep X 1, Y 2, Z 4. FORCE 512 is no
    # ignore bit: it makes the acceleration a force.
    assert message.type_mask == 8 + 16 + 32 + 64 + 128 + 256 + 1024 + 2048
    assert [message.vx, message.vy, message.vz, message.afx, message.afy, message.afz, message.yaw_rate] == [0.0] * 7


@pytest.mark.parametrize("autopilot", [ARDUPILOT, PX4])
def test_yaw_is_sent_where_it_is_asked_for(autopilot: Autopilot) -> None:
    target = Target(-37.8136, 144.9631, 50.0, 70.0, yaw_ned=1.25)
    message = autopilot.position_target(target, vehicle(), AltitudeDatum.RELATIVE, 0)
    # As above without YAW 1024.
    assert (message.type_mask, message.yaw) == (8 + 16 + 32 + 64 + 128 + 256 + 2048, 1.25)


def test_coordinates_are_rounded_not_cut() -> None:
    # -37.81360006 deg is -378136000.6 units: -378136001 rounded, -378136000 cut.
    assert Target(-37.81360006, 144.96310007, 0.0, 0.0).lat_e7 == -378136001
    assert Target(-37.81360006, 144.96310007, 0.0, 0.0).lon_e7 == 1449631001


def test_no_home_no_height_above_it() -> None:
    for autopilot in (ARDUPILOT, PX4):
        with pytest.raises(TargetError, match="home is not set"):
            autopilot.position_target(TARGET, vehicle(None), AltitudeDatum.RELATIVE, 0)
        autopilot.position_target(TARGET, vehicle(None), AltitudeDatum.AMSL, 0)
    with pytest.raises(TargetError, match="home is not set"):
        PX4.takeoff(vehicle(None), 10.0)


def test_takeoff_altitudes() -> None:
    # ArduCopter: height above home in parameter 7. PX4: above mean sea level; position and yaw NaN.
    assert ARDUPILOT.takeoff(vehicle(), 10.0).params == (0.0,) * 6 + (10.0,)
    params = PX4.takeoff(vehicle(), 10.0).params
    assert params[6] == 43.0
    assert all(math.isnan(value) for value in params[3:6])


@pytest.mark.parametrize("autopilot", [ARDUPILOT, PX4])
def test_what_may_be_repeated(autopilot: Autopilot) -> None:
    assert not autopilot.arm().idempotent
    assert not autopilot.takeoff(vehicle(), 10.0).idempotent
    for command in (autopilot.land(), autopilot.return_home(), autopilot.disarm()):
        assert command.idempotent


def test_reposition_changes_the_mode_and_carries_the_same_target() -> None:
    command = PX4.reposition(TARGET, vehicle(), AltitudeDatum.RELATIVE)
    message = command.message(7, 1, as_int=command.frame is not None, confirmation=0)
    assert (message.command, message.frame, message.param1, message.param2) == (192, 5, -1.0, 1.0)
    assert (message.x, message.y, message.z) == (-378136000, 1449631000, 83.0)
    assert math.isnan(message.param4)


def test_when_the_bridge_stops() -> None:
    parting = PX4.parting("OFFBOARD")
    assert parting is not None and parting.params == (1.0, 4.0, 3.0)  # Hold
    assert PX4.parting("AUTO.RTL") is None
    assert ARDUPILOT.parting("GUIDED") is None


def test_stream_demands() -> None:
    # PX4: at least 2 Hz and 1 s before the mode, https://docs.px4.io/main/en/flight_modes/offboard.html
    assert PX4.min_stream_hz >= 5.0 and PX4.stream_lead_s > 1.0
    assert PX4.goal_mode == {Transport.SETPOINT: "OFFBOARD", Transport.REPOSITION: "AUTO.LOITER"}
    assert ARDUPILOT.goal_mode[Transport.SETPOINT] == "GUIDED"

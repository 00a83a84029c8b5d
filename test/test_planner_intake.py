"""Device reports after a restart. Oracle: what the reporters said last, by the stamps of their own clocks."""

import pytest
from geometry_msgs.msg import Point
from jpap_msgs.msg import Device as DeviceMessage
from jpap_msgs.msg import DeviceUpdate

from jpap_ros.fleet.config import MapOrigin
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.nodes.planner_intake import DeviceIntake
from jpap_ros.planning.devices import Device


def report(sec, snapshot=False, departed=(), **devices):
    """Return a report with a stamp [s], 0 for none, of devices by their easting [m]."""
    message = DeviceUpdate(snapshot=snapshot, departed=list(departed))
    message.header.frame_id, message.header.stamp.sec = "map", sec
    message.devices = [
        DeviceMessage(id=name, position=Point(x=float(x)), rate_demand=10.0, weight=1.0) for name, x in devices.items()
    ]
    return message


@pytest.fixture
def intake():
    """Return the intake of a planner that was started again, and knew a of 50 s, b of 20 s, and c without a stamp."""
    made = DeviceIntake("map", LocalFrame(MapOrigin(0.0, 0.0)), lambda line: None)
    known = [Device(name, (5.0, 0.0), 10.0) for name in "abc"]
    made.restore(known, {"a": 50 * 10**9, "b": 20 * 10**9, "c": 0})
    return made


def east(intake):
    return {device.id: device.position[0] for device in intake.devices}


def test_what_is_replayed_moves_no_device_back(intake):
    for sec in (10, 30, 49):
        assert not intake.take(report(sec, a=sec)).moved
    assert east(intake)["a"] == 5.0
    assert intake.take(report(51, a=51)).moved == ("a",)
    assert intake.stamps["a"] == 51 * 10**9


def test_each_device_has_a_clock_of_its_own(intake):
    # b's reporter is 30 s behind a's.
    intake.take(report(30, a=1, b=30))
    assert east(intake) == {"a": 5.0, "b": 30.0, "c": 5.0}


def test_reports_without_a_stamp_and_devices_without_one_are_taken(intake):
    intake.take(report(0, a=1))
    intake.take(report(1, c=2))
    assert east(intake) == {"a": 1.0, "b": 5.0, "c": 2.0}


def test_an_old_departure_and_an_old_snapshot_take_nobody_out(intake):
    assert not intake.take(report(49, departed=["a"])).left
    assert not intake.take(report(49, snapshot=True, b=49)).left
    assert east(intake) == {"a": 5.0, "b": 49.0, "c": 5.0}
    assert set(intake.take(report(51, snapshot=True, a=51)).left) == {"b", "c"}
    assert intake.stamps.keys() == {"a"}


def test_in_a_planner_that_was_not_restarted_a_clock_may_be_set_back():
    made = DeviceIntake("map", LocalFrame(MapOrigin(0.0, 0.0)), lambda line: None)
    made.take(report(50, a=50))
    made.take(report(10, a=10))
    assert east(made) == {"a": 10.0} and made.stamps == {"a": 10 * 10**9}

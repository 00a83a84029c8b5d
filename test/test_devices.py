"""The device table. Oracle: the rules of a report, worked by hand, and a plain dictionary for the sequences."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jpap_ros.fleet.availability import Charge, Link, Vehicle
from jpap_ros.fleet.events import AircraftWatch, Events
from jpap_ros.planning.devices import Changes, Device, DeviceTable, Fault


def device(name="a", x=1.0, y=2.0, rate=16.0, weight=1.0):
    return Device(name, (x, y), rate, weight)


@pytest.fixture
def table():
    """Return a table that knows a and b."""
    made = DeviceTable()
    made.apply([device("a"), device("b", 5.0)])
    return made


def test_first_reports_join(table):
    assert table.apply([device("c")]) == Changes(joined=("c",))
    assert [d.id for d in table.devices] == ["a", "b", "c"]


def test_the_same_again_is_no_change(table):
    assert not table.apply([device("a"), device("b", 5.0)])


def test_a_move_and_a_new_demand_are_told_apart(table):
    changes = table.apply([device("a", x=9.0), device("b", 5.0, rate=17.0)])
    assert changes == Changes(moved=("a",), demanded=("b",))
    assert table.devices == (device("a", x=9.0), device("b", 5.0, rate=17.0))


def test_a_new_weight_is_a_new_demand(table):
    assert table.apply([device("a", weight=2.0)]) == Changes(demanded=("a",))


def test_departed_devices_leave_and_unknown_ones_are_no_fault(table):
    assert table.apply([], ["a", "nobody", "a"]) == Changes(left=("a",))
    assert table.devices == (device("b", 5.0),)


def test_a_snapshot_removes_the_others(table):
    assert table.apply([device("b", 5.0), device("c")], snapshot=True) == Changes(joined=("c",), left=("a",))
    assert [d.id for d in table.devices] == ["b", "c"]


def test_an_empty_snapshot_removes_all(table):
    assert table.apply([], snapshot=True).left == ("a", "b")
    assert len(table) == 0


BAD = [
    (device("", x=1.0), "id", "''"),
    (device(x=math.nan), "position.x", "nan"),
    (device(y=math.inf), "position.y", "inf"),
    (device(x=-1e6), "position.x", "-1000000.0"),
    (device(rate=math.nan), "rate_demand", "nan"),
    (device(rate=math.inf), "rate_demand", "inf"),
    (device(rate=-3.0), "rate_demand", "-3.0"),
    (device(rate=0.0), "rate_demand", "0.0"),
    (device(weight=math.nan), "weight", "nan"),
    (device(weight=-1.0), "weight", "-1.0"),
    (device(weight=math.inf), "weight", "inf"),
]


@pytest.mark.parametrize(("bad", "field", "value"), BAD, ids=[f"{field}={value}" for _, field, value in BAD])
def test_a_wrong_report_is_ignored_alone_and_named(table, bad, field, value):
    changes = table.apply([bad, device("c")])
    assert changes.joined == ("c",) and not changes.moved and not changes.demanded
    assert [(fault.id, fault.field) for fault in changes.faults] == [(bad.id, field)]
    assert (
        repr(bad.id) in str(changes.faults[0]) and field in str(changes.faults[0]) and value in str(changes.faults[0])
    )
    assert table.devices == (device("a"), device("b", 5.0), device("c"))


def test_an_id_twice_in_a_report_is_ignored_in_both_places(table):
    changes = table.apply([device("a", x=7.0), device("a", x=8.0), device("b", 6.0)])
    assert [str(fault) for fault in changes.faults] == ["device 'a': id must be unique in a report, got 'a' 2 times"]
    assert table.devices == (device("a"), device("b", 6.0))


def test_an_id_both_present_and_departed_stays_as_it_was(table):
    changes = table.apply([device("a", x=7.0)], ["a", "b"])
    assert [(fault.id, fault.field) for fault in changes.faults] == [("a", "id")]
    assert changes.left == ("b",) and table.devices == (device("a"),)


def test_an_empty_departed_id_is_a_fault(table):
    changes = table.apply([], ["", "a"])
    assert [fault.field for fault in changes.faults] == ["departed id"] and changes.left == ("a",)


def test_a_device_whose_report_is_wrong_is_not_removed_by_the_snapshot_that_names_it(table):
    changes = table.apply([device("a", rate=math.nan)], snapshot=True)
    assert changes.left == ("b",) and table.devices == (device("a"),)


def test_an_unreadable_device_counts_as_named(table):
    unread = Fault("a", "latitude", "must be from -90 to 90 degrees, got nan")
    changes = table.apply([unread], snapshot=True)
    assert changes.faults == (unread,) and changes.left == ("b",) and table.devices == (device("a"),)


def test_silent_devices_expire_and_any_report_keeps_one_alive():
    table = DeviceTable()
    table.apply([device("a"), device("b"), device("c")], now_s=0.0)
    table.apply([device("a"), device("b", rate=math.nan)], now_s=6.0)
    assert table.expire(10.0, 10.0) == ()
    # c was heard 11 s ago; b reports nonsense but is there.
    assert table.expire(11.0, 10.0) == ("c",)
    assert table.expire(16.5, 10.0) == ("a", "b")
    assert len(table) == 0


def test_a_device_that_comes_back_joins_again(table):
    table.apply([], ["a"])
    assert table.apply([device("a")]).joined == ("a",)


names = st.sampled_from("abcd")
reports = st.tuples(
    st.dictionaries(names, st.tuples(st.floats(-1e4, 1e4), st.floats(1e-3, 40.0)), max_size=4),
    st.lists(names, max_size=3),
    st.booleans(),
)


@given(st.lists(reports, max_size=8))
def test_good_reports_act_like_a_dictionary(sequence):
    table, model = DeviceTable(), {}
    for present, departed, snapshot in sequence:
        gone = [name for name in departed if name not in present]
        before = dict(model)
        if snapshot:
            model = {}
        for name in gone:
            model.pop(name, None)
        model.update(present)
        changes = table.apply(
            [device(name, x=x, rate=rate) for name, (x, rate) in present.items()], gone, snapshot=snapshot
        )
        assert set(changes.joined) == model.keys() - before.keys()
        assert set(changes.left) == before.keys() - model.keys()
        assert {d.id: (d.position[0], d.rate_demand) for d in table.devices} == model


wild = st.floats(allow_nan=True, allow_infinity=True)


@given(st.lists(st.builds(device, st.sampled_from(["", "a", "b", "c"]), wild, wild, wild, wild), max_size=5))
def test_nothing_wrong_ever_gets_in(reported):
    table = DeviceTable()
    table.apply(reported)
    for known in table.devices:
        assert known.id and all(abs(value) <= 1e5 for value in known.position)
        assert 0 < known.rate_demand < math.inf and 0 < known.weight < math.inf


def test_events_say_what_happened_in_one_line():
    events = Events()
    assert not events
    events.add_changes(Changes(joined=("a", "b"), moved=("c",)))
    events.add_changes(Changes(joined=("d",), left=("e",)))
    events.add("uav2 is lost")
    events.add("uav2 is lost")
    assert str(events) == "3 devices joined, 1 moved, 1 left, uav2 is lost"


def test_events_merge_in_the_order_of_time():
    earlier, later = Events(), Events()
    earlier.add("operator asked")
    earlier.add_silent(1)
    later.add("uav1 is lost")
    later.merge(earlier)
    assert str(later) == "1 device fell silent, operator asked, uav1 is lost"


def test_aircraft_that_join_are_named_or_counted():
    few, many = Events(), Events()
    for name in ("uav1", "uav2", "uav1"):
        few.add_aircraft(name)
    for k in range(30):
        many.add_aircraft(f"uav{k}")
    many.add("operator asked")
    assert str(few) == "uav1 joined, uav2 joined"
    assert str(many) == "30 UAVs joined, operator asked"


def test_what_happens_to_aircraft_is_told_once():
    watch = AircraftWatch(low_battery=0.3)

    def told(**report):
        events = Events()
        assert watch.take(Vehicle("u", **report), events) == bool(events)
        return str(events)

    assert told() == ""
    assert told(link=Link.CONNECTED) == "u joined"
    assert told(link=Link.CONNECTED, in_air=True, battery=0.8) == ""
    assert told(link=Link.CONNECTED, in_air=True, battery=0.3) == "u is low on battery"
    # A battery recovers a little; and what comes over a lost link is old.
    assert told(link=Link.CONNECTED, in_air=True, battery=0.31) == ""
    assert told(link=Link.LOST, in_air=True, battery=0.2) == ""
    assert told(link=Link.CONNECTED, in_air=True, battery=0.2) == ""
    assert told(link=Link.CONNECTED, battery=0.2) == "u has landed"
    assert told(link=Link.CONNECTED, in_air=True, charge=Charge.LOW) == "u is low on battery"


def test_where_the_fleet_s_life_tells_of_low_batteries_the_watch_does_not():
    events = Events()
    watch = AircraftWatch(low_battery=None)
    assert watch.take(Vehicle("u", Link.CONNECTED, in_air=True, battery=0.1, charge=Charge.LOW), events)
    assert str(events) == "u joined"


def test_a_report_that_changes_nothing_is_no_event():
    events = Events()
    events.add_changes(Changes(faults=(Fault("a", "id", "is wrong"),)))
    assert not events

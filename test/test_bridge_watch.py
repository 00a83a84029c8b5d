"""The planner's ear for the bridge. Oracle: times worked by hand, with 5 s of silence that mean nothing."""

from jpap_ros.fleet.bridge_watch import BridgeWatch


def test_silence_is_told_after_a_while_and_ends_with_the_next_state():
    watch = BridgeWatch(100.0)
    assert watch.silent_s(104.9) == 0.0
    watch.hear(104.9)
    assert watch.silent_s(109.8) == 0.0
    assert watch.silent_s(109.9) == 5.0
    watch.hear(130.0)
    assert watch.silent_s(130.0) == 0.0


def test_the_fleet_s_clock_stands_still_while_nobody_reports():
    watch = BridgeWatch(100.0)
    assert [watch.clock(now) for now in (100.0, 104.0, 105.0, 112.0, 120.0)] == [100.0, 104.0, 105.0, 105.0, 105.0]
    watch.hear(120.0)
    # 15 s were lost: from 105 s to 120 s.
    assert [watch.clock(now) for now in (120.0, 123.0, 130.0)] == [105.0, 108.0, 110.0]
    watch.hear(131.0)
    assert watch.clock(132.0) == 111.0

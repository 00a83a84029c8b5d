"""Waiting for what a publisher repeats. Oracle: times worked out by hand from the two limits in the module."""

import pytest

from jpap_ros.nodes.backlog import Backlog


def test_nothing_is_waited_for_unless_a_publisher_was_found():
    backlog = Backlog()
    backlog.heard(5.0)
    assert backlog.left_s(5.0) == 0.0


def test_it_is_over_when_nothing_came_for_a_while():
    backlog = Backlog()
    backlog.found(10.0)
    backlog.heard(10.05)
    assert backlog.left_s(10.05) == pytest.approx(0.1)
    assert backlog.left_s(10.16) == 0.0
    backlog.heard(10.2)
    assert backlog.left_s(10.2) == 0.0, "a report long after is news"


def test_a_stream_that_never_ends_is_waited_for_once():
    backlog = Backlog()
    backlog.found(0.0)
    for tick in range(1, 200):
        backlog.heard(tick / 100)
    assert backlog.left_s(0.99) <= 0.011 and backlog.left_s(1.0) == 0.0

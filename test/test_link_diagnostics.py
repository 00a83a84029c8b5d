"""Verdict on a link for the operator. Oracle: the rules in the docstring of `link_status`, one instance each."""

from __future__ import annotations

from dataclasses import replace

import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from jpap_ros.mavlink.link_report import LinkReport
from jpap_ros.nodes.bridge_diagnostics import link_status

GOOD = LinkReport(
    url="udpin:0.0.0.0:14550",
    up=True,
    problem="",
    signed=True,
    peers=3,
    received_per_s=60.0,
    sent_per_s=30.0,
    received_bytes_per_s=2400.0,
    sent_bytes_per_s=1500.0,
    max_bytes_per_s=4000.0,
    loss=0.05,
    source_loss=((1, 1, 0.05), (2, 1, 0.04)),
    dropped=2,
    over_budget=0,
    bad_frames=1,
    skipped_bytes=17,
    reconnects=0,
    refused_per_s=0.0,
    unsigned=4,
    badly_signed=0,
    replayed=0,
)


@pytest.mark.parametrize(
    ("changes", "level", "words"),
    [
        ({}, DiagnosticStatus.OK, "up"),
        ({"peers": 0}, DiagnosticStatus.OK, "nobody heard"),
        ({"refused_per_s": 2.0}, DiagnosticStatus.ERROR, "2.0 frames/s refused"),
        ({"up": False, "problem": "Connection refused"}, DiagnosticStatus.WARN, "Connection refused"),
        ({"problem": "signing state file k: cannot be written"}, DiagnosticStatus.WARN, "cannot be written"),
        ({"loss": 0.31}, DiagnosticStatus.WARN, "31 % of messages lost"),
        ({"received_bytes_per_s": 3500.0}, DiagnosticStatus.WARN, "5000 of 4000 byte/s used"),
        ({"received_bytes_per_s": 9000.0, "max_bytes_per_s": None}, DiagnosticStatus.OK, "up"),
    ],
)
def test_verdicts(changes: dict[str, object], level: bytes, words: str) -> None:
    status = link_status("/bridge", replace(GOOD, **changes))
    assert status.level == level
    assert words in status.message


def test_figures_are_those_of_the_report() -> None:
    status = link_status("/bridge", GOOD)
    figures = {value.key: value.value for value in status.values}
    assert status.name == "/bridge: link udpin:0.0.0.0:14550"
    assert figures["received [byte/s]"] == "2400"
    assert figures["budget [byte/s]"] == "4000"
    assert figures["loss [%]"] == "5.0"
    assert figures["loss of 2/1 [%]"] == "4.0"
    assert figures["unsigned frames refused"] == "4"

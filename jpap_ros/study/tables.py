"""The study's report: tables in Markdown."""

from __future__ import annotations

from collections.abc import Sequence

from jpap_ros.study.figures import average_rate, uav_number
from jpap_ros.study.rows import Row
from jpap_ros.study.scenario import Scenario
from jpap_ros.study.style import look, scheme_order
from jpap_ros.study.summary import CONFIDENCE, Mean, Metric, markdown_table, mean_difference, mean_of

#: The scheme that the paper claims to be best; the differences are to it.
REFERENCE = "jpap"


def report(scenario: Scenario, rows: Sequence[Row]) -> str:
    """Markdown: parameters, each metric by scheme and number of devices, and by link budget where it is another."""
    link = scenario.link
    parts = [
        "# Comparison of the schemes\n",
        f"{scenario.side_m:g} m x {scenario.side_m:g} m, demands U[{scenario.least_rate:g}, {scenario.greatest_rate:g}]"
        f" bit/s/Hz, P_T = {link.transmit_power_dbm:g} dBm, noise {link.noise_power_dbm:g} dBm,"
        f" rho_0 = {link.reference_gain_db:g} dB, H = {link.altitude_m:g} m,"
        f" K_max = {scenario.max_devices_per_uav or 'none'}, seed {scenario.seed}."
        f" Mean ± half-width of the {CONFIDENCE:.0%} confidence interval.\n",
    ]
    stated = [row for row in rows if row.gain_db == 0]
    if stated:
        parts += [
            "## UAVs\n",
            _table(stated, uav_number, "devices", "K = {}"),
            "## Average UAV rate [bit/s/Hz]\n",
            _table(stated, average_rate, "devices", "K = {}"),
        ]
    if {REFERENCE} < {row.scheme for row in stated}:
        parts += [
            f"## UAVs more than {look(REFERENCE).label}, draw by draw\n",
            _differences(stated, uav_number),
            f"## Average UAV rate above {look(REFERENCE).label}, draw by draw [bit/s/Hz]\n",
            _differences(stated, average_rate),
        ]
    for count in sorted({row.devices for row in rows if row.gain_db != 0}):
        here = [row for row in rows if row.devices == count]
        parts += [
            f"## UAVs for {count} devices by link budget above the stated one\n",
            _table(here, uav_number, "gain_db", "{:+g} dB"),
            f"## Average UAV rate for {count} devices by link budget above the stated one [bit/s/Hz]\n",
            _table(here, average_rate, "gain_db", "{:+g} dB"),
        ]
    parts += ["## Proofs and time\n", _proofs(rows)]
    return "\n".join(parts)


def _schemes(rows: Sequence[Row]) -> list[str]:
    return sorted({row.scheme for row in rows}, key=scheme_order)


def _table(rows: Sequence[Row], metric: Metric, over: str, heading: str) -> str:
    """A metric by scheme and by the values of a column."""
    values = sorted({getattr(row, over) for row in rows})
    return markdown_table(
        ["Scheme", *(heading.format(value) for value in values)],
        [
            [
                look(scheme).label,
                *(_cell(mean_of(rows, metric, **{"scheme": scheme, over: value}), ".2f") for value in values),
            ]
            for scheme in _schemes(rows)
        ],
    )


def _cell(found: Mean, spec: str) -> str:
    return format(found, spec) if found.draws else ""


def _differences(rows: Sequence[Row], metric: Metric) -> str:
    counts = sorted({row.devices for row in rows})
    return markdown_table(
        ["Scheme", *(f"K = {count}" for count in counts)],
        [
            [
                look(scheme).label,
                *(_cell(mean_difference(rows, metric, scheme, REFERENCE, devices=k), "+.2f") for k in counts),
            ]
            for scheme in _schemes(rows)
            if scheme != REFERENCE
        ],
    )


def _proofs(rows: Sequence[Row]) -> str:
    """Draws, proven minima, broken constraints and run time of each scheme."""

    def line(scheme: str) -> list[str]:
        own = [row for row in rows if row.scheme == scheme]
        longest = max(row.runtime_s for row in own)
        return [
            look(scheme).label,
            str(len(own)),
            str(sum(row.proven_optimal for row in own)),
            str(sum(row.unserved for row in own)),
            str(sum(row.violations for row in own)),
            f"{longest:.3g}",
        ]

    header = ["Scheme", "trials", "N proven least", "devices unserved", "constraints broken", "longest solve [s]"]
    return markdown_table(header, [line(scheme) for scheme in _schemes(rows)])

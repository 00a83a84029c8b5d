"""The study's report: tables in Markdown."""

from __future__ import annotations

from collections.abc import Sequence

from jpap_ros.study.figures import average_rate, uav_number
from jpap_ros.study.rows import Row
from jpap_ros.study.scenario import Scenario
from jpap_ros.study.style import look, scheme_order
from jpap_ros.study.summary import CONFIDENCE, Metric, markdown_table, mean_difference, mean_of

#: The scheme that the paper claims to be best; the differences are to it.
REFERENCE = "jpap"


def report(scenario: Scenario, rows: Sequence[Row]) -> str:
    """Markdown: the parameters, then each metric by scheme and number of devices, and link budget where it varies."""
    link = scenario.link
    parts = [
        "# Comparison of the schemes\n",
        f"{scenario.side_m:g} m x {scenario.side_m:g} m, demands U[{scenario.least_rate:g}, {scenario.greatest_rate:g}]"
        f" bit/s/Hz, P_T = {link.transmit_power_dbm:g} dBm, noise {link.noise_power_dbm:g} dBm,"
        f" rho_0 = {link.reference_gain_db:g} dB, H = {link.altitude_m:g} m,"
        f" K_max = {scenario.max_devices_per_uav or 'none'}, seed {scenario.seed}."
        f" Mean ± half-width of the {CONFIDENCE:.0%} confidence interval.\n",
    ]
    for gain in sorted({row.gain_db for row in rows}):
        here = [row for row in rows if row.gain_db == gain]
        at = "" if gain == 0 else f", {gain:+g} dB of link budget"
        parts += [
            f"## UAVs{at}\n",
            _table(here, uav_number, ".2f"),
            f"## Average UAV rate [bit/s/Hz]{at}\n",
            _table(here, average_rate, ".2f"),
        ]
        if REFERENCE in {row.scheme for row in here}:
            parts += [
                f"## UAVs more than {look(REFERENCE).label}, draw by draw{at}\n",
                _differences(here, uav_number),
                f"## Average UAV rate above {look(REFERENCE).label}, draw by draw [bit/s/Hz]{at}\n",
                _differences(here, average_rate),
            ]
        parts += [f"## Proofs and time{at}\n", _proofs(here)]
    return "\n".join(parts)


def _schemes(rows: Sequence[Row]) -> list[str]:
    return sorted({row.scheme for row in rows}, key=scheme_order)


def _table(rows: Sequence[Row], metric: Metric, spec: str) -> str:
    counts = sorted({row.devices for row in rows})
    return markdown_table(
        ["Scheme", *(f"K = {count}" for count in counts)],
        [
            [look(scheme).label, *(format(mean_of(rows, metric, scheme=scheme, devices=k), spec) for k in counts)]
            for scheme in _schemes(rows)
        ],
    )


def _differences(rows: Sequence[Row], metric: Metric) -> str:
    counts = sorted({row.devices for row in rows})
    return markdown_table(
        ["Scheme", *(f"K = {count}" for count in counts)],
        [
            [
                look(scheme).label,
                *(format(mean_difference(rows, metric, scheme, REFERENCE, devices=k), "+.2f") for k in counts),
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

"""Run the missing trials of a study, in parallel, and append each to the results as it finishes."""

from __future__ import annotations

import json
import multiprocessing
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

from jpap_ros.planning import solve
from jpap_ros.study.rows import Row, RowWriter, Trial, read_rows, write_rows
from jpap_ros.study.scenario import Scenario


def run_trial(scenario: Scenario, time_limit_s: float | None, trial: Trial) -> Row:
    """Draw the trial's field of devices, solve it, and check the deployment against every constraint of P1."""
    positions, rates = scenario.draw(trial.devices, trial.draw)
    link = scenario.with_gain(trial.gain_db)
    deployment = solve(
        positions,
        rates,
        trial.scheme,
        link,
        max_devices_per_uav=scenario.max_devices_per_uav,
        time_limit_s=time_limit_s,
        seed=scenario.scheme_seed(trial.devices, trial.draw),
    )
    return Row(
        *trial,
        uavs=len(deployment.uav_positions),
        average_uav_rate=deployment.average_uav_rate,
        min_uavs_bound=deployment.min_uavs_bound,
        proven_optimal=deployment.proven_optimal,
        unserved=len(deployment.unserved),
        violations=len(deployment.violations(positions, rates, link, scenario.max_devices_per_uav)),
        runtime_s=deployment.runtime_s,
    )


def run_study(
    path: Path,
    scenario: Scenario,
    trials: Iterable[Trial],
    *,
    workers: int,
    time_limit_s: float | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Row]:
    """Run every trial that the results file lacks; return all the rows that it then has.

    Parameters
    ----------
    path : Path
        The CSV file of results. The scenario is recorded beside it, as `<name>.json`.
    scenario : Scenario
        Parameters of the simulation.
    trials : iterable of Trial
        What to run; duplicates are run once.
    workers : int
        Number of processes; 1 runs in this one. Results do not depend on it.
    time_limit_s : float, optional
        Time limit of each solve [s].
    progress : callable
        Called with the number of finished trials and of all trials.

    Returns
    -------
    list of Row
        Ordered by trial; those of earlier runs that added other trials to the file are among them.

    Raises
    ------
    ValueError
        If the file holds results of another scenario.
    """
    wanted = sorted(set(trials))
    have = {row.trial: row for row in read_rows(path)}
    _record_scenario(path, scenario, time_limit_s, has_rows=bool(have))
    missing = [trial for trial in wanted if trial not in have]
    done = len(wanted) - len(missing)
    progress(done, len(wanted))
    with RowWriter(path) as writer:
        for row in _run(partial(run_trial, scenario, time_limit_s), missing, workers):
            writer.write(row)
            have[row.trial] = row
            done += 1
            progress(done, len(wanted))
    rows = [have[trial] for trial in sorted(have)]
    write_rows(path, rows)
    return rows


def _run(task: Callable[[Trial], Row], trials: Sequence[Trial], workers: int) -> Iterator[Row]:
    if workers == 1 or not trials:
        yield from map(task, trials)
        return
    # Not forked: the progress bar has a thread of its own. Ctrl-C is for the parent, which cancels what has not begun.
    pool = ProcessPoolExecutor(
        workers,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=signal.signal,
        initargs=(signal.SIGINT, signal.SIG_IGN),
    )
    try:
        yield from pool.map(task, trials)
    finally:
        pool.shutdown(cancel_futures=True)


def _record_scenario(path: Path, scenario: Scenario, time_limit_s: float | None, *, has_rows: bool) -> None:
    """Keep the scenario beside the results; refuse to add to the rows of another one."""
    record = path.with_suffix(".json")
    text = json.dumps(scenario.as_dict() | {"time_limit_s": time_limit_s}, indent=2) + "\n"
    if record.exists() and has_rows:
        before, now = json.loads(record.read_text()), json.loads(text)
        changed = [f"{name} {before.get(name)!r} -> {now[name]!r}" for name in now if before.get(name) != now[name]]
        if changed:
            raise ValueError(f"{path} holds results of another scenario ({'; '.join(changed)}): choose another file")
        return
    record.parent.mkdir(parents=True, exist_ok=True)
    record.write_text(text)

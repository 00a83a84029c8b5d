"""What a bridge leaves to the one after it: which aircraft it flew when it was killed, and where all were."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from concurrent.futures import Future
from functools import partial
from pathlib import Path

from rclpy.impl.rcutils_logger import RcutilsLogger

from jpap_ros.mavlink.fleet_controller import FleetController, OrderResult
from jpap_ros.mavlink.flown_file import FlownFile, FlownFileError, Place
from jpap_ros.mavlink.snapshot import AircraftSnapshot


class Succession:
    """Keeps the file of flown aircraft, and takes them back at the start.

    Parameters
    ----------
    path : str
        Of the file; empty: nothing is kept.
    logger : RcutilsLogger
    """

    def __init__(self, path: str, logger: RcutilsLogger) -> None:
        self._file = FlownFile(Path(path).expanduser()) if path else None
        self._logger = logger

    def take_over(self, controller: FleetController) -> None:
        """Go on with the aircraft of a bridge that was killed."""
        if self._file is None:
            return
        try:
            left = self._file.read()
            outcomes = controller.resume(left.flown, left.in_air)
        except FlownFileError as error:
            self._logger.warning(f"nothing is resumed: {error}")
            return
        for name, outcome in outcomes.items():
            outcome.add_done_callback(partial(self._tell, name))

    def keep(self, fleet: Iterable[str], snapshots: Mapping[str, AircraftSnapshot]) -> None:
        """Say who is flown now, once something is known of everybody."""
        if all(name in snapshots for name in fleet):
            self._write(
                (name for name, snapshot in snapshots.items() if snapshot.flown),
                {name: snapshot.line_m for name, snapshot in snapshots.items() if snapshot.line_m},
            )

    def end(self) -> None:
        """Leave nothing: after an orderly end nobody takes aircraft back by himself."""
        self._write((), {})

    def _write(self, names: Iterable[str], in_air: Mapping[str, tuple[Place, ...]]) -> None:
        if self._file is None:
            return
        try:
            self._file.write(names, in_air)
        except FlownFileError as error:
            self._logger.error(str(error), throttle_duration_sec=60.0)

    def _tell(self, name: str, outcome: Future[OrderResult]) -> None:
        self._logger.info(f"{name}: {outcome.result().message}")

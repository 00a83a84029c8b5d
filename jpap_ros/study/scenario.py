"""The paper's simulation (section V): its parameters, and its random device fields."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace

import numpy as np

from jpap_ros.planning.link_budget import Floats, LinkBudget


@dataclass(frozen=True)
class Scenario:
    """What section V states, with its values as defaults.

    Parameters
    ----------
    side_m : float
        Side of the square in which the devices lie [m].
    least_rate, greatest_rate : float
        Ends of the interval from which the demands are drawn [bit/s/Hz].
    link : LinkBudget
        The channel and the altitude.
    max_devices_per_uav : int or None
        K_max of constraint (6e); the paper gives no value, None means no limit.
    seed : int
        Seed of every draw; >= 0.
    """

    side_m: float = 1500.0
    least_rate: float = 15.0
    greatest_rate: float = 20.0
    link: LinkBudget = field(default_factory=LinkBudget)
    max_devices_per_uav: int | None = None
    seed: int = 2022

    def draw(self, devices: int, draw: int) -> tuple[Floats, Floats]:
        """Draw a field of devices: positions (K, 2) [m] and demanded rates (K,) [bit/s/Hz].

        The stream is keyed by (seed, devices, draw) alone, so that every scheme and every link budget sees the same
        fields, in whatever order and process they are drawn.
        """
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(devices, draw)))
        positions = rng.uniform(0.0, self.side_m, (devices, 2))
        return positions, rng.uniform(self.least_rate, self.greatest_rate, devices)

    def scheme_seed(self, devices: int, draw: int) -> int:
        """Seed for the schemes that draw at random themselves; independent of the field's stream."""
        return int(np.random.SeedSequence(self.seed, spawn_key=(devices, draw, 1)).generate_state(1)[0])

    def with_gain(self, gain_db: float) -> LinkBudget:
        """The link budget with `gain_db` more transmit power [dB]."""
        return replace(self.link, transmit_power_dbm=self.link.transmit_power_dbm + gain_db)

    def as_dict(self) -> dict[str, object]:
        """Every parameter, for the record beside the results."""
        return asdict(self)

"""What one simulated vehicle is and what shall go wrong with it from the start."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from jpap_ros.sim.dynamics import MotionLimits


@dataclass(frozen=True)
class Fence:
    """Cylinder round home that the autopilot keeps within.

    Attributes
    ----------
    radius_m : float
        Horizontal, from home.
    max_height_m : float
        Above home.
    """

    radius_m: float = float("inf")
    max_height_m: float = float("inf")


@dataclass(frozen=True)
class LinkFaults:
    """What happens to each frame, in both directions.

    Attributes
    ----------
    loss, duplicate, reorder : float
        Probabilities that a frame is lost, comes twice, or is held back behind later ones.
    delay_s, jitter_s : float
        Fixed delay and the greatest random addition to it [s].
    """

    loss: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    delay_s: float = 0.0
    jitter_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("loss", "duplicate", "reorder"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"{name} must be a probability from 0 to 1, got {getattr(self, name)!r}")
        for name in ("delay_s", "jitter_s"):
            if not 0.0 <= getattr(self, name) <= 60.0:
                raise ValueError(f"{name} must be from 0 to 60 s, got {getattr(self, name)!r}")

    @property
    def clean(self) -> bool:
        """Whether frames simply pass."""
        return self == LinkFaults()


@dataclass(frozen=True)
class VehicleOptions:
    """Settings of one simulated vehicle.

    Attributes
    ----------
    limits : MotionLimits
    battery : float
        Charge at the start, 0 to 1.
    endurance_s : float
        Flight time from full to empty [s].
    battery_low, battery_critical : float
        Charge below which the low-battery failsafe returns home, and below which it lands.
    gps_delay_s : float
        From boot until the position is good enough to arm [s of simulated time].
    prearm_failure : str or None
        A failing pre-arm check, in the autopilot's words.
    refuse_arming : bool
        Pre-arm checks pass, and yet the arming command is refused.
    fence : Fence
    int_only, long_only : frozenset of int
        Commands that are taken only as COMMAND_INT or only as COMMAND_LONG, as old firmware does; the other kind is
        answered with MAV_RESULT_COMMAND_INT_ONLY or MAV_RESULT_COMMAND_LONG_ONLY.
    gcs_sysid : int
        The ground station's system id, for `sysid_enforce` and `gcs_failsafe_s` (ArduPilot's MAV_GCS_SYSID).
    sysid_enforce : bool
        Obey nobody else (ArduPilot).
    gcs_failsafe_s : float or None
        Return home when the ground station's heartbeat has been missing for so long [s].
    offboard_loss_s : float
        PX4's COM_OF_LOSS_T [s].
    offboard_proof_s : float
        How long targets must have been streaming before OFFBOARD is granted [s]: a second by PX4's documentation; its
        source asks only for one fresh target, which 0 stands for.
    offboard_loss_mode : str
        Where PX4 goes then: `HOLD`, `RTL` or `LAND`.
    offboard_resumes : bool
        Whether OFFBOARD comes back by itself with the stream, unless another mode was asked for meanwhile.
    signing_key : bytes or None
        32 bytes; frames out are signed, and unsigned or badly signed frames in are dropped.
    link_faults : LinkFaults
    geoid_separation_m : float
        Height of the ellipsoid's zero below mean sea level, as the receiver reports it.
    """

    limits: MotionLimits = field(default_factory=MotionLimits)
    battery: float = 1.0
    endurance_s: float = 1500.0
    battery_low: float = 0.2
    battery_critical: float = 0.1
    gps_delay_s: float = 0.0
    prearm_failure: str | None = None
    refuse_arming: bool = False
    fence: Fence = field(default_factory=Fence)
    int_only: frozenset[int] = frozenset()
    long_only: frozenset[int] = frozenset()
    gcs_sysid: int = 255
    sysid_enforce: bool = False
    gcs_failsafe_s: float | None = None
    offboard_loss_s: float = 1.0
    offboard_proof_s: float = 1.0
    offboard_loss_mode: str = "HOLD"
    offboard_resumes: bool = False
    signing_key: bytes | None = None
    link_faults: LinkFaults = field(default_factory=LinkFaults)
    geoid_separation_m: float = 25.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.battery <= 1.0:
            raise ValueError(f"battery must be from 0 to 1, got {self.battery!r}")
        if not self.endurance_s > 0.0:
            raise ValueError(f"endurance_s must be positive, got {self.endurance_s!r}")
        if not self.gps_delay_s >= 0.0:
            raise ValueError(f"gps_delay_s must not be negative, got {self.gps_delay_s!r}")
        if self.offboard_loss_mode not in ("HOLD", "RTL", "LAND"):
            raise ValueError(f"offboard_loss_mode must be HOLD, RTL or LAND, got {self.offboard_loss_mode!r}")
        if self.signing_key is not None and len(self.signing_key) != 32:
            raise ValueError(f"signing_key must have 32 bytes, got {len(self.signing_key)}")

    def but(self, **changes: Any) -> VehicleOptions:
        """The same options with some of them changed."""
        return replace(self, **changes)

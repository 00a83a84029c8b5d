"""Where one aircraft is, by its own telemetry or by what is left of it, in the map frame."""

from __future__ import annotations

import math

from jpap_ros.fleet.traffic import Setpoint, Vector
from jpap_ros.mavlink.autopilots import AltitudeDatum
from jpap_ros.mavlink.geodesy import LocalFrame
from jpap_ros.mavlink.vehicle import Vehicle


class Whereabouts:
    """Places of one vehicle: east, north, up [m], up in the goal's altitude datum.

    Parameters
    ----------
    vehicle : Vehicle
    frame : LocalFrame
    datum : AltitudeDatum
    """

    def __init__(self, vehicle: Vehicle, frame: LocalFrame, datum: AltitudeDatum) -> None:
        #: Position [m]; None: unknown.
        self.enu_m: Vector | None = None
        #: Line on which traffic control takes it to be since it fell silent on its way [m]; empty: it did not.
        self.lost_m: tuple[Vector, ...] = ()
        #: Line on which a bridge before this one left it in the air [m]; empty: unknown, or heard since.
        self.left_m: tuple[Vector, ...] = ()
        #: When its link came up, local clock [s].
        self.link_at = -math.inf
        self._vehicle = vehicle
        self._frame = frame
        self._datum = datum

    def measure(self) -> None:
        """Take the vehicle's position."""
        position = self._vehicle.position
        if position is None:
            return
        try:
            east_m, north_m = self._frame.to_map(position.latitude, position.longitude)
        except ValueError:
            self.enu_m = None
            return
        relative = self._datum is AltitudeDatum.RELATIVE
        up_m = position.relative_m if relative else position.amsl_m - self._frame.origin.altitude_amsl_m
        self.enu_m = east_m, north_m, up_m
        self.left_m = ()

    def rebooted(self) -> None:
        """Its autopilot began anew: it is where it was, until it says so itself."""
        if self.enu_m is not None:
            self.left_m = (self.enu_m,)
        self.enu_m = None

    def known(self, now: float) -> bool:
        """Whether it said lately where it is, and since its link is there: before that it may have flown anywhere."""
        position = self._vehicle.position
        fresh = self.enu_m is not None and self._vehicle.position_fresh(now)
        return fresh and position is not None and position.received_at >= self.link_at

    @property
    def flies(self) -> bool:
        """Whether it is not on the ground; as it was left, before it is heard."""
        if self._vehicle.autopilot is None:
            return bool(self.left_m)
        return self._vehicle.in_air or not self._vehicle.on_ground

    @property
    def home_m(self) -> Vector | None:
        """Its home, on the ground [m]; None: unknown."""
        home = self._vehicle.home
        if home is None:
            return None
        try:
            east_m, north_m = self._frame.to_map(home.latitude, home.longitude)
        except ValueError:
            return None
        relative = self._datum is AltitudeDatum.RELATIVE
        return east_m, north_m, 0.0 if relative else home.amsl_m - self._frame.origin.altitude_amsl_m

    @property
    def pad_m(self) -> Vector | None:
        """Where it stands on the ground, as `home_m`; None: unknown, or it does not stand there."""
        if self.enu_m is None or not self._vehicle.on_ground:
            return None
        east_m, north_m, up_m = self.enu_m
        return east_m, north_m, 0.0 if self._datum is AltitudeDatum.RELATIVE else up_m

    def line_m(self, setpoint: Setpoint | None) -> tuple[Vector, ...]:
        """Corners of the line in the air on which it is until it is heard again [m]; empty: none, or unknown.

        Parameters
        ----------
        setpoint : Setpoint or None
            Where traffic control wants it now; None: it has no part in it.
        """
        if not self.flies or self.enu_m is None:
            return self.left_m if self.flies else ()
        if self.lost_m:
            return self.lost_m
        if setpoint is None or (speed := math.hypot(*setpoint.velocity)) == 0.0:
            return (self.enu_m,)
        # A leg ends at rest, so nobody who hears nothing more comes farther than that.
        (x, y, z), (east, north, up) = setpoint.position, setpoint.velocity
        ahead = setpoint.ahead_m / speed
        return self.enu_m, (x + ahead * east, y + ahead * north, z + ahead * up)

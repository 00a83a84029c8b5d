"""The edge between the map (ENU metres) and MAVLink (degrees in units of 1e-7, NED yaw)."""

from __future__ import annotations

import math

import pymap3d

from jpap_ros.fleet.checks import MAX_MAP_M
from jpap_ros.fleet.config import MapOrigin

_MAX_DROP_M = 2_000.0
_CONVERGED_M = 1e-6
_MAX_STEPS = 20


class LocalFrame:
    """The map frame: the plane tangent to the WGS-84 ellipsoid at an origin, x east and y north.

    Only the horizontal coordinates are converted, between a map point and the geodetic position at the origin's
    height whose east and north components it has. Heights stay heights above the ground (map z) and never follow the
    tangent plane up from the curved earth. The two directions are inverse to each other within a micrometre. One
    conversion takes about 15 us (to the map) or 60 us (from it).

    Parameters
    ----------
    origin : MapOrigin

    Raises
    ------
    ValueError
        If the origin is not finite or lies within a degree of a pole.
    """

    def __init__(self, origin: MapOrigin) -> None:
        check_geodetic(origin.latitude, origin.longitude)
        if abs(origin.latitude) > 89.0 or not math.isfinite(origin.altitude_amsl_m):
            raise ValueError(f"the origin must lie between latitudes -89 and 89 at a finite altitude, got {origin}")
        self.origin = origin
        ellipsoid = pymap3d.Ellipsoid.from_name("wgs84")
        latitude = math.radians(origin.latitude)
        root = math.sqrt(1.0 - (ellipsoid.eccentricity * math.sin(latitude)) ** 2)
        prime_vertical_m = ellipsoid.semimajor_axis / root
        meridional_m = prime_vertical_m * (1.0 - ellipsoid.eccentricity**2) / root**2
        self._degrees_per_m_north = math.degrees(1.0 / meridional_m)
        self._degrees_per_m_east = math.degrees(1.0 / (prime_vertical_m * math.cos(latitude)))

    def to_map(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
        """East and north [m] of a geodetic position [deg]; ValueError if it is out of range or of the map."""
        check_geodetic(latitude_deg, longitude_deg)
        east, north, up = self._project(latitude_deg, longitude_deg)
        # The far side of the earth projects onto the map as well; the ground of the map never lies this deep.
        if up < -_MAX_DROP_M:
            raise ValueError(
                f"latitude {latitude_deg!r}, longitude {longitude_deg!r} is off the map around {self.origin}"
            )
        _check_map(east, north)
        return east, north

    def to_geodetic(self, east_m: float, north_m: float) -> tuple[float, float]:
        """Latitude and longitude [deg] of a map point [m]; ValueError if it is not finite or out of the map."""
        _check_map(east_m, north_m)
        latitude, longitude = self.origin.latitude, self.origin.longitude
        # Newton's method with the derivative at the origin: the error shrinks by about 1e-3 a step at 5 km.
        error_east, error_north = east_m, north_m
        for _ in range(_MAX_STEPS):
            latitude += error_north * self._degrees_per_m_north
            longitude += error_east * self._degrees_per_m_east
            east, north, _ = self._project(latitude, longitude)
            error_east, error_north = east_m - east, north_m - north
            if abs(error_east) < _CONVERGED_M and abs(error_north) < _CONVERGED_M:
                break
        return latitude, (longitude + 180.0) % 360.0 - 180.0

    def _project(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float, float]:
        # On the ellipsoid itself: MAVLink's altitude is above mean sea level, whose undulation is not known here;
        # 100 m of height scale distances by 1.6e-5.
        east, north, up = pymap3d.geodetic2enu(
            latitude_deg, longitude_deg, 0.0, self.origin.latitude, self.origin.longitude, 0.0
        )
        return float(east), float(north), float(up)


def check_geodetic(latitude_deg: float, longitude_deg: float) -> None:
    """Raise ValueError unless both are finite degrees in range."""
    if not abs(latitude_deg) <= 90.0:
        raise ValueError(f"latitude must be from -90 to 90 degrees, got {latitude_deg!r}")
    if not abs(longitude_deg) <= 180.0:
        raise ValueError(f"longitude must be from -180 to 180 degrees, got {longitude_deg!r}")


def degrees_to_e7(degrees: float) -> int:
    """Angle in MAVLink's unit of 1e-7 deg, rounded (truncation would err by up to 1.1 cm, always towards 0, 0)."""
    return round(degrees * 1e7)


def degrees_from_e7(e7: int) -> float:
    """Degrees of an angle in MAVLink's unit of 1e-7 deg."""
    return e7 / 1e7


def yaw_ned_from_enu(yaw_rad: float) -> float:
    """Heading clockwise from north of a yaw counterclockwise from east [rad], in (-pi, pi]."""
    return wrap_angle(math.pi / 2.0 - yaw_rad)


def yaw_enu_from_ned(heading_rad: float) -> float:
    """Yaw counterclockwise from east of a heading clockwise from north [rad], in (-pi, pi]."""
    return wrap_angle(math.pi / 2.0 - heading_rad)


def wrap_angle(angle_rad: float) -> float:
    """Bring an angle [rad] into (-pi, pi]; ValueError if it is not finite."""
    if not math.isfinite(angle_rad):
        raise ValueError(f"angle must be finite, got {angle_rad!r}")
    return -(((-angle_rad) + math.pi) % (2.0 * math.pi) - math.pi)


def _check_map(east_m: float, north_m: float) -> None:
    for name, value in (("east", east_m), ("north", north_m)):
        if not abs(value) <= MAX_MAP_M:
            raise ValueError(f"{name} must be from {-MAX_MAP_M:g} to {MAX_MAP_M:g} m, got {value!r}")

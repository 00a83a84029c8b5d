"""Map to geodetic and back. Oracles: Vincenty's inverse formula and plain ECEF algebra, written out here."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jpap_ros.fleet.config import MapOrigin
from jpap_ros.mavlink.geodesy import (
    LocalFrame,
    degrees_from_e7,
    degrees_to_e7,
    wrap_angle,
    yaw_enu_from_ned,
    yaw_ned_from_enu,
)

A = 6_378_137.0
F = 1.0 / 298.257223563
MELBOURNE = MapOrigin(-37.8136, 144.9631, 20.0)


def vincenty(lat1: float, lon1: float, lat2: float, lon2: float) -> tuple[float, float]:
    """Geodesic distance [m] and initial azimuth [rad]; T. Vincenty, Survey Review XXIII (176), 1975."""
    b = A * (1 - F)
    u1, u2 = (math.atan((1 - F) * math.tan(math.radians(x))) for x in (lat1, lat2))
    difference = math.radians(lon2 - lon1)
    lam = difference
    for _ in range(100):
        s, c = math.sin(lam), math.cos(lam)
        sin_sigma = math.hypot(math.cos(u2) * s, math.cos(u1) * math.sin(u2) - math.sin(u1) * math.cos(u2) * c)
        if sin_sigma == 0:
            return 0.0, 0.0
        cos_sigma = math.sin(u1) * math.sin(u2) + math.cos(u1) * math.cos(u2) * c
        sigma = math.atan2(sin_sigma, cos_sigma)
        sin_alpha = math.cos(u1) * math.cos(u2) * s / sin_sigma
        cos2_alpha = 1 - sin_alpha**2
        cos_2m = cos_sigma - 2 * math.sin(u1) * math.sin(u2) / cos2_alpha if cos2_alpha else 0.0
        k = F / 16 * cos2_alpha * (4 + F * (4 - 3 * cos2_alpha))
        previous, lam = (
            lam,
            difference
            + (1 - k) * F * sin_alpha * (sigma + k * sin_sigma * (cos_2m + k * cos_sigma * (2 * cos_2m**2 - 1))),
        )
        if abs(lam - previous) < 1e-15:
            break
    usq = cos2_alpha * (A**2 - b**2) / b**2
    big_a = 1 + usq / 16384 * (4096 + usq * (-768 + usq * (320 - 175 * usq)))
    big_b = usq / 1024 * (256 + usq * (-128 + usq * (74 - 47 * usq)))
    delta = (
        big_b
        * sin_sigma
        * (
            cos_2m
            + big_b
            / 4
            * (cos_sigma * (2 * cos_2m**2 - 1) - big_b / 6 * cos_2m * (4 * sin_sigma**2 - 3) * (4 * cos_2m**2 - 3))
        )
    )
    azimuth = math.atan2(
        math.cos(u2) * math.sin(lam), math.cos(u1) * math.sin(u2) - math.sin(u1) * math.cos(u2) * math.cos(lam)
    )
    return b * big_a * (sigma - delta), azimuth


def ecef(lat: float, lon: float) -> np.ndarray:
    """Point on the WGS-84 ellipsoid, from its definition x = N cos(lat) cos(lon) …, N = a / sqrt(1 − e² sin²)."""
    e2 = F * (2 - F)
    phi, lam = math.radians(lat), math.radians(lon)
    n = A / math.sqrt(1 - e2 * math.sin(phi) ** 2)
    return np.array(
        [n * math.cos(phi) * math.cos(lam), n * math.cos(phi) * math.sin(lam), n * (1 - e2) * math.sin(phi)]
    )


def test_oracle_reproduces_a_published_geodesic() -> None:
    # Flinders Peak to Buninyon, the worked example of the GDA technical manual (GRS80, equal to WGS-84 within 0.1 mm):
    # 54 972.271 m at 306°52'05.37".
    distance, azimuth = vincenty(
        -(37 + 57 / 60 + 3.72030 / 3600),
        144 + 25 / 60 + 29.52440 / 3600,
        -(37 + 39 / 60 + 10.15610 / 3600),
        143 + 55 / 60 + 35.38390 / 3600,
    )
    assert distance == pytest.approx(54972.271, abs=0.001)
    assert math.degrees(azimuth) % 360 == pytest.approx(306 + 52 / 60 + 5.37 / 3600, abs=1e-5)


@pytest.mark.parametrize("latitude", [-70.0, -37.8136, 0.0, 12.5, 60.0])
@pytest.mark.parametrize(("east", "north"), [(1.0, 0.0), (0.0, 1.0), (-250.0, 400.0), (3000.0, -2000.0)])
def test_distance_and_bearing_are_those_of_the_geodesic(latitude: float, east: float, north: float) -> None:
    origin = MapOrigin(latitude, 144.9631, 0.0)
    distance, azimuth = vincenty(latitude, 144.9631, *LocalFrame(origin).to_geodetic(east, north))
    # A tangent plane shortens a distance d by d³/6R²: 0.2 mm at 3.6 km; Vincenty's series is good to 0.1 mm.
    assert distance == pytest.approx(math.hypot(east, north), abs=1e-3)
    assert distance * math.sin(azimuth) == pytest.approx(east, abs=5e-3)
    assert distance * math.cos(azimuth) == pytest.approx(north, abs=5e-3)


@given(st.floats(-85, 85), st.floats(-180, 180), st.floats(-0.2, 0.2), st.floats(-0.2, 0.2))
@settings(max_examples=100, deadline=None)
def test_to_map_is_the_projection_on_the_tangent_plane(lat0: float, lon0: float, dlat: float, dlon: float) -> None:
    lat, lon = lat0 + dlat, (lon0 + dlon + 180) % 360 - 180
    phi, lam = math.radians(lat0), math.radians(lon0)
    east_axis = np.array([-math.sin(lam), math.cos(lam), 0.0])
    north_axis = np.array([-math.sin(phi) * math.cos(lam), -math.sin(phi) * math.sin(lam), math.cos(phi)])
    offset = ecef(lat, lon) - ecef(lat0, lon0)
    east, north = LocalFrame(MapOrigin(lat0, lon0)).to_map(lat, lon)
    assert east == pytest.approx(east_axis @ offset, abs=1e-6)
    assert north == pytest.approx(north_axis @ offset, abs=1e-6)


@given(st.floats(-89, 89), st.floats(-180, 180), st.floats(-20_000, 20_000), st.floats(-20_000, 20_000))
@settings(max_examples=100, deadline=None)
def test_there_and_back(lat0: float, lon0: float, east: float, north: float) -> None:
    frame = LocalFrame(MapOrigin(lat0, lon0))
    latitude, longitude = frame.to_geodetic(east, north)
    assert -180.0 <= longitude < 180.0
    back = frame.to_map(latitude, longitude)
    assert math.dist(back, (east, north)) < 1e-5


def test_across_the_date_line() -> None:
    frame = LocalFrame(MapOrigin(10.0, 179.999))
    _, longitude = frame.to_geodetic(1000.0, 0.0)
    assert longitude < -179.99
    assert frame.to_map(10.0, longitude)[0] == pytest.approx(1000.0, abs=0.1)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 100_001.0])
def test_map_points_out_of_range_are_refused(bad: float) -> None:
    frame = LocalFrame(MELBOURNE)
    with pytest.raises(ValueError, match=f"east .*{bad!r}"):
        frame.to_geodetic(bad, 0.0)
    with pytest.raises(ValueError, match=f"north .*{bad!r}"):
        frame.to_geodetic(0.0, bad)


@pytest.mark.parametrize(
    ("latitude", "longitude", "word"),
    [
        (math.nan, 0.0, "latitude"),
        (90.1, 0.0, "latitude"),
        (0.0, math.inf, "longitude"),
        (0.0, 180.1, "longitude"),
        (0.0, 0.0, "off the map"),
        # The antipode lies right below the origin.
        (37.8136, 144.9631 - 180.0, "off the map"),
        (-38.9, 144.9631, "north"),
    ],
)
def test_geodetic_positions_out_of_range_are_refused(latitude: float, longitude: float, word: str) -> None:
    with pytest.raises(ValueError, match=word):
        LocalFrame(MELBOURNE).to_map(latitude, longitude)


def test_an_origin_at_the_pole_is_refused() -> None:
    with pytest.raises(ValueError, match="origin"):
        LocalFrame(MapOrigin(90.0, 0.0))


def test_degrees_are_rounded_not_cut() -> None:
    # -37.81361239 in units of 1e-7: truncation would give -378136123.
    assert degrees_to_e7(-37.81361239) == -378136124
    assert degrees_to_e7(144.96309999) == 1449631000


@given(st.integers(-1_800_000_000, 1_800_000_000))
def test_e7_survives_the_way_through_degrees(e7: int) -> None:
    assert degrees_to_e7(degrees_from_e7(e7)) == e7


@pytest.mark.parametrize(
    ("enu_deg", "ned_deg"), [(0, 90), (90, 0), (180, -90), (-90, 180), (45, 45), (135, -45), (-135, -135), (-180, -90)]
)
def test_yaw_of_the_compass_points(enu_deg: float, ned_deg: float) -> None:
    # East is 0 in ENU and 90 in NED; north 90 and 0; west 180 and -90; south -90 and 180.
    assert yaw_ned_from_enu(math.radians(enu_deg)) == pytest.approx(math.radians(ned_deg), abs=1e-12)
    back = math.degrees(yaw_enu_from_ned(math.radians(ned_deg)))
    assert (back - enu_deg) % 360 == pytest.approx(0, abs=1e-9) or (back - enu_deg) % 360 == pytest.approx(360)


@given(st.floats(-1000, 1000))
def test_wrapped_angles(angle: float) -> None:
    wrapped = wrap_angle(angle)
    assert -math.pi < wrapped <= math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-9)


def test_wrapping_refuses_what_is_no_angle() -> None:
    with pytest.raises(ValueError, match="finite"):
        wrap_angle(math.nan)

"""Fast conversion of an aircraft's map position to degrees."""

from __future__ import annotations

from jpap_ros.mavlink.geodesy import LocalFrame

#: The map bends by 0.4 mm against a straight line over this distance [m].
_REACH_M = 50.0
_PROBE_M = 10.0


class GeodeticAnchor:
    """Linear map from metres to degrees near an exactly converted point, renewed when the aircraft moves away.

    `LocalFrame.to_geodetic` iterates; called for each position message of a large fleet it would be most of the
    simulator's work.
    """

    def __init__(self, frame: LocalFrame) -> None:
        self._frame = frame
        self._anchored = False
        self._x = self._y = self._lat = self._lon = 0.0
        self._lat_x = self._lat_y = self._lon_x = self._lon_y = 0.0

    def to_geodetic(self, x: float, y: float) -> tuple[float, float]:
        """Latitude and longitude [deg] of a map point [m]."""
        dx, dy = x - self._x, y - self._y
        if not self._anchored or abs(dx) > _REACH_M or abs(dy) > _REACH_M:
            self._renew(x, y)
            dx = dy = 0.0
        return self._lat + self._lat_x * dx + self._lat_y * dy, self._lon + self._lon_x * dx + self._lon_y * dy

    def _renew(self, x: float, y: float) -> None:
        lat, lon = self._frame.to_geodetic(x, y)
        lat_e, lon_e = self._frame.to_geodetic(x + _PROBE_M, y)
        lat_n, lon_n = self._frame.to_geodetic(x, y + _PROBE_M)
        self._x, self._y, self._lat, self._lon = x, y, lat, lon
        self._lat_x, self._lon_x = (lat_e - lat) / _PROBE_M, (lon_e - lon) / _PROBE_M
        self._lat_y, self._lon_y = (lat_n - lat) / _PROBE_M, (lon_n - lon) / _PROBE_M
        self._anchored = True

"""Where the simulated room lies on earth."""

from __future__ import annotations

import math

ORIGIN_LATITUDE_DEG = 47.397742
ORIGIN_LONGITUDE_DEG = 8.545594
# Degrees, degrees, m above sea level, for autopilots that need it; a height of 0 is unknown to ArduPilot
ORIGIN_WGS84 = (ORIGIN_LATITUDE_DEG, ORIGIN_LONGITUDE_DEG, 10.0)
_EARTH_RADIUS_M = 6_371_000.0  # PX4 geo.h
_AROUND_M = _EARTH_RADIUS_M * math.cos(math.radians(ORIGIN_LATITUDE_DEG))
_E7 = 1e7  # degrees to MAVLink's integers


def degrees_e7(x_m: float, y_m: float) -> tuple[int, int]:
    """Latitude and longitude of a point of the room, 1e-7 degrees."""
    latitude = ORIGIN_LATITUDE_DEG + math.degrees(y_m / _EARTH_RADIUS_M)
    longitude = ORIGIN_LONGITUDE_DEG + math.degrees(x_m / _AROUND_M)
    return round(latitude * _E7), round(longitude * _E7)


def x_of(longitude_deg: float) -> float:
    """East of the origin, m."""
    return math.radians(longitude_deg - ORIGIN_LONGITUDE_DEG) * _AROUND_M


def y_of(latitude_deg: float) -> float:
    """North of the origin, m."""
    return math.radians(latitude_deg - ORIGIN_LATITUDE_DEG) * _EARTH_RADIUS_M

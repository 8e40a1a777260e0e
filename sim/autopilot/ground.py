"""Geodetic position of the simulated room."""

from __future__ import annotations

import math

ORIGIN_LATITUDE_DEG = 47.397742
ORIGIN_LONGITUDE_DEG = 8.545594
# latitude and longitude, degrees, height above sea level, m; ArduPilot treats a height of 0 as unknown
ORIGIN_WGS84 = (ORIGIN_LATITUDE_DEG, ORIGIN_LONGITUDE_DEG, 10.0)
_EARTH_RADIUS_M = 6_371_000.0  # radius of the earth in PX4's geo.h
_AROUND_M = _EARTH_RADIUS_M * math.cos(math.radians(ORIGIN_LATITUDE_DEG))
_E7 = 1e7  # number of MAVLink's integer units per degree


def degrees_e7(x_m: float, y_m: float) -> tuple[int, int]:
    """Return latitude and longitude, 1e-7 degrees, of a point in the room (ENU, m)."""
    latitude = ORIGIN_LATITUDE_DEG + math.degrees(y_m / _EARTH_RADIUS_M)
    longitude = ORIGIN_LONGITUDE_DEG + math.degrees(x_m / _AROUND_M)
    return round(latitude * _E7), round(longitude * _E7)


def x_of(longitude_deg: float) -> float:
    """Return the distance east of the origin, m."""
    return math.radians(longitude_deg - ORIGIN_LONGITUDE_DEG) * _AROUND_M


def y_of(latitude_deg: float) -> float:
    """Return the distance north of the origin, m."""
    return math.radians(latitude_deg - ORIGIN_LATITUDE_DEG) * _EARTH_RADIUS_M

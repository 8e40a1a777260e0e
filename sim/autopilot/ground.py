"""Whether the vehicle stands: contact that lasts, not a bounce."""

from __future__ import annotations

import math

from sim.autopilot.vehicle_like import VehicleLike

ORIGIN_LATITUDE_DEG = 47.397742
ORIGIN_LONGITUDE_DEG = 8.545594
# Degrees, degrees, m above sea level: what an autopilot is told that needs it. Its height is not 0, which
# ArduPilot takes for "not known"; the simulated one does not mind the height.
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


_CONTACT_S = 0.3  # s of unbroken contact until the vehicle counts as standing; bounces are shorter
_NO_CONTACT_S = 0.1  # s without contact until it counts as flying again


class Standing:
    """Watches the contacts.

    Attributes:
        now: on the ground or on the pad, not just touching.
        since_s: when that began.
    """

    def __init__(self, vehicle: VehicleLike) -> None:
        self._vehicle = vehicle
        self.now = vehicle.landed or vehicle.on_pad or vehicle.on_ground
        self.since_s = 0.0
        self._contact = self.now
        self._changed_s = 0.0

    def watch(self, now_s: float, armed: bool) -> None:
        """Look at the contacts; call it at every tick."""
        vehicle = self._vehicle
        contact = vehicle.on_pad or vehicle.on_ground or vehicle.landed
        if contact != self._contact:
            self._contact, self._changed_s = contact, now_s
        if contact == self.now:
            return
        lasted_s = now_s - self._changed_s
        if not armed or lasted_s >= (_CONTACT_S if contact else _NO_CONTACT_S) - 1e-9:
            self.now = contact or not armed
            self.since_s = now_s

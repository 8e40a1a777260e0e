"""Readings of PX4's sensors from the true state: body FRD, world NED, noise from the seed.

The IMU is read every 4 ms (250 Hz, IMU_INTEG_RATE of px4-rc.simulator). A reading has the mean acceleration
since the last reading and the current rates, both unfiltered, because PX4 filters them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from bridge.frames import body_from_world, frd_from_flu, ned_from_enu
from flightstack.core.types import Vec3
from sim.autopilot.ground import degrees_e7
from sim.plant.imu import Imu
from sim.plant.params import Params
from sim.plant.rotation import rotation_axes
from sim.plant.sensors import NoiseRows
from sim.px4.plant import Body

STEP_MS = 4  # time between two IMU readings, ms
SLOW_EVERY = 5  # number of IMU readings per reading of magnetometer and barometer: 50 Hz
GPS_EVERY = 25  # number of IMU readings per satellite fix: 10 Hz

# World magnetic model 2020 at the room's origin, 47.397742 N 8.545594 E, interpolated from PX4's tables
# (geo_magnetic_tables.hpp, 2023.6), with which EKF2 compares the magnetometer.
DECLINATION_RAD = 0.05713
INCLINATION_RAD = 1.10208
STRENGTH_GAUSS = 0.48197
MAG_NOISE_GAUSS = 0.003  # Bosch BMM150 data sheet: 0.3 uT rms

SEA_LEVEL_HPA, SEA_LEVEL_K, LAPSE_K_M, EXPONENT = 1013.25, 288.15, 0.0065, 5.25588  # values of ISO 2533
ZERO_CELSIUS_K = 273.15
BARO_NOISE_HPA = 0.012  # Bosch BMP388 data sheet: 1.2 Pa rms

# assumed standard deviations of a receiver with base station (RTK fix), which a pad of 0.1 m requires, m
GPS_NOISE_M = (0.010, 0.010, 0.020)
GPS_NOISE_M_S = (0.03, 0.03, 0.05)

ACCEL_MAX_M_S2 = 156.8  # range of 16 g, stored as a 16 bit number in PX4 (SimulatorMavlink.cpp)
GYRO_MAX_RAD_S = math.radians(1999.9)  # range of 2000 deg/s, stored as a 16 bit number in PX4


@dataclass(frozen=True, slots=True)
class Slow:
    """Readings of magnetometer and barometer."""

    mag_frd_gauss: Vec3
    pressure_hpa: float
    pressure_altitude_m: float
    temperature_c: float


@dataclass(frozen=True, slots=True)
class Fix:
    latitude_e7: int
    longitude_e7: int
    altitude_amsl_m: float
    velocity_ned_m_s: Vec3


@dataclass(frozen=True, slots=True)
class Readings:
    """New values at one IMU reading; None for a sensor without a new value."""

    accel_frd_m_s2: Vec3
    gyro_frd_rad_s: Vec3
    slow: Slow | None
    fix: Fix | None


def field_ned_gauss() -> Vec3:
    """Return the earth's magnetic field in the room, NED."""
    level = STRENGTH_GAUSS * math.cos(INCLINATION_RAD)
    return (
        level * math.cos(DECLINATION_RAD),
        level * math.sin(DECLINATION_RAD),
        STRENGTH_GAUSS * math.sin(INCLINATION_RAD),
    )


_NORTH, _EAST, _DOWN = field_ned_gauss()
_FIELD_ENU: Vec3 = (_EAST, _NORTH, -_DOWN)


def temperature_k(altitude_m: float) -> float:
    """Return the temperature of the standard atmosphere below 11 km."""
    return SEA_LEVEL_K - LAPSE_K_M * altitude_m


def pressure_hpa(altitude_m: float) -> float:
    """Return the pressure of the standard atmosphere below 11 km."""
    return float(SEA_LEVEL_HPA * (temperature_k(altitude_m) / SEA_LEVEL_K) ** EXPONENT)


def pressure_altitude_m(hpa: float) -> float:
    """Return the altitude for a pressure (inverse of ``pressure_hpa``)."""
    return float(SEA_LEVEL_K / LAPSE_K_M * (1.0 - (hpa / SEA_LEVEL_HPA) ** (1.0 / EXPONENT)))


def _within(v: Vec3, limit: float) -> Vec3:
    x, y, z = (max(-limit, min(limit, c)) for c in v)
    return (x, y, z)


class Px4Sensors:
    """All sensors of one vehicle, which starts at rest; call ``read`` every ``STEP_MS``."""

    def __init__(self, params: Params, body: Body, seed: int) -> None:
        raw = replace(params.imu, gyro_filter_hz=math.inf, accel_filter_hz=math.inf)
        gravity = params.contact.gravity_m_s2
        self._imu = Imu(raw, gravity, STEP_MS * 1e-3, seed)
        self._imu.settle(body.velocity_enu_m_s, body_from_world(body.quaternion, (0.0, 0.0, gravity)))
        self._mag = NoiseRows((MAG_NOISE_GAUSS,) * 3, seed, "px4.mag")
        self._baro = NoiseRows((BARO_NOISE_HPA,), seed, "px4.baro")
        self._gps = NoiseRows((*GPS_NOISE_M, *GPS_NOISE_M_S), seed, "px4.gps")
        self._count = 0

    def read(self, body: Body) -> Readings:
        """Return the readings that are due now."""
        count = self._count
        self._count += 1
        self._imu.measure(
            body.velocity_enu_m_s, body.angular_velocity_flu_rad_s, rotation_axes(body.quaternion)
        )
        return Readings(
            _within(frd_from_flu(self._imu.accel), ACCEL_MAX_M_S2),
            _within(frd_from_flu(self._imu.gyro), GYRO_MAX_RAD_S),
            self._read_slow(body) if count % SLOW_EVERY == 0 else None,
            self._read_gps(body) if count % GPS_EVERY == GPS_EVERY - 1 else None,  # PX4's clock runs already
        )

    def _read_slow(self, body: Body) -> Slow:
        x, y, z = frd_from_flu(body_from_world(body.quaternion, _FIELD_ENU))
        nx, ny, nz = self._mag.take()
        height = body.position_enu_m[2]
        hpa = pressure_hpa(height) + self._baro.take()[0]
        temperature_c = temperature_k(height) - ZERO_CELSIUS_K
        return Slow((x + nx, y + ny, z + nz), hpa, pressure_altitude_m(hpa), temperature_c)

    def _read_gps(self, body: Body) -> Fix:
        nx, ny, nz, nu, nv, nw = self._gps.take()
        x, y, z = body.position_enu_m
        vx, vy, vz = body.velocity_enu_m_s
        latitude, longitude = degrees_e7(x + nx, y + ny)
        return Fix(latitude, longitude, z + nz, ned_from_enu((vx + nu, vy + nv, vz + nw)))

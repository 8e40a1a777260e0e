"""Gyro and accelerometer at the control rate, with a random bias, white noise and first-order filters.

The filters have the group delay of the firmware's second-order Butterworth filters, sqrt(2) / (2 pi f).
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, Record, Vector, new
from flightstack.core.types import Vec3
from sim.chance import stream
from sim.plant.params import Imu as ImuParams
from sim.plant.rotation import Nine
from sim.plant.sensors import Tape, TapeRecord, take


class ImuRecord(Record):
    """Readings of the IMU and its parameters; body FLU, SI units."""

    gyro: Vector  # angular velocity, rad/s
    accel: Vector  # specific force, m/s^2
    velocity: Vector  # true velocity at the last measurement, world, m/s
    gyro_bias: Vector
    accel_bias: Vector
    gyro_sigma: float  # standard deviation of the white noise per measurement
    accel_sigma: float
    gyro_gain: float  # gain of the filter
    accel_gain: float
    per_step: float  # number of measurements per second
    gravity: float
    noise: TapeRecord


@jitted
def measure(imu: ImuRecord, velocity: F64, rates: F64, axes: Nine) -> None:
    """Measure the mean acceleration since the last call and the current rates; uses six random numbers.

    ``velocity``: true velocity, world, m/s; ``rates``: true body rates, rad/s; ``axes``: true body axes.
    """
    old, per_step = imu.velocity, imu.per_step
    ax, ay = (velocity[0] - old[0]) * per_step, (velocity[1] - old[1]) * per_step
    az = (velocity[2] - old[2]) * per_step + imu.gravity
    old[0], old[1], old[2] = velocity[0], velocity[1], velocity[2]
    for i in range(3):
        x, y, z = axes[3 * i], axes[3 * i + 1], axes[3 * i + 2]
        felt = x * ax + y * ay + z * az + imu.accel_bias[i] + imu.accel_sigma * take(imu.noise)
        imu.accel[i] += imu.accel_gain * (felt - imu.accel[i])
    for i in range(3):
        felt = rates[i] + imu.gyro_bias[i] + imu.gyro_sigma * take(imu.noise)
        imu.gyro[i] += imu.gyro_gain * (felt - imu.gyro[i])


class Imu:
    """One IMU. ``step_s``: time between calls of ``measure``; ``record``: record that stores the state."""

    def __init__(
        self, imu: ImuParams, gravity_m_s2: float, step_s: float, seed: int, record: ImuRecord | None = None
    ) -> None:
        self.record = r = new(ImuRecord) if record is None else record
        self._gyro, self._accel = r.gyro, r.accel
        rng = stream(seed, "imu.bias")
        r.gyro_bias[:] = imu.gyro_bias_rad_s * rng.standard_normal(3)
        r.accel_bias[:] = imu.accel_bias_m_s2 * rng.standard_normal(3)
        self.accel_bias: list[float] = r.accel_bias.tolist()  # accelerometer bias drawn from the seed, m/s^2
        band = math.sqrt(0.5 / step_s)  # white noise of density n has standard deviation n * sqrt(rate / 2)
        r.gyro_sigma = imu.gyro_noise_rad_s_sqrthz * band
        r.accel_sigma = imu.accel_noise_m_s2_sqrthz * band
        r.gyro_gain = -math.expm1(-step_s * math.sqrt(2.0) * math.pi * imu.gyro_filter_hz)
        r.accel_gain = -math.expm1(-step_s * math.sqrt(2.0) * math.pi * imu.accel_filter_hz)
        r.per_step = 1.0 / step_s
        r.gravity = gravity_m_s2
        r.accel[2] = gravity_m_s2
        self._tape = Tape(seed, "imu.noise", r.noise)

    def settle(self, velocity: Vec3, specific_force: Vec3) -> None:
        """Set the filters to their steady state for this specific force (body frame, m/s^2)."""
        r = self.record
        r.velocity[:] = velocity
        r.accel[:] = np.array(specific_force) + r.accel_bias
        r.gyro[:] = r.gyro_bias

    def top_up(self) -> None:
        """Draw noise for at least 170 measurements."""
        self._tape.top_up()

    def measure(self, velocity: Vec3, rates: Vec3, axes: Nine) -> None:
        self.top_up()
        measure(self.record, np.array(velocity), np.array(rates), axes)

    @property
    def gyro(self) -> Vec3:
        """Measured angular velocity, rad/s, body FLU."""
        x, y, z = self._gyro.tolist()
        return (x, y, z)

    @property
    def accel(self) -> Vec3:
        """Measured specific force, m/s^2, body FLU."""
        x, y, z = self._accel.tolist()
        return (x, y, z)

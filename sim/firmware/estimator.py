"""On-board state estimate: IMU at 500 Hz, corrected by position and yaw from the motion capture.

It stands for the Crazyflie's Kalman filter with external pose: same noise figures, same weakness (samples are
taken as if they were new, so that the estimate lags by the capture's delay when it moves), but with the
filter's stationary gains instead of a covariance. Per axis the states are position, velocity and an
acceleration error; horizontally the latter is a tilt of the attitude estimate (a tilt d makes g d of
acceleration), vertically it is the accelerometer's bias. Unlike the firmware in flight, which takes body z
alone, all three accelerometer axes count, so that wind does not pass for tilt.

Gains: steady state of the discrete Kalman filter at the capture's rate. Noise from firmware
kalman_core_params_defaults.h and kalman_core.c, which add (sigma dt)^2 every 1 ms: procNoiseAcc 0.5 and 1.0
m/s^2, gyro 0.1 rad/s; crtp_localization_service.c: position 0.01 m, quaternion 4.5e-3.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from flightstack.types import Vec3
from sim.firmware.setpoint import SensedState

FIRMWARE_STEP_S = 0.001
ACCEL_XY_M_S2, ACCEL_Z_M_S2 = 0.5, 1.0  # procNoiseAcc_xy, procNoiseAcc_z
GYRO_RAD_S = 0.1  # measNoiseGyro
POSITION_STD_M = 0.01  # extPosStdDev
YAW_STD_RAD = 2.0 * 4.5e-3  # extQuatStdDev is of half the angle
INNOVATION_AGE_MAX_S = 0.5  # without a sample for this long the estimate counts as invalid


@cache
def axis_gains(period_s: float, accel_std: float, gravity: float) -> tuple[float, float, float]:
    """Stationary gains on (position, velocity, acceleration error) for one metre of innovation.

    Args:
        period_s: time between position samples.
        accel_std: the firmware's acceleration noise of this axis, m/s^2 per 1 ms step.
        gravity: m/s^2, turns gyro noise into a random walk of the acceleration error.
    """
    t = period_s
    velocity_walk = accel_std**2 * FIRMWARE_STEP_S  # (m/s)^2 per s
    accel_walk = (gravity * GYRO_RAD_S) ** 2 * FIRMWARE_STEP_S  # (m/s^2)^2 per s
    f = np.array([[1.0, t, 0.5 * t * t], [0.0, 1.0, t], [0.0, 0.0, 1.0]])
    q = velocity_walk * np.array([[t**3 / 3, t**2 / 2, 0.0], [t**2 / 2, t, 0.0], [0.0, 0.0, 0.0]])
    q += accel_walk * np.array(
        [[t**5 / 20, t**4 / 8, t**3 / 6], [t**4 / 8, t**3 / 3, t**2 / 2], [t**3 / 6, t**2 / 2, t]]
    )
    r = POSITION_STD_M**2
    p = np.eye(3) * r
    gain = p[:, 0]
    for _ in range(10_000):
        p = f @ p @ f.T + q
        before, gain = gain, p[:, 0] / (p[0, 0] + r)
        p = p - np.outer(gain, p[0])
        if np.abs(gain - before).max() < 1e-12 * np.abs(gain).max():
            break
    k = gain.tolist()
    return (k[0], k[1], k[2])


def yaw_gain(period_s: float) -> float:
    """Stationary gain on yaw for one radian of innovation (scalar Riccati equation)."""
    q = GYRO_RAD_S**2 * FIRMWARE_STEP_S * period_s
    r = YAW_STD_RAD**2
    p = 0.5 * (q + math.sqrt(q * q + 4.0 * q * r))  # predicted variance
    return p / (p + r)


class Estimator:
    """Predict and correct. ``sensed`` holds the result, updated in place.

    Args:
        mocap_period_s: time between motion-capture samples.
        step_s: time between calls of ``predict``.
        gravity_m_s2: of the place.
    """

    __slots__ = (
        "_bias_z", "_gravity", "_half", "_kp", "_kp_z", "_kt", "_kv", "_kv_z", "_kyaw", "_kz", "_step",
        "sensed", "since_sample_s",
    )  # fmt: skip

    def __init__(self, mocap_period_s: float, step_s: float, gravity_m_s2: float) -> None:
        self._kp, self._kv, accel = axis_gains(mocap_period_s, ACCEL_XY_M_S2, gravity_m_s2)
        self._kt = accel / gravity_m_s2  # rad per m
        self._kp_z, self._kv_z, self._kz = axis_gains(mocap_period_s, ACCEL_Z_M_S2, gravity_m_s2)
        self._kyaw = yaw_gain(mocap_period_s)
        self._step = step_s
        self._half = 0.5 * step_s
        self._gravity = gravity_m_s2
        self._bias_z = 0.0
        self.sensed = SensedState()
        self.since_sample_s = 0.0

    def settle(
        self,
        position: Vec3,
        velocity: Vec3,
        axes: tuple[float, ...],
        quaternion: tuple[float, float, float, float],
        accel_bias: list[float],
    ) -> None:
        """Start converged: where the corrections would have balanced the accelerometer's bias."""
        sensed = self.sensed
        sensed.position, sensed.velocity, sensed.quaternion = position, velocity, quaternion
        a, b, c = accel_bias
        bx, by, bz = (axes[i] * a + axes[3 + i] * b + axes[6 + i] * c for i in range(3))
        self._bias_z = -bz
        self._turn(by / self._gravity, -bx / self._gravity, 0.0)

    def predict(self, gyro: Vec3, accel: Vec3) -> None:
        """Advance by one step with what the IMU measured (rad/s and m/s^2, body)."""
        sensed = self.sensed
        gx, gy, gz = gyro
        half = self._half
        ax, ay, az = gx * half, gy * half, gz * half
        w, x, y, z = sensed.quaternion
        w, x, y, z = (
            w - ax * x - ay * y - az * z,
            x + ax * w + az * y - ay * z,
            y + ay * w + ax * z - az * x,
            z + az * w + ay * x - ax * y,
        )
        scale = 1.5 - 0.5 * (w * w + x * x + y * y + z * z)  # one Newton step of 1 / sqrt
        w, x, y, z = w * scale, x * scale, y * scale, z * scale
        sensed.quaternion = (w, x, y, z)
        x2, y2, z2 = x + x, y + y, z + z
        xx, yy, zz, xy, xz, yz = x * x2, y * y2, z * z2, x * y2, x * z2, y * z2
        wx, wy, wz = w * x2, w * y2, w * z2
        axes = (
            1.0 - yy - zz,
            xy + wz,
            xz - wy,
            xy - wz,
            1.0 - xx - zz,
            yz + wx,
            xz + wy,
            yz - wx,
            1.0 - xx - yy,
        )
        sensed.axes = axes
        sensed.rates = gyro
        fx, fy, fz = accel
        step = self._step
        dvx = (axes[0] * fx + axes[3] * fy + axes[6] * fz) * step
        dvy = (axes[1] * fx + axes[4] * fy + axes[7] * fz) * step
        dvz = (axes[2] * fx + axes[5] * fy + axes[8] * fz - self._gravity + self._bias_z) * step
        px, py, pz = sensed.position
        vx, vy, vz = sensed.velocity
        sensed.position = (
            px + (vx + 0.5 * dvx) * step,
            py + (vy + 0.5 * dvy) * step,
            pz + (vz + 0.5 * dvz) * step,
        )
        sensed.velocity = (vx + dvx, vy + dvy, vz + dvz)
        self.since_sample_s += step

    def correct(self, x: float, y: float, z: float, yaw: float) -> None:
        """Take a motion-capture sample as if it were measured now."""
        sensed = self.sensed
        px, py, pz = sensed.position
        vx, vy, vz = sensed.velocity
        rx, ry, rz = x - px, y - py, z - pz
        sensed.position = (px + self._kp * rx, py + self._kp * ry, pz + self._kp_z * rz)
        sensed.velocity = (vx + self._kv * rx, vy + self._kv * ry, vz + self._kv_z * rz)
        self._bias_z += self._kz * rz
        error = yaw - math.atan2(sensed.axes[1], sensed.axes[0])
        turn = self._kyaw * math.atan2(math.sin(error), math.cos(error))
        self._turn(-self._kt * ry, self._kt * rx, turn)  # tilt d makes the acceleration g (d_y, -d_x)
        self.since_sample_s = 0.0

    def _turn(self, dx: float, dy: float, dz: float) -> None:
        """Turn the attitude estimate by a small rotation vector in the world frame."""
        sensed = self.sensed
        dx, dy, dz = 0.5 * dx, 0.5 * dy, 0.5 * dz
        w, x, y, z = sensed.quaternion
        w, x, y, z = (
            w - dx * x - dy * y - dz * z,
            x + dx * w + dy * z - dz * y,
            y + dy * w + dz * x - dx * z,
            z + dz * w + dx * y - dy * x,
        )
        scale = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
        sensed.quaternion = (w * scale, x * scale, y * scale, z * scale)

    @property
    def valid(self) -> bool:
        """Whether samples still come."""
        return self.since_sample_s < INNOVATION_AGE_MAX_S

"""On-board state estimator: IMU at 500 Hz, corrected by position and yaw from motion capture.

The estimator models the Crazyflie's Kalman filter for an external pose, with the firmware's noise figures.
Like the firmware, it ignores the age of samples, so the estimate of a moving vehicle lags by the latency of
motion capture. Stationary gains of the filter replace the covariance. The states of each axis are position,
velocity and acceleration error. The horizontal acceleration error is a tilt of the attitude estimate (a tilt
d causes the acceleration g d), the vertical error is the accelerometer's bias.

There are two forms. The default form uses all three accelerometer axes, so wind and drag do not look like
tilt; a pose has no roll and pitch. With ``known_drag_1_s`` the estimator has the firmware's form: in flight
it uses only body z of the accelerometer, computes the drag along body x and y from ``kalman.dragB_x`` and
``_y`` (the accelerometer measures the drag along z), receives full attitudes, and estimates no bias.
Unmodelled drag makes the estimated velocity too high, by 16 % at 0.46 1/s.

The gains are the steady state of the discrete Kalman filter at the capture's rate. Noise figures are from
firmware kalman_core_params_defaults.h and kalman_core.c, which add (sigma dt)^2 every 1 ms: procNoiseAcc 0.5
and 1.0 m/s^2, gyro 0.1 rad/s; crtp_localization_service.c: position 0.01 m, quaternion 4.5e-3.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, Record, Vector, reader, scalars
from flightstack.core.types import Vec3
from sim.firmware.setpoint import SensedState
from sim.plant.params import CONTROL_STEP_S
from sim.plant.states import Estimate

FIRMWARE_STEP_S = 0.001
ACCEL_XY_M_S2, ACCEL_Z_M_S2 = 0.5, 1.0  # accelerometer noise: procNoiseAcc_xy, procNoiseAcc_z
GYRO_RAD_S = 0.1  # gyro noise: measNoiseGyro
POSITION_STD_M = 0.01  # position noise: extPosStdDev
YAW_STD_RAD = 2.0 * 4.5e-3  # yaw noise: twice extQuatStdDev
TILT_STD_RAD = 4.5e-3  # tilt noise: extQuatStdDev (mm_pose.c)
INNOVATION_AGE_MAX_S = 0.5  # time without a sample after which the estimate is invalid, s


@cache
def axis_gains(period_s: float, accel_std: float, gravity: float) -> tuple[float, float, float]:
    """Return the stationary gains on (position, velocity, acceleration error) for one metre of innovation.

    ``accel_std``: the firmware's acceleration noise on this axis, m/s^2 per step of 1 ms. Gyro noise becomes
    a random walk of the acceleration error.
    """
    t = period_s
    velocity_walk = accel_std**2 * FIRMWARE_STEP_S  # variance rate of the velocity, (m/s)^2 per s
    accel_walk = (gravity * GYRO_RAD_S) ** 2 * FIRMWARE_STEP_S  # variance rate of that error, (m/s^2)^2 per s
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


@cache
def pose_gains(
    period_s: float, gravity: float
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Return the stationary gains of a pose on (position, velocity, tilt): per metre, then per radian."""
    t, g = FIRMWARE_STEP_S, gravity
    f = np.array([[1.0, t, 0.5 * g * t * t], [0.0, 1.0, g * t], [0.0, 0.0, 1.0]])
    q = np.diag([(ACCEL_XY_M_S2 * t * t) ** 2, (ACCEL_XY_M_S2 * t) ** 2, (GYRO_RAD_S * t) ** 2])
    p = np.eye(3) * POSITION_STD_M**2
    gains: list[tuple[float, float, float]] = []
    for _ in range(round(10.0 / period_s)):  # the slowest mode converges within a second
        gains.clear()
        for _ in range(round(period_s / t)):
            p = f @ p @ f.T + q
        for i, std in ((0, POSITION_STD_M), (2, TILT_STD_RAD)):
            k = p[:, i] / (p[i, i] + std**2)
            p = p - np.outer(k, p[i])
            gains.append((float(k[0]), float(k[1]), float(k[2])))
    return gains[0], gains[1]


def yaw_gain(period_s: float) -> float:
    """Return the stationary gain on yaw for one radian of innovation (scalar Riccati equation)."""
    q = GYRO_RAD_S**2 * FIRMWARE_STEP_S * period_s
    r = YAW_STD_RAD**2
    p = 0.5 * (q + math.sqrt(q * q + 4.0 * q * r))  # predicted variance of the yaw
    return p / (p + r)


class EstimatorRecord(Record):
    """State estimate, gains of the corrections, and constants."""

    sensed: SensedState
    bias_z: float  # estimated bias of the vertical acceleration, sign reversed, m/s^2
    since_sample_s: float
    kp: float  # horizontal gain on the position
    kv: float  # horizontal gain on the velocity, 1/s
    kt: float  # gain on the tilt, rad per m
    kp_z: float  # vertical gain on the position
    kv_z: float
    kz: float  # gain on the bias, 1/s^2
    kyaw: float
    by_pose: bool  # whether the estimator has the firmware's form
    body_z: bool  # whether only body z of the accelerometer is used (firmware's form in flight)
    known_drag: Vector  # rotor drag in the firmware's filter (kalman.dragB_*), body axes, 1/s
    kp_tilt: float  # gain from a pose's attitude to the position, m per rad
    kv_tilt: float  # gain from a pose's attitude to the velocity, m/s per rad
    kt_tilt: float  # gain from a pose's attitude to the tilt
    step: float  # time step, s
    gravity: float


@jitted
def predict(e: EstimatorRecord, gyro: F64, accel: F64) -> None:
    """Advance by one step with the IMU's measurement (rad/s and m/s^2, body frame)."""
    s = e.sensed
    half = 0.5 * e.step
    ax, ay, az = gyro[0] * half, gyro[1] * half, gyro[2] * half
    q = s.quaternion
    w, x, y, z = q[0], q[1], q[2], q[3]
    w, x, y, z = (
        w - ax * x - ay * y - az * z,
        x + ax * w + az * y - ay * z,
        y + ay * w + ax * z - az * x,
        z + az * w + ay * x - ax * y,
    )
    scale = 1.5 - 0.5 * (w * w + x * x + y * y + z * z)  # one Newton step of 1 / sqrt(norm^2)
    w, x, y, z = w * scale, x * scale, y * scale, z * scale
    q[0], q[1], q[2], q[3] = w, x, y, z
    # not rotation_axes, because its order of products rounds differently and would change recorded runs
    x2, y2, z2 = x + x, y + y, z + z
    xx, yy, zz, xy, xz, yz = x * x2, y * y2, z * z2, x * y2, x * z2, y * z2
    wx, wy, wz = w * x2, w * y2, w * z2
    axes = (1.0 - yy - zz, xy + wz, xz - wy, xy - wz, 1.0 - xx - zz, yz + wx, xz + wy, yz - wx, 1.0 - xx - yy)
    for i in range(9):
        s.axes[i] = axes[i]
    fx, fy, fz = accel[0], accel[1], accel[2]
    if e.body_z:
        v = s.velocity
        fx = -e.known_drag[0] * (axes[0] * v[0] + axes[1] * v[1] + axes[2] * v[2])
        fy = -e.known_drag[1] * (axes[3] * v[0] + axes[4] * v[1] + axes[5] * v[2])
    for i in range(3):
        s.rates[i] = gyro[i]
        felt = axes[i] * fx + axes[3 + i] * fy + axes[6 + i] * fz
        if i == 2:
            felt = felt - e.gravity + e.bias_z
        change = felt * e.step
        s.position[i] += (s.velocity[i] + 0.5 * change) * e.step
        s.velocity[i] += change
    e.since_sample_s += e.step


@jitted
def correct(e: EstimatorRecord, x: float, y: float, z: float, yaw: float) -> None:
    """Correct the estimate with a motion-capture sample; the sample's age is ignored."""
    p, v = e.sensed.position, e.sensed.velocity
    rx, ry, rz = x - p[0], y - p[1], z - p[2]
    p[0], p[1], p[2] = p[0] + e.kp * rx, p[1] + e.kp * ry, p[2] + e.kp_z * rz
    v[0], v[1], v[2] = v[0] + e.kv * rx, v[1] + e.kv * ry, v[2] + e.kv_z * rz
    e.bias_z += e.kz * rz
    error = yaw - math.atan2(e.sensed.axes[1], e.sensed.axes[0])
    turn = e.kyaw * math.atan2(math.sin(error), math.cos(error))
    turn_estimate(e.sensed, -e.kt * ry, e.kt * rx, turn)  # a tilt d causes the acceleration g (d_y, -d_x)
    e.since_sample_s = 0.0


@jitted
def correct_tilt(e: EstimatorRecord, quaternion: F64) -> None:
    """Correct the estimate with roll and pitch of a pose; call it after ``correct``."""
    s = e.sensed
    w, x, y, z = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    mx, my, mz = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)
    w, x, y, z = s.quaternion[0], s.quaternion[1], s.quaternion[2], s.quaternion[3]
    bx, by, bz = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)
    # rotation from the estimated to the measured body z
    about_x, about_y = by * mz - bz * my, bz * mx - bx * mz
    s.position[0] += e.kp_tilt * about_y
    s.position[1] -= e.kp_tilt * about_x
    s.velocity[0] += e.kv_tilt * about_y
    s.velocity[1] -= e.kv_tilt * about_x
    turn_estimate(s, e.kt_tilt * about_x, e.kt_tilt * about_y, 0.0)


@jitted
def replace_estimate(e: EstimatorRecord, state: F64, quaternion: F64, turn: F64) -> None:
    """Replace the estimate; the next ``predict`` updates the axes.

    ``state``: position (m) and velocity (m/s), ENU; ``quaternion``: true attitude; ``turn``: small rotation
    vector from true to estimated attitude, body frame, rad.
    """
    s = e.sensed
    for i in range(3):
        s.position[i], s.velocity[i] = state[i], state[3 + i]
    hx, hy, hz = 0.5 * turn[0], 0.5 * turn[1], 0.5 * turn[2]
    w, x, y, z = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    scale = 1.0 / math.sqrt((1.0 + hx * hx + hy * hy + hz * hz) * (w * w + x * x + y * y + z * z))
    s.quaternion[0] = scale * (w - x * hx - y * hy - z * hz)
    s.quaternion[1] = scale * (x + w * hx + y * hz - z * hy)
    s.quaternion[2] = scale * (y + w * hy + z * hx - x * hz)
    s.quaternion[3] = scale * (z + w * hz + x * hy - y * hx)
    e.since_sample_s = 0.0


@jitted
def turn_estimate(s: SensedState, dx: float, dy: float, dz: float) -> None:
    """Rotate the attitude estimate by a small rotation vector in the world frame, rad."""
    dx, dy, dz = 0.5 * dx, 0.5 * dy, 0.5 * dz
    q = s.quaternion
    w, x, y, z = q[0], q[1], q[2], q[3]
    w, x, y, z = (
        w - dx * x - dy * y - dz * z,
        x + dx * w + dy * z - dz * y,
        y + dy * w + dz * x - dx * z,
        z + dz * w + dx * y - dy * x,
    )
    scale = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    q[0], q[1], q[2], q[3] = w * scale, x * scale, y * scale, z * scale


class Estimator:
    """State estimator of one vehicle; ``sensed`` is the result. ``known_drag_1_s``: see the module."""

    def __init__(
        self, record: EstimatorRecord, mocap_period_s: float, gravity_m_s2: float,
        known_drag_1_s: Vec3 | None,
    ) -> None:  # fmt: skip
        self.record = r = record
        self.sensed = s = r.sensed
        (self._age_s,) = scalars(r, "since_sample_s")
        self._read = reader(s)
        r.kp, r.kv, accel = axis_gains(mocap_period_s, ACCEL_XY_M_S2, gravity_m_s2)
        r.kt = accel / gravity_m_s2
        r.kp_z, r.kv_z, r.kz = axis_gains(mocap_period_s, ACCEL_Z_M_S2, gravity_m_s2)
        r.kyaw = yaw_gain(mocap_period_s)
        if known_drag_1_s is not None:
            (r.kp, r.kv, r.kt), (r.kp_tilt, r.kv_tilt, r.kt_tilt) = pose_gains(mocap_period_s, gravity_m_s2)
            r.by_pose, r.known_drag[:], r.kz = True, known_drag_1_s, 0.0
        r.step = CONTROL_STEP_S
        r.gravity = gravity_m_s2
        self.sensed.quaternion[:] = (1.0, 0.0, 0.0, 0.0)
        self.sensed.axes[:] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)

    def settle(
        self, position: Vec3, velocity: Vec3, axes: tuple[float, ...],
        quaternion: tuple[float, float, float, float], accel_bias: list[float],
    ) -> None:  # fmt: skip
        """Start in the steady state in which the corrections balance the accelerometer's bias."""
        sensed, gravity = self.sensed, float(self.record.gravity)
        sensed.position[:], sensed.velocity[:], sensed.quaternion[:] = position, velocity, quaternion
        if self.record.by_pose:  # the filter by poses does not estimate the bias
            return
        a, b, c = accel_bias
        bx, by, bz = (axes[i] * a + axes[3 + i] * b + axes[6 + i] * c for i in range(3))
        self.record.bias_z = -bz
        turn_estimate(sensed, by / gravity, -bx / gravity, 0.0)

    def estimate(self) -> Estimate:
        """Return the newest estimate; it is invalid ``INNOVATION_AGE_MAX_S`` after the last sample."""
        s = self._read()  # values in the order of SensedState's fields
        return Estimate(s[:3], s[3:6], s[6:10], s[-3:], self._age_s[0] < INNOVATION_AGE_MAX_S)

    @property
    def valid(self) -> bool:
        return bool(self._age_s[0] < INNOVATION_AGE_MAX_S)

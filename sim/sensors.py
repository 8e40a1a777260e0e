"""Sensors: measurements on their way (noise, loss, delay), the IMU, and seeded random streams."""

from __future__ import annotations

import math
import zlib
from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from flightstack.types import Vec3
from sim.scenario import OdometryLink

if TYPE_CHECKING:
    from sim.params import Imu as ImuParams

NS = 1_000_000_000
NEVER_NS = 1 << 62
BLOCK = 1024  # numbers drawn at a time; single draws from numpy cost twenty times as much


def stream(seed: int, purpose: str) -> np.random.Generator:
    """Random stream of one purpose. Streams of different purposes are independent, whatever others draw."""
    return np.random.default_rng(np.random.SeedSequence([seed & (1 << 64) - 1, zlib.crc32(purpose.encode())]))


class Normals:
    """Standard normal numbers, drawn in blocks."""

    __slots__ = ("_left", "_rng")

    def __init__(self, seed: int, purpose: str) -> None:
        self._rng = stream(seed, purpose)
        self._left: list[float] = []

    def take(self) -> float:
        """Return the next number."""
        if not self._left:
            self._left = self._rng.standard_normal(BLOCK).tolist()
        return self._left.pop()


class MeasurementChannel:
    """Samples a quantity at the link's rate and hands the samples out after the link's delay, in order.

    Sample k is measured at time k / rate. A lost sample, or one taken within a drop-out, never comes.
    Drop-outs begin as a Poisson process of mean distance ``dropout_every_s`` and last uniformly up to
    ``dropout_max_s``. Times are integer nanoseconds. ``due_ns`` and ``release_ns`` tell when the next call
    has something to do.

    Args:
        link: rate, delay, loss, drop-outs.
        sigmas: standard deviation of the noise on each value.
        seed: of the run.
        purpose: name of the random stream.
    """

    __slots__ = (
        "_delay_ns", "_drop_end_ns", "_drop_start_ns", "_index", "_link", "_normals", "_queue", "_rate",
        "_rng", "_sigmas", "due_ns", "lost", "release_ns", "taken",
    )  # fmt: skip

    def __init__(self, link: OdometryLink, sigmas: Sequence[float], seed: int, purpose: str) -> None:
        self._link = link
        self._sigmas = tuple(sigmas)
        self._rng = stream(seed, purpose + ".loss")
        self._normals = Normals(seed, purpose + ".noise")
        self._rate = link.rate_hz
        self._delay_ns = round(link.delay_s * NS)
        self._queue: deque[tuple[int, int, tuple[float, ...]]] = deque()
        self._index = 0
        self._drop_start_ns = self._drop_end_ns = NEVER_NS
        self.due_ns = 0
        self.release_ns = NEVER_NS
        self.taken = 0
        self.lost = 0
        if link.dropout_every_s > 0.0 and link.dropout_max_s > 0.0:
            self._draw_dropout(0)

    def _draw_dropout(self, after_ns: int) -> None:
        self._drop_start_ns = after_ns + round(self._rng.exponential(self._link.dropout_every_s) * NS)
        self._drop_end_ns = self._drop_start_ns + round(self._rng.uniform(0.0, self._link.dropout_max_s) * NS)

    def sample(self, now_ns: int, values: Sequence[float]) -> None:
        """Measure ``values`` now. Call when ``now_ns >= due_ns``; one sample a call."""
        self._index += 1
        self.due_ns = round(self._index * NS / self._rate)
        self.taken += 1
        while now_ns >= self._drop_end_ns:
            self._draw_dropout(self._drop_end_ns)
        take = self._normals.take
        noisy = tuple([v + s * take() if s else v for v, s in zip(values, self._sigmas, strict=True)])
        lost = self._link.loss > 0.0 and self._rng.random() < self._link.loss
        if lost or now_ns >= self._drop_start_ns:
            self.lost += 1
            return
        if not self._queue:
            self.release_ns = now_ns + self._delay_ns
        self._queue.append((now_ns + self._delay_ns, now_ns, noisy))

    def release(self, now_ns: int) -> list[tuple[int, tuple[float, ...]]]:
        """Return ``(measured_ns, values)`` of all samples whose delay has passed, oldest first."""
        queue = self._queue
        out = []
        while queue and queue[0][0] <= now_ns:
            _, measured_ns, values = queue.popleft()
            out.append((measured_ns, values))
        self.release_ns = queue[0][0] if queue else NEVER_NS
        return out


class Imu:
    """Gyro and accelerometer: bias drawn from the seed, white noise, first-order filter, at the control rate.

    The filters have the group delay of the firmware's second-order Butterworth filters, sqrt(2) / (2 pi f).

    Attributes:
        gyro: rad/s, body FLU.
        accel: specific force, m/s^2, body FLU.
        accel_bias: the bias drawn.

    Args:
        imu: noise, biases, filters.
        gravity_m_s2: of the place.
        step_s: time between calls of ``measure``.
        seed: of the run.
    """

    __slots__ = (
        "_accel_gain", "_accel_sigma", "_gravity", "_gyro_bias", "_gyro_gain", "_gyro_sigma", "_normals",
        "_per_step", "_velocity", "accel", "accel_bias", "gyro",
    )  # fmt: skip

    def __init__(self, imu: ImuParams, gravity_m_s2: float, step_s: float, seed: int) -> None:
        rng = stream(seed, "imu.bias")
        self._gyro_bias: list[float] = (imu.gyro_bias_rad_s * rng.standard_normal(3)).tolist()
        self.accel_bias: list[float] = (imu.accel_bias_m_s2 * rng.standard_normal(3)).tolist()
        band = math.sqrt(0.5 / step_s)  # white noise of density n has n * sqrt(rate / 2) per sample
        self._gyro_sigma = imu.gyro_noise_rad_s_sqrthz * band
        self._accel_sigma = imu.accel_noise_m_s2_sqrthz * band
        self._gyro_gain = -math.expm1(-step_s * math.sqrt(2.0) * math.pi * imu.gyro_filter_hz)
        self._accel_gain = -math.expm1(-step_s * math.sqrt(2.0) * math.pi * imu.accel_filter_hz)
        self._per_step = 1.0 / step_s
        self._gravity = gravity_m_s2
        self._normals = Normals(seed, "imu.noise")
        self._velocity: Vec3 = (0.0, 0.0, 0.0)
        self.gyro: Vec3 = (0.0, 0.0, 0.0)
        self.accel: Vec3 = (0.0, 0.0, gravity_m_s2)

    def settle(self, velocity: Vec3, specific_force: Vec3) -> None:
        """Start as if it had measured this for long (specific force in the body frame)."""
        self._velocity = velocity
        fx, fy, fz = specific_force
        bx, by, bz = self.accel_bias
        self.accel = (fx + bx, fy + by, fz + bz)
        self.gyro = (self._gyro_bias[0], self._gyro_bias[1], self._gyro_bias[2])

    def measure(self, velocity: Vec3, rates: Vec3, axes: tuple[float, ...]) -> None:
        """Measure: mean acceleration since the last call, and the rates now."""
        per_step = self._per_step
        ox, oy, oz = self._velocity
        self._velocity = velocity
        vx, vy, vz = velocity
        ax, ay, az = (vx - ox) * per_step, (vy - oy) * per_step, (vz - oz) * per_step + self._gravity
        xx, xy, xz, yx, yy, yz, zx, zy, zz = axes
        take = self._normals.take
        s, gain, (bx, by, bz), (fx, fy, fz) = self._accel_sigma, self._accel_gain, self.accel_bias, self.accel
        self.accel = (
            fx + gain * (xx * ax + xy * ay + xz * az + bx + s * take() - fx),
            fy + gain * (yx * ax + yy * ay + yz * az + by + s * take() - fy),
            fz + gain * (zx * ax + zy * ay + zz * az + bz + s * take() - fz),
        )
        wx, wy, wz = rates
        s, gain, (bx, by, bz), (fx, fy, fz) = self._gyro_sigma, self._gyro_gain, self._gyro_bias, self.gyro
        self.gyro = (
            fx + gain * (wx + bx + s * take() - fx),
            fy + gain * (wy + by + s * take() - fy),
            fz + gain * (wz + bz + s * take() - fz),
        )

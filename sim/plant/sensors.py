"""Measurements with noise, loss and delay; gyro and accelerometer at the control rate.

Gyro and accelerometer have a random bias, white noise and first-order filters. The filters have the group
delay of the firmware's second-order Butterworth filters, sqrt(2) / (2 pi f).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Annotated, TypeVar

import numpy as np
import numpy.typing as npt

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, I64, Record, Vector, cell, new
from flightstack.core.types import Vec3
from sim.chance import stream
from sim.plant.params import Imu as ImuParams
from sim.plant.states import Nine
from sim.scenarios.tables import OdometryLink

Time = TypeVar("Time", int, I64)

NS = 1_000_000_000
NS_PER_MS = 1_000_000
NEVER_NS = 1 << 62
NO_NOISE = -0.0  # zero noise; adding -0.0 does not change the sign of a zero
BLOCK = 1024  # number of random values in one draw; a single draw takes twenty times as long per value


def ms_from(time_ns: Time) -> Time:
    """Return times in whole milliseconds, rounded up."""
    return -(-time_ns // NS_PER_MS)


def normals(rng: np.random.Generator) -> F64:
    """Return a block of standard normal numbers."""
    drawn: F64 = rng.standard_normal(BLOCK)
    return drawn[::-1]


class NoiseRows:
    """Noise for samples of several values; each value with a nonzero sigma uses one normal number."""

    def __init__(self, sigmas: Sequence[float], seed: int, purpose: str) -> None:
        self._sigmas = np.array(sigmas, dtype=np.float64)
        self._noisy = self._sigmas != 0.0
        self._rng = stream(seed, purpose)
        self._left = np.empty((0, len(self._sigmas)))  # rows that are drawn but not taken

    def take(self, count: int) -> F64:
        """Return the noise of the next samples, one row for each."""
        while len(self._left) < count:
            self._left = np.concatenate((self._left, self._block()))
        rows, self._left = self._left[:count], self._left[count:]
        return rows

    def _block(self) -> F64:
        """Draw and return the noise of further samples."""
        width = int(self._noisy.sum())
        if width == 0:
            return np.full((BLOCK, len(self._sigmas)), NO_NOISE)
        blocks = [normals(self._rng) for _ in range(width // math.gcd(width, BLOCK))]
        numbers = np.concatenate(blocks).reshape(-1, width)
        rows = np.full((len(numbers), len(self._sigmas)), NO_NOISE)
        rows[:, self._noisy] = self._sigmas[self._noisy] * numbers
        return rows


class TapeRecord(Record):
    """Normal numbers drawn in advance for compiled code, in the order of use."""

    numbers: Annotated[F64, 2 * BLOCK]
    next: int


@jitted
def take(tape: TapeRecord) -> float:
    """Return the next number; the tape must not be empty (``Tape.top_up``)."""
    tape.next += 1
    return float(tape.numbers[tape.next - 1])


class Tape:
    """Supplies compiled code, which cannot draw random numbers, with normal numbers."""

    def __init__(self, seed: int, purpose: str, record: TapeRecord) -> None:
        self._rng = stream(seed, purpose)
        self._next, self._numbers = cell(record)["next"], record.numbers
        self._numbers[:BLOCK] = normals(self._rng)
        self._numbers[BLOCK:] = normals(self._rng)

    def top_up(self) -> None:
        """Draw until at least ``BLOCK`` numbers are available."""
        if self._next[0] >= BLOCK:
            self._numbers[:BLOCK] = self._numbers[BLOCK:]
            self._numbers[BLOCK:] = normals(self._rng)
            self._next -= BLOCK


class Losses:
    """Lost samples of a link: random single losses, and all samples within a drop-out.

    Drop-outs start as a Poisson process with the mean interval ``dropout_every_s``; their duration is uniform
    up to ``dropout_max_s``. ``purpose``: name of the random stream.
    """

    def __init__(self, link: OdometryLink, seed: int, purpose: str) -> None:
        self._link = link
        self._rng = stream(seed, purpose)
        self._chances = np.empty(0)  # drawn in advance
        self._drop_start_ns = self._drop_end_ns = NEVER_NS
        if link.dropout_every_s > 0.0 and link.dropout_max_s > 0.0:
            self._draw_dropout(0)

    def _draw_dropout(self, after_ns: int) -> None:
        self._drop_start_ns = after_ns + round(self._rng.exponential(self._link.dropout_every_s) * NS)
        self._drop_end_ns = self._drop_start_ns + round(self._rng.uniform(0.0, self._link.dropout_max_s) * NS)

    def lost(self, measured_ns: I64) -> npt.NDArray[np.bool_]:
        """Return for each of the next samples, in order, whether it is lost."""
        if self._drop_start_ns != NEVER_NS:
            return np.array([self._one_lost(time_ns) for time_ns in measured_ns.tolist()], dtype=np.bool_)
        if self._link.loss == 0.0:
            return np.zeros(len(measured_ns), np.bool_)
        while len(self._chances) < len(measured_ns):
            self._chances = np.concatenate((self._chances, self._rng.random(BLOCK)))
        chances, self._chances = np.split(self._chances, [len(measured_ns)])
        return chances < self._link.loss

    def _one_lost(self, measured_ns: int) -> bool:
        """Whether the next sample is lost; drop-outs and single losses use the same random numbers."""
        while measured_ns >= self._drop_end_ns:
            self._draw_dropout(self._drop_end_ns)
        by_chance = self._link.loss > 0.0 and self._rng.random() < self._link.loss
        return bool(by_chance or measured_ns >= self._drop_start_ns)


class MeasurementChannel:
    """Samples a quantity at the link's rate and releases the samples after the link's delay, in order.

    Sample k is measured at time k / rate and can be lost (``Losses``). Times are integer nanoseconds.
    ``sigmas``: standard deviation of the noise of each value; ``purpose``: name of the random stream.
    """

    def __init__(self, link: OdometryLink, sigmas: Sequence[float], seed: int, purpose: str) -> None:
        self._losses, self._width = Losses(link, seed, purpose + ".loss"), len(sigmas)
        self._noise = NoiseRows(sigmas, seed, purpose + ".noise")
        self._rate, self._delay_ns = link.rate_hz, round(link.delay_s * NS)
        self._waiting = np.empty((0, 1 + self._width))  # time of measurement, ns, and values
        self._taken = self._due_ns = 0  # number of measurements; time of the next measurement, ns

    def run(self, times_ns: Sequence[int], measure: Callable[[list[int]], F64]) -> tuple[list[int], F64]:
        """Measure the samples that are due at these times, in increasing order, and release samples.

        ``measure``: function from the indices (in ``times_ns``) of n due samples to their values, (n, width).
        Returns the index of the time at which each sample is released, and the m released samples,
        (m, 1 + width): time of measurement, ns, and values.
        """
        if not times_ns:
            return [], self._waiting[:0]
        due: list[int] = []
        for n, now_ns in enumerate(times_ns):
            if now_ns >= self._due_ns:
                due.append(n)
                self._taken += 1
                self._due_ns = round(self._taken * NS / self._rate)
        times = np.array(times_ns, dtype=np.int64)
        if due:
            rows = np.column_stack((times[due], measure(due) + self._noise.take(len(due))))
            self._waiting = np.concatenate((self._waiting, rows[~self._losses.lost(times[due])]))
        released_ns = self._waiting[:, 0].astype(np.int64) + self._delay_ns
        count = int(np.searchsorted(released_ns, times[-1], side="right"))
        released, self._waiting = self._waiting[:count], self._waiting[count:]
        return np.searchsorted(times, released_ns[:count]).tolist(), released


class ImuRecord(Record):
    """Readings of the IMU and its parameters; body FLU, SI units."""

    gyro: Vector  # angular velocity, rad/s
    accel: Vector  # specific force, m/s^2
    velocity: Vector  # true velocity at the last measurement, world, m/s
    gyro_bias: Vector
    accel_bias: Vector
    gyro_sigma: float  # standard deviation of the white noise per measurement
    accel_sigma: float
    gyro_gain: float  # gain of the gyro's low-pass filter in one measurement
    accel_gain: float
    per_step: float  # number of measurements per second
    gravity: float
    noise: TapeRecord


@jitted
def measure(imu: ImuRecord, velocity: F64, rates: F64, axes: Nine) -> None:
    """Measure mean acceleration and rates with six random numbers, from world velocity and body rates."""
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

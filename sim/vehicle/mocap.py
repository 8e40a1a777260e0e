"""Motion capture for compiled code: Python draws the random numbers of each sample in advance.

Time, noise and loss of a sample depend only on the seed, so the compiled code only adds the true pose. The
random numbers and their order equal those of ``MeasurementChannel``.

With the errors of recorded flights (``StateError``) a sample is a complete on-board estimate: the sample
arrives without delay and replaces the estimate. A fault that diverts samples receives only position and
heading.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, I64, Record, scalars
from sim.firmware.estimator import EstimatorRecord, correct, correct_tilt, replace_estimate
from sim.plant.sensors import NS, NS_PER_MS, Losses, NoiseRows, ms_from
from sim.plant.state_error import TURN, WIDTH, ErrorRows, PastRecord, mismeasure
from sim.plant.states import rotation_axes
from sim.scenarios.tables import OdometryLink, StateError
from sim.world.bodies import BodyRecord

ROWS = 512  # number of stored samples; at most 250 are in transit (500 Hz, 0.5 s)
LOST = -1
VALUES = 4  # x, y, z (ENU, m), yaw (rad)


class MocapRecord(Record):
    """Samples in the order of measurement: arrived samples, then samples in transit, then future samples."""

    measured_ms: Annotated[I64, ROWS]
    arrives_ms: Annotated[I64, ROWS]  # arrival time, ms, or ``LOST``
    values: Annotated[F64, ROWS * VALUES]  # noise of each value; after the measurement, the measured value
    measuring: int  # row of the next measurement
    arriving: int  # row of the next arrival
    diverted: bool  # whether a fault sends arriving samples to Python code
    recorded: bool  # whether samples have the errors of recorded flights (``errors``)
    errors: Annotated[F64, ROWS * WIDTH]
    past: PastRecord


@jitted
def measure_pose(m: MocapRecord, body: BodyRecord, now_ms: int) -> None:
    """Measure the due samples; their rows must be filled (``MocapTape.top_up``)."""
    while m.measured_ms[m.measuring] <= now_ms:
        axes = rotation_axes(body.quaternion)
        at = VALUES * m.measuring
        if m.recorded:
            row = m.errors[WIDTH * m.measuring : WIDTH * (m.measuring + 1)]
            mismeasure(m.past, body.position, body.velocity, row)
            for i in range(3):
                m.values[at + i] = m.past.late[i]
            m.values[at + 3] = row[TURN + 2]
        else:
            for i in range(3):
                m.values[at + i] += body.position[i]
        m.values[at + 3] += math.atan2(axes[1], axes[0])
        m.measuring += 1


@jitted
def next_arrived(m: MocapRecord, now_ms: int) -> int:
    """Return the index of the first value of the next arrived sample, or -1."""
    while m.arriving < m.measuring and m.arrives_ms[m.arriving] <= now_ms:
        m.arriving += 1
        if m.arrives_ms[m.arriving - 1] != LOST:
            return VALUES * (m.arriving - 1)
    return -1


@jitted
def correct_estimate(m: MocapRecord, estimator: EstimatorRecord, body: BodyRecord, now_ms: int) -> None:
    """Pass arrived samples to the estimator."""
    at = next_arrived(m, now_ms)
    while at >= 0:
        if m.recorded:
            turn = m.errors[WIDTH * (m.arriving - 1) + TURN : WIDTH * m.arriving]
            replace_estimate(estimator, m.past.late, body.quaternion, turn)
        else:
            correct(estimator, m.values[at], m.values[at + 1], m.values[at + 2], m.values[at + 3])
            if estimator.by_pose:
                correct_tilt(estimator, body.quaternion)  # the measured tilt has no error and no delay
        at = next_arrived(m, now_ms)


class MocapTape:
    """Fills the rows with random numbers; with ``error``, recorded errors replace noise and delay."""

    def __init__(
        self, link: OdometryLink, seed: int, record: MocapRecord, body: BodyRecord,
        error: StateError | None = None,
    ) -> None:  # fmt: skip
        noise = link.position_noise_m
        self._rate_hz, self._delay_ns = link.rate_hz, round(link.delay_s * NS)
        self._errors = None
        self._error_rows = record.errors.reshape(ROWS, WIDTH)
        if error is not None:
            self._errors, self._delay_ns = ErrorRows(error, seed, "own", link.rate_hz), 0
            record.recorded, record.past.rate = True, link.rate_hz
        self._losses = Losses(link, seed, "mocap.loss")
        self._noise = NoiseRows((noise, noise, noise, link.yaw_noise_rad), seed, "mocap.noise")
        self._record, self._body = record, body
        self._measured_ms, self._arrives_ms, self._values = (
            record.measured_ms, record.arrives_ms, record.values.reshape(ROWS, VALUES),
        )  # fmt: skip
        self._measuring, self._arriving = scalars(record, "measuring", "arriving")
        self._count = 0  # number of samples whose random numbers are drawn
        self._fill(0)

    @property
    def drawn_until_ms(self) -> int:
        """Time of the last measurement whose random numbers are drawn, ms."""
        return int(self._measured_ms[-1])

    def top_up(self) -> None:
        """Fill the rows for at least the next half second and at most ten minutes."""
        if self._measuring[0] < ROWS // 2:
            return
        done = int(self._arriving[0])
        for rows in (self._measured_ms, self._arrives_ms, self._values, self._error_rows):
            rows[: ROWS - done] = rows[done:].copy()
        self._measuring[0] -= done
        self._arriving[0] = 0
        self._fill(ROWS - done)

    def _fill(self, first: int) -> None:
        counts = np.arange(self._count, self._count + ROWS - first)
        self._count += len(counts)
        measured_ms = ms_from(np.rint(counts * NS / self._rate_hz).astype(np.int64))
        measured_ns = measured_ms * NS_PER_MS
        self._measured_ms[first:] = measured_ms
        self._arrives_ms[first:] = ms_from(measured_ns + self._delay_ns)
        self._arrives_ms[first:][self._losses.lost(measured_ns)] = LOST
        self._values[first:] = self._noise.take(len(counts))
        if self._errors is not None:
            self._error_rows[first:] = self._errors.take(len(counts))

    def take(self, now_ms: int) -> list[tuple[float, ...]]:
        """Measure due samples; return the samples that have arrived."""
        measure_pose(self._record, self._body, now_ms)
        samples: list[tuple[float, ...]] = []
        while (at := next_arrived(self._record, now_ms)) >= 0:
            samples.append(tuple(self._values[at // VALUES].tolist()))
        return samples

    def next_ms(self) -> int:
        """Return the time at which ``take`` next measures or releases a sample, ms."""
        measuring, arriving = int(self._measuring[0]), int(self._arriving[0])
        measured_ms = int(self._measured_ms[measuring])
        return min(measured_ms, int(self._arrives_ms[arriving])) if arriving < measuring else measured_ms

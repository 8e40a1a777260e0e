"""Errors of a measured state as in recorded flights; the largest part is a varying delay.

A row of random numbers for each sample is drawn in advance. The sample is computed from the row and the true
path: a delayed position plus a small error, a velocity with errors that grow with speed, and a rotated
attitude.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, Cell, Record
from sim.chance import stream
from sim.scenarios.tables import StateError

# columns of a row of errors
DELAY = 0  # delay of the position, s; negative: prediction
VELOCITY_DELAY = 1  # delay of the velocity, s
POSITION = 2  # first of three columns: error of the position, ENU, m
AHEAD, ASIDE = 5, 6  # velocity error along and left of the horizontal velocity, divided by the speed
STILL_AHEAD, STILL_ASIDE = 7, 8  # additional velocity error at any speed, along and left, m/s
VELOCITY = 9  # first of three columns: velocity error in world axes, ENU, m/s
TURN = 12  # first of three columns: rotation vector from true to measured attitude, body FLU, rad
WIDTH = 15

PAST = 128  # number of stored states: 0.25 s at 500 Hz
DELAY_MAX_S = 0.2
DELAY_MIN_S = -0.1  # lower limit of the delay, s; a negative delay is a prediction at constant velocity
SMOOTH_S = 0.02  # smoothing time, s; the correlation of recorded errors is 0.98 to 0.99 after 10 ms
SETTLED = 12.0  # settling time of the noise before its use, divided by its time constant


class PastRecord(Record):
    """Ring buffer of the true states at the last samples, and the measured state computed from it."""

    states: Annotated[F64, 6 * PAST]  # ring buffer of position (m) and velocity (m/s), ENU
    count: int  # number of states stored since the start
    rate: float  # number of stored states per second
    late: Annotated[F64, 6]  # measured (delayed) position, m, and velocity, m/s


@jitted
def _recall(past: PastRecord, delay_s: float, first: int) -> None:
    """Write three components of the state ``delay_s`` (>= 0) ago to ``past.late``, from ``first`` on."""
    back = max(0.0, min(delay_s * past.rate, float(min(past.count, PAST) - 1)))
    whole = int(back)
    share = back - whole
    newer = 6 * ((past.count - 1 - whole) % PAST) + first
    older = 6 * ((past.count - 2 - whole) % PAST) + first
    for i in range(3):
        value = past.states[newer + i]
        if share > 0.0:
            value += share * (past.states[older + i] - value)
        past.late[first + i] = value


@jitted
def mismeasure(past: PastRecord, position: F64, velocity: F64, row: F64) -> None:
    """Store the true state (ENU) in ``past``; write the state with the errors of ``row`` to ``past.late``."""
    at = 6 * (past.count % PAST)
    for i in range(3):
        past.states[at + i] = position[i]
        past.states[at + 3 + i] = velocity[i]
    past.count += 1
    late = past.late
    _recall(past, row[DELAY], 0)
    _recall(past, abs(row[VELOCITY_DELAY]), 3)
    lead_s = max(0.0, -row[DELAY])
    for i in range(3):
        late[i] += velocity[i] * lead_s + row[POSITION + i]
        if row[VELOCITY_DELAY] < 0.0:  # extrapolate by the last change: a derivative jumps at an impact
            late[3 + i] = 2.0 * velocity[i] - late[3 + i]
    speed = math.sqrt(late[3] * late[3] + late[4] * late[4])
    x, y = 1.0, 0.0
    if speed > 0.0:
        x, y = late[3] / speed, late[4] / speed
    along, across = row[AHEAD] * speed + row[STILL_AHEAD], row[ASIDE] * speed + row[STILL_ASIDE]
    late[3] += along * x - across * y
    late[4] += along * y + across * x
    for i in range(3):
        late[3 + i] += row[VELOCITY + i]


@jitted
def mismeasured_path(
    past: Cell[PastRecord], positions: F64, velocities: F64, rows: F64, measured: F64
) -> None:
    """Write measured position and velocity for each of the n samples of a path to ``measured`` (n, 6)."""
    for k in range(len(positions)):
        mismeasure(past[0], positions[k], velocities[k], rows[k])
        for i in range(6):
            measured[k, i] = past[0].late[i]


class Noise:
    """Correlated normal noise of several values with variance one: white noise through two first-order lags.

    The correlation after t is (T exp(-t / T) - S exp(-t / S)) / (T - S), or (1 + t / T) exp(-t / T) if T = S.
    The noise is smooth from sample to sample, because jumps would excite the controllers on board.
    ``width``: number of values; ``time_s``: T; ``smooth_s``: S; ``step_s``: time between samples.
    """

    def __init__(
        self, rng: np.random.Generator, width: int, time_s: float, smooth_s: float, step_s: float
    ) -> None:
        p, q = math.exp(-step_s / time_s), math.exp(-step_s / smooth_s)
        self._rng, self._width, self._lag = rng, width, [1.0, -p - q, p * q]
        self._gain = math.sqrt((1.0 - p * q) * (1.0 - p * p) * (1.0 - q * q) / (1.0 + p * q))
        self._state = np.zeros((2, width))
        self.take(round(SETTLED * max(time_s, smooth_s) / step_s) + 1)

    def take(self, count: int) -> F64:
        """Return the next samples, (count, width)."""
        from scipy.signal import lfilter  # late import: it takes 0.5 s, few flights need it

        white = self._gain * self._rng.standard_normal((count, self._width))
        out, self._state = lfilter([1.0], self._lag, white, axis=0, zi=self._state)
        noise: F64 = out
        return noise


_NOISY = (*range(POSITION, POSITION + 3), AHEAD, ASIDE, VELOCITY + 2, *range(TURN, TURN + 3))  # noisy columns


class ErrorRows:
    """Errors from the model of ``StateError``; with ``delay_shared``, all purposes have one mean delay."""

    def __init__(self, spec: StateError, seed: int, purpose: str, rate_hz: float) -> None:
        self._spec = spec
        rng, step_s = stream(seed, f"{purpose}.model"), 1.0 / rate_hz
        base, lead, fast, slow = rng.standard_normal(4).tolist()
        if spec.delay_shared:
            base = float(stream(seed, "capture.delay").standard_normal())
        self._base_s = spec.delay_s + spec.delay_spread_s * _within(base)
        self._velocity_delay_s = (
            self._base_s - spec.velocity_lead_s + spec.velocity_lead_spread_s * _within(lead)
        )
        self._fast_s = spec.delay_fast_s * math.exp(spec.delay_fast_varies * _within(fast))
        self._slow_s = spec.delay_slow_s * math.exp(spec.delay_slow_varies * _within(slow))
        self._turn = np.array((spec.tilt_rad, spec.tilt_rad, spec.yaw_rad)) * rng.standard_normal(3)
        self._scale = spec.velocity_scale * _within(float(rng.standard_normal()))
        one, two, three = rng.spawn(3)  # separate streams, so that rows do not depend on the block size
        fast_s, slow_s = spec.delay_fast_time_s, spec.delay_slow_time_s
        self._fast, self._slow = Noise(one, 1, fast_s, fast_s, step_s), Noise(two, 1, slow_s, slow_s, step_s)
        self._state = Noise(three, len(_NOISY), spec.error_time_s, SMOOTH_S, step_s)
        tilt, yaw = spec.tilt_noise_rad, spec.yaw_noise_rad
        self._sigmas = np.array(
            [
                *[spec.position_error_m] * 3, spec.velocity_along, spec.velocity_across,
                spec.velocity_z_m_s, tilt, tilt, yaw,
            ]
        )  # fmt: skip

    def take(self, count: int) -> F64:
        """Return the errors of the next samples, (count, WIDTH)."""
        rows = np.zeros((count, WIDTH))
        delay = self._base_s + self._fast_s * self._fast.take(count) + self._slow_s * self._slow.take(count)
        rows[:, DELAY] = np.clip(delay[:, 0], DELAY_MIN_S, DELAY_MAX_S)
        rows[:, VELOCITY_DELAY] = self._velocity_delay_s
        noise = self._state.take(count)
        rows[:, _NOISY] = self._sigmas * noise
        rows[:, AHEAD] += self._scale
        rows[:, STILL_AHEAD : STILL_ASIDE + 1] = self._spec.velocity_error_m_s * noise[:, 3:5]
        rows[:, TURN:] += self._turn
        return rows


def _within(draw: float) -> float:
    """Limit a standard normal number to two standard deviations, the range of recorded flights."""
    return max(-2.0, min(2.0, draw))

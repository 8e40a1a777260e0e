"""Errors of a measured state as recorded flights show them: late by a time that varies, and little else.

A row of numbers is drawn ahead for every sample; what the sample says follows from the true path up to now:
the position of a while ago plus a small error, a velocity with errors that grow with speed, and an attitude
that is turned. ``Rows`` come from a model (``ModelRows``) or from recorded flights (``TapeRows``).
"""

from __future__ import annotations

import math
from typing import Annotated, Protocol

import numpy as np

from sim.compiled.jit import jitted
from sim.compiled.records import F64, Cell, Record
from sim.plant.sensors import stream
from sim.scenarios.scenario import StateError

# columns of a row
DELAY = 0  # of the position, s; negative: ahead
VELOCITY_DELAY = 1  # s
POSITION = 2  # three: error of the position, ENU, m
AHEAD, ASIDE = 5, 6  # error of the velocity along and left of the horizontal velocity, as shares of the speed
VELOCITY = 7  # three: error of the velocity whatever the speed, ENU, m/s
TURN = 10  # three: turn of the measured attitude against the body, rotation vector, body FLU, rad
WIDTH = 13

PAST = 128  # states kept: 0.25 s at 500 Hz
DELAY_MAX_S = 0.2
DELAY_MIN_S = -0.1  # beyond that a state predicted at constant velocity is no recorded one's like
SETTLED = 12.0  # times the time constant that noise runs before it is used


class PastRecord(Record):
    """The true states of the last samples, and the measured one that follows from them."""

    states: Annotated[F64, 6 * PAST]  # position (m) and velocity (m/s), ENU; a ring
    count: int  # of states so far
    rate: float  # states per second
    late: Annotated[F64, 6]  # measured position and velocity


@jitted
def _recall(past: PastRecord, delay_s: float, first: int) -> None:
    """Write three numbers of the state of ``delay_s`` ago; velocity holds on, for what is yet to come."""
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
    """Take the true state of now (ENU) and write to ``late`` what a sample with these errors says."""
    at = 6 * (past.count % PAST)
    for i in range(3):
        past.states[at + i] = position[i]
        past.states[at + 3 + i] = velocity[i]
    past.count += 1
    late = past.late
    _recall(past, row[DELAY], 0)
    _recall(past, row[VELOCITY_DELAY], 3)
    lead_s = max(0.0, -row[DELAY])
    for i in range(3):
        late[i] += velocity[i] * lead_s + row[POSITION + i]
    vx, vy = late[3], late[4]
    late[3] += row[AHEAD] * vx - row[ASIDE] * vy + row[VELOCITY]
    late[4] += row[AHEAD] * vy + row[ASIDE] * vx + row[VELOCITY + 1]
    late[5] += row[VELOCITY + 2]


@jitted
def mismeasured(past: Cell[PastRecord], position: F64, velocity: F64, row: F64) -> None:
    """Do ``mismeasure``, called from Python."""
    mismeasure(past[0], position, velocity, row)


class Rows(Protocol):
    """Draws the errors of one flight."""

    def take(self, count: int) -> F64:
        """Errors of the next samples, (count, WIDTH)."""


class Noise:
    """Correlated normal noise of several values, each of variance one.

    First order (Ornstein-Uhlenbeck): its correlation falls as exp(-t / T). Second order (twice the same lag):
    as (1 + t / T) exp(-t / T), so that it is smooth from sample to sample.

    Args:
        rng: source of chance.
        width: number of values.
        time_s: T.
        step_s: between samples.
        smooth: second order.
    """

    def __init__(
        self, rng: np.random.Generator, width: int, time_s: float, step_s: float, *, smooth: bool = False
    ) -> None:
        keep = math.exp(-step_s / time_s)
        rest = 1.0 - keep * keep
        self._rng, self._width = rng, width
        if smooth:  # variance of the process with a double pole: (1 + keep^2) / (1 - keep^2)^3
            self._gain, self._lag = math.sqrt(rest**3 / (1.0 + keep * keep)), [1.0, -2.0 * keep, keep * keep]
        else:
            self._gain, self._lag = math.sqrt(rest), [1.0, -keep]
        self._state = np.zeros((len(self._lag) - 1, width))
        self.take(round(SETTLED * time_s / step_s) + 1)

    def take(self, count: int) -> F64:
        """Return the next samples, (count, width)."""
        from scipy.signal import lfilter  # half a second, and only flights with such errors need it

        white = self._gain * self._rng.standard_normal((count, self._width))
        out, self._state = lfilter([1.0], self._lag, white, axis=0, zi=self._state)
        noise: F64 = out
        return noise


class ModelRows:
    """Errors by the parameters of ``StateError``.

    Args:
        spec: parameters.
        seed: of the run.
        purpose: whose errors; other purposes have other chance, except for a shared delay.
        rate_hz: of the samples.
    """

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
        self._fast_s = spec.delay_fast_s * math.exp(spec.delay_varies * _within(fast))
        self._slow_s = spec.delay_slow_s * math.exp(spec.delay_varies * _within(slow))
        self._turn = np.array((spec.tilt_rad, spec.tilt_rad, spec.yaw_rad)) * rng.standard_normal(3)
        one, two, three = rng.spawn(3)  # so that rows do not depend on how many are taken at once
        self._fast = Noise(one, 1, spec.delay_fast_time_s, step_s, smooth=True)
        self._slow = Noise(two, 1, spec.delay_slow_time_s, step_s, smooth=True)
        self._state = Noise(three, WIDTH - POSITION, spec.error_time_s, step_s)
        tilt, yaw, still = spec.tilt_noise_rad, spec.yaw_noise_rad, spec.velocity_error_m_s
        along, across = spec.velocity_along, spec.velocity_across
        self._sigmas = np.array(
            [*[spec.position_error_m] * 3, along, across, still, still, still, tilt, tilt, yaw]
        )

    def take(self, count: int) -> F64:
        """Errors of the next samples, (count, WIDTH)."""
        rows = np.empty((count, WIDTH))
        delay = self._base_s + self._fast_s * self._fast.take(count) + self._slow_s * self._slow.take(count)
        rows[:, DELAY] = np.clip(delay[:, 0], DELAY_MIN_S, DELAY_MAX_S)
        rows[:, VELOCITY_DELAY] = self._velocity_delay_s
        rows[:, POSITION:] = self._sigmas * self._state.take(count)
        rows[:, TURN:] += self._turn
        return rows


def _within(draw: float) -> float:
    """Cut a standard normal draw of a flight to two standard deviations: no flight was beyond."""
    return max(-2.0, min(2.0, draw))


def state_errors(spec: StateError, seed: int, purpose: str, rate_hz: float) -> Rows:
    """Errors of a run, from the source that the scenario names.

    Args:
        spec: source and parameters.
        seed: of the run.
        purpose: whose errors.
        rate_hz: of the samples.
    """
    return ModelRows(spec, seed, purpose, rate_hz)

"""Identification from flights: the vehicle's velocity loop, and noise, rate and motion of measurements.

The model of one axis of the velocity loop has a gain, a second-order low-pass and a dead time:

    v(s) = gain exp(-theta s) w^2 / (s^2 + 2 zeta w s + w^2) u(s) + disturbance

(v: velocity, u: command, theta: dead time, w: natural frequency, zeta: damping). The same high-pass filter is
applied to command and velocity: the filter removes wind and weight and does not change the model. The initial
state of each segment is free. The fit minimises the squared difference between model and flight. The standard
errors are computed from blocks of one second, because gusts correlate neighbouring differences.

Noise is the residual of a parabola in a short window; the parabola follows any real motion. Correlated noise
(of an estimator, or a slow drift) has no residual, so the values are lower bounds.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy  # scipy loads its parts at their first use; this takes 0.3 to 0.5 s
from numpy.typing import NDArray

Floats = NDArray[np.float64]

HIGH_PASS_S = 2.0  # time constant of the high-pass, s; slower changes count as disturbance
BLOCK_S = 1.0  # duration for which differences count as correlated, s
SEGMENT_MIN_S = 1.5  # minimum length of a segment, s; shorter ones depend mostly on their initial state
TIME_MIN_S = 3.0  # minimum total length of all segments, s
EXCITATION_MIN_M_S = 0.04  # minimum standard deviation of the high-passed command, m/s
EXPLAINED_MIN = 0.6  # minimum fraction of the velocity's variance that the model must explain
ERROR_MAX = 0.2  # maximum accepted relative standard error of the lag
START = (1.0, 6.0, 0.7, 0.02)  # start values of the fit: gain, rate in 1/s, damping, dead time in s
LOW, HIGH = (0.2, 0.5, 0.1, 0.0), (2.0, 50.0, 2.0, 0.6)  # bounds of the fit, in the same order
# minimum modelled dead time, s; a shorter dead time is included in the lag of the second-order model
DEAD_TIME_MIN_S = 0.12


class Segment(NamedTuple):
    """Uninterrupted commands and velocities (n,) of one axis, m/s, one per tick."""

    command_m_s: Floats
    velocity_m_s: Floats


class Loop(NamedTuple):
    """Velocity loop of an axis; ``errors``: standard errors of the five fields above, in their order."""

    gain: float
    rate_1_s: float
    damping: float
    dead_time_s: float
    lag_s: float  # group delay at low frequency, s: 2 damping / rate + dead time
    errors: tuple[float, ...]
    explained: float  # fraction of the velocity's variance that the model explains
    time_s: float  # total length of the compared segments, s

    @property
    def model_dead_time_s(self) -> float:
        """Dead time of the stack's model, s; 0 if a second-order model with this lag is sufficient."""
        return self.dead_time_s if self.dead_time_s >= DEAD_TIME_MIN_S else 0.0

    @property
    def model_rate_1_s(self) -> float:
        """Natural frequency of the stack's model with this lag, 1/s."""
        return 2.0 * self.damping / (self.lag_s - self.model_dead_time_s)


def identify(segments: Sequence[Segment], period_s: float, axis: str) -> Loop:
    """Identify the velocity loop of an axis, or of several equal axes; ``axis``: name in error texts.

    Raises ValueError: the flight is too short, has too little excitation, or differs from the model; the text
    describes a flight that identifies the parameters.
    """
    kept = [s for s in segments if len(s.command_m_s) * period_s >= SEGMENT_MIN_S]
    passed = [Segment(*(_high_pass(column, period_s) for column in s)) for s in kept]
    time_s = sum(len(s.command_m_s) for s in passed) * period_s
    if time_s < TIME_MIN_S:
        raise ValueError(
            f"{axis}: found {time_s:.1f} s of uninterrupted set-points, at least {TIME_MIN_S:g} s are needed "
            f"in pieces of {SEGMENT_MIN_S:g} s: fly longer, or give several logs"
        )
    excitation = float(np.std(np.concatenate([s.command_m_s for s in passed])))
    if excitation < EXCITATION_MIN_M_S:
        raise ValueError(
            f"{axis}: the command varies by {excitation:.3f} m/s, {EXCITATION_MIN_M_S:g} are needed: "
            "fly behind a target that reverses or stops and goes, or land from farther away"
        )

    def difference(parameters: Floats) -> Floats:
        return np.concatenate([_difference(s, parameters, period_s) for s in passed])

    found = scipy.optimize.least_squares(
        difference, START, bounds=(LOW, HIGH), x_scale=(1.0, 5.0, 0.5, 0.05), diff_step=1e-4
    )
    gain, rate, damping, dead_time = (float(p) for p in found.x)
    covariance = _covariance(found.jac, found.fun, max(1, round(BLOCK_S / period_s)))
    slope = np.array([0.0, -2.0 * damping / rate**2, 2.0 / rate, 1.0])
    lag_s = 2.0 * damping / rate + dead_time
    errors = np.sqrt(np.append(np.diag(covariance), slope @ covariance @ slope))
    flown = np.concatenate([s.velocity_m_s for s in passed])
    explained = 1.0 - float(np.mean(found.fun**2) / np.mean(flown**2))
    if not explained >= EXPLAINED_MIN:
        raise ValueError(
            f"{axis}: the model explains {100.0 * explained:.0f} % of the velocity, at least "
            f"{100.0 * EXPLAINED_MIN:g} are needed: fly in less wind, with larger commands"
        )
    if not errors[4] <= ERROR_MAX * lag_s:
        raise ValueError(
            f"{axis}: lag {lag_s:.3f} s is known to {errors[4]:.3f} s only, {100.0 * ERROR_MAX:g} % are "
            "needed: fly longer, with larger changes of the command, or give several logs"
        )
    return Loop(gain, rate, damping, dead_time, lag_s, tuple(errors.tolist()), explained, time_s)


def _high_pass(column: Floats, period_s: float) -> Floats:
    a = HIGH_PASS_S / (HIGH_PASS_S + period_s)
    return np.asarray(scipy.signal.lfilter([a, -a], [1.0, -a], column - column[0]), dtype=np.float64)


def _difference(passed: Segment, parameters: Floats, period_s: float) -> Floats:
    """Return measured minus modelled velocity, without the response to the segment's initial state."""
    gain, rate, damping, dead_time = parameters
    plant = ([rate * rate], [1.0, 2.0 * damping * rate, rate * rate])
    numerator, denominator, _ = scipy.signal.cont2discrete(plant, period_s, method="zoh")
    count = len(passed.command_m_s)
    ticks = np.arange(count, dtype=np.float64)
    late = np.interp(ticks - dead_time / period_s, ticks, passed.command_m_s, left=0.0)
    left = passed.velocity_m_s - gain * scipy.signal.lfilter(numerator.ravel(), denominator, late)
    # responses to earlier commands, then to initial speed and acceleration
    responses = [scipy.signal.lfilter(numerator.ravel(), denominator, np.ones(count))]
    responses += [scipy.signal.lfilter([1.0], denominator, kick) for kick in np.eye(2, count)]
    past = np.apply_along_axis(_high_pass, 0, np.column_stack(responses), period_s)
    explained = past @ np.linalg.lstsq(past, left, rcond=None)[0]
    return np.asarray(left - explained, dtype=np.float64)


def _covariance(jacobian: Floats, difference: Floats, block: int) -> Floats:
    """Return the covariance of least-squares parameters if differences are correlated within blocks."""
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    scores = jacobian * difference[:, None]
    starts = np.arange(0, len(scores), block)
    sums = np.add.reduceat(scores, starts, axis=0)
    few = len(starts) / max(1, len(starts) - len(inverse))
    return np.asarray(few * inverse @ (sums.T @ sums) @ inverse, dtype=np.float64)


NOISE_SAMPLES = 9  # number of samples in a window for the noise
MOTION_S = 0.6  # length of a window for velocity and acceleration, s
SAMPLES_MIN = 100  # minimum number of samples for the noise
OFTEN = 99.0  # percentile that replaces the largest value, because single windows contain noise
MAD_TO_SIGMA = 1.4826  # ratio of standard deviation to median absolute value in a normal distribution


class Link(NamedTuple):
    """Statistics of the samples that arrived over a link."""

    rate_hz: float
    loss: float  # fraction of missing samples
    delay_spread_s: float  # 95th percentile of the delay minus the smallest delay, s
    delay_s: float | None  # minimum delay; None: it is not between 0 and 0.5 s, so the clocks differ
    position_noise_m: float  # standard deviation of the position noise on each axis, m
    velocity_noise_m_s: float


class Motion(NamedTuple):
    """Largest speeds and acceleration of a motion."""

    speed_m_s: float  # horizontal speed, m/s
    climb_m_s: float
    acceleration_m_s2: float  # horizontal acceleration, m/s^2


def noise(time_s: Floats, values: Floats) -> float:
    """Return a robust standard deviation of the values from parabolas fitted to ``NOISE_SAMPLES`` samples.

    ``time_s``: (n,) increasing; ``values``: (n,) or (n, axes); all axes are combined.
    Raises ValueError: there are too few samples.
    """
    if len(time_s) < SAMPLES_MIN:
        raise ValueError(f"found {len(time_s)} samples, at least {SAMPLES_MIN} are needed")
    columns = values.reshape(len(values), -1)
    half, left = NOISE_SAMPLES // 2, []
    for middle in range(half, len(time_s) - half, half):
        window = slice(middle - half, middle + half + 1)
        basis = np.vander(time_s[window] - time_s[middle], 3)
        hat = basis @ np.linalg.pinv(basis)
        free = 1.0 - hat[half, half]
        left.append((columns[middle] - hat[half] @ columns[window]) / np.sqrt(free))
    return float(MAD_TO_SIGMA * np.median(np.abs(np.array(left))))


def motion(time_s: Floats, position_m: Floats) -> Motion:
    """Return the largest speeds and acceleration from parabolas in windows of ``MOTION_S``.

    ``time_s``: (n,) increasing; ``position_m``: (n, 3).
    Raises ValueError: the rate of the samples is too low.
    """
    rows: list[tuple[float, float, float]] = []
    for centre in np.arange(time_s[0] + MOTION_S / 2, time_s[-1] - MOTION_S / 2, MOTION_S / 6):
        window = np.abs(time_s - centre) <= MOTION_S / 2
        if np.count_nonzero(window) < 6:
            continue
        fit = np.linalg.lstsq(np.vander(time_s[window] - centre, 3), position_m[window], rcond=None)[0]
        rows.append((np.hypot(*fit[1][:2]), abs(fit[1][2]), 2.0 * np.hypot(*fit[0][:2])))
    if not rows:
        raise ValueError("the rate of the samples is too low to show motion")
    speed, climb, acceleration = np.percentile(np.array(rows), OFTEN, axis=0)
    return Motion(float(speed), float(climb), float(acceleration))


def link(stamp_s: Floats, arrival_s: Floats, position_m: Floats, velocity_m_s: Floats) -> Link:
    """Return the statistics of the samples of a link.

    ``stamp_s``: (n,) times of measurement, increasing; ``arrival_s``: (n,) arrival times, local clock;
    ``position_m``: (n, 3); ``velocity_m_s``: (n, 3), in any frame that turns slowly.
    Raises ValueError: there are too few samples.
    """
    position_noise, velocity_noise = noise(stamp_s, position_m), noise(stamp_s, velocity_m_s)
    steps = np.diff(stamp_s)
    period_s = float(np.median(steps))
    due = round((stamp_s[-1] - stamp_s[0]) / period_s) + 1
    late = arrival_s - stamp_s
    smallest = float(late.min())
    loss, spread_s = max(0.0, 1.0 - len(stamp_s) / due), float(np.percentile(late, 95.0) - smallest)
    delay_s = smallest if 0.0 <= smallest < 0.5 else None
    return Link(1.0 / period_s, loss, spread_s, delay_s, position_noise, velocity_noise)

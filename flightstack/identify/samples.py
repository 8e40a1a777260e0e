"""Noise, rate and motion of measurements from the measurements alone. Pure.

A parabola through a short window follows any real motion; the residual is noise. Correlated noise (of an
estimator, or a slow drift) is not visible: the values are lower bounds.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

NOISE_SAMPLES = 9  # samples of a window for noise
MOTION_S = 0.6  # window for velocity and acceleration
SAMPLES_MIN = 100
OFTEN = 99.0  # percentile used as the largest value: single windows are noise
MAD_TO_SIGMA = 1.4826  # median of absolute values to standard deviation, of a normal distribution


class Link(NamedTuple):
    """Statistics of a link."""

    rate_hz: float
    loss: float  # share of missing samples
    delay_spread_s: float  # 95 % of the delay above its smallest
    delay_s: float | None  # smallest delay, if the clocks agree
    position_noise_m: float  # standard deviation on an axis
    velocity_noise_m_s: float


class Motion(NamedTuple):
    """Largest speeds and acceleration."""

    speed_m_s: float  # horizontal
    climb_m_s: float
    acceleration_m_s2: float  # horizontal


def noise(time_s: Floats, values: Floats) -> float:
    """Standard deviation of a column around parabolas of ``NOISE_SAMPLES`` samples; robust to outliers.

    ``time_s``: (n,) increasing; ``values``: (n,) or (n, axes); axes are pooled.
    Raises ValueError: too few samples.
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
    """Largest speeds and acceleration, by parabolas of ``MOTION_S``.

    ``time_s``: (n,) increasing; ``position_m``: (n, 3).
    Raises ValueError: too few samples.
    """
    if len(time_s) < SAMPLES_MIN:
        raise ValueError(f"found {len(time_s)} samples, at least {SAMPLES_MIN} are needed")
    rows = []
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
    """Statistics of the samples of a link.

    ``stamp_s``: (n,) of the measurement, increasing; ``arrival_s``: (n,) on our clock; ``position_m``: (n,
    3); ``velocity_m_s``: (n, 3), in any frame that turns slowly.
    Raises ValueError: too few samples.
    """
    position_noise, velocity_noise = noise(stamp_s, position_m), noise(stamp_s, velocity_m_s)
    steps = np.diff(stamp_s)
    period_s = float(np.median(steps))
    due = round((stamp_s[-1] - stamp_s[0]) / period_s) + 1
    late = arrival_s - stamp_s
    smallest = float(late.min())
    return Link(
        1.0 / period_s,
        max(0.0, 1.0 - len(stamp_s) / due),
        float(np.percentile(late, 95.0) - smallest),
        smallest if 0.0 <= smallest < 0.5 else None,
        position_noise,
        velocity_noise,
    )

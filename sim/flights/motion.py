"""Angular rates by motion capture, and the difference of its clock to that of the log.

The gyro is logged on board, the attitude by motion capture. Both show the same rotation, so their lag is the
difference of the clocks. Over radio it may wander by a tenth of a second within a flight.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt
from scipy.spatial.transform import Rotation

from sim.flights.recording import Floats, Recording

BAND_HZ = (0.5, 6.0)  # band of a Crazyflie's attitude; above it the derivative of the attitude is noise
WINDOW_S = 4.0  # time window of one estimate of the lag
LAG_MAX_S = 0.25  # greatest lag that is searched
CORRELATION_MIN = 0.7  # below it the lag is unknown


def rates_rad_s(recording: Recording) -> Floats:
    """Return (n, 3) body rates from the attitude, rad/s; 0 beside values that are missing."""
    r = recording
    good: NDArray[np.bool_] = np.all(np.isfinite(r.attitude), axis=1)
    turned = Rotation.from_quat(np.where(good[:, None], r.attitude, (1.0, 0.0, 0.0, 0.0)), scalar_first=True)
    rates = np.zeros((len(r.time_s), 3))
    rates[1:] = (turned[:-1].inv() * turned[1:]).as_rotvec() / np.diff(r.time_s)[:, None]
    rates[1:][~(good[:-1] & good[1:])] = 0.0
    return rates


def band(rates: Floats, step_s: float) -> Floats:
    """Return (n, 3) rates in ``BAND_HZ``, without delay; missing values count as 0."""
    high_hz = min(BAND_HZ[1], 0.4 / step_s)
    sections = butter(2, (BAND_HZ[0], high_hz), "bandpass", fs=1.0 / step_s, output="sos")
    filtered: Floats = sosfiltfilt(sections, np.nan_to_num(rates, posinf=0.0, neginf=0.0), axis=0)
    return filtered


def clock_lag_s(recording: Recording) -> Floats:
    """Return (n,) delay of the log behind motion capture around each sample, s; NaN where unknown."""
    r = recording
    true, gyro = (band(rates, r.step_s)[:, :2] for rates in (rates_rad_s(r), r.rates_rad_s))
    longest = round(LAG_MAX_S / r.step_s)
    lags = np.arange(-longest, longest + 1)
    kernel = np.ones(min(round(WINDOW_S / r.step_s), len(true)))

    def around(values: Floats) -> Floats:
        summed: Floats = np.convolve(values, kernel, mode="same")
        return summed

    power = around((true**2).sum(axis=1)) * around((gyro**2).sum(axis=1))
    shared = np.stack([around((true * np.roll(gyro, -lag, axis=0)).sum(axis=1)) for lag in lags])
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = shared / np.sqrt(power)
    known = correlation.max(axis=0) >= CORRELATION_MIN  # False where NaN
    return np.where(known, lags[np.argmax(shared, axis=0)] * r.step_s, np.nan)

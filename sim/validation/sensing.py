"""How far a vehicle's own estimate is from the truth: delay, error by axis and speed, correlation, spectrum.

The error has three parts. A constant offset and a constant delay are found first, together, by least squares.
What is left grows with speed: the delay varies, and markers and body axes are not quite aligned.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from sim.flights.recording import Floats

DELAY_S = (-0.1, 0.2)  # searched for the delay; clocks of radio and motion capture may differ by tens of ms
SPEED_EDGES_M_S = (0.0, 0.35, 0.65, 0.85, 1.5)  # bands around 0.2, 0.5, 0.75 and 1 m/s
CORRELATION_S = 1.0  # longest lag of the correlation
CORRELATED = 1.0 / np.e  # the correlation time is the first lag where the correlation falls below this
BANDS_HZ = ((0.0, 0.5), (0.5, 2.0), (2.0, 8.0), (8.0, 50.0))  # of the spectrum


@dataclass(frozen=True, slots=True)
class Trace:
    """A piece of estimate and truth at the same instants, n samples ``step_s`` apart.

    It lasts longer than ``DELAY_S`` spans.

    Attributes:
        step_s: between two samples.
        truth: (n, 3) position in m or velocity in m/s.
        estimate: (n, 3) the same of the estimator.
        speed_m_s: (n,) true horizontal speed.
    """

    step_s: float
    truth: Floats
    estimate: Floats
    speed_m_s: Floats


@dataclass(frozen=True, slots=True)
class Error:
    """What is wrong with an estimate; m for positions, m/s for velocities.

    Attributes:
        delay_s: of the estimate behind the truth, that fits best.
        offset: (3,) mean error.
        rms: (3,) error on each axis without delay and offset.
        along: rms of the error along the horizontal velocity.
        across: rms of the horizontal error across it.
        median, p95: of the norm of the error as it stands, delay and offset included.
        by_speed: rms of the horizontal error, without delay and offset, in each band of
            ``SPEED_EDGES_M_S``; NaN where nobody flew.
        correlation_s: time after which the horizontal error is forgotten.
        spectrum: share of the horizontal error's power in each band of ``BANDS_HZ``.
    """

    delay_s: float
    offset: tuple[float, float, float]
    rms: tuple[float, float, float]
    along: float
    across: float
    median: float
    p95: float
    by_speed: tuple[float, ...]
    correlation_s: float
    spectrum: tuple[float, ...]


def analyse(traces: list[Trace]) -> Error:
    """Find the error of an estimate in pieces of one flight.

    Raises:
        ValueError: no trace.
    """
    if not traces:
        raise ValueError("found no pieces of flight, one at least is needed")
    found = minimize_scalar(
        lambda delay_s: float(np.sum(_centred(_residuals(traces, delay_s)) ** 2)),
        bounds=DELAY_S,
        method="bounded",
        options={"xatol": 1e-4},
    )
    delay_s = float(found.x)
    parts = _residuals(traces, delay_s)
    offset = np.concatenate(parts).mean(axis=0)
    parts = [part - offset for part in parts]
    left = np.concatenate(parts)
    raw = np.linalg.norm(np.concatenate([t.estimate - t.truth for t in traces]), axis=1)
    speed = np.concatenate([t.speed_m_s[_inner(t.step_s)] for t in traces])
    horizontal = np.sum(left[:, :2] ** 2, axis=1)
    along, across = _along(traces, left)
    bands = np.digitize(speed, SPEED_EDGES_M_S) - 1
    by_speed = tuple(
        float(np.sqrt(horizontal[bands == band].mean())) if np.any(bands == band) else float("nan")
        for band in range(len(SPEED_EDGES_M_S) - 1)
    )
    return Error(
        delay_s,
        _three(offset),
        _three(np.sqrt((left**2).mean(axis=0))),
        along,
        across,
        float(np.median(raw)),
        float(np.percentile(raw, 95.0)),
        by_speed,
        _correlation_s(parts, traces[0].step_s),
        _spectrum(parts, traces[0].step_s),
    )


def _three(values: Floats) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return (x, y, z)


def _residuals(traces: list[Trace], delay_s: float) -> list[Floats]:
    """Estimate minus the truth of ``delay_s`` before, for the inner part of each piece."""
    return [
        (trace.estimate - _delayed(trace.truth, delay_s / trace.step_s))[_inner(trace.step_s)]
        for trace in traces
    ]


def _inner(step_s: float) -> slice:
    """Cut off both ends, where the truth of another time lies outside the piece."""
    return slice(math.ceil(DELAY_S[1] / step_s), math.floor(DELAY_S[0] / step_s))


def _delayed(values: Floats, samples: float) -> Floats:
    at = np.arange(len(values)) - samples
    return np.stack([np.interp(at, np.arange(len(values)), column) for column in values.T], axis=1)


def _centred(parts: list[Floats]) -> Floats:
    left: Floats = np.concatenate(parts)
    left -= left.mean(axis=0)
    return left


def _along(traces: list[Trace], left: Floats) -> tuple[float, float]:
    """Return rms along and across the horizontal direction of motion, where there is one."""
    moves = np.concatenate([np.gradient(t.truth[:, :2], axis=0)[_inner(t.step_s)] for t in traces])
    length = np.linalg.norm(moves, axis=1)
    ahead = moves / np.maximum(length, 1e-12)[:, None]
    moving = np.concatenate([t.speed_m_s[_inner(t.step_s)] for t in traces]) > SPEED_EDGES_M_S[1]
    if not moving.any():
        moving = np.ones(len(left), dtype=bool)
    along = left[:, 0] * ahead[:, 0] + left[:, 1] * ahead[:, 1]
    across = left[:, 1] * ahead[:, 0] - left[:, 0] * ahead[:, 1]
    return float(np.sqrt((along[moving] ** 2).mean())), float(np.sqrt((across[moving] ** 2).mean()))


def _correlation_s(parts: list[Floats], step_s: float) -> float:
    longest = round(CORRELATION_S / step_s)
    products, counts = np.zeros(longest + 1), np.zeros(longest + 1)
    for part in parts:
        for lag in range(min(longest, len(part) - 1) + 1):
            products[lag] += float(np.sum(part[lag:, :2] * part[: len(part) - lag, :2]))
            counts[lag] += len(part) - lag
    correlation = products / np.maximum(counts, 1.0)
    if correlation[0] <= 0.0:
        return 0.0
    below = np.flatnonzero(correlation / correlation[0] < CORRELATED)
    return float(below[0] * step_s) if len(below) else CORRELATION_S


def _spectrum(parts: list[Floats], step_s: float) -> tuple[float, ...]:
    longest = max(parts, key=len)[:, :2]
    window = np.hanning(len(longest))[:, None]
    power = np.sum(np.abs(np.fft.rfft(window * longest, axis=0)) ** 2, axis=1)
    frequency_hz = np.fft.rfftfreq(len(longest), step_s)
    total = float(power.sum())
    if total <= 0.0:
        return tuple(0.0 for _ in BANDS_HZ)
    return tuple(
        float(power[(frequency_hz >= low) & (frequency_hz < high)].sum()) / total for low, high in BANDS_HZ
    )

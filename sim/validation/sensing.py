"""How far a vehicle's own estimate is from the truth: delay, error by axis and speed, correlation, spectrum.

The error has three parts. A constant delay is found first, by least squares, then a constant offset. What is
left grows with speed: the delay varies. ``compare`` does that with the recorded estimate of a flight and with
simulated ones along the same true path.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import correlate

from flightstack.compiled.records import cell, new
from sim.flights.recording import Floats
from sim.flights.screening import Screened
from sim.plant.state_error import PastRecord, mismeasured_path, state_errors
from sim.scenarios.scenario import StateError

DELAY_S = (-0.1, 0.2)  # searched for the delay; clocks of radio and motion capture may differ by tens of ms
SPEED_EDGES_M_S = (0.0, 0.35, 0.65, 0.85, 1.5)  # bands around 0.2, 0.5, 0.75 and 1 m/s
DRAWS = 6  # simulated estimates of a flight: the errors of the model's flights differ as the recorded ones do
SLOWEST = 10.0  # percent of the time that show a constant offset
CORRELATION_S = 1.0  # longest lag of the correlation
CORRELATED = 1.0 / np.e  # the correlation time is the first lag where the correlation falls below this
BANDS_HZ = ((0.0, 0.5), (0.5, 2.0), (2.0, 8.0), (8.0, 50.0))  # of the spectrum


@dataclass(frozen=True, slots=True)
class Trace:
    """A piece of estimate and truth at the same instants, n samples ``step_s`` apart.

    It lasts longer than ``DELAY_S`` spans.
    """

    step_s: float  # between two samples
    truth: Floats  # (n, 3) position in m or velocity in m/s
    estimate: Floats  # (n, 3) the same of the estimator
    speed_m_s: Floats  # (n,) true horizontal speed


@dataclass(frozen=True, slots=True)
class Error:
    """What is wrong with an estimate; m for positions, m/s for velocities."""

    delay_s: float  # of the estimate behind the truth, that fits best
    offset: tuple[float, float, float]  # (3,) error at low speed
    rms: tuple[float, float, float]  # (3,) error on each axis without delay and offset
    along: float  # rms of the error along the horizontal velocity
    across: float  # rms of the horizontal error across it
    median: float  # median, p95: of the norm of the error as it stands, delay and offset included
    p95: float
    # rms of the horizontal error, without delay and offset, in each band of ``SPEED_EDGES_M_S``; NaN where
    # nobody flew
    by_speed: tuple[float, ...]
    correlation_s: float  # time after which the horizontal error is forgotten
    spectrum: tuple[float, ...]  # share of the horizontal error's power in each band of ``BANDS_HZ``


def analyse(traces: list[Trace]) -> Error:
    """Find the error of an estimate in pieces of one flight. Raises ValueError: no trace."""
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
    offset = _offset(traces, parts)
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


def _offset(traces: list[Trace], parts: list[Floats]) -> Floats:
    """Median error of the slowest tenth of the time, in which no delay passes for an offset."""
    speed = np.concatenate([trace.speed_m_s[_inner(trace.step_s)] for trace in traces])
    slow = speed <= np.percentile(speed, SLOWEST)
    offset: Floats = np.median(np.concatenate(parts)[slow], axis=0)
    return offset


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
        last = min(longest, len(part) - 1)
        for column in part[:, :2].T:
            products[: last + 1] += correlate(column, column, method="fft")[len(part) - 1 :][: last + 1]
        counts[: last + 1] += len(part) - np.arange(last + 1)
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


@dataclass(frozen=True, slots=True)
class Errors:
    """Errors of one estimator."""

    position: Error
    velocity: Error


@dataclass(frozen=True, slots=True)
class Sensing:
    """What is wrong with the recorded estimate of a flight, and with simulated ones on its path."""

    recorded: Errors
    simulated: Errors


def compare(flight: Screened, seed: int, error: StateError | None = None) -> Sensing | None:
    """Hold simulated estimates against the recorded one; None where there is none to compare with.

    The model knows nothing of the flight but its true path: delay and size of the errors are drawn anew for
    each of ``DRAWS`` estimates. So single flights differ from it; over many the two agree if the model does.

    ``flight``: screened; ``seed``: of the draws; ``error``: parameters, or a tape; None: the defaults.
    """
    r = flight.recording
    estimates = (r.estimate_position_m, r.estimate_velocity_m_s)
    pieces = [p for p in flight.pieces if (p.stop - p.start) * r.step_s > 2.0 * (DELAY_S[1] - DELAY_S[0])]
    if estimates[0] is None or estimates[1] is None or not pieces:
        return None
    recorded = _errors(flight, pieces, [np.column_stack((estimates[0][p], estimates[1][p])) for p in pieces])
    simulated = []
    for draw in range(DRAWS):
        rows = state_errors(error or StateError(), DRAWS * seed + draw, "own", 1.0 / r.step_s)
        measured = []
        for piece in pieces:
            past = new(PastRecord)
            past.rate = 1.0 / r.step_s
            states = np.empty((piece.stop - piece.start, 6))
            path = r.position_m[piece], r.velocity_m_s[piece]
            mismeasured_path(cell(past), *path, rows.take(len(states)), states)
            measured.append(states)
        simulated.append(_errors(flight, pieces, measured))
    return Sensing(
        recorded,
        Errors(_mean([each.position for each in simulated]), _mean([each.velocity for each in simulated])),
    )


def _errors(flight: Screened, pieces: list[slice], estimates: list[Floats]) -> Errors:
    """Analyse estimates of position and velocity, (n, 6) for each piece."""
    r = flight.recording

    def error(truth: Floats, columns: slice) -> Error:
        return analyse(
            [
                Trace(r.step_s, truth[p], each[:, columns], np.linalg.norm(r.velocity_m_s[p, :2], axis=1))
                for p, each in zip(pieces, estimates, strict=True)
            ]
        )

    return Errors(error(r.position_m, slice(0, 3)), error(r.velocity_m_s, slice(3, 6)))


def _mean(errors: list[Error]) -> Error:
    """Mean of several, root mean square of what is a size."""

    def mean(name: str) -> Floats:
        return np.asarray(np.mean([getattr(error, name) for error in errors], axis=0))

    def rms(name: str) -> Floats:
        return np.asarray(np.sqrt(np.mean(np.square([getattr(error, name) for error in errors]), axis=0)))

    return Error(
        float(mean("delay_s")), _three(mean("offset")), _three(rms("rms")), float(rms("along")),
        float(rms("across")), float(mean("median")), float(mean("p95")), tuple(rms("by_speed").tolist()),
        float(mean("correlation_s")), tuple(mean("spectrum").tolist()),
    )  # fmt: skip

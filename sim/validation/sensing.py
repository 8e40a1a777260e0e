"""Error of the estimated vehicle state: its delay, and its size in bands of speed.

The error has three parts. Least squares give a constant delay, then a constant offset. The remainder grows
with speed, because the delay varies. ``compare`` analyses the recorded estimate of a flight and simulated
estimates along the same true path.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # loads each part at the first use of the part, in 0.3 to 0.5 s

from flightstack.compiled.records import cell, new
from sim.flights.recording import Floats
from sim.flights.screening import Screened
from sim.plant.state_error import ErrorRows, PastRecord, mismeasured_path
from sim.scenarios.tables import StateError

SPEED_EDGES_M_S = (0.0, 0.35, 0.65, 0.85, 1.5)  # edges of the speed bands around 0.2, 0.5, 0.75 and 1 m/s
DELAY_S = (-0.1, 0.2)  # range of an estimate's delay; a delay outside this range means different clocks
DRAWS = 6  # number of simulated estimates per flight; the model's errors differ between flights
SLOWEST = 10.0  # percentage of samples from which the offset is computed: those with the lowest speeds


@dataclass(frozen=True, slots=True)
class Error:
    """Error of an estimate in a flight."""

    delay_s: float  # delay of the estimate behind the true state, from the best fit
    # rms horizontal error without delay and offset in each band of speed, m or m/s; NaN: speed not flown
    by_speed: tuple[float, ...]


def analyse(step_s: float, traces: Sequence[tuple[Floats, Floats, Floats]]) -> Error:
    """Return the error of an estimate of position (m) or velocity (m/s) in segments of one flight.

    ``traces``: for each segment, true and estimated values (n, 3) at the same times, ``step_s`` apart and
    without gaps, and the true horizontal speed (n,), m/s. A segment must be longer than ``DELAY_S`` is wide.
    """
    # Both ends are cut off, because the delayed truth lies outside the segment at its ends.
    inner = slice(math.ceil(DELAY_S[1] / step_s), math.floor(DELAY_S[0] / step_s))

    def errors(delay_s: float) -> list[Floats]:
        return [(estimate - _delayed(truth, delay_s / step_s))[inner] for truth, estimate, _ in traces]

    def misfit(delay_s: float) -> float:
        left = np.concatenate(errors(delay_s))
        return float(np.sum((left - left.mean(axis=0)) ** 2))

    delay_s = float(
        scipy.optimize.minimize_scalar(misfit, bounds=DELAY_S, method="bounded", options={"xatol": 1e-4}).x
    )
    parts = errors(delay_s)
    speed = np.concatenate([speed_m_s[inner] for _, _, speed_m_s in traces])
    slow = speed <= np.percentile(speed, SLOWEST)  # samples at which a delay has little effect
    offset = np.median(np.concatenate(parts)[slow], axis=0)
    horizontal = np.sum((np.concatenate(parts) - offset)[:, :2] ** 2, axis=1)
    bands = np.digitize(speed, SPEED_EDGES_M_S) - 1
    return Error(
        delay_s,
        tuple(
            float(np.sqrt(horizontal[bands == band].mean())) if np.any(bands == band) else float("nan")
            for band in range(len(SPEED_EDGES_M_S) - 1)
        ),
    )


def _delayed(values: Floats, samples: float) -> Floats:
    at = np.arange(len(values)) - samples
    return np.stack([np.interp(at, np.arange(len(values)), column) for column in values.T], axis=1)


@dataclass(frozen=True, slots=True)
class Errors:
    """Position and velocity errors of one estimator."""

    position: Error
    velocity: Error


@dataclass(frozen=True, slots=True)
class Sensing:
    """Errors of the recorded estimate of a flight, and of simulated estimates on its path."""

    recorded: Errors
    simulated: Errors


def compare(flight: Screened, seed: int, error: StateError | None = None) -> Sensing | None:
    """Compare simulated estimates with the recorded estimate; return None without a usable estimate.

    The model's only input is the true path of the flight: delay and size of the errors are drawn for each of
    ``DRAWS`` estimates. Single flights therefore differ; over many flights both agree if the model is right.
    """
    r = flight.recording
    estimates = (r.estimate_position_m, r.estimate_velocity_m_s)
    pieces = [p for p in flight.pieces if (p.stop - p.start) * r.step_s > 2.0 * (DELAY_S[1] - DELAY_S[0])]
    if estimates[0] is None or estimates[1] is None or not pieces:
        return None
    recorded = _errors(flight, pieces, [np.column_stack((estimates[0][p], estimates[1][p])) for p in pieces])
    simulated = []
    for draw in range(DRAWS):
        rows = ErrorRows(error or StateError(), DRAWS * seed + draw, "own", 1.0 / r.step_s)
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
    """Analyse estimates of position and velocity, (n, 6) for each segment."""
    r = flight.recording
    speeds = [np.linalg.norm(r.velocity_m_s[p, :2], axis=1) for p in pieces]

    def error(truth: Floats, columns: slice) -> Error:
        parts = zip(pieces, estimates, speeds, strict=True)
        return analyse(r.step_s, [(truth[p], each[:, columns], speed) for p, each, speed in parts])

    return Errors(error(r.position_m, slice(0, 3)), error(r.velocity_m_s, slice(3, 6)))


def _mean(errors: list[Error]) -> Error:
    """Return the mean delay, and the root mean square of the errors in each band of speed."""
    sizes = np.sqrt(np.mean(np.square([error.by_speed for error in errors]), axis=0))
    return Error(float(np.mean([error.delay_s for error in errors])), tuple(sizes.tolist()))

"""Fits the parameters of state-estimate errors (``StateError``) to recorded flights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import curve_fit, nnls

from sim.flights.recording import Floats
from sim.flights.screening import Screened
from sim.flights.tape import STILL_M_S, Piece, Tape, tape_of
from sim.scenarios.scenario import StateError

FLIGHTS_MIN = 3  # minimum number of flights from which a spread between flights is computed
LAG_MAX_S = 3.0  # largest lag of the fitted correlations, s
LAGS = 40
SPEEDS = 12  # number of speed bands with equal sample counts for the velocity error
DIGITS = 2  # significant digits of the result


def fit(flights: Sequence[Screened]) -> StateError:
    """Return the parameters of the model, fitted to flights; parameters without a fit keep their default.

    The mean autocovariance splits the variation of the delay into a fast and a slow part. With these two
    time constants, the sizes of the parts are fitted to each flight. The result is the median size, with the
    log-normal spread that gives the mean square of all flights. The variation of the attitude is not fitted,
    because most of the recorded variation comes from the log and from motion capture.

    Raises ValueError: fewer than ``FLIGHTS_MIN`` flights with a usable estimate.
    """
    tapes = [tape for flight in flights if (tape := tape_of(flight)) is not None]
    if len(tapes) < FLIGHTS_MIN:
        raise ValueError(f"found {len(tapes)} flights with an estimate, at least {FLIGHTS_MIN} are needed")
    base = np.array([_all(tape, "delay_s").mean() for tape in tapes])
    lead = base - np.array([_all(tape, "velocity_delay_s").mean() for tape in tapes])
    turns = np.array([_all(tape, "turn_rad").mean(axis=0) for tape in tapes])
    lags = np.unique(np.geomspace(1.0, LAG_MAX_S / tapes[0].step_s, LAGS).astype(int))
    lags_s = lags * tapes[0].step_s
    delays = np.array(
        [
            _autocovariance([p.delay_s - mean for p in t.pieces], lags)
            for t, mean in zip(tapes, base, strict=True)
        ]
    )
    (fast, fast_s, slow, slow_s), _ = curve_fit(
        _two_parts, lags_s, delays.mean(axis=0), (0.02, 0.06, 0.02, 1.0),
        bounds=((0.0, 0.01, 0.0, 0.3), (0.1, 0.3, 0.1, 10.0)),
    )  # fmt: skip
    sizes = np.sqrt([_sizes(row, lags_s, fast_s, slow_s) for row in delays])
    (fast, fast_varies), (slow, slow_varies) = (_spread(column) for column in sizes.T)
    others = np.mean(
        [_autocovariance([_centred(_velocity_error(p)) for p in t.pieces], lags) for t in tapes], axis=0
    )
    other_s = float(np.interp(-np.exp(-1.0), -others / others[0], lags_s))
    scales = np.array([_scale(tape) for tape in tapes])
    along, across, still, vertical = _velocity(tapes, scales)
    found = {
        "delay_s": base.mean(), "delay_spread_s": base.std(ddof=1),
        "delay_fast_s": fast, "delay_fast_time_s": fast_s, "delay_fast_varies": fast_varies,
        "delay_slow_s": slow, "delay_slow_time_s": slow_s, "delay_slow_varies": slow_varies,
        "velocity_lead_s": lead.mean(), "velocity_lead_spread_s": lead.std(ddof=1),
        "position_error_m": _rms(np.concatenate([_all(t, "position_m") for t in tapes])),
        "velocity_error_m_s": still, "velocity_z_m_s": vertical,
        "velocity_scale": _rms(scales), "velocity_along": along, "velocity_across": across,
        "tilt_rad": _rms(turns[:, :2]), "yaw_rad": _rms(turns[:, 2]),
        "error_time_s": other_s,
    }  # fmt: skip
    rounded: dict[str, Any] = {name: _rounded(value) for name, value in found.items()}
    return replace(StateError(), **rounded)


def _all(tape: Tape, name: str) -> Floats:
    return np.concatenate([getattr(piece, name) for piece in tape.pieces])


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def _centred(values: Floats) -> Floats:
    return np.asarray(values - values.mean(axis=0))


def _velocity_error(piece: Piece) -> Floats:
    """Return the velocity errors (n, 3) along the motion, across it and vertical, m/s."""
    along, across = piece.along, piece.across
    speed, (still_1, still_2) = piece.speed_m_s, STILL_M_S
    return np.column_stack((along * (speed + still_1), across * (speed + still_2), piece.velocity_m_s[:, 2]))


def _autocovariance(parts: list[Floats], lags: np.ndarray) -> Floats:
    """Return the autocovariance at each lag: mean product over all parts that are long enough."""
    found = np.zeros(len(lags))
    for at, lag in enumerate(lags.tolist()):
        long = [part for part in parts if len(part) > lag]
        total = sum(float(np.sum(part[lag:] * part[: len(part) - lag])) for part in long)
        found[at] = total / max(1, sum(part[lag:].size for part in long))
    return found


def _smooth(lag_s: Floats, time_s: float) -> Floats:
    """Return the autocorrelation of second-order noise with this time constant."""
    ratio = lag_s / time_s
    return np.asarray((1.0 + ratio) * np.exp(-ratio))


def _two_parts(lag_s: Floats, fast: float, fast_s: float, slow: float, slow_s: float) -> Floats:
    both: Floats = fast**2 * _smooth(lag_s, fast_s) + slow**2 * _smooth(lag_s, slow_s)
    return both


def _sizes(covariance: Floats, lags_s: Floats, fast_s: float, slow_s: float) -> Floats:
    """Return the variances of the fast and the slow part of the delay in one flight."""
    variances: Floats = nnls(np.column_stack((_smooth(lags_s, fast_s), _smooth(lags_s, slow_s))), covariance)[
        0
    ]
    return variances


def _spread(sizes: Floats) -> tuple[float, float]:
    """Return the median of log-normal sizes, and the logarithmic spread that gives their mean square."""
    median = float(np.median(sizes))
    return median, math.sqrt(max(0.0, math.log(max(_rms(sizes), 1e-12) / max(median, 1e-12))))


def _scale(tape: Tape) -> float:
    """Return the mean scale error of the estimated velocity in a flight, as a fraction of the speed."""
    speed = _all(tape, "speed_m_s")
    along = np.concatenate([_velocity_error(piece)[:, 0] for piece in tape.pieces])
    return float(np.dot(along, speed) / np.dot(speed, speed))


def _velocity(tapes: Sequence[Tape], scales: Floats) -> tuple[float, float, float, float]:
    """Return the velocity errors: along and across divided by the speed, then at rest and vertical, m/s."""
    speed = np.concatenate([_all(tape, "speed_m_s") for tape in tapes])
    error = np.concatenate([_velocity_error(piece) for tape in tapes for piece in tape.pieces])
    error[:, 0] -= speed * np.repeat(scales, [len(_all(tape, "speed_m_s")) for tape in tapes])
    bands = [band for band in np.array_split(np.argsort(speed), SPEEDS) if len(band)]
    speeds = np.array([speed[band].mean() for band in bands])
    sizes = np.array([[_rms(error[band, axis]) for axis in (0, 1)] for band in bands])
    none = np.zeros(len(bands))
    terms = np.block([[speeds[:, None], none[:, None]], [none[:, None], speeds[:, None]]])
    terms = np.column_stack((terms, np.ones(2 * len(bands))))
    along, across, still = nnls(terms, sizes.T.ravel())[0].tolist()
    return along, across, still, _rms(error[:, 2])

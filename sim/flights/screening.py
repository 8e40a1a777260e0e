"""Selects the usable parts of a recorded flight, and states why other parts are left out.

Each check marks samples. A marked sample also excludes ``MARGIN_S`` on both sides, because loggers
interpolate over damaged values. A piece must last at least ``PIECE_MIN_S`` in the air. A flight with more
damage than ``DAMAGED_MAX`` is excluded, because its estimator or link failed before a limit was exceeded.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim.flights.plausible import check, clock_lag_s
from sim.flights.recording import Group, Recording, read_recording

Mask = NDArray[np.bool_]

GAP_FACTOR = 5.0  # sample distance that counts as a gap, in periods
SPEED_MAX_M_S = 6.0  # largest speed between two motion-capture samples; no Crazyflie in a room is faster
FROZEN_S = 0.05  # duration after which a repeated pose counts as frozen: motion capture lost the body
ESTIMATE_OFF_M = 0.3  # distance from motion capture above which an estimate has diverged; good flights: 0.2 m
CLOCKS_OFF_S = 0.05  # allowed clock offset, s; at 1 m/s it causes 5 cm, as much as the compared errors
CLOCKS_S = 0.5  # minimum duration of a clock offset; a shorter offset is chance
VOLTAGE_V = (2.5, 4.4)  # voltage range of one LiPo cell under load
ABOVE_GROUND_M = 0.15  # height of flight without ground effect (3 propeller diameters)
START_S = 0.5  # time after lift-off and before landing in which contact is possible
MARGIN_S = 0.1  # excluded time on both sides of a marked sample
DAMAGED_MAX = 0.05  # largest allowed fraction of damaged time in the air; gaps do not count
PIECE_MIN_S = 2.0
FLIGHT_MIN_S = 3.0  # minimum usable time in the air


@dataclass(frozen=True, slots=True)
class Reason:
    """Reason why a part of a flight, or all of it, is left out."""

    text: str
    seconds: float


@dataclass(frozen=True, slots=True)
class Screened:
    """Usable parts of a flight."""

    recording: Recording
    pieces: tuple[slice, ...]  # slices of samples, each without a gap, a damaged value or contact
    left_out: tuple[Reason, ...]  # reasons for the other parts

    @property
    def usable(self) -> bool:
        return bool(self.pieces)

    @property
    def seconds(self) -> float:
        """Total duration of the usable pieces, s."""
        return float(sum(piece.stop - piece.start for piece in self.pieces)) * self.recording.step_s


def load(path: Path, columns: Mapping[str, Group]) -> Screened:
    """Read a flight, check units and signs, and screen it.

    Raises RecordingError: the file cannot be read or contradicts the columns.
    """
    recording = read_recording(path, columns)
    check(recording, columns)
    return screen(recording)


def screen(recording: Recording) -> Screened:
    r = recording
    ground = np.nanmin(r.position_m[:, 2]) if np.any(np.isfinite(r.position_m[:, 2])) else 0.0
    with np.errstate(invalid="ignore"):
        flying = ~((r.position_m[:, 2] <= ground + ABOVE_GROUND_M) | (r.duty.max(axis=1) <= 0.0))
    flying = ~_spread(~flying, START_S, r.step_s)
    reasons: list[Reason] = []
    ill, good = np.zeros_like(flying), flying.copy()
    for text, bad in _damage(r):
        spoiled = _spread(bad, MARGIN_S, r.step_s) & flying
        ill |= spoiled
        _tell(reasons, text, spoiled, r.step_s)
    for text, bad in _gaps(r, flying):
        spoiled = _spread(bad, MARGIN_S, r.step_s) & flying
        good &= ~spoiled
        _tell(reasons, text, spoiled, r.step_s)
    pieces = tuple(p for p in _runs(good & ~ill) if (p.stop - p.start) * r.step_s >= PIECE_MIN_S)
    air_s, ill_s = float(flying.sum() * r.step_s), float(ill.sum() * r.step_s)
    left_s = float(sum(p.stop - p.start for p in pieces) * r.step_s)
    whole = None
    if air_s < FLIGHT_MIN_S:
        whole = (
            f"in the air for {air_s:.1f} s only, at least {FLIGHT_MIN_S:g} s are needed; "
            f"highest {_highest_m(r):.2f} m above the ground"
        )
    elif ill_s > DAMAGED_MAX * air_s:
        whole = (
            f"damaged for {ill_s:.1f} s of {air_s:.1f} s in the air; {100.0 * DAMAGED_MAX:g} % are allowed"
        )
    elif left_s < FLIGHT_MIN_S:
        whole = f"{left_s:.1f} s left of {air_s:.1f} s in the air, at least {FLIGHT_MIN_S:g} s are needed"
    if whole is not None:
        return Screened(r, (), (*reasons, Reason(whole, float(r.time_s[-1]))))
    return Screened(r, pieces, tuple(reasons))


def _tell(reasons: list[Reason], text: str, mask: Mask, step_s: float) -> None:
    if mask.any():
        reasons.append(Reason(text, float(mask.sum() * step_s)))


def _highest_m(r: Recording) -> float:
    height_m = r.position_m[np.isfinite(r.position_m[:, 2]), 2]
    return float(np.ptp(height_m)) if len(height_m) else 0.0


def _damage(r: Recording) -> Iterator[tuple[str, Mask]]:
    """Yield failures of the vehicle's link or estimator, each with the samples that show the failure."""
    with np.errstate(invalid="ignore"):
        yield "motor commands outside 0 to 65535", np.any((r.duty < 0.0) | (r.duty > 1.0 + 1e-6), axis=1)
        low, high = VOLTAGE_V
        yield f"battery outside {low:g} to {high:g} V", (r.battery_v < low) | (r.battery_v > high)
        step = np.linalg.norm(np.diff(r.position_m, axis=0, prepend=r.position_m[:1]), axis=1)
        yield "motion capture jumps", step > SPEED_MAX_M_S * np.maximum(r.step_s, _steps(r))
        if r.estimate_position_m is not None:
            off = np.linalg.norm(r.estimate_position_m - r.position_m, axis=1)
            yield f"estimate more than {ESTIMATE_OFF_M:g} m from motion capture", off > ESTIMATE_OFF_M


def _gaps(r: Recording, flying: Mask) -> Iterator[tuple[str, Mask]]:
    """Yield gaps of the recording during the flight, each with its samples."""
    needed = [r.position_m, r.velocity_m_s, r.attitude, r.rates_rad_s, r.duty, r.battery_v[:, None]]
    if r.estimate_position_m is not None:
        needed.append(r.estimate_position_m)
    yield "values missing (NaN)", np.any(~np.isfinite(np.concatenate(needed, axis=1)), axis=1)
    yield "samples missing", np.diff(r.time_s, prepend=r.time_s[0]) > GAP_FACTOR * r.step_s
    yield "motion capture frozen", _frozen(r)
    lag_s = clock_lag_s(r)
    apart = _lasting((np.abs(lag_s) > CLOCKS_OFF_S + 0.5 * r.step_s) & flying, CLOCKS_S, r.step_s)
    worst_ms = 1000.0 * float(np.max(np.abs(lag_s[apart]), initial=0.0))
    yield f"clocks of log and motion capture differ by up to {worst_ms:.0f} ms", apart


def _steps(r: Recording) -> NDArray[np.float64]:
    return np.diff(r.time_s, prepend=r.time_s[0] - r.step_s)


def _frozen(r: Recording) -> Mask:
    """Return the samples at which the pose does not change for ``FROZEN_S``."""
    same = np.concatenate([[False], np.all(np.diff(r.position_m, axis=0) == 0.0, axis=1)])
    return _lasting(same, FROZEN_S, r.step_s)


def _lasting(mask: Mask, seconds: float, step_s: float) -> Mask:
    """Return the runs of marked samples that last at least ``seconds``."""
    kept = np.zeros_like(mask)
    for run in _runs(mask):
        kept[run] = (run.stop - run.start) * step_s >= seconds
    return kept


def _spread(mask: Mask, margin_s: float, step_s: float) -> Mask:
    """Return the samples within ``margin_s`` of a marked sample."""
    width = 2 * round(margin_s / step_s) + 1
    return np.convolve(mask, np.ones(width), mode="same") > 0.5


def _runs(mask: Mask) -> Iterator[slice]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    for start, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        yield slice(start, stop)

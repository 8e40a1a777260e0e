"""Selects the usable parts of a recorded flight, and states why other parts are left out.

First the values are checked: units, signs, order, clocks. Each quantity is compared with another quantity of
the same flight, or with the range of a small quadrotor; a factor of ``FAR`` is allowed. The gyro is
logged on board, the attitude comes from motion capture. Both show the same rotation, so their lag is the
offset of the two clocks. Over radio this offset may drift by a tenth of a second within a flight.

Each check of the screening marks samples. A marked sample also excludes ``MARGIN_S`` on both sides, because
loggers interpolate over damaged values. A piece must last at least ``PIECE_MIN_S`` in the air. A flight with
more damage than ``DAMAGED_MAX`` is excluded: estimator or link must have failed before a check detected it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy  # loads each part at the first use of the part, in 0.3 to 0.5 s
from numpy.typing import NDArray

from sim.flights.recording import QUANTITIES, Floats, Recording, RecordingError, read_recording

FAR = 6.0  # maximum ratio of two compared quantities; a wrong unit causes a larger ratio
STEP_S = (0.5e-3, 0.1)  # allowed sample period, s; longer periods do not show a quadrotor's motion
ROOM_M = 50.0  # maximum allowed extent of a flight, m
CELL_V = 3.7  # typical voltage of a LiPo cell, V
DUTY = 0.5  # typical duty cycle in flight, within a factor of 2
TILT_MAX_DEG = 60.0  # maximum allowed median tilt of a flight
OPPOSITE = -0.5  # correlation below which an axis has the wrong sign
MOVES = 0.05  # lower limit of a compared motion, m, m/s or rad/s; smaller motions are noise


def check(recording: Recording) -> None:
    """Raise RecordingError with the first quantity that contradicts the others."""
    for text in _contradictions(recording):
        raise RecordingError(text)


def _contradictions(r: Recording) -> Iterator[str]:
    low, high = STEP_S
    if not low <= r.step_s <= high:
        yield f"time: samples are {r.step_s:.3g} s apart, {low:g} to {high:g} s are allowed; the unit is s"
    for name, ratio, text in _sizes(r):
        if not 1.0 / FAR <= ratio <= FAR:
            unit = QUANTITIES[name].unit
            yield f"{name}: {text}; allowed is a factor of {FAR:g}; are these its columns, in {unit}?"
    yield from _turned(r)


def _sizes(r: Recording) -> Iterator[tuple[str, float, str]]:
    """Yield each quantity of the flight, the ratio of its size to the expected size, and both as text."""
    moving = np.isfinite(r.duty).all(axis=1) & (r.duty.max(axis=1) > 0.0)
    span_m = _width(r.position_m)
    if span_m > ROOM_M:
        yield "position", span_m, f"the flight is {2.0 * span_m:.3g} m wide"
    if moving.any():
        duty = float(np.median(r.duty[moving]))
        yield "pwm", duty / DUTY, f"the median is {duty:.3g} of the highest command, expected {DUTY:g}"
    volt = float(np.nanmedian(r.battery_v)) if np.isfinite(r.battery_v).any() else CELL_V
    yield "battery", volt / CELL_V, f"the median is {volt:.3g} V, expected {CELL_V:g} V"
    derived = np.gradient(r.position_m, r.time_s, axis=0)
    turning, gyro = (band(rates, r.step_s) for rates in (rates_rad_s(r), r.rates_rad_s))
    pairs = [
        ("velocity", r.velocity_m_s, derived, "derivative of the position"),
        ("rates", gyro, turning, "derivative of the attitude"),
        ("estimate_position", r.estimate_position_m, r.position_m, "position"),
        ("estimate_velocity", r.estimate_velocity_m_s, r.velocity_m_s, "velocity"),
        ("setpoint_position", r.setpoint_position_m, r.position_m, "position"),
    ]
    for name, values, reference, text in pairs:
        if values is None:
            continue
        size, true = _width(values), _width(reference)
        rests = size == 0.0 and name.startswith("setpoint")  # set-points, but not sensors, can be constant
        if true > MOVES and not rests:
            yield name, size / true, f"{size / true:.3g} times the {text}"


def _turned(r: Recording) -> Iterator[str]:
    """Yield a sentence for an attitude or a rate with a wrong order of columns or a wrong sign."""
    up = _matrix(r)[:, 2, 2]
    tilt_deg = float(np.degrees(np.arccos(np.clip(np.median(up), -1.0, 1.0))))
    if tilt_deg > TILT_MAX_DEG:
        yield (
            f"attitude: tilted by {tilt_deg:.0f} degrees in the middle; columns are w, x, y, z of the "
            "rotation from body (forward, left, up) to world (z up)"
        )
    values, reference = (band(rates, r.step_s) for rates in (r.rates_rad_s, rates_rad_s(r)))
    if _width(reference) <= MOVES:
        return
    for axis in range(3):
        a, b = (v[:, axis] - v[:, axis].mean() for v in (values, reference))
        size = float(np.sqrt((a**2).sum() * (b**2).sum()))
        if size > 0.0 and float((a * b).sum()) / size < OPPOSITE:
            yield f"rates: column {axis + 1} is opposite to the attitude; mend its sign, or the attitude"


def _width(values: Floats) -> float:
    """Return the median distance of the rows from their median; few damaged samples change it little."""
    good = values[np.isfinite(values).all(axis=1)]
    return float(np.median(np.linalg.norm(good - np.median(good, axis=0), axis=1))) if len(good) else 0.0


def _matrix(r: Recording) -> Floats:
    good = r.attitude[np.isfinite(r.attitude).all(axis=1)]
    if not len(good):
        return np.eye(3)[None]
    made: Floats = scipy.spatial.transform.Rotation.from_quat(good, scalar_first=True).as_matrix()
    return made


BAND_HZ = (0.5, 6.0)  # frequency band of a Crazyflie's attitude; above 6 Hz its derivative is noise
WINDOW_S = 4.0  # time window of one lag estimate, s
LAG_MAX_S = 0.25  # upper limit of the lag in the search, s
CORRELATION_MIN = 0.7  # correlation below which the lag counts as unknown


def rates_rad_s(recording: Recording) -> Floats:
    """Return (n, 3) body rates from the attitude, rad/s; 0 next to missing values."""
    r = recording
    good: NDArray[np.bool_] = np.all(np.isfinite(r.attitude), axis=1)
    turned = scipy.spatial.transform.Rotation.from_quat(
        np.where(good[:, None], r.attitude, (1.0, 0.0, 0.0, 0.0)), scalar_first=True
    )
    rates = np.zeros((len(r.time_s), 3))
    rates[1:] = (turned[:-1].inv() * turned[1:]).as_rotvec() / np.diff(r.time_s)[:, None]
    rates[1:][~(good[:-1] & good[1:])] = 0.0
    return rates


def band(rates: Floats, step_s: float) -> Floats:
    """Return (n, 3) rates, filtered to ``BAND_HZ`` without delay; missing values count as 0."""
    high_hz = min(BAND_HZ[1], 0.4 / step_s)
    sections = scipy.signal.butter(2, (BAND_HZ[0], high_hz), "bandpass", fs=1.0 / step_s, output="sos")
    filtered: Floats = scipy.signal.sosfiltfilt(
        sections, np.nan_to_num(rates, posinf=0.0, neginf=0.0), axis=0
    )
    return filtered


def clock_lag_s(recording: Recording) -> Floats:
    """Return (n,) delay of the log relative to motion capture around each sample, s; NaN if unknown."""
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
    known = correlation.max(axis=0) >= CORRELATION_MIN  # False for NaN
    return np.where(known, lags[np.argmax(shared, axis=0)] * r.step_s, np.nan)


Mask = NDArray[np.bool_]

GAP_FACTOR = 5.0  # maximum time between two samples without a gap, in sample periods
SPEED_MAX_M_S = 6.0  # maximum speed between two motion-capture samples; no Crazyflie in a room is faster
FROZEN_S = 0.05  # duration after which a repeated pose counts as frozen, s; motion capture lost the body
ESTIMATE_OFF_M = 0.3  # distance from motion capture above which an estimate has diverged; good flights: 0.2 m
CLOCKS_OFF_S = 0.05  # allowed clock offset, s; 0.05 s cause 5 cm at 1 m/s, as much as the compared errors
CLOCKS_S = 0.5  # minimum duration of a clock offset, s; a shorter offset is random
VOLTAGE_V = (2.5, 4.4)  # voltage range of one LiPo cell under load, V
ABOVE_GROUND_M = 0.15  # height above which there is no ground effect (3 propeller diameters), m
START_S = 0.5  # excluded time after lift-off and before landing, s, because contact is possible
MARGIN_S = 0.1  # excluded time on both sides of a marked sample, s
DAMAGED_MAX = 0.05  # maximum allowed fraction of damaged time in the air; gaps do not count
PIECE_MIN_S = 2.0
FLIGHT_MIN_S = 3.0  # minimum usable time in the air, s


@dataclass(frozen=True, slots=True)
class Reason:
    """Reason why a part of a flight, or the whole flight, is left out."""

    text: str
    seconds: float


@dataclass(frozen=True, slots=True)
class Screened:
    """A recorded flight with its usable parts, and the reasons why the other parts are excluded."""

    recording: Recording
    pieces: tuple[slice, ...]  # slices of samples, each without a gap, a damaged value or contact
    left_out: tuple[Reason, ...]  # reasons for the other parts

    @property
    def usable(self) -> bool:
        return bool(self.pieces)

    @property
    def seconds(self) -> float:
        """Total duration of the usable segments, s."""
        return float(sum(piece.stop - piece.start for piece in self.pieces)) * self.recording.step_s


def load(path: Path) -> Screened:
    """Read, check and screen a flight. Raises RecordingError: unreadable or contradictory data."""
    recording = read_recording(path)
    check(recording)
    return screen(recording)


def screen(recording: Recording) -> Screened:
    r = recording
    ground = np.nanmin(r.position_m[:, 2]) if np.any(np.isfinite(r.position_m[:, 2])) else 0.0
    with np.errstate(invalid="ignore"):
        flying = ~((r.position_m[:, 2] <= ground + ABOVE_GROUND_M) | (r.duty.max(axis=1) <= 0.0))
    flying = ~_spread(~flying, START_S, r.step_s)
    reasons: list[Reason] = []
    ill, good = np.zeros_like(flying), flying.copy()
    for text, damages, bad in _checks(r, flying):
        spoiled = _spread(bad, MARGIN_S, r.step_s) & flying
        good &= ~spoiled
        ill |= spoiled & damages
        if spoiled.any():
            reasons.append(Reason(text, float(spoiled.sum() * r.step_s)))
    pieces = tuple(p for p in _runs(good) if (p.stop - p.start) * r.step_s >= PIECE_MIN_S)
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


def _highest_m(r: Recording) -> float:
    height_m = r.position_m[np.isfinite(r.position_m[:, 2]), 2]
    return float(np.ptp(height_m)) if len(height_m) else 0.0


def _checks(r: Recording, flying: Mask) -> Iterator[tuple[str, bool, Mask]]:
    """Yield the text of each check, whether it finds damage (failed link or estimator), and the samples."""
    steps = np.diff(r.time_s, prepend=r.time_s[0] - r.step_s)
    needed = [r.position_m, r.velocity_m_s, r.attitude, r.rates_rad_s, r.duty, r.battery_v[:, None]]
    with np.errstate(invalid="ignore"):
        outside = np.any((r.duty < 0.0) | (r.duty > 1.0 + 1e-6), axis=1)
        yield "motor commands outside 0 to 65535", True, outside
        low, high = VOLTAGE_V
        yield f"battery outside {low:g} to {high:g} V", True, (r.battery_v < low) | (r.battery_v > high)
        step = np.linalg.norm(np.diff(r.position_m, axis=0, prepend=r.position_m[:1]), axis=1)
        yield "motion capture jumps", True, step > SPEED_MAX_M_S * np.maximum(r.step_s, steps)
        if r.estimate_position_m is not None:
            needed.append(r.estimate_position_m)
            off = np.linalg.norm(r.estimate_position_m - r.position_m, axis=1) > ESTIMATE_OFF_M
            yield f"estimate more than {ESTIMATE_OFF_M:g} m from motion capture", True, off
    yield "values missing (NaN)", False, np.any(~np.isfinite(np.concatenate(needed, axis=1)), axis=1)
    late = np.diff(r.time_s, prepend=r.time_s[0]) > GAP_FACTOR * r.step_s
    yield "samples missing", False, late
    same = np.concatenate([[False], np.all(np.diff(r.position_m, axis=0) == 0.0, axis=1)])
    yield "motion capture frozen", False, _lasting(same, FROZEN_S, r.step_s)
    lag_s = clock_lag_s(r)
    apart = _lasting((np.abs(lag_s) > CLOCKS_OFF_S + 0.5 * r.step_s) & flying, CLOCKS_S, r.step_s)
    worst_ms = 1000.0 * float(np.max(np.abs(lag_s[apart]), initial=0.0))
    yield f"clocks of log and motion capture differ by up to {worst_ms:.0f} ms", False, apart


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

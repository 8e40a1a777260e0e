"""Checks the values of a recording against the table of columns: units, signs, order, clocks.

Each quantity is compared with another quantity of the same flight, or with the range of a small quadrotor. If
they differ by more than a factor of ``FAR``, the error message names the unit that would fit.

The gyro is logged on board, the attitude comes from motion capture. Both show the same rotation, so their lag
is the offset of the two clocks. Over radio this offset may drift by a tenth of a second within a flight.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt
from scipy.spatial.transform import Rotation

from sim.flights.recording import QUANTITIES, Floats, Group, Recording, RecordingError

FAR = 6.0  # allowed factor between two quantities; any two units differ by more
STEP_S = (0.5e-3, 0.1)  # allowed sample period, s; longer periods do not show a quadrotor's motion
ROOM_M = 50.0  # largest extent of a flight
CELL_V = 3.7  # typical voltage of a LiPo cell
DUTY = 0.5  # typical duty cycle in flight, within a factor of 2
TILT_MAX_DEG = 60.0  # largest median tilt of a flight
OPPOSITE = -0.5  # correlation below which an axis has the wrong sign
# smallest motion that is compared, SI units; smaller motions are noise
MOVES = {"attitude": 0.05, "position": 0.05, "velocity": 0.05, "tilt": 0.01}


class _Scale(NamedTuple):
    """Ratio of a quantity's size to its expected size."""

    name: str
    ratio: float
    told: str


def check(recording: Recording, columns: Mapping[str, Group]) -> None:
    """Raise RecordingError if values contradict ``columns``, with each quantity and the unit that fits."""
    low, high = STEP_S
    if not low <= recording.step_s <= high:
        scale = _Scale("time", recording.step_s / 0.01, f"samples are {recording.step_s:.3g} s apart")
        raise RecordingError(_wrong(scale, columns) + f"; {low:g} to {high:g} s are allowed")
    far = [scale for scale in _scales(recording) if not 1.0 / FAR <= scale.ratio <= FAR]
    # a quantity without a fitting unit results from the wrong unit of another quantity
    far = [scale for scale in far if _fits(scale, columns)] or far
    found = [_wrong(scale, columns) for scale in far] + list(_turned(recording))
    if found:
        raise RecordingError("; ".join(found))


def _fits(scale: _Scale, columns: Mapping[str, Group]) -> list[str]:
    declared = abs(columns[scale.name].factors[0])
    units = QUANTITIES[scale.name].units
    return [u for u, factor in units.items() if 1.0 / FAR <= scale.ratio * factor / declared <= FAR]


def _wrong(scale: _Scale, columns: Mapping[str, Group]) -> str:
    """Return a sentence with the value found and the unit that would fit."""
    declared, fits = abs(columns[scale.name].factors[0]), _fits(scale, columns)
    unit = next(u for u, factor in QUANTITIES[scale.name].units.items() if np.isclose(factor, declared))
    hint = f"unit {' or '.join(fits)} would fit" if fits else "no unit fits: are these its columns?"
    return f"{scale.name}: {scale.told}, if the unit is {unit}; {hint}"


def _scales(r: Recording) -> Iterator[_Scale]:
    """Yield the ratio for each quantity that the flight shows."""
    moving = np.isfinite(r.duty).all(axis=1) & (r.duty.max(axis=1) > 0.0)
    span_m = max(_spread(r.position_m), 1e-9)
    if span_m > ROOM_M:
        yield _Scale("position", span_m, f"the flight is {2.0 * span_m:.3g} m wide")
    if moving.any():
        duty = float(np.median(r.duty[moving]))
        yield _Scale("pwm", duty / DUTY, f"the median is {duty:.3g} of the highest command")
    volt = float(np.nanmedian(r.battery_v)) if np.isfinite(r.battery_v).any() else CELL_V
    yield _Scale("battery", volt / CELL_V, f"the median is {volt:.3g} V")
    derived = np.gradient(r.position_m, r.time_s, axis=0)
    pairs = [
        ("velocity", r.velocity_m_s, derived, MOVES["velocity"], "derivative of the position"),
        ("rates", r.rates_rad_s, rates_rad_s(r), MOVES["attitude"], "derivative of the attitude"),
        ("estimate_position", r.estimate_position_m, r.position_m, MOVES["position"], "position"),
        ("estimate_velocity", r.estimate_velocity_m_s, r.velocity_m_s, MOVES["velocity"], "velocity"),
        ("setpoint_position", r.setpoint_position_m, r.position_m, MOVES["position"], "position"),
    ]
    if r.estimate_attitude_rad is not None:
        pairs.append(
            ("estimate_attitude", r.estimate_attitude_rad[:, :2], _roll_pitch(r), MOVES["tilt"], "attitude")
        )  # fmt: skip
    for name, values, reference, least, told in pairs:
        if values is None:
            continue
        if name == "rates":
            values, reference = band(values, r.step_s), band(reference, r.step_s)
        size, true = _spread(values), _spread(reference)
        rests = size == 0.0 and name.startswith("setpoint")  # unlike a sensor, a set-point can be constant
        if true > least and not rests:
            yield _Scale(name, size / true, f"{size / true:.3g} times the {told}")


def _turned(r: Recording) -> Iterator[str]:
    """Yield a sentence for each group of columns with rotated axes or a wrong sign."""
    up = _matrix(r)[:, 2, 2]
    tilt_deg = float(np.degrees(np.arccos(np.clip(np.median(up), -1.0, 1.0))))
    if tilt_deg > TILT_MAX_DEG:
        yield (
            f"attitude: tilted by {tilt_deg:.0f} degrees in the middle; columns are w, x, y, z of the "
            "rotation from body (forward, left, up) to world (z up)"
        )
        return
    yield from _signs("rates", band(r.rates_rad_s, r.step_s), band(rates_rad_s(r), r.step_s), "attitude")
    if r.estimate_attitude_rad is not None:
        yield from _signs("estimate_attitude", r.estimate_attitude_rad[:, :2], _roll_pitch(r), "tilt")


def _signs(name: str, values: Floats, reference: Floats, kind: str) -> Iterator[str]:
    good = np.isfinite(values).all(axis=1) & np.isfinite(reference).all(axis=1)
    if _spread(reference) <= MOVES[kind] or not good.any():
        return
    for axis in range(values.shape[1]):
        a, b = (v[good, axis] - v[good, axis].mean() for v in (values, reference))
        size = float(np.sqrt((a**2).sum() * (b**2).sum()))
        if size > 0.0 and float((a * b).sum()) / size < OPPOSITE:
            yield f"{name}: column {axis + 1} is opposite to the attitude; set its sign, or mend the attitude"


def _spread(values: Floats) -> float:
    """Return the median distance of the rows from their median. Damaged samples have little effect on it."""
    good = values[np.isfinite(values).all(axis=1)]
    return float(np.median(np.linalg.norm(good - np.median(good, axis=0), axis=1))) if len(good) else 0.0


def _matrix(r: Recording) -> Floats:
    good = r.attitude[np.isfinite(r.attitude).all(axis=1)]
    if not len(good):
        return np.eye(3)[None]
    made: Floats = Rotation.from_quat(good, scalar_first=True).as_matrix()
    return made


def _roll_pitch(r: Recording) -> Floats:
    """Return (n, 2) roll and pitch from motion capture; NaN: no pose."""
    w, x, y, z = r.attitude.T
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    return np.stack([roll, np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))], axis=1)


BAND_HZ = (0.5, 6.0)  # frequency band of a Crazyflie's attitude; above it the attitude's derivative is noise
WINDOW_S = 4.0  # time window of one lag estimate
LAG_MAX_S = 0.25  # largest lag of the search
CORRELATION_MIN = 0.7  # correlation below which the lag counts as unknown


def rates_rad_s(recording: Recording) -> Floats:
    """Return (n, 3) body rates from the attitude, rad/s; 0 next to missing values."""
    r = recording
    good: NDArray[np.bool_] = np.all(np.isfinite(r.attitude), axis=1)
    turned = Rotation.from_quat(np.where(good[:, None], r.attitude, (1.0, 0.0, 0.0, 0.0)), scalar_first=True)
    rates = np.zeros((len(r.time_s), 3))
    rates[1:] = (turned[:-1].inv() * turned[1:]).as_rotvec() / np.diff(r.time_s)[:, None]
    rates[1:][~(good[:-1] & good[1:])] = 0.0
    return rates


def band(rates: Floats, step_s: float) -> Floats:
    """Return (n, 3) rates, filtered to ``BAND_HZ`` without delay; missing values count as 0."""
    high_hz = min(BAND_HZ[1], 0.4 / step_s)
    sections = butter(2, (BAND_HZ[0], high_hz), "bandpass", fs=1.0 / step_s, output="sos")
    filtered: Floats = sosfiltfilt(sections, np.nan_to_num(rates, posinf=0.0, neginf=0.0), axis=0)
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

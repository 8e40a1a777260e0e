"""Fits the numbers of a vehicle's file to recorded flights.

Each flight is fitted separately by least squares (scipy). The result is the median over the flights, with an
interval from bootstrap over flights: the spread between flights (airframes, batteries, propellers) is larger
than the uncertainty of one flight. Only numbers that flights reveal are fitted: forces per mass, and torques
per rotor thrust. The base file gives mass and thrust curve.

Three kinds of residuals are minimised together, each divided by its usual size: the specific force along body
z (thrust, lag), the one across it (drag, misalignment of the markers), and the next gyro sample minus the
prediction by an observer of rate and unknown torque. The last kind is needed for flights under feedback: a
regression of angular acceleration on torque would identify the inverse of the controller.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter
from scipy.stats import bootstrap

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64
from sim.flights.screening import Screened
from sim.plant.params import Params
from sim.plant.rotors import POSITION_X, POSITION_Y
from sim.validation.open_loop import SAMPLE_S, Piece, pieces, rotations

WINDOW = 5  # number of samples over which the velocity is differentiated
FINE = 5  # motor steps per sample: the firmware commands the motors at 500 Hz
SKIP = 50  # samples at the start of a piece in which the lags settle; they are not used
SIZES = (0.15, 0.3, 0.024)  # usual residuals: along z and across, m/s^2; gyro, rad/s
LEVEL = 0.95  # confidence of the intervals
SECONDS_MIN = 3.0  # smallest usable time of a flight
VOLTAGE_LAG_S = 0.1  # lag of the voltage, which is logged at 10 Hz


class Values(NamedTuple):
    """Fitted numbers of a vehicle."""

    hover_v: float  # mean voltage at the motors in hover
    exponent: float  # exponent of the thrust as a power of this voltage, near hover
    lag_s: float  # lag of the motor speed
    drag_1_s: float  # drag along body x and y per mass
    climb_drag_1_s: float  # drag along body z per mass
    inertia_kg_m2: float  # inertia about body x and y, for the base's mass and arm
    drag_above_com_m: float  # height of the drag's point of action above the centre of mass
    rate_damping_1_s: float  # damping of roll and pitch rate
    delay_s: float  # delay from a logged command to the gyro, in addition to the lag
    resistance_ohm: float  # resistance of the battery, for the base's currents


LOW = Values(1.0, 0.5, 0.005, -0.5, -2.0, 1e-7, -1.0, -10.0, -0.02, 0.0)
HIGH = Values(20.0, 4.0, 0.3, 5.0, 5.0, 1.0, 1.0, 60.0, 0.06, 5.0)


@dataclass(frozen=True, slots=True)
class FlightFit:
    """Numbers of one flight, with standard errors from the Jacobian."""

    name: str
    values: Values
    errors: Values


@dataclass(frozen=True, slots=True)
class Number:
    """A fitted number: median over flights, its interval, and the standard deviation over flights."""

    value: float
    low: float
    high: float
    spread: float


@dataclass(frozen=True, slots=True)
class Fit:
    """Result over all flights."""

    numbers: Mapping[str, Number]  # numbers under the names of ``Values``
    flights: tuple[FlightFit, ...]

    @property
    def values(self) -> Values:
        return Values(*(self.numbers[name].value for name in Values._fields))


class _Data(NamedTuple):
    """A piece of a flight, prepared for the residuals."""

    duty: F64  # (n, 4) duty cycles
    battery_v: F64  # (n,) voltage under load
    rates: F64  # (n, 3) gyro, rad/s
    velocity: F64  # (n, 3) true velocity, body frame
    force: F64  # (w, 3) mean specific force in each window, body frame


def _data(piece: Piece) -> _Data:
    turn = rotations(piece.quaternion)
    world = np.diff(piece.velocity[::WINDOW], axis=0) / (WINDOW * SAMPLE_S) + (0.0, 0.0, 9.81)
    middle = turn[WINDOW // 2 :: WINDOW][: len(world)]
    return _Data(
        np.clip(piece.duty, 0.0, 1.0), piece.battery_v, piece.rates,
        turn.inv().apply(piece.velocity), middle.inv().apply(world),
    )  # fmt: skip


@jitted
def _innovations(
    torque: F64, aside: F64, rates: F64, moment: float, damping: float, gains: F64, out: F64
) -> None:
    """Write the gyro samples minus the observer's predictions to ``out``: (n,) rad/s.

    ``torque``: (n,) angular acceleration by the rotors until the next sample, rad/s^2; ``aside``: (n,) body
    velocity that causes the drag's moment, m/s; ``moment``: angular acceleration per m/s of this velocity;
    ``gains``: gain of the rate, gains of the fading and the constant unknown torque (1/s), and the fraction
    of the fading torque that remains after a sample.
    """
    rate, fades, stays = rates[0], 0.0, 0.0
    for i in range(len(rates)):
        error = rates[i] - rate
        out[i] = error
        rate += gains[0] * error
        fades += gains[1] * error
        stays += gains[2] * error
        rate += SAMPLE_S * (torque[i] + moment * aside[i] - damping * rate + fades + stays)
        fades *= gains[3]


def _lagged(values: F64, lag_s: float, step_s: float = SAMPLE_S) -> F64:
    keep = math.exp(-step_s / lag_s)
    found = lfilter([1.0 - keep], [1.0, -keep], values, axis=0, zi=keep * values[:1])[0]
    return np.asarray(found, dtype=np.float64)


class _Problem:
    """Residuals of one flight.

    The unknowns are ``Values`` without the resistance, the misalignment (2), and the observer's gains (4).
    """

    def __init__(self, data: Sequence[_Data], params: Params) -> None:
        self._data, self.battery = data, params.battery
        self._mass, self._arm, rotor = params.body.mass_kg, params.rotor.arm_m, params.rotor
        self._linear, self._square = rotor.thrust_linear_n_rpm, rotor.thrust_square_n_rpm2
        self.hover_rpm = rotor.rpm(self._mass * params.contact.gravity_m_s2 / 4.0)
        self.steepness = steepness(params)

    def speeds(self, d: _Data, hover_v: float, exponent: float, lag_s: float) -> F64:
        """Return settled motor speeds (n, 4) over the hover speed, by the map of ``sim.plant.rotors``."""
        slope, sag_v = exponent / self.steepness, np.full(len(d.duty), self.battery.hover_sag_v)
        for _ in range(2):  # fixed-point iteration: the sag depends on the speed, the speed on the sag
            motor_v = d.duty * (d.battery_v + sag_v)[:, None] - sag_v[:, None]
            speeds = np.maximum(0.0, 1.0 + slope * (motor_v / hover_v - 1.0))
            power = _lagged((speeds**3).mean(axis=1), lag_s)
            sag_v = self.battery.resistance_ohm * (
                self.battery.idle_current_a + self.battery.hover_current_a * power
            )
        return np.asarray(speeds, dtype=np.float64)

    def residuals(self, unknown: F64) -> F64:
        """Return all residuals, divided by their usual sizes."""
        hover_v, exponent, lag_s, drag, climb_drag, inertia, above, damping, delay_s, *rest = unknown.tolist()
        ahead, left, *gains = rest
        parts = []
        for d in self._data:
            wanted = self.hover_rpm * self.speeds(d, hover_v, exponent, lag_s)
            index = np.arange(FINE * len(wanted)) / FINE - delay_s / SAMPLE_S
            fine = [np.interp(index, np.arange(len(wanted)), column) for column in wanted.T]
            rpm = _lagged(np.stack(fine, axis=1), lag_s, SAMPLE_S / FINE)
            each = ((self._linear + self._square * rpm) * rpm).reshape(-1, FINE, 4).mean(axis=1)
            windows = WINDOW * len(d.force)
            pull = each[:windows].sum(axis=1).reshape(-1, WINDOW).mean(axis=1) / self._mass
            v = d.velocity[:windows].reshape(-1, WINDOW, 3).mean(axis=1)
            first = SKIP // WINDOW
            errors = (
                (d.force[:, 2] - pull + climb_drag * v[:, 2]) / SIZES[0],
                (d.force[:, 0] - ahead * pull + drag * v[:, 0]) / SIZES[1],
                (d.force[:, 1] - left * pull + drag * v[:, 1]) / SIZES[1],
            )
            parts += [error[first:] for error in errors]
            moment = drag * self._mass * above / inertia
            for axis, sign, places, aside in (
                (0, 1, POSITION_Y, d.velocity[:, 1]),
                (1, -1, POSITION_X, -d.velocity[:, 0]),
            ):
                torque = sign * self._arm / inertia * (each @ np.array(places, dtype=np.float64))
                out = np.empty(len(torque))
                rate = np.ascontiguousarray(d.rates[:, axis])
                _innovations(torque, np.ascontiguousarray(aside), rate, moment, damping, np.array(gains), out)
                parts.append(out[SKIP:] / SIZES[2])
        return np.concatenate(parts)


def steepness(params: Params) -> float:
    """Return the exponent of thrust as a power of the rotor speed, at hover."""
    rotor, weight_n = params.rotor, params.body.mass_kg * params.contact.gravity_m_s2
    rpm = rotor.rpm(weight_n / 4.0)
    return (rotor.thrust_linear_n_rpm + 2.0 * rotor.thrust_square_n_rpm2 * rpm) * rpm / (weight_n / 4.0)


def start_values(params: Params) -> Values:
    """Return the numbers of a vehicle's file."""
    body, battery = params.body, params.battery
    rpm = params.rotor.rpm(body.mass_kg * params.contact.gravity_m_s2 / 4.0)
    hover_v = battery.motor_v(rpm)
    return Values(
        hover_v, steepness(params) * battery.speed_per_volt_rpm * hover_v / rpm, params.rotor.lag_s,
        body.drag_n_s_m[0] / body.mass_kg, body.drag_n_s_m[2] / body.mass_kg, body.inertia_kg_m2[0],
        body.drag_above_com_m, body.rate_damping_n_m_s / body.inertia_kg_m2[0], 0.008, battery.resistance_ohm,
    )  # fmt: skip


def fit_flight(flight: Screened, params: Params) -> FlightFit | None:
    """Fit one flight; None if its usable time is below ``SECONDS_MIN``.

    ``params``: the base, which gives the start of the fit and the numbers that a flight does not reveal.
    """
    usable = [piece for piece in pieces(flight) if len(piece.duty) > 4 * SKIP]
    if sum(len(piece.duty) for piece in usable) * SAMPLE_S < SECONDS_MIN:
        return None
    data = [_data(piece) for piece in usable]
    problem = _Problem(data, params)
    start = start_values(params)
    scale = np.array([*(max(abs(v), 0.02) for v in start[:-1]), 0.05, 0.05, 1.0, 40.0, 10.0, 0.5])
    guess = np.array([*start[:-1], 0.0, 0.0, 1.1, 40.0, 5.0, 0.9])
    low = np.array([*LOW[:-1], -0.3, -0.3, 0.1, 0.0, 0.0, 0.0])
    high = np.array([*HIGH[:-1], 0.3, 0.3, 1.95, 400.0, 100.0, 0.999])
    found = least_squares(
        problem.residuals, np.clip(guess, low, high), bounds=(low, high), x_scale=scale,
        loss="soft_l1", f_scale=3.0, ftol=1e-4, xtol=1e-4, max_nfev=30,
    )  # fmt: skip
    errors = _standard_errors(found.jac, found.fun)
    own = Values._make([*found.x[:9].tolist(), start.resistance_ohm])
    resistance, its_error = _resistance(data, problem, own)
    values = own._replace(resistance_ohm=resistance)
    return FlightFit(flight.recording.name, values, Values._make([*errors[:9].tolist(), its_error]))


def _standard_errors(jacobian: F64, residuals: F64) -> F64:
    """Return standard errors of least squares; infinite for an unknown without effect on residuals."""
    freedom = max(1, len(residuals) - jacobian.shape[1])
    size = np.linalg.norm(jacobian, axis=0)
    if not np.all(size > 0.0):
        return np.full(len(size), np.inf)
    square = (jacobian / size).T @ (jacobian / size)
    variance = np.diag(np.linalg.pinv(square)) * float(residuals @ residuals) / freedom
    return np.asarray(np.sqrt(variance) / size, dtype=np.float64)


def _resistance(data: Sequence[_Data], problem: _Problem, values: Values) -> tuple[float, float]:
    """Return the battery's resistance and its standard error, from the voltage as a function of the power."""
    rows, volts = [], []
    for number, d in enumerate(data):
        speeds = problem.speeds(d, values.hover_v, values.exponent, values.lag_s)
        power = _lagged(np.mean(speeds**3, axis=1), VOLTAGE_LAG_S)
        columns = np.zeros((len(power), 1 + 2 * len(data)))
        columns[:, 0] = -problem.battery.hover_current_a * power
        columns[:, 1 + 2 * number], columns[:, 2 + 2 * number] = 1.0, SAMPLE_S * np.arange(len(power))
        rows.append(columns[SKIP:])
        volts.append(d.battery_v[SKIP:])
    matrix, right = np.concatenate(rows)[::10], np.concatenate(volts)[::10]
    found = np.linalg.lstsq(matrix, right, rcond=None)[0]
    return float(found[0]), float(_standard_errors(matrix, right - matrix @ found)[0])


def together(flights: Sequence[FlightFit], seed: int = 0) -> Fit:
    """Return medians over flights with intervals (from the Jacobians below three). ValueError: no flight."""
    if not flights:
        raise ValueError("found no flight that can be fitted, one at least is needed")
    numbers = {}
    for name in Values._fields:
        each = np.array([getattr(flight.values, name) for flight in flights])
        middle, spread = float(np.median(each)), float(np.std(each))
        if len(each) < 3:
            half = 1.96 * max(getattr(flight.errors, name) for flight in flights) + spread
            numbers[name] = Number(middle, middle - half, middle + half, spread)
            continue
        interval = bootstrap(
            (each,), np.median, confidence_level=LEVEL, method="percentile", rng=np.random.default_rng(seed)
        ).confidence_interval
        numbers[name] = Number(middle, float(interval.low), float(interval.high), spread)
    return Fit(numbers, tuple(flights))


def fitted(params: Params, values: Values) -> Params:
    """Return the base with the fitted numbers."""
    b, rotor = params.body, params.rotor
    rpm = rotor.rpm(b.mass_kg * params.contact.gravity_m_s2 / 4.0)
    slope = values.exponent / steepness(params)
    battery = replace(
        params.battery, speed_at_zero_v_rpm=rpm * (1.0 - slope),
        speed_per_volt_rpm=rpm * slope / values.hover_v, resistance_ohm=values.resistance_ohm,
    )  # fmt: skip
    drag, up = values.drag_1_s * b.mass_kg, values.climb_drag_1_s * b.mass_kg
    body = replace(
        b, drag_n_s_m=(drag, drag, up), drag_above_com_m=values.drag_above_com_m,
        inertia_kg_m2=(values.inertia_kg_m2, values.inertia_kg_m2, b.inertia_kg_m2[2]),
        rate_damping_n_m_s=values.rate_damping_1_s * values.inertia_kg_m2,
    )  # fmt: skip
    return replace(params, body=body, rotor=replace(rotor, lag_s=values.lag_s), battery=battery)

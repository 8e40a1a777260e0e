"""Predicts recorded flights from motor commands and battery voltage, to find the error of the plant alone.

Every ``EVERY_S`` the plant starts from the true state: position, velocity and attitude from motion capture,
rates from the gyro. After the start its only inputs are the recorded commands and voltages. Before each start
three quantities are calibrated from earlier samples:

- thrust: one factor, with which the plant reproduces the recorded change of velocity in the last
  ``CALIBRATION_S`` seconds;
- marker misalignment: two angles, from the same change of velocity;
- torque: an observer follows the gyro and estimates the torque that the plant lacks. In the prediction the
  slow part of this torque (unequal motors, offset centre of mass) is constant, and the fast part decays.

The recorded commands contain the controller's reaction to the missing torque, so the missing torque opposes
the rates that the commands alone would cause. ``ANSWER_1_S`` models this.

The result is compared with two simpler predictions: a calibrated ideal rigid body without motor lag, drag and
battery sag; and a motion with the velocity and body rates of the start.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy  # loads each part at the first use of the part, in 0.3 to 0.5 s

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, I64, Cell, cell, new
from sim.flights.screening import Screened
from sim.plant.params import STEP_S, Params, Plant
from sim.plant.rotors import set_up_rotors, turn_rotors
from sim.vehicle.physics import VehicleRecord, push, set_up_drag
from sim.world.bodies import move_body

HORIZONS_S = (0.1, 0.25, 0.5)
EVERY_S = 0.1
SAMPLE_S = 0.01  # period to which recordings are resampled, s
STEPS = 10  # plant steps per sample
CALIBRATION_S = 1.0
BACK = round(CALIBRATION_S / SAMPLE_S)
COMMAND_DELAY_MS = 8  # delay from a logged command to the gyro in addition to the motors' lag, ms; fitted
# gains of the observer; they minimise the errors after 0.5 s, with a flat minimum
RATE_GAIN = 1.4  # rate correction divided by rate error, per sample; above 1 because of the gyro's filter
FAST_GAIN, SLOW_GAIN = 40.0, 10.0  # gains of the missing angular acceleration's fast and slow part, 1/s
FADES_S = 0.1  # correlation time of the fast part, s
ANSWER_1_S = 9.0  # angular acceleration against a body rate, divided by that rate, 1/s


@dataclass(frozen=True, slots=True)
class Compared:
    """Rms errors of three predictions over all starts of a flight."""

    model: float
    constant_velocity: float
    ideal: float


@dataclass(frozen=True, slots=True)
class Horizon:
    """Errors at the time ``seconds`` after the start."""

    seconds: float
    position_m: Compared
    velocity_m_s: Compared
    attitude_rad: Compared


@dataclass(frozen=True, slots=True)
class OpenLoop:
    """Errors of the predictions of one flight."""

    horizons: tuple[Horizon, ...]  # errors at ``HORIZONS_S``
    thrust_ratio: float  # ratio of the plant's thrust to the recorded thrust, mean over the starts
    starts: int  # number of start samples; a prediction begins at each start sample


class Piece(NamedTuple):
    """A usable segment of a flight with n samples, resampled to ``SAMPLE_S``."""

    position: F64  # (n, 3) true position, ENU, m
    velocity: F64  # (n, 3) true velocity, ENU, m/s
    quaternion: F64  # (n, 4) true attitude, w first, body FLU to ENU
    rates: F64  # (n, 3) gyro, rad/s
    duty: F64  # (n, 4) duty cycles of the motors
    battery_v: F64  # (n,) voltage under load


def pieces(flight: Screened) -> Iterator[Piece]:
    """Yield the usable segments, resampled because the logs lack some samples."""
    r = flight.recording
    attitude = _continuous(r.attitude)
    for part in flight.pieces:
        time_s = r.time_s[part]
        at = np.arange(time_s[0], time_s[-1], SAMPLE_S)

        columns = np.concatenate(
            [r.position_m, r.velocity_m_s, attitude, r.rates_rad_s, r.duty, r.battery_v[:, None]], axis=1
        )[part]
        even = np.stack([np.interp(at, time_s, column) for column in columns.T], axis=1)
        position, velocity, turned, rates, duty, battery_v = np.split(even, (3, 6, 10, 13, 17), axis=1)
        turned = turned / np.linalg.norm(turned, axis=1, keepdims=True)
        yield Piece(position, velocity, turned, rates, duty, battery_v[:, 0])


def _continuous(quaternion: F64) -> F64:
    """Return the same rotations without sign changes between samples."""
    with np.errstate(invalid="ignore"):
        flips = np.sum(quaternion[1:] * quaternion[:-1], axis=1) < 0.0
    sign = np.concatenate([[1.0], np.where(np.cumsum(flips) % 2 == 1, -1.0, 1.0)])
    even: F64 = quaternion * sign[:, None]
    return even


def commanded_rpm(params: Params, duty: F64, battery_v: F64) -> F64:
    """Return settled motor speeds (n, 4), rpm, for duty cycles (n, 4) and voltage under load (n,), V."""
    rotor, battery = params.rotor, params.battery
    if rotor.volt_map is None:  # the duty cycle is a fraction of the highest thrust
        a, b = rotor.thrust_square_n_rpm2, rotor.thrust_linear_n_rpm
        rpm = (np.sqrt(b * b + 4.0 * a * rotor.thrust_max_n * duty) - b) / (2.0 * a)
        limit = battery.speed_at_zero_v_rpm + battery.speed_per_volt_rpm * battery_v
        return np.minimum(rpm, limit[:, None])
    sag_v = battery.hover_sag_v  # sag from current pulses: sim.plant.rotors.speed_at_no_duty
    motor_v = duty * (battery_v[:, None] + sag_v) - sag_v
    return np.maximum(0.0, battery.speed_at_zero_v_rpm + battery.speed_per_volt_rpm * motor_v)


@jitted
def _follow(
    vehicle: Cell[VehicleRecord], commands: F64, rates: F64, rpm: F64, thrust: F64, torque: F64
) -> None:
    """Simulate the rotors: speeds at each sample, mean thrust and torque until the next sample."""
    r = vehicle[0].rotors
    for k in range(4):
        r.rpm[k] = commands[0, k]
    for i in range(len(commands)):
        for k in range(4):
            rpm[i, k] = r.rpm[k]
        for step in range(STEPS):
            now = max(0, i * STEPS + step - COMMAND_DELAY_MS) // STEPS
            turn_rotors(r, commands[now], rates[i, 0], rates[i, 1])
            thrust[i] += r.thrust_n / STEPS
            torque[i, 0] += r.torque_x / STEPS
            torque[i, 1] += r.torque_y / STEPS
            torque[i, 2] += r.torque_z / STEPS


@jitted
def _observe(acceleration: F64, rates: F64, fade: float, fast: F64, slow: F64) -> None:
    """Estimate the missing angular acceleration at each sample from earlier samples, in (n, 3) arrays.

    ``acceleration``: angular acceleration of the plant at the recorded rates until the next sample, (n, 3),
    rad/s^2; ``fade``: fraction of the fast part that remains after a sample.
    """
    for axis in range(3):
        rate, fades, stays = rates[0, axis], 0.0, 0.0
        for i in range(len(rates)):
            error = rates[i, axis] - rate
            rate += RATE_GAIN * error
            fades += FAST_GAIN * error
            stays += SLOW_GAIN * error
            fast[i, axis], slow[i, axis] = fades, stays
            rate += SAMPLE_S * (acceleration[i, axis] + fades + stays)
            fades *= fade


@jitted
def _predict(
    vehicle: Cell[VehicleRecord], commands: F64, starts: I64, states: F64, fade: float, ends: I64, found: F64
) -> None:
    """Simulate the plant from each start.

    ``commands``: (n, 4) rpm; ``starts``: (m,) samples; ``states``: (m, 24) position, velocity, quaternion,
    rates, rotor speeds, thrust factor, slow and fast missing angular acceleration; ``fade``: fraction of the
    fast part that remains after a step; ``ends``: (h,) samples after the start at which states are stored, in
    increasing order; ``found``: (m, h, 10) receives position, velocity, quaternion.
    """
    v = vehicle[0]
    body, wrench = v.world.body, v.world.wrench
    for s in range(len(starts)):
        start, left, end = states[s], 1.0, 0
        for k in range(3):
            body.position[k], body.velocity[k], body.rates[k] = start[k], start[3 + k], start[10 + k]
        for k in range(4):
            body.quaternion[k], v.rotors.rpm[k], v.rotors.share[k] = start[6 + k], start[13 + k], start[17]
        for step in range(ends[-1] * STEPS):
            now = (starts[s] * STEPS + step - COMMAND_DELAY_MS) // STEPS
            for k in range(4):
                v.firmware.commands[k] = commands[now, k]
            push(v)
            for k in range(3):
                lacking = start[18 + k] + left * start[21 + k] - ANSWER_1_S * body.rates[k]
                wrench.torque[k] += wrench.inertia[k] * lacking
            move_body(body, wrench)
            left *= fade
            if step + 1 == ends[end] * STEPS:
                for k in range(3):
                    found[s, end, k], found[s, end, 3 + k] = body.position[k], body.velocity[k]
                for k in range(4):
                    found[s, end, 6 + k] = body.quaternion[k]
                end += 1


def rotations(quaternion: F64) -> scipy.spatial.transform.Rotation:
    """Return the rotations from body to world of unit quaternions (n, 4), w first."""
    return scipy.spatial.transform.Rotation.from_quat(quaternion[:, [1, 2, 3, 0]])


class Model:
    """A plant that flies along recorded segments."""

    def __init__(self, params: Params) -> None:
        self._params, self._gravity = params, params.contact.gravity_m_s2
        self._record = r = new(VehicleRecord)
        self._vehicle = cell(r)
        set_up_rotors(r.rotors, params.rotor, Plant(), False, STEP_S)
        set_up_drag(r.drag, params.body, params.body.mass_kg * self._gravity)
        r.world.wrench.mass, r.world.wrench.inertia[:] = params.body.mass_kg, params.body.inertia_kg_m2
        r.motor_share[:] = 1.0

    def fly(self, piece: Piece, starts: I64, ends: I64) -> tuple[F64, scipy.spatial.transform.Rotation, F64]:
        """Calibrate before each start and predict.

        ``starts``: (m,) samples, later than ``BACK``; ``ends``: (h,) samples after the start, increasing.
        Returns states (m, h, 10), misalignments of the markers (m,), thrust factors (m,).
        """
        commands = commanded_rpm(self._params, np.clip(piece.duty, 0.0, 1.0), piece.battery_v)
        n = len(commands)
        rpm, thrust, torque = np.empty((n, 4)), np.zeros(n), np.zeros((n, 3))
        self._record.rotors.share[:] = 1.0
        _follow(self._vehicle, commands, piece.rates, rpm, thrust, torque)
        axes = rotations(piece.quaternion).as_matrix()
        force = self._force(piece, axes, thrust, starts)
        scale = np.linalg.norm(force, axis=1)
        aside = np.stack([-force[:, 1], force[:, 0], np.zeros(len(force))], axis=1) / scale[:, None]
        misaligned = scipy.spatial.transform.Rotation.from_rotvec(aside)
        fast, slow = np.empty((n, 3)), np.empty((n, 3))
        acceleration = self._angular(piece, axes, torque)
        _observe(acceleration, piece.rates, math.exp(-SAMPLE_S / FADES_S), fast, slow)
        attitude = (rotations(piece.quaternion[starts]) * misaligned).as_quat()[:, [3, 0, 1, 2]]
        calibration = (scale[:, None], slow[starts], fast[starts])
        true = (piece.position[starts], piece.velocity[starts], attitude, piece.rates[starts], rpm[starts])
        states = np.concatenate([*true, *calibration], axis=1)
        found = np.empty((len(starts), len(ends), 10))
        _predict(self._vehicle, commands, starts, states, math.exp(-STEP_S / FADES_S), ends, found)
        return found, misaligned, scale

    def _force(self, piece: Piece, axes: F64, thrust: F64, starts: I64) -> F64:
        """Return vectors b (m, 3) in the body frame that scale the plant's thrust.

        Over ``BACK`` samples: change of velocity without weight and drag = sum of (R thrust / mass) b.
        """
        b = self._params.body
        drag = np.einsum("nij,j,nkj,nk->ni", axes, np.array(b.drag_n_s_m), axes, piece.velocity) / b.mass_kg
        other = np.cumsum(drag + np.array([0.0, 0.0, self._gravity]), axis=0) * SAMPLE_S
        pull = np.cumsum(axes * (thrust / b.mass_kg)[:, None, None], axis=0) * SAMPLE_S
        since = starts - BACK
        gained = piece.velocity[starts] - piece.velocity[since] + other[starts - 1] - other[since - 1]
        found = np.linalg.solve(pull[starts - 1] - pull[since - 1], gained[:, :, None])
        return np.asarray(found[:, :, 0], dtype=np.float64)

    def _angular(self, piece: Piece, axes: F64, torque: F64) -> F64:
        """Return the angular acceleration (n, 3) at the recorded velocities and rates."""
        drag = self._record.drag
        velocity = np.einsum("nji,nj->ni", axes, piece.velocity)
        turning = torque.copy()
        turning[:, 0] += drag.moment * velocity[:, 1] - drag.damping * piece.rates[:, 0]
        turning[:, 1] -= drag.moment * velocity[:, 0] + drag.damping * piece.rates[:, 1]
        turning /= np.array(self._params.body.inertia_kg_m2)
        return turning


def ideal(params: Params) -> Params:
    """Return the vehicle as a rigid body without drag and motor lag."""
    body = replace(params.body, drag_n_s_m=(0.0, 0.0, 0.0), drag_above_com_m=0.0, rate_damping_n_m_s=0.0)
    return replace(params, body=body, rotor=replace(params.rotor, lag_s=1e-6))


def compare(flight: Screened, params: Params) -> OpenLoop | None:
    """Compare the plant with the usable segments of a flight; None if every segment is too short."""
    ends = np.array([round(seconds / SAMPLE_S) for seconds in HORIZONS_S])
    usable = [p for p in pieces(flight) if len(p.duty) > BACK + 1 + ends[-1]]
    if not usable:
        return None
    mean_v = float(np.mean(np.concatenate([p.battery_v for p in usable])))
    model, simple = Model(params), Model(ideal(params))
    squares: list[F64] = []
    scales: list[F64] = []
    for piece in usable:
        starts = np.arange(BACK + 1, len(piece.duty) - ends[-1], round(EVERY_S / SAMPLE_S))
        after = starts[:, None] + ends
        found, misaligned, scale = model.fly(piece, starts, ends)
        fresh = piece._replace(battery_v=np.full_like(piece.battery_v, mean_v))
        bare, turned, _ = simple.fly(fresh, starts, ends)
        aligned = scipy.spatial.transform.Rotation.identity(len(starts))
        errors = (
            _errors(found, piece, after, misaligned),
            _errors(_constant(piece, starts, ends), piece, after, aligned),
            _errors(bare, piece, after, turned),
        )
        squares.append(np.stack(errors, axis=-1) ** 2)
        scales.append(scale)
    rms = np.sqrt(np.mean(np.concatenate(squares), axis=0))  # axes: horizon, quantity, ``Compared``
    horizons = tuple(
        Horizon(seconds, *(Compared(*values) for values in row))
        for seconds, row in zip(HORIZONS_S, rms.tolist(), strict=True)
    )
    factors = np.concatenate(scales)
    return OpenLoop(horizons, float(1.0 / factors.mean()), len(factors))


def _errors(found: F64, piece: Piece, after: I64, misaligned: scipy.spatial.transform.Rotation) -> F64:
    """Return errors (m starts, h horizons, 3) against the flight: position, velocity, attitude."""
    position = np.linalg.norm(found[..., :3] - piece.position[after], axis=-1)
    velocity = np.linalg.norm(found[..., 3:6] - piece.velocity[after], axis=-1)
    angle = np.empty_like(position)
    for end in range(after.shape[1]):
        own, true = rotations(found[:, end, 6:]), rotations(piece.quaternion[after[:, end]])
        angle[:, end] = (own.inv() * true * misaligned).magnitude()
    return np.stack([position, velocity, angle], axis=-1)


def _constant(piece: Piece, starts: I64, ends: I64) -> F64:
    """Return states (m, h, 10) at constant velocity and rates."""
    rows = []
    attitude, v = rotations(piece.quaternion[starts]), piece.velocity[starts]
    for seconds in ends * SAMPLE_S:
        turned = attitude * scipy.spatial.transform.Rotation.from_rotvec(piece.rates[starts] * seconds)
        quaternion = turned.as_quat()[:, [3, 0, 1, 2]]
        rows.append(np.concatenate([piece.position[starts] + v * seconds, v, quaternion], axis=1))
    return np.stack(rows, axis=1)

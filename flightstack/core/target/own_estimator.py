"""Estimate of the vehicle state from delayed positions and velocities with errors.

docs/how_it_works/own_state.md describes the errors. The vehicle's velocity loop controls the reported
velocity. Each horizontal axis has the position p, the velocity v, the acceleration a of the loop, the error e
of the reported velocity, and the acceleration f of gusts and turning moments. With velocity feedback, which
needs the same model (natural frequency w, damping zeta; T, T_f: correlation times), the equations are:

    p' = v,   v' = a + f,   a' = w^2 (u - v - e) - 2 zeta w a,   e' = -e/T + noise,   f' = -f/T_f + noise

p and v + e are measured. A steady Kalman filter estimates all five states for the time of the measurement.
The same model predicts the states over the delay with the set-points u that have no effect yet. Without
velocity feedback the real loop can be faster than the declared one; the filter would estimate the difference
as an error e. In this case only the position (as q) and e are estimated, and p and v are the reported values.
The same holds always for z, where thrust saturation makes the model wrong:

    q' = v - e + 2 r (p - q),      e' = -r^2 (p - q),      r = 1 / T
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import NamedTuple

from flightstack.core.memory import AxisState, OwnMemory
from flightstack.core.parameters.robust import OwnStateLink, VelocityLoop
from flightstack.core.safety.position_loop import clip
from flightstack.core.types import OwnState, Vec3

KNOWN = 4  # number of stored set-points: 30 ms at 100 Hz, and one earlier set-point
GAP_MAX_S = 0.2  # gap between samples after which the estimator restarts, s
VELOCITY_NOISE_M_S = 0.01  # standard deviation of the white noise in a reported velocity, m/s

PUSH_M_S2 = 0.15  # rms of f, m/s^2: recorded turning moments, a tilt error of 0.015 rad, gusts of 0.3 m/s
PUSH_TIME_S = 1.0  # correlation time of f, s: between that of moments, 0.1 s, and of a tilt error
PERIODS = 600  # number of steps of the Riccati recursion: 6 s at 100 Hz, longer than all time constants

Matrix = list[list[float]]
Model = tuple[float, float, float, float, float]  # model of an axis, see ``OwnEstimator``


class Gains(NamedTuple):
    """Kalman gains of the five states for the innovations of position and velocity."""

    position: tuple[float, float, float, float, float]
    velocity: tuple[float, float, float, float, float]


NO_GAINS = Gains((0.0,) * 5, (0.0,) * 5)  # gains with which no sample corrects the estimate


@lru_cache(maxsize=16)
def steady_gains(loop: VelocityLoop, link: OwnStateLink, period_s: float) -> Gains:
    """Return the gains of the steady Kalman filter; plain floats give the same bits on every machine."""
    t, w, two_zw = period_s, loop.rate_xy_1_s, 2.0 * loop.damping * loop.rate_xy_1_s
    step = [
        [1.0, t, 0.0, 0.0, 0.0],
        [0.0, 1.0, t, 0.0, t],
        [0.0, -t * w * w, 1.0 - t * two_zw, -t * w * w, 0.0],
        [0.0, 0.0, 0.0, 1.0 - t / link.velocity_error_time_s, 0.0],
        [0.0, 0.0, 0.0, 0.0, 1.0 - t / PUSH_TIME_S],
    ]
    error, push = link.velocity_error_m_s, PUSH_M_S2
    noise = [
        0.0, 0.0, 0.0,
        2.0 * t * error * error / link.velocity_error_time_s, 2.0 * t * push * push / PUSH_TIME_S,
    ]  # fmt: skip
    measures: Matrix = [[1.0, 0.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 1.0, 0.0]]
    variances = (link.position_noise_m**2, VELOCITY_NOISE_M_S**2)
    p: Matrix = [[1e-2 if i == j else 0.0 for j in range(5)] for i in range(5)]
    gains: list[tuple[float, float]] = []
    for _ in range(PERIODS):
        p = _product(_product(step, p), zip(*step, strict=True))
        for i in range(5):
            p[i][i] += noise[i]
        to = _product(p, zip(*measures, strict=True))  # covariance of the states with the measurements
        (s00, s01), (_, s11) = _product(measures, to)
        s00, s11 = s00 + variances[0], s11 + variances[1]
        det = s00 * s11 - s01 * s01
        gains = [((a * s11 - b * s01) / det, (b * s00 - a * s01) / det) for a, b in to]
        p = [[p[i][j] - gains[i][0] * to[j][0] - gains[i][1] * to[j][1] for j in range(5)] for i in range(5)]
    return Gains._make(zip(*gains, strict=True))


def _product(a: Matrix, b: Iterable[Sequence[float]]) -> Matrix:
    """Return the product of two matrices."""
    columns = list(zip(*b, strict=True))
    return [[sum(x * y for x, y in zip(row, column, strict=True)) for column in columns] for row in a]


class OwnEstimator:
    """Estimator of the vehicle state. Call ``step`` in each tick, and ``to_send`` for each set-point."""

    memory: OwnMemory
    gains: Gains  # gains of the Kalman filter
    # model of an axis: period of a tick, s; w^2, 1/s^2; 2 zeta w, 1/s; fractions of e and f left after a tick
    model: Model
    period_s: float  # period of a tick, s
    by_loop: bool  # whether the model of the velocity loop is used
    delay_s: float  # delay of the reported state, s
    push_1_s: float  # ratio of the acceleration f to the steady velocity change that it causes, 1/s
    rate_1_s: float  # bandwidth r with which e is estimated without the model of the loop, 1/s
    most_m_s: float  # upper limit of the estimated velocity error, m/s
    ahead: int  # number of ticks from the measurement time of the newest sample to now
    gap_max: int  # maximum number of predicted ticks between two samples

    def __init__(self, link: OwnStateLink, loop: VelocityLoop, period_s: float, *, by_loop: bool) -> None:
        self.memory, self.by_loop = OwnMemory(), by_loop
        self.gains = steady_gains(loop, link, period_s) if link.learns and by_loop else NO_GAINS
        self.period_s, self.delay_s = period_s, link.delay_s
        drag_1_s = 2.0 * loop.damping * loop.rate_xy_1_s
        fades = 1.0 - period_s / link.velocity_error_time_s
        self.model = (period_s, loop.rate_xy_1_s**2, drag_1_s, fades, 1.0 - period_s / PUSH_TIME_S)
        self.push_1_s = loop.rate_xy_1_s / (2.0 * loop.damping)
        self.rate_1_s, self.most_m_s = 1.0 / link.velocity_error_time_s, link.velocity_error_max_m_s
        self.ahead = max(1, round(link.delay_s / period_s))
        self.gap_max = round(GAP_MAX_S / period_s)

    def step(self, own: OwnState) -> OwnState:
        """Return the current vehicle state, estimated from the newest received one."""
        memory, (_, second, third, fourth) = self.memory, self.memory.pending
        memory.pending = (second, third, fourth, memory.sent_m_s)
        elapsed_s = own.source_time_s - memory.time_s
        if not 0.0 <= elapsed_s <= GAP_MAX_S:  # elapsed_s is NaN before the first sample
            self._begin(own)
        elif elapsed_s > 0.0:
            memory.time_s = own.source_time_s
            self._learn(own, elapsed_s)
        x, y, model = memory.x, memory.y, self.model
        if self.by_loop:
            for k in range(self.ahead):
                ux, uy, _ = self._acting(k)
                x, y = moved(x, ux, model), moved(y, uy, model)
        else:
            x, y = straight_on(x, self.delay_s), straight_on(y, self.delay_s)
        memory.x_now, memory.y_now = x, y
        z_m, z_m_s = memory.z_m, own.velocity_enu_m_s[2] - memory.z_error_m_s
        position_enu_m = (x[0], y[0], z_m + self.delay_s * z_m_s)
        return OwnState(own.arrival_s, own.source_time_s, position_enu_m, (x[1], y[1], z_m_s), own.yaw_rad)

    def to_send(self, velocity_m_s: Vec3, most_m_s: Vec3) -> Vec3:
        """Return the set-point to send: the wanted velocity plus the estimated error of the reported one."""
        memory, (x, y, z), (mx, my, mz) = self.memory, velocity_m_s, most_m_s
        ex, ey, ez = memory.x_now[3], memory.y_now[3], memory.z_error_m_s
        memory.sent_m_s = (clip(x + ex, -mx, mx), clip(y + ey, -my, my), clip(z + ez, -mz, mz))
        return memory.sent_m_s

    def forget(self) -> None:
        """Restart with the next sample, because the vehicle followed unknown set-points."""
        self.memory.time_s = math.nan

    def _acting(self, k: int) -> Vec3:
        """Return the set-point that acts k ticks after the newest sample, or the oldest stored one."""
        return self.memory.pending[max(0, KNOWN - self.ahead + k)]

    def _begin(self, own: OwnState) -> None:
        (px, py, pz), (vx, vy, _) = own.position_enu_m, own.velocity_enu_m_s
        memory = self.memory
        memory.time_s, memory.z_m, memory.z_error_m_s = own.source_time_s, pz, 0.0
        memory.x, memory.y = (px, vx, 0.0, 0.0, 0.0), (py, vy, 0.0, 0.0, 0.0)
        reported = (vx, vy, 0.0)
        memory.pending = (reported, reported, reported, reported)

    def _learn(self, own: OwnState, elapsed_s: float) -> None:
        (px, py, pz), (vx, vy, vz), memory = own.position_enu_m, own.velocity_enu_m_s, self.memory
        rate_1_s, most_m_s = self.rate_1_s, self.most_m_s
        if self.by_loop:
            ux, uy, _ = self._acting(-1)
            ticks = min(self.gap_max, max(1, round(elapsed_s / self.period_s)))
            model, gains = self.model, self.gains
            memory.x = learned(memory.x, ux, ticks, model, px, vx, gains, most_m_s)
            memory.y = learned(memory.y, uy, ticks, model, py, vy, gains, most_m_s)
        else:
            memory.x = drifted_apart(memory.x, px, vx, elapsed_s, rate_1_s, most_m_s)
            memory.y = drifted_apart(memory.y, py, vy, elapsed_s, rate_1_s, most_m_s)
        z = (memory.z_m, 0.0, 0.0, memory.z_error_m_s, 0.0)
        memory.z_m, _, _, memory.z_error_m_s, _ = drifted_apart(z, pz, vz, elapsed_s, rate_1_s, most_m_s)


def moved(axis: AxisState, u_m_s: float, model: Model) -> AxisState:
    """Return the state of an axis after one tick with this set-point."""
    (p, v, a, e, f), (t, rate_2_s2, drag_1_s, fades, push_fades) = axis, model
    return (
        p + t * v,
        v + t * (a + f),
        a + t * (rate_2_s2 * (u_m_s - v - e) - drag_1_s * a),
        fades * e,
        push_fades * f,
    )


def learned(
    axis: AxisState, u_m_s: float, ticks: int, model: Model, p_m: float, v_m_s: float, gains: Gains,
    most_m_s: float,
) -> AxisState:  # fmt: skip
    """Advance the state of an axis by ``ticks``, then correct it with a reported position and velocity."""
    for _ in range(ticks):
        axis = moved(axis, u_m_s, model)
    (p, v, a, e, f), ((kp, kv, ka, ke, kf), (lp, lv, la, le, lf)) = axis, gains
    i, j = p_m - p, v_m_s - v - e
    e = clip(e + ke * i + le * j, -most_m_s, most_m_s)
    return (p + kp * i + lp * j, v + kv * i + lv * j, a + ka * i + la * j, e, f + kf * i + lf * j)


def straight_on(axis: AxisState, t_s: float) -> AxisState:
    """Return the state of an axis after a time at constant velocity."""
    p, v, a, e, f = axis
    return p + t_s * v, v, a, e, f


def drifted_apart(
    axis: AxisState, p_m: float, v_m_s: float, elapsed_s: float, rate_1_s: float, most_m_s: float
) -> AxisState:
    """Return the state of an axis after ``elapsed_s``; p and e are corrected without the loop's model."""
    q = axis[0] + (v_m_s - axis[3]) * elapsed_s
    missed = p_m - q
    e = clip(axis[3] - rate_1_s * rate_1_s * elapsed_s * missed, -most_m_s, most_m_s)
    return (q + min(1.0, 2.0 * rate_1_s * elapsed_s) * missed, v_m_s - e, 0.0, e, 0.0)

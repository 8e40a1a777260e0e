"""Kalman filter that estimates the target's position, velocity and acceleration from delayed samples.

Each axis is a triple integrator driven by white jerk. A sample measures position and velocity at its stamp,
and the filter predicts the state from this time to now. x and y have equal noise. Each lost sample increases
the uncertainty; a late sample counts for the time of its measurement.

The horizontal velocity turns at the measured yaw rate (coordinated turn), and the remaining acceleration
decays (R. A. Singer, Estimating Optimal Tracking Filter Performance for Manned Maneuvering Targets, IEEE
Transactions on Aerospace and Electronic Systems 6(4), 1970). The vertical acceleration does not decay: a ship
heaves for seconds. The covariances of x and y are equal, so a turn does not change them. While innovations
are larger than expected, the jerk on x and y is raised. docs/how_it_works/robust_filter.md, *Targets that
turn, brake, reverse and heave*, gives the reasons.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from flightstack.core.memory import Covariance, MotionMemory
from flightstack.core.numeric import rare, wrapped
from flightstack.core.parameters.robust import TargetLink
from flightstack.core.types import ZERO, Vec3

RESTART_S = 1.0  # gap between samples after which the filter restarts, s

TURN_TIME_S = 0.3  # time constant of the yaw rate's low-pass, s: the difference of two measured yaws is noisy
TURN_RATE_MAX_RAD_S = 3.0  # limit of the yaw rate, rad/s; a TurtleBot3 reaches 2.84 (ROBOTIS, specifications)
INNOVATION_TIME_S = 0.15  # time constant of the mean normalised innovation squared, s: three samples at 20 Hz
TURN_MAX_RAD = 0.5  # upper limit of a turn, rad; below it the series in ``_moved`` are exact to 1e-5


class TargetMotion(NamedTuple):
    """Estimate of the target's motion at one time."""

    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    position_sigma_m: float  # standard deviation of x, which equals that of y, m
    position_sigma_z_m: float
    velocity_sigma_m_s: float


# time, s; effect of an acceleration on position, s^2, and on velocity, s; remaining part of the acceleration
_Time = tuple[float, float, float, float]
_NOW: _Time = (0.0, 0.0, 0.0, 1.0)


class _Noise(NamedTuple):
    """Squared noise parameters of one axis."""

    position2: float
    velocity2: float
    jerk2: float
    acceleration2: float


class TargetEstimator:
    """Kalman filter of the target; ``memory`` is its complete state."""

    memory: MotionMemory
    growth2_max: float
    noise_xy: _Noise
    noise_z: _Noise
    _fade_s: float
    _turns: bool

    def __init__(self, link: TargetLink) -> None:
        self.memory = MotionMemory()
        self.growth2_max = link.jerk_growth_max**2
        self._fade_s, self._turns = link.acceleration_time_s, link.turns_with_yaw
        position2, velocity2 = link.position_noise_m**2, link.velocity_noise_m_s**2
        self.noise_xy = _Noise(
            position2, velocity2, link.jerk_xy_m_s3_sqrthz**2, link.acceleration_xy_m_s2**2
        )
        self.noise_z = _Noise(position2, velocity2, link.jerk_z_m_s3_sqrthz**2, link.acceleration_z_m_s2**2)

    def update(
        self, time_s: float, position_enu_m: Vec3, velocity_enu_m_s: Vec3, yaw_rad: float = math.nan,
        position_sigma_m: float = 0.0, velocity_sigma_m_s: float = 0.0,
    ) -> None:  # fmt: skip
        """Update the filter with a sample; restart it if the sample is not newer, or after a long gap."""
        memory, xy, z = self.memory, self.noise_xy, self.noise_z
        dt_s, before_rad = time_s - memory.time_s, memory.yaw_rad
        memory.time_s = time_s
        if math.isfinite(yaw_rad):
            memory.yaw_rad = yaw_rad
        else:
            self._lose_yaw()
        if position_sigma_m > 0.0 or velocity_sigma_m_s > 0.0:
            xy = self._noise_at_least(position_sigma_m, velocity_sigma_m_s)
        if not 0.0 < dt_s <= RESTART_S:  # dt_s is NaN for the first sample
            self._begin(xy, position_enu_m, velocity_enu_m_s)
            return
        if self._turns:
            turned_rad_s = 0.0
            if before_rad is not None and memory.yaw_rad is not None:
                turned_rad_s = turn_rate(before_rad, memory.yaw_rad, dt_s)
            memory.turn_rate_rad_s += dt_s / (dt_s + TURN_TIME_S) * (turned_rad_s - memory.turn_rate_rad_s)
        fades, lasts = fading(dt_s, self._fade_s), lasting(dt_s)
        (p, q, r), (u, v, w), (a, b, c) = self._moved(fades, lasts)
        memory.covariance_xy, gains_xy, weights = _correct(
            _propagate(memory.covariance_xy, fades, self._jerk2_xy()), xy.position2, xy.velocity2
        )
        memory.covariance_z, gains_z, _ = _correct(
            _propagate(memory.covariance_z, lasts, z.jerk2), z.position2, z.velocity2
        )
        ax = _corrected(gains_xy, p, u, a, position_enu_m[0], velocity_enu_m_s[0])
        ay = _corrected(gains_xy, q, v, b, position_enu_m[1], velocity_enu_m_s[1])
        az = _corrected(gains_z, r, w, c, position_enu_m[2], velocity_enu_m_s[2])
        memory.position_enu_m, memory.velocity_enu_m_s = (ax[0], ay[0], az[0]), (ax[1], ay[1], az[1])
        memory.acceleration_enu_m_s2 = (ax[2], ay[2], az[2])
        # mean of four normalised squared innovations: position and velocity on x and on y
        now2 = 0.25 * (weights[0] * (ax[3] + ay[3]) + weights[1] * (ax[4] + ay[4]))
        memory.innovation2 += dt_s / (dt_s + INNOVATION_TIME_S) * (now2 - memory.innovation2)

    @rare
    def _lose_yaw(self) -> None:
        self.memory.yaw_rad = None

    @rare
    def _noise_at_least(self, position_sigma_m: float, velocity_sigma_m_s: float) -> _Noise:
        """Return the noise of x and y: the configured one, but at least the reported standard deviations."""
        xy = self.noise_xy
        return xy._replace(
            position2=max(xy.position2, position_sigma_m**2),
            velocity2=max(xy.velocity2, velocity_sigma_m_s**2),
        )

    @rare
    def _begin(self, xy: _Noise, position_enu_m: Vec3, velocity_enu_m_s: Vec3) -> None:
        memory = self.memory
        memory.position_enu_m, memory.velocity_enu_m_s = position_enu_m, velocity_enu_m_s
        memory.acceleration_enu_m_s2, memory.turn_rate_rad_s, memory.innovation2 = ZERO, 0.0, 1.0
        memory.covariance_xy, memory.covariance_z = _start(xy), _start(self.noise_z)

    def _jerk2_xy(self) -> float:
        """Return the squared jerk on x and y; the jerk is multiplied by the square of ``innovation2``.

        The factor is at least 1 and at most ``jerk_growth_max``. Noise alone rarely causes a factor of 4.
        """
        mean2 = self.memory.innovation2
        return self.noise_xy.jerk2 * max(1.0, min(self.growth2_max, mean2 * mean2 * mean2 * mean2))

    def _moved(self, fading: _Time, lasting: _Time) -> tuple[Vec3, Vec3, Vec3]:
        """Return position, velocity and acceleration after a time: x and y turn, their acceleration decays.

        With the turn R(s) in the time s, v(s) = R(s) (v + a * to_velocity(s)); the acceleration a turns, too.
        The effect of a on the position turns by two thirds of the angle, the weighted mean. Sines and cosines
        are series, because the means sin x / x and (1 - cos x) / x over the turn x are also needed at x = 0.
        """
        memory, (t, p, v, left), (_, p_z, v_z, left_z) = self.memory, fading, lasting
        (x, y, z), (vx, vy, vz) = memory.position_enu_m, memory.velocity_enu_m_s
        ax, ay, az = memory.acceleration_enu_m_s2
        turned = max(-TURN_MAX_RAD, min(TURN_MAX_RAD, memory.turn_rate_rad_s * t))
        turned2 = turned * turned
        along = 1.0 - turned2 / 6.0 * (1.0 - turned2 / 20.0)
        across = turned * (0.5 - turned2 / 24.0 * (1.0 - turned2 / 30.0))
        cos, sin = 1.0 - turned * across, turned * along
        part = turned * (2.0 / 3.0)
        part2 = part * part
        p_cos, p_sin = 1.0 - 0.5 * part2 * (1.0 - part2 / 12.0), part * (1.0 - part2 / 6.0)
        ux, uy = vx + v * ax, vy + v * ay
        return (
            (
                x + t * (along * vx - across * vy) + p * (p_cos * ax - p_sin * ay),
                y + t * (along * vy + across * vx) + p * (p_cos * ay + p_sin * ax),
                z + t * vz + p_z * az,
            ),
            (cos * ux - sin * uy, cos * uy + sin * ux, vz + v_z * az),
            (left * (cos * ax - sin * ay), left * (cos * ay + sin * ax), left_z * az),
        )

    def at(self, time_s: float) -> TargetMotion:
        """Predict the newest estimate to another time, on the sender's clock."""
        memory = self.memory
        dt_s = time_s - memory.time_s
        if math.isnan(dt_s):
            raise ValueError("no target sample yet: there is no motion to carry on")
        fades, lasts = fading(dt_s, self._fade_s), lasting(dt_s)
        position, velocity, _ = self._moved(fades, lasts)
        if dt_s < 0.0:  # an earlier time has the uncertainty of the newest estimate
            fades = lasts = _NOW
        xy = _propagate(memory.covariance_xy, fades, self._jerk2_xy())
        z = _propagate(memory.covariance_z, lasts, self.noise_z.jerk2)
        return TargetMotion(position, velocity, math.sqrt(xy[0]), math.sqrt(z[0]), math.sqrt(xy[3]))


def fading(dt_s: float, fade_s: float) -> _Time:
    """Return the effect of a decaying acceleration over a time; ``fade_s``: time constant of the decay."""
    share = dt_s / fade_s
    gone = -math.expm1(-share)
    to_velocity_s = fade_s * gone
    if abs(share) < 0.01:  # the difference below would lose digits; the series is exact to 1e-10
        bent = 0.5 - share / 6.0 * (1.0 - share / 4.0 * (1.0 - share / 5.0))
        return (dt_s, dt_s * dt_s * bent, to_velocity_s, 1.0 - gone)
    return (dt_s, fade_s * (dt_s - to_velocity_s), to_velocity_s, 1.0 - gone)


def turn_rate(before_rad: float, after_rad: float, dt_s: float) -> float:
    """Return the turn rate between two measured yaws, rad/s."""
    rate_rad_s = wrapped(after_rad - before_rad) / dt_s
    return max(-TURN_RATE_MAX_RAD_S, min(TURN_RATE_MAX_RAD_S, rate_rad_s))


def lasting(dt_s: float) -> _Time:
    """Return the effect of a constant acceleration over a time."""
    return (dt_s, 0.5 * dt_s * dt_s, dt_s, 1.0)


def _start(noise: _Noise) -> Covariance:
    return (noise.position2, 0.0, 0.0, noise.velocity2, 0.0, noise.acceleration2)


def _propagate(covariance: Covariance, time: _Time, jerk2: float) -> Covariance:
    """Return the propagated covariance; white jerk adds noise without decay, which is conservative."""
    pp, pv, pa, vv, va, aa = covariance
    t, p, v, left = time
    t2 = t * t
    q = jerk2 * t
    return (
        pp + 2.0 * (t * pv + p * pa + t * p * va) + t2 * vv + p * p * aa + q * t2 * t2 / 20.0,
        pv + v * pa + t * vv + (t * v + p) * va + p * v * aa + q * t * t2 / 8.0,
        left * (pa + t * va + p * aa) + q * t2 / 6.0,
        vv + 2.0 * v * va + v * v * aa + q * t2 / 3.0,
        left * (va + v * aa) + q * t / 2.0,
        left * left * aa + q,
    )


_Gains = tuple[float, float, float, float, float, float]  # gains of p, v, a for innovations of p, then of v


def _correct(
    covariance: Covariance, position2: float, velocity2: float
) -> tuple[Covariance, _Gains, tuple[float, float]]:
    """Return gains and covariance for a measured position and velocity with independent noise."""
    pp, pv, pa, vv, va, aa = covariance
    s = 1.0 / (pp + position2)
    kp, kv, ka = pp * s, pv * s, pa * s
    pp, pv, pa, vv, va, aa = (
        pp - kp * pp, pv - kp * pv, pa - kp * pa, vv - kv * pv, va - kv * pa, aa - ka * pa,
    )  # fmt: skip
    t = 1.0 / (vv + velocity2)
    lp, lv, la = pv * t, vv * t, va * t
    corrected = (
        pp - lp * pv, pv - lp * vv, pa - lp * va, vv - lv * vv, va - lv * va, aa - la * va,
    )  # fmt: skip
    return corrected, (kp, kv, ka, lp, lv, la), (s, t)


def _corrected(
    gains: _Gains, p: float, v: float, a: float, measured_p: float, measured_v: float
) -> tuple[float, float, float, float, float]:
    """Return corrected position, velocity and acceleration of one axis, and the squared innovations."""
    kp, kv, ka, lp, lv, la = gains
    missed_p = measured_p - p
    p, v, a = p + kp * missed_p, v + kv * missed_p, a + ka * missed_p
    missed_v = measured_v - v
    return p + lp * missed_v, v + lv * missed_v, a + la * missed_v, missed_p * missed_p, missed_v * missed_v

"""Where the target is now, how fast and with what acceleration: a Kalman filter over its late samples.

Each axis is a triple integrator driven by white jerk; samples measure position and velocity at their own
stamp, and the state is carried from there to now. x and y have the same noise. Lost samples make the
uncertainty grow, late ones are taken at the time they were measured.

A wheeled robot's acceleration turns with it: in a bend its direction changes all the time and its amount does
not. So the horizontal acceleration turns at the yaw rate that the samples tell, and the jerk is only what is
left. Turning makes no acceleration longer: of a robot that slides, or a wrong yaw rate, no more than the
direction is believed. The covariances of x and y are equal, so turning leaves them as they are.

While the samples miss by more than expected, the jerk on x and y is raised, up to a factor: a robot that
brakes is followed at once, and one that drives on is known better than by any one jerk.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from flightstack.memory import Covariance, MotionMemory
from flightstack.robust_config import TargetLink
from flightstack.types import ZERO, Vec3

RESTART_S = 1.0  # s between two samples; checks.target_age_max_s is no longer, so the target was lost before

TURN_TIME_S = 0.3  # low-pass of the yaw rate: differences of two measured yaws are noisy
SURPRISE_TIME_S = 0.15  # low-pass of the squared misses; three samples at 20 Hz
TURN_MAX_RAD = 0.5  # in one step; so far the series of _turned are exact to 1e-5


class TargetMotion(NamedTuple):
    """Estimate at one time."""

    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    acceleration_enu_m_s2: Vec3
    position_sigma_m: float  # standard deviation of x and of y
    position_sigma_z_m: float
    velocity_sigma_m_s: float


class _Noise(NamedTuple):
    """Squares of what the filter assumes of one axis."""

    position2: float
    velocity2: float
    jerk2: float
    acceleration2: float


class TargetEstimator:
    """The filter; ``memory`` is all of its state.

    Args:
        link: noise of samples and target.
    """

    def __init__(self, link: TargetLink) -> None:
        self.memory = MotionMemory()
        self._growth2_max = link.jerk_growth_max**2
        position2, velocity2 = link.position_noise_m**2, link.velocity_noise_m_s**2
        self._xy = _Noise(position2, velocity2, link.jerk_xy_m_s3_sqrthz**2, link.acceleration_xy_m_s2**2)
        self._z = _Noise(position2, velocity2, link.jerk_z_m_s3_sqrthz**2, link.acceleration_z_m_s2**2)

    def update(
        self, time_s: float, position_enu_m: Vec3, velocity_enu_m_s: Vec3, yaw_rate_rad_s: float = 0.0
    ) -> None:
        """Take a sample; one that is older than the last, or follows a long gap, starts anew.

        Args:
            time_s: stamp of the measurement, on the sender's clock.
            position_enu_m: measured.
            velocity_enu_m_s: measured.
            yaw_rate_rad_s: measured; 0 if unknown or not finite.
        """
        memory = self.memory
        dt_s = time_s - memory.time_s
        turn_rate_rad_s = yaw_rate_rad_s if math.isfinite(yaw_rate_rad_s) else 0.0
        memory.time_s = time_s
        if not 0.0 < dt_s <= RESTART_S:  # also the very first, where it is NaN
            memory.position_enu_m, memory.velocity_enu_m_s = position_enu_m, velocity_enu_m_s
            memory.acceleration_enu_m_s2, memory.turn_rate_rad_s, memory.surprise = ZERO, turn_rate_rad_s, 1.0
            memory.covariance_xy, memory.covariance_z = _start(self._xy), _start(self._z)
            return
        memory.turn_rate_rad_s += dt_s / (dt_s + TURN_TIME_S) * (turn_rate_rad_s - memory.turn_rate_rad_s)
        position, velocity, acceleration = _carried(memory, dt_s)
        memory.covariance_xy, gains_xy, weights = _correct(
            _propagate(memory.covariance_xy, dt_s, self._jerk2_xy()), self._xy
        )
        memory.covariance_z, gains_z, _ = _correct(
            _propagate(memory.covariance_z, dt_s, self._z.jerk2), self._z
        )
        (p, q, r), (u, v, w), (a, b, c) = position, velocity, acceleration
        x = _corrected(gains_xy, p, u, a, position_enu_m[0], velocity_enu_m_s[0])
        y = _corrected(gains_xy, q, v, b, position_enu_m[1], velocity_enu_m_s[1])
        z = _corrected(gains_z, r, w, c, position_enu_m[2], velocity_enu_m_s[2])
        memory.position_enu_m, memory.velocity_enu_m_s = (x[0], y[0], z[0]), (x[1], y[1], z[1])
        memory.acceleration_enu_m_s2 = (x[2], y[2], z[2])
        # the mean of four: position and velocity on x and on y, each 1 on average
        missed = 0.25 * (weights[0] * (x[3] + y[3]) + weights[1] * (x[4] + y[4]))
        memory.surprise += dt_s / (dt_s + SURPRISE_TIME_S) * (missed - memory.surprise)

    def _jerk2_xy(self) -> float:
        """Square of the jerk on x and y, now: the jerk goes with the square of the surprise.

        A surprise of 2, which chance seldom makes, is four times the jerk already.
        """
        surprise = self.memory.surprise
        return self._xy.jerk2 * max(1.0, min(self._growth2_max, surprise * surprise * surprise * surprise))

    def at(self, time_s: float) -> TargetMotion:
        """Carry the newest estimate to another time, on the sender's clock.

        Raises:
            ValueError: there has been no sample.
        """
        memory = self.memory
        dt_s = time_s - memory.time_s
        if math.isnan(dt_s):
            raise ValueError("no target sample yet: there is no motion to carry on")
        ahead_s = max(0.0, dt_s)
        jerk2_xy = self._jerk2_xy()
        return TargetMotion(
            *_carried(memory, dt_s),
            math.sqrt(_position_variance(memory.covariance_xy, ahead_s, jerk2_xy)),
            math.sqrt(_position_variance(memory.covariance_z, ahead_s, self._z.jerk2)),
            math.sqrt(_velocity_variance(memory.covariance_xy, ahead_s, jerk2_xy)),
        )


def _carried(memory: MotionMemory, dt_s: float) -> tuple[Vec3, Vec3, Vec3]:
    """Position, velocity and acceleration ``dt_s`` later, with an acceleration that turns."""
    (x, y, z), (vx, vy, vz), (ax, ay, az) = (
        memory.position_enu_m, memory.velocity_enu_m_s, memory.acceleration_enu_m_s2,
    )  # fmt: skip
    t, half = dt_s, 0.5 * dt_s * dt_s
    turned = max(-TURN_MAX_RAD, min(TURN_MAX_RAD, memory.turn_rate_rad_s * dt_s))
    cos, sin, v_along, v_across, p_along, p_across = _turned(turned)
    return (
        (
            x + t * vx + t * t * (p_along * ax - p_across * ay),
            y + t * vy + t * t * (p_along * ay + p_across * ax),
            z + t * vz + half * az,
        ),
        (
            vx + t * (v_along * ax - v_across * ay),
            vy + t * (v_along * ay + v_across * ax),
            vz + t * az,
        ),
        (cos * ax - sin * ay, cos * ay + sin * ax, az),
    )


def _turned(angle_rad: float) -> tuple[float, float, float, float, float, float]:
    """Parts along and across of a vector that has turned, of its mean, and of the mean of that over the time.

    Series, since they are needed at zero, and the same on every machine: sin x / x, (1 - cos x) / x and
    (1 - cos x) / x^2, (x - sin x) / x^2.
    """
    x2 = angle_rad * angle_rad
    v_along = 1.0 - x2 / 6.0 * (1.0 - x2 / 20.0)
    p_along = 0.5 - x2 / 24.0 * (1.0 - x2 / 30.0)
    v_across = angle_rad * p_along
    p_across = angle_rad / 6.0 * (1.0 - x2 / 20.0 * (1.0 - x2 / 42.0))
    return 1.0 - angle_rad * v_across, angle_rad * v_along, v_along, v_across, p_along, p_across


def _propagate(covariance: Covariance, dt_s: float, jerk2: float) -> Covariance:
    """Covariance of a triple integrator driven by white jerk of density ``jerk2``, ``dt_s`` later."""
    pp, pv, pa, vv, va, aa = covariance
    t = dt_s
    t2 = t * t
    half = 0.5 * t2
    q = jerk2 * t
    return (
        pp + 2.0 * t * pv + t2 * (pa + vv) + t * t2 * va + half * half * aa + q * t2 * t2 / 20.0,
        pv + t * (vv + pa) + 1.5 * t2 * va + half * t * aa + q * t * t2 / 8.0,
        pa + t * va + half * aa + q * t2 / 6.0,
        vv + 2.0 * t * va + t2 * aa + q * t2 / 3.0,
        va + t * aa + q * t / 2.0,
        aa + q,
    )


def _position_variance(covariance: Covariance, dt_s: float, jerk2: float) -> float:
    """First number of ``_propagate``."""
    pp, pv, pa, vv, va, aa = covariance
    t2 = dt_s * dt_s
    return (
        pp + 2.0 * dt_s * pv + t2 * (pa + vv) + dt_s * t2 * va + 0.25 * t2 * t2 * aa
        + jerk2 * dt_s * t2 * t2 / 20.0
    )  # fmt: skip


def _velocity_variance(covariance: Covariance, dt_s: float, jerk2: float) -> float:
    """Fourth number of ``_propagate``."""
    _, _, _, vv, va, aa = covariance
    t2 = dt_s * dt_s
    return vv + 2.0 * dt_s * va + t2 * aa + jerk2 * dt_s * t2 / 3.0


def _start(noise: _Noise) -> Covariance:
    return (noise.position2, 0.0, 0.0, noise.velocity2, 0.0, noise.acceleration2)


_Gains = tuple[float, float, float, float, float, float]  # of position, then of velocity: p, v, a each


def _correct(covariance: Covariance, noise: _Noise) -> tuple[Covariance, _Gains, tuple[float, float]]:
    """Position and velocity are measured with independent noise: one scalar update after the other.

    Returns:
        Covariance, gains, and one over the variance by which position and velocity are expected to miss.
    """
    pp, pv, pa, vv, va, aa = covariance
    s = 1.0 / (pp + noise.position2)
    kp, kv, ka = pp * s, pv * s, pa * s
    pp, pv, pa, vv, va, aa = (
        pp - kp * pp, pv - kp * pv, pa - kp * pa, vv - kv * pv, va - kv * pa, aa - ka * pa,
    )  # fmt: skip
    t = 1.0 / (vv + noise.velocity2)
    lp, lv, la = pv * t, vv * t, va * t
    corrected = (
        pp - lp * pv, pv - lp * vv, pa - lp * va, vv - lv * vv, va - lv * va, aa - la * va,
    )  # fmt: skip
    return corrected, (kp, kv, ka, lp, lv, la), (s, t)


def _corrected(
    gains: _Gains, p: float, v: float, a: float, measured_p: float, measured_v: float
) -> tuple[float, float, float, float, float]:
    """Position, velocity and acceleration of one axis by what was measured, and the squares of the misses."""
    kp, kv, ka, lp, lv, la = gains
    missed_p = measured_p - p
    p, v, a = p + kp * missed_p, v + kv * missed_p, a + ka * missed_p
    missed_v = measured_v - v
    return p + lp * missed_v, v + lv * missed_v, a + la * missed_v, missed_p * missed_p, missed_v * missed_v

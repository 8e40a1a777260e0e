"""Where the target is now, how fast and with what acceleration: a Kalman filter over its late samples.

Each axis is a triple integrator driven by white jerk; samples measure position and velocity at their own
stamp, and the state is carried from there to now. The axes are independent; x and y have the same noise. Lost
samples make the uncertainty grow, late ones are taken at the time they were measured.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from flightstack.memory import Covariance, MotionMemory
from flightstack.robust_config import TargetLink
from flightstack.types import ZERO, Vec3

RESTART_S = 1.0  # s between two samples beyond which the old motion says nothing about the new


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
        position2, velocity2 = link.position_noise_m**2, link.velocity_noise_m_s**2
        self._xy = _Noise(position2, velocity2, link.jerk_xy_m_s3_sqrthz**2, link.acceleration_xy_m_s2**2)
        self._z = _Noise(position2, velocity2, link.jerk_z_m_s3_sqrthz**2, link.acceleration_z_m_s2**2)

    def update(self, time_s: float, position_enu_m: Vec3, velocity_enu_m_s: Vec3) -> None:
        """Take a sample; one that is older than the last, or follows a long gap, starts anew.

        Args:
            time_s: stamp of the measurement, on the sender's clock.
            position_enu_m: measured.
            velocity_enu_m_s: measured.
        """
        memory = self.memory
        dt_s = time_s - memory.time_s
        memory.time_s = time_s
        if not 0.0 < dt_s <= RESTART_S:  # also the very first, where it is NaN
            memory.position_enu_m, memory.velocity_enu_m_s = position_enu_m, velocity_enu_m_s
            memory.acceleration_enu_m_s2 = ZERO
            memory.covariance_xy, memory.covariance_z = _start(self._xy), _start(self._z)
            return
        memory.covariance_xy, gains_xy = _correct(
            _propagate(memory.covariance_xy, dt_s, self._xy.jerk2), self._xy
        )
        memory.covariance_z, gains_z = _correct(_propagate(memory.covariance_z, dt_s, self._z.jerk2), self._z)
        x, y, z = (
            _move(dt_s, gains, *old)
            for gains, *old in zip(
                (gains_xy, gains_xy, gains_z),
                memory.position_enu_m,
                memory.velocity_enu_m_s,
                memory.acceleration_enu_m_s2,
                position_enu_m,
                velocity_enu_m_s,
                strict=True,
            )
        )
        memory.position_enu_m, memory.velocity_enu_m_s = (x[0], y[0], z[0]), (x[1], y[1], z[1])
        memory.acceleration_enu_m_s2 = (x[2], y[2], z[2])

    def at(self, time_s: float) -> TargetMotion:
        """Carry the newest estimate to another time, on the sender's clock.

        Raises:
            ValueError: there has been no sample.
        """
        memory = self.memory
        dt_s = time_s - memory.time_s
        if math.isnan(dt_s):
            raise ValueError("no target sample yet: there is no motion to carry on")
        half = 0.5 * dt_s * dt_s
        (x, y, z), (vx, vy, vz), (ax, ay, az) = (
            memory.position_enu_m, memory.velocity_enu_m_s, memory.acceleration_enu_m_s2,
        )  # fmt: skip
        ahead_s = max(0.0, dt_s)
        pp, _, _, vv, _, _ = _propagate(memory.covariance_xy, ahead_s, self._xy.jerk2)
        return TargetMotion(
            (x + dt_s * vx + half * ax, y + dt_s * vy + half * ay, z + dt_s * vz + half * az),
            (vx + dt_s * ax, vy + dt_s * ay, vz + dt_s * az),
            memory.acceleration_enu_m_s2,
            math.sqrt(pp),
            math.sqrt(_position_variance(memory.covariance_z, ahead_s, self._z.jerk2)),
            math.sqrt(vv),
        )


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


def _start(noise: _Noise) -> Covariance:
    return (noise.position2, 0.0, 0.0, noise.velocity2, 0.0, noise.acceleration2)


_Gains = tuple[float, float, float, float, float, float]  # of position, then of velocity: p, v, a each


def _correct(covariance: Covariance, noise: _Noise) -> tuple[Covariance, _Gains]:
    """Position and velocity are measured with independent noise: one scalar update after the other."""
    pp, pv, pa, vv, va, aa = covariance
    s = 1.0 / (pp + noise.position2)
    kp, kv, ka = pp * s, pv * s, pa * s
    pp, pv, pa, vv, va, aa = (
        pp - kp * pp, pv - kp * pv, pa - kp * pa, vv - kv * pv, va - kv * pa, aa - ka * pa,
    )  # fmt: skip
    s = 1.0 / (vv + noise.velocity2)
    lp, lv, la = pv * s, vv * s, va * s
    corrected = (
        pp - lp * pv, pv - lp * vv, pa - lp * va, vv - lv * vv, va - lv * va, aa - la * va,
    )  # fmt: skip
    return corrected, (kp, kv, ka, lp, lv, la)


def _move(
    dt_s: float, gains: _Gains, p: float, v: float, a: float, measured_p: float, measured_v: float
) -> tuple[float, float, float]:
    """Position, velocity and acceleration of one axis, carried on and corrected."""
    kp, kv, ka, lp, lv, la = gains
    p, v = p + dt_s * v + 0.5 * dt_s * dt_s * a, v + dt_s * a
    missed = measured_p - p
    p, v, a = p + kp * missed, v + kv * missed, a + ka * missed
    missed = measured_v - v
    return p + lp * missed, v + lv * missed, a + la * missed

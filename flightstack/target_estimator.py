"""Where the target is now, how fast and with what acceleration: a Kalman filter over its late samples.

Each axis is a triple integrator driven by white jerk; samples measure position and velocity at their own
stamp, and the state is carried from there to now. All axes have the same noise, so they share a covariance.
Lost samples make the uncertainty grow, late ones are taken at the time they were measured.
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
    position_sigma_m: float  # standard deviation on each axis
    velocity_sigma_m_s: float


class TargetEstimator:
    """The filter; ``memory`` is all of its state.

    Args:
        link: noise of samples and target.
    """

    def __init__(self, link: TargetLink) -> None:
        self.memory = MotionMemory()
        self._position2 = link.position_noise_m**2
        self._velocity2 = link.velocity_noise_m_s**2
        self._jerk2 = link.jerk_m_s3_sqrthz**2
        self._acceleration2 = link.acceleration_m_s2**2

    def update(self, time_s: float, position_enu_m: Vec3, velocity_enu_m_s: Vec3) -> None:
        """Take a sample; one that is older than the last, or follows a long gap, starts anew.

        Args:
            time_s: stamp of the measurement, on the sender's clock.
            position_enu_m: measured.
            velocity_enu_m_s: measured.
        """
        memory, r_p, r_v = self.memory, self._position2, self._velocity2
        dt_s = time_s - memory.time_s
        memory.time_s = time_s
        if not 0.0 < dt_s <= RESTART_S:  # also the very first, where it is NaN
            memory.position_enu_m, memory.velocity_enu_m_s = position_enu_m, velocity_enu_m_s
            memory.acceleration_enu_m_s2 = ZERO
            memory.covariance = (r_p, 0.0, 0.0, r_v, 0.0, self._acceleration2)
            return
        pp, pv, pa, vv, va, aa = _propagate(memory.covariance, dt_s, self._jerk2)
        # Position and velocity are measured with independent noise: one scalar update after the other.
        s = 1.0 / (pp + r_p)
        kp, kv, ka = pp * s, pv * s, pa * s
        pp, pv, pa, vv, va, aa = (
            pp - kp * pp, pv - kp * pv, pa - kp * pa, vv - kv * pv, va - kv * pa, aa - ka * pa,
        )  # fmt: skip
        s = 1.0 / (vv + r_v)
        lp, lv, la = pv * s, vv * s, va * s
        memory.covariance = (
            pp - lp * pv, pv - lp * vv, pa - lp * va, vv - lv * vv, va - lv * va, aa - la * va,
        )  # fmt: skip
        half = 0.5 * dt_s * dt_s
        moved = []
        for x, v, a, z_p, z_v in zip(
            memory.position_enu_m,
            memory.velocity_enu_m_s,
            memory.acceleration_enu_m_s2,
            position_enu_m,
            velocity_enu_m_s,
            strict=True,
        ):
            x_, v_ = x + dt_s * v + half * a, v + dt_s * a
            missed = z_p - x_
            x_, v_, a_ = x_ + kp * missed, v_ + kv * missed, a + ka * missed
            missed = z_v - v_
            moved.append((x_ + lp * missed, v_ + lv * missed, a_ + la * missed))
        (x0, v0, a0), (x1, v1, a1), (x2, v2, a2) = moved
        memory.position_enu_m, memory.velocity_enu_m_s = (x0, x1, x2), (v0, v1, v2)
        memory.acceleration_enu_m_s2 = (a0, a1, a2)

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
        pp, _, _, vv, _, _ = _propagate(memory.covariance, max(0.0, dt_s), self._jerk2)
        return TargetMotion(
            (x + dt_s * vx + half * ax, y + dt_s * vy + half * ay, z + dt_s * vz + half * az),
            (vx + dt_s * ax, vy + dt_s * ay, vz + dt_s * az),
            memory.acceleration_enu_m_s2,
            math.sqrt(pp),
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

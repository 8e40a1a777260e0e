"""Corrections that make MuJoCo's Euler step of the vehicle's rotation second order."""

from __future__ import annotations

import math

from sim.compiled.jit import jitted
from sim.compiled.records import F64
from sim.plant.params import STEP_S


@jitted
def gyroscopic(inertia: F64, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Angular velocity cross angular momentum, body frame."""
    jx, jy, jz = inertia[0], inertia[1], inertia[2]
    return ((jz - jy) * y * z, (jx - jz) * z * x, (jy - jx) * x * y)


@jitted
def midpoint_torque(
    inertia: F64, rates: F64, torque: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Return the torque with which MuJoCo's step equals the implicit midpoint rule with ``torque``."""
    half = 0.5 * STEP_S
    gx, gy, gz = before = gyroscopic(inertia, rates[0], rates[1], rates[2])
    for _ in range(3):  # each gains a factor of rate times half a step, 0.01 at most
        x = rates[0] + half * (torque[0] - gx) / inertia[0]
        y = rates[1] + half * (torque[1] - gy) / inertia[1]
        z = rates[2] + half * (torque[2] - gz) / inertia[2]
        gx, gy, gz = gyroscopic(inertia, x, y, z)
    return (torque[0] + before[0] - gx, torque[1] + before[1] - gy, torque[2] + before[2] - gz)


@jitted
def turn_back(q: F64, x: float, y: float, z: float) -> None:
    """Turn the vehicle's attitude in ``qpos`` back by a small rotation vector in the body frame."""
    x, y, z = -0.5 * x, -0.5 * y, -0.5 * z
    a, b, c, d = q[3], q[4], q[5], q[6]
    w, i = a - b * x - c * y - d * z, b + a * x + c * z - d * y
    j, k = c + a * y + d * x - b * z, d + a * z + b * y - c * x
    scale = 1.0 / math.sqrt(w * w + i * i + j * j + k * k)
    q[3], q[4], q[5], q[6] = w * scale, i * scale, j * scale, k * scale

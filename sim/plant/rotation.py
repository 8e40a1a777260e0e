"""Rotations as unit quaternions (w, x, y, z) and as body axes in the world (nine numbers)."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64

Nine = tuple[float, float, float, float, float, float, float, float, float]


@jitted
def rotation_axes(quaternion: Sequence[float] | F64) -> Nine:
    """Return the body's x, y and z axis in the world (columns of the rotation matrix), nine numbers."""
    w, x, y, z = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    return (
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
        2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
        2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y),
    )  # fmt: skip


@jitted
def nine(axes: F64) -> Nine:
    """Return an array of nine numbers as a tuple."""
    return (axes[0], axes[1], axes[2], axes[3], axes[4], axes[5], axes[6], axes[7], axes[8])


def quaternion_from_axes(axes: tuple[float, ...]) -> tuple[float, float, float, float]:
    """Return the quaternion (w, x, y, z), w >= 0, of the rotation with these body axes in the world."""
    out = np.zeros(4)
    mujoco.mju_mat2Quat(out, np.array(axes).reshape(3, 3).T.ravel())
    w, x, y, z = (out if out[0] >= 0.0 else -out).tolist()
    return (w, x, y, z)

"""Estimated and true states of the simulated vehicle, and rotations: unit quaternions and body axes.

A quaternion is (w, x, y, z); body axes in the world are nine numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64
from flightstack.core.types import Vec3
from logs.schema.rows import TrueStateRow

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


class Body(NamedTuple):
    """True motion of the vehicle; the position is that of the centre of mass."""

    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    quaternion: tuple[float, float, float, float]  # attitude (w, x, y, z) of body FLU in world ENU
    angular_velocity_flu_rad_s: Vec3


class Estimate(NamedTuple):
    """State that the simulated on-board estimator reports."""

    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    quaternion: tuple[float, float, float, float]  # attitude (w, x, y, z) of body FLU in world ENU
    angular_velocity_flu_rad_s: Vec3
    valid: bool


TRUTH = 41  # number of values of a true state: time, s, then the fields of ``TrueStateRow`` after ``tick``


def truth_row(values: Sequence[float], stamp_ns: int, tick: int = 0) -> TrueStateRow:
    """Return the row of the log with these ``TRUTH`` values."""
    found = truth_of(values)
    contacts, running = int(found.contacts), found.motors_running != 0.0
    return found._replace(stamp_ns=stamp_ns, tick=tick, contacts=contacts, motors_running=running)


def truth_of(row: Any) -> TrueStateRow:
    """Return the state with these ``TRUTH`` values and tick 0; values that are arrays give arrays."""
    return TrueStateRow(
        row[0], 0, row[1:4], row[4:7], row[7:11], row[11:14], row[14:18], row[18:21], row[21:24], row[24],
        row[25], row[26], row[27], row[28], row[29:32], row[32:35], row[35], row[36], row[37], row[38:],
    )  # fmt: skip

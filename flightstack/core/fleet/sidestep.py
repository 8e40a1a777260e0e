"""Side-step to the right of an approaching vehicle, since two vehicles that meet head-on would block."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from flightstack.core.types import Vec3

_LEAST_M = 1e-6


class Near(NamedTuple):
    """A vehicle in reach."""

    h_m: float  # value of the barrier
    gradient: Vec3  # gradient by this vehicle's position
    away_m: Vec3  # this vehicle minus the other one, ENU
    velocity_enu_m_s: Vec3  # velocity of the other one


def sidestep(nominal: Vec3, near: Sequence[Near], rate_1_s: float) -> Vec3:
    """Nominal velocity with a part to the right of each vehicle that it closes in on.

    The part grows to the closing speed from where the row begins to bind to where nothing is left.
    """
    x, y, z = nominal
    for h_m, (gx, gy, gz), (ax, ay, _), (vx, vy, vz) in near:
        closing_m_s = -(gx * (nominal[0] - vx) + gy * (nominal[1] - vy) + gz * (nominal[2] - vz))
        if closing_m_s <= 0.0 or rate_1_s * h_m >= closing_m_s:
            continue
        d_m = math.hypot(ax, ay)
        ahead = (-ax / d_m, -ay / d_m) if d_m > _LEAST_M else (1.0, 0.0)
        part_m_s = min(closing_m_s - rate_1_s * h_m, closing_m_s)
        x, y = x + part_m_s * ahead[1], y - part_m_s * ahead[0]
    return (x, y, z)

"""Bounds of the velocity over the pad, for waiting or giving way without loss of height over the boundary.

A lone vehicle flies inwards, where the boundary falls. A vehicle that gives way may fly outwards or past the
middle, where the boundary may rise faster than the vehicle can climb.
"""

from __future__ import annotations

from typing import NamedTuple

from flightstack.core.fleet.exact import Row
from flightstack.core.safety.position_loop import clip
from flightstack.core.types import Vec3

INWARD_RATE_1_S = 2.5  # always allowed horizontal velocity per distance from the pad's middle
OUTWARD_PART = 0.5  # share of the landing barrier's rate for horizontal velocities that lower h


class Cone(NamedTuple):
    """Bounds of the velocity over the pad."""

    rate_1_s: float  # rate at which h may be used up
    slope_max: float  # steepest slope of the boundary
    lag_s: float  # delay of a climb
    period_s: float  # period of a tick

    def outward(self, h_m: float, gradient: Vec3, before_m_s: Vec3, target_m_s: Vec3) -> Row:
        """Row that lets a velocity out of the cone grow no faster than the climb that holds h can follow.

        Flying inwards may always end.
        """
        gx, gy, _ = gradient
        used_m_s = self.period_s * self.rate_1_s * max(0.0, h_m) / self.lag_s
        with_target = gx * target_m_s[0] + gy * target_m_s[1]
        inward_m_s = gx * before_m_s[0] + gy * before_m_s[1] - with_target
        return Row((gx, gy, 0.0), with_target + min(0.0, inward_m_s) - OUTWARD_PART * used_m_s)

    def box(
        self, d_m: float, h_m: float, nominal: Vec3, target_m_s: Vec3, lower: Vec3, upper: Vec3
    ) -> tuple[Vec3, Vec3]:
        """Box in which making way neither makes the vehicle sink faster nor takes it fast past the middle.

        Beyond the middle a velocity inwards is one outwards. A climb may always end. It sinks no faster than
        h alone allows: a flight inwards, where the boundary falls, may be turned round by a neighbour sooner
        than the climb follows.
        """
        most = INWARD_RATE_1_S * d_m + OUTWARD_PART * max(0.0, h_m) / (self.slope_max * self.lag_s)
        (tx, ty, tz), (lx, ly, lz), (ux, uy, uz) = target_m_s, lower, upper
        least_z_m_s = min(tz, max(nominal[2], tz - self.rate_1_s * max(0.0, h_m)))
        return (
            (
                clip(tx - most, lx, ux),
                clip(ty - most, ly, uy),
                clip(least_z_m_s, lz, uz),
            ),
            (clip(tx + most, lx, ux), clip(ty + most, ly, uy), uz),
        )

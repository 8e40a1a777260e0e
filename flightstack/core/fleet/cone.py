"""How a vehicle that waits over its pad, or makes way there, moves without losing height over the boundary.

A lone vehicle flies inwards, where the boundary falls. One that makes way may fly outwards or past the
middle, where the boundary rises faster than its climb can follow.
"""

from __future__ import annotations

from typing import NamedTuple

from flightstack.core.fleet.exact import Row
from flightstack.core.safety.position_loop import clip
from flightstack.core.types import Vec3

INWARD_RATE_1_S = 2.5  # times the distance from the pad's middle: horizontal velocity that is always allowed
OUTWARD_PART = 0.5  # of what the landing barrier's rate allows, for velocities that lower h sideways


class Cone(NamedTuple):
    """Bounds of the velocity over the pad.

    Attributes:
        rate_1_s: at which h may be used up.
        slope_max: of the boundary, without unit.
        lag_s: by which a climb comes late.
        period_s: of a tick.
    """

    rate_1_s: float
    slope_max: float
    lag_s: float
    period_s: float

    def outward(self, h_m: float, gradient: Vec3, before_m_s: Vec3, target_m_s: Vec3) -> Row:
        """Row that lets a velocity out of the cone grow no faster than the climb that holds h can follow.

        Flying inwards may always end.

        Args:
            h_m: value of the active landing barrier.
            gradient: of it by the vehicle's position.
            before_m_s: velocity wanted in the last tick, ENU.
            target_m_s: velocity of the target, ENU.
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

        Args:
            d_m: horizontal distance from the pad's middle.
            h_m: value of the active landing barrier.
            nominal: velocity wanted, ENU, m/s.
            target_m_s: velocity of the target, ENU.
            lower: lower corner of the box of this tick, m/s.
            upper: upper corner, m/s.
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

"""The landing barrier with a margin, which the robust filter enforces to keep the barrier itself.

    h_r(e) = h(e) - m (1 - exp(-(d / w)^2))

The margin m fades within the radius w around the landing spot, or the vehicle would hover over the pad for
ever. The rule chooses m such that the faded margin is still sufficient at the pad's edge.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from flightstack.core.numeric import numeric
from flightstack.core.safety.barrier import Barrier
from flightstack.core.types import Vec3


@numeric
class RobustBarrier(NamedTuple):
    """Barrier with a margin; has the interface of a barrier that gate and filter use."""

    barrier: Barrier
    margin_m: float
    fade_radius_m: float

    @property
    def slope_max(self) -> float:
        """Bound of the boundary's slope: the barrier's steepest plus the margin's, at w / sqrt(2)."""
        return self.barrier.slope_max + self.margin_m / self.fade_radius_m * math.sqrt(2.0 / math.e)

    def linearisation_bound_m(self, e_m: Vec3, moved_m: float) -> float:
        """Most that h may lie below its linear prediction; as ``Barrier.linearisation_bound_m``.

        The margin bends by 2 m / w^2 exp(-(d/w)^2) at most, most of all where the motion comes nearest.
        """
        d_m = math.sqrt(e_m[0] * e_m[0] + e_m[1] * e_m[1])
        near = max(0.0, d_m - moved_m) / self.fade_radius_m
        share = moved_m / self.fade_radius_m
        bend_m = self.margin_m * share * share * math.exp(-near * near)
        return self.barrier.linearisation_bound_m(e_m, moved_m) + bend_m

    def h(self, e_m: Vec3) -> float:
        """Value in metres at the relative position ``e_m``."""
        x = (e_m[0] * e_m[0] + e_m[1] * e_m[1]) / (self.fade_radius_m * self.fade_radius_m)
        return self.barrier.h(e_m) - self.margin_m * (1.0 - math.exp(-x))

    def evaluate(self, e_m: Vec3, target_velocity_enu_m_s: Vec3) -> tuple[float, Vec3, float]:
        """Value, gradient by the vehicle's position, time derivative; as ``Barrier.evaluate``."""
        h, (gx, gy, _), _ = self.barrier.evaluate(e_m, target_velocity_enu_m_s)
        w2 = self.fade_radius_m * self.fade_radius_m
        decay = math.exp(-(e_m[0] * e_m[0] + e_m[1] * e_m[1]) / w2)
        slope = 2.0 * self.margin_m / w2 * decay
        gx, gy = gx - slope * e_m[0], gy - slope * e_m[1]
        vx, vy, vz = target_velocity_enu_m_s
        return h - self.margin_m * (1.0 - decay), (gx, gy, 1.0), -(gx * vx + gy * vy + vz)

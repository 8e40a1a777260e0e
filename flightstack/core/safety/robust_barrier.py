"""Landing barrier with a margin; the robust filter enforces it to keep the barrier without the margin.

    h_r(e) = h(e) - m (1 - exp(-(d / w)^2))

The margin m fades within the radius w around the landing spot; otherwise the vehicle would hover over the pad
for ever. m is chosen such that the faded margin is still sufficient at the pad's edge.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from flightstack.core.numeric import numeric
from flightstack.core.safety.barrier import Barrier
from flightstack.core.types import Vec3


@numeric
class RobustBarrier(NamedTuple):
    """Barrier with a margin, with the interface that gate and filter use."""

    barrier: Barrier
    margin_m: float
    fade_radius_m: float

    @property
    def slope_max(self) -> float:
        """Bound of the boundary's slope: the steepest slope of the barrier plus that of the margin."""
        return self.barrier.slope_max + self.margin_m / self.fade_radius_m * math.sqrt(2.0 / math.e)

    def linearisation_bound_m(self, e_m: Vec3, moved_m: float) -> float:
        """Return how far h may fall below its linear prediction; see ``Barrier.linearisation_bound_m``.

        The curvature of the margin is at most 2 m / w^2 exp(-(d/w)^2), at the nearest point of the motion.
        """
        d_m = math.sqrt(e_m[0] * e_m[0] + e_m[1] * e_m[1])
        near = max(0.0, d_m - moved_m) / self.fade_radius_m
        share = moved_m / self.fade_radius_m
        bend_m = self.margin_m * share * share * math.exp(-near * near)
        return self.barrier.linearisation_bound_m(e_m, moved_m) + bend_m

    def h(self, e_m: Vec3) -> float:
        """Return the value in metres at the relative position ``e_m``."""
        x = (e_m[0] * e_m[0] + e_m[1] * e_m[1]) / (self.fade_radius_m * self.fade_radius_m)
        return self.barrier.h(e_m) - self.margin_m * (1.0 - math.exp(-x))

    def evaluate(self, e_m: Vec3, target_velocity_enu_m_s: Vec3) -> tuple[float, Vec3, float]:
        """Return value, gradient and time derivative, as ``Barrier.evaluate`` does."""
        h, (gx, gy, _), _ = self.barrier.evaluate(e_m, target_velocity_enu_m_s)
        w2 = self.fade_radius_m * self.fade_radius_m
        decay = math.exp(-(e_m[0] * e_m[0] + e_m[1] * e_m[1]) / w2)
        slope = 2.0 * self.margin_m / w2 * decay
        gx, gy = gx - slope * e_m[0], gy - slope * e_m[1]
        vx, vy, vz = target_velocity_enu_m_s
        return h - self.margin_m * (1.0 - decay), (gx, gy, 1.0), -(gx * vx + gy * vy + vz)

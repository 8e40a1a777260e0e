"""Your own boundary: a truncated cone over the pad. The filter returns the nearest admissible velocity.

    flightstack sitl --scenario paper_moving_1 --lockstep --filter examples.own_boundary:ConeFilter
    flightstack campaign paper_moving_1 --runs 20 --filter examples.own_boundary:ConeFilter

``filter = "examples.own_boundary:ConeFilter"`` in a configuration selects it. Python looks for the module
among the installed modules first, then in the working folder. ``flightstack/core/strategies/strategy.py``
describes each method.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import flightstack as fs
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.safety.barrier import Barrier
from flightstack.core.snapshot import Relative
from flightstack.core.types import Vec3
from flightstack.verify.ends import any_filter, reaches_touchdown
from flightstack.verify.types import Check


@dataclass(frozen=True)
class Cone:
    """h(e) = e_z - min(slope d, height), d: horizontal distance; a cone truncated at the barrier's peak."""

    slope: float
    height_m: float

    def h(self, e_m: Vec3) -> float:
        """Return h at the relative position ``e_m``, m."""
        return e_m[2] - min(self.slope * math.hypot(e_m[0], e_m[1]), self.height_m)

    def evaluate(self, e_m: Vec3, target_velocity_enu_m_s: Vec3) -> tuple[float, Vec3, float]:
        """Return h, its gradient with respect to the vehicle's position, and dh/dt.

        On the axis the gradient points up.
        """
        d = math.hypot(e_m[0], e_m[1])
        slope = self.slope if 0.0 < self.slope * d < self.height_m else 0.0
        gx, gy = (-slope * e_m[0] / d, -slope * e_m[1] / d) if slope else (0.0, 0.0)
        vx, vy, vz = target_velocity_enu_m_s
        return self.h(e_m), (gx, gy, 1.0), -(gx * vx + gy * vy + vz)

    def linearisation_bound_m(self, e_m: Vec3, moved_m: float) -> float:
        """Return how far h may fall below its linear prediction in a horizontal motion of s = ``moved_m``, m.

        With d, the distance from the axis, this is at most slope * s^2 / (2 d) if s < 2 d, else
        slope * 2 (s - d). On the axis, where the gradient points up, it is slope * s.
        """
        d = math.hypot(e_m[0], e_m[1])
        if d == 0.0:
            return self.slope * moved_m
        return self.slope * (moved_m * moved_m / (2.0 * d) if moved_m < 2.0 * d else 2.0 * (moved_m - d))


class ConeFilter(fs.Filter):
    """Safety filter with the cone as boundary.

    The nominal velocity is that of a position loop with feed-forward of the target's velocity.
    """

    certificate = f"{__name__}:certificate"
    waits_filtered = False

    def __init__(self, config: FlightConfig, barrier: Barrier) -> None:
        super().__init__(config, barrier)
        self._config, self._cone = config, Cone(barrier.slope_max, barrier.peak_height_m)

    def barrier(self, at: Relative) -> Cone:
        """Return the cone; its shape does not change during the flight."""
        return self._cone

    def may_touch(self, at: Relative) -> bool:
        """Whether the vehicle is low, over the pad and above the cone."""
        touchdown = self._config.touchdown
        low = at.e_m[2] < touchdown.height_m and at.d_m <= touchdown.pad_radius_m
        return low and self._cone.h(at.e_m) >= 0.0


def certificate(config: FlightConfig) -> list[Check]:
    """Return the claims that must be proven before a flight; `flightstack check` prints them."""
    vx, vy, vz = config.limits.velocity_max_m_s
    speed_m_s, slope = config.touchdown.target_speed_max_m_s, config.barrier.slope_max
    return [
        Check(
            "cone",
            "some velocity in the box keeps the vehicle above a cone that comes nearer",
            vz + slope * (min(vx, vy) - speed_m_s),
            "m/s",
            f"slope {slope:.3g}, a target of {speed_m_s:g} m/s",
            "raise limits.velocity_max_m_s, or lower alpha * beta or touchdown.target_speed_max_m_s",
        ),
        reaches_touchdown(config),
        *any_filter(config, config.touchdown.descent_m_s, "touchdown.descent_m_s"),
    ]

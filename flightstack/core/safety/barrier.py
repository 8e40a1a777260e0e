"""Landing barrier function h, its gradient and its time derivative (paper eq. 5, 7, 9, 10), and its margin.

    h(e) = e_z - b(d),   b(d) = beta * alpha * d * exp(-alpha * d)

``e`` is the vehicle's position minus the landing spot, ``d`` its horizontal length. Safe states have h >= 0.

At the apex, d = 0, the gradient has no direction. The slope is multiplied by the smoothing factor ``d /
sqrt(d^2 + smoothing^2)``, which only shortens the gradient. Therefore, for d below a few ``smoothing``, the
filter uses a smaller slope than that of b(d); h itself is never smoothed. See docs/how_it_works/method.md.

The geometry gives the shape (eq. 7): the boundary peaks at ``d* = 1/alpha``, ``e* = beta/exp(1)`` high.

The robust filter enforces a barrier with a margin m for errors, so that the barrier h itself holds:

    h_r(e) = h(e) - m (1 - exp(-(d / w)^2))

The margin m fades within the radius w around the landing spot; otherwise the vehicle would hover over the pad
without end. m is chosen such that the faded margin is still sufficient at the pad's edge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Annotated, Any, NamedTuple, Protocol

from flightstack.common.strict_toml import ConfigError, from_table, span
from flightstack.core.numeric import numeric
from flightstack.core.types import ZERO, Vec3

E = math.e
_BEND_MOST = math.exp(-3.0)  # maximum of (x - 2) exp(-x), which is at x = 3


class ActiveBarrier(Protocol):
    """Barrier function that a filter enforces; positions are vehicle minus landing spot, ENU, m."""

    def h(self, e_m: Vec3) -> float:
        """Return the value at a relative position, m."""

    def linearisation_bound_m(self, e_m: Vec3, moved_m: float) -> float:
        """Return the largest error of h predicted linearly over a horizontal motion of ``moved_m``, m."""

    def evaluate(self, e_m: Vec3, target_velocity_enu_m_s: Vec3) -> tuple[float, Vec3, float]:
        """Return value, gradient with respect to the vehicle's position, and time derivative."""


def problem_of(boundary: Any, e_m: Vec3) -> str:
    """Evaluate a user's barrier at one position; return the text of an error, or an empty text."""
    name = type(boundary).__name__
    try:
        h_m, (gx, gy, gz), dh_dt_m_s = boundary.evaluate(e_m, ZERO)
        numbers = (h_m, gx, gy, gz, dh_dt_m_s, boundary.h(e_m), boundary.linearisation_bound_m(e_m, 0.01))
        return "" if math.isfinite(sum(numbers)) else f"{name} gives no finite numbers at {e_m}: {numbers}"
    except Exception as error:  # the user's code can raise any exception
        return f"{name} raised {type(error).__name__}: {error}"


@dataclass(frozen=True, slots=True)
class Peak:
    """Highest ring of the boundary, which a configuration can contain instead of alpha and beta (eq. 7)."""

    peak_height_m: Annotated[float, span(0.05, 7.0)]  # height of the ring; beta is e times this height
    peak_distance_m: Annotated[float, span(0.05, 20.0)] | None = None  # radius of the ring
    # angle at the landing spot between the vertical and the ring, instead of the radius
    cone_half_angle_rad: Annotated[float, span(0.05, 1.5)] | None = None

    def __post_init__(self) -> None:
        if (self.peak_distance_m is None) == (self.cone_half_angle_rad is None):
            raise ConfigError("give peak_height_m with either peak_distance_m or cone_half_angle_rad")
        if not 0.05 <= self.distance_m <= 20.0:
            raise ConfigError(
                f"cone_half_angle_rad: found {self.cone_half_angle_rad:g}; with this height the peak is "
                f"{self.distance_m:.3g} m from the landing spot, allowed are 0.05 to 20"
            )

    @property
    def distance_m(self) -> float:
        """Radius of the ring, m."""
        if self.peak_distance_m is not None:
            return self.peak_distance_m
        return self.peak_height_m * math.tan(self.cone_half_angle_rad or 0.0)

    @property
    def numbers(self) -> dict[str, float]:
        """Alpha and beta of the boundary."""
        return {"alpha_1_m": 1.0 / self.distance_m, "beta_m": E * self.peak_height_m}


@dataclass(frozen=True, slots=True)
class Barrier:
    """Landing barrier: the table [barrier] of a configuration, in which a ``Peak`` is also allowed."""

    # inverse of the peak's horizontal distance from the landing spot
    alpha_1_m: Annotated[float, span(0.05, 20.0)]
    beta_m: Annotated[float, span(0.05, 20.0)]  # Euler's number times the height of the peak
    omega_1_s: Annotated[float, span(0.01, 20.0)] = 0.7  # paper filter: maximum decay rate of h
    # radius around the landing spot within which the gradient fades to vertical
    apex_smoothing_m: Annotated[float, span(0.001, 0.02)] = 0.005

    @staticmethod
    def other_keys(table: dict[str, Any]) -> None:
        """Replace the keys of a ``Peak`` by alpha and beta. Raises ConfigError: the table has both."""
        given = {each.name: table.pop(each.name) for each in fields(Peak) if each.name in table}
        if not given:
            return
        numbers = from_table(Peak, given).numbers
        if both := table.keys() & numbers:
            values = ", ".join(f"{name} = {value:.4g}" for name, value in numbers.items())
            raise ConfigError(
                f"found {', '.join((*given, *sorted(both)))} (a base file may give some of them); "
                f"give either the peak or alpha_1_m and beta_m; this peak is {values}"
            )
        table |= numbers

    @property
    def peak_height_m(self) -> float:
        """Height of the boundary's highest ring, m."""
        return self.beta_m / E

    @property
    def peak_distance_m(self) -> float:
        """Radius of the boundary's highest ring, m."""
        return 1.0 / self.alpha_1_m

    @property
    def slope_max(self) -> float:
        """Steepest slope of the boundary, at its apex."""
        return self.alpha_1_m * self.beta_m

    def height(self, d_m: float) -> float:
        """Return the boundary height b(d) in metres at horizontal distance ``d_m`` (eq. 5)."""
        return boundary_height(self.alpha_1_m, self.beta_m, d_m)

    def slope(self, d_m: float) -> float:
        """Return the slope b'(d) of the boundary at horizontal distance ``d_m``."""
        ad = self.alpha_1_m * d_m
        return self.beta_m * self.alpha_1_m * (1.0 - ad) * math.exp(-ad)

    def h(self, e_m: Vec3) -> float:
        """Return the barrier value in metres at the relative position ``e_m`` (eq. 9)."""
        return barrier_h(self.alpha_1_m, self.beta_m, e_m)

    def linearisation_bound_m(self, e_m: Vec3, moved_m: float) -> float:
        """Return how far h can fall below its linear prediction in a horizontal motion from ``e_m``, m.

        docs/how_it_works/robust_filter.md, *The tolerance of the gate*, derives the bound.

        Args:
            e_m: relative position at which the motion starts.
            moved_m: horizontal length of the motion, in any direction.
        """
        d2 = e_m[0] * e_m[0] + e_m[1] * e_m[1]
        d, r = math.sqrt(d2), math.sqrt(d2 + self.apex_smoothing_m * self.apex_smoothing_m)
        gap = r - d
        if moved_m <= gap:
            turned = moved_m * gap / r  # worst case: a motion straight outwards
        elif moved_m < r + d:
            turned = (gap * gap + moved_m * moved_m) / (2.0 * r)
        else:
            # worst case: the motion crosses the vertical axis through the pad's centre
            turned = moved_m * (1.0 + d / r) - 2.0 * d
        bend_1_m = self.alpha_1_m * self.alpha_1_m * self.beta_m * _BEND_MOST
        return abs(self.slope(d)) * turned + 0.5 * bend_1_m * moved_m * moved_m

    def evaluate(self, e_m: Vec3, target_velocity_enu_m_s: Vec3) -> tuple[float, Vec3, float]:
        """Return barrier value, gradient with respect to the vehicle's position, time derivative (eq. 9, 10).

        Returns:
            ``(h_m, gradient, dh_dt_m_s)``. The barrier moves with the target, so the time derivative is minus
            the gradient times the target's velocity, including heave (the paper sets heave to zero).
        """
        ex, ey, ez = e_m
        d2 = ex * ex + ey * ey
        d = math.sqrt(d2)
        ad = self.alpha_1_m * d
        decay = self.beta_m * self.alpha_1_m * math.exp(-ad)
        # decay * (1 - ad) is b'(d); e divided by the smoothed length is a direction that is 0 at d = 0
        factor = -decay * (1.0 - ad) / math.sqrt(d2 + self.apex_smoothing_m * self.apex_smoothing_m)
        gx, gy = factor * ex, factor * ey
        vx, vy, vz = target_velocity_enu_m_s
        return ez - decay * d, (gx, gy, 1.0), -(gx * vx + gy * vy + vz)


def boundary_height(alpha_1_m: float, beta_m: float, d_m: float) -> float:
    """Return the boundary height; ``Barrier.height`` without an object."""
    ad = alpha_1_m * d_m
    return beta_m * ad * math.exp(-ad)


def barrier_h(alpha_1_m: float, beta_m: float, e_m: Vec3) -> float:
    """Return the barrier value; ``Barrier.h`` without an object."""
    return e_m[2] - boundary_height(alpha_1_m, beta_m, math.sqrt(e_m[0] * e_m[0] + e_m[1] * e_m[1]))


@numeric
class RobustBarrier(NamedTuple):
    """Barrier with a margin; gate and filter use it like ``Barrier``."""

    barrier: Barrier
    margin_m: float  # margin m at a large distance from the landing spot, m
    fade_radius_m: float  # radius w within which the margin fades, m

    def linearisation_bound_m(self, e_m: Vec3, moved_m: float) -> float:
        """Return how far h can fall below its linear prediction, as ``Barrier.linearisation_bound_m``, m.

        The curvature of the margin is at most 2 m / w^2 exp(-(d/w)^2), with the smallest d of the motion.
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

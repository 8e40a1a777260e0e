"""The barrier between two vehicles; it grows with the uncertainty of the other vehicle's position.

    h(p) = r_xy (rho - 1),   rho = sqrt((dx^2 + dy^2) / r_xy^2 + dz^2 / r_z^2)

``p`` is this vehicle minus the other one. h is convex in p and its gradient at most 1 long where r_xy is the
smaller semi-axis: a motion never loses more of h than its linear prediction says.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from flightstack.core.parameters.fleet import CARRIED_AGES, Fleet
from flightstack.core.types import ZERO, Intent, Neighbour, Vec3

LEAST_M = 1e-6  # of the distance from the middle, where the gradient has no direction


class Estimate(NamedTuple):
    """Another vehicle as it is taken to be now.

    Attributes:
        age_s: of its word, with the error of the clock.
        position_enu_m: carried on from the stamp.
        velocity_enu_m_s: as it was told; 0 where it is carried on no more.
        grown_m: by which both semi-axes are longer.
        growth_m_s: at which they grow.
        late: its word is older than ``latency_max_s``, and did not say that it is down.
        anywhere_m: the same as ``grown_m``, with all that it can have flown since.
    """

    age_s: float
    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    grown_m: float
    growth_m_s: float
    late: bool
    anywhere_m: float


def barrier(p_m: Vec3, radius_xy_m: float, radius_z_m: float, *, first: bool = True) -> tuple[float, Vec3]:
    """Value and gradient of the barrier.

    Args:
        p_m: this vehicle minus the other one, ENU, m.
        radius_xy_m: horizontal semi-axis.
        radius_z_m: vertical semi-axis.
        first: at the same place this one goes east, or else west.

    Returns:
        ``(h_m, gradient)``, the gradient by the position of this vehicle, without unit.
    """
    x, y, z = p_m
    flat = radius_xy_m / radius_z_m
    far_m = math.sqrt(x * x + y * y + flat * flat * z * z)  # rho in metres
    if far_m < LEAST_M:
        return -radius_xy_m, (1.0 if first else -1.0, 0.0, 0.0)
    return far_m - radius_xy_m, (x / far_m, y / far_m, flat * flat * z / far_m)


def growth(age_s: float, speed_m_s: float, fleet: Fleet) -> tuple[float, float]:
    """Distance by which a vehicle may be elsewhere than carried on, and at what speed that grows.

    It speeds up away from where it is carried to, by the acceleration, up to a difference of both speeds.
    """
    most_m_s, a = max(fleet.speed_max_m_s, speed_m_s) + speed_m_s, fleet.acceleration_max_m_s2
    speeds_up_s = most_m_s / a
    if age_s < speeds_up_s:
        return 0.5 * a * age_s * age_s, a * age_s
    return most_m_s * (age_s - 0.5 * speeds_up_s), most_m_s


def estimate(word: Neighbour, now_s: float, own_sigma_m: float, fleet: Fleet) -> Estimate:
    """Where another vehicle is now, and how far it may be from there.

    One whose words are late is carried on for ``CARRIED_AGES``, about as long as an autopilot without a
    companion flies on. Where it may be grows until ``silent_flight_s``: by then its own failsafe has ended
    its flight. One that is down stands still, or rides on a pad that may have stopped since.

    Args:
        word: its newest.
        now_s: stack clock.
        own_sigma_m: standard deviation of the own position on each axis.
        fleet: of the configuration.
    """
    v, p = word.velocity_enu_m_s, word.position_enu_m
    speed_m_s = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    gone_s = max(0.0, now_s - word.stamp_s)
    age_s = gone_s + word.clock_bound_s
    base_m = speed_m_s * word.clock_bound_s + fleet.margin_m
    base_m += fleet.sigma_factor * math.hypot(own_sigma_m, word.position_sigma_m)
    flies_s = min(age_s, fleet.silent_flight_s)
    if word.intent is Intent.DOWN:
        carried_s, moves = min(gone_s, fleet.silent_flight_s), age_s <= fleet.silent_flight_s
        place = (p[0] + v[0] * carried_s, p[1] + v[1] * carried_s, p[2] + v[2] * carried_s)
        grown_m = base_m + speed_m_s * flies_s
        return Estimate(
            age_s, place, v if moves else ZERO, grown_m, speed_m_s if moves else 0.0, False, grown_m
        )
    late, carried_max_s = age_s > fleet.latency_max_s, CARRIED_AGES * fleet.age_max_s
    carried_s = min(gone_s, carried_max_s)
    place = (p[0] + v[0] * carried_s, p[1] + v[1] * carried_s, p[2] + v[2] * carried_s)
    grown_m, growth_m_s = growth(min(age_s, fleet.latency_max_s), speed_m_s, fleet)
    if not late:
        return Estimate(age_s, place, v, base_m + grown_m, growth_m_s, False, base_m + grown_m)
    anywhere_m, _ = growth(min(flies_s, carried_max_s), speed_m_s, fleet)
    anywhere_m += max(0.0, flies_s - carried_max_s) * max(fleet.speed_max_m_s, speed_m_s)
    velocity = v if gone_s < carried_max_s else ZERO
    return Estimate(age_s, place, velocity, base_m + grown_m, 0.0, True, base_m + anywhere_m)

"""Distances at which landing barrier, box and the rows of neighbours have a common feasible velocity.

h is the value of a neighbour's barrier and g its gradient. The worst row (constraint) of a neighbour is

    g . u >= |g| w + a t - rate h,

where w is the neighbour's speed and a t the growth of its ellipsoid at the largest latency; this vehicle has
the whole share, and the neighbour approaches directly. g is a unit vector whose vertical part is multiplied
by k = radius_xy / radius_z. The box is reduced to its horizontal disc, without slew limit.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from flightstack.core.parameters.fleet import Fleet
from flightstack.core.parameters.flight import FlightConfig
from flightstack.verify.bound import Cell, Shape, Span, most
from flightstack.verify.types import Check, Need


class Crowd(NamedTuple):
    """Numbers that decide whether a common feasible velocity exists."""

    steepest: float  # steepest slope of the boundary outside the pad
    climb_m_s: float  # vertical speed of the pad
    speed_m_s: float  # speed of a neighbour
    flat: float  # factor k = radius_xy / radius_z
    longest: float  # length of the longest gradient g
    growth_m_s: float  # growth of the ellipsoid in the largest latency


def crowd(config: FlightConfig, fleet: Fleet, shape: Shape, climb_m_s: float) -> Crowd:
    """Return the numbers of a configuration with a table [fleet].

    ``shape``: boundary; ``climb_m_s``: fastest climb of the pad.
    """
    slope = shape.slope(Span(config.touchdown.pad_radius_m, math.inf))
    flat, growth_m_s = fleet.radius_xy_m / fleet.radius_z_m, fleet.acceleration_max_m_s2 * fleet.latency_max_s
    steepest = max(abs(slope.low), abs(slope.high))
    return Crowd(steepest, climb_m_s, fleet.speed_max_m_s, flat, max(1.0, flat), growth_m_s)


def anywhere_m(config: FlightConfig, fleet: Fleet, c: Crowd) -> float:
    """Return the h above which the rows of any number of neighbours have a common point.

    The point is the pad's horizontal velocity with any climb, which meets the landing barrier wherever h is
    not negative.
    """
    at_most = math.hypot(config.touchdown.target_speed_max_m_s, c.flat * config.limits.velocity_max_m_s[2])
    return (c.longest * c.speed_m_s + at_most + c.growth_m_s) / fleet.rate_1_s


def begins(config: FlightConfig, fleet: Fleet, c: Crowd) -> Check:
    from_m = anywhere_m(config, fleet, c)
    return Check(
        "neighbours in reach",
        "where neighbours come into reach, the rows of any number of neighbours have a common feasible point",
        fleet.reach_m - fleet.radius_xy_m - from_m,
        "m",
        f"from h = {from_m:.3g} m on, the pad's velocity with any climb meets all rows; rows become active "
        f"at {fleet.reach_m - fleet.radius_xy_m:.3g} m",
        "raise fleet.reach_m or fleet.rate_1_s, or lower fleet.speed_max_m_s",
        Need.PROOF,
    )


def up_the_slope_m_s(config: FlightConfig, c: Crowd) -> float:
    """Return the horizontal speed that remains up the steepest slope.

    The landing barrier at h = 0 needs (speed + w_pad) slope + the pad's climb, up to the climb of the box.
    """
    vx, vy, vz = config.limits.velocity_max_m_s
    if c.steepest <= 0.0:
        return min(vx, vy)
    return min(vx, vy, (vz - c.climb_m_s) / c.steepest - config.touchdown.target_speed_max_m_s)


def one_short_m_s(config: FlightConfig, c: Crowd, aside_m_s: float, lowest: float) -> tuple[float, float]:
    """Return the largest violation of one neighbour's row at h = 0, and the elevation of its g (rad).

    ``aside_m_s``: largest horizontal speed of evasion; ``lowest``: least elevation of g; -pi / 2 is a
    neighbour directly above a vehicle that has to climb.
    """
    vz = config.limits.velocity_max_m_s[2]

    def length(angle: float) -> float:
        return math.hypot(math.cos(angle), c.flat * math.sin(angle))

    def value(at: tuple[float, ...]) -> float:
        away = aside_m_s * math.cos(at[0]) + c.flat * vz * math.sin(at[0])
        return c.speed_m_s * length(at[0]) + c.growth_m_s - away

    def upper(cell: Cell) -> float:  # each part is monotone on both sides of the horizontal plane
        low, high = cell[0]
        at = (low, high, 0.0) if low < 0.0 < high else (low, high)
        pushed, aside = max(map(length, at)), max(-aside_m_s * math.cos(each) for each in at)
        return c.speed_m_s * pushed + c.growth_m_s + aside - c.flat * vz * math.sin(low)

    worst = most(upper, value, (Span(lowest, math.pi / 2.0),), ((0.0,),))
    return worst.bound, worst.at[0]


def one(config: FlightConfig, fleet: Fleet, c: Crowd) -> Check:
    vx, vy, _ = config.limits.velocity_max_m_s
    short_m_s, elevation = one_short_m_s(config, c, up_the_slope_m_s(config, c), -math.pi / 2.0)
    open_m_s, _ = one_short_m_s(config, c, min(vx, vy), 0.0)
    return Check(
        "one neighbour",
        "if no h is negative, landing barrier, box and the row of one neighbour have a common feasible point",
        -short_m_s,
        "m/s",
        f"the neighbour approaches with {c.speed_m_s:g} m/s at a slope of {c.steepest:.3g}, "
        f"{math.degrees(-elevation):.0f} deg from above; a common point exists from h = "
        f"{max(0.0, short_m_s) / fleet.rate_1_s:.3g} m on, and without landing barrier from "
        f"{max(0.0, open_m_s) / fleet.rate_1_s:.3g} m on; below, its row is relaxed",
        "raise limits.velocity_max_m_s, or lower fleet.speed_max_m_s or the slope alpha * beta",
        Need.PROOF,
    )


def several(config: FlightConfig, fleet: Fleet, c: Crowd) -> Check:
    """Check the rows of two neighbours from opposite sides, away from the landing barrier."""
    short_m_s = c.longest * c.speed_m_s + c.growth_m_s
    return Check(
        "several neighbours",
        "if no h is negative, box and the rows of several neighbours have a common feasible point",
        -short_m_s,
        "m/s",
        f"two neighbours approach from opposite sides with {c.speed_m_s:g} m/s each; a common point exists "
        f"from h = {short_m_s / fleet.rate_1_s:.3g} m on, and for any number with the landing barrier from "
        f"{anywhere_m(config, fleet, c):.3g} m on; below, the rows of neighbours are relaxed together",
        "lower fleet.speed_max_m_s, or raise fleet.rate_1_s; no setting meets all",
        Need.PROOF,
    )

"""Share of this vehicle in the avoidance of another one: none, half, or all of it; and the side-step.

The shares of two vehicles always sum to at least 1, also with late or lost messages
(docs/how_it_works/fleet.md). The order of the rules is the proof: first the announcements of this vehicle,
then the reasons why the other one cannot give way, then the latest announcements of the other one. Two
vehicles that meet head-on would block each other: each steps aside to its right.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from flightstack.core.fleet.ellipsoid import Estimate
from flightstack.core.fleet.exact import Row
from flightstack.core.memory import Heard
from flightstack.core.parameters.fleet import HOLD_LATENCIES, ZERO_LATENCIES, Fleet
from flightstack.core.types import ZERO, Intent, Neighbour, Vec3

# members that do not give way, or have a fault
FIRM = frozenset({Intent.STANDING, Intent.COMMITTED, Intent.CLEARING, Intent.DOWN})
NONE, HALF, ALL = 0.0, 0.5, 1.0
_LEAST_M = 1e-6  # least horizontal distance with a direction, m


def share(slot: Heard, word: Neighbour, now_s: float, fleet: Fleet) -> float:
    """Share of the avoidance that this vehicle takes: none, half or all of it."""
    if slot.yields or now_s - slot.yielded_s <= HOLD_LATENCIES * fleet.latency_max_s:
        return ALL
    age_s = now_s - word.stamp_s + word.clock_bound_s
    if word.intent in FIRM or age_s > fleet.age_max_s:
        return ALL
    if slot.jumped_m != ZERO and math.hypot(*slot.jumped_m) > fleet.margin_m:
        return ALL  # its own position estimate may be wrong
    if fleet.id in word.yields_to and age_s <= ZERO_LATENCIES * fleet.latency_max_s:
        return NONE
    return HALF


def row(
    part: float,
    h_m: float,
    gradient: Vec3,
    own_wanted_m_s: Vec3,
    word: Neighbour,
    now: Estimate,
    fleet: Fleet,
) -> Row:
    """Constraint on this vehicle's velocity.

    With the whole part it goes by the other one's velocity. With half of it, it goes by the mean of both
    velocities wanted, each as it was told: where both hold theirs, the distance falls no faster than the rate
    allows. What the other one may have changed since its word counts against this vehicle.
    """
    if part == ALL:
        c = now.velocity_enu_m_s
    else:
        (x, y, z), (ox, oy, oz) = word.wanted_enu_m_s, own_wanted_m_s
        c = (0.5 * (x + ox), 0.5 * (y + oy), 0.5 * (z + oz))
    along = gradient[0] * c[0] + gradient[1] * c[1] + gradient[2] * c[2]
    return Row(gradient, along + part * (now.growth_m_s - fleet.rate_1_s * h_m))


def wider(lax: Row, outer_m: float, now: Estimate, fleet: Fleet) -> Row:
    """Constraint for a vehicle whose messages are late: it may be anywhere in a larger ellipsoid.

    While the other vehicle may fly, this vehicle stays out of the ellipsoid, or, inside it, does not approach
    its middle. After that the other vehicle lies in the ellipsoid: a vehicle outside remains outside, and one
    inside has to land, too.
    """
    bound_m_s = -fleet.rate_1_s * outer_m
    if now.age_s <= fleet.silent_flight_s:
        bound_m_s = min(0.0, bound_m_s + fleet.speed_max_m_s)
    elif outer_m < 0.0:
        return lax
    return Row(lax.g, max(lax.bound_m_s, bound_m_s))


class Near(NamedTuple):
    """A vehicle in reach."""

    h_m: float  # value of the barrier
    gradient: Vec3  # gradient by this vehicle's position
    away_m: Vec3  # this vehicle minus the other one, ENU
    velocity_enu_m_s: Vec3  # velocity of the other one


def sidestep(nominal: Vec3, near: Sequence[Near], rate_1_s: float) -> Vec3:
    """Nominal velocity plus a side-step to the right of each vehicle that it approaches.

    The side-step grows from 0, where the row begins to bind, to the closing speed, where h is 0.
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

"""Share of the avoidance of another vehicle that this vehicle takes (none, half or all), and the side-step.

The shares of two vehicles always sum to at least 1, also with late or lost messages
(docs/how_it_works/fleet.md). The order of the rules proves this: first the announcements of this vehicle,
then the reasons why the other one cannot give way, then the latest announcements of the other one. Two
vehicles that meet head-on would block each other, so each steps aside to its right.
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

# intents of members that do not give way, or have a fault
FIRM = frozenset({Intent.STANDING, Intent.COMMITTED, Intent.CLEARING, Intent.DOWN})
NONE, HALF, ALL = 0.0, 0.5, 1.0
_LEAST_M = 1e-6  # least horizontal distance that defines a direction, m


def share(slot: Heard, word: Neighbour, now_s: float, fleet: Fleet) -> float:
    """Return the share of the avoidance that this vehicle takes: none, half or all of it."""
    if slot.yields or now_s - slot.yielded_s <= HOLD_LATENCIES * fleet.latency_max_s:
        return ALL
    age_s = now_s - word.stamp_s + word.clock_bound_s
    if word.intent in FIRM or age_s > fleet.age_max_s:
        return ALL
    if slot.jumped_m != ZERO and math.hypot(*slot.jumped_m) > fleet.margin_m:
        return ALL  # the position estimate of the other vehicle may be wrong
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
    """Return the constraint on this vehicle's velocity.

    With the whole share, the constraint uses the other vehicle's velocity. With half of it, it uses the mean
    of both announced velocity commands: if both vehicles follow them, the distance falls no faster than the
    rate allows. Possible changes of the other velocity since its message tighten the constraint.
    """
    if part == ALL:
        c = now.velocity_enu_m_s
    else:
        (x, y, z), (ox, oy, oz) = word.wanted_enu_m_s, own_wanted_m_s
        c = (0.5 * (x + ox), 0.5 * (y + oy), 0.5 * (z + oz))
    along = gradient[0] * c[0] + gradient[1] * c[1] + gradient[2] * c[2]
    return Row(gradient, along + part * (now.growth_m_s - fleet.rate_1_s * h_m))


def wider(lax: Row, outer_m: float, now: Estimate, fleet: Fleet) -> Row:
    """Return the constraint for a vehicle whose messages are late: it may be anywhere in a larger ellipsoid.

    While the other vehicle may fly, this vehicle stays out of the ellipsoid or, inside it, does not approach
    its centre. After that the other vehicle lies in the ellipsoid: a vehicle outside remains outside, and one
    inside keeps only the row ``lax``, since it has to land, too.
    """
    bound_m_s = -fleet.rate_1_s * outer_m
    if now.age_s <= fleet.silent_flight_s:
        bound_m_s = min(0.0, bound_m_s + fleet.speed_max_m_s)
    elif outer_m < 0.0:
        return lax
    return Row(lax.g, max(lax.bound_m_s, bound_m_s))


class Near(NamedTuple):
    """A neighbour within reach."""

    h_m: float  # value of the barrier function between the two vehicles, m
    gradient: Vec3  # gradient of ``h_m`` with respect to this vehicle's position
    away_m: Vec3  # position of this vehicle minus that of the neighbour, ENU
    velocity_enu_m_s: Vec3  # velocity of the neighbour


def sidestep(nominal: Vec3, near: Sequence[Near], rate_1_s: float) -> Vec3:
    """Return the nominal velocity plus a side-step to the right of each vehicle that it approaches.

    The side-step grows from 0, where the row becomes active, to the closing speed at h = 0.
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

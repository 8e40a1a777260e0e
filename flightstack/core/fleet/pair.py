"""Barrier between two vehicles (``barrier``), its constraint on this vehicle (``row``), and the side-step.

    h(p) = r_xy (rho - 1),   rho = sqrt((dx^2 + dy^2) / r_xy^2 + dz^2 / r_z^2)

p = (dx, dy, dz) is the position of this vehicle minus that of the other vehicle; r_xy and r_z are the
semi-axes of the ellipsoid. h is convex in p, and its gradient has at most length 1 if r_xy is the smaller
semi-axis: a motion never reduces h more than the linear prediction. The ellipsoid grows with the uncertainty
of the other vehicle's position.

This vehicle takes a share of the avoidance: none, half or all. The shares of two vehicles always sum to at
least 1, also if messages are late or lost. docs/how_it_works/fleet.md proves this from the order of the rules
in ``share``: announcements of this vehicle, reasons why the other vehicle cannot give way, and the newest
announcements of the other vehicle. Vehicles that meet head-on each step aside to the right.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from flightstack.core.fleet.solution import Row
from flightstack.core.memory import Heard
from flightstack.core.parameters.fleet import CARRIED_AGES, HOLD_LATENCIES, ZERO_LATENCIES, Fleet
from flightstack.core.types import ZERO, Intent, MemberStatus, Vec3

LEAST_M = 1e-6  # distance from the ellipsoid's centre below which the gradient has no direction, m
# If a companion fails, the vehicle follows the last set-point until the autopilot lands the vehicle.
LEAD_S = 0.2  # lead time of a set-point, s: set-point = command + lead time * derivative of the command
SMOOTH_S = 0.03  # time constant of the low-pass filter for the velocity command's derivative, s
DRIFT_M_S, DRIFT_MAX_M = 0.35, 0.45  # silent vehicle's drift: rate, maximum (docs/design_notes/0004-fleet.md)
SINK_M_S = 0.5  # maximum sink rate of an autopilot's landing, m/s
RIDES_S = 3.0  # time for which a silent vehicle on a pad is assumed to move with the pad, s


class Estimate(NamedTuple):
    """Current estimate of the position and velocity of another vehicle."""

    age_s: float  # age of the vehicle's newest message plus the clock error, s
    # position extrapolated from the stamp, m; if messages are late: highest possible position
    position_enu_m: Vec3
    velocity_enu_m_s: Vec3  # reported or commanded velocity, m/s; 0 after the extrapolation ends
    grown_m: float  # addition to both semi-axes of the ellipsoid, m: margin, errors, motion since the message
    growth_m_s: float  # growth rate of both semi-axes of the ellipsoid, m/s
    late: bool  # whether the newest message is older than ``latency_max_s`` and does not announce DOWN
    anywhere_m: float  # addition to both semi-axes that covers every position within the vehicle's reach, m
    depth_m: float = 0.0  # largest descent below ``position_enu_m`` if the autopilot lands the vehicle, m
    sink_m_s: float = 0.0  # rate at which ``depth_m`` grows, m/s

    def beside(self, place_enu_m: Vec3) -> tuple[Vec3, Vec3]:
        """Return ``place_enu_m`` minus the vehicle's nearest possible position, and its velocity there."""
        (x, y, z), (px, py, top_m), (vx, vy, vz) = place_enu_m, self.position_enu_m, self.velocity_enu_m_s
        low_m = top_m - self.depth_m
        if z < low_m:
            return (x - px, y - py, z - low_m), (vx, vy, vz - self.sink_m_s)
        return (x - px, y - py, max(z - top_m, 0.0)), self.velocity_enu_m_s


def barrier(p_m: Vec3, radius_xy_m: float, radius_z_m: float, *, first: bool = True) -> tuple[float, Vec3]:
    """Return the value (m) and the gradient of the barrier; ``p_m``: offset from the other vehicle."""
    x, y, z = p_m
    flat = radius_xy_m / radius_z_m
    far_m = math.sqrt(x * x + y * y + flat * flat * z * z)  # rho times r_xy
    if far_m < LEAST_M:
        return -radius_xy_m, (1.0 if first else -1.0, 0.0, 0.0)
    return far_m - radius_xy_m, (x / far_m, y / far_m, flat * flat * z / far_m)


def growth(age_s: float, speed_m_s: float, fleet: Fleet) -> tuple[float, float]:
    """Return the largest distance of a vehicle from its extrapolated position, m, and its derivative, m/s.

    In the worst case the vehicle accelerates against its last velocity, up to the maximum speed.
    """
    most_m_s, a = max(fleet.speed_max_m_s, speed_m_s) + speed_m_s, fleet.acceleration_max_m_s2
    speeds_up_s = most_m_s / a
    if age_s < speeds_up_s:
        return 0.5 * a * age_s * age_s, a * age_s
    return most_m_s * (age_s - 0.5 * speeds_up_s), most_m_s


def jump(before: MemberStatus, message: MemberStatus, fleet: Fleet) -> Vec3:
    """Return the offset of a reported position from the predicted one; zero if the position is reachable.

    A reachable position differs from the predicted one at most by the sum of three parts: the effect of the
    maximum acceleration, the errors of position and clock that both messages report, and the ellipsoid's
    margin. The margin is for a landing, which stops a vehicle immediately.
    """
    gone_s = message.stamp_s - before.stamp_s
    (x, y, z), (px, py, pz), v = message.position_enu_m, before.position_enu_m, before.velocity_enu_m_s
    away = x, y, z = x - px - v[0] * gone_s, y - py - v[1] * gone_s, z - pz - v[2] * gone_s
    if abs(x) + abs(y) + abs(z) < fleet.margin_m:  # the usual case, which does not need ``growth``
        return ZERO
    speed_m_s = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    clocks_s = before.clock_bound_s + message.clock_bound_s
    allowed_m, _ = growth(gone_s + clocks_s, speed_m_s, fleet)
    allowed_m += speed_m_s * clocks_s + fleet.margin_m
    allowed_m += fleet.sigma_factor * math.hypot(before.position_sigma_m, message.position_sigma_m)
    return away if math.hypot(x, y, z) > allowed_m else ZERO


def faster(before_m_s2: Vec3, before: MemberStatus, message: MemberStatus) -> Vec3:
    """Return the derivative of another vehicle's velocity command, m/s^2, smoothed over messages."""
    t = message.stamp_s - before.stamp_s
    share = 1.0 / (t + SMOOTH_S)
    (x, y, z), (ox, oy, oz), (ax, ay, az) = message.wanted_enu_m_s, before.wanted_enu_m_s, before_m_s2
    return (ax + share * (x - ox - t * ax), ay + share * (y - oy - t * ay), az + share * (z - oz - t * az))


def estimate(
    message: MemberStatus, now_s: float, own_sigma_m: float, fleet: Fleet, faster_m_s2: Vec3 = ZERO
) -> Estimate:
    """Estimate the current position of another vehicle, and the largest error of this estimate.

    A vehicle with late messages is extrapolated for ``CARRIED_AGES`` with the last possible set-point, about
    as long as an autopilot continues without a companion. The vehicle can drift from this path and sink to
    the ground. The region of possible positions grows until ``silent_flight_s``; by then the vehicle's
    fail-safe has ended the flight. A vehicle that is down stands still, or moves with a pad that can have
    stopped since the message.
    """
    v, p = message.velocity_enu_m_s, message.position_enu_m
    speed_m_s = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    gone_s = max(0.0, now_s - message.stamp_s)
    age_s = gone_s + message.clock_bound_s
    base_m = speed_m_s * message.clock_bound_s + fleet.margin_m
    base_m += fleet.sigma_factor * math.hypot(own_sigma_m, message.position_sigma_m)
    if message.intent is Intent.DOWN:
        carried_s, moves = min(gone_s, RIDES_S), age_s <= RIDES_S
        place = (p[0] + v[0] * carried_s, p[1] + v[1] * carried_s, p[2] + v[2] * carried_s)
        grown_m = base_m + speed_m_s * min(age_s, RIDES_S)
        return Estimate(
            age_s, place, v if moves else ZERO, grown_m, speed_m_s if moves else 0.0, False, grown_m
        )
    if age_s > fleet.latency_max_s:
        return _late(message, age_s, base_m, speed_m_s, fleet, faster_m_s2)
    place = (p[0] + v[0] * gone_s, p[1] + v[1] * gone_s, p[2] + v[2] * gone_s)
    grown_m, growth_m_s = growth(age_s, speed_m_s, fleet)
    return Estimate(age_s, place, v, base_m + grown_m, growth_m_s, False, base_m + grown_m)


def _late(
    message: MemberStatus, age_s: float, base_m: float, speed_m_s: float, fleet: Fleet, faster_m_s2: Vec3
) -> Estimate:
    """Estimate the position of a vehicle whose messages are late."""
    (x, y, z), (vx, vy, vz), (wx, wy, wz) = (
        message.position_enu_m,
        message.velocity_enu_m_s,
        message.wanted_enu_m_s,
    )
    ax, ay, az = faster_m_s2
    wx, wy, wz = wx + LEAD_S * ax, wy + LEAD_S * ay, wz + LEAD_S * az
    latency_s, carried_max_s = fleet.latency_max_s, CARRIED_AGES * fleet.age_max_s
    level_s, upright_s = min(age_s, carried_max_s) - latency_s, min(age_s, fleet.age_max_s) - latency_s
    place = (
        x + vx * latency_s + wx * level_s,
        y + vy * latency_s + wy * level_s,
        z + vz * latency_s + wz * upright_s,
    )
    moves, sinks_on = age_s < carried_max_s, age_s < fleet.age_max_s
    velocity = (wx, wy, wz if sinks_on else 0.0) if moves else ZERO
    flies, flies_s = age_s <= fleet.silent_flight_s, min(age_s, fleet.silent_flight_s)
    grown_m, late_s = base_m + growth(latency_s, speed_m_s, fleet)[0], flies_s - latency_s
    straight_s = min(age_s, carried_max_s)  # duration of the extrapolation at constant velocity, s
    straight = (x + vx * straight_s, y + vy * straight_s, z + vz * straight_s)
    anywhere_m = (
        base_m + math.dist(place, straight) + growth(min(flies_s, carried_max_s), speed_m_s, fleet)[0]
    )
    anywhere_m += max(0.0, flies_s - carried_max_s) * max(fleet.speed_max_m_s, speed_m_s)
    drift_m = min(DRIFT_M_S * late_s, DRIFT_MAX_M) if flies else 0.0
    growth_m_s = DRIFT_M_S if flies and drift_m < DRIFT_MAX_M else 0.0
    sink_m_s = SINK_M_S if flies else 0.0
    return Estimate(
        age_s, place, velocity, grown_m + drift_m, growth_m_s, True, anywhere_m, SINK_M_S * late_s, sink_m_s
    )


# intents with which a member does not give way
FIRM = frozenset({Intent.STANDING, Intent.COMMITTED, Intent.CLEARING, Intent.DOWN})
NONE, HALF, ALL = 0.0, 0.5, 1.0


def share(slot: Heard, message: MemberStatus, now_s: float, fleet: Fleet) -> float:
    """Return the share of the avoidance that this vehicle takes: none, half or all of it."""
    if slot.yields or now_s - slot.yielded_s <= HOLD_LATENCIES * fleet.latency_max_s:
        return ALL
    age_s = now_s - message.stamp_s + message.clock_bound_s
    if message.intent in FIRM or age_s > fleet.age_max_s:
        return ALL
    if slot.jumped_m != ZERO and math.hypot(*slot.jumped_m) > fleet.margin_m:
        return ALL  # the position estimate of the other vehicle may be wrong
    if fleet.id in message.yields_to and age_s <= ZERO_LATENCIES * fleet.latency_max_s:
        return NONE
    return HALF


def row(
    part: float, h_m: float, gradient: Vec3, own_wanted_m_s: Vec3, message: MemberStatus, now: Estimate,
    fleet: Fleet,
) -> Row:  # fmt: skip
    """Return the constraint on this vehicle's velocity; ``part``: share of this vehicle (see ``share``).

    With the share ALL, the constraint uses the other vehicle's velocity; with the share HALF, the mean of
    both announced velocity commands. If both vehicles follow their commands, h falls no faster than the rate
    allows. Possible changes of the other vehicle's velocity since its message tighten the constraint.
    """
    if part == ALL:
        c = now.velocity_enu_m_s
    else:
        (x, y, z), (ox, oy, oz) = message.wanted_enu_m_s, own_wanted_m_s
        c = (0.5 * (x + ox), 0.5 * (y + oy), 0.5 * (z + oz))
    along = gradient[0] * c[0] + gradient[1] * c[1] + gradient[2] * c[2]
    return Row(gradient, along + part * (now.growth_m_s - fleet.rate_1_s * h_m))


def wider(basic: Row, outer_m: float, now: Estimate, fleet: Fleet) -> Row:
    """Tighten ``basic`` for a vehicle with late messages, which can be anywhere in a wider ellipsoid.

    While a flight of the other vehicle is possible, this vehicle does not enter the wider ellipsoid; inside,
    it does not approach the centre. After that time the other vehicle has landed inside. This vehicle then
    does not enter the ellipsoid; inside, only the constraint ``basic`` holds, because this vehicle must land.
    """
    bound_m_s = -fleet.rate_1_s * outer_m
    if now.age_s <= fleet.silent_flight_s:
        bound_m_s = min(0.0, bound_m_s + fleet.speed_max_m_s)
    elif outer_m < 0.0:
        return basic
    return Row(basic.g, max(basic.bound_m_s, bound_m_s))


class Near(NamedTuple):
    """Barrier function between this vehicle and a neighbour, with the data for the side-step."""

    h_m: float  # value of the barrier function between the two vehicles, m
    gradient: Vec3  # gradient of ``h_m`` with respect to this vehicle's position
    away_m: Vec3  # position of this vehicle minus that of the neighbour, ENU, m
    velocity_enu_m_s: Vec3  # velocity of the neighbour, m/s


def sidestep(nominal: Vec3, near: Sequence[Near], rate_1_s: float) -> Vec3:
    """Return the nominal velocity plus a side-step to the right of each vehicle that this one approaches.

    The side-step grows from 0, where the constraint becomes active, to the closing speed at h = 0.
    """
    x, y, z = nominal
    for h_m, (gx, gy, gz), (ax, ay, _), (vx, vy, vz) in near:
        closing_m_s = -(gx * (nominal[0] - vx) + gy * (nominal[1] - vy) + gz * (nominal[2] - vz))
        if closing_m_s <= 0.0 or rate_1_s * h_m >= closing_m_s:
            continue
        d_m = math.hypot(ax, ay)
        ahead = (-ax / d_m, -ay / d_m) if d_m > LEAST_M else (1.0, 0.0)
        part_m_s = min(closing_m_s - rate_1_s * h_m, closing_m_s)
        x, y = x + part_m_s * ahead[1], y - part_m_s * ahead[0]
    return (x, y, z)

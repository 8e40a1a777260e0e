"""Checks of a configuration with a table [fleet]: separation of two vehicles, and its limits.

docs/how_it_works/fleet.md derives each check. ``crowd`` checks common points of several rows, ``team`` the
members as a whole.
"""

from __future__ import annotations

import math

from flightstack.core.parameters.fleet import HOLD_LATENCIES, KEPT_PART, PART_OF_LAG, ZERO_LATENCIES, Fleet
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.strategies.robust import RobustFilter
from flightstack.core.strategies.strategy import strategy_class, strategy_of
from flightstack.core.types import Vec3
from flightstack.verify import crowd, paper, touchdown
from flightstack.verify.bound import Shape, Span
from flightstack.verify.envelope import extremes
from flightstack.verify.types import Check, Need

LATE_TICKS = 1.0  # missed ticks in a row, in addition to the tick of a command


def fleet_checks(config: FlightConfig) -> list[Check]:
    """Return every check of the table [fleet]; none without this table."""
    fleet = config.fleet
    if fleet is None:
        return []
    robust = issubclass(strategy_class(config.filter), RobustFilter)
    spread, loop = config.envelope.lag_spread, config.velocity_loop
    # the lead of the set-point compensates the declared lag, but not the vehicle's deviation from it
    lag_s = (spread if robust else 1.0 + spread) * max(loop.lag_xy_s, loop.lag_z_s)
    if robust:
        x = extremes(config)
        shape, climb_m_s, descent_s = x.shape, x.target_climb_m_s, touchdown.descent_time_s(config, x)
    else:
        shape, climb_m_s = Shape(config.barrier.build(), Span(0.0, 0.0), 1.0), 0.0
        descent_s = config.touchdown.height_m / config.touchdown.descent_m_s + (1.0 + spread) * loop.lag_z_s
    where = crowd.crowd(config, fleet, shape, climb_m_s)
    slew_m_s2 = strategy_of(config).acceleration_max_m_s2
    return [
        apart(fleet, lag_s),
        paper.sampling(config, "fleet.rate_1_s", fleet.rate_1_s),
        margin(config, fleet),
        shares(fleet, 1.0 / config.loop.rate_hz),
        speed(config, fleet),
        acceleration(fleet, slew_m_s2),
        jump(config, fleet),
        slew(config, fleet, slew_m_s2, whole=False),
        slew(config, fleet, slew_m_s2, whole=True),
        crowd.begins(config, fleet, where),
        crowd.one(config, fleet, where),
        crowd.several(config, fleet, where),
        touchdowns(config, fleet, descent_s),
        waits(config, fleet, descent_s),
    ]


def apart(fleet: Fleet, lag_s: float) -> Check:
    """Check that two vehicles whose rows are met stop before their distance is zero.

    With the distance y = h, velocities that follow the commands by a first-order lag T, and both rows met, T
    y'' + y' + rate y >= 0: h is convex, so its curvature adds to y''. For rate T <= 1/4 the roots are real,
    and y remains positive if y' >= -L y, where L is the larger root.
    """
    left = 1.0 - fleet.rate_1_s * lag_s / PART_OF_LAG
    root_1_s = (1.0 + math.sqrt(max(0.0, left))) / (2.0 * lag_s) if lag_s > 0.0 else math.inf
    return Check(
        "fleet.rate_1_s",
        "two vehicles that meet their rows do not enter the ellipsoid, for equal lags within the spread",
        PART_OF_LAG - fleet.rate_1_s * lag_s,
        "",
        f"rate {fleet.rate_1_s:g} times a lag of {lag_s:.3g} s may be at most {PART_OF_LAG:g}; valid for "
        f"states in which h decreases by at most {root_1_s:.3g} h per second; with share 1 an acceleration "
        f"of a neighbour reduces h by up to {lag_s * fleet.acceleration_max_m_s2 / fleet.rate_1_s:.3g} m",
        "lower fleet.rate_1_s",
        Need.PROOF,
    )


def errors_m(config: FlightConfig, fleet: Fleet) -> float:
    """Return how far velocity errors of two vehicles towards each other can reduce h, m.

    h' >= -rate h - e keeps h above -e / rate. ``robust.tracking_error_m_s`` is declared for the vertical
    velocity; this check applies it in each direction.
    """
    longest = max(1.0, fleet.radius_xy_m / fleet.radius_z_m)
    return 2.0 * longest * config.robust.tracking_error_m_s / fleet.rate_1_s


def margin(config: FlightConfig, fleet: Fleet) -> Check:
    """Check that the margin of the ellipsoid covers the errors of the velocities."""
    lost_m = errors_m(config, fleet)
    return Check(
        "fleet.margin_m",
        "velocity errors do not bring two vehicles into the ellipsoid",
        fleet.margin_m - lost_m,
        "m",
        f"found {fleet.margin_m:g}; errors of robust.tracking_error_m_s of both vehicles, in any direction, "
        f"reduce h by {lost_m:.3g}",
        "raise fleet.margin_m or fleet.rate_1_s",
        Need.PROOF,
    )


def shares(fleet: Fleet, period_s: float) -> Check:
    """Check that a vehicle keeps its share until no other vehicle relies on it.

    A receiver relies on a message in ticks until ZERO_LATENCIES after it, plus the period of that tick and of
    late ones; the sender keeps the whole share in all ticks until HOLD_LATENCIES.
    """
    spare_s = (HOLD_LATENCIES - ZERO_LATENCIES) * fleet.latency_max_s
    needed_s = (1.0 + LATE_TICKS) * period_s
    return Check(
        "shares",
        "the shares of two vehicles sum to at least 1, also with lost, late or reordered messages",
        spare_s - needed_s,
        "s",
        f"{spare_s:.3g} s are available; a tick and a late tick need {needed_s:.3g} s; valid for clock "
        "errors within their bound, and unless the autopilot or another sender takes over a vehicle",
        "raise fleet.latency_max_s or loop.rate_hz",
        Need.PROOF,
    )


def _fastest_m_s(config: FlightConfig, fleet: Fleet) -> float:
    """Return the largest rate at which this vehicle can reduce the distance, along any gradient."""
    vx, vy, vz = config.limits.velocity_max_m_s
    return math.sqrt(vx * vx + vy * vy + (fleet.radius_xy_m / fleet.radius_z_m * vz) ** 2)


def speed(config: FlightConfig, fleet: Fleet) -> Check:
    box_m_s = math.hypot(*config.limits.velocity_max_m_s)
    return Check(
        "fleet.speed_max_m_s",
        "the speed of a member in a corner of its box is at most the speed that the others assume",
        fleet.speed_max_m_s - box_m_s,
        "m/s",
        f"found {fleet.speed_max_m_s:g}; a corner of the box allows {box_m_s:.3g}",
        "raise fleet.speed_max_m_s (and fleet.reach_m with it), or lower limits.velocity_max_m_s",
        Need.PROOF,
    )


def acceleration(fleet: Fleet, slew_m_s2: Vec3) -> Check:
    """Check that the ellipsoid grows by the largest change of a velocity since its message was sent."""
    found = math.hypot(*slew_m_s2)
    lost_m_s = max(0.0, found - fleet.acceleration_max_m_s2) * fleet.latency_max_s
    return Check(
        "fleet.acceleration_max_m_s2",
        "the commanded velocity changes at most as fast as the others assume",
        fleet.acceleration_max_m_s2 - found,
        "m/s^2",
        f"found {fleet.acceleration_max_m_s2:g}; the slew limits of all axes together allow {found:.3g}; in "
        f"a latency of {fleet.latency_max_s:g} s a velocity may differ by {lost_m_s:.3g} m/s from the "
        "assumed one",
        "raise fleet.acceleration_max_m_s2, or lower robust.acceleration_max_m_s2",
        Need.PROOF,
    )


def jump(config: FlightConfig, fleet: Fleet) -> Check:
    """Check that a row is inactive when its vehicle comes within reach."""
    allowed_m_s = fleet.rate_1_s * (fleet.reach_m - fleet.radius_xy_m)
    closing_m_s = _fastest_m_s(config, fleet) + fleet.speed_max_m_s
    return Check(
        "fleet.reach_m",
        "the row of a vehicle that comes into reach does not require a jump of the velocity",
        allowed_m_s - closing_m_s,
        "m/s",
        f"the row allows a closing speed of {allowed_m_s:.3g} m/s there; a corner of the box and "
        f"fleet.speed_max_m_s result in {closing_m_s:.3g}",
        "raise fleet.reach_m",
        Need.PROOF,
    )


def slew(config: FlightConfig, fleet: Fleet, slew_m_s2: Vec3, *, whole: bool) -> Check:
    """Check that the slew limit allows a velocity to follow an active row.

    For an active row g . (u - c) = -rate h: g . u has to grow by rate times the closing speed plus the
    acceleration of the other vehicle; the curvature of h reduces this. With half of the share it is half of
    this. The remaining room is homogeneous in g and concave, so it is least along an axis.
    """
    part, v = (1.0 if whole else 0.5), config.limits.velocity_max_m_s
    needed = [part * (fleet.rate_1_s * (m + fleet.speed_max_m_s) + fleet.acceleration_max_m_s2) for m in v]
    axis = min(range(3), key=lambda i: slew_m_s2[i] - needed[i])
    who = "whole" if whole else "half"
    return Check(
        f"slew, {who} share",
        f"the velocity of a vehicle with the {who} share can change as fast as the row of a neighbour",
        slew_m_s2[axis] - needed[axis],
        "m/s^2",
        f"along axis {axis} the row may require {needed[axis]:.3g} m/s^2 at full speed of both vehicles; "
        f"allowed are {slew_m_s2[axis]:.3g}",
        "lower fleet.rate_1_s or fleet.speed_max_m_s, or raise robust.acceleration_max_m_s2 and "
        "fleet.slew_xy_max_m_s2",
        Need.PROOF,
    )


def touchdowns(config: FlightConfig, fleet: Fleet, descent_s: float) -> Check:
    # horizon of the conflict search, until the touchdown, from messages of this age
    ahead_s = fleet.age_max_s + descent_s
    unseen_s = max(0.0, ahead_s - KEPT_PART * fleet.descent_s)  # time in which pads come closer
    accelerated = 0.5 * config.envelope.target_acceleration_max_m_s2 * ahead_s * ahead_s
    moved_m = min(
        accelerated + config.touchdown.target_speed_max_m_s * unseen_s,
        2.0 * config.touchdown.target_speed_max_m_s * ahead_s,
    )
    needed_m = fleet.radius_xy_m + 2.0 * config.touchdown.pad_radius_m + 2.0 * moved_m
    return Check(
        "touchdowns",
        "two vehicles in touchdown remain apart: pads come near each other only after both have landed",
        fleet.pad_distance_m - needed_m,
        "m",
        f"in {ahead_s:.3g} s each pad may move {moved_m:.3g} m from the position of the conflict check; "
        f"{needed_m:.3g} m are needed, fleet.pad_distance_m is {fleet.pad_distance_m:g}",
        "raise fleet.pad_distance_m, or use robots whose paths do not meet",
        Need.PROOF,
    )


def first_attempt_s(config: FlightConfig, fleet: Fleet, descent_s: float) -> float:
    """Return the duration of a landing after the wait, without a go-around, s."""
    robust = issubclass(strategy_class(config.filter), RobustFilter)
    if robust:
        near_m, gain_1_s, down_m_s = (
            config.robust.commit_radius_m, config.robust.gain_1_s, config.robust.descent_max_m_s,
        )  # fmt: skip
    else:
        near_m, gain_1_s = config.touchdown.pad_radius_m, min(config.position_loop.gain_1_s)
        down_m_s = config.limits.velocity_max_m_s[2]
    over_s = math.log(max(1.0, fleet.wait_distance_m / near_m)) / gain_1_s
    told_s = fleet.age_max_s + 2.0 * fleet.latency_max_s
    return over_s + fleet.wait_height_m / down_m_s + told_s + descent_s + config.velocity_loop.lag_xy_s


def waits(config: FlightConfig, fleet: Fleet, descent_s: float) -> Check:
    each_s, before = first_attempt_s(config, fleet, descent_s), len(fleet.others)
    return Check(
        "waits",
        "if each member lands at its first attempt, no member aborts while it waits for the right of way",
        fleet.wait_max_s - before * each_s,
        "s",
        f"{before} members land before the last one, in about {each_s:.3g} s each; allowed are "
        f"{fleet.wait_max_s / before:.3g} s each; go-arounds and vehicles that remain on the pad do not "
        "count",
        "raise fleet.wait_max_s",
        Need.PROOF,
    )

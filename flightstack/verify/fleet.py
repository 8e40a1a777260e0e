"""Checks of a configuration with a table [fleet], and of all members together (docs/how_it_works/fleet.md).

Some velocity must satisfy the landing barrier, the velocity limits (box) and the neighbours' constraints
(rows). h is the value of a neighbour's barrier, g the gradient of h. The worst constraint of a neighbour is

    g . u >= |g| w + a t - rate h,

where w is the neighbour's speed, a t its ellipsoid's growth rate at the maximum latency, rate = rate_1_s.
This vehicle has the whole share, and the neighbour approaches straight. g is a unit vector whose vertical
part is multiplied by k = radius_xy / radius_z. The checks use the box's horizontal disc, without slew limit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields
from itertools import chain, combinations

from flightstack.core.fleet.pair import barrier
from flightstack.core.parameters.fleet import HOLD_LATENCIES, KEPT_PART, PART_OF_LAG, ZERO_LATENCIES, Fleet
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.strategies.packaged.robust import RobustFilter
from flightstack.core.strategies.strategy import strategy_class, strategy_of
from flightstack.core.types import Vec3
from flightstack.verify import paper, touchdown
from flightstack.verify.bound import Most, Shape, Span, most
from flightstack.verify.envelope import extremes
from flightstack.verify.types import PROOF, Check, worst

LATE_TICKS = 1.0  # number of consecutive late ticks, in addition to the tick of a command


def fleet_checks(config: FlightConfig) -> list[Check]:
    """Return the claims about the neighbours, each for its worst neighbour in the order of the landings."""
    before = range(1, len(config.fleet.members))
    return worst(chain.from_iterable(_about_neighbour(config, number) for number in before))


def _about_neighbour(config: FlightConfig, before: int) -> list[Check]:
    """Return the claims about one neighbour if ``before`` members land before this vehicle.

    The table [fleet] has the same numbers for all neighbours; only the wait depends on ``before``.
    """
    fleet, loop, touch, spread = (
        config.fleet, config.velocity_loop, config.touchdown, config.envelope.lag_spread,
    )  # fmt: skip
    if _is_robust(config):
        x, own = extremes(config), config.robust
        shape, climb_m_s, descent_s = x.shape, x.target_climb_m_s, touchdown.descent_time_s(config, x)
        near_m, gain_1_s, down_m_s = own.commit_radius_m, own.gain_1_s, own.descent_max_m_s
        lags = spread  # the set-point compensates the declared lag, but not the vehicle's deviation from it
    else:
        shape, climb_m_s, lags = Shape(config.barrier, Span(0.0, 0.0), 1.0), 0.0, 1.0 + spread
        descent_s = touch.height_m / touch.descent_m_s + lags * loop.lag_z_s
        near_m, gain_1_s = touch.pad_radius_m, min(config.position_loop.gain_1_s)
        down_m_s = config.limits.velocity_max_m_s[2]
    # duration of a landing without a go-around, from the end of the wait
    over_s = math.log(max(1.0, fleet.wait_distance_m / near_m)) / gain_1_s
    announced_s = fleet.age_max_s + 2.0 * fleet.latency_max_s
    landing_s = over_s + fleet.wait_height_m / down_m_s + announced_s + descent_s + loop.lag_xy_s
    return [
        *_separation(config, lags * max(loop.lag_xy_s, loop.lag_z_s)),
        *_common_points(config, steepest(config, shape), climb_m_s),
        *_landings(config, descent_s, landing_s, before),
    ]


def _is_robust(config: FlightConfig) -> bool:
    return issubclass(strategy_class(config.filter), RobustFilter)


def errors_m(config: FlightConfig) -> float:
    """Return the largest loss of h if the velocities of two vehicles have errors towards each other, m.

    An error e in h' >= -rate h - e keeps h above -e / rate. ``robust.tracking_error_m_s`` is declared for the
    vertical velocity; this check applies this error in each direction.
    """
    fleet = config.fleet
    return 2.0 * max(1.0, fleet.flat) * config.robust.tracking_error_m_s / fleet.rate_1_s


def _separation(config: FlightConfig, lag_s: float) -> list[Check]:
    """Return the checks that two vehicles remain apart by their constraints.

    If velocities follow the commands with a first-order lag T and both constraints are satisfied, y = h has
    T y'' + y' + rate y >= 0: h is convex, so its curvature adds to y''. For rate T <= 1/4 the roots are real,
    and y remains positive if y' >= -L y, where L is the larger root.

    A receiver relies on an announcement in all ticks that start within ZERO_LATENCIES after the announcement,
    until these ticks and late ones end. The sender keeps the whole share for HOLD_LATENCIES after it.

    While the constraint g . (u - c) >= -rate h is active (c: the other vehicle's velocity), g . u must grow
    at least at rate * closing speed + g . c'. The curvature of h reduces this value; share HALF halves it.
    The remaining slew limit is homogeneous in g and concave, so it is smallest if g is along an axis.
    """
    fleet, speeds_m_s = config.fleet, config.limits.velocity_max_m_s
    slew_m_s2 = strategy_of(config).acceleration_max_m_s2
    left = 1.0 - fleet.rate_1_s * lag_s / PART_OF_LAG
    root_1_s = (1.0 + math.sqrt(max(0.0, left))) / (2.0 * lag_s) if lag_s > 0.0 else math.inf
    lost_m, (vx, vy, vz) = errors_m(config), speeds_m_s
    spare_s = (HOLD_LATENCIES - ZERO_LATENCIES) * fleet.latency_max_s
    needed_s = (1.0 + LATE_TICKS) * (1.0 / config.loop.rate_hz)
    corner_m_s, found_m_s2 = math.hypot(vx, vy, vz), math.hypot(*slew_m_s2)
    # maximum rate at which this vehicle can reduce h, along any gradient, m/s
    own_m_s = math.sqrt(vx * vx + vy * vy + (fleet.flat * vz) ** 2)
    allowed_m_s = fleet.rate_1_s * (fleet.reach_m - fleet.radius_xy_m)
    closing_m_s = own_m_s + fleet.speed_max_m_s
    found = [
        Check(
            "fleet.rate_1_s",
            "two vehicles that meet their rows do not enter the ellipsoid, for equal lags within the spread",
            PART_OF_LAG - fleet.rate_1_s * lag_s, "",
            f"rate {fleet.rate_1_s:g} times a lag of {lag_s:.3g} s may be at most {PART_OF_LAG:g}; valid for "
            f"states in which h decreases by at most {root_1_s:.3g} h per second; with share 1 an "
            "acceleration "
            f"of a neighbour reduces h by up to {lag_s * fleet.acceleration_max_m_s2 / fleet.rate_1_s:.3g} m",
            "lower fleet.rate_1_s", PROOF,
        ),
        paper.sampling(config, "fleet.rate_1_s", fleet.rate_1_s),
        Check(
            "fleet.margin_m", "velocity errors do not bring two vehicles into the ellipsoid",
            fleet.margin_m - lost_m, "m",
            f"found {fleet.margin_m:g}; errors of robust.tracking_error_m_s of both vehicles, in any "
            f"direction, reduce h by {lost_m:.3g}", "raise fleet.margin_m or fleet.rate_1_s", PROOF,
        ),
        Check(
            "shares",
            "the shares of two vehicles sum to at least 1, also with lost, late or reordered messages",
            spare_s - needed_s, "s",
            f"{spare_s:.3g} s are available; a tick and a late tick need {needed_s:.3g} s; valid for clock "
            "errors within their bound, and unless the autopilot or another sender takes over a vehicle",
            "raise fleet.latency_max_s or loop.rate_hz", PROOF,
        ),
        Check(
            "fleet.speed_max_m_s",
            "the speed of a member in a corner of its box is at most the speed that the others assume",
            fleet.speed_max_m_s - corner_m_s, "m/s",
            f"found {fleet.speed_max_m_s:g}; a corner of the box allows {corner_m_s:.3g}",
            "raise fleet.speed_max_m_s (and fleet.reach_m with it), or lower limits.velocity_max_m_s", PROOF,
        ),
        Check(
            "fleet.acceleration_max_m_s2",
            "the commanded velocity changes at most as fast as the others assume",
            fleet.acceleration_max_m_s2 - found_m_s2, "m/s^2",
            f"found {fleet.acceleration_max_m_s2:g}; the slew limits of all axes together allow "
            f"{found_m_s2:.3g}",
            "raise fleet.acceleration_max_m_s2, or lower robust.acceleration_max_m_s2", PROOF,
        ),
        Check(
            "fleet.reach_m",
            "the row of a vehicle that comes into reach does not require a jump of the velocity",
            allowed_m_s - closing_m_s, "m/s",
            f"the row allows a closing speed of {allowed_m_s:.3g} m/s there; a corner of the box and "
            f"fleet.speed_max_m_s result in {closing_m_s:.3g}", "raise fleet.reach_m", PROOF,
        ),
    ]  # fmt: skip
    for who, part in (("half", 0.5), ("whole", 1.0)):
        needed = [
            part * (fleet.rate_1_s * (m + fleet.speed_max_m_s) + fleet.acceleration_max_m_s2)
            for m in speeds_m_s
        ]
        room_m_s2, axis = min((slew_m_s2[i] - needed[i], i) for i in range(3))
        found.append(Check(
            f"slew, {who} share",
            f"the velocity of a vehicle with the {who} share can change as fast as the row of a neighbour",
            room_m_s2, "m/s^2",
            f"along axis {axis} the row may require {needed[axis]:.3g} m/s^2 at full speed of both vehicles; "
            f"allowed are {slew_m_s2[axis]:.3g}",
            "lower fleet.rate_1_s or fleet.speed_max_m_s, or raise robust.acceleration_max_m_s2 and "
            "fleet.slew_xy_max_m_s2", PROOF,
        ))  # fmt: skip
    return found


def _landings(config: FlightConfig, descent_s: float, landing_s: float, before: int) -> list[Check]:
    """Return the checks of simultaneous touchdowns and of the wait for ``before`` landings."""
    fleet, target_m_s = config.fleet, config.touchdown.target_speed_max_m_s
    ahead_s = fleet.age_max_s + descent_s  # horizon of the conflict check, s: message age plus descent
    closer_s = max(0.0, ahead_s - KEPT_PART * fleet.descent_s)  # time in which pads can come nearer, s
    accelerated_m = 0.5 * config.envelope.target_acceleration_max_m_s2 * ahead_s * ahead_s
    moved_m = min(accelerated_m + target_m_s * closer_s, 2.0 * target_m_s * ahead_s)
    needed_m = fleet.radius_xy_m + 2.0 * config.touchdown.pad_radius_m + 2.0 * moved_m
    return [
        Check(
            "touchdowns",
            "two vehicles in touchdown remain apart: pads come near each other only after both have landed",
            fleet.pad_distance_m - needed_m, "m",
            f"in {ahead_s:.3g} s each pad may move {moved_m:.3g} m from the position of the conflict check; "
            f"{needed_m:.3g} m are needed, fleet.pad_distance_m is {fleet.pad_distance_m:g}",
            "raise fleet.pad_distance_m, or use robots whose paths do not meet", PROOF,
        ),
        Check(
            "waits",
            "if each member lands at its first attempt, no member aborts while it waits for the right of way",
            fleet.wait_max_s - before * landing_s, "s",
            f"{before} members land before the last one, in about {landing_s:.3g} s each; allowed are "
            f"{fleet.wait_max_s / before:.3g} s each; go-arounds and vehicles that remain on the pad do not "
            "count", "raise fleet.wait_max_s", PROOF,
        ),
    ]  # fmt: skip


def steepest(config: FlightConfig, shape: Shape) -> float:
    """Return the steepest slope of the landing boundary outside the pad."""
    slope = shape.slope(Span(config.touchdown.pad_radius_m, math.inf))
    return max(abs(slope.low), abs(slope.high))


def anywhere_m(config: FlightConfig) -> float:
    """Return the h above which the constraints of any number of neighbours have a common feasible velocity.

    This velocity is the pad's horizontal velocity with any climb; it satisfies the constraint of the landing
    barrier if h is not negative.
    """
    fleet, vz = config.fleet, config.limits.velocity_max_m_s[2]
    at_most = math.hypot(config.touchdown.target_speed_max_m_s, fleet.flat * vz)
    return (max(1.0, fleet.flat) * fleet.speed_max_m_s + at_most + fleet.growth_m_s) / fleet.rate_1_s


def up_the_slope_m_s(config: FlightConfig, slope: float, climb_m_s: float) -> float:
    """Return the horizontal speed that remains for motion up the boundary's steepest slope, m/s.

    The landing barrier needs the climb rate (this speed + the pad's speed) * slope + the pad's climb rate.
    The box must contain this climb rate.
    """
    vx, vy, vz = config.limits.velocity_max_m_s
    if slope <= 0.0:
        return min(vx, vy)
    return min(vx, vy, (vz - climb_m_s) / slope - config.touchdown.target_speed_max_m_s)


def one_short_m_s(config: FlightConfig, aside_m_s: float, lowest: float) -> Most:
    """Return the largest violation of one neighbour's constraint at h = 0, m/s, and the elevation of g, rad.

    ``aside_m_s``: maximum horizontal speed of evasion; ``lowest``: smallest elevation of g; -pi / 2 is a
    neighbour directly above a vehicle that has to climb.
    """
    fleet, flat, vz = config.fleet, config.fleet.flat, config.limits.velocity_max_m_s[2]

    def length(angle: float) -> float:
        return math.hypot(math.cos(angle), flat * math.sin(angle))

    def upper(span: Span) -> float:  # each term is monotone above and below the horizontal plane
        low, high = span
        at = (low, high, 0.0) if low < 0.0 < high else (low, high)
        pushed, aside = max(map(length, at)), max(-aside_m_s * math.cos(each) for each in at)
        return fleet.speed_max_m_s * pushed + fleet.growth_m_s + aside - flat * vz * math.sin(low)

    return most(upper, Span(lowest, math.pi / 2.0), (0.0,))


def _common_points(config: FlightConfig, slope: float, climb_m_s: float) -> list[Check]:
    """Return the checks that a velocity satisfies neighbours' constraints, box and landing barrier."""
    fleet, (vx, vy, _), speed_m_s = config.fleet, config.limits.velocity_max_m_s, config.fleet.speed_max_m_s
    from_m, reach_m = anywhere_m(config), fleet.reach_m - fleet.radius_xy_m
    short_m_s, elevation = one_short_m_s(config, up_the_slope_m_s(config, slope, climb_m_s), -math.pi / 2.0)
    open_m_s, _ = one_short_m_s(config, min(vx, vy), 0.0)
    # speed that is needed far from the landing boundary, between two neighbours, m/s
    opposite_m_s = max(1.0, fleet.flat) * speed_m_s + fleet.growth_m_s
    return [
        Check(
            "neighbours in reach",
            "where neighbours come into reach, the rows of any number of neighbours have a common "
            "feasible point",
            reach_m - from_m, "m",
            f"from h = {from_m:.3g} m on, the pad's velocity with any climb meets all rows; rows "
            f"become active at {reach_m:.3g} m",
            "raise fleet.reach_m or fleet.rate_1_s, or lower fleet.speed_max_m_s", PROOF,
        ),
        Check(
            "one neighbour",
            "if no h is negative, landing barrier, box and the row of one neighbour have a common "
            "feasible point",
            -short_m_s, "m/s",
            f"the neighbour approaches with {speed_m_s:g} m/s at a slope of {slope:.3g}, "
            f"{math.degrees(-elevation):.0f} deg from above; a common point exists from h = "
            f"{max(0.0, short_m_s) / fleet.rate_1_s:.3g} m on, and without landing barrier from "
            f"{max(0.0, open_m_s) / fleet.rate_1_s:.3g} m on; below, its row is relaxed",
            "raise limits.velocity_max_m_s, or lower fleet.speed_max_m_s or the slope alpha * beta", PROOF,
        ),
        Check(
            "several neighbours",
            "if no h is negative, box and the rows of several neighbours have a common feasible point",
            -opposite_m_s, "m/s",
            f"two neighbours approach from opposite sides with {speed_m_s:g} m/s each; a common point "
            f"exists from h = {opposite_m_s / fleet.rate_1_s:.3g} m on, and for any number with the landing "
            f"barrier from {from_m:.3g} m on; below, the rows of neighbours are relaxed together",
            "lower fleet.speed_max_m_s, or raise fleet.rate_1_s; no setting meets all", PROOF,
        ),
    ]  # fmt: skip


def team_checks(
    configs: Sequence[FlightConfig],
    starts_enu_m: Sequence[Vec3],
    touch_m: Vec3,
    pads_apart_m: Sequence[float],
) -> list[Check]:
    """Return the checks that involve all members; those of two vehicles or pads are for the worst pair.

    ``configs``: configurations of the members; ``starts_enu_m``: known start places in the air; ``touch_m``:
    largest offset of two vehicles at which they overlap; ``pads_apart_m``: smallest distances of two pads.
    """
    first, pairs = configs[0].fleet, list(combinations(configs, 2))
    return worst([
        *([_one_table([config.fleet for config in configs])] if pairs else []),
        *(
            Check(
                "starts", "no vehicle starts inside the ellipsoid around another one",
                barrier((x - ox, y - oy, z - oz), first.radius_xy_m, first.radius_z_m)[0], "m",
                f"members {i} and {j} are nearest to each other", "give them other start positions", PROOF,
            )
            for (i, (ox, oy, oz)), (j, (x, y, z)) in combinations(enumerate(starts_enu_m, 1), 2)
        ),
        *(_pads(configs[0], apart_m) for apart_m in pads_apart_m),
        *(_contact(each, touch_m) for each in chain.from_iterable(pairs)),
    ])  # fmt: skip


def _one_table(tables: Sequence[Fleet]) -> Check:
    """Return the check that all members have the same table; it names each key that differs."""
    ids = sorted(each.id for each in tables)
    keys = [field.name for field in fields(Fleet) if field.name not in ("id", "members")]
    found = [key for key in keys if any(getattr(each, key) != getattr(tables[0], key) for each in tables)]
    found += ["members"] * any(sorted(each.members) != ids for each in tables)
    return Check(
        "one table", "all members have the same table [fleet], with exactly the members of the team",
        0.0 - len(found), "keys", f"{len(ids)} members; different keys: {', '.join(found) or 'none'}",
        f"give all members the same fleet.{', fleet.'.join(found)}" if found else "", PROOF,
    )  # fmt: skip


def _contact(config: FlightConfig, touch_m: Vec3) -> Check:
    """Return the check that a pair with this member's table does not touch; ``touch_m`` as in team_checks."""
    fleet, lost_m = config.fleet, max(0.0, errors_m(config) - config.fleet.margin_m)
    touch_h_m, _ = barrier(touch_m, fleet.radius_xy_m, fleet.radius_z_m)
    allowed_m_s = fleet.rate_1_s * (fleet.margin_m - touch_h_m)
    return Check(
        "contact", "two vehicles that meet their rows do not touch, in spite of velocity errors",
        -touch_h_m - lost_m, "m",
        f"errors of robust.tracking_error_m_s, in any direction, reduce h to -{lost_m:.3g} m; the "
        f"shapes touch at {touch_h_m:.3g} m; together, errors of {allowed_m_s:.3g} m/s are allowed",
        "raise fleet.margin_m, fleet.radius_xy_m or fleet.rate_1_s", PROOF,
    )  # fmt: skip


def _pads(config: FlightConfig, apart_m: float) -> Check:
    """Return the check that no vehicle has to wait; ``apart_m``: smallest distance of two pads."""
    fleet = config.fleet
    if _is_robust(config):
        x = extremes(config)
        velocity_m_s, position_m = x.velocity_error_m_s, x.position_error_m
    else:
        factor, link = config.robust.sigma_factor, config.target
        velocity_m_s, position_m = factor * link.velocity_noise_m_s, factor * link.position_noise_m
    error_m = 2.0 * (position_m + velocity_m_s * fleet.descent_s)
    paths = f"paths remain {apart_m:.3g} m apart" if apart_m > 0.0 else "paths may meet"
    return Check(
        "pads", "no two pads are predicted to conflict, so no member waits",
        apart_m - error_m - fleet.pad_distance_m, "m",
        f"{paths}, fleet.pad_distance_m is {fleet.pad_distance_m:g}; velocity errors of "
        f"{velocity_m_s:.3g} m/s each add {error_m:.3g} m within fleet.descent_s",
        "drive the robots farther apart, or lower fleet.pad_distance_m or fleet.descent_s", PROOF,
    )  # fmt: skip

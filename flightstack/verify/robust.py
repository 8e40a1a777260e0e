"""Checks of the robust filter outside the pad: the barrier holds for a vehicle with lag and errors.

docs/how_it_works/robust_filter.md derives each check. These speeds lower h, depending on the side of the
boundary's peak:

- outside, where the boundary rises inwards: the fastest approach that box and target allow;
- inside, where the boundary rises outwards: the vehicle leaves the centre at most at the target's speed.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.parameters.reserve import GRAVITY_M_S2
from flightstack.verify.bound import Most, Shape, Span, most
from flightstack.verify.envelope import Extremes
from flightstack.verify.paper import shortfall
from flightstack.verify.types import PROOF, Check

NOISE_SIGMAS = 7.0  # covered jump, in standard deviations of one position (5 of the difference of two)
HELD_M = 0.005  # maximum depth below the boundary outside the pad that is not yet a violation, m


def demand(x: Extremes, slope: Span) -> float:
    """Return the vertical velocity that keeps h at this slope for the worst horizontal velocity, m/s."""
    return max(0.0, -slope.low) * x.box_speed_m_s + max(0.0, slope.high) * x.target_speed_m_s


def demand_change(config: FlightConfig, x: Extremes, shape: Shape, d: Span, sign: float = 1.0) -> float:
    """Return the fastest rise (sign 1) or fall (sign -1) of ``demand`` as the vehicle moves, m/s^2."""
    slope, bend = shape.slope(d), shape.curvature_1_m(d)
    ax, ay, _ = config.slew_max_m_s2
    # a high inward speed is possible; it reduces the demand
    inside = x.slip_m_s if sign > 0.0 else x.box_speed_m_s
    speed = x.box_speed_m_s if slope.low < 0.0 else inside
    pushed = math.hypot(ax, ay) + x.target_acceleration_m_s2
    return (
        max(0.0, max(sign * bend.low, sign * bend.high)) * speed**2
        + (shape.turn_1_m(d) * x.slip_m_s**2 if sign > 0.0 else -min(0.0, slope.low) / d.low * speed**2)
        + max(0.0, -slope.low) * pushed
        + max(0.0, slope.high) * (x.target_acceleration_m_s2 if sign > 0.0 else pushed)
        + x.heave_acceleration_m_s2
    )


def outside(x: Extremes, function: Callable[[Span], float]) -> Most:
    """Return the largest value of a function of the distance, outside the pad."""
    return most(function, Span(x.pad_radius_m, math.inf))


def between_ticks_m(config: FlightConfig, x: Extremes) -> float:
    """Return the largest loss of h because the barrier condition is enforced only at ticks, m.

    The worst course of the demand is a saw-tooth: fastest growth g for t_up, then fastest fall for t_down.
    With period T and r = rate_1_s the loss is g T / (2 r) (1 - exp(-r t_up)) / (1 - exp(-r (t_up + t_down))).
    """
    rate_1_s, period_s = config.robust.rate_1_s, 1.0 / config.loop.rate_hz
    growth = outside(x, lambda d: demand_change(config, x, x.usual, d)).bound
    fall = outside(x, lambda d: demand_change(config, x, x.usual, d, -1.0)).bound
    swing = outside(x, lambda d: demand(x, x.usual.slope(d))).bound + 2.0 * x.target_climb_m_s
    if growth <= 0.0 or fall <= 0.0:
        return 0.0
    up, down = (math.exp(-rate_1_s * swing / change) for change in (growth, fall))
    share = (1.0 - up) / (1.0 - up * down) if up * down < 1.0 else 1.0
    return 0.5 * growth * period_s / rate_1_s * share


def depth_m(config: FlightConfig, x: Extremes) -> tuple[float, float]:
    """Return the lowest h outside the pad as a depth below 0, m, and its distance from the centre, m.

    The depth is the missing margin at this distance, plus the losses between two ticks and between two
    samples of the target. The margin fades towards the pad and is sized for the slope at the pad's edge.
    """
    robust, held_m = config.robust, x.usual.margin_m.low
    kept_m = robust.tracking_error_m_s / robust.rate_1_s

    def lacking(d: Span) -> float:
        slope = Shape(x.barrier, Span(0.0, 0.0), x.usual.fade_radius_m).slope(d)
        steep = max(abs(slope.low), abs(slope.high))
        fade = math.exp(-((d.low / robust.fade_radius_m) ** 2))
        error_m = math.hypot(steep * x.position_error_m, x.height_error_m)
        return 1000.0 * (kept_m + error_m - held_m * (1.0 - fade))

    lack = outside(x, lacking)  # the result is in mm
    return 1e-3 * max(0.0, lack.bound) + between_ticks_m(config, x) + x.growth_m, lack.at


def demand_growth(config: FlightConfig, x: Extremes) -> Most:
    """Return the largest rise rate of ``demand`` for a vehicle that follows the target, m/s^2."""
    rate_1_s = config.robust.rate_1_s

    def growth(d: Span) -> float:
        slope = x.shape.slope(d)
        used = max(0.0, -slope.low) * x.box_speed_m_s + max(0.0, slope.high) * x.slip_m_s
        return demand_change(config, x, x.shape, d) + rate_1_s * used

    return outside(x, growth)


def outside_pad(config: FlightConfig, x: Extremes) -> list[Check]:
    """Return the checks of the vehicle's motion outside the pad, and of the filter's estimators."""
    robust, link, az = config.robust, config.target, config.slew_max_m_s2[2]
    box_m_s, vz = config.limits.velocity_max_m_s, config.limits.velocity_max_m_s[2]
    most_1_s = 1.0 / x.lag_z_s if x.lag_z_s > 0.0 else math.inf
    falls_m_s, lowest_m = shortfall(x.shape, box_m_s, x.target_speed_m_s, x.target_climb_m_s)
    rises_m_s = -falls_m_s - robust.tracking_error_m_s
    deep_m = x.barrier.peak_height_m + x.shape.margin_m.high
    lasts = "never from some points"
    if rises_m_s > 0.0:
        lasts = f"at most {deep_m / rises_m_s:.3g} s from the deepest point"
    steep, growth = outside(x, lambda d: demand(x, x.shape.slope(d))), demand_growth(config, x)
    climb_m_s = steep.bound + x.target_climb_m_s + robust.tracking_error_m_s
    depth, where = depth_m(config, x)
    # white jerk of density j gives the acceleration a standard deviation of j sqrt(t); t is 1 s
    factor = robust.sigma_factor
    xy_m_s2 = factor * link.jerk_growth_max * link.jerk_xy_m_s3_sqrthz - x.target_acceleration_m_s2
    z_m_s2 = factor * link.jerk_z_m_s3_sqrthz - x.heave_acceleration_m_s2
    key = "jerk_z_m_s3_sqrthz" if z_m_s2 < xy_m_s2 else "jerk_xy_m_s3_sqrthz"
    jump_m, noise_m = config.checks.target_jump_max_m, NOISE_SIGMAS * link.position_noise_m
    return [
        Check("recovery", "from h < 0 the vehicle returns to h >= 0", rises_m_s, "m/s",
              f"at {lowest_m:.3g} m h rises with {rises_m_s:.3g} m/s: {lasts}",
              "lower touchdown.target_speed_max_m_s or robust.tracking_error_m_s, or raise "
              "limits.velocity_max_m_s"),
        Check("robust.rate_1_s",
              "h may fall more slowly than the vertical velocity settles, for each vehicle of the spread",
              most_1_s - robust.rate_1_s, "1/s",
              f"found {robust.rate_1_s:g}, the slowest vehicle lags {x.lag_z_s:.3g} s: below {most_1_s:.3g}",
              "lower robust.rate_1_s"),
        Check("climb",
              "the vertical axis alone satisfies the barrier before the horizontal velocity has changed",
              vz - climb_m_s, "m/s",
              f"at {steep.at:.3g} m it may need {climb_m_s:.3g} m/s, the box has {vz:g}",
              "raise limits.velocity_max_m_s[2], or lower its horizontal part or "
              "touchdown.target_speed_max_m_s", PROOF),
        Check("acceleration",
              "while the target is followed, the needed vertical velocity changes no faster than the limit",
              az - growth.bound, "m/s^2",
              f"at {growth.at:.3g} m it may change with {growth.bound:.3g} m/s^2, allowed are {az:g}",
              "raise robust.acceleration_max_m_s2[2], or lower its horizontal part or "
              "limits.velocity_max_m_s", PROOF),
        *_reserve(config, growth),
        Check("h outside the pad",
              f"h stays above {-1000.0 * HELD_M:g} mm wherever d exceeds the pad's radius", HELD_M - depth,
              "m", f"margin {1000.0 * x.usual.margin_m.low:.3g} mm, at {where:.3g} m; "
              f"h > {-1000.0 * depth:.3g} mm",
              "lower robust.fade_radius_m, robust.acceleration_max_m_s2 or limits.velocity_max_m_s, or raise "
              "loop.rate_hz", PROOF),
        Check("estimator", "the estimator's jerk noise reaches each declared acceleration within a second",
              min(xy_m_s2, z_m_s2), "m/s^2",
              f"target.{key} {getattr(link, key):g}, {factor:g} standard deviations of it are covered",
              f"raise target.{key} or lower envelope.target_acceleration_max_m_s2", PROOF),
        Check("checks.target_jump_max_m", "two positions of a target with the declared noise are no jump",
              jump_m - noise_m, "m",
              f"found {jump_m:g}, the noise of a position is {link.position_noise_m:g} m",
              f"raise checks.target_jump_max_m to {noise_m:.3g}", PROOF),
        *_own_estimator(config),
    ]  # fmt: skip


def _reserve(config: FlightConfig, growth: Most) -> list[Check]:
    """Return the check of the thrust reserve, if there is a table [reserve]."""
    table = config.reserve
    if table is None:
        return []
    low_v, least = table.lowest_voltage_v, table.at(table.lowest_voltage_v)
    up_m_s2 = table.share * (least - 1.0) * GRAVITY_M_S2
    enough_v = table.voltage_v(1.0 + max(0.0, growth.bound) / (table.share * GRAVITY_M_S2))
    takes, remedy = "no voltage gives", "raise reserve.share, or "
    if enough_v < math.inf:
        takes, to_v = f"takes {enough_v:.3g} V", math.ceil(100.0 * enough_v) / 100.0
        remedy = f"raise reserve.lowest_voltage_v to {to_v:g} or reserve.share, or "
    return [
        Check("thrust reserve",
              "the battery allows the climb that the barrier may demand, down to its lowest voltage",
              up_m_s2 - growth.bound, "m/s^2",
              f"at {low_v:g} V thrust is {least:.3g} times the weight, which climbs with {up_m_s2:.3g} m/s^2"
              f"; at {growth.at:.3g} m {growth.bound:.3g} are needed, which {takes}",
              f"{remedy}lower what is needed, as the check acceleration says", PROOF),
    ]  # fmt: skip


def _own_estimator(config: FlightConfig) -> list[Check]:
    """Return the check that a velocity error is estimated faster than the position loop acts on it.

    Without the velocity loop's model, a new error makes the velocity estimate wrong for this estimation time.
    """
    if not config.own.learns or config.velocity_feedback.horizontal:
        return []
    gain = max(config.robust.gain_1_s, config.robust.gain_over_pad_1_s, config.robust.to_contact_1_s)
    time_s = config.own.velocity_error_time_s
    return [
        Check("own.velocity_error_time_s",
              "an error of the vehicle's velocity is estimated twice as fast as the position loop acts",
              0.5 / gain - time_s, "s",
              f"found {time_s:g} s; with a gain of {gain:g} 1/s at most {0.5 / gain:.3g} s",
              "lower own.velocity_error_time_s, or set own.velocity_error_m_s to 0", PROOF),
    ]  # fmt: skip

"""Envelope of the certificate: the worst target, vehicle and estimates that a configuration declares."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.parameters.robust import TargetLink
from flightstack.core.safety.barrier import Barrier
from flightstack.core.strategies.packaged.robust import RobustFilter
from flightstack.core.target.estimator import TargetEstimator, TargetMotion
from flightstack.core.types import ZERO
from flightstack.verify.bound import Shape, Span

SETTLE_SAMPLES = 2000  # number of samples after which the estimator's covariance is constant


@dataclass(frozen=True, slots=True)
class Extremes:
    """Worst values of the declared envelope, for the robust filter."""

    barrier: Barrier  # the paper's barrier
    shape: Shape  # boundary; the margin ranges from that of ``usual`` to that of a target at the age limit
    usual: Shape  # boundary with the margin that applies while all samples of the target arrive
    pad_radius_m: float  # radius outside which the barrier must hold, m
    box_speed_m_s: float  # maximum approach speed, m/s: diagonal of the velocity box plus the target's speed
    target_speed_m_s: float  # horizontal speed of the target, also relative to a hovering vehicle, m/s
    target_climb_m_s: float  # vertical speed of the pad, m/s
    target_acceleration_m_s2: float  # horizontal acceleration of the target, m/s^2
    heave_acceleration_m_s2: float  # vertical acceleration of the target, m/s^2; 0 without heave
    slip_m_s: float  # horizontal speed relative to the target while the vehicle follows the target, m/s
    position_error_m: float  # horizontal error of the relative position, m: sigma_factor deviations
    height_error_m: float  # vertical error of the relative position, m: sigma_factor deviations
    growth_m: float  # growth of the margin between two samples of the target, m
    velocity_error_m_s: float  # error of the relative velocity on each axis, m/s: sigma_factor deviations
    lag_xy_s: float  # horizontal lag of the slowest vehicle, s
    lag_z_s: float  # vertical lag of the slowest vehicle, s


def extremes(config: FlightConfig) -> Extremes:
    """Return the worst values of the declared envelope."""
    barrier, robust, loop = config.barrier, config.robust, config.velocity_loop
    strategy = RobustFilter(config, barrier)
    envelope, pad_radius_m = config.envelope, config.touchdown.pad_radius_m
    errors = _estimates(config.target, envelope.target_rate_hz, config.checks.target_age_max_s)
    fresh, near, far = (strategy.margin_m(each.position_sigma_m, each.position_sigma_z_m) for each in errors)
    (_, usual, _), own_m = errors, config.own.position_noise_m
    vx, vy, _ = config.limits.velocity_max_m_s
    acceleration = envelope.target_acceleration_max_m_s2
    own_m_s = _own_velocity_sigma_m_s(config)
    velocity_error = robust.sigma_factor * math.hypot(usual.velocity_sigma_m_s, own_m_s)
    slower = 1.0 + envelope.lag_spread
    return Extremes(
        barrier=barrier,
        shape=Shape(barrier, Span(near, max(near, far)), robust.fade_radius_m),
        usual=Shape(barrier, Span(near, near), robust.fade_radius_m),
        pad_radius_m=pad_radius_m,
        box_speed_m_s=math.hypot(vx, vy) + config.touchdown.target_speed_max_m_s,
        target_speed_m_s=config.touchdown.target_speed_max_m_s,
        target_climb_m_s=envelope.target_climb_max_m_s,
        target_acceleration_m_s2=acceleration,
        heave_acceleration_m_s2=acceleration if envelope.target_climb_max_m_s > 0.0 else 0.0,
        # the set-point compensates the declared lag, but not the vehicle's deviation from it
        slip_m_s=(envelope.lag_spread * loop.lag_xy_s + loop.dead_time_s) * acceleration + velocity_error,
        position_error_m=robust.sigma_factor * math.hypot(usual.position_sigma_m, own_m),
        height_error_m=robust.sigma_factor * math.hypot(usual.position_sigma_z_m, own_m),
        growth_m=near - fresh,
        velocity_error_m_s=velocity_error,
        lag_xy_s=slower * loop.lag_xy_s,
        lag_z_s=slower * loop.lag_z_s,
    )


def _own_velocity_sigma_m_s(config: FlightConfig) -> float:
    """Return the noise of a velocity whose error is estimated without the velocity loop's model, m/s.

    White position noise through s w^2 / (s + w)^2, w = 1 / time_s, has the variance noise^2 period w^3 / 4.
    """
    own = config.own
    if not own.learns or config.velocity_feedback.horizontal:
        return 0.0
    period_s, time_s = 1.0 / config.loop.rate_hz, own.velocity_error_time_s
    return 0.5 * own.position_noise_m * math.sqrt(period_s / time_s) / time_s


@lru_cache(maxsize=16)  # several checks of one configuration use the result
def _estimates(link: TargetLink, rate_hz: float, age_max_s: float) -> tuple[TargetMotion, ...]:
    """Return the target estimate when a sample has just arrived, just before the next, and at the age limit.

    The estimator's covariance is independent of the measured values, so running it on zeros is exact. The
    estimate at the age limit is the worse one of the first and a later sample, on each axis.
    """
    estimator, period_s = TargetEstimator(link), 1.0 / rate_hz
    estimator.update(0.0, ZERO, ZERO)
    first = estimator.at(age_max_s)
    for number in range(1, SETTLE_SAMPLES):
        estimator.update(number * period_s, ZERO, ZERO)
    newest_s = estimator.memory.time_s
    fresh, usual, later = (
        estimator.at(newest_s + age_s)
        for age_s in (min(age_max_s, link.delay_s), min(age_max_s, link.delay_s + period_s), age_max_s)
    )
    lost = later._replace(
        position_sigma_m=max(first.position_sigma_m, later.position_sigma_m),
        position_sigma_z_m=max(first.position_sigma_z_m, later.position_sigma_z_m),
    )
    return fresh, usual, lost

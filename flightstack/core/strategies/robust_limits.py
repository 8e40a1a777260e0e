"""Configurations of the robust filter that contradict themselves, or that no proof was made for."""

from __future__ import annotations

from flightstack.common.strict_toml import ConfigError
from flightstack.core.parameters.flight import FlightConfig


def refuse(config: FlightConfig) -> None:
    """Refuse them."""
    _refuse_loop(config)
    checks, link, period_s = config.checks, config.target, 1.0 / config.loop.rate_hz
    sample_s, lag_s = link.delay_s + 1.0 / config.envelope.target_rate_hz, config.velocity_loop.lag_xy_s
    for key, found_s, least_s, others, why in (
        ("checks.target_age_max_s", checks.target_age_max_s, sample_s,
         "envelope.target_rate_hz and target.delay_s", "a sample is as old when the next one comes"),
        ("checks.own_age_max_s", checks.own_age_max_s, period_s, "loop.rate_hz",
         "an own state is as old when the next tick comes"),
        ("checks.follow_lag_max_s", checks.follow_lag_max_s, lag_s, "velocity_loop.lag_xy_s",
         "a vehicle that follows lags as much"),
    ):  # fmt: skip
        if not found_s > least_s:
            raise ConfigError(
                f"{key}: found {found_s:g}; by {others} {why}, {least_s:.3g} s: raise the first above that, "
                "or change the others"
            )
    feet_m = config.touchdown.feet_below_reference_m
    for height in ("wait_height_m", "commit_height_m", "touch_height_m"):
        height_m = getattr(config.robust, height)
        if height_m <= feet_m:
            raise ConfigError(
                f"robust.{height}: found {height_m:g}; with touchdown.feet_below_reference_m {feet_m:g} the "
                "feet are in the pad at this height of the reference: raise it above, or lower that"
            )
    fade_m, pad_m = config.robust.fade_radius_m, config.touchdown.pad_radius_m
    if fade_m > pad_m:
        raise ConfigError(
            f"robust.fade_radius_m: found {fade_m:g}, allowed is at most the pad's radius, {pad_m:g} m, "
            "where the margin has to be there: lower it"
        )


def _refuse_loop(config: FlightConfig) -> None:
    """A model of the velocity loop that is not stable, or whose dead time some part does not know."""
    loop, rate_hz = config.velocity_loop, config.loop.rate_hz
    most_1_s = loop.rate_max_1_s(1.0 / rate_hz)
    for key, found_1_s in (("rate_xy_1_s", loop.rate_xy_1_s), ("rate_z_1_s", loop.rate_z_1_s)):
        if not found_1_s < most_1_s:
            raise ConfigError(
                f"velocity_loop.{key}: found {found_1_s:g}; with velocity_loop.damping {loop.damping:g} "
                f"and loop.rate_hz {rate_hz} the model of the loop is stable below {most_1_s:.4g} 1/s: "
                "lower it, or raise loop.rate_hz"
            )
    late_s = loop.dead_time_s
    if late_s <= 0.0:
        return
    if not late_s < loop.lag_xy_s:
        raise ConfigError(
            f"velocity_loop.dead_time_s: found {late_s:g}; it is a part of velocity_loop.lag_xy_s, "
            f"{loop.lag_xy_s:g} s: lower it, or raise the lag"
        )
    without = {
        "velocity_feedback.horizontal": config.velocity_feedback.horizontal,
        "own.velocity_error_m_s": config.own.learns,
        "fleet": config.fleet is not None,
    }
    if any(without.values()):
        names = ", ".join(name for name, given in without.items() if given)
        raise ConfigError(
            f"velocity_loop.dead_time_s: found {late_s:g} together with {names}, which is proven for a loop "
            "without dead time only: set it to 0, or leave the other out"
        )

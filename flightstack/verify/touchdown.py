"""Checks of the final descent with the robust filter: the vehicle reaches the pad in time.

A comparison system bounds the horizontal motion over the pad (docs/how_it_works/robust_filter.md,
*Touchdown*): y is the distance from the centre, z the difference between velocity and commanded velocity, K
the descent's gain, tau the vehicle's lag, and rho the relative error of the set-point's lead.
"""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import accumulate, pairwise
from typing import NamedTuple

import numpy as np

from flightstack.core.mission.guidance import CLIMB_OVER
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.strategies.packaged.robust import BRAKING
from flightstack.verify import late
from flightstack.verify.envelope import Extremes
from flightstack.verify.feedback import follow_m, matrix_exp
from flightstack.verify.types import PROOF, Check

STEP_S = 2e-3  # step of the comparison system, s
PIECES = 20  # number of intervals into which the range of lags is divided
AGREE = 1.6  # maximum allowed ratio of declared and modelled lag, the larger divided by the smaller


def descent_time_s(config: FlightConfig, x: Extremes) -> float:
    """Return the longest duration of the final descent until contact, s."""
    robust = config.robust
    descent_m = robust.commit_height_m - config.touchdown.feet_below_reference_m + x.height_error_m
    speed = robust.descent_m_s - robust.tracking_error_m_s
    return descent_m / speed + x.lag_z_s if speed > 0.0 else math.inf


def modelled(config: FlightConfig) -> Check:
    """Check that the lag of the velocity loop's model is within a factor of ``AGREE`` of the declared lag.

    The lag correction uses the declared lag, and the disturbance estimate uses the model: a large
    difference would count as a disturbance. The identified loops of the shipped configurations agree within a
    factor of 1.5.
    """
    loop = config.velocity_loop
    axes = (
        ("xy", loop.lag_xy_s, 2.0 * loop.damping / loop.rate_xy_1_s + loop.dead_time_s),
        ("z", loop.lag_z_s, 2.0 * loop.damping / loop.rate_z_1_s),
    )
    factor, axis, declared_s, model_s = max(
        (max(declared / model, model / declared) if declared > 0.0 else math.inf, axis, declared, model)
        for axis, declared, model in axes
    )
    made = f"2 damping / rate_{axis}_1_s {'+ dead_time_s ' if axis == 'xy' else ''}make {model_s:.3g} s"
    return Check(
        f"velocity_loop.lag_{axis}_s", "rate and damping of the velocity loop's model make the declared lag",
        AGREE - factor, "", f"found {declared_s:g} s, {made}: {factor:.3g} times apart, at most {AGREE:g}",
        "identify the loop again (flightstack identify)", PROOF,
    )  # fmt: skip


def drift_m(config: FlightConfig, x: Extremes) -> tuple[float, float]:
    """Return the largest distance from the centre in the final descent, m, and its time, s, over all lags.

    The range of lags is divided into intervals; the slowest decay and the largest rho of each one are used.
    """
    declared_s, spread = config.velocity_loop.lag_xy_s, config.envelope.lag_spread
    robust, gain = config.robust, config.robust.gain_over_pad_1_s
    descent = _Descent(
        gain, x.velocity_error_m_s + gain * x.position_error_m, x.target_acceleration_m_s2,
        robust.commit_radius_m + x.position_error_m, robust.commit_speed_m_s,
        min(descent_time_s(config, x), config.touchdown.timeout_s),
    )  # fmt: skip
    if declared_s <= 0.0 or spread <= 0.0:
        return _drift_of_m(descent, declared_s, 0.0)
    cuts = [declared_s * (1.0 + spread * (2.0 * i / PIECES - 1.0)) for i in range(PIECES + 1)]
    pieces = (
        (slow, max(abs(fast - declared_s) / fast, abs(slow - declared_s) / slow))
        for fast, slow in pairwise(cuts)
    )
    return max(_drift_of_m(descent, lag_s, rho) for lag_s, rho in pieces)


class _Descent(NamedTuple):
    """Numbers of a final descent, which are hashed; a configuration from Python code can contain lists."""

    gain_1_s: float
    error_m_s: float  # error of the commanded velocity, m/s
    target_acceleration_m_s2: float
    distance_m: float  # distance from the centre at the start of the final descent, m
    speed_m_s: float  # speed relative to the target at the start of the final descent, m/s
    time_s: float


@lru_cache(maxsize=64)  # several checks of one configuration use the result
def _drift_of_m(descent: _Descent, lag_s: float, rho: float) -> tuple[float, float]:
    """Return the result of ``drift_m`` for one tau and rho.

    The linear comparison system is solved exactly at each step; the possible growth between two steps is
    added.
    """
    (gain, error, acceleration, y, speed, time_s), decay_1_s = descent, 1.0 / max(lag_s, STEP_S)
    rates = np.zeros((3, 3))  # derivatives of y, z and the constant 1
    rates[0] = -gain, 1.0, error
    pushed = acceleration + gain * error
    rates[1] = rho * gain * gain, rho * gain - decay_1_s, rho * pushed
    step = matrix_exp(STEP_S * rates)
    state, steps = np.array([y, speed + error + gain * y, 1.0]), math.ceil(time_s / STEP_S)
    path = np.array(list(accumulate(range(steps), lambda now, _: step @ now, initial=state)))
    fastest, bend = np.abs(path @ rates[0]).max(), np.abs(path @ (rates @ rates)[0]).max()
    between_m = 0.5 * STEP_S * (fastest + STEP_S * bend)
    last = int(path[:, 0].argmax())
    return float(path[last, 0] + between_m), last * STEP_S


def over_pad(config: FlightConfig, x: Extremes) -> list[Check]:
    """Return the checks of following, final descent and climb."""
    robust, touchdown, speed = config.robust, config.touchdown, config.robust.descent_min_m_s
    (vx, vy, vz), feet_m = config.limits.velocity_max_m_s, touchdown.feet_below_reference_m
    down_m_s, noise_m_s = robust.descent_m_s + x.target_climb_m_s, config.target.velocity_noise_m_s
    shows_m_s = math.hypot(x.target_speed_m_s, x.target_climb_m_s) + robust.sigma_factor * noise_m_s
    # the boundary rises only up to its peak, but the margin rises at every distance
    ring_m, pad_m = min(robust.commit_radius_m, x.barrier.peak_distance_m), x.pad_radius_m
    fade = 1.0 - math.exp(-((robust.commit_radius_m / robust.fade_radius_m) ** 2))
    floor_m = x.barrier.height(ring_m) + x.usual.margin_m.high * fade
    hover_m = floor_m + config.velocity_loop.lag_z_s * robust.tracking_error_m_s + x.height_error_m
    time_s, peak_m = descent_time_s(config, x), x.barrier.peak_height_m
    # stopping distance of the slowest descent: v tau + v^2 / (2 a)
    stop_m = speed * x.lag_z_s + 0.5 * speed * speed / config.slew_max_m_s2[2]
    room_m = robust.wait_height_m - feet_m - x.height_error_m
    top_m = peak_m + config.retreat.climb_margin_m + CLIMB_OVER * config.retreat.climb_margin_m
    left_m = config.limits.altitude_max_m - max(top_m, peak_m + x.shape.margin_m.high)
    return [
        # a refuted claim does not prevent a flight, because the vehicle can still reach a slower target
        Check("follow", "the vehicle is faster than the target", min(vx, vy) - x.target_speed_m_s, "m/s",
              f"horizontally the box has {min(vx, vy):g} m/s, the target {x.target_speed_m_s:g}",
              "raise limits.velocity_max_m_s or lower touchdown.target_speed_max_m_s", PROOF),
        Check("descent on a heaving pad", "the box contains the descent and the pad's own motion",
              vz - down_m_s, "m/s", f"the box has {vz:g} m/s vertically, {down_m_s:.3g} are needed",
              "raise limits.velocity_max_m_s[2] or lower robust.descent_m_s"),
        Check("checks.target_speed_max_m_s", "samples of the fastest target pass the check of their speed",
              config.checks.target_speed_max_m_s - shows_m_s, "m/s",
              f"found {config.checks.target_speed_max_m_s:g}, the target shows up to {shows_m_s:.3g}",
              "raise checks.target_speed_max_m_s"),
        Check("commit height", "the boundary with its margin does not block the descent to the commit height",
              robust.commit_height_m - hover_m, "m",
              f"at commit_radius {robust.commit_radius_m:g} m it ends at {hover_m:.3g} m, commit_height: "
              f"{robust.commit_height_m:g} m",
              "raise robust.commit_height_m, or lower robust.commit_radius_m or robust.tracking_error_m_s"),
        Check("wait height", "the vehicle waits below the commit height",
              robust.commit_height_m - robust.wait_height_m - x.height_error_m, "m",
              f"it waits at {robust.wait_height_m:g} m, the commit height is {robust.commit_height_m:g} m",
              "raise robust.commit_height_m or lower robust.wait_height_m"),
        Check("touch height",
              "a vehicle standing on the pad is below the height at which a stopped descent is contact",
              robust.touch_height_m - feet_m - x.height_error_m, "m",
              f"found {robust.touch_height_m:g}, it stands at {feet_m:g} m", "raise robust.touch_height_m"),
        Check("corridor", "the corridor lies over the pad", pad_m - robust.corridor_m, "m",
              f"robust.corridor_m {robust.corridor_m:g} m, the pad's radius {pad_m:g} m",
              f"lower robust.corridor_m to {pad_m:g} or less"),
        Check("descent time", "the last descent ends before its time limit", touchdown.timeout_s - time_s,
              "s", f"it may take {time_s:.3g} s, allowed are {touchdown.timeout_s:g}",
              "raise robust.descent_m_s or touchdown.timeout_s, or lower robust.commit_height_m"),
        Check("robust.descent_min_m_s", "the slowest descent ends between the waiting height and the pad",
              room_m - stop_m, "m",
              f"found {speed:g}, which ends within {stop_m:.3g} m; it waits {room_m:.3g} m above",
              "lower robust.descent_min_m_s or raise robust.wait_height_m", PROOF),
        Check("altitude", "the climb clear of the target ends below the highest altitude", left_m, "m",
              f"it ends {top_m:.3g} m above the pad; that leaves {max(0.0, left_m):.3g} m for the pad's own "
              "height",
              "raise limits.altitude_max_m"),
        _tilts(config, x),
        modelled(config),
        _drift(config.descending, x),
    ]  # fmt: skip


def _tilts(config: FlightConfig, x: Extremes) -> Check:
    """Check that the bound of the set-point allows the required acceleration.

    docs/how_it_works/robust_filter.md, *Limits of the lead*, derives the required acceleration A. The lag of
    a vehicle that accelerates to the speed v is longer by v / (2 A) - v / (2 a), where a is the slew limit.
    """
    loop, (ax, ay, _) = config.velocity_loop, config.slew_max_m_s2
    speed, slew = max(config.limits.velocity_max_m_s[:2]), min(ax, ay)
    answers_s = x.lag_xy_s if loop.dead_time_s else loop.lag_xy_s
    found = loop.error_max_m_s / answers_s if answers_s > 0.0 else math.inf
    left_s = config.checks.follow_lag_max_s - x.lag_xy_s - loop.dead_time_s + 0.5 * speed / slew
    needed = max(BRAKING * slew, 0.5 * speed / left_s if left_s > 0.0 else math.inf)
    raise_to = f"velocity_loop.error_max_m_s to {needed * answers_s:.3g}, or " if needed < math.inf else ""
    return Check(
        "velocity_loop.error_max_m_s",
        "the bound of the set-point allows the acceleration to brake, and to follow without an abort",
        found - needed, "m/s^2",
        f"found {loop.error_max_m_s:g}, which accelerates with {found:.3g} m/s^2; {needed:.3g} are needed",
        f"raise {raise_to}checks.follow_lag_max_s", PROOF,
    )  # fmt: skip


def farthest_m(config: FlightConfig, x: Extremes) -> tuple[float, str]:
    """Return the bound of the touchdown's distance from the centre, m, and a text about the worst point.

    The configuration has the gain of the final descent.
    """
    if config.velocity_feedback.horizontal:
        farthest, vehicle = follow_m(config, x)
        return farthest, f", a velocity loop {vehicle:.3g} times as fast"
    if config.velocity_loop.dead_time_s > 0.0:
        time_s = min(descent_time_s(config, x), config.touchdown.timeout_s)
        farthest, lags = late.drift_m(config, x, time_s)
        return farthest, f", with {lags:.3g} times the lag"
    farthest, when_s = drift_m(config, x)
    return farthest, f" after {when_s:.2f} s"


def _drift(config: FlightConfig, x: Extremes) -> Check:
    """Check that the vehicle touches the pad; the configuration has the gain of the final descent."""
    fed_back = config.velocity_feedback.horizontal
    farthest, how = farthest_m(config, x)
    worst = f"{1000.0 * farthest:.3g} mm from the middle{how}"
    remedy = "lower robust.commit_speed_m_s or robust.commit_radius_m"
    if fed_back and config.own.learns:
        worst = "no bound is known for a vehicle that estimates its own state (own.velocity_error_m_s)"
        remedy = "campaigns show how far from the middle it touches"
    elif fed_back:
        remedy = "lower envelope.lag_spread or envelope.target_acceleration_max_m_s2"
    followed = fed_back or config.velocity_loop.dead_time_s > 0.0
    target = "a target that it followed" if followed else "the target"
    return Check(
        "drift", f"after the commit the vehicle touches the pad, for any motion of {target}",
        x.pad_radius_m - farthest, "m", f"{worst}; the pad has {1000.0 * x.pad_radius_m:g} mm",
        f"{remedy}; the vehicle then goes around more often", PROOF,
    )  # fmt: skip

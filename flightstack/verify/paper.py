"""Checks of eq. 11 that any filter needs: some velocity in the box always satisfies the barrier.

At the slope s, with the horizontal unit vector n away from the target, the best velocity in the box (limits
v) raises h by ``v_z + |s| (|n_x| v_x + |n_y| v_y)``. The worst target (speed w, climb w_z) lowers h by
``|s| w + w_z``. The first rate minus the second must not be negative at any distance and in any direction;
this difference is smallest along the slower axis of the box. Near the apex (d = 0) the smoothing makes the
filter's gradient smaller than s. The difference is linear in |s|, and the check at the peak includes s = 0:
the apex is covered, too.
"""

from __future__ import annotations

import math

from flightstack.core.parameters.flight import FlightConfig, TouchdownRule
from flightstack.core.types import Vec3
from flightstack.verify.bound import Most, Shape, Span, most
from flightstack.verify.types import PROOF, Check

TICK_S = 0.05  # length of a tick, s, that is allowed even if the vehicle's lag is shorter
QUICKER = 1.25  # required ratio of the position loop's gain to omega
FASTER = 1.4  # required ratio of the vehicle's speed to the target's
# Required ratio of the boundary height at half the pad's radius to contact.gap_m. At a ratio of 1 two of 100
# landings touched the pad's edge, at 1.6 none.
CENTRES = 1.5


def shortfall(shape: Shape, box_m_s: Vec3, target_speed_m_s: float, target_climb_m_s: float) -> Most:
    """Return the fastest fall of h with the best velocity of the box, m/s, and the distance d there, m."""
    excess_m_s = target_speed_m_s - min(box_m_s[:2])

    def lost(d: Span) -> float:
        slope = shape.slope(d)
        steep = max(abs(slope.low), abs(slope.high))
        flat = 0.0 if slope.low <= 0.0 <= slope.high else min(abs(slope.low), abs(slope.high))
        return (steep if excess_m_s > 0.0 else flat) * excess_m_s + target_climb_m_s - box_m_s[2]

    return most(lost, Span(0.0, math.inf), (shape.barrier.peak_distance_m,))


def basics(
    config: FlightConfig, shape: Shape, target_climb_m_s: float, rate: tuple[str, float],
    slew: tuple[str, Vec3],
) -> list[Check]:  # fmt: skip
    """Return the checks of box, barrier and tick; ``rate`` and ``slew`` are the filter's keys and values."""
    speed, pad_m = config.touchdown.target_speed_max_m_s, config.touchdown.pad_radius_m
    peak_m = shape.barrier.peak_distance_m
    box, gains, hz = config.limits.velocity_max_m_s, config.position_loop.gain_1_s, config.loop.rate_hz
    fastest_m_s, d = shortfall(shape, box, speed, target_climb_m_s)
    slope = round(shape.slope(Span(d, d)).high, 6)
    heave = f" that climbs with {target_climb_m_s:g} m/s" if target_climb_m_s > 0.0 else ""
    end = "outruns the box" if fastest_m_s > 0.0 else "does not outrun the box"
    most_1_s, axis = 0.5 * hz, max(range(3), key=lambda i: gains[i])
    key, slew_m_s2 = slew
    most_m_s2 = [2.0 * limit * hz for limit in box]  # acceleration between both limits in one tick, m/s^2
    side = min(range(3), key=lambda i: most_m_s2[i] - slew_m_s2[i])
    return [
        Check("barrier", "some velocity in the box meets the barrier wherever h >= 0", -fastest_m_s, "m/s",
              f"at {d:.3g} m, direction {0 if box[0] <= box[1] else 90} deg, slope {slope:.3g}, "
              f"a target of {speed:g} m/s{heave} {end}",
              "lower touchdown.target_speed_max_m_s or the slope alpha * beta, or raise "
              "limits.velocity_max_m_s"),
        sampling(config, *rate),
        Check("barrier's peak", "the boundary rises with distance everywhere over the pad", peak_m - pad_m,
              "m", f"its peak at {peak_m:.3g} m, the pad's radius {pad_m:g} m",
              "make the barrier wider: lower alpha_1_m"),
        Check(f"position_loop.gain_1_s[{axis}]", "a tick is short against the position loop",
              most_1_s - gains[axis], "1/s", f"found {gains[axis]:g}, at {hz} Hz at most {most_1_s:g}",
              "lower position_loop.gain_1_s or raise loop.rate_hz"),
        Check(f"{key}[{side}]", "the slew limit is lower than the change that the box allows in a tick",
              most_m_s2[side] - slew_m_s2[side], "m/s^2",
              f"found {slew_m_s2[side]:g}, no limit at {hz} Hz; at most {most_m_s2[side]:g}",
              f"lower {key}"),
    ]  # fmt: skip


def sampling(config: FlightConfig, key: str, rate_1_s: float) -> Check:
    """Return the check that a tick is short compared with the time constant of the fastest decay of h."""
    most_1_s = 0.5 * config.loop.rate_hz
    return Check(f"sampling, {key}", "a tick is short compared with the rate at which h may fall",
                 most_1_s - rate_1_s, "1/s",
                 f"found {rate_1_s:g}, at {config.loop.rate_hz} Hz at most {most_1_s:g}",
                 f"lower {key} or raise loop.rate_hz")  # fmt: skip


def touch_height(config: FlightConfig) -> tuple[str, float]:
    """Return the name and the value of the height at which the paper's filter counts as touching down, m."""
    if config.touchdown.rule is TouchdownRule.CONTACT:
        return f"{CENTRES:g} times contact.gap_m", CENTRES * config.contact.gap_m
    return "touchdown.height_m", config.touchdown.height_m


def answers(config: FlightConfig) -> list[Check]:
    """Check that position loop, filter, slew limit and tick fit a vehicle with lag, which the paper omits.

    docs/how_it_works/method.md, *Feasibility*, gives the reasons.
    """
    loop, slower, tick_s = config.velocity_loop, 1.0 + config.envelope.lag_spread, 1.0 / config.loop.rate_hz
    (kx, ky, kz), (ax, ay, _) = config.position_loop.gain_1_s, config.limits.slew_max_m_s2
    (vx, vy, vz), target_m_s = config.limits.velocity_max_m_s, config.touchdown.target_speed_max_m_s
    lag_s, settles_s, omega_1_s = slower * loop.lag_xy_s, slower * loop.lag_z_s, config.barrier.omega_1_s
    quick_s, target_m_s2 = max(loop.lag_xy_s, TICK_S), config.envelope.target_acceleration_max_m_s2
    speed, overtakes_m_s, pad_m = max(vx, vy), min(vx, vy), config.touchdown.pad_radius_m
    barrier, (key, touch_m) = config.barrier, touch_height(config)
    rises_m_s, half_m = barrier.slope_max * target_m_s, barrier.height(0.5 * pad_m)
    return [
        Check("lag",
              "the distance flown during the lag, which the paper neglects, is shorter than the pad's radius",
              pad_m - speed * lag_s, "m",
              f"at {speed:g} m/s the slowest vehicle flies {speed * lag_s:.3g} m, the pad's radius is "
              f"{pad_m:g} m",
              'choose filter = "robust", or lower limits.velocity_max_m_s; or velocity_loop.lag_xy_s if it '
              "is less", PROOF),
        Check("position loop", "the position loop is damped with the slowest vehicle",
              0.5 - max(kx, ky) * lag_s, "", f"gain {max(kx, ky):g} 1/s at a lag of {lag_s:.3g} s",
              "lower position_loop.gain_1_s", PROOF),
        Check("position loop, vertical", "the vertical position loop is damped with the slowest vehicle",
              0.5 - kz * settles_s, "", f"gain {kz:g} 1/s at a lag of {settles_s:.3g} s",
              "lower position_loop.gain_1_s", PROOF),
        Check("position loop, filter", "the vehicle comes to the middle more quickly than h may fall",
              min(kx, ky, kz) - QUICKER * omega_1_s, "1/s",
              f"gain {min(kx, ky, kz):g}, omega {omega_1_s:g}",
              f"raise position_loop.gain_1_s to {QUICKER:g} times barrier.omega_1_s, or lower that", PROOF),
        Check("limits.velocity_max_m_s", "the vehicle overtakes the target",
              overtakes_m_s - FASTER * target_m_s, "m/s",
              f"found {overtakes_m_s:g}, the target has {target_m_s:g}",
              f"raise it to {FASTER:g} times touchdown.target_speed_max_m_s", PROOF),
        Check("climb", "the vehicle climbs as fast as the boundary rises over a target that turns back",
              vz - rises_m_s, "m/s",
              f"slope {barrier.slope_max:.3g} at {target_m_s:g} m/s, the vehicle climbs with {vz:g} m/s",
              "lower the slope alpha * beta, or raise limits.velocity_max_m_s", PROOF),
        Check("cone", "as low as a touchdown, a vehicle above the barrier is within half the pad's radius",
              half_m - touch_m, "m", f"there the boundary is {half_m:.3g} m high, {key} is {touch_m:g} m",
              f"raise the slope alpha * beta, or lower {key.split()[-1]}", PROOF),
        Check("barrier.omega_1_s", "h may fall more slowly than the vertical velocity settles",
              1.0 - omega_1_s * settles_s, "",
              f"omega {omega_1_s:g}, the slowest vehicle lags {settles_s:.3g} s", "lower barrier.omega_1_s",
              PROOF),
        Check("slew", "the command may change as quickly as the target's velocity",
              min(ax, ay) - target_m_s2, "m/s^2", f"found {min(ax, ay):g}, the target has {target_m_s2:g}",
              "raise limits.slew_max_m_s2", PROOF),
        Check("tick",
              f"a tick is no longer than the vehicle's lag, or than {TICK_S:g} s if the lag is shorter",
              quick_s - tick_s, "s", f"found {tick_s:.3g}, the lag is {loop.lag_xy_s:g}",
              "raise loop.rate_hz", PROOF),
    ]  # fmt: skip

"""Is the quadratic program feasible for these parameters, bounds and target speeds? Checked before take-off.

On the boundary h = 0 the program needs some u in the box with ``g . (u - v_target) >= 0``. The gradient is
``(-s n, 1)`` with a horizontal unit vector n and a slope s between -alpha beta / e^2 and alpha beta. The best
u gives ``v_z + |s| (|n_x| v_x + |n_y| v_y)``, the worst target takes ``|s| v_target``. Their difference is
linear in s and smallest along the tighter axis: the worst point is an end of the slope's range, and the
bound below is exact, not a sample.
"""

from __future__ import annotations

import math

from flightstack.config import FlightConfig


def problems(config: FlightConfig) -> list[str]:
    """Reasons for which this configuration must not fly; empty if it may."""
    barrier = config.barrier.build()
    vx, vy, vz = config.limits.velocity_max_m_s
    target = config.touchdown.target_speed_max_m_s
    omega = config.barrier.omega_1_s
    found = []
    lateral = min(vx, vy)
    room = vz + barrier.slope_max * (lateral - target)
    if room < 0.0:
        found.append(
            f"barrier: at slope {barrier.slope_max:.3g} a target of {target:g} m/s outruns the box by "
            f"{-room:.3g} m/s: lower touchdown.target_speed_max_m_s or the slope alpha * beta, or raise "
            "limits.velocity_max_m_s"
        )
    if omega / config.loop.rate_hz > 0.5:
        found.append(
            f"barrier.omega_1_s: found {omega:g}, at this rate at most {0.5 * config.loop.rate_hz:g}"
        )
    if config.touchdown.pad_radius_m * 0.5 > 1.0 / barrier.alpha_1_m:
        found.append(
            f"barrier: its peak at {barrier.peak_distance_m:.3g} m lies over the pad of radius "
            f"{config.touchdown.pad_radius_m:g} m: make it wider"
        )
    for axis, (gain, limit) in enumerate(
        zip(config.position_loop.gain_1_s, config.limits.velocity_max_m_s, strict=True)
    ):
        if gain / config.loop.rate_hz > 0.5:
            found.append(
                f"position_loop.gain_1_s[{axis}]: found {gain:g}, at most {0.5 * config.loop.rate_hz:g}"
            )
        step = config.limits.slew_max_m_s2[axis] / config.loop.rate_hz
        if not math.isfinite(step) or step > 2.0 * limit:
            found.append(
                f"limits.slew_max_m_s2[{axis}]: found {config.limits.slew_max_m_s2[axis]:g}, no limit "
                f"at {config.loop.rate_hz} Hz; at most {2.0 * limit * config.loop.rate_hz:g}"
            )
    return found

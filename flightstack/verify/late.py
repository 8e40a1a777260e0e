"""Check that errors decay in the loop of position control, lag compensation and vehicle, for all lags.

docs/how_it_works/robust_filter.md, *Limits of the lead*: one axis is simulated tick by tick with the filter's
functions (``velocity_tracking.py``), which are linear within their bounds. So a matrix describes a tick.
Delays are rounded to whole ticks. Only vehicles on a grid are checked: the decay rate is continuous in the
parameters of a vehicle, and the required rate leaves room for vehicles between the grid points.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.strategies.velocity_tracking import lead_carried, lead_commanded, lead_observed
from flightstack.verify.envelope import Extremes
from flightstack.verify.feedback import F64, matrix_exp
from flightstack.verify.types import PROOF, Check

DAMPING_MIN = 0.5  # minimum damping of the position loop around the lagging velocity loop
LATE_TICKS = 1  # number of ticks between the inputs and their set-point
MIN_DECAY_1_S = 0.1  # required decay rate, 1/s: an error halves in 7 s; for gains below 0.2, half the gain
SLOWER = (-1.0, -0.5, 0.0, 0.5, 1.0)  # checked deviations from the declared lag, divided by ``lag_spread``
RESPONSES = (1.0, 1.15, 1.3)  # ratios of steady velocity to set-point; identified vehicles reach 1.3
# Ratio of steady velocity to set-point at which a loop with a dead time must still be stable: its phase lag
# has no bound, so only the gain limits oscillation. Identified gains are means of large and small commands.
RESPONSE_LATE = 1.35 * RESPONSES[-1]
# Number of states before the queues: position relative to the target, velocity, acceleration; velocity and
# derivative of the model, disturbance, slope, velocity command; velocity of the target, and error of the
# velocity command. The queues contain set-points and vehicle states that are still delayed.
STATES = 10
_TARGET, _ERROR = 8, 9


def tick_matrix(config: FlightConfig, gain_1_s: float, slower: float, response: float) -> F64:
    """Return the state-transition matrix of one tick.

    ``gain_1_s``: gain of the position loop; ``slower``: ratio of lag and dead time to the declared ones;
    ``response``: ratio of steady velocity to set-point.
    """
    loop, period_s = config.velocity_loop, 1.0 / config.loop.rate_hz
    free = replace(loop, error_max_m_s=math.inf, disturbance_max_m_s=1e9)
    late = loop.late_ticks(period_s)
    acts = LATE_TICKS + round(slower * loop.dead_time_s / period_s)
    aged = round(config.own.delay_s / period_s)
    w = loop.rate_xy_1_s / slower
    rates = np.eye(4, k=1)  # derivatives of position, velocity, acceleration and (constant) set-point
    rates[2] = 0.0, -w * w, -2.0 * loop.damping * w, response * w * w
    step = matrix_exp(rates * period_s)[:3].tolist()
    sent = max(late, acts) + 1  # number of stored set-points, the newest last
    size = STATES + sent + 2 * aged

    def tick(x: Sequence[float]) -> list[float]:
        p, v, a, m, dm, d, s, before, target, error = x[:STATES]
        line, samples = list(x[STATES : STATES + sent]), list(x[STATES + sent :])
        u = line[-1 - acts]
        p -= period_s * target
        p, v, a = (row[0] * p + row[1] * v + row[2] * a + row[3] * u for row in step)
        samples += [p, v]
        reported_p, reported_v, *samples = samples
        reported_p += config.own.delay_s * (reported_v - target)
        m, dm, d = lead_observed(free, period_s, reported_v, line[-1 - late], m, dm, d)
        distance_m, then = lead_carried(free, period_s, reported_v, m, dm, line[sent - late :])
        wanted = target - gain_1_s * (reported_p + distance_m - loop.dead_time_s * target) + error
        s, u = lead_commanded(free, period_s, before, wanted, then, s, d, math.inf)
        return [p, v, a, m, dm, d, s, wanted, target, 0.0, *line[1:], u, *samples]

    return np.array([tick(unit) for unit in np.eye(size).tolist()]).T


def decay_1_s(config: FlightConfig, gain_1_s: float, slower: float, response: float) -> float:
    """Return the decay rate of an error, 1/s; it is negative for an unstable loop."""
    whole = tick_matrix(config, gain_1_s, slower, response)
    own = np.delete(np.delete(whole, _TARGET, 0), _TARGET, 1)  # without the constant target velocity
    return -math.log(float(np.abs(np.linalg.eigvals(own)).max())) * config.loop.rate_hz


def drift_m(config: FlightConfig, x: Extremes, time_s: float) -> tuple[float, float]:
    """Return a vehicle's largest distance from the pad's centre, m, and its lag divided by the declared one.

    The distance holds until ``time_s`` after the start of the final descent. It is the free motion from the
    maximum distance and speed at the start, plus the effects of the target's acceleration and of the velocity
    command's error. Each effect is the bound of the input times the sum of the absolute impulse response.
    """
    slower = [1.0 + share * config.envelope.lag_spread for share in SLOWER]
    return max((_drift_m(config, x, time_s, lag, each), lag) for lag in slower for each in RESPONSES)


def _drift_m(config: FlightConfig, x: Extremes, time_s: float, slower: float, response: float) -> float:
    robust, period_s = config.robust, 1.0 / config.loop.rate_hz
    gain, slip = robust.gain_over_pad_1_s, robust.commit_speed_m_s + x.velocity_error_m_s
    step = tick_matrix(config, gain, slower, response)
    now, sent = np.zeros((len(step), 4)), len(step) - 2 * round(config.own.delay_s / period_s)
    now[0, 0] = now[sent::2, 0] = robust.commit_radius_m + x.position_error_m
    now[[1, 3, 7], 1] = now[STATES:sent, 1] = now[sent + 1 :: 2, 1] = slip
    now[_TARGET, 2] = x.target_acceleration_m_s2 * period_s
    now[_ERROR, 3] = x.velocity_error_m_s + gain * x.position_error_m
    farthest, pushed = 0.0, 0.0
    for _ in range(math.ceil(time_s / period_s)):
        now = step @ now
        distances = np.abs(now[0])
        pushed += float(distances[2:].sum())
        farthest = max(farthest, float(distances[:2].sum()) + pushed)
    return farthest


def comes_to_rest(config: FlightConfig) -> list[Check]:
    """Return the checks of the damping and the decay of errors."""
    robust, spread, loop = config.robust, config.envelope.lag_spread, config.velocity_loop
    lag_s, descent = (1.0 + spread) * loop.lag_xy_s, robust.gain_descent_1_s
    over, key = max((robust.gain_over_pad_1_s, "gain_over_pad_1_s"), (descent, "gain_descent_1_s"))
    damping = 0.5 / math.sqrt(over * lag_s) if lag_s > 0.0 else math.inf
    gains = {
        robust.gain_1_s: "gain_1_s",
        robust.gain_over_pad_1_s: "gain_over_pad_1_s",
        robust.to_contact_1_s: "gain_descent_1_s" if descent else "gain_over_pad_1_s",
    }
    rows = [
        (decay_1_s(config, gain, slower, response) - needed, needed, gain, slower, response)
        for gain in gains
        for slower in (1.0 + share * spread for share in SLOWER)
        for response, needed in [
            *((each, min(MIN_DECAY_1_S, 0.5 * gain)) for each in RESPONSES),
            *([(RESPONSE_LATE, 0.0)] if loop.dead_time_s > 0.0 else []),
        ]
    ]
    slack, least_1_s, slack_gain, *_ = min(row for row in rows if row[3:] == (1.0, 1.0))
    room, needed, gain, slower, response = min(rows)
    remedy = "lower robust.{} or velocity_loop.gain_xy, or identify the loop again (flightstack identify)"
    return [
        Check("position loop",
              f"the descent's position loop is damped by {DAMPING_MIN:g} at least with the slowest vehicle",
              damping - DAMPING_MIN, "",
              f"gain {over:.3g} 1/s at a lag of {lag_s:.3g} s: damping {damping:.3g}",
              f"lower robust.{key}", PROOF),
        Check("lead", "the loop of position and lead is stable for the declared vehicle", slack, "1/s",
              f"an error decays at {slack + least_1_s:.3g} 1/s, least: {least_1_s:g}",
              remedy.format(gains[slack_gain])),
        Check("lead, spread", "the loop of position and lead is stable for each vehicle of the spread", room,
              "1/s",
              f"an error decays at {room + needed:.3g} 1/s with {slower:.3g} times the lag and "
              f"{response:.3g} times the velocity commanded, {needed:g} are needed",
              remedy.format(gains[gain]), PROOF),
    ]  # fmt: skip

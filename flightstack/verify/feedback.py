"""Check that the loop with velocity and disturbance feedback is stable for every declared vehicle.

``linear`` is the loop x' = A x: the vehicle's own loop as in velocity_tracking.py, the position loop over the
pad around it, and the delay as a first-order Padé element. A depends linearly on the vehicle through W = w^2
and D = 2 z w. Over a small piece of the spread, with (W, D) in a rectangle, a quadratic Lyapunov function
that decays at the four corners therefore decays in the whole rectangle (a convex hull of matrices). Pieces
for which this fails are halved. With an estimated vehicle state (``own.velocity_error_m_s``) the states of
the estimator replace those of the observer.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import numpy.typing as npt

from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.target.own_estimator import PUSH_TIME_S, steady_gains
from flightstack.verify.types import Check, Need

F64 = npt.NDArray[np.float64]
TICKS_LATE = 1.5  # delay of a set-point in ticks: a mean of half a tick, and one tick after its inputs
SHARE = 0.5  # required decay rate of a piece, as a share of the rate at its middle
PIECE_MIN = 1e-6  # least size of a piece, in the spread's factor; if it fails, the loop is unstable
PIECES_MAX = 10_000
# Largest ratio of feedback rate to velocity loop rate. The model omits motors and attitude loop: at a ratio
# of 3 the 1 kg quadrotor oscillates at 1.8 Hz (tilts of 45 degrees), with 2.5 it lands (150 of 150).
BANDWIDTH = 2.5
# Smallest ratio of observer rate to velocity loop rate. The filter's margins assume that the observer finds a
# disturbance while the loop answers: at a ratio of 0.2, 6 of 400 landings of `field` violate, at 0.3 one, at
# 0.4 and 0.5 none.
OBSERVER = 0.5
MIN_DECAY_1_S = 0.1  # required proven decay rate: half of an error in seven seconds


def linear(config: FlightConfig, faster: float, damped: float | None = None) -> F64:
    """Return the loop's matrix for a vehicle whose velocity loop is ``faster`` than the declared one.

    Its D is ``damped`` times the declared one; the default is the factor of w.

    States: position relative to the target, velocity, acceleration; state of the delay; velocity,
    acceleration and disturbance of the observer; smoothed derivative of the velocity command.
    """
    damped = faster if damped is None else damped
    if config.own.learns:
        return _estimated(config, faster, damped)
    loop, feedback, period_s = config.velocity_loop, config.velocity_feedback, 1.0 / config.loop.rate_hz
    gain, told_s = config.robust.gain_over_pad_1_s, config.own.delay_s
    w, drag = loop.rate_xy_1_s, 2.0 * loop.damping * loop.rate_xy_1_s
    late_s = told_s + TICKS_LATE * period_s
    p, v, a, held, m, dm, f, s = np.eye(8)
    measured = held - v
    observed = measured + told_s * (dm + f)
    missed = measured - m
    wanted, wanted_slope = -gain * p, -gain * v
    now = m + told_s * (dm + f)
    aim = s + feedback.error_rate_1_s * (wanted - now) - f
    u = now + (drag * dm + feedback.tilt_rate_1_s * (aim - dm)) / (w * w)
    observer = feedback.observer_rate_1_s
    return np.array(
        [
            v,
            a,
            (faster * w) ** 2 * (u - v) - damped * drag * a,
            (2.0 * v - held) * 2.0 / late_s,
            dm + f + 2.0 * observer * missed,
            w * w * (u - observed) - drag * dm,
            observer * observer * missed,
            (wanted_slope - s) / max(loop.slope_time_s, period_s),
        ]
    )


def _estimated(config: FlightConfig, faster: float, damped: float) -> F64:
    """Return the matrix of ``linear`` with the estimator of the vehicle state, whose gains act once a tick.

    States: position relative to the target, velocity, acceleration; states of the delay for position and
    velocity; the five states of the estimator, at the time of the measurement; smoothed derivative of the
    velocity command.
    """
    loop, feedback, period_s = config.velocity_loop, config.velocity_feedback, 1.0 / config.loop.rate_hz
    gain, told_s = config.robust.gain_over_pad_1_s, config.own.delay_s
    w, drag = loop.rate_xy_1_s, 2.0 * loop.damping * loop.rate_xy_1_s
    late_s = told_s + TICKS_LATE * period_s
    p, v, a, held_p, held_v, q, m, dm, e, f, s = np.eye(11)
    position, velocity = held_p - p - q, held_v - v - m - e  # innovations of the measurements
    now_p, now_m = q + told_s * m, m + told_s * (dm + f)
    aim = s + feedback.error_rate_1_s * (-gain * now_p - now_m) - f
    u = now_m + e + (drag * dm + feedback.tilt_rate_1_s * (aim - dm)) / (w * w)  # set-point of the velocity
    gains = steady_gains(loop, config.own, period_s)
    added = [(k * position + j * velocity) / period_s for k, j in zip(*gains, strict=True)]
    fades_1_s, push_fades_1_s = 1.0 / config.own.velocity_error_time_s, 1.0 / PUSH_TIME_S
    return np.array(
        [
            v,
            a,
            (faster * w) ** 2 * (u - v) - damped * drag * a,
            (2.0 * p - held_p) * 2.0 / late_s,
            (2.0 * v - held_v) * 2.0 / late_s,
            m + added[0],
            dm + f + added[1],
            w * w * (u - m - e) - drag * dm + added[2],
            added[3] - fades_1_s * e,
            added[4] - push_fades_1_s * f,
            (-gain * now_m - s) / max(loop.slope_time_s, period_s),
        ]
    )


def decay_1_s(config: FlightConfig, slower: float, faster: float) -> tuple[float, float]:
    """Return the proven decay rate of all loops between two factors, 1/s, and its factor."""
    least, where = math.inf, 1.0
    pieces = [(slower, faster)]
    for _ in range(PIECES_MAX):
        if not pieces:
            return least, where
        low, high = pieces.pop()
        middle = 0.5 * (low + high)
        centre = linear(config, middle)
        fastest = -float(np.linalg.eigvals(centre).real.max())
        if fastest <= 0.0:
            return fastest, middle
        if _decays(config, centre, SHARE * fastest, low, high):
            if SHARE * fastest < least:
                least, where = SHARE * fastest, middle
        elif high - low < PIECE_MIN:
            return 0.0, middle
        else:
            pieces += [(low, middle), (middle, high)]
    return 0.0, where


def _decays(config: FlightConfig, centre: F64, rate_1_s: float, low: float, high: float) -> bool:
    """Return whether one quadratic function decays at this rate in the whole rectangle of (W, D)."""
    # Lyapunov function: the sum of squares of the modes at the middle
    modes = np.linalg.inv(np.linalg.eig(centre).eigenvectors)
    shape: F64 = (modes.conj().T @ modes).real
    if not float(np.linalg.eigvalsh(shape)[0]) > 0.0:
        return False
    for stiff, damped in itertools.product((low, high), repeat=2):
        corner = linear(config, stiff, damped) + rate_1_s * np.eye(len(centre))
        if not float(np.linalg.eigvalsh(corner.T @ shape + shape @ corner)[-1]) < 0.0:
            return False
    return True


def comes_to_rest(config: FlightConfig) -> list[Check]:
    spread = config.envelope.lag_spread
    remedy = (
        "lower velocity_feedback.error_rate_1_s, far_error_rate_1_s or observer_rate_1_s, or "
        "robust.gain_over_pad_1_s and gain_descent_1_s, or raise loop.rate_hz"
    )
    # one setting, unless the gains in the final descent or far away differ
    flown = {config, config.descending, config.far}
    told = min(decay_1_s(one, 1.0, 1.0)[0] for one in flown)
    fastest = max(_bandwidth(one) for one in flown)
    observer = config.velocity_feedback.observer_rate_1_s / config.velocity_loop.rate_xy_1_s
    wanted_m_s2, most_m_s2 = max(config.slew_max_m_s2[:2]), config.velocity_feedback.acceleration_max_m_s2
    least, where = min(decay_1_s(one, 1.0 / (1.0 + spread), 1.0 / (1.0 - spread)) for one in flown)
    return [
        Check(
            "velocity feedback",
            "the feedback loop is stable for the declared vehicle",
            told - MIN_DECAY_1_S,
            "1/s",
            f"decays at {told:.3g} 1/s at least, {MIN_DECAY_1_S:g} are needed",
            remedy,
        ),
        Check(
            "velocity feedback, spread",
            "the feedback loop is stable for each vehicle of the spread",
            least - MIN_DECAY_1_S,
            "1/s",
            f"decays at {least:.3g} 1/s at least, with a velocity loop {where:.3g} times as fast as declared",
            f"lower envelope.lag_spread, or {remedy}",
            Need.PROOF,
        ),
        Check(
            "velocity feedback, model",
            "the feedback is no faster than the model of the velocity loop is valid",
            BANDWIDTH - fastest + 1e-9,
            "times",
            f"{fastest:.3g} times as fast as velocity_loop.rate_xy_1_s, {BANDWIDTH:g} are allowed",
            "lower velocity_feedback.tilt_rate_1_s or error_rate_1_s, and the far ones",
            Need.PROOF,
        ),
        Check(
            "velocity_feedback.observer_rate_1_s",
            "the observer is quick enough beside the velocity loop",
            observer - OBSERVER + 1e-9,
            "times",
            f"{observer:.3g} times velocity_loop.rate_xy_1_s, {OBSERVER:g} are required",
            "raise velocity_feedback.observer_rate_1_s",
            Need.PROOF,
        ),
        Check(
            "velocity_feedback.acceleration_max_m_s2",
            "the feedback allows the acceleration of the commanded velocity",
            most_m_s2 - wanted_m_s2,
            "m/s^2",
            f"found {most_m_s2:g}, robust.acceleration_max_m_s2 allows {wanted_m_s2:g}",
            "raise velocity_feedback.acceleration_max_m_s2, or lower robust.acceleration_max_m_s2",
            Need.PROOF,
        ),
    ]


def _bandwidth(config: FlightConfig) -> float:
    """Return the rate of the feedback, as it acts on an error, over that of the velocity loop."""
    feedback, rate_1_s = config.velocity_feedback, config.velocity_loop.rate_xy_1_s
    return feedback.tilt_rate_1_s / rate_1_s * max(1.0, feedback.error_rate_1_s / rate_1_s)

"""Check that the loop with velocity and disturbance feedback is stable for every declared vehicle.

docs/how_it_works/robust_filter.md, *Velocity feedback*, derives both bounds and gives the measurements behind
the limits. ``linear`` is the loop x' = A x, with the delay as a first-order Padé element; A depends linearly
on the vehicle through W = w^2 and D = 2 zeta w (w: natural frequency, zeta: damping). ``follow_m`` bounds the
distance between the pad's centre and a vehicle that follows its target. An interval of the lag spread
without a proof, or with a large bound, is halved.
"""

from __future__ import annotations

import heapq
import itertools
import math

import numpy as np
import numpy.typing as npt

from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.target.own_estimator import PUSH_TIME_S, steady_gains
from flightstack.verify.envelope import Extremes
from flightstack.verify.types import PROOF, Check

F64 = npt.NDArray[np.float64]
TICKS_LATE = 1.5  # delay of a set-point, ticks: on average half a tick, plus one tick after its inputs
SHARE = 0.5  # ratio of the required decay rate on an interval of the lag spread to the rate at its centre
PIECE_MIN = 1e-6  # minimum width of an interval of lag factors; without a proof there: decay rate 0
BANDWIDTH = 2.5  # maximum ratio of feedback rate to velocity loop rate; the model omits motors and attitude
OBSERVER = 0.5  # minimum ratio of observer rate to velocity loop rate, so that a disturbance is found soon
# maximum acceleration that velocity_loop.error_max_m_s may cause, m/s^2, so that the linear model holds
ACCELERATION_MAX_M_S2 = 3.0
MIN_DECAY_1_S = 0.1  # required proven decay rate, 1/s: an error halves in 7 s


def linear(config: FlightConfig, faster: float, damped: float | None = None) -> F64:
    """Return the loop's matrix for a vehicle whose w is ``faster`` times the declared one.

    D is ``damped`` times the declared D; the default of ``damped`` is ``faster``. The gains of the vehicle
    state's estimator act once a tick.

    States: position relative to the target, velocity, acceleration; state of the delay; velocity,
    acceleration and disturbance of the observer; smoothed derivative of the velocity command. With an
    estimated vehicle state: states of the delay for position and velocity; the five states of the estimator,
    at the time of the measurement; smoothed derivative.
    """
    loop, feedback, period_s = config.velocity_loop, config.velocity_feedback, 1.0 / config.loop.rate_hz
    gain, delay_s, learns = config.robust.gain_over_pad_1_s, config.own.delay_s, config.own.learns
    w, drag = loop.rate_xy_1_s, 2.0 * loop.damping * loop.rate_xy_1_s
    late_s = delay_s + TICKS_LATE * period_s
    if learns:
        p, v, a, late_p, late_v, q, m, dm, e, f, s = np.eye(11)
        now = m + delay_s * (dm + f)
        wanted, slope = -gain * (q + delay_s * m), -gain * now
    else:
        p, v, a, late_v, m, dm, f, s = np.eye(8)
        now, e = m + delay_s * (dm + f), 0.0 * p  # the reported velocity has no error
        wanted, slope = -gain * p, -gain * v
    aim = s + feedback.error_rate_1_s * (wanted - now) - f
    u = now + e + (drag * dm + feedback.tilt_rate_1_s * (aim - dm)) / (w * w)  # set-point of the velocity
    flown = (faster * w) ** 2 * (u - v) - (faster if damped is None else damped) * drag * a
    held = (2.0 * v - late_v) * 2.0 / late_s
    smoothed = (slope - s) / max(loop.slope_time_s, period_s)
    if not learns:
        measured = late_v - v
        observed, missed = measured + delay_s * (dm + f), measured - m
        observer = feedback.observer_rate_1_s
        model = w * w * (u - observed) - drag * dm
        observes = (dm + f + 2.0 * observer * missed, model, observer * observer * missed)
        return np.array([v, a, flown, held, *observes, smoothed])
    position, velocity = late_p - p - q, late_v - v - m - e  # innovations of the measurements
    gains = steady_gains(loop, config.own, period_s)
    added = [(k * position + j * velocity) / period_s for k, j in zip(*gains, strict=True)]
    moves = (
        m, dm + f, w * w * (u - m - e) - drag * dm, -1.0 / config.own.velocity_error_time_s * e,
        -1.0 / PUSH_TIME_S * f,
    )  # fmt: skip
    learned = [move + more for move, more in zip(moves, added, strict=True)]
    return np.array([v, a, flown, (2.0 * p - late_p) * 2.0 / late_s, held, *learned, smoothed])


def decay_1_s(config: FlightConfig, low: float, high: float) -> tuple[float, float]:
    """Return the proven decay rate of all loops between two factors, 1/s, and the slowest loop's factor."""
    middle = 0.5 * (low + high)
    centre = linear(config, middle)
    fastest = -float(np.linalg.eigvals(centre).real.max())
    if fastest <= 0.0:
        return fastest, middle
    if _decays(config, centre, SHARE * fastest, low, high):
        return SHARE * fastest, middle
    if high - low < PIECE_MIN:
        return 0.0, middle
    upper = decay_1_s(config, middle, high)
    return upper if upper[0] <= 0.0 else min(upper, decay_1_s(config, low, middle))


def _decays(config: FlightConfig, centre: F64, rate_1_s: float, low: float, high: float) -> bool:
    """Whether one quadratic function decays at this rate in the whole rectangle of (W, D)."""
    # Lyapunov function: the sum of squares of the modes at the centre
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
    # configurations with different gains: over the pad, final descent, far from the pad
    flown = {config, config.descending, config.far}
    decay = min(decay_1_s(one, 1.0, 1.0)[0] for one in flown)
    fastest = max(_bandwidth(one) for one in flown)
    observer = config.velocity_feedback.observer_rate_1_s / config.velocity_loop.rate_xy_1_s
    wanted_m_s2, most_m_s2 = max(config.slew_max_m_s2[:2]), config.velocity_feedback.acceleration_max_m_s2
    loop = config.velocity_loop
    tilted_m_s2 = loop.error_max_m_s * loop.rate_xy_1_s / (2.0 * loop.damping)
    least, where = min(decay_1_s(one, 1.0 / (1.0 + spread), 1.0 / (1.0 - spread)) for one in flown)
    return [
        Check("velocity feedback", "the feedback loop is stable for the declared vehicle",
              decay - MIN_DECAY_1_S, "1/s",
              f"decays at {decay:.3g} 1/s at least, {MIN_DECAY_1_S:g} are needed", remedy),
        Check("velocity feedback, spread", "the feedback loop is stable for each vehicle of the spread",
              least - MIN_DECAY_1_S, "1/s",
              f"decays at {least:.3g} 1/s at least, with a velocity loop {where:.3g} times as fast as "
              "declared",
              f"lower envelope.lag_spread, or {remedy}", PROOF),
        Check("velocity feedback, model",
              "the feedback is no faster than the model of the velocity loop is valid",
              BANDWIDTH - fastest + 1e-9, "times",
              f"{fastest:.3g} times as fast as velocity_loop.rate_xy_1_s, {BANDWIDTH:g} are allowed",
              "lower velocity_feedback.tilt_rate_1_s or error_rate_1_s, and the far ones", PROOF),
        Check("velocity_feedback.observer_rate_1_s",
              "the observer is quick enough beside the velocity loop", observer - OBSERVER + 1e-9, "times",
              f"{observer:.3g} times velocity_loop.rate_xy_1_s, {OBSERVER:g} are required",
              "raise velocity_feedback.observer_rate_1_s", PROOF),
        Check("velocity_feedback.acceleration_max_m_s2",
              "the feedback allows the acceleration of the commanded velocity", most_m_s2 - wanted_m_s2,
              "m/s^2", f"found {most_m_s2:g}, robust.acceleration_max_m_s2 allows {wanted_m_s2:g}",
              "raise velocity_feedback.acceleration_max_m_s2, or lower robust.acceleration_max_m_s2", PROOF),
        Check("velocity_loop.error_max_m_s, feedback",
              "the vehicle tilts no more than the model of the velocity loop is valid for",
              ACCELERATION_MAX_M_S2 - tilted_m_s2, "m/s^2",
              f"found {loop.error_max_m_s:g}, which accelerates with {tilted_m_s2:.3g} m/s^2; "
              f"{ACCELERATION_MAX_M_S2:g} are allowed",
              "lower velocity_loop.error_max_m_s", PROOF),
    ]  # fmt: skip


def _bandwidth(config: FlightConfig) -> float:
    """Return the ratio of the feedback's bandwidth to that of the velocity loop."""
    feedback, rate_1_s = config.velocity_feedback, config.velocity_loop.rate_xy_1_s
    return feedback.tilt_rate_1_s / rate_1_s * max(1.0, feedback.error_rate_1_s / rate_1_s)


STEP_S = 3e-3  # step of the impulse responses, s; the values between two steps are bounded
DOUBLINGS = (11, 14)  # minimum and maximum number of doublings: responses of 6 to 49 s; the rest is bounded
SLACK = 0.03  # maximum fraction of a result that the vehicles beside the interval's centre can add
FOLLOW_PIECE_MIN = 1e-4  # minimum width of an interval of lag factors
_POSITION, _VELOCITY, _PULL, _HELD, _MODEL, _MODEL_PULL, _, _SLOPE = range(8)  # state indices of ``linear``
_TARGET, _ERROR, _OTHER = range(3)  # indices of the loop's inputs


def follow_m(config: FlightConfig, x: Extremes) -> tuple[float, float]:
    """Return the largest distance between pad centre and a following vehicle, m, and the worst factor.

    The distance is infinite if no bound is proven, and always for an estimated vehicle state. The factor is
    the ratio of the vehicle's velocity loop rate to the declared one.
    """
    if config.own.learns:
        return math.inf, 1.0

    def piece(low: float, high: float) -> tuple[float, float, float, float]:
        own_m, beside_m = _piece_m(config, x, low, high)
        return -(own_m + beside_m), own_m, low, high

    spread = config.envelope.lag_spread
    pieces = [piece(1.0 / (1.0 + spread), 1.0 / (1.0 - spread))]
    while True:  # the interval with the largest bound is first
        least, own_m, low, high = heapq.heappop(pieces)
        middle = 0.5 * (low + high)
        if -least <= (1.0 + SLACK) * own_m or high - low < FOLLOW_PIECE_MIN:
            return -least, middle
        for half in ((low, middle), (middle, high)):
            heapq.heappush(pieces, piece(*half))


def _piece_m(config: FlightConfig, x: Extremes, low: float, high: float) -> tuple[float, float]:
    """Return the bound of an interval's central vehicle, m, and the addition for its other vehicles, m."""
    middle, loop = 0.5 * (low + high), config.velocity_loop
    inputs, outputs, through = _ports(config, middle)
    gains = _gains(linear(config, middle), inputs, outputs)
    if gains is None:
        return math.inf, 0.0
    error_m_s = x.velocity_error_m_s + config.robust.gain_over_pad_1_s * x.position_error_m
    bounds = np.array([x.target_acceleration_m_s2, error_m_s])
    own = (gains + through)[:, :_OTHER] @ bounds  # bounds of position, of u - v, and of a
    w, drag = loop.rate_xy_1_s, 2.0 * loop.damping * loop.rate_xy_1_s
    stiff = max(high**2 - middle**2, middle**2 - low**2) * w * w
    differs = np.array([0.0, stiff, (high - middle) * drag])
    room = 1.0 - float(differs @ gains[:, _OTHER])
    if room <= 0.0:
        return float(own[0]), math.inf
    return float(own[0]), float(gains[0, _OTHER] * (differs @ own) / room)


def _ports(config: FlightConfig, factor: float) -> tuple[F64, F64, F64]:
    """Return input columns, output rows, and the direct feed-through from inputs to outputs.

    In s' = (r' - s) / T the derivative of r's error q is unbounded; therefore the state is s - q / T.
    """
    loop, feedback = config.velocity_loop, config.velocity_feedback
    w, drag = loop.rate_xy_1_s, 2.0 * loop.damping * loop.rate_xy_1_s
    smoothing_s = max(loop.slope_time_s, 1.0 / config.loop.rate_hz)
    inputs, outputs, through = np.zeros((8, 3)), np.zeros((3, 8)), np.zeros((3, 3))
    # the target's acceleration reduces relative velocities, and the delay's state twice as much
    inputs[[_VELOCITY, _HELD, _MODEL, _SLOPE], _TARGET] = -1.0, -2.0, -1.0, 1.0 / smoothing_s
    push = feedback.tilt_rate_1_s * (feedback.error_rate_1_s + 1.0 / smoothing_s)
    inputs[[_PULL, _MODEL_PULL, _SLOPE], _ERROR] = factor * factor * push, push, -1.0 / smoothing_s**2
    inputs[_PULL, _OTHER] = 1.0
    outputs[0, _POSITION] = outputs[2, _PULL] = 1.0
    flown = linear(config, factor)[_PULL]
    flown[_PULL] += factor * drag
    outputs[1] = flown / (factor * w) ** 2
    through[1, _ERROR] = push / (w * w)
    return inputs, outputs, through


def _gains(loop: F64, inputs: F64, outputs: F64) -> F64 | None:
    """Return the integrals of absolute impulse responses, outputs x inputs; None for an unstable loop.

    Between two steps of length h the integral differs from that of the straight line by at most h^3 / 12
    times the second derivative. After the last step, the remaining state starts the response again.
    """
    bend = np.abs(outputs @ loop @ loop) @ matrix_exp(np.abs(loop) * STEP_S)
    powers = np.eye(len(loop))[np.newaxis]
    factor = matrix_exp(loop * STEP_S)
    for doubling in range(1, DOUBLINGS[1] + 1):
        with np.errstate(over="ignore", invalid="ignore"):
            powers = np.concatenate([powers, powers @ factor])
            factor = factor @ factor
        if not np.isfinite(factor).all():
            return None  # the loop is unstable: its state exceeds the range of floats
        left = np.abs(factor)
        if doubling >= DOUBLINGS[0] and float(np.abs(np.linalg.eigvals(left)).max()) < 0.5:
            break
    else:
        return None

    def integral(columns: F64, last: F64) -> F64:
        states = powers @ columns
        found = np.abs(outputs @ states)
        ends = 0.5 * (np.abs(outputs @ last) - found[0])
        curved = STEP_S**3 / 12.0 * (bend @ np.abs(states).sum(axis=0))
        total: F64 = STEP_S * (found.sum(axis=0) + ends) + curved
        return total

    rest = np.linalg.inv(np.eye(len(loop)) - left) @ np.abs(factor @ inputs)
    gains: F64 = integral(inputs, factor @ inputs) + integral(np.eye(len(loop)), factor) @ rest
    return gains


def matrix_exp(matrix: F64) -> F64:
    """Return the exponential of a square matrix."""
    from scipy.linalg import expm  # imported late: it takes 0.5 s, and every process loads this module

    result: F64 = expm(matrix)
    return result

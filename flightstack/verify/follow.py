"""Bound of the distance from the pad's centre for a vehicle with velocity feedback that follows its target.

The loop x' = A x + B i of ``feedback.linear``, relative to the target, has two inputs of any sign at any
time: the target's acceleration, and the error q of the commanded velocity (error of the estimated velocity
plus the gain times that of the position). The absolute value of an output is at most the bounds of the inputs
times the integrals of the absolute impulse responses. The command is assumed to stay within the limits of the
feedback.

The vehicles between two factors are compared with the one in the middle. The difference is a third input of
the middle's loop, (W - W0) (u - v) - (D - D0) a. The bounds of u - v and a bound it, and contain it (small
gain theorem). A piece of the spread with a large or no bound is halved.
"""

from __future__ import annotations

import heapq
import math

import numpy as np
import numpy.typing as npt

from flightstack.core.parameters.flight import FlightConfig
from flightstack.verify.envelope import Extremes
from flightstack.verify.feedback import linear

F64 = npt.NDArray[np.float64]
STEP_S = 3e-3  # step of the impulse responses, s; their values between two steps are bounded
DOUBLINGS = (11, 14)  # numbers of doublings: responses of 6 s, or up to 49 s; the rest is bounded
SLACK = 0.03  # largest share of a piece's result that the vehicles beside its middle cause
PIECE_MIN = 1e-4  # least size of a piece, in units of the spread's factor
_POSITION, _VELOCITY, _PULL, _HELD, _MODEL, _MODEL_PULL, _, _SLOPE = range(8)  # states of ``linear``
_TARGET, _ERROR, _OTHER = range(3)  # inputs of the loop


def follow_m(config: FlightConfig, x: Extremes) -> tuple[float, float]:
    """Return the largest distance from the centre while the target is followed, and its vehicle.

    The distance is in m, infinite if no bound is proven; the vehicle is the factor of its velocity loop to
    the declared one. No bound is known for an estimated vehicle state: the distance is infinite.
    """
    if config.own.learns:
        return math.inf, 1.0
    spread = config.envelope.lag_spread
    low, high = 1.0 / (1.0 + spread), 1.0 / (1.0 - spread)
    pieces = [(*_reach_m(config, x, low, high), low, high)]
    while True:  # the piece with the largest bound is first
        least, own_m, low, high = heapq.heappop(pieces)
        if -least <= (1.0 + SLACK) * own_m or high - low < PIECE_MIN:
            return -least, 0.5 * (low + high)
        middle = 0.5 * (low + high)
        for half in ((low, middle), (middle, high)):
            heapq.heappush(pieces, (*_reach_m(config, x, *half), *half))


def _reach_m(config: FlightConfig, x: Extremes, low: float, high: float) -> tuple[float, float]:
    """Return minus the largest distance of all vehicles of a piece, and the distance of its middle one."""
    own_m, beside_m = _piece_m(config, x, low, high)
    return -(own_m + beside_m), own_m


def _piece_m(config: FlightConfig, x: Extremes, low: float, high: float) -> tuple[float, float]:
    """Return the bound of the vehicle in the middle of a piece, and the additional distance of the others."""
    middle, loop = 0.5 * (low + high), config.velocity_loop
    inputs, outputs, through = _ports(config, middle)
    gains = _gains(linear(config, middle), inputs, outputs)
    if gains is None:
        return math.inf, 0.0
    bounds = np.array(
        [
            x.target_acceleration_m_s2,
            x.velocity_error_m_s + config.robust.gain_over_pad_1_s * x.position_error_m,
        ]
    )
    own = (gains + through)[:, :_OTHER] @ bounds  # bounds of position, u - v, a
    w, drag = loop.rate_xy_1_s, 2.0 * loop.damping * loop.rate_xy_1_s
    stiff = max(high**2 - middle**2, middle**2 - low**2) * w * w
    differs = np.array([0.0, stiff, (high - middle) * drag])
    room = 1.0 - float(differs @ gains[:, _OTHER])
    if room <= 0.0:
        return float(own[0]), math.inf
    return float(own[0]), float(gains[0, _OTHER] * (differs @ own) / room)


def _ports(config: FlightConfig, factor: float) -> tuple[F64, F64, F64]:
    """Return input columns, output rows, and the direct feed-through from inputs to outputs.

    The smoothed derivative s' = (r' - s) / T contains q', which has no bound: the state is s - q / T.
    """
    loop, feedback = config.velocity_loop, config.velocity_feedback
    w, drag = loop.rate_xy_1_s, 2.0 * loop.damping * loop.rate_xy_1_s
    smoothing_s = max(loop.slope_time_s, 1.0 / config.loop.rate_hz)
    inputs, outputs, through = np.zeros((8, 3)), np.zeros((3, 8)), np.zeros((3, 3))
    # relative to the target, all velocities change sign, twice in the state of the delay
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

    Between two steps a response differs from the straight line by at most h^3 / 12 of its second derivative,
    in the integral. After the last step, the remaining state starts the response again.
    """
    step, grown = matrix_exp(loop * STEP_S), matrix_exp(np.abs(loop) * STEP_S)
    bend = np.abs(outputs @ loop @ loop) @ grown
    powers = np.eye(len(loop))[np.newaxis]
    factor = step
    for doubling in range(1, DOUBLINGS[1] + 1):
        with np.errstate(over="ignore", invalid="ignore"):
            powers = np.concatenate([powers, powers @ factor])
            factor = factor @ factor
        if not np.isfinite(factor).all():
            return None  # unstable, beyond the range of floats
        left = np.abs(factor)
        if doubling < DOUBLINGS[0] or not float(np.abs(np.linalg.eigvals(left)).max()) < 0.5:
            continue

        def integral(columns: F64, last: F64, powers: F64 = powers) -> F64:
            states = powers @ columns
            found = np.abs(outputs @ states)
            ends = 0.5 * (np.abs(outputs @ last) - found[0])
            curved = STEP_S**3 / 12.0 * (bend @ np.abs(states).sum(axis=0))
            total: F64 = STEP_S * (found.sum(axis=0) + ends) + curved
            return total

        rest = np.linalg.inv(np.eye(len(loop)) - left) @ np.abs(factor @ inputs)
        return integral(inputs, factor @ inputs) + integral(np.eye(len(loop)), factor) @ rest
    return None


def matrix_exp(matrix: F64) -> F64:
    """Return the exponential of a small matrix by a series whose remainder is below double precision."""
    total = term = np.eye(len(matrix))
    for order in range(1, 30):
        term = term @ matrix / order
        total = total + term
    return total

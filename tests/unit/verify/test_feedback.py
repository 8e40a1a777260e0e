"""Tests that the proof of the velocity feedback agrees with the controller's code on a plant with a delay."""

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.core.safety.barrier import Barrier
from flightstack.verify.bound import Shape, Span, most
from flightstack.verify.certificate import problems
from flightstack.verify.envelope import extremes
from flightstack.verify.feedback import SLACK, _piece_m, decay_1_s, follow_m, linear
from sim.scenarios.scenario import load
from tests.examples import examples
from tests.unit.core.strategies.loop_helpers import BASE, FEEDBACK, fed_back, flown_behind
from tests.unit.verify.certificate_helpers import config, one

pytestmark = pytest.mark.slow

STORM = load("storm").onboard


@given(st.floats(0.6, 1.0), st.floats(1.0, 1.6), st.floats(0.0, 1.0), st.floats(0.0, 1.0))
@examples(40)
def test_no_vehicle_within_decays_slower_than_proven(low, high, stiff, damped):
    """The loop decays at least as fast as proven, also if the factors of rate and damping differ slightly."""
    proven, _ = decay_1_s(STORM, low, high)
    factor = low + stiff * (high - low)
    assert proven <= max(0.0, -np.linalg.eigvals(linear(STORM, factor)).real.max())
    near = factor + 1e-3 * (damped - 0.5)
    assert proven <= max(0.0, -np.linalg.eigvals(linear(STORM, factor, near)).real.max())


FAR_SWINGS = {"far_error_rate_1_s": 20.0, "far_tilt_rate_1_s": 30.0}


@pytest.mark.parametrize(
    "wrong",
    [
        {"velocity_feedback": {**FEEDBACK, "error_rate_1_s": 20.0, "tilt_rate_1_s": 30.0}},
        {"velocity_feedback": {**FEEDBACK, **FAR_SWINGS, "far_m": 1.0}},
        {"loop": {"rate_hz": 20}},
        {"own": {"delay_s": 0.15}},
        {"robust": {"gain_descent_1_s": 5.0}, "own": {"delay_s": 0.06}},
    ],
)
def test_a_loop_that_swings_by_itself_must_not_fly(wrong):
    refused = problems(config(**{**BASE, **wrong}))
    assert any(text.startswith("velocity feedback:") for text in refused)


FED = fed_back(  # configuration in which the feedback does not reach its own limits
    velocity_feedback={"acceleration_max_m_s2": 20.0}, velocity_loop={"disturbance_max_m_s": 3.0}
)
SLOWEST, QUICKEST = 1.0 / 1.3, 1.0 / 0.7
LONG_S = 8.0


@cache
def promise_m():
    return follow_m(FED, extremes(FED))[0]


def turned_against(settings_, factor):
    """Return the target accelerations and velocity errors that cause the largest distance at the end.

    Both arrays have one value for each tick of the simulated loop.
    """
    x, gain, ticks = extremes(settings_), settings_.robust.gain_over_pad_1_s, round(LONG_S * 100)
    none, knock = np.zeros(ticks), np.zeros(ticks)
    knock[0] = 1e-3
    told = (
        flown_behind(settings_, factor, knock, none)[::-1],
        flown_behind(settings_, factor, none, knock)[::-1],
    )
    error = x.velocity_error_m_s + gain * x.position_error_m
    return np.sign(told[0]) * x.target_acceleration_m_s2, np.sign(told[1]) * error


def farthest(*flight):
    return float(np.abs(flown_behind(*flight)).max())


# a fast vehicle oscillates less than the loop's matrix, whose delay is equal at all frequencies
@pytest.mark.parametrize("factor", [SLOWEST, 0.9, 1.0, 1.15, 1.35])
def test_the_worst_target_and_errors_reach_what_is_promised_and_no_more(factor):
    promised, _ = _piece_m(FED, extremes(FED), factor, factor)
    reached = farthest(FED, factor, *turned_against(FED, factor))
    assert (0.9 * promised if factor <= 1.0 else 0.5 * promised) < reached <= promised
    assert promised <= promise_m()


def test_no_vehicle_hides_between_the_pieces():
    x = extremes(FED)
    bound, where = follow_m(FED, x)
    found = max(_piece_m(FED, x, f, f)[0] for f in np.linspace(SLOWEST, QUICKEST, 60))
    assert (1.0 - 2.0 * SLACK) * bound <= found <= bound
    assert SLOWEST <= where <= QUICKEST
    alone, beside = _piece_m(FED, x, 1.0, 1.0)
    assert beside == 0.0
    own, beside = _piece_m(FED, x, 0.99, 1.01)
    assert own == alone
    assert max(_piece_m(FED, x, f, f)[0] for f in (0.99, 0.995, 1.005, 1.01)) <= own + beside


def test_a_spread_with_a_vehicle_that_swings_has_no_bound():
    hard = fed_back(velocity_feedback={"error_rate_1_s": 9.0})
    assert math.isinf(follow_m(hard, extremes(hard))[0])
    assert (
        one("drift", **{**BASE, "velocity_feedback": {**FEEDBACK, "error_rate_1_s": 9.0}}).room == -math.inf
    )


INF = math.inf


def test_a_spike_that_a_grid_misses_is_found():
    at, wide = 0.123456789, 1e-4  # a grid of 1000 points has a value above 0.5 with a probability of 10 %

    def spike(x):
        return max(0.0, 1.0 - abs(x - at) / wide)

    def upper(span):
        return 1.0 if span.low <= at <= span.high else max(spike(span.low), spike(span.high))

    assert max(spike(x) for x in np.linspace(0.0, 1.0, 1001)) < 0.5
    assert spike(most(upper, Span(0.0, 1.0)).at) > 0.9999


def test_a_bound_that_is_not_a_number_is_refused():
    with pytest.raises(ValueError, match="not a number"):
        most(lambda _: math.nan, Span(0.0, 1.0))


@given(
    alpha=st.floats(0.3, 5.0),
    beta=st.floats(0.2, 4.0),
    low=st.one_of(st.just(0.0), st.floats(1e-3, 4.0)),
    width=st.floats(0.0, 3.0),
    margins=st.tuples(st.floats(0.0, 0.1), st.floats(0.0, 0.2)),
    fade=st.floats(0.02, 0.3),
)
def test_slope_and_curvature_lie_in_their_ranges(alpha, beta, low, width, margins, fade):
    m0, m1 = margins[0], margins[0] + margins[1]
    shape = Shape(Barrier(alpha, beta), Span(m0, m1), fade)
    span = Span(low, low + width)
    slope, bend, turn = shape.slope(span), shape.curvature_1_m(span), shape.turn_1_m(span)
    open_slope = shape.slope(Span(low, INF))
    d = np.linspace(low, low + width, 101)
    for m in (m0, m1):
        fading = np.exp(-((d / fade) ** 2)) * 2.0 * m / fade**2
        b1 = alpha * beta * (1 - alpha * d) * np.exp(-alpha * d) + fading * d
        b2 = alpha**2 * beta * (alpha * d - 2) * np.exp(-alpha * d) + fading * (1 - 2 * (d / fade) ** 2)
        assert slope.low <= b1.min() and b1.max() <= slope.high  # noqa: PT018
        assert open_slope.low <= b1.min() and b1.max() <= open_slope.high  # noqa: PT018
        assert bend.low <= b2.min() and b2.max() <= bend.high  # noqa: PT018
        if low > 0.0:
            assert (b1 / d).max() <= turn

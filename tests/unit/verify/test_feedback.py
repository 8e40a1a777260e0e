"""Proof of the velocity feedback compared with the flown code and a plant with a delay."""

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from flightstack.core.safety.barrier import Barrier
from flightstack.verify.bound import TOLERANCE, Shape, Span, most
from flightstack.verify.certificate import checks, problems
from flightstack.verify.envelope import extremes
from flightstack.verify.feedback import SLACK, _gains, _piece_m, _ports, decay_1_s, follow_m, linear
from sim.scenarios.scenario import load
from tests.unit.core.strategies.loop_helpers import BASE, FEEDBACK, fed_back, flown_behind
from tests.unit.verify.certificate_helpers import config, one

pytestmark = pytest.mark.slow

STORM = load("storm").onboard


@given(share=st.floats(0.0, 1.0))
@settings(max_examples=25, deadline=None)
def test_every_vehicle_of_the_spread_comes_to_rest_at_least_as_fast_as_proven(share):
    settings_ = fed_back()
    slower, faster = 1.0 / 1.3, 1.0 / 0.7
    proven, _ = decay_1_s(settings_, slower, faster)
    assert proven > 0.3
    path = np.abs(flown_behind(settings_, slower + share * (faster - slower), np.zeros(1400), start_m=0.05))
    early, late = path[200:500].max(), path[1000:1300].max()  # 8 s later
    assert late <= early * np.exp(-8.0 * proven) + 1e-12


@pytest.mark.parametrize("factor", [1.0 / 1.3, 1.0, 1.2])
def test_the_matrix_is_the_loop_that_flies(factor):
    """Compare the first 1.5 s of the return to the centre, with the ticks of the code."""
    settings_ = fed_back()
    period_s = 1.0 / settings_.loop.rate_hz
    state, step = np.zeros(8), expm(linear(settings_, factor) * period_s)
    state[0] = 0.05
    path = []
    for _ in range(150):
        state = step @ state
        path.append(state[0])
    assert np.abs(flown_behind(settings_, factor, np.zeros(150), start_m=0.05) - path).max() < 0.1 * 0.05


def test_a_vehicle_may_differ_in_rate_and_damping_on_their_own():
    a, b = linear(STORM, 1.1), linear(STORM, 1.1, 1.1)
    assert (a == b).all()
    assert np.flatnonzero(np.any(linear(STORM, 1.1, 0.9) != a, axis=1)).tolist() == [2]


@given(st.floats(0.6, 1.0), st.floats(1.0, 1.6), st.floats(0.0, 1.0), st.floats(0.0, 1.0))
@settings(max_examples=40, deadline=None)
def test_no_vehicle_within_decays_slower_than_proven(low, high, stiff, damped):
    """Rate and damping are tested separately near each other, where the rectangles are."""
    proven, _ = decay_1_s(STORM, low, high)
    factor = low + stiff * (high - low)
    assert proven <= max(0.0, -np.linalg.eigvals(linear(STORM, factor)).real.max())
    near = factor + 1e-3 * (damped - 0.5)
    assert proven <= max(0.0, -np.linalg.eigvals(linear(STORM, factor, near)).real.max())


def test_the_checks_are_there_with_feedback_alone():
    assert one("velocity feedback", **BASE).proven
    assert one("velocity feedback, spread", **BASE).proven
    names = {check.name for check in checks(config())}
    assert "position loop" in names
    assert not any(name.startswith("velocity feedback") for name in names)
    with_it = {check.name for check in checks(fed_back())}
    assert "position loop" not in with_it


def test_a_loop_that_swings_with_a_quicker_vehicle_is_not_proven_but_may_fly():
    hard = {"velocity_feedback": {**FEEDBACK, "error_rate_1_s": 9.0}}
    found = one("velocity feedback, spread", **{**BASE, **hard})
    assert not found.proven
    assert found.remedy
    assert one("velocity feedback", **{**BASE, **hard}).proven
    assert not [text for text in problems(config(**{**BASE, **hard})) if "velocity feedback" in text]


FAR_SWINGS = {"far_error_rate_1_s": 20.0, "far_tilt_rate_1_s": 30.0}


def test_rates_of_far_away_do_not_count_where_nothing_is_far_away():
    assert one("velocity feedback", **{**BASE, "velocity_feedback": {**FEEDBACK, **FAR_SWINGS}}).proven


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


LIMITED = fed_back()
FED = fed_back(  # the feedback's own limits are not reached
    velocity_feedback={"acceleration_max_m_s2": 20.0}, velocity_loop={"disturbance_max_m_s": 3.0}
)
SLOWEST, QUICKEST = 1.0 / 1.3, 1.0 / 0.7
LONG_S = 8.0


@cache
def promise_m():
    return follow_m(FED, extremes(FED))[0]


def responses(settings_, factor, step_s, seconds=LONG_S):
    """Return impulse responses of the position to target accelerations and velocity command errors."""
    inputs, outputs, _ = _ports(settings_, factor)
    step, states, found = expm(linear(settings_, factor) * step_s), inputs, []
    for _ in range(round(seconds / step_s)):
        found.append((outputs @ states)[0, :2])
        states = step @ states
    return np.array(found)


def turned_against(settings_, factor):
    """Return accelerations and errors, by tick, with the largest final distance that the flown loop
    allows."""
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


# a fast vehicle oscillates less than the matrix, whose delay acts equally on all frequencies
@pytest.mark.parametrize("factor", [SLOWEST, 0.9, 1.0, 1.15, 1.35])
def test_the_worst_target_and_errors_reach_what_is_promised_and_no_more(factor):
    promised, _ = _piece_m(FED, extremes(FED), factor, factor)
    reached = farthest(FED, factor, *turned_against(FED, factor))
    assert (0.9 * promised if factor <= 1.0 else 0.5 * promised) < reached <= promised
    assert promised <= promise_m()


@given(
    share=st.floats(0.0, 1.0),
    changes=st.lists(st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)), min_size=1, max_size=30),
)
@settings(max_examples=10, deadline=None)
def test_no_target_and_no_errors_get_farther(share, changes):
    x, gain = extremes(FED), FED.robust.gain_over_pad_1_s
    error = x.velocity_error_m_s + gain * x.position_error_m
    held = np.repeat(np.array(changes), math.ceil(400 / len(changes)), axis=0)
    promised = promise_m()
    factor = SLOWEST + share * (QUICKEST - SLOWEST)
    for settings_ in (FED, LIMITED):
        away = farthest(settings_, factor, held[:, 0] * x.target_acceleration_m_s2, held[:, 1] * error)
        assert away <= promised


@pytest.mark.parametrize("factor", [SLOWEST, 1.0, QUICKEST])
def test_the_integrals_lie_just_above_what_fine_steps_give(factor):
    """At factor 1 the observer's poles coincide, so nothing here may depend on separate modes."""
    inputs, outputs, _ = _ports(FED, factor)
    gains = _gains(linear(FED, factor), inputs, outputs)
    fine = 2e-4
    brute = np.abs(responses(FED, factor, fine, 20.0)).sum(axis=0) * fine
    assert (brute <= gains[0, :2] * 1.001).all()
    assert (gains[0, :2] <= 1.06 * brute).all()


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


def test_the_check_compares_it_with_the_pad():
    found = one("drift", **BASE)
    farthest_m, _ = follow_m(LIMITED, extremes(LIMITED))
    assert found.room == pytest.approx(0.1 - farthest_m)
    assert found.proven == (farthest_m < 0.1)
    calm = {**BASE, "envelope": {"target_acceleration_max_m_s2": 0.05, "lag_spread": 0.05}}
    assert one("drift", **calm).proven
    wild = {**BASE, "envelope": {"target_acceleration_max_m_s2": 3.0}}
    assert not one("drift", **wild).proven
    assert config().velocity_feedback.horizontal is False  # the lead has its own bound
    assert "after" in one("drift").worst


INF = math.inf


def test_the_largest_value_of_a_parabola_is_found():
    def upper(cell):
        near = min(max(0.3, cell[0].low), cell[0].high)
        return -((near - 0.3) ** 2)

    found = most(upper, lambda at: -((at[0] - 0.3) ** 2), (Span(0.0, INF),))
    assert 0.0 <= found.bound <= TOLERANCE
    assert found.at[0] == pytest.approx(0.3, abs=math.sqrt(TOLERANCE))


def test_a_spike_that_a_grid_misses_is_found():
    at, wide = 0.123456789, 1e-4  # a grid of a thousand points finds it with a chance of one in ten

    def spike(x):
        return max(0.0, 1.0 - abs(x - at) / wide)

    def upper(cell):
        (span,) = cell
        return 1.0 if span.low <= at <= span.high else max(spike(span.low), spike(span.high))

    assert max(spike(x) for x in np.linspace(0.0, 1.0, 1001)) < 0.5
    assert most(upper, lambda p: spike(p[0]), (Span(0.0, 1.0),)).found > 0.9999


def test_where_values_stay_open_the_bound_says_so():
    found = most(lambda _: 1.0, lambda _: 0.0, (Span(0.0, 1.0),))  # a bound that never becomes tight
    assert (found.bound, found.found) == (1.0, 0.0)


def test_a_bound_that_is_not_a_number_is_refused():
    with pytest.raises(ValueError, match="not a number"):
        most(lambda _: math.nan, lambda _: 0.0, (Span(0.0, 1.0),))


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


def test_ranges_of_a_point_are_the_barriers_own_values():
    shape = Shape(Barrier(1.0, 1.5), Span(0.0, 0.0), 1.0)
    for d in (0.0, 0.1, 1.0, 2.0, 5.0):
        assert shape.slope(Span(d, d)) == pytest.approx((shape.barrier.slope(d),) * 2, abs=1e-10)
        step = 1e-5
        numeric = (shape.barrier.slope(d + step) - shape.barrier.slope(d)) / step
        assert shape.curvature_1_m(Span(d, d)).low == pytest.approx(numeric, abs=1e-4)

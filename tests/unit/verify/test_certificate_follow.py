"""How far a followed target may get away from under a vehicle with fed-back velocity."""

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from flightstack.verify.envelope import extremes
from flightstack.verify.feedback import linear
from flightstack.verify.follow import SLACK, _gains, _piece_m, _ports, follow_m
from tests.unit.core.strategies.feedback_helpers import BASE, FEEDBACK, fed_back, flown
from tests.unit.verify.certificate_helpers import config, one

LIMITED = fed_back()
FED = fed_back(  # nothing reaches the feedback's own limits
    velocity_feedback={"acceleration_max_m_s2": 20.0}, velocity_loop={"disturbance_max_m_s": 3.0}
)
SLOWEST, QUICKEST = 1.0 / 1.3, 1.0 / 0.7
LONG_S = 8.0


@cache
def promise_m():
    return follow_m(FED, extremes(FED))[0]


def responses(settings_, factor, step_s, seconds=LONG_S):
    """Of the position to accelerations of the target and to errors of the velocity wanted, by time."""
    inputs, outputs, _ = _ports(settings_, factor)
    step, states, found = expm(linear(settings_, factor) * step_s), inputs, []
    for _ in range(round(seconds / step_s)):
        found.append((outputs @ states)[0, :2])
        states = step @ states
    return np.array(found)


def turned_against(settings_, factor):
    """Accelerations and errors, by tick, that end as far from the middle as the flown loop lets them."""
    x, gain, ticks = extremes(settings_), settings_.robust.gain_over_pad_1_s, round(LONG_S * 100)
    none, knock = np.zeros(ticks), np.zeros(ticks)
    knock[0] = 1e-3
    told = flown(settings_, factor, knock, none)[::-1], flown(settings_, factor, none, knock)[::-1]
    error = x.velocity_error_m_s + gain * x.position_error_m
    return np.sign(told[0]) * x.target_acceleration_m_s2, np.sign(told[1]) * error


def farthest(*flight):
    return float(np.abs(flown(*flight)).max())


# a quick vehicle swings less than the matrix, whose delay acts on all frequencies as on low ones
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
    """At factor 1 the observer's poles fall together: nothing here may depend on modes."""
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
    assert config().velocity_feedback.horizontal is False  # and the lead has its own bound
    assert "after" in one("drift").worst

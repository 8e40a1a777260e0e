"""The bounds the certificate stands on: nothing lies above them, and they find what samples miss."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.core.safety.barrier import Barrier
from flightstack.verify.bound import TOLERANCE, Shape, Span, most

INF = math.inf


def test_the_largest_value_of_a_parabola_is_found():
    def upper(cell):
        near = min(max(0.3, cell[0].low), cell[0].high)
        return -((near - 0.3) ** 2)

    found = most(upper, lambda at: -((at[0] - 0.3) ** 2), (Span(0.0, INF),))
    assert 0.0 <= found.bound <= TOLERANCE
    assert found.at[0] == pytest.approx(0.3, abs=math.sqrt(TOLERANCE))


def test_a_spike_that_a_grid_misses_is_found():
    at, wide = 0.123456789, 1e-4  # a grid of a thousand points has a chance of one in ten

    def spike(x):
        return max(0.0, 1.0 - abs(x - at) / wide)

    def upper(cell):
        (span,) = cell
        return 1.0 if span.low <= at <= span.high else max(spike(span.low), spike(span.high))

    assert max(spike(x) for x in np.linspace(0.0, 1.0, 1001)) < 0.5
    assert most(upper, lambda p: spike(p[0]), (Span(0.0, 1.0),)).found > 0.9999


def test_where_values_stay_open_the_bound_says_so():
    found = most(lambda _: 1.0, lambda _: 0.0, (Span(0.0, 1.0),))  # a bound that never gets tight
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

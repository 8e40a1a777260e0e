"""The barrier with a margin: its derivatives, its limits, and that without a margin it is the barrier."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.barrier import Barrier
from flightstack.config import FlightConfig
from flightstack.robust_barrier import RobustBarrier
from flightstack.robust_config import Robust
from flightstack.strict_toml import from_table

STILL = (0.0, 0.0, 0.0)
lengths = st.floats(-3.0, 3.0)
places = st.tuples(lengths, lengths, lengths)
near = st.tuples(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), lengths)
speeds = st.tuples(*(st.floats(-1.0, 1.0),) * 3)
margins = st.floats(0.0, 0.3)
radii = st.floats(0.01, 1.0)
shapes = st.builds(Barrier, st.floats(0.2, 5.0), st.floats(0.1, 3.0), st.floats(0.001, 0.02))
robusts = st.builds(RobustBarrier, shapes, margins, radii)


@given(shapes, radii, st.one_of(places, near), speeds)
def test_without_a_margin_it_is_the_barrier_to_the_last_bit(barrier, radius, e, velocity):
    robust = RobustBarrier(barrier, 0.0, radius)
    assert robust.h(e) == barrier.h(e)
    assert robust.evaluate(e, velocity) == barrier.evaluate(e, velocity)
    assert (robust.slope_max, robust.smoothing_m) == (barrier.slope_max, barrier.smoothing_m)


@given(robusts, st.one_of(places, near))
def test_the_margin_is_never_negative_and_full_outside_its_radius(robust, e):
    taken = robust.barrier.h(e) - robust.h(e)
    assert -1e-15 <= taken <= robust.margin_m + 1e-15
    if math.hypot(e[0], e[1]) > 3.0 * robust.fade_radius_m:
        assert taken >= robust.margin_m * (1.0 - math.exp(-9.0)) - 1e-15
    assert robust.h((0.0, 0.0, e[2])) == e[2]


@given(robusts, st.one_of(places, near), speeds)
def test_both_ways_to_the_value_agree(robust, e, velocity):
    assert robust.evaluate(e, velocity)[0] == pytest.approx(robust.h(e), abs=1e-12)


@given(robusts, st.one_of(places, near))
def test_what_the_margin_adds_to_the_gradient_is_its_derivative(robust, e):
    _, plain, _ = robust.barrier.evaluate(e, STILL)
    _, found, _ = robust.evaluate(e, STILL)
    step = 1e-6 * robust.fade_radius_m

    def margin(x, y):
        return robust.margin_m * (1.0 - math.exp(-(x * x + y * y) / robust.fade_radius_m**2))

    by_x = (margin(e[0] + step, e[1]) - margin(e[0] - step, e[1])) / (2 * step)
    by_y = (margin(e[0], e[1] + step) - margin(e[0], e[1] - step)) / (2 * step)
    close = 1e-7 * (1.0 + robust.margin_m / robust.fade_radius_m)
    assert found[0] - plain[0] == pytest.approx(-by_x, abs=close)
    assert found[1] - plain[1] == pytest.approx(-by_y, abs=close)
    assert found[2] == 1.0


@given(robusts, places)
def test_the_gradient_is_the_derivative_of_h(robust, e):
    if math.hypot(e[0], e[1]) < 0.3:
        return  # the barrier's own gradient is smoothed by the apex
    _, g, _ = robust.evaluate(e, STILL)
    step = 1e-6
    for axis in range(3):
        plus, minus = list(e), list(e)
        plus[axis] += step
        minus[axis] -= step
        numeric = (robust.h(tuple(plus)) - robust.h(tuple(minus))) / (2 * step)
        smoothed = robust.slope_max * 0.5 * (robust.smoothing_m / 0.3) ** 2
        assert g[axis] == pytest.approx(numeric, abs=2e-6 + smoothed)


@given(robusts, places, speeds)
def test_the_time_derivative_is_that_of_a_moving_target(robust, e, velocity):
    _, g, dh_dt = robust.evaluate(e, velocity)
    assert dh_dt == pytest.approx(-sum(a * b for a, b in zip(g, velocity, strict=True)), abs=1e-12)
    if math.hypot(e[0], e[1]) < 0.3:
        return
    step = 1e-6
    later, sooner = (
        robust.h(tuple(a - sign * step * v for a, v in zip(e, velocity, strict=True))) for sign in (1, -1)
    )
    smoothed = robust.slope_max * 0.5 * (robust.smoothing_m / 0.3) ** 2 * math.hypot(*velocity)
    assert dh_dt == pytest.approx((later - sooner) / (2 * step), abs=1e-5 + smoothed)


@given(robusts, st.one_of(places, near))
def test_no_slope_is_steeper_than_it_says(robust, e):
    _, (gx, gy, _), _ = robust.evaluate(e, STILL)
    assert math.hypot(gx, gy) <= robust.slope_max * (1.0 + 1e-12)


@given(st.floats(0.001, 0.3), radii)
def test_the_steepest_slope_of_the_margin_is_reached(margin, radius):
    flat = Barrier(1e-6, 1e-6)  # nothing but the margin
    robust = RobustBarrier(flat, margin, radius)
    assert robust.smoothing_m == flat.smoothing_m
    _, (gx, _, _), _ = robust.evaluate((radius / math.sqrt(2.0), 0.0, 1.0), STILL)
    assert -gx == pytest.approx(robust.slope_max, rel=1e-6)
    assert -gx == pytest.approx(margin / radius * math.sqrt(2.0 / math.e), rel=1e-6)


@given(
    st.floats(0.1, 10.0), st.floats(0.0, 1.0), st.floats(0.0, 6.0), st.floats(-2.0, 4.0), st.floats(0.0, 0.2)
)
def test_the_margin_of_every_allowed_configuration_is_a_length(rate, error, factor, slope, sigma):
    robust = Robust(rate_1_s=rate, tracking_error_m_s=error, sigma_factor=factor)
    margin = robust.margin_m(slope, sigma)
    assert margin >= 0.0
    assert robust.margin_m(slope, 2.0 * sigma + 0.01) >= margin  # never less for knowing less
    assert margin == pytest.approx(error / rate + factor * sigma * math.sqrt(1.0 + slope * slope))


def test_the_default_margin_in_numbers():
    robust = from_table(FlightConfig, {"barrier": {"alpha_1_m": 1.0, "beta_m": 1.5}}).robust
    # 0.04 / 1.5 for the tracking, and 2 sigma of 5 mm over a slope of 1.22
    assert robust.margin_m(1.22, 0.005) == pytest.approx(0.0267 + 0.0158, abs=1e-4)

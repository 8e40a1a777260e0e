"""The barrier with a margin: its derivatives, its limits, and that without a margin it is the barrier."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.common.strict_toml import from_table
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.parameters.robust import Robust
from flightstack.core.safety.barrier import Barrier
from flightstack.core.safety.robust_barrier import RobustBarrier

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
    assert robust.slope_max == barrier.slope_max
    assert robust.linearisation_bound_m(e, 0.02) == barrier.linearisation_bound_m(e, 0.02)


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
        smoothed = robust.slope_max * 0.5 * (robust.barrier.smoothing_m / 0.3) ** 2
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
    smoothed = robust.slope_max * 0.5 * (robust.barrier.smoothing_m / 0.3) ** 2 * math.hypot(*velocity)
    assert dh_dt == pytest.approx((later - sooner) / (2 * step), abs=1e-5 + smoothed)


@given(robusts, st.one_of(places, near))
def test_no_slope_is_steeper_than_it_says(robust, e):
    _, (gx, gy, _), _ = robust.evaluate(e, STILL)
    assert math.hypot(gx, gy) <= robust.slope_max * (1.0 + 1e-12)


@given(st.floats(0.001, 0.3), radii)
def test_the_steepest_slope_of_the_margin_is_reached(margin, radius):
    flat = Barrier(1e-6, 1e-6)  # nothing but the margin
    robust = RobustBarrier(flat, margin, radius)
    _, (gx, _, _), _ = robust.evaluate((radius / math.sqrt(2.0), 0.0, 1.0), STILL)
    assert -gx == pytest.approx(robust.slope_max, rel=1e-6)
    assert -gx == pytest.approx(margin / radius * math.sqrt(2.0 / math.e), rel=1e-6)


def missed(robust, e, moved, angle):
    """How far h lies below its linear prediction after this motion."""
    dx, dy = moved * math.cos(angle), moved * math.sin(angle)
    h, g, _ = robust.evaluate(e, STILL)
    return h + g[0] * dx + g[1] * dy - robust.h((e[0] + dx, e[1] + dy, e[2]))


@given(
    robusts,
    st.one_of(places, near),
    st.one_of(st.floats(0.0, 0.03), st.floats(0.0, 0.5)),
    st.floats(0.0, 7.0),
)
def test_no_motion_misses_the_linear_prediction_by_more_than_is_said(robust, e, moved, angle):
    bound = robust.linearisation_bound_m(e, moved)
    assert bound >= robust.barrier.linearisation_bound_m(e, moved)
    inward = math.atan2(-e[1], -e[0])
    for way in (angle, inward, inward + math.pi, inward + 0.5 * math.pi):
        assert missed(robust, e, moved, way) <= bound + 1e-12


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0, 2.0])
def test_what_the_margin_bends_by_is_reached_across_its_slope(share):
    flat, radius, margin = Barrier(1e-6, 1e-6), 0.06, 0.05
    robust, moved = RobustBarrier(flat, margin, radius), 1e-3
    e = (share * radius, 0.0, 1.0)
    bound = margin * (moved / radius) ** 2 * math.exp(-((max(0.0, share - moved / radius)) ** 2))
    assert robust.linearisation_bound_m(e, moved) == pytest.approx(bound, rel=1e-9)
    assert missed(robust, e, moved, 0.5 * math.pi) == pytest.approx(bound, rel=0.08)


@given(
    st.floats(0.1, 10.0), st.floats(0.0, 1.0), st.floats(0.0, 6.0), st.floats(-2.0, 4.0), st.floats(0.0, 0.2),
    st.floats(0.0, 0.2),
)  # fmt: skip
def test_the_margin_of_every_allowed_configuration_is_a_length(rate, error, factor, slope, sigma, sigma_z):
    robust = Robust(rate_1_s=rate, tracking_error_m_s=error, sigma_factor=factor)
    margin = robust.margin_m(slope, sigma, sigma_z)
    assert margin >= 0.0
    # never less for knowing less
    assert robust.margin_m(slope, 2.0 * sigma + 0.01, sigma_z) >= margin
    assert robust.margin_m(slope, sigma, 2.0 * sigma_z + 0.01) >= margin
    expected = error / rate + factor * math.sqrt((slope * sigma) ** 2 + sigma_z**2)
    assert margin == pytest.approx(expected)


@pytest.mark.parametrize("slope", [0.0, 0.4, 1.22])
def test_the_margin_is_that_of_the_worst_direction_of_an_error(slope):
    """Of independent errors, h has the deviation that is the gradient's length, each axis weighted."""
    sigma_xy, sigma_z = 0.004, 0.011
    gradients = [(slope * math.cos(a), slope * math.sin(a), 1.0) for a in (0.0, 0.7, 2.0, 4.5)]
    spread = max(math.hypot(gx * sigma_xy, gy * sigma_xy, gz * sigma_z) for gx, gy, gz in gradients)
    assert Robust(tracking_error_m_s=0.0, sigma_factor=2.0).margin_m(
        slope, sigma_xy, sigma_z
    ) == pytest.approx(2.0 * spread)


def test_the_default_margin_in_numbers():
    robust = from_table(FlightConfig, {"barrier": {"alpha_1_m": 1.0, "beta_m": 1.5}}).robust
    # 0.04 / 1.5 for the tracking, and 2 sigma of 5 mm over a slope of 1.22
    assert robust.margin_m(1.22, 0.005, 0.005) == pytest.approx(0.0267 + 0.0158, abs=1e-4)

"""Tests both barriers: definition, derivatives (finite differences), and eq. (7) with the paper's numbers."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.core.parameters.robust import Robust
from flightstack.core.safety.barrier import Barrier, RobustBarrier

STILL = (0.0, 0.0, 0.0)
lengths = st.floats(-3.0, 3.0)
points = st.tuples(lengths, lengths, lengths)
near = st.tuples(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), lengths)
velocities = st.tuples(*(st.floats(-1.0, 1.0),) * 3)
margins = st.floats(0.0, 0.3)
radii = st.floats(0.01, 1.0)
shapes = st.builds(Barrier, st.floats(0.2, 5.0), st.floats(0.1, 3.0))
ways = st.one_of(st.floats(0.0, 0.03), st.floats(0.0, 0.5))
places = st.one_of(st.floats(0.0, 0.03), st.floats(0.0, 3.0))
smoothed = st.builds(
    Barrier, st.floats(0.2, 5.0), st.floats(0.1, 3.0), apex_smoothing_m=st.floats(0.001, 0.02)
)
robusts = st.builds(RobustBarrier, smoothed, margins, radii)


def shortened(barrier):
    """Return the largest reduction of the slope by the smoothing at d >= 0.3 m: slope_max (s/d)^2 / 2."""
    inner = getattr(barrier, "barrier", barrier)
    steepest = inner.slope_max + (barrier.margin_m / barrier.fade_radius_m if inner is not barrier else 0.0)
    return steepest * 0.5 * (inner.apex_smoothing_m / 0.3) ** 2


@given(shapes, lengths, lengths, lengths)
def test_h_is_eq_9(barrier, ex, ey, ez):
    d = math.hypot(ex, ey)
    expected = ez - barrier.beta_m * barrier.alpha_1_m * d * math.exp(-barrier.alpha_1_m * d)
    assert barrier.h((ex, ey, ez)) == pytest.approx(expected, abs=1e-12)
    assert barrier.evaluate((ex, ey, ez), (0.0, 0.0, 0.0))[0] == pytest.approx(expected, abs=1e-12)


@given(st.one_of(shapes, robusts), points, velocities)
def test_the_time_derivative_is_that_of_a_moving_target(barrier, e, velocity):
    _, g, dh_dt = barrier.evaluate(e, velocity)
    assert dh_dt == pytest.approx(-sum(a * b for a, b in zip(g, velocity, strict=True)), abs=1e-12)
    if math.hypot(e[0], e[1]) < 0.3:
        return
    step = 1e-6
    later, sooner = (
        barrier.h(tuple(a - sign * step * v for a, v in zip(e, velocity, strict=True))) for sign in (1, -1)
    )
    close = 1e-5 + shortened(barrier) * math.hypot(*velocity)
    assert dh_dt == pytest.approx((later - sooner) / (2 * step), abs=close)


def test_the_papers_numbers_follow_from_its_geometry_once_eq_7_has_units():
    barrier = Barrier(1.0 / (0.55 * math.tan(math.radians(60.0))), math.e * 0.55)
    assert (barrier.peak_height_m, barrier.peak_distance_m) == pytest.approx((0.55, 0.9526), abs=1e-4)
    assert barrier.beta_m == pytest.approx(1.495, abs=1e-3)
    assert barrier.alpha_1_m == pytest.approx(1.0498, abs=1e-4)  # 1 / (0.55 m tan 60 deg)
    as_printed = 0.55 * math.tan(math.radians(60.0))  # the paper prints this length for alpha
    assert as_printed == pytest.approx(0.9526, abs=1e-4)
    assert round(barrier.alpha_1_m, 1) in (1.0, 1.1)
    assert round(as_printed, 1) == 1.0
    assert Barrier(1.0, 1.5).peak_height_m == pytest.approx(0.5518, abs=1e-4)


@given(shapes, lengths, lengths, lengths)
def test_by_the_apex_too_the_gradient_is_the_slope_times_the_smoothing_factor(barrier, ex, ey, ez):
    d = math.hypot(ex, ey)
    _, (gx, gy, gz), _ = barrier.evaluate((ex, ey, ez), (0.0, 0.0, 0.0))
    inward = -barrier.slope(d) / math.hypot(d, barrier.apex_smoothing_m)
    assert (gx, gy, gz) == pytest.approx((inward * ex, inward * ey, 1.0), rel=1e-12, abs=1e-15)


@given(shapes, st.floats(0.0, 5.0))
def test_the_slope_is_the_derivative_of_the_boundary(barrier, d):
    step = 1e-6
    numeric = (barrier.height(d + step) - barrier.height(d - step)) / (2 * step)
    assert barrier.slope(d) == pytest.approx(numeric, abs=1e-7)
    assert abs(barrier.slope(d)) <= barrier.slope_max
    assert barrier.slope(0.0) == barrier.slope_max


def missed(barrier, e, moved, angle):
    """Return the error of a linear prediction of h after a horizontal motion, m: prediction minus true h."""
    dx, dy = moved * math.cos(angle), moved * math.sin(angle)
    h, g, _ = barrier.evaluate(e, STILL)
    return h + g[0] * dx + g[1] * dy - barrier.h((e[0] + dx, e[1] + dy, e[2]))


@given(st.one_of(shapes, robusts), st.one_of(points, near), ways, st.floats(0.0, 7.0))
def test_no_motion_misses_the_linear_prediction_by_more_than_is_said(barrier, e, moved, angle):
    bound = barrier.linearisation_bound_m(e, moved)
    assert bound >= 0.0
    if isinstance(barrier, RobustBarrier):
        assert bound >= barrier.barrier.linearisation_bound_m(e, moved)
    inward = math.atan2(-e[1], -e[0])
    for way in (angle, inward, inward + math.pi, inward + 0.5 * math.pi):
        assert missed(barrier, e, moved, way) <= bound + 1e-12


@given(places, ways)
def test_of_a_cone_some_motion_misses_by_all_that_is_said(d, moved):
    """With a cone of slope 2, the largest error equals the bound, and the bound is continuous."""
    barrier = Barrier(1e-6, 2e6)
    worst = max(missed(barrier, (d, 0.0, 0.0), moved, math.pi * n / 2000) for n in range(2001))
    bound = barrier.linearisation_bound_m((d, 0.0, 0.0), moved)
    assert worst <= bound + 1e-9
    assert worst == pytest.approx(bound, rel=1e-3, abs=1e-6)
    r = math.hypot(d, barrier.apex_smoothing_m)
    for edge in (r - d, r + d):
        before, after = (
            barrier.linearisation_bound_m((d, 0.0, 0.0), edge * (1.0 + s)) for s in (-1e-9, 1e-9)
        )
        assert after == pytest.approx(before, rel=1e-6, abs=1e-9)


@given(smoothed, radii, st.one_of(points, near), velocities)
def test_without_a_margin_it_is_the_barrier_to_the_last_bit(barrier, radius, e, velocity):
    robust = RobustBarrier(barrier, 0.0, radius)
    assert robust.h(e) == barrier.h(e)
    assert robust.evaluate(e, velocity) == barrier.evaluate(e, velocity)
    assert robust.linearisation_bound_m(e, 0.02) == barrier.linearisation_bound_m(e, 0.02)


@given(robusts, st.one_of(points, near))
def test_the_margin_is_never_negative_and_full_outside_its_radius(robust, e):
    taken = robust.barrier.h(e) - robust.h(e)
    assert -1e-15 <= taken <= robust.margin_m + 1e-15
    if math.hypot(e[0], e[1]) > 3.0 * robust.fade_radius_m:
        assert taken >= robust.margin_m * (1.0 - math.exp(-9.0)) - 1e-15
    assert robust.h((0.0, 0.0, e[2])) == e[2]


@given(robusts, st.one_of(points, near), velocities)
def test_both_ways_to_the_value_agree(robust, e, velocity):
    assert robust.evaluate(e, velocity)[0] == pytest.approx(robust.h(e), abs=1e-12)


@given(robusts, st.one_of(points, near))
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
    # a larger uncertainty never reduces the margin
    assert robust.margin_m(slope, 2.0 * sigma + 0.01, sigma_z) >= margin
    assert robust.margin_m(slope, sigma, 2.0 * sigma_z + 0.01) >= margin
    expected = error / rate + factor * math.sqrt((slope * sigma) ** 2 + sigma_z**2)
    assert margin == pytest.approx(expected)

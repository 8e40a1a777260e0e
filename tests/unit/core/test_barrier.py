"""The barrier against its definition, its derivatives against finite differences, eq. 7 against numbers."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.core.safety.barrier import Barrier

lengths = st.floats(-3.0, 3.0)
speeds = st.floats(-1.0, 1.0)
shapes = st.builds(Barrier, st.floats(0.2, 5.0), st.floats(0.1, 3.0), st.just(0.005))
ways = st.one_of(st.floats(0.0, 0.03), st.floats(0.0, 0.5))
places = st.one_of(st.floats(0.0, 0.03), st.floats(0.0, 3.0))


@given(shapes, lengths, lengths, lengths)
def test_h_is_eq_9(barrier, ex, ey, ez):
    d = math.hypot(ex, ey)
    expected = ez - barrier.beta_m * barrier.alpha_1_m * d * math.exp(-barrier.alpha_1_m * d)
    assert barrier.h((ex, ey, ez)) == pytest.approx(expected, abs=1e-12)
    assert barrier.evaluate((ex, ey, ez), (0.0, 0.0, 0.0))[0] == pytest.approx(expected, abs=1e-12)


@given(shapes, lengths, lengths, lengths)
def test_gradient_is_the_derivative_of_h(barrier, ex, ey, ez):
    if math.hypot(ex, ey) < 0.3:
        return  # by the apex the gradient is smoothed: see below
    _, g, _ = barrier.evaluate((ex, ey, ez), (0.0, 0.0, 0.0))
    step = 1e-6
    for axis in range(3):
        plus, minus = [ex, ey, ez], [ex, ey, ez]
        plus[axis] += step
        minus[axis] -= step
        numeric = (barrier.h(tuple(plus)) - barrier.h(tuple(minus))) / (2 * step)
        # the smoothing shortens the gradient by (s/d)^2 / 2
        assert g[axis] == pytest.approx(numeric, abs=1e-6 + barrier.slope_max * 0.5 * (0.005 / 0.3) ** 2)


@given(shapes, lengths, lengths, lengths, speeds, speeds, speeds)
def test_time_derivative_is_that_of_a_moving_target(barrier, ex, ey, ez, vx, vy, vz):
    if math.hypot(ex, ey) < 0.3:
        return
    _, _, dh_dt = barrier.evaluate((ex, ey, ez), (vx, vy, vz))
    step = 1e-6
    later = barrier.h((ex - vx * step, ey - vy * step, ez - vz * step))
    sooner = barrier.h((ex + vx * step, ey + vy * step, ez + vz * step))
    shortened = barrier.slope_max * 0.5 * (0.005 / 0.3) ** 2 * math.hypot(vx, vy)
    assert dh_dt == pytest.approx((later - sooner) / (2 * step), abs=1e-5 + shortened)


@given(shapes, st.floats(0.0, 2 * math.pi), st.floats(1e-9, 0.02))
def test_at_the_apex_the_gradient_fades_and_never_exceeds_the_slope(barrier, angle, d):
    _, (gx, gy, gz), _ = barrier.evaluate((d * math.cos(angle), d * math.sin(angle), 0.1), (0.0, 0.0, 0.0))
    assert gz == 1.0
    assert math.hypot(gx, gy) <= barrier.slope_max
    assert math.hypot(gx, gy) <= barrier.slope_max * d / barrier.smoothing_m + 1e-12


def test_at_the_apex_itself_the_gradient_is_vertical():
    h, gradient, dh_dt = Barrier(1.0, 1.5).evaluate((0.0, 0.0, 0.1), (0.3, -0.2, 0.0))
    assert (h, gradient, dh_dt) == (0.1, (0.0, 0.0, 1.0), 0.0)


@given(st.floats(0.1, 2.0), st.floats(0.1, 3.0))
def test_a_peak_stands_where_it_was_asked_for(height, distance):
    barrier = Barrier.from_peak(height, distance)
    assert barrier.height(distance) == pytest.approx(height)
    assert barrier.height(distance * 0.99) < barrier.height(distance) > barrier.height(distance * 1.01)


def test_the_papers_numbers_follow_from_its_geometry_once_eq_7_has_units():
    barrier = Barrier.from_cone(0.55, math.radians(60.0))
    assert barrier.beta_m == pytest.approx(1.495, abs=1e-3)
    assert barrier.alpha_1_m == pytest.approx(1.0498, abs=1e-4)  # 1 / (0.55 m tan 60 deg)
    as_printed = 0.55 * math.tan(math.radians(60.0))  # a length
    assert as_printed == pytest.approx(0.9526, abs=1e-4)
    assert round(barrier.alpha_1_m, 1) in (1.0, 1.1)
    assert round(as_printed, 1) == 1.0
    assert Barrier(1.0, 1.5).peak_height_m == pytest.approx(0.5518, abs=1e-4)


@given(shapes, lengths, lengths, lengths)
def test_by_the_apex_too_the_gradient_is_the_slope_times_the_smoothing_factor(barrier, ex, ey, ez):
    d = math.hypot(ex, ey)
    _, (gx, gy, gz), _ = barrier.evaluate((ex, ey, ez), (0.0, 0.0, 0.0))
    inward = -barrier.slope(d) / math.hypot(d, barrier.smoothing_m)
    assert (gx, gy, gz) == pytest.approx((inward * ex, inward * ey, 1.0), rel=1e-12, abs=1e-15)


@given(shapes, st.floats(0.0, 5.0))
def test_the_slope_is_the_derivative_of_the_boundary(barrier, d):
    step = 1e-6
    numeric = (barrier.height(d + step) - barrier.height(d - step)) / (2 * step)
    assert barrier.slope(d) == pytest.approx(numeric, abs=1e-7)
    assert abs(barrier.slope(d)) <= barrier.slope_max
    assert barrier.slope(0.0) == barrier.slope_max


def test_the_shapes_numbers():
    barrier = Barrier(2.0, 1.5)
    assert barrier.smoothing_m == 0.005
    assert barrier.slope_max == 3.0
    assert barrier.peak_distance_m == 0.5
    assert barrier.peak_height_m == 1.5 / math.e == pytest.approx(barrier.height(0.5))


@given(st.floats(0.1, 2.0), st.floats(0.1, 1.4), st.floats(0.001, 0.02))
def test_the_cones_angle_is_seen_from_the_landing_spot(height, angle, smoothing):
    barrier = Barrier.from_cone(height, angle, smoothing)
    assert math.atan2(barrier.peak_distance_m, barrier.peak_height_m) == pytest.approx(angle)
    assert barrier.peak_height_m == pytest.approx(height)
    assert barrier.smoothing_m == smoothing
    assert Barrier.from_peak(height, 1.0, smoothing).smoothing_m == smoothing
    assert Barrier.from_cone(height, angle).smoothing_m == Barrier.from_peak(height, 1.0).smoothing_m == 0.005


def missed(barrier, d, moved, angle):
    """How far h lies below its linear prediction after this motion, from a place on the x axis."""
    e, (dx, dy) = (d, 0.0, 0.0), (moved * math.cos(angle), moved * math.sin(angle))
    h, g, _ = barrier.evaluate(e, (0.0, 0.0, 0.0))
    return h + g[0] * dx + g[1] * dy - barrier.h((d + dx, dy, 0.0))


@given(shapes, places, ways, st.floats(0.0, math.tau))
def test_no_motion_misses_the_linear_prediction_by_more_than_is_said(barrier, d, moved, angle):
    bound = barrier.linearisation_bound_m((d * math.cos(1.0), d * math.sin(1.0), 0.7), moved)
    assert bound >= 0.0
    for way in (angle, 0.0, math.pi):
        assert missed(barrier, d, moved, way) <= bound + 1e-12


@given(places, ways)
def test_of_a_cone_some_motion_misses_by_all_that_is_said(d, moved):
    """A barrier so wide that it is a cone of slope 2; the three cases of the bound meet without a step."""
    barrier = Barrier(1e-6, 2e6)
    worst = max(missed(barrier, d, moved, math.pi * n / 2000) for n in range(2001))
    bound = barrier.linearisation_bound_m((d, 0.0, 0.0), moved)
    assert worst <= bound + 1e-9
    assert worst == pytest.approx(bound, rel=1e-3, abs=1e-6)
    r = math.hypot(d, barrier.smoothing_m)
    for edge in (r - d, r + d):
        before, after = (
            barrier.linearisation_bound_m((d, 0.0, 0.0), edge * (1.0 + s)) for s in (-1e-9, 1e-9)
        )
        assert after == pytest.approx(before, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("barrier", [Barrier(1.0, 1.5), Barrier(3.0, 0.4)])
def test_beyond_the_peak_the_bend_at_three_times_its_distance_is_what_is_missed(barrier):
    d, moved = 3.0 / barrier.alpha_1_m, 0.01
    worst = max(missed(barrier, d, moved, way) for way in (0.0, math.pi))
    bend = barrier.alpha_1_m**2 * barrier.beta_m * math.exp(-3.0)
    assert worst == pytest.approx(0.5 * bend * moved**2, rel=0.05)
    assert barrier.linearisation_bound_m((0.0, d, 0.0), moved) == pytest.approx(
        0.5 * bend * moved**2 + abs(barrier.slope(d)) * 0.5 * moved**2 / d, rel=0.01
    )

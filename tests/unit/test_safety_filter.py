"""The quadratic program: OSQP against the exact projection, and what happens when it cannot be solved."""

import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flightstack.projection import best_corner, project
from flightstack.safety_filter import FilterStatus, SafetyFilter

FILTER = SafetyFilter(0.7)
BOX = (0.2, 0.2, 0.5)
velocities = st.tuples(*(st.floats(-2.0, 2.0),) * 3)
gradients = st.tuples(st.floats(-4.0, 4.0), st.floats(-4.0, 4.0), st.just(1.0))


def low(box):
    return tuple(-b for b in box)


def test_osqp_agrees_with_the_exact_projection_on_random_states():
    chance = random.Random(20261121)
    worst, solved = 0.0, 0
    for _ in range(5000):  # 10^5 in the benchmark
        box = tuple(chance.choice((0.2, 0.5, 1.0)) for _ in range(3))
        nominal = tuple(chance.uniform(-2, 2) for _ in range(3))
        gradient = (chance.uniform(-2, 2), chance.uniform(-2, 2), 1.0)
        h, dh_dt = chance.uniform(-0.5, 1.0), chance.uniform(-0.4, 0.4)
        result = FILTER.solve(nominal, h, gradient, dh_dt, low(box), box)
        exact = project(nominal, gradient, -0.7 * h - dh_dt, low(box), box)
        if exact is None:
            assert result.status is FilterStatus.INFEASIBLE
            continue
        solved += result.status is FilterStatus.SOLVED
        worst = max(worst, *(abs(a - b) for a, b in zip(exact, result.velocity_enu_m_s, strict=True)))
    assert worst < 1e-6
    assert solved > 4000


@given(velocities, st.floats(-1, 1), gradients, st.floats(-0.5, 0.5))
@settings(max_examples=300)
def test_never_outside_the_box_and_never_below_the_barrier_unless_it_says_so(nominal, h, gradient, dh_dt):
    result = FILTER.solve(nominal, h, gradient, dh_dt, low(BOX), BOX)
    assert all(abs(u) <= b for u, b in zip(result.velocity_enu_m_s, BOX, strict=True))
    dot = sum(g * u for g, u in zip(gradient, result.velocity_enu_m_s, strict=True))
    assert result.slack_m_s == pytest.approx(dot + dh_dt + 0.7 * h, abs=1e-9)
    if result.status is FilterStatus.INFEASIBLE:
        assert result.slack_m_s < 0.0
        assert result.velocity_enu_m_s == best_corner(gradient, low(BOX), BOX)
    else:
        assert result.slack_m_s >= -2e-6


@given(velocities, gradients, st.floats(-1, 1))
@settings(max_examples=300)
def test_the_exact_projection_is_optimal(nominal, gradient, bound):
    point = project(nominal, gradient, bound, low(BOX), BOX)
    corner = best_corner(gradient, low(BOX), BOX)
    if point is None:
        assert sum(g * u for g, u in zip(gradient, corner, strict=True)) < bound
        return
    assert sum(g * u for g, u in zip(gradient, point, strict=True)) >= bound - 1e-9
    # projection onto a convex set: (nominal - point) . (other - point) <= 0 for every feasible other
    chance = random.Random(1)
    for _ in range(50):
        mix = chance.random()
        other = tuple(mix * c + (1 - mix) * chance.uniform(-b, b) for c, b in zip(corner, BOX, strict=True))
        if sum(g * u for g, u in zip(gradient, other, strict=True)) < bound:
            continue
        angle = sum((n - p) * (o - p) for n, p, o in zip(nominal, point, other, strict=True))
        assert angle <= 1e-7


def test_a_safe_nominal_passes_unchanged():
    result = FILTER.solve((0.1, -0.1, -0.2), 1.0, (0.5, 0.5, 1.0), 0.0, low(BOX), BOX)
    assert result.velocity_enu_m_s == pytest.approx((0.1, -0.1, -0.2), abs=1e-7)
    assert not result.active


def test_filtering_twice_changes_nothing():
    once = FILTER.solve((0.2, 0.0, -0.5), 0.0, (1.0, 0.0, 1.0), -0.1, low(BOX), BOX)
    twice = FILTER.solve(once.velocity_enu_m_s, 0.0, (1.0, 0.0, 1.0), -0.1, low(BOX), BOX)
    assert once.active
    assert twice.velocity_enu_m_s == pytest.approx(once.velocity_enu_m_s, abs=1e-6)


def test_a_result_does_not_depend_on_what_was_solved_before():
    asked = ((0.2, 0.1, -0.5), 0.05, (1.2, -0.4, 1.0), -0.05, low(BOX), BOX)
    fresh = SafetyFilter(0.7).solve(*asked)
    used = SafetyFilter(0.7)
    chance = random.Random(3)
    for _ in range(200):
        used.solve(
            tuple(chance.uniform(-2, 2) for _ in range(3)),
            chance.uniform(-1, 1),
            (1.0, 0.0, 1.0),
            0.0,
            low(BOX),
            BOX,
        )
    again = used.solve(*asked)
    assert again.velocity_enu_m_s == fresh.velocity_enu_m_s  # to the last bit
    assert again.iterations == fresh.iterations


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_numbers_that_are_not_finite_are_refused(bad):
    result = FILTER.solve((bad, 0.0, 0.0), 0.1, (0.0, 0.0, 1.0), 0.0, low(BOX), BOX)
    assert result.status is FilterStatus.REJECTED
    assert (
        FILTER.solve((0.0, 0.0, 0.0), bad, (0.0, 0.0, 1.0), 0.0, low(BOX), BOX).status
        is FilterStatus.REJECTED
    )


@pytest.mark.parametrize("failure", ["not solved", "residual too large"])
def test_a_solver_that_fails_is_replaced_by_the_exact_projection(monkeypatch, failure):
    residual = math.inf if failure == "not solved" else 1e-3
    broken = SafetyFilter(0.7)
    monkeypatch.setattr(broken, "_osqp", lambda *_: ((0.0, 0.0, -0.5), residual, 4000))
    result = broken.solve((0.2, 0.0, -0.5), 0.0, (1.0, 0.0, 1.0), -0.1, low(BOX), BOX)
    assert result.status is FilterStatus.CLOSED_FORM
    assert result.velocity_enu_m_s == project((0.2, 0.0, -0.5), (1.0, 0.0, 1.0), 0.1, low(BOX), BOX)
    assert result.slack_m_s >= -1e-12

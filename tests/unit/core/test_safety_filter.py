"""Compares OSQP with the exact projection, and tests the quadratic program without a solution."""

import itertools
import math
import random
import subprocess
import sys
import time

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from osqp import OSQP, ext_builtin
from scipy import sparse

from flightstack.core.safety import osqp, qp_filter
from flightstack.core.safety.osqp import Osqp
from flightstack.core.safety.projection import EMPTY, best_corner, projected
from flightstack.core.safety.qp_filter import SafetyFilter
from flightstack.core.types import FilterStatus
from tests.examples import examples

FILTER = SafetyFilter(0.7)
BOX = (0.2, 0.2, 0.5)
STILL = (0.0, 0.0, 0.0)
FREE, LOW, HIGH = range(3)  # state of a component of u: free, at its lower limit, at its upper limit
SOLVED = ext_builtin.osqp_status_type.OSQP_SOLVED
velocities = st.tuples(*(st.floats(-2.0, 2.0),) * 3)
slopes = st.one_of(st.just(0.0), st.floats(-4.0, 4.0))
gradients = st.tuples(slopes, slopes, st.just(1.0))
any_gradients = st.tuples(slopes, slopes, slopes).filter(lambda g: all(s == 0.0 or abs(s) > 1e-3 for s in g))
sides = st.tuples(st.floats(-1.0, 1.0), st.one_of(st.just(0.0), st.floats(0.0, 1.0)))
boxes = st.tuples(sides, sides, sides).map(
    lambda b: (tuple(low for low, _ in b), tuple(low + size for low, size in b))
)


def project(*given):
    """Return the exact projection; None: no velocity within the limits satisfies the constraint."""
    point, multiplier = projected(*given)
    return None if multiplier == EMPTY else point


def low(box):
    return tuple(-b for b in box)


def dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


def by_active_sets(nominal, g, b, lower, upper):
    """Return the permitted point nearest to ``nominal``, from a search of all 54 sets of active bounds."""
    best, least = None, math.inf
    for states in itertools.product((FREE, LOW, HIGH), repeat=3):
        for on_barrier in (False, True):
            u = [
                axis[state]
                for axis, state in zip(zip(nominal, lower, upper, strict=True), states, strict=True)
            ]
            free = [i for i in range(3) if states[i] == FREE]
            if on_barrier:
                steepness = sum(g[i] * g[i] for i in free)
                if steepness == 0.0:
                    continue
                push = (b - dot(g, u)) / steepness
                for i in free:
                    u[i] += push * g[i]
            inside = all(lo - 1e-9 <= x <= hi + 1e-9 for lo, x, hi in zip(lower, u, upper, strict=True))
            if inside and dot(g, u) >= b - 1e-9 and math.dist(u, nominal) < least:
                best, least = tuple(u), math.dist(u, nominal)
    return best


@given(velocities, any_gradients, st.floats(-3.0, 3.0), boxes)
@examples(300)
def test_the_exact_projection_agrees_with_a_search_of_all_active_sets(nominal, g, b, box):
    lower, upper = box
    most = max(dot(g, corner) for corner in itertools.product(*zip(lower, upper, strict=True)))
    assume(abs(most - b) > 1e-6)
    point = project(nominal, g, b, lower, upper)
    assert (point is None) == (most < b)
    if point is not None:
        assert all(lo <= x <= hi for lo, x, hi in zip(lower, point, upper, strict=True))
        assert math.dist(point, by_active_sets(nominal, g, b, lower, upper)) < 1e-5


@given(any_gradients, boxes)
def test_the_best_corner_is_the_best_and_stays_where_nothing_is_won(g, box):
    lower, upper = box
    corner = best_corner(g, lower, upper)
    assert dot(g, corner) == pytest.approx(
        max(dot(g, c) for c in itertools.product(*zip(lower, upper, strict=True))), abs=1e-12
    )
    for slope, x, lo, hi in zip(g, corner, lower, upper, strict=True):
        assert lo <= x <= hi
        if slope == 0.0:
            assert abs(x) == min(abs(y) for y in (lo, hi, *((0.0,) if lo <= 0.0 <= hi else ())))


def test_exact_cases_of_the_projection():
    lower, upper = (-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)
    assert project((0.0, 0.5, 0.25), (0.0, 0.0, 1.0), 0.25, lower, upper) == (0.0, 0.5, 0.25)
    assert project(STILL, (0.0, 0.0, 1.0), 0.5, lower, upper) == (0.0, 0.0, 0.5)
    assert project(STILL, (1.0, 0.0, 1.0), 1.0, lower, upper) == (0.5, 0.0, 0.5)
    assert project(STILL, (1.0, 1.0, 1.0), 3.0, lower, upper) == (1.0, 1.0, 1.0)  # only one point is allowed
    assert project(STILL, (1.0, 1.0, 1.0), math.nextafter(3.0, 4.0), lower, upper) is None
    assert project((-3.0, 0.0, 0.0), (1.0, 0.0, 0.5), 1.25, lower, upper) == (0.75, 0.0, 1.0)
    assert project((-3.0, 0.0, 0.0), (-1.0, 0.0, 0.0), 0.5, lower, upper) == (-1.0, 0.0, 0.0)
    assert project(STILL, (0.0, 0.0, 0.0), 0.5, lower, upper) is None
    assert project((9.0, 9.0, 9.0), (0.0, 0.0, 0.0), -0.5, lower, upper) == (1.0, 1.0, 1.0)
    # with this gradient the multiplier has no finite value
    tiny = 5e-324
    assert project((0.0, 0.0, -9.0), (0.0, 0.0, tiny), tiny, lower, upper) == (0.0, 0.0, 1.0)
    with pytest.raises(ValueError, match=r"unpack"):
        project((0.0, 0.0), (0.0, 0.0, 1.0), 0.5, lower, upper)
    with pytest.raises(ValueError, match=r"unpack"):
        project((*STILL, 0.0), (0.0, 0.0, 1.0), 0.5, lower, upper)


@given(velocities, st.floats(-1, 1), gradients, st.floats(-0.5, 0.5), boxes)
@examples(300)
def test_never_outside_the_box_and_never_below_the_barrier_unless_it_says_so(
    nominal, h, gradient, dh_dt, box
):
    result = FILTER.solve(nominal, h, gradient, dh_dt, *box)
    assert all(lo <= u <= hi for lo, u, hi in zip(box[0], result.velocity_enu_m_s, box[1], strict=True))
    assert result.slack_m_s == pytest.approx(
        dot(gradient, result.velocity_enu_m_s) + dh_dt + 0.7 * h, abs=1e-9
    )
    if result.status is FilterStatus.INFEASIBLE:
        assert result.slack_m_s < 0.0
        assert result.velocity_enu_m_s == best_corner(gradient, *box)
    else:
        assert result.slack_m_s >= -2e-6


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
    assert again.velocity_enu_m_s == fresh.velocity_enu_m_s  # the velocities are equal to the last bit
    assert again.iterations == fresh.iterations


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_numbers_that_are_not_finite_are_refused(bad):
    good = [0.1, 0.1, 0.1, 0.1, 0.5, 0.5, 1.0, 0.0, -0.2, -0.2, -0.5, 0.2, 0.2, 0.5]
    for place in range(len(good)):
        n = [*good[:place], bad, *good[place + 1 :]]
        result = FILTER.solve(n[0:3], n[3], n[4:7], n[7], n[8:11], n[11:14])
        assert result.status is FilterStatus.REJECTED
        assert (result.velocity_enu_m_s, result.active, result.iterations) == (STILL, False, 0)
        assert result.solve_s == 0.0
        assert math.isnan(result.slack_m_s)
        assert math.isnan(result.residual_m_s)


def test_a_nominal_on_the_barrier_itself_is_not_changed():
    result = FILTER.solve((0.0, 0.0, 0.25), 0.0, (0.0, 0.0, 1.0), -0.25, low(BOX), BOX)
    assert not result.active
    assert FILTER.solve((0.0, 0.0, 0.2499), 0.0, (0.0, 0.0, 1.0), -0.25, low(BOX), BOX).active


def test_the_time_is_that_of_the_solver():
    before = time.perf_counter()
    result = FILTER.solve((0.2, 0.0, -0.5), 0.0, (1.0, 0.0, 1.0), -0.1, low(BOX), BOX)
    assert 0.0 < result.solve_s < time.perf_counter() - before
    assert result.iterations == 1


def test_the_solver_confirms_the_projection_and_corrects_a_wrong_one(monkeypatch):
    chance, corrected, tried = random.Random(5), 0, 0
    for _ in range(600):
        nominal = tuple(chance.uniform(-2, 2) for _ in range(3))
        gradient = (chance.uniform(-2, 2), chance.uniform(-2, 2), 1.0)
        asked = (nominal, chance.uniform(-0.5, 1.0), gradient, chance.uniform(-0.4, 0.4), low(BOX), BOX)
        right = FILTER.solve(*asked)
        if right.status is FilterStatus.INFEASIBLE:
            continue
        assert (right.status, right.iterations) == (FilterStatus.SOLVED, 1)
        point, multiplier = tuple(chance.uniform(-1, 1) for _ in range(3)), chance.uniform(0, 1)
        with monkeypatch.context() as wrong:
            wrong.setattr(qp_filter, "projected", lambda *_, p=point, m=multiplier: (p, m))
            result = FILTER.solve(*asked)
        tried += 1
        if result.status is FilterStatus.SOLVED:
            corrected += 1
            assert result.velocity_enu_m_s == pytest.approx(right.velocity_enu_m_s, abs=1e-6)
            assert result.iterations > 1
    assert tried > 300
    assert corrected > 0.9 * tried


@given(velocities, any_gradients, st.floats(-3.0, 3.0), boxes)
def test_the_multiplier_makes_the_projection_optimal(nominal, g, b, box):
    point, multiplier = projected(nominal, g, b, *box)
    assume(multiplier != EMPTY and math.isfinite(multiplier))
    for n, gi, x, lo, hi in zip(nominal, g, point, *box, strict=True):
        pull = n + multiplier * gi - x  # multiplier of this component's limits; zero unless a limit is active
        assert pull == pytest.approx(0.0, abs=1e-9) or (x == lo and pull < 0.0) or (x == hi and pull > 0.0)


@pytest.mark.parametrize("residual", [math.inf, math.nan, 1e-3, math.nextafter(1e-6, 1.0)])
def test_a_solver_that_fails_is_replaced_by_the_exact_projection(monkeypatch, residual):
    broken = SafetyFilter(0.7)
    monkeypatch.setattr(broken, "_osqp", lambda *_: ((0.0, 0.0, -0.5), residual, 200))
    result = broken.solve((0.2, 0.0, -0.5), 0.0, (1.0, 0.0, 1.0), -0.1, low(BOX), BOX)
    assert result.status is FilterStatus.CLOSED_FORM
    assert result.velocity_enu_m_s == project((0.2, 0.0, -0.5), (1.0, 0.0, 1.0), 0.1, low(BOX), BOX)
    assert result.slack_m_s >= -1e-12
    assert (result.residual_m_s, result.iterations) == (pytest.approx(residual, nan_ok=True), 200)


def test_a_result_that_misses_by_as_much_as_allowed_is_used(monkeypatch):
    exact = SafetyFilter(0.7)
    monkeypatch.setattr(exact, "_osqp", lambda *_: ((0.1, 0.0, 0.0), 1e-6, 10))
    result = exact.solve((0.2, 0.0, -0.5), 0.0, (1.0, 0.0, 1.0), -0.1, low(BOX), BOX)
    assert (result.status, result.velocity_enu_m_s) == (FilterStatus.SOLVED, (0.1, 0.0, 0.0))


LOWER, UPPER, NOMINAL, GRADIENT = (-0.1, -0.2, -0.3), (0.4, 0.5, 0.6), (0.7, -0.8, 0.9), (1.5, -2.5, 0.5)


def told(point, status=SOLVED, bound=-9.0, multiplier=0.25):
    """Return the filter's result for a given solution and status of the solver, and the solver's inputs."""
    judged = SafetyFilter(0.7)
    solver = judged.osqp
    solver._calls, solver._status.value, solver._count.value = [], int(status), 35
    solver._point[:] = point
    found = judged._osqp(NOMINAL, GRADIENT, bound, LOWER, UPPER, (0.1, 0.2, 0.3), multiplier)
    return found, solver._memory.tolist()


def test_the_solver_is_asked_the_program():
    _, numbers = told(STILL, bound=0.125)
    assert numbers[:3] == [-0.7, 0.8, -0.9]
    assert (numbers[3:7], numbers[8:11]) == ([0.125, *LOWER], list(UPPER))
    assert numbers[7] >= ext_builtin.OSQP_INFTY
    assert numbers[11:17] == [1.5, 1.0, -2.5, 1.0, 0.5, 1.0]
    assert numbers[17:20] == [0.1, 0.2, 0.3]
    # multipliers y from u - u' - multiplier g + y = 0
    assert numbers[20:] == pytest.approx([-0.25, 0.6 + 0.375, -1.0 - 0.625, 0.6 + 0.125])


def test_a_multiplier_without_end_is_no_start():
    _, numbers = told(STILL, multiplier=math.inf)
    assert numbers[20:] == pytest.approx([0.0, 0.6, -1.0, 0.6])


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_what_a_point_misses_the_box_by_is_its_residual(axis):
    for edge, sign in ((LOWER[axis], -1.0), (UPPER[axis], 1.0)):
        point, expected = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
        point[axis], expected[axis] = edge + sign * 0.01, edge
        (found, residual, _), _ = told(point)
        assert found == tuple(expected)
        assert residual == pytest.approx(0.01)


def test_what_a_point_misses_the_barrier_by_is_its_residual():
    (_, residual, _), _ = told((0.1, 0.2, 0.3), bound=-0.15)  # g . u = 0.15 - 0.5 + 0.15 = -0.2
    assert residual == pytest.approx(0.05)
    (_, residual, _), _ = told((0.1, 0.2, 0.3), bound=-0.25)
    assert residual == 0.0
    # the residual is that of the point clipped to the limits, (0.4, 0.2, 0.3): g . u = 0.25
    (_, residual, _), _ = told((0.5, 0.2, 0.3), bound=0.75)
    assert residual == pytest.approx(0.5)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_point_that_is_not_finite_is_no_result(axis, bad):
    point = [0.0, 0.0, 0.0]
    point[axis] = bad
    assert told(point)[0][1] == math.inf


def test_any_other_status_than_solved_is_no_result():
    others = [s for s in ext_builtin.osqp_status_type.__members__.values() if s != SOLVED]
    assert len(others) > 5
    for status in others:
        (point, residual, iterations), _ = told((0.1, 0.9, 0.3), status)
        assert (point, residual, iterations) == ((0.1, 0.5, 0.3), math.inf, 35)


@pytest.mark.parametrize("rows", [1, 4, 10])
def test_the_numbers_are_the_program_of_the_packages_own_solver(rows):
    chance, infinity = np.random.default_rng(rows), ext_builtin.OSQP_INFTY
    for _ in range(20):
        gradients, nominal, sides = chance.normal(size=(rows, 3)), chance.normal(size=3), np.ones(3)
        bounds = chance.uniform(-1.0, 0.0, rows)
        matrix = np.vstack([gradients, np.eye(3)])
        lower, upper = np.concatenate([bounds, -sides]), np.concatenate([np.full(rows, infinity), sides])
        theirs = OSQP()
        theirs.setup(
            sparse.eye(3, format="csc"), -nominal, sparse.csc_matrix(matrix), lower, upper, verbose=False,
            eps_abs=1e-10, eps_rel=1e-10, max_iter=20_000,
        )  # fmt: skip
        expected = theirs.solve(raise_error=True).x
        columns = np.vstack([gradients, np.ones((1, 3))]).T.ravel()
        start = np.concatenate([expected, np.zeros(rows + 3)])
        point, solved, _ = Osqp(rows).solve([*-nominal, *lower, *upper, *columns, *start])
        assert not solved or point == pytest.approx(expected, abs=1e-7)


def test_a_solver_with_another_layout_is_not_used(monkeypatch):
    monkeypatch.setattr(osqp, "_STATUS_AT", 36)
    with pytest.raises(RuntimeError, match="memory layout"):
        Osqp(1)


def test_a_process_that_solves_loads_no_scipy_and_osqp_finds_the_same_module():
    code = (
        "import sys; from flightstack.core.controller import Controller;"
        "from flightstack.core.fleet.program import FleetProgram;"
        "from flightstack.config import load;"
        "from flightstack.core.safety.osqp import compiled_solver;"
        "Controller(load('crazyflie')); FleetProgram();"
        "assert not {'scipy', 'scipy.sparse', 'jinja2', 'osqp'} & sys.modules.keys();"
        "import scipy.sparse; assert scipy.sparse.csr_matrix;"
        "import osqp; from osqp import ext_builtin; assert ext_builtin is compiled_solver()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr

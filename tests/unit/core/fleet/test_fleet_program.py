"""Compares the fleet program with scipy on random sets of several constraints."""

import math

import pytest
import scipy  # loads scipy.optimize at the first use
from hypothesis import example, given
from hypothesis import strategies as st

from flightstack.common.strict_toml import ConfigError
from flightstack.core.controller import Controller
from flightstack.core.fleet import program as program_module
from flightstack.core.fleet.program import AGREES_M_S, OUTWARD_PART, Cone, FleetProgram
from flightstack.core.fleet.solution import Row, least_slack, nearest
from flightstack.core.parameters.fleet import OTHERS_MAX
from flightstack.core.safety.barrier import Barrier
from flightstack.core.safety.qp_filter import SafetyFilter
from flightstack.core.types import FilterStatus, Inputs, Intent, Landed, Mode, OwnState, VehicleStatus
from tests.examples import examples
from tests.unit.core.core_helpers import config
from tests.unit.core.fleet.fleet_helpers import fleet, settings_of

PROGRAM = FleetProgram()
SPEED = st.floats(-1.5, 1.5)
VECTORS = st.tuples(SPEED, SPEED, SPEED)


@st.composite
def rows(draw, least=1, most=OTHERS_MAX):
    found = []
    for _ in range(draw(st.integers(least, most))):
        azimuth, height = draw(st.floats(-math.pi, math.pi)), draw(st.floats(-1.0, 1.0))
        flat = math.sqrt(1.0 - height * height)
        g = (flat * math.cos(azimuth), flat * math.sin(azimuth), height)
        found.append(Row(g, draw(st.floats(-1.0, 0.6))))
    return found


@st.composite
def boxes(draw):
    middle, half = draw(VECTORS), [draw(st.floats(0.02, 0.8)) for _ in range(3)]
    return tuple(m - h for m, h in zip(middle, half, strict=True)), tuple(
        m + h for m, h in zip(middle, half, strict=True)
    )


def missing(found, lower, upper, point):
    sides = [max(lo - p, p - hi) for lo, hi, p in zip(lower, upper, point, strict=True)]
    return max(*sides, *(row.missing_m_s(point) for row in found))


def least_by_scipy(soft, firm, lower, upper):
    a = [[*(-x for x in r.g), -1.0] for r in soft] + [[*(-x for x in r.g), 0.0] for r in firm]
    b = [-r.bound_m_s for r in (*soft, *firm)]
    found = scipy.optimize.linprog(
        [0, 0, 0, 1], A_ub=a, b_ub=b, bounds=[*zip(lower, upper, strict=True), (0, None)]
    )
    return found.fun if found.status == 0 else math.inf


def met_nowhere(found, lower, upper):
    """Whether no point within the limits satisfies all constraints, made stricter by the solver's error."""
    more = [row._replace(bound_m_s=row.bound_m_s + AGREES_M_S) for row in found]
    return least_by_scipy(more, [], lower, upper) > 0.0


# three constraints: a shift of one constraint moves their common corner ten million times as far
FLAT = [
    Row((-0.9899924966004384, 0.14112000805986621, 1.192092896e-07), 0.0),
    Row((1.0, 0.0, 0.0), 0.0),
    Row((0.5403023058681398, -0.8414709848078965, 0.0), 0.0),
]
UNIT_BOX = ((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5))
# a constraint that the best corner of the limits violates by a rounding error
ROUNDED, BESIDE = Row((1.0, -2.220446049250313e-16, 0.0), 0.5), ((-0.5, 0.5, -0.5), (0.5, 1.5, 0.5))
# a constraint that points within the limits satisfy only at x = 0; there the constraint requires z >= 0, or
# nothing if the coefficient of z is rounded to zero
LEVEL, AGAINST = Row((1.0, 0.0, 4.2e-145), 0.0), ((-0.04, -0.5, -0.5), (0.0, 0.5, 0.5))


@examples(150)
@given(VECTORS, rows(), boxes())
@example((0.0, 0.0, -1.0), FLAT, UNIT_BOX)
def test_the_exact_solution_is_that_of_scipy(nominal, found, box):
    lower, upper = box
    slack, _ = least_slack([], found, lower, upper)
    assert slack == pytest.approx(least_by_scipy(found, [], lower, upper), abs=AGREES_M_S)
    exact = nearest(nominal, found, lower, upper)
    if exact is None:
        assert met_nowhere(found, lower, upper)
        return
    assert slack <= 2e-9
    point, multipliers = exact
    assert missing(found, lower, upper, point) <= 1e-8
    # optimality: gradients of the active constraints and limits balance the gradient of the objective
    rest = [n - p for n, p in zip(nominal, point, strict=True)]
    for row, multiplier in zip(found, multipliers, strict=True):
        assert multiplier >= 0.0
        assert multiplier * max(0.0, -row.missing_m_s(point)) <= 1e-6 * (1.0 + multiplier)
        rest = [r + multiplier * g for r, g in zip(rest, row.g, strict=True)]
    scale = 1e-6 * (1.0 + sum(multipliers))
    for r, p, lo, hi in zip(rest, point, lower, upper, strict=True):
        assert abs(r) <= scale or (r > 0.0 and p >= hi - 1e-7) or (r < 0.0 and p <= lo + 1e-7)


@examples(150)
@given(VECTORS, rows(1, 1), rows(0), boxes())
@example((0.0, 0.0, -1.0), FLAT[:1], FLAT[1:], UNIT_BOX)
@example((0.0, 0.0, 0.0), [Row((1.0, 0.0, 0.0), 0.0)], [ROUNDED], BESIDE)
@example((0.0, 0.0, 0.0), [ROUNDED], [], BESIDE)
@example((0.0, 0.0, -1.0), [LEVEL], [], AGAINST)
def test_the_program_holds_barrier_and_box_and_gives_way_no_more_than_it_must(nominal, firm, soft, box):
    lower, upper = box
    found = PROGRAM.solve(nominal, firm, soft, lower, upper)
    point, status = found.filter.velocity_enu_m_s, found.filter.status
    if status is FilterStatus.INFEASIBLE:
        assert met_nowhere(firm, lower, upper)
        return
    assert missing(firm, lower, upper, point) <= 1e-6
    if status is FilterStatus.CROWDED:
        assert found.given_m_s == pytest.approx(least_by_scipy(soft, firm, lower, upper), abs=AGREES_M_S)
        assert max(row.missing_m_s(point) for row in soft) <= found.given_m_s + 1e-6
    else:
        assert status in (FilterStatus.SOLVED, FilterStatus.CLOSED_FORM)
        assert found.given_m_s == 0.0
        assert missing([*firm, *soft], lower, upper, point) <= 1e-6


@examples(100)
@given(VECTORS, rows(1, 1), boxes())
def test_with_the_landing_row_alone_it_is_the_filter_of_a_lone_vehicle(nominal, firm, box):
    lower, upper = box
    ours = PROGRAM.solve(nominal, firm, [], lower, upper).filter
    theirs = SafetyFilter(1.0).solve(nominal, -firm[0].bound_m_s, firm[0].g, 0.0, lower, upper)
    assert ours.status is theirs.status
    assert ours.active is theirs.active
    assert math.dist(ours.velocity_enu_m_s, theirs.velocity_enu_m_s) <= 2e-6


@pytest.mark.parametrize("wrong", [(0.3, 0.0, 0.0), (math.nan, 0.0, 0.0)])
def test_a_wrong_result_of_the_solver_is_not_flown(monkeypatch, wrong):
    program = FleetProgram()
    monkeypatch.setattr(program, "_osqp", lambda *_: (wrong, 0.0, 1))
    found = program.solve((0.0, 0.0, 0.0), (), [Row((1.0, 0.0, 0.0), 0.1)], (-1.0,) * 3, (1.0,) * 3)
    assert found.filter.status is FilterStatus.CLOSED_FORM
    assert found.filter.velocity_enu_m_s == pytest.approx((0.1, 0.0, 0.0))


def test_numbers_that_are_not_finite_are_rejected():
    found = PROGRAM.solve((0.0, 0.0, 0.0), (), [Row((1.0, 0.0, 0.0), math.nan)], (-1.0,) * 3, (1.0,) * 3)
    assert found.filter.status is FilterStatus.REJECTED


def test_without_a_place_for_all_the_neighbours_share_the_slack_evenly():
    walls = [Row((1.0, 0.0, 0.0), 0.3), Row((-1.0, 0.0, 0.0), 0.1)]
    found = PROGRAM.solve((0.0, 0.0, 0.0), [Row((0.0, 0.0, 1.0), 0.2)], walls, (-1.0,) * 3, (1.0,) * 3)
    assert found.filter.status is FilterStatus.CROWDED
    assert found.given_m_s == pytest.approx(0.2)
    assert found.filter.velocity_enu_m_s == pytest.approx((0.1, 0.0, 0.2), abs=1e-6)
    assert found.filter.slack_m_s >= -1e-9


def test_no_slack_helps_where_the_firm_row_is_met_nowhere(monkeypatch):
    firm, soft, box = Row((0.0, 0.0, 1.0), 2.0), Row((1.0, 0.0, 0.0), 2.0), ((-1.0,) * 3, (1.0,) * 3)
    assert least_slack([firm], [soft], *box)[0] == math.inf
    # if rounding makes the firm row seem infeasible, the result is the box corner where h grows fastest
    monkeypatch.setattr(program_module, "least_slack", lambda *_: (math.inf, (0.0, 0.0, 0.0)))
    found = PROGRAM.solve((0.0, 0.0, 0.0), [Row((0.0, 0.0, 1.0), 0.5)], [soft], *box)
    assert found.filter.velocity_enu_m_s[2] == 1.0


BARRIER = Barrier(1.0, 1.5)
CONE = Cone(1.5, BARRIER.slope_max, 0.3, 0.01)
speeds = st.floats(-1.0, 1.0)
velocities3 = st.tuples(speeds, speeds, speeds)


@given(st.floats(0.0, 2.0), st.floats(-0.1, 1.0), velocities3, velocities3, velocities3)
def test_nothing_sinks_faster_than_wanted_or_than_h_alone_allows(d_m, h_m, nominal, target, before):
    reached = tuple(v - 0.05 for v in before), tuple(v + 0.05 for v in before)
    lower, upper = CONE.box(d_m, h_m, nominal, target, *reached)
    for axis in range(3):
        assert reached[0][axis] <= lower[axis] <= upper[axis] <= reached[1][axis]
    allowed = target[2] - CONE.rate_1_s * max(0.0, h_m)
    assert lower[2] >= min(allowed, reached[1][2])
    assert lower[2] >= min(nominal[2], target[2], reached[1][2])
    assert lower[2] <= max(target[2], reached[0][2])  # constant height above the pad is always allowed
    assert upper[2] == reached[1][2]


@given(st.floats(0.05, 0.9), st.floats(0.0, math.tau), st.floats(0.0, 0.3), velocities3, velocities3)
def test_velocity_out_of_the_cone_grows_by_half_of_what_the_rate_allows(d_m, azimuth, h_m, before, target):
    x, y = d_m * math.cos(azimuth), d_m * math.sin(azimuth)
    _, gradient, _ = BARRIER.evaluate((x, y, BARRIER.height(d_m) + h_m), target)

    def lowers_m_s(velocity):
        return sum(g * (t - v) for g, t, v in zip(gradient[:2], target, velocity, strict=False))

    row = CONE.outward(h_m, gradient, before, target)
    most_m_s = lowers_m_s((0.0, 0.0)) - row.bound_m_s  # maximum allowed rate at which h decreases, m/s
    grows_m_s = OUTWARD_PART * CONE.period_s * CONE.rate_1_s * h_m / CONE.lag_s
    assert row.g == (*gradient[:2], 0.0)
    assert math.isclose(most_m_s, max(0.0, lowers_m_s(before)) + grows_m_s, abs_tol=1e-9)


def test_a_vehicle_that_does_not_know_where_it_is_says_nothing():
    controller = Controller(settings_of(3, (3, 7)))
    status = VehicleStatus(0.0, True, Mode.EXTERNAL, Landed.IN_AIR, True)
    assert controller.step(Inputs(None, status), 0.0).member_status is None
    own = OwnState(0.0, 0.0, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 0.0)
    assert controller.step(Inputs(own, status), 0.0).member_status.intent is Intent.WAITING
    assert controller.step(Inputs(own, status), 1.0).member_status is None


@pytest.mark.parametrize(
    ("keys", "why"),
    [
        ({"members": [7, 9]}, "id 3"),
        ({"members": [3, 7, 7]}, "each once"),
        ({"members": list(range(1, 11))}, "members: found 10, allowed are 1 to 9"),
        ({"id": 251}, "1 to 250"),
        ({"reach_m": 2.7}, "reach_m: found 2.7"),
        ({"age_max_s": 0.4}, "age_max_s: found 0.4"),
        ({"pad_distance_m": 0.45}, "pad_distance_m: found 0.45"),
        ({"wait_distance_m": 0.7}, "wait_distance_m: found 0.7"),
        ({"rate_1_s": 1.0}, "fleet.rate_1_s: found 1"),
        ({"latency_max_s": 0.015}, "fleet.latency_max_s: found 0.015"),
    ],
)
def test_a_fleet_that_cannot_work_is_refused(keys, why):
    table = {**fleet(), **keys}
    with pytest.raises(ConfigError, match=why):
        config(fleet=table, loop={"rate_hz": 50})

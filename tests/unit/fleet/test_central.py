"""The baseline's central program: its points against another solver, and two vehicles that would collide."""

import numpy as np
import pytest
from scipy.optimize import minimize

from flightstack.core.fleet.exact import Row
from logs.verdict.types import Outcome
from sim.runners.fleet.team import land_team
from tests.benchmarks.central import RATE_1_S, Central, JointProgram, One, central_team
from tests.unit.fleet.fleet_helpers import at, team_of

DISTANCE_M = 0.5


def drawn(rng):
    """Three vehicles that want to each other, one of them flies by itself."""
    places = rng.uniform(-1.0, 1.0, (3, 3))
    every = []
    for k, p in enumerate(places):
        nominal = tuple((places[(k + 1) % 3] - p).tolist())
        g = (*rng.uniform(-0.5, 0.5, 2).tolist(), 1.0)
        row = Row(g, float(rng.uniform(-0.6, 0.1))) if k < 2 else None
        every.append(One(nominal, row, (-1.0, -1.0, -1.0), (1.0, 1.0, 1.0), tuple(p.tolist())))
    return every


def constraints(every, slack):
    """Rows as functions that are not negative, of all velocities in a row."""
    found = []
    for i, one in enumerate(every):
        if one.landing is not None:
            found.append(lambda u, i=i, r=one.landing: np.dot(r.g, u[3 * i : 3 * i + 3]) - r.bound_m_s)
        for j in range(i):
            away = np.subtract(one.position_enu_m, every[j].position_enu_m)
            far = np.linalg.norm(away)
            bound = -RATE_1_S * (far**2 - DISTANCE_M**2) / (2.0 * far) - slack
            found.append(
                lambda u, i=i, j=j, n=away / far, b=bound: (
                    n @ (u[3 * i : 3 * i + 3] - u[3 * j : 3 * j + 3]) - b
                )
            )
    return found


@pytest.mark.parametrize("seed", range(25))
def test_the_point_is_that_of_another_solver(seed):
    every, program = drawn(np.random.default_rng(seed)), JointProgram(3, DISTANCE_M)
    found = np.array(program.solve(every)).ravel()
    assert program.unsolved == 0
    nominal = np.array([one.nominal for one in every]).ravel()
    sides = [
        side
        for one in every
        for side in ([(-1.0, 1.0)] * 3 if one.landing is not None else [(v, v) for v in one.nominal])
    ]
    rows = constraints(every, 0.0)
    # the problem is convex, but the line search of SLSQP may stop early from one start
    others = [
        minimize(
            lambda u: 0.5 * np.sum((u - nominal) ** 2), start, jac=lambda u: u - nominal,
            bounds=sides, constraints=[{"type": "ineq", "fun": row} for row in rows], method="SLSQP",
            options={"ftol": 1e-12, "maxiter": 500},
        )
        for start in (np.clip(nominal, -1.0, 1.0), np.clip(0.5 * nominal, -1.0, 1.0), 0.9 * found)
    ]  # fmt: skip
    points = [other.x for other in others if other.success]
    assert program.relaxed == (not points)
    for point in points:
        assert found == pytest.approx(point, abs=1e-3)


def test_rows_of_two_give_way_and_the_landing_barrier_does_not():
    """Two that are inside each other's sphere can't leave it as fast as asked, in so small a box."""
    row = Row((0.3, 0.0, 1.0), 0.05)
    small = ((-0.1,) * 3, (0.1,) * 3)
    every = [One((0.0, 0.0, -1.0), row, *small, (x, 0.0, 1.0)) for x in (0.0, 0.05)]
    program = JointProgram(2, DISTANCE_M)
    one, other = program.solve(every)
    assert (program.relaxed, program.unsolved) == (1, 0)
    assert min(-row.missing_m_s(u) for u in (one, other)) > -1e-3
    assert (one[0], other[0]) == pytest.approx((-0.1, 0.1), abs=1e-3)


def test_vehicles_far_apart_fly_as_they_want():
    every = [One((0.3, 0.0, -0.2), Row((0.0, 0.0, 1.0), -1.0), (-1.0,) * 3, (1.0,) * 3, (x, 0.0, 1.0))
             for x in (0.0, 5.0)]  # fmt: skip
    assert JointProgram(2, DISTANCE_M).solve(every) == [(0.3, 0.0, -0.2)] * 2


def test_two_that_would_collide_pass_each_other():
    head_on = {"speed_m_s": 0.0, "random_heading": False}
    pair = [at(1.5, 0.05, (-3.0, 0.0, 0.9), **head_on), at(-1.5, -0.05, (3.0, 0.0, 0.9), **head_on)]
    found = central_team(team_of(*pair))
    flown = land_team(found, 1, exchange=(program := Central(found, DISTANCE_M)))
    alone = land_team(found, 1, exchange=lambda tick, outputs: [(), ()])
    assert alone.pairs[0].collided_ms is not None
    assert flown.pairs[0].collided_ms is None
    assert flown.pairs[0].distance_min_m > 0.3
    assert Outcome.CRASHED not in {each.verdict.outcome for each in flown.landings}
    assert set(program.programs) >= {2}

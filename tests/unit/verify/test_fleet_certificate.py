"""Compares the proof for fleets with random motions and constraints; tests each limit from both sides."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from flightstack.cli.check import check as check_verb
from flightstack.core.fleet.pair import barrier
from flightstack.core.fleet.solution import Row, nearest
from flightstack.core.types import ZERO
from flightstack.verify.certificate import checks
from flightstack.verify.envelope import extremes
from flightstack.verify.fleet import anywhere_m, one_short_m_s, steepest, team_checks, up_the_slope_m_s
from sim.scenarios import scenario
from tests.examples import examples
from tests.unit.verify.certificate_helpers import config

pytestmark = pytest.mark.slow

FLEET = {
    "id": 1, "members": [1, 2, 3], "radius_xy_m": 0.25, "radius_z_m": 0.75, "rate_1_s": 0.8,
    "speed_max_m_s": 1.0, "acceleration_max_m_s2": 1.0, "reach_m": 6.0, "age_max_s": 0.5,
    "latency_max_s": 0.15, "wait_max_s": 60.0, "pad_distance_m": 0.8, "margin_m": 0.08,
    "slew_xy_max_m_s2": 20.0,
}  # fmt: skip


def with_fleet(fleet=None, **sections):
    return config(fleet={**FLEET, **(fleet or {})}, **sections)


def one(name, fleet=None, **sections):
    (found,) = (each for each in checks(with_fleet(fleet, **sections)) if each.name == name)
    return found


STILL = {
    "touchdown": {"target_speed_max_m_s": 0.0, "pad_radius_m": 0.13},
    "envelope": {"target_acceleration_max_m_s2": 0.0},
}
WAIT_S = 13.1  # maximum wait of the third vehicle, s


@pytest.mark.parametrize(
    ("name", "passes", "fails", "more"),
    [
        # the limit is 0.25 / (1.3 * 0.27 s)
        ("fleet.rate_1_s", {"rate_1_s": 0.71}, {"rate_1_s": 0.714}, {"filter": "paper"}),
        ("shares", {"latency_max_s": 0.041}, {"latency_max_s": 0.039}, {"loop": {"rate_hz": 50}}),
        ("fleet.speed_max_m_s", {"speed_max_m_s": 1.733}, {"speed_max_m_s": 1.731}, {}),
        ("fleet.acceleration_max_m_s2", {"acceleration_max_m_s2": 3.78}, {"acceleration_max_m_s2": 3.77}, {}),
        ("fleet.reach_m", {"reach_m": 3.33}, {"reach_m": 3.3}, {}),
        ("slew, half share", {"acceleration_max_m_s2": 2.39}, {"acceleration_max_m_s2": 2.41}, {}),
        ("slew, whole share", {"acceleration_max_m_s2": 0.39}, {"acceleration_max_m_s2": 0.41}, {}),
        ("neighbours in reach", {"reach_m": 1.82, "speed_max_m_s": 0.5},
         {"reach_m": 1.81, "speed_max_m_s": 0.5}, {}),
        ("touchdowns", {"pad_distance_m": 0.511}, {"pad_distance_m": 0.509}, STILL),
        ("fleet.margin_m", {"margin_m": 0.101}, {"margin_m": 0.099}, {}),  # the limit is 2 * 0.04 / 0.8
        ("waits", {"wait_max_s": WAIT_S}, {"wait_max_s": WAIT_S - 0.1}, {}),
    ],
)  # fmt: skip
def test_each_limit_from_both_sides(name, passes, fails, more):
    assert one(name, passes, **more).proven
    found = one(name, fails, **more)
    assert not found.proven
    assert found.remedy


def closest_m(rate_1_s, lag_s, seed, root_1_s):
    """Return the lowest h while two vehicles fly towards each other, m; inf: the start is not admissible.

    Each vehicle takes half of the pair's constraint; the velocity loops are of first order.
    """
    rng = np.random.default_rng(seed)
    p = [rng.uniform(-1.5, 1.5, 3) for _ in range(2)]
    p[1][2] *= 0.3
    h_m, g = barrier(tuple(p[0] - p[1]), 0.25, 0.75)
    v = [rng.uniform(-1.0, 1.0, 3) for _ in range(2)]
    closing = -float(np.dot(g, v[0] - v[1]))
    if h_m < 0.0 or closing > root_1_s * h_m:
        return math.inf
    u, lowest, step_s = [v[0].copy(), v[1].copy()], h_m, 0.002
    for _ in range(3000):
        h_m, g = barrier(tuple(p[0] - p[1]), 0.25, 0.75)
        lowest, g = min(lowest, h_m), np.array(g)
        mean, wanted = 0.5 * (u[0] + u[1]), [1.5 * (p[1] - p[0]), 1.5 * (p[0] - p[1])]
        for me, out in ((0, g), (1, -g)):
            missing = out @ mean - 0.5 * rate_1_s * h_m - out @ wanted[me]
            u[me] = wanted[me] + max(0.0, missing) * out / (out @ out)
        for me in (0, 1):
            v[me] += step_s * (u[me] - v[me]) / lag_s
            p[me] = p[me] + step_s * v[me]
    return lowest


def test_two_that_lag_come_to_rest_outside_if_the_rate_is_proven_and_not_if_it_is_far_too_high():
    lag_s = 0.25
    root_1_s = 1.0 / (2.0 * lag_s)
    assert min(closest_m(0.25 / lag_s, lag_s, seed, root_1_s) for seed in range(25)) > -2e-3
    assert min(closest_m(4.0 / lag_s, lag_s, seed, 4.0 / lag_s) for seed in range(25)) < -2e-2


CONFIG = with_fleet()
X = extremes(CONFIG)
STEEPEST = steepest(CONFIG, X.shape)
BOX = ((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0))


def landing_row(slope, bearing, pad):
    """Return the constraint of the landing barrier at h = 0, for a pad with this horizontal velocity."""
    g = (-slope * math.cos(bearing), -slope * math.sin(bearing), 1.0)
    return Row(g, g[0] * pad[0] + g[1] * pad[1])


def neighbour_row(away, h_m, speed_m_s):
    """Return the constraint of a neighbour at the offset -``away``, which flies towards this vehicle."""
    _, g = barrier(away, 0.25, 0.75)
    length = math.hypot(*g)
    return Row(g, speed_m_s * length + CONFIG.fleet.growth_m_s - CONFIG.fleet.rate_1_s * h_m)


ANGLE, UNIT = st.floats(-math.pi, math.pi), st.floats(0.0, 1.0)
AWAY = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda p: math.hypot(*p) > 0.1)
SLOPE = st.floats(CONFIG.touchdown.pad_radius_m, 5.0).map(lambda d: X.barrier.slope(d))
CLIMB = st.floats(-1.0, 1.0)  # lower limit of the vertical velocity, which a filter may raise, m/s


def pad_of(share_of_speed, angle):
    speed = share_of_speed * CONFIG.touchdown.target_speed_max_m_s
    return speed * math.cos(angle), speed * math.sin(angle)


@examples(400)
@given(SLOPE, ANGLE, UNIT, ANGLE, CLIMB, st.lists(st.tuples(AWAY, UNIT), min_size=1, max_size=8))
def test_any_number_of_neighbours_leaves_a_common_point_from_far_enough(slope, n, w, pad, climb, others):
    from_m = anywhere_m(CONFIG)
    rows = [neighbour_row(away, from_m, speed) for away, speed in others]
    lower = (*BOX[0][:2], climb)
    assert nearest(ZERO, [landing_row(slope, n, pad_of(w, pad)), *rows], lower, BOX[1]) is not None


SHORT = one_short_m_s(CONFIG, up_the_slope_m_s(CONFIG, STEEPEST, X.target_climb_m_s), -math.pi / 2.0)


@examples(400)
@given(SLOPE, ANGLE, UNIT, ANGLE, CLIMB, AWAY)
def test_one_neighbour_leaves_a_common_point_from_where_it_is_said(slope, n, w, pad, climb, away):
    row = neighbour_row(away, SHORT[0] / CONFIG.fleet.rate_1_s, CONFIG.fleet.speed_max_m_s)
    lower = (*BOX[0][:2], climb)
    assert nearest(ZERO, [landing_row(slope, n, pad_of(w, pad)), row], lower, BOX[1]) is not None


def test_the_worst_neighbour_is_met_at_that_distance_and_not_nearer():
    slope, (short_m_s, elevation) = STEEPEST, SHORT
    # the point of the ellipsoid with this parametric elevation
    away = (math.cos(elevation), 0.0, math.sin(elevation) / CONFIG.fleet.flat)
    landing = landing_row(slope, 0.0, (-CONFIG.touchdown.target_speed_max_m_s, 0.0))
    for nearer_m, found in ((0.01, False), (-0.01, True)):
        row = neighbour_row(away, short_m_s / CONFIG.fleet.rate_1_s - nearer_m, CONFIG.fleet.speed_max_m_s)
        assert (nearest(ZERO, [landing, row], (-1.0, -1.0, 1.0), BOX[1]) is not None) is found
    assert short_m_s > 0.5


def test_two_from_opposite_sides_are_met_from_where_it_is_said_and_not_nearer():
    from_m = -one("several neighbours").room / CONFIG.fleet.rate_1_s
    for nearer_m, found in ((0.01, False), (-0.01, True)):
        rows = [neighbour_row((x, 0.0, 0.0), from_m - nearer_m, 1.0) for x in (1.0, -1.0)]
        assert (nearest(ZERO, rows, *BOX) is not None) is found


X_FIELD = extremes(scenario.load("field").onboard)


def test_all_members_together():
    members = [each.onboard for each in scenario.load("fleet_3").members]
    starts = scenario.load("fleet_3").starts_enu_m()
    assert starts == [(-1.0, 1.0, 1.2), (-1.5, 0.0, 1.2), (-1.0, -1.0, 1.2)]

    def found(configs=members, places=starts, touch=(0.14, 0.0, 0.05), apart_m=1.0):
        return {each.name: each for each in team_checks(configs, places, touch, [apart_m])}

    assert found()["one table"].proven
    assert found()["starts"].room == pytest.approx(barrier((0.5, 1.0, 0.0), 0.25, 0.75)[0])
    assert not found(places=[(0.0, 0.0, 1.0), (0.1, 0.1, 1.3)])["starts"].proven
    other = replace(members[1], fleet=replace(members[1].fleet, rate_1_s=0.9))
    last = replace(members[2], fleet=replace(members[2].fleet, members=(1, 3), wait_max_s=9.0))
    unlike = found([members[0], other, last])["one table"]
    assert not unlike.proven
    assert unlike.room == -3.0  # the keys of all members count, not only those of two
    assert unlike.worst == "3 members; different keys: rate_1_s, wait_max_s, members"
    assert unlike.remedy == "give all members the same fleet.rate_1_s, fleet.wait_max_s, fleet.members"
    assert "members" in found(members[:2])["one table"].worst
    # the loss of h is 2 * 0.05 m / 0.8, minus the margin of 0.045 m
    assert found()["contact"].proven
    assert not found(touch=(0.206, 0.0, 0.0))["contact"].proven
    assert found(touch=(0.204, 0.0, 0.0))["contact"].proven
    error_m = 2.0 * (5.0 * X_FIELD.velocity_error_m_s + X_FIELD.position_error_m)
    assert found(apart_m=0.81 + error_m)["pads"].proven
    assert not found(apart_m=0.79 + error_m)["pads"].proven
    paper = [replace(each, filter="paper") for each in members]
    assert found(paper, apart_m=0.81 + 2.0 * (5.0 * 0.06 + 0.02))["pads"].proven
    assert not found(paper, apart_m=0.79 + 2.0 * (5.0 * 0.06 + 0.02))["pads"].proven


def test_members_that_differ_are_checked_apart(tmp_path):
    (tmp_path / "mine.toml").write_text(
        'name = "mine"\ndescription = ""\nbase = "field"\n'
        "onboard.fleet.members = [1, 2]\nonboard.fleet.id = 1\n[[member]]\n"
        "[[member]]\nonboard.fleet.id = 2\nonboard.fleet.wait_max_s = 5.0\n"
    )
    done = CliRunner().invoke(check_verb, [str(tmp_path / "mine.toml"), "--json"])
    parts = json.loads(done.output)["parts"]
    assert [part["members"] for part in parts] == [["cf1"], ["cf2"], ["cf1", "cf2"]]
    waits = [next(each for each in part["checks"] if each["name"] == "waits") for part in parts[:2]]
    assert [each["proven"] for each in waits] == [True, False]
    assert [each["name"] for each in parts[2]["checks"]] == ["one table", "pads", "contact"]

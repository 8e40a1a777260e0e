"""Compares claims of the certificate with brute force, and tests each limit from both sides."""

import math
import random
from dataclasses import replace

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from flightstack.core.safety.barrier import RobustBarrier
from flightstack.core.safety.projection import best_corner
from flightstack.core.safety.qp_filter import SafetyFilter
from flightstack.core.types import FilterStatus
from flightstack.verify.bound import Span
from flightstack.verify.certificate import checks, problems
from flightstack.verify.envelope import extremes
from flightstack.verify.paper import shortfall
from flightstack.verify.robust import demand, demand_change, outside
from flightstack.verify.types import Need
from tests.examples import examples
from tests.unit.verify.certificate_helpers import config, one, rooms

pytestmark = pytest.mark.slow

BOX, AT_REST = {"velocity_max_m_s": [0.05, 0.05, 1.0]}, {"target_speed_max_m_s": 0.0}
GAIN_1_S = config().robust.gain_over_pad_1_s


def own(share):
    """Return keys for a velocity error whose time is ``share`` times that of the position loop."""
    return {"own": {"velocity_error_m_s": 0.05, "velocity_error_time_s": share / GAIN_1_S}}


# name of a check; changes with which the check just passes; changes with which the check just fails
LIMITS = [
    ("barrier", {"touchdown": {"target_speed_max_m_s": 1.0}}, None),
    *(
        (name, {section: {key: passes}}, {section: {key: fails}})
        for name, section, key, passes, fails in (
            ("robust.rate_1_s", "robust", "rate_1_s", 4.524, 4.525),  # 1 / (1.3 * 0.17 s)
            ("follow", "touchdown", "target_speed_max_m_s", 1.0, 1.0001),
            ("descent on a heaving pad", "envelope", "target_climb_max_m_s", 0.78, 0.7801),
            ("checks.target_speed_max_m_s", "checks", "target_speed_max_m_s", 0.5401, 0.5399),
            ("wait height", "robust", "wait_height_m", 0.214, 0.22),
            ("touch height", "robust", "touch_height_m", 0.02, 0.0145),
            ("corridor", "robust", "corridor_m", 0.1, 0.1001),
            ("descent time", "robust", "descent_m_s", 0.17, 0.15),
            ("altitude", "limits", "altitude_max_m", 0.853, 0.851),
            ("position loop", "robust", "gain_over_pad_1_s", 2.848, 2.850),  # 1 / (1.3 * 0.27 s)
            ("estimator", "target", "jerk_xy_m_s3_sqrthz", 0.2501, 0.2499),
        )
    ),
    *(
        (name, {**more, section: {**more.get(section, {}), key: passes}},
         {**more, section: {**more.get(section, {}), key: fails}})
        for name, more, section, key, passes, fails in (
            ("sampling, robust.rate_1_s", {"loop": {"rate_hz": 10}}, "robust", "rate_1_s", 5.0, 5.01),
            ("robust.acceleration_max_m_s2[0]", {"limits": BOX, "touchdown": AT_REST}, "robust",
             "acceleration_max_m_s2", [10.0, 5.0, 2.5], [10.01, 5.0, 2.5]),
            ("barrier's peak", {"barrier": {"alpha_1_m": 2.0, "beta_m": 1.0}}, "touchdown", "pad_radius_m",
             0.5, 0.501),
            ("estimator", {"target": {"jerk_growth_max": 5.0}}, "target", "jerk_xy_m_s3_sqrthz", 0.0501,
             0.0499),
            ("estimator", {"target": {"jerk_z_m_s3_sqrthz": 0.02}}, "envelope", "target_climb_max_m_s", 0.0,
             0.1),
        )
    ),
    ("own.velocity_error_time_s", own(0.499), own(0.501)),
]  # fmt: skip


@pytest.mark.parametrize(("name", "passes", "fails"), LIMITS)
def test_each_limit_from_both_sides(name, passes, fails):
    assert one(name, **passes).proven
    if fails is not None:
        found = one(name, **fails)
        assert not found.proven
        assert found.remedy
        if found.need is Need.FLIGHT:
            assert found.text in problems(config(**fails))


def test_a_configuration_made_in_python_may_hold_lists():
    made = config()
    listed = replace(made, limits=replace(made.limits, velocity_max_m_s=list(made.limits.velocity_max_m_s)))
    assert [each.name for each in checks(listed)] == [each.name for each in checks(made)]


@pytest.mark.parametrize("alpha_1_m", [0.5, 2.0, 2.5, 3.33, 3.34, 5.0, 9.0])
def test_barriers_peak_is_proven_if_the_boundary_rises_at_every_distance_over_the_pad(alpha_1_m):
    sections = {"barrier": {"alpha_1_m": alpha_1_m, "beta_m": 0.5}, "touchdown": {"pad_radius_m": 0.3}}
    barrier = config(**sections).barrier
    rises = all(barrier.slope(k * 0.3 / 1000) >= 0.0 for k in range(1001))
    assert one("barrier's peak", **sections).proven == rises


def states(seed, x, count):
    """Yield random distance, direction, margin and target velocity in the envelope, often at its limits."""
    rng = random.Random(seed)

    def some(low, high):
        return rng.choice((low, high, rng.uniform(low, high), rng.uniform(low, high)))

    for _ in range(count):
        d = rng.choice((rng.expovariate(1.0), rng.uniform(0.0, 0.3), 0.0, x.barrier.peak_distance_m))
        angle, heading = rng.choice((0.0, math.pi / 2, rng.uniform(0, math.tau))), rng.uniform(0, math.tau)
        speed = some(0.0, x.target_speed_m_s)
        target = (
            speed * math.cos(heading),
            speed * math.sin(heading),
            some(-x.target_climb_m_s, x.target_climb_m_s),
        )
        yield d, angle, some(*x.shape.margin_m), target, rng


SETS = [
    {},
    {"envelope": {"target_climb_max_m_s": 0.3}},
    {"limits": {"velocity_max_m_s": [0.6, 0.3, 0.9]}, "touchdown": {"target_speed_max_m_s": 0.6}},
    {"barrier": {"alpha_1_m": 2.0, "beta_m": 1.2}, "robust": {"fade_radius_m": 0.03}},
]


@pytest.mark.parametrize("number", range(len(SETS)))
def test_no_state_of_the_envelope_beats_the_feasibility_bound(number):
    settled = config(**SETS[number])
    x = extremes(settled)
    box = settled.limits.velocity_max_m_s
    bound = -shortfall(x.shape, box, x.target_speed_m_s, x.target_climb_m_s).bound
    lower = tuple(-v for v in box)
    program = SafetyFilter(settled.robust.rate_1_s)
    least = math.inf
    for n, (d, angle, margin, target, _) in enumerate(states(number, x, 3000)):
        held = RobustBarrier(x.barrier, margin, x.shape.fade_radius_m)
        flat = (d * math.cos(angle), d * math.sin(angle))
        e = (*flat, -held.h((*flat, 0.0)))  # a position with h = 0
        h, gradient, dh_dt = held.evaluate(e, target)
        corner = best_corner(gradient, lower, box)
        rise = sum(g * u for g, u in zip(gradient, corner, strict=True)) + dh_dt
        assert rise >= bound - 1e-9
        least = min(least, rise)
        if n % 10 == 0:
            status = program.solve((0.0, 0.0, -9.0), h, gradient, dh_dt, lower, box).status
            assert (status is FilterStatus.INFEASIBLE) == (rise < 0.0)
    assert least <= bound + 0.3  # the bound is at most 0.3 m/s below the worst case


@pytest.mark.parametrize("number", range(len(SETS)))
def test_demand_and_its_growth_stay_below_their_bounds(number):
    """On the boundary, the required climb and its rate are below the bounds for all allowed motions."""
    settled = config(**SETS[number])
    x = extremes(settled)
    w, step_s, ahead_s = x.shape.fade_radius_m, 1e-5, 1e-3
    largest = outside(x, lambda d: demand(x, x.shape.slope(d))).bound
    ax, ay, _ = settled.robust.acceleration_max_m_s2
    closest = math.inf
    for d, angle, margin, _, rng in states(100 + number, x, 2000):
        d += x.pad_radius_m + 0.01
        held = RobustBarrier(x.barrier, margin, w)
        outer = x.barrier.slope(d) + 2.0 * margin * d / w**2 * math.exp(-((d / w) ** 2)) < 0.0
        speed = x.box_speed_m_s if outer else x.slip_m_s
        push = (math.hypot(ax, ay) if outer else 0.0) + x.target_acceleration_m_s2
        along, across = rng.uniform(0.0, math.tau), rng.uniform(0.0, math.tau)
        e = (d * math.cos(angle), d * math.sin(angle))
        v = (speed * math.cos(along), speed * math.sin(along))
        a = (push * math.cos(across), push * math.sin(across))

        def needed(t, e=e, v=v, a=a, held=held):
            x0, y0 = (q + p * t + 0.5 * k * t * t for q, p, k in zip(e, v, a, strict=True))
            vx, vy = (p + k * t for p, k in zip(v, a, strict=True))
            return (held.h((x0, y0, 0.0)) - held.h((x0 + vx * step_s, y0 + vy * step_s, 0.0))) / step_s

        assert needed(0.0) <= largest + 1e-3
        grown = (needed(ahead_s) - needed(0.0)) / ahead_s
        bound = demand_change(settled, x, x.shape, Span(d - 0.01, d + 0.01))
        assert grown <= bound + 0.02
        assert -grown <= demand_change(settled, x, x.shape, Span(d - 0.01, d + 0.01), -1.0) + 0.02
        closest = min(closest, bound - x.heave_acceleration_m_s2 - grown)
    assert closest < 0.3  # m/s^2: the bound is close to the largest observed value


TIGHTER = [
    ("robust", "tracking_error_m_s", ("recovery", "climb", "h outside the pad", "commit height"), 1.0),
    ("own", "position_noise_m", ("h outside the pad", "drift", "commit height"), 0.1),
    ("touchdown", "target_speed_max_m_s", ("barrier", "recovery", "climb", "follow"), 1.0),
    ("envelope", "target_climb_max_m_s", ("barrier", "recovery", "climb", "h outside the pad"), 2.0),
    ("envelope", "target_acceleration_max_m_s2", ("acceleration", "h outside the pad", "drift"), 4.0),
    ("envelope", "lag_spread", ("robust.rate_1_s", "acceleration", "position loop", "drift"), 0.9),
    ("robust", "commit_speed_m_s", ("drift",), 1.0),
    ("robust", "commit_radius_m", ("drift", "commit height"), 0.3),
    ("velocity_loop", "lag_z_s", ("robust.rate_1_s",), 1.0),
]


@pytest.mark.parametrize(("section", "key", "names", "most"), TIGHTER)
@examples(5)
@given(shares=st.tuples(st.floats(0.05, 1.0), st.floats(0.05, 1.0)))
@example(shares=(0.05, 1.0))  # with the maximum tracking error, a negative h recovers at 0 m/s
def test_more_of_what_is_bad_never_leaves_more_room(section, key, names, most, shares):
    less, more = sorted(share * most for share in shares)
    good, bad = rooms(**{section: {key: less}}), rooms(**{section: {key: more}})
    for name in names:
        assert bad[name] <= good[name] + 2e-4, name


def test_the_voltage_that_the_reserve_check_names_is_the_lowest_that_it_proves():
    table = {"hover_throttle": 0.78, "hover_voltage_v": 3.7, "lowest_voltage_v": 3.2, "sag_v": 0.4}
    tired = one("thrust reserve", reserve=table)
    assert not tired.proven
    assert tired.need is Need.PROOF
    named_v = float(tired.remedy.split(" to ")[1].split(" or ")[0])
    assert "raise reserve.lowest_voltage_v" in tired.remedy
    assert one("thrust reserve", reserve=table | {"lowest_voltage_v": named_v}).proven
    assert not one("thrust reserve", reserve=table | {"lowest_voltage_v": named_v - 0.02}).proven
    fresh = one("thrust reserve", reserve=table | {"lowest_voltage_v": named_v})
    # the required vertical acceleration, m/s^2
    needed = config().robust.acceleration_max_m_s2[2] - rooms()["acceleration"]
    assert f"{needed:.3g} are needed" in fresh.worst
    assert "thrust reserve" not in rooms()
    limited = one("thrust reserve", reserve=table | {"motor_voltage_max_v": 3.07})
    assert "which no voltage gives" in limited.worst
    assert limited.remedy.startswith("raise reserve.share")


def test_the_commit_height_is_where_the_vehicle_would_hover():
    base = one("commit height")
    exact = config().robust.commit_height_m - base.room
    assert one("commit height", robust={"commit_height_m": exact + 1e-4}).proven
    assert not one("commit height", robust={"commit_height_m": exact - 1e-4}).proven

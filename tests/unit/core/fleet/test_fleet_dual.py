"""Tests the exactness of the fleet program's solutions, and the constraints that silent vehicles cause."""

import math
import random

import pytest
from hypothesis import given

from flightstack.core.fleet import solution
from flightstack.core.fleet.member import HELD_BACK_M_S, FleetMember
from flightstack.core.fleet.pair import (
    ALL,
    DRIFT_M_S,
    DRIFT_MAX_M,
    LEAD_S,
    SINK_M_S,
    barrier,
    estimate,
    row,
    wider,
)
from flightstack.core.fleet.precedence import decide
from flightstack.core.fleet.program import FleetProgram
from flightstack.core.fleet.solution import Row
from flightstack.core.memory import FleetMemory, Heard
from flightstack.core.parameters.fleet import CARRIED_AGES, Fleet
from flightstack.core.types import ZERO, Intent, MemberStatus, OwnState, Phase
from tests.examples import examples
from tests.unit.core.fleet.test_fleet_program import VECTORS, boxes, missing, rows

FLEET = Fleet(3, (3, 7))


def test_nearly_all_programs_are_confirmed():
    chance, unsure = random.Random(4), 0
    for _ in range(2000):
        made = []
        for _ in range(chance.randint(2, 9)):
            g = [chance.gauss(0.0, 1.0) for _ in range(3)]
            made.append(Row(tuple(x / math.hypot(*g) for x in g), chance.uniform(-1.0, 0.3)))
        unsure += (
            solution.by_active_set(
                tuple(chance.uniform(-1, 1) for _ in range(3)), made, (-0.6,) * 3, (0.6,) * 3
            )
            is None
        )
    assert unsure == 0


# inputs of a tick of `fleet_3`: the slew limit permits few velocities; the nominal velocity is lowest in z
IN_FLIGHT = (
    (0.23562030240347953, -1.0276756593002732, -0.14770333756579554),
    [
        Row((-0.08812922613441608, 0.18278009364482725, 1.0), -0.4960209659927682),
        Row((-0.08812922613441608, 0.18278009364482725, 0.0), -0.12622807334641106),
        Row((0.6052001162126651, 0.7960689830320591, 0.0010757836573145592), -0.12669354272984673),
        Row((-0.0361829814480803, 0.9993451688845963, -6.467970973815599e-05), -0.446350051053737),
    ],
    (0.3490912035365606, -0.4519051404781362, -0.14770333756579554),
    (0.3773754747840225, -0.42362086923067427, -0.12340783654644691),
)


def test_a_program_that_the_active_set_method_does_not_confirm_is_solved_by_all_sets():
    nominal, made, lower, upper = IN_FLIGHT
    assert solution.by_active_set(*IN_FLIGHT) is None
    assert solution.nearest(*IN_FLIGHT) == solution.by_all_sets(*IN_FLIGHT)
    found = FleetProgram().solve(nominal, made[:1], made[1:], lower, upper)
    assert found.filter.status.name in ("SOLVED", "CLOSED_FORM")
    assert found.given_m_s == 0.0  # no neighbour's constraint is relaxed
    assert max(row.missing_m_s(found.filter.velocity_enu_m_s) for row in made) <= 1e-6


@examples(300)
@given(VECTORS, rows(), boxes())
def test_the_active_set_method_finds_the_point_that_all_sets_give(nominal, found, box):
    quick, slow = solution.by_active_set(nominal, found, *box), solution.by_all_sets(nominal, found, *box)
    if quick is None or any(math.hypot(*row.g) <= 1e-9 for row in found):
        return
    assert (quick.point is None) == (slow is None)
    if slow is None:
        assert quick.lacking_m_s > 0.0
        return
    assert missing(found, *box, quick.point) <= 1e-8
    assert math.dist(quick.point, nominal) <= math.dist(slow[0], nominal) + 1e-7
    assert all(each >= 0.0 for each in quick.multipliers)


@pytest.mark.parametrize(("bound_m_s", "status"), [(-1.0, "SOLVED"), (0.5, "CROWDED")])
def test_a_row_without_a_direction_is_met_by_all_velocities_or_by_none(bound_m_s, status):
    rows = [Row(ZERO, bound_m_s), Row((1.0, 0.0, 0.0), 0.5)]
    found = FleetProgram().solve(ZERO, (), rows, (-1.0,) * 3, (1.0,) * 3)
    assert found.filter.status.name == status
    if status == "SOLVED":
        assert found.filter.velocity_enu_m_s == pytest.approx((0.5, 0.0, 0.0))


def word(stamp_s=0.0, velocity=ZERO, **keys):
    return MemberStatus(
        7, stamp_s, stamp_s, ZERO, velocity, **{"wanted_enu_m_s": ZERO, "intent": Intent.WAITING, **keys}
    )


def test_a_silent_vehicle_is_carried_on_with_its_last_set_point_for_as_long_as_its_autopilot_flies_on():
    told = word(velocity=(0.5, 0.0, 0.0), wanted_enu_m_s=(0.8, 0.0, -0.4))
    faster_m_s2, late_s = (1.0, 0.0, 0.0), FLEET.latency_max_s
    set_point_m_s, flies_s = 0.8 + LEAD_S, CARRIED_AGES * FLEET.age_max_s
    for now_s, x, v in (
        (0.1, 0.05, 0.5),
        (0.6, 0.5 * late_s + set_point_m_s * (0.6 - late_s), set_point_m_s),
        (flies_s + 2.0, 0.5 * late_s + set_point_m_s * (flies_s - late_s), 0.0),
    ):
        now = estimate(told, now_s, 0.0, FLEET, faster_m_s2)
        assert now.position_enu_m[0] == pytest.approx(x)
        assert now.velocity_enu_m_s[0] == pytest.approx(v)
        assert now.late == (now_s > FLEET.latency_max_s)
    assert now.position_enu_m[2] == pytest.approx(-0.4 * (FLEET.age_max_s - late_s))


def test_a_silent_vehicle_may_be_anywhere_from_where_its_autopilot_holds_it_down_to_where_it_has_sunk():
    now = estimate(word(), 3.0, 0.0, FLEET)
    low_m = -SINK_M_S * (3.0 - FLEET.latency_max_s)
    for z, away_z, moves in (
        (0.4, 0.4, 0.0),
        (0.0, 0.0, 0.0),
        (low_m, 0.0, 0.0),
        (low_m - 0.3, -0.3, -SINK_M_S),
    ):
        away, velocity = now.beside((1.0, 0.0, z))
        assert away == pytest.approx((1.0, 0.0, away_z))
        assert velocity == (0.0, 0.0, moves)
    down = estimate(word(), FLEET.silent_flight_s + 1.0, 0.0, FLEET)
    assert down.beside((0.0, 0.0, -9.0))[1] == ZERO
    heard = estimate(word(), 0.1, 0.0, FLEET)
    assert heard.beside((1.0, 0.0, -0.3)) == ((1.0, 0.0, -0.3), ZERO)


def test_where_a_silent_vehicle_is_taken_to_be_grows_by_its_drift_until_it_is_down():
    plain_m = estimate(word(), FLEET.latency_max_s, 0.0, FLEET).grown_m
    for now_s, drift_m in (
        (1.0, DRIFT_M_S * (1.0 - FLEET.latency_max_s)),
        (FLEET.silent_flight_s, DRIFT_MAX_M),
        (9.0, 0.0),
    ):
        now = estimate(word(), now_s, 0.0, FLEET)
        assert now.grown_m - plain_m == pytest.approx(drift_m)
        assert (now.growth_m_s > 0.0) == (now_s == 1.0)


@pytest.mark.parametrize(
    ("now_s", "away_m", "asked"),
    [
        (1.5, 0.9, "no nearer"),  # this vehicle is where the silent vehicle may be
        (1.5, 2.9, "outside"),
        (9.0, 2.0, "lax"),  # the silent vehicle has landed; this vehicle is where the silent vehicle may be
        (9.0, 9.0, "outside"),
    ],
)
def test_who_may_meet_a_silent_vehicle_comes_no_nearer_and_who_is_outside_stays_so(now_s, away_m, asked):
    now = estimate(word(), now_s, 0.0, FLEET)
    p = (away_m, 0.0, 0.0)
    h_m, g = barrier(p, FLEET.radius_xy_m + now.grown_m, FLEET.radius_z_m + now.grown_m)
    outer_m, _ = barrier(p, FLEET.radius_xy_m + now.anywhere_m, FLEET.radius_z_m + now.anywhere_m)
    lax = row(ALL, h_m, g, ZERO, word(), now, FLEET)
    made = wider(lax, outer_m, now, FLEET)
    assert made.bound_m_s >= lax.bound_m_s
    if asked == "no nearer":
        assert outer_m < 0.0
        assert made.bound_m_s == 0.0
    elif asked == "lax":
        assert outer_m < 0.0
        assert made == lax
    else:
        assert outer_m > 0.0
        assert made.bound_m_s > -FLEET.rate_1_s * h_m
        assert made.bound_m_s <= 0.0


def way_of(own, members, heard, down=(), now_s=10.0):
    fleet = Fleet(own, members)
    slots = [
        (
            n,
            Heard(
                word(
                    now_s - (0.1 if n in heard else 2.0), intent=Intent.DOWN if n in down else Intent.WAITING
                )
            ),
        )
        for n in fleet.others
    ]
    return decide(FleetMemory(), slots, Phase.HOLD, None, now_s, fleet)


@pytest.mark.parametrize(
    ("own", "members", "heard", "down", "cut_off"),
    [
        (1, (1, 2, 3), (2,), (), False),
        (3, (1, 2, 3), (), (), True),
        (1, (1, 2, 3), (), (), True),
        (1, (1, 2), (), (), False),  # of two parts with equal size, the part with the lowest id continues
        (2, (1, 2), (), (), True),
        (2, (1, 2), (), (1,), False),  # vehicle 1 has landed and may stop sending
        (3, (1, 2, 3, 4), (4,), (), True),
        (2, (1, 2, 3, 4), (1,), (), False),
        (3, (1, 2, 3), (1,), (1,), False),
    ],
)
def test_of_the_parts_of_a_fleet_that_do_not_hear_each_other_one_goes_on(own, members, heard, down, cut_off):
    assert way_of(own, members, heard, down).cut_off is cut_off


def test_a_member_that_was_never_heard_cuts_nobody_off():
    fleet = Fleet(3, (1, 3, 7))
    slots = [(n, Heard()) for n in fleet.others]
    assert not decide(FleetMemory(), slots, Phase.HOLD, None, 1.0, fleet).cut_off


def test_who_may_meet_a_silent_vehicle_holds_back_while_that_may_fly():
    member = FleetMember(FLEET, 0.0)
    own = OwnState(0.0, 0.0, (0.6, 0.0, 0.0), ZERO, 0.0)
    asked = (0.0, 1.0, -1.0)
    member.take([word()], 0.0)
    for now_s, expected in (
        (0.1, asked),
        (FLEET.age_max_s + 0.1, (0.0, HELD_BACK_M_S, -1.0)),
        (FLEET.silent_flight_s - 0.1, (0.0, HELD_BACK_M_S, -1.0)),
        (FLEET.silent_flight_s + 0.1, asked),  # by this time the silent vehicle has landed
    ):
        nominal, rows = member.beside(Phase.APPROACH, own, lambda _: ZERO, asked, (1.0, 1.0, 1.0), now_s)
        assert len(rows.rows) == 1
        assert nominal[1:] == pytest.approx(expected[1:])

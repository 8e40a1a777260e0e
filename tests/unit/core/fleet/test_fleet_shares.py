"""Tests that two vehicles' shares sum to at least 1 and keep them apart, also with late or lost messages."""

import heapq
import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.core.fleet.member import FleetMember
from flightstack.core.fleet.pair import ALL, HALF, NONE, barrier, estimate, growth, jump, row, share
from flightstack.core.fleet.program import FleetProgram
from flightstack.core.memory import AbortWay, Heard, Memory
from flightstack.core.parameters.fleet import Fleet
from flightstack.core.types import ZERO, Intent, Landed, MemberStatus, Mode, OwnState, Phase, VehicleStatus
from tests.examples import examples

TICK_S = 0.02
A, B = Fleet(3, (3, 7)), Fleet(7, (3, 7))
FLYING = VehicleStatus(0.0, True, Mode.EXTERNAL, Landed.IN_AIR, True)
# phases that may follow each phase; before TOUCHDOWN the neighbours have received messages with phase LAND
AFTER = {
    Phase.APPROACH: (Phase.APPROACH, Phase.LAND, Phase.HOLD),
    Phase.LAND: (Phase.LAND, Phase.APPROACH, Phase.TOUCHDOWN),
    Phase.TOUCHDOWN: (Phase.TOUCHDOWN, Phase.APPROACH, Phase.LANDED),
    Phase.HOLD: (Phase.HOLD, Phase.APPROACH),
    Phase.LANDED: (Phase.LANDED, Phase.APPROACH),  # after a landing the next flight starts
}


class Side:
    """One vehicle: the messages that it will receive, and its current share."""

    def __init__(self, fleet, offset_s, rng):
        self.fleet, self.offset_s, self.rng = fleet, offset_s, rng
        self.member, self.memory = FleetMember(fleet, 0.0), Memory(phase=Phase.APPROACH)
        self.queue, self.part = [], ALL

    def step(self, t_s):
        now_s = t_s + self.offset_s  # time on the vehicle's clock
        while self.queue and self.queue[0][0] <= t_s:
            assert self.member.take([heapq.heappop(self.queue)[2]], now_s) == []
        slot, mission = self.member.memory.slots[0], self.memory
        if self.rng.random() < (0.1 if slot.yields else 0.03):
            slot.yields = not slot.yields
        if self.rng.random() < (0.02 if mission.phase is Phase.APPROACH else 0.15):
            after = Phase(self.rng.choice(AFTER[mission.phase]))
            told_s = now_s - self.member.memory.committed_s
            if after is not Phase.TOUCHDOWN or told_s >= self.fleet.age_max_s + self.fleet.latency_max_s:
                mission.phase = after
        firm = mission.phase in (Phase.TOUCHDOWN, Phase.LANDED)
        self.part = NONE if firm or slot.message is None else share(slot, slot.message, now_s, self.fleet)
        own = OwnState(now_s, now_s, ZERO, ZERO, 0.0)
        return self.member.message(mission, own, FLYING, lambda _: ZERO, None, now_s)


@examples(60)
@given(
    st.integers(0, 2**32), st.sampled_from([0.0, 0.1, 0.5, 0.8]), st.floats(TICK_S, A.latency_max_s),
    st.floats(0.0, 0.05),
    st.floats(-1.0, 1.0),
)  # fmt: skip
def test_the_shares_that_two_vehicles_fly_sum_to_one_or_more(seed, lost, slowest_s, bound_s, error):
    rng, count = np.random.default_rng(seed), itertools.count()
    sides, back_s = (Side(A, 0.0, rng), Side(B, 5.0, rng)), [0.0, 0.0]
    for tick in range(600):
        t_s = tick * TICK_S
        words = [side.step(t_s) for side in sides]
        flown = [side.part for side in sides]
        down = [side.memory.phase in (Phase.TOUCHDOWN, Phase.LANDED) for side in sides]
        heard = all(side.member.memory.slots[0].message is not None for side in sides)
        if heard and not all(down):  # the right of way keeps one of the vehicles off the pad
            assert sum(flown) >= 1.0, (t_s, flown, [side.memory.phase for side in sides])
        for me, other, word in ((0, 1, words[1]), (1, 0, words[0])):
            if rng.random() < 0.1 * lost:
                back_s[me] = t_s + rng.uniform(0.0, 0.8)
            if t_s < back_s[me] or rng.random() < lost:
                continue
            shift_s = sides[me].offset_s - sides[other].offset_s + error * bound_s
            came = word._replace(stamp_s=word.stamp_s + shift_s, clock_bound_s=bound_s)
            at_s = t_s + rng.uniform(TICK_S, slowest_s)
            heapq.heappush(sides[me].queue, (at_s, next(count), came))


def word_of(intent=Intent.WAITING, stamp_s=0.0, **keys):
    return MemberStatus(7, stamp_s, stamp_s, (1.0, 0.0, 1.0), ZERO, ZERO, intent=intent, **keys)


POINT = st.tuples(*[st.floats(-3.0, 3.0)] * 3)


@examples(200)
@given(POINT, POINT)
def test_the_barrier_is_convex_with_the_gradient_of_finite_differences(p, q):
    h_m, g = barrier(p, 0.25, 0.75)
    assert math.hypot(*g) <= 1.0 + 1e-12
    then_m, _ = barrier(tuple(a + b for a, b in zip(p, q, strict=True)), 0.25, 0.75)
    # the tolerance covers that h is constant within 1 um of the centre
    assert then_m >= h_m + sum(a * b for a, b in zip(g, q, strict=True)) - 1.1e-6
    if h_m > -0.2:
        for axis in range(3):
            ahead, back = list(p), list(p)
            ahead[axis] += 1e-6
            back[axis] -= 1e-6
            slope = (barrier(tuple(ahead), 0.25, 0.75)[0] - barrier(tuple(back), 0.25, 0.75)[0]) / 2e-6
            assert slope == pytest.approx(g[axis], abs=1e-5)


@examples(60)
@given(st.integers(0, 2**32), st.floats(0.0, 1.0))
def test_no_vehicle_within_its_limits_leaves_what_its_ellipsoid_grew_by(seed, share_of_speed):
    rng = np.random.default_rng(seed)
    v = rng.normal(size=3)
    v *= share_of_speed * A.speed_max_m_s / np.linalg.norm(v)
    told = MemberStatus(7, 0.0, 0.0, ZERO, tuple(v.tolist()), ZERO)
    p, at, before_m = np.zeros(3), v.copy(), 0.0
    away = rng.normal(size=3)
    for tick in range(1, round(A.silent_flight_s / 0.01)):
        at = at + 0.01 * A.acceleration_max_m_s2 * away / np.linalg.norm(away)
        at *= min(1.0, A.speed_max_m_s / np.linalg.norm(at))
        p = p + 0.01 * at
        now = estimate(told, 0.01 * tick, 0.0, A)
        assert math.dist(p, now.position_enu_m) <= now.anywhere_m - A.margin_m + 0.01 * A.speed_max_m_s
        assert now.anywhere_m >= before_m
        before_m = now.anywhere_m


@examples(60)
@given(st.integers(0, 2**32), st.floats(0.0, 1.0), st.floats(0.0, 0.05))
def test_a_vehicle_within_its_limits_never_jumps_and_one_that_lies_always_does(seed, lost, sigma_m):
    rng = np.random.default_rng(seed)
    p, v, told = rng.normal(size=3), np.zeros(3), None
    for tick in range(300):
        v += 0.01 * A.acceleration_max_m_s2 * _towards(rng)
        v *= min(1.0, A.speed_max_m_s / np.linalg.norm(v))
        p = p + 0.01 * v
        if told is not None and rng.random() < lost:
            continue
        error = sigma_m * _towards(rng)  # the message reports the length of this error as standard deviation
        says = MemberStatus(
            7, 0.01 * tick, 0.0, tuple((p + error).tolist()), tuple(v.tolist()), ZERO, sigma_m
        )
        if told is not None:
            assert jump(told, says, A) == ZERO
            since_s = says.stamp_s - told.stamp_s
            covered_m = growth(since_s, math.hypot(*told.velocity_enu_m_s), A)[0] + A.margin_m
            covered_m += A.sigma_factor * math.hypot(sigma_m, sigma_m)
            carried = np.array(told.position_enu_m) + since_s * np.array(told.velocity_enu_m_s)
            for share, jumps in ((0.99, False), (1.01, True)):
                away = share * covered_m * _towards(rng)
                lie = says._replace(position_enu_m=tuple((carried + away).tolist()))
                found = jump(told, lie, A)
                assert found == (pytest.approx(away.tolist()) if jumps else ZERO)
        told = says


def _towards(rng):
    away = rng.normal(size=3)
    return away / np.linalg.norm(away)


def test_a_place_that_jumps_makes_the_ellipsoid_larger_until_it_jumps_back():
    member, own = FleetMember(A, 0.0), OwnState(0.0, 0.0, (2.0, 0.0, 1.0), ZERO, 0.0)
    told = word_of()._replace(position_enu_m=(0.0, 0.0, 1.0))

    def take(stamp_s, x):
        place = (x, 0.0, 1.0)
        texts = member.take([told._replace(stamp_s=stamp_s, position_enu_m=place)], stamp_s)
        return texts, member.rows(Phase.APPROACH, own, ZERO, stamp_s).neighbours[0].h_m

    assert take(0.0, 0.0) == ([], pytest.approx(2.0 - A.radius_xy_m - A.margin_m))
    texts, h_m = take(0.02, 0.5)
    assert texts == [
        "the position of vehicle 7 jumps by 0.50 m: its ellipsoid is larger by 0.50 m now, since either "
        "position may be wrong"
    ]
    assert h_m == pytest.approx(1.0 - A.radius_xy_m - A.margin_m)  # the ellipsoid contains both positions
    assert take(0.04, 0.5) == ([], pytest.approx(h_m))  # after the jump the ellipsoid remains larger
    texts, h_m = take(0.06, 0.0)
    assert [text[:35] for text in texts] == ["the position of vehicle 7 jumps by "]
    assert h_m == pytest.approx(2.0 - A.radius_xy_m - A.margin_m)  # the position has jumped back


PROGRAM = FleetProgram()
BOX = ((-1.0,) * 3, (1.0,) * 3)


@examples(40)
@given(st.integers(0, 2**32), st.sampled_from([(HALF, HALF), (ALL, NONE), (NONE, ALL), (ALL, HALF)]))
def test_two_points_that_follow_their_rows_never_come_too_near(seed, parts):
    rng = np.random.default_rng(seed)
    p, u = [rng.uniform(-1.0, 1.0, 3) for _ in range(2)], [np.zeros(3), np.zeros(3)]
    if barrier(tuple(p[0] - p[1]), 0.25, 0.75)[0] < 0.0:
        return
    wanted = [p[1] - p[0], p[0] - p[1]]
    for tick in range(150):
        if tick % 30 == 29:
            wanted = [rng.uniform(-1.5, 1.5, 3) for _ in range(2)]
        told = [tuple(v.tolist()) for v in u]
        # the vehicle with the larger share flies last, because it reacts to the velocity of the other vehicle
        for me in sorted((0, 1), key=lambda k: parts[k]):
            if parts[me] == NONE:
                u[me] = np.clip(wanted[me], -1.0, 1.0)
                continue
            h_m, g = barrier(tuple((p[me] - p[1 - me]).tolist()), 0.25, 0.75)
            speed = tuple(u[1 - me].tolist())
            other = word_of()._replace(velocity_enu_m_s=speed, wanted_enu_m_s=told[1 - me])
            made = row(parts[me], h_m, g, told[me], other, estimate(other, 0.0, 0.0, A), A)
            found = PROGRAM.solve(tuple(wanted[me].tolist()), (), [made], *BOX)
            assert found.given_m_s == 0.0
            u[me] = np.array(found.filter.velocity_enu_m_s)
        before_m = barrier(tuple(p[0] - p[1]), 0.25, 0.75)[0]
        p = [a + TICK_S * b for a, b in zip(p, u, strict=True)]
        after_m = barrier(tuple(p[0] - p[1]), 0.25, 0.75)[0]
        assert after_m >= (1.0 - A.rate_1_s * TICK_S) * before_m - 1e-6


@pytest.mark.parametrize(
    ("phase", "keys", "granted", "landed", "expected"),
    [
        (Phase.WAIT, {}, False, Landed.ON_GROUND, Intent.STANDING),
        (Phase.WAIT, {}, False, Landed.IN_AIR, Intent.WAITING),
        (Phase.TAKEOFF, {}, False, Landed.IN_AIR, Intent.STANDING),
        (Phase.TAKEOFF, {"climbed": True}, False, Landed.IN_AIR, Intent.WAITING),
        (Phase.APPROACH, {}, False, Landed.IN_AIR, Intent.WAITING),
        (Phase.APPROACH, {}, True, Landed.IN_AIR, Intent.LANDING),
        (Phase.LAND, {}, True, Landed.IN_AIR, Intent.COMMITTED),
        (Phase.TOUCHDOWN, {}, True, Landed.IN_AIR, Intent.COMMITTED),
        (Phase.LANDED, {}, False, Landed.ON_GROUND, Intent.DOWN),
        (Phase.LEAVE, {}, False, Landed.ON_GROUND, Intent.STANDING),
        (Phase.LEAVE, {}, False, Landed.IN_AIR, Intent.CLEARING),
        (Phase.LEAVE, {"clear": True}, False, Landed.IN_AIR, Intent.DOWN),
        (Phase.LEAVE, {"clear": True}, False, Landed.ON_GROUND, Intent.DOWN),
        (Phase.HOLD, {}, False, Landed.IN_AIR, Intent.CLEARING),
        (Phase.CLIMB, {}, False, Landed.IN_AIR, Intent.CLEARING),
        (Phase.ABORT, {"abort_way": AbortWay.FLY_CLEAR}, False, Landed.IN_AIR, Intent.CLEARING),
        (Phase.ABORT, {"abort_way": AbortWay.FLY_CLEAR, "clear": True}, False, Landed.IN_AIR, Intent.DOWN),
        (Phase.ABORT, {"abort_way": AbortWay.LAND_HERE}, False, Landed.IN_AIR, Intent.DOWN),
    ],
)
def test_what_the_others_are_told_of_each_phase(phase, keys, granted, landed, expected):
    member = FleetMember(A, 0.01)
    member.memory.granted = granted
    own = OwnState(0.9, 0.9, (1.0, 2.0, 3.0), (0.5, 0.0, 0.0), 0.0)
    status = VehicleStatus(0.0, True, Mode.EXTERNAL, landed, True)
    said = member.message(Memory(phase=phase, **keys), own, status, lambda _: (0.1, 0.2, 0.3), None, 1.0)
    assert said.intent is expected
    assert (said.id, said.stamp_s, said.wanted_enu_m_s) == (3, 1.0, (0.1, 0.2, 0.3))
    assert said.position_enu_m == pytest.approx((1.05, 2.0, 3.0))  # extrapolated to the time stamp


@pytest.mark.parametrize(
    ("slot", "word", "now_s", "expected"),
    [
        (Heard(), word_of(), 0.1, HALF),
        (Heard(), word_of(), A.age_max_s + 0.01, ALL),  # the other vehicle is silent
        (Heard(), word_of(clock_bound_s=0.1), A.age_max_s - 0.05, ALL),
        (Heard(), word_of(yields_to=(3,)), 0.3, NONE),
        (Heard(), word_of(yields_to=(3,)), 0.31, HALF),
        (Heard(), word_of(yields_to=(3,), clock_bound_s=0.1), 0.21, HALF),
        (Heard(), word_of(yields_to=(4,)), 0.1, HALF),
        (Heard(yields=True), word_of(yields_to=(3,)), 0.1, ALL),
        (Heard(jumped_m=(0.0, 0.1, 0.0)), word_of(yields_to=(3,)), 0.1, ALL),
        (Heard(jumped_m=(0.0, 1e-9, 0.0)), word_of(yields_to=(3,)), 0.1, NONE),
        (Heard(yielded_s=0.0), word_of(yields_to=(3,), stamp_s=0.4), 0.44, ALL),
        (Heard(yielded_s=0.0), word_of(yields_to=(3,), stamp_s=0.4), 0.46, NONE),
        *((Heard(), word_of(firm, yields_to=(3,)), 0.1, ALL)
          for firm in (Intent.STANDING, Intent.COMMITTED, Intent.CLEARING, Intent.DOWN)),
    ],
)  # fmt: skip
def test_the_share_by_what_was_said(slot, word, now_s, expected):
    assert share(slot, word, now_s, A) == expected

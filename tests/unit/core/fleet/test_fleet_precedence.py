"""Tests that at most one vehicle has the right of way at a pad, and that each vehicle gets it eventually."""

import heapq
import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.core.controller import Controller
from flightstack.core.fleet.member import FleetMember
from flightstack.core.fleet.precedence import Pad, nearest_m
from flightstack.core.memory import AbortWay, Memory
from flightstack.core.parameters.fleet import Fleet
from flightstack.core.target.track import TargetState
from flightstack.core.types import (
    ZERO,
    Inputs,
    Intent,
    Landed,
    MemberStatus,
    Mode,
    OwnState,
    Phase,
    TargetSample,
    VehicleStatus,
)
from tests.examples import examples
from tests.unit.core.fleet.fleet_helpers import DT_S, settings_of

TICK_S = 0.05
FLEET = Fleet(3, (3, 7))
FLYING = VehicleStatus(0.0, True, Mode.EXTERNAL, Landed.IN_AIR, True)
HERE = TargetState(0.0, ZERO, ZERO, 0.0)
AWAY = (5.0, 5.0, 0.0)


def claimed(**keys):
    """Return a member that claimed the pad at 1.0 s and received a message with these values at 1.2 s."""
    member = FleetMember(FLEET, 0.0)
    told = {"stamp_s": 1.2, "arrival_s": 1.2, "intent": Intent.WAITING, "pad_position_enu_m": ZERO, **keys}
    word = MemberStatus(7, position_enu_m=AWAY, velocity_enu_m_s=ZERO, wanted_enu_m_s=ZERO, **told)
    member.permissions(Phase.APPROACH, HERE, 1.0)
    assert member.take([word], 1.2) == []
    return member


@pytest.mark.parametrize(
    ("told", "may_land", "yields"),
    [
        ({}, True, False),  # the other vehicle has no claim
        ({"stamp_s": 1.14}, False, False),  # the other vehicle may not have received this member's claim yet
        ({"stamp_s": 1.17, "clock_bound_s": 0.03}, False, False),
        ({"claim_s": 1.1, "yields_to": (3,)}, True, False),
        ({"claim_s": 1.1}, False, False),  # the other vehicle has the younger claim, but has not yielded yet
        ({"claim_s": 0.9}, False, True),
        ({"claim_s": 1.0}, False, False),  # equal claims: the lower id has precedence
        ({"claim_s": 0.9, "yields_to": (3,)}, True, False),  # both yield: the lower id gets precedence
        ({"claim_s": 1.1, "intent": Intent.LANDING}, False, True),
        ({"claim_s": 1.1, "intent": Intent.COMMITTED}, False, True),
        ({"claim_s": 0.9, "pad_position_enu_m": (0.9, 0.0, 0.0)}, True, False),  # the other pad is far away
        ({"claim_s": 0.9, "pad_position_enu_m": (0.7, 0.0, 0.0)}, False, True),
        ({"claim_s": 0.9, "pad_position_enu_m": None}, False, True),
        ({"pad_position_enu_m": None}, True, False),
        ({"intent": Intent.DOWN}, True, False),
    ],
)
def test_the_right_of_way_by_what_was_heard(told, may_land, yields):
    member = claimed(**told)
    way = member.permissions(Phase.APPROACH, HERE, 1.2)
    assert way.may_land is may_land
    assert member.memory.slots[0].yields is yields
    assert way.text == ("" if may_land else "no right of way because of member 7")


def test_where_both_believe_to_be_first_the_higher_id_gives_way_in_the_end():
    higher = FleetMember(replace(FLEET, id=7), 0.0)
    higher.permissions(Phase.APPROACH, HERE, 1.0)
    for now_s, yields in ((1.5, False), (1.65, False), (1.75, True)):
        word = MemberStatus(3, now_s, now_s, AWAY, ZERO, ZERO, claim_s=1.05, pad_position_enu_m=ZERO)
        higher.take([word], now_s)
        assert not higher.permissions(Phase.APPROACH, HERE, now_s).may_land
        assert higher.memory.slots[0].yields is yields


def test_without_a_pad_in_sight_there_is_no_right_of_way_but_the_claim_stands():
    member = claimed()
    assert not member.permissions(Phase.APPROACH, None, 1.2).may_land
    assert member.memory.claim_s == 1.0


def test_it_waits_no_longer_than_allowed_and_says_for_whom():
    member = claimed(claim_s=0.9)
    assert not member.permissions(Phase.APPROACH, HERE, 1.0 + FLEET.wait_max_s).waited
    way = member.permissions(Phase.APPROACH, HERE, 1.1 + FLEET.wait_max_s)
    assert way.waited
    assert way.text == "no right of way because of member 7"


def test_it_may_touch_when_all_know_that_it_gives_way_to_nobody():
    member = claimed()
    own = OwnState(1.2, 1.2, ZERO, ZERO, 0.0)
    member.permissions(Phase.APPROACH, HERE, 1.2)
    member.message(Memory(phase=Phase.LAND), own, FLYING, lambda _: ZERO, HERE, 1.2)
    least_s = FLEET.age_max_s + FLEET.latency_max_s
    assert not member.permissions(Phase.LAND, HERE, 1.19 + least_s).may_touch
    assert member.permissions(Phase.LAND, HERE, 1.21 + least_s).may_touch
    member.message(Memory(phase=Phase.APPROACH), own, FLYING, lambda _: ZERO, HERE, 2.0)
    assert not member.permissions(Phase.LAND, HERE, 2.1).may_touch


def test_pads_that_drive_towards_each_other_come_near_within_the_time():
    a, b = Pad(ZERO, (0.2, 0.0, 0.0)), Pad((2.0, 0.3, 0.0), (-0.2, 0.0, 0.0))
    assert nearest_m(a, *b, 10.0) == pytest.approx(0.3)
    assert nearest_m(a, *b, 2.0) == pytest.approx(math.hypot(1.2, 0.3))
    assert nearest_m(b, *b, 10.0) == 0.0
    assert nearest_m(a, (-1.0, 0.0, 0.0), ZERO, 10.0) == pytest.approx(1.0)  # the pad drives away


@pytest.mark.parametrize(
    ("keys", "why"),
    [
        ({"id": 4}, "not in fleet.members"),
        ({"id": 3}, "not in fleet.members"),
        ({"position_enu_m": (math.nan, 0.0, 0.0)}, "not finite"),
        ({"wanted_enu_m_s": (0.0, math.inf, 0.0)}, "not finite"),
        ({"stamp_s": math.inf}, "not finite"),
        ({"claim_s": math.inf}, "claim or its pad"),
        ({"pad_position_enu_m": (0.0, 0.0, math.nan)}, "claim or its pad"),
        ({"clock_bound_s": -0.1}, "negative"),
        ({"position_sigma_m": -0.1}, "negative"),
        ({"stamp_s": 1.2}, "0.20 s ahead"),
    ],
)
def test_a_word_that_says_nothing_usable_is_refused_with_the_reason(keys, why):
    member = FleetMember(FLEET, 0.0)
    (told,) = member.take([MemberStatus(7, 1.0, 1.0, AWAY, ZERO, ZERO)._replace(**keys)], 1.0)
    assert why in told
    assert member.memory.slots[0].message is None


class Claimant:
    """A vehicle that claims the pad from ``begins_s`` on, and lands when the right of way permits it."""

    def __init__(self, fleet, begins_s):
        self.member, self.memory = FleetMember(fleet, 0.0), Memory(phase=Phase.TAKEOFF, climbed=True)
        self.begins_s, self.down_s, self.queue = begins_s, math.inf, []

    @property
    def over_pad(self):
        return self.memory.phase in (Phase.LAND, Phase.TOUCHDOWN)

    def step(self, t_s):
        while self.queue and self.queue[0][0] <= t_s:
            self.member.take([heapq.heappop(self.queue)[2]], t_s)
        way = self.member.permissions(self.memory.phase, HERE, t_s)
        if self.memory.phase is Phase.TAKEOFF and t_s >= self.begins_s:
            self.memory.phase = Phase.APPROACH
        elif self.memory.phase is Phase.APPROACH and way.may_land:
            self.memory.phase, self.down_s = Phase.LAND, t_s + 2.0
        elif self.memory.phase is Phase.LAND and not way.may_land:
            self.memory.phase = Phase.APPROACH
        elif self.memory.phase is Phase.LAND and way.may_touch and t_s >= self.down_s:
            self.memory.phase = Phase.LANDED
        own = OwnState(t_s, t_s, AWAY, ZERO, 0.0)
        return self.member.message(self.memory, own, FLYING, lambda _: ZERO, HERE, t_s)


@examples(40)
@given(
    st.integers(0, 2**32), st.integers(2, 4), st.sampled_from([0.0, 0.1, 0.5, 0.8]),
    st.floats(0.0, 0.05), st.floats(0.0, 1.0),
)  # fmt: skip
def test_no_two_land_on_one_pad_together_and_each_lands(seed, number, lost, bound_s, apart_s):
    rng, count, ids = np.random.default_rng(seed), itertools.count(), tuple(range(1, number + 1))
    all_ = [Claimant(Fleet(n, ids), 1.0 + rng.uniform(0.0, apart_s)) for n in ids]
    error_s = rng.uniform(-bound_s, bound_s, (number, number))
    back_s = np.zeros((number, number))
    for tick in range(round(60.0 / TICK_S)):
        t_s = tick * TICK_S
        words = [each.step(t_s) for each in all_]
        assert sum(each.over_pad for each in all_) <= 1, (t_s, [each.memory.phase for each in all_])
        for me, other in itertools.permutations(range(number), 2):
            if rng.random() < 0.05 * lost:
                back_s[me, other] = t_s + rng.uniform(0.0, 0.8)
            if t_s < back_s[me, other] or rng.random() < lost:
                continue
            word, shift_s = words[other], error_s[me, other]
            came = word._replace(
                stamp_s=word.stamp_s + shift_s, claim_s=word.claim_s + shift_s, clock_bound_s=bound_s
            )
            at_s = t_s + rng.uniform(TICK_S, FLEET.latency_max_s)
            heapq.heappush(all_[me].queue, (at_s, next(count), came))
        if all(each.memory.phase is Phase.LANDED for each in all_):
            break
    if lost <= 0.1:
        assert all(each.memory.phase is Phase.LANDED for each in all_)


# vehicle 9 is a member that never sends a message
SETTINGS = settings_of(3, (3, 7, 9), takeoff={"start_offset_m": [2.0, 0.0, 1.0]})
EAST, UP, DOWN = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)
CLEAR = {"abort_way": AbortWay.FLY_CLEAR}
PHASES = [
    (Phase.WAIT, {}, (2.0, 0.0, 1.5), None),  # the vehicle hovers while it waits
    (Phase.TAKEOFF, {"climbed": True}, (0.0, 0.0, 1.2), EAST),
    (Phase.APPROACH, {}, (-2.0, 0.0, 1.2), EAST),
    (Phase.HOLD, {"started_s": 0.0}, (0.5, 0.0, 1.0), UP),
    (Phase.CLIMB, {"started_s": 0.0}, (0.5, 0.0, 0.5), UP),
    (Phase.ABORT, CLEAR, (0.3, 0.0, 2.5), EAST),
    (Phase.LEAVE, {}, (0.0, 0.0, 0.3), UP),
    (Phase.TOUCHDOWN, {}, (0.0, 0.0, 0.35), DOWN),
]


def flown(phase, keys, place, words):
    """Return the velocity, m/s, that vehicle 3 at ``place`` commands in one tick of this phase."""
    controller = Controller(SETTINGS)
    memory = controller.memory
    memory.phase, memory.was_armed, memory.was_external = phase, True, True
    memory.target_position_enu_m, memory.target_velocity_enu_m_s = (0.0, 0.0, 0.2), ZERO
    memory.commanding, memory.command = True, ZERO
    for name, value in keys.items():
        setattr(memory, name, value)
    now_s = 2 * DT_S
    own = OwnState(now_s, now_s, place, ZERO, 0.0)
    status = VehicleStatus(now_s, True, Mode.EXTERNAL, Landed.IN_AIR, False)
    sample = TargetSample(now_s, now_s, "map", "target", (0.0, 0.0, 0.2), ZERO, 0.0, 0.0)
    out = controller.step(Inputs(own, status, (sample,), neighbours=tuple(words)), now_s)
    assert out.phase is phase
    return out.wanted


def beside(place, way, h_m):
    """Return the message of a vehicle that hovers in direction ``way``; the pair barrier is ``h_m`` there."""
    far_m = (0.75 if way[2] else 0.25) + (3.0 if way[2] else 1.0) * h_m
    at = tuple(p + far_m * w for p, w in zip(place, way, strict=True))
    return MemberStatus(7, 2 * DT_S, 2 * DT_S, at, ZERO, ZERO, intent=Intent.WAITING)


@pytest.mark.parametrize(("phase", "keys", "place", "way"), PHASES, ids=[p[0].name for p in PHASES])
def test_a_neighbour_in_the_way_stops_each_phase_but_the_touchdown(phase, keys, place, way):
    if way is None:
        assert flown(phase, keys, place, []) == pytest.approx(ZERO, abs=1e-9)
        pushed = flown(phase, keys, place, [beside(place, EAST, -0.1)])
        assert pushed[0] < -0.02
        return
    alone = flown(phase, keys, place, [])
    ahead_m_s = sum(a * w for a, w in zip(alone, way, strict=True))
    assert ahead_m_s > 0.025
    there = flown(phase, keys, place, [beside(place, way, 0.015)])
    if phase is Phase.TOUCHDOWN:
        assert there == alone
        return
    # the approach may use half of the speed that the decay rate of h allows, because positions may be wrong
    assert sum(a * w for a, w in zip(there, way, strict=True)) <= 0.02
    assert flown(phase, keys, place, [beside(place, way, 2.9)]) == alone  # the other vehicle is out of reach
    assert math.dist(flown(phase, keys, place, [beside(place, way, 1.5)]), alone) < 1e-6  # within reach

"""Tests landings of a team in one process, and four vehicles that land on one robot in turn."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from flightstack.core.types import Phase
from logs.verdict.types import Outcome
from sim.campaign.rows import judge_landing
from sim.runners.landing import land
from sim.scenarios.scenario import load
from tests.fault_grid.fleet import MOMENTS_S, SEED, WHO, Way, fly, row
from tests.unit.fleet.fleet_helpers import at, same, team_of

pytestmark = pytest.mark.slow


def crossing():
    """Return a team with two approaches that cross at equal height but at different times."""
    still = {"speed_m_s": 0.0, "random_heading": False}
    return at(0.0, 0.0, (-1.0, 1.0, 0.9), **still), at(0.0, 1.0, (-1.0, -1.25, 1.3), **still)


def test_a_team_is_the_same_every_time_and_near_vehicles_matter():
    near = team_of(*crossing())
    one, two = land(near, 2), land(near, 2)
    assert all(same(a, b) for a, b in zip(one.members, two.members, strict=True))
    assert one.pairs == two.pairs
    alone = [land(scenario, seed) for scenario, seed in near.singles(2)]
    assert not all(same(a, b) for a, b in zip(one.members, alone, strict=True))


def test_a_collision_is_a_crash_of_both():
    head_on = {"speed_m_s": 0.0, "random_heading": False}
    flown = land(
        team_of(at(1.5, 0.0, (-3.0, 0.0, 0.9), **head_on), at(-1.5, 0.0, (3.0, 0.0, 0.9), **head_on)), 1
    )
    (pair,) = flown.pairs
    assert pair.collided_ms >= 0
    assert pair.distance_min_m < 0.14
    assert pair.ellipsoid_min < 1.0
    assert pair.violations >= 1
    assert pair.inside_ms >= 10
    for landing, other in zip(flown.members, ("cf2", "cf1"), strict=True):
        assert landing.verdict.outcome is Outcome.CRASHED
        assert "another vehicle" in landing.verdict.reason
        (told,) = [event for event in landing.seen.events if event.text == f"collision with {other}"]
        assert told.t_s == pair.collided_ms / 1000.0
        after = landing.seen.truth.t_s > told.t_s + 0.5
        assert landing.seen.truth.rotor_rpm[after].max() < 1000.0


def test_vehicles_that_begin_inside_each_other_are_refused():
    with pytest.raises(ValueError, match=r"cf1 and cf3 begin inside each other, at \(-0\.80, 0\.30, 1\.10\)"):
        land(team_of(at(0.0, 0.0), at(5.0, 0.0), at(0.1, 0.0)), 0)


def test_a_flight_inwards_that_a_neighbour_turns_round_stays_above_the_barrier():
    """Every h stays above 30 mm. Predicting that a sinking vehicle continues inwards gave -11 mm once."""
    landings = land(load("fleet_8"), 20866).members
    assert min(each.verdict.h_min_outside_pad_m for each in landings) > 0.03


ROOT = Path(__file__).parents[3]
# if a member sends a wrong position, the third vehicle waits for a minute; only one such moment is flown
CELLS = [(way, m) for way in Way for m in MOMENTS_S if way is not Way.LIES or m == "touchdown"]
PAGE = (ROOT / "docs" / "reference" / "fault_grid.md").read_text()


@pytest.mark.parametrize(("way", "moment"), CELLS)
def test_nothing_collides_and_the_others_land(way, moment):
    verdict = fly(way, MOMENTS_S[moment], SEED)
    assert (verdict.collisions, verdict.ellipsoid_violations) == (0, 0)
    others = [end for number, end in enumerate(verdict.outcomes, 1) if number != WHO]
    # a landing near the member with a wrong position may be aborted
    allowed = {Outcome.LANDED, Outcome.ABORTED} if way is Way.LIES else {Outcome.LANDED}
    assert set(others) <= allowed, verdict.reason
    assert row(way, moment, verdict) in PAGE


BUSY = (Phase.LAND, Phase.TOUCHDOWN)


turns = pytest.mark.xdist_group("turns")  # one worker runs these tests, so the team flies once


@pytest.fixture(scope="module")
def flown():
    return land(load("turns_4"), 1)


def phases(landing):
    steps = landing.seen.steps
    at = np.concatenate(([0], np.flatnonzero(np.diff(steps.phase)) + 1))
    return [(Phase(steps.phase[n]), float(steps.t_s[n])) for n in at]


@turns
def test_all_land_and_nobody_is_hit(flown):
    verdict = judge_landing(flown)
    assert [landing.verdict.outcome for landing in flown.members] == [Outcome.LANDED] * 4
    assert (verdict.collisions, verdict.ellipsoid_violations) == (0, 0)
    assert [landing.verdict.violation for landing in flown.members] == [False] * 4


@turns
def test_three_take_off_again_and_the_last_one_stays(flown):
    ways = sorted((phases(landing) for landing in flown.members), key=lambda each: len(each), reverse=True)
    assert [[phase for phase, _ in each][-3:] for each in ways] == [
        *[[Phase.LANDED, Phase.LEAVE, Phase.LANDED]] * 3,
        [Phase.LAND, Phase.TOUCHDOWN, Phase.LANDED],
    ]


@turns
def test_the_next_one_lands_when_the_one_before_has_left(flown):
    """From a landing to the departure of this vehicle, no other vehicle starts to land."""
    stays, lands = [], []
    for landing in flown.members:
        found = phases(landing)
        (landed_s,) = [
            t
            for (before, _), (now, t) in pairwise(found)
            if before is Phase.TOUCHDOWN and now is Phase.LANDED
        ]
        left_s = next((t for phase, t in found if phase is Phase.LEAVE), np.inf)
        stays.append((landed_s, left_s))
        lands += [t for phase, t in found if phase in BUSY]
    stays.sort()
    assert all(left_s < landed_s for (_, left_s), (landed_s, _) in pairwise(stays))
    assert not any(landed_s < t < left_s for t in lands for landed_s, left_s in stays)

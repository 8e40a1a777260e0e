"""Tests four vehicles that land on one robot in turn; each takes off again to free the pad."""

from itertools import pairwise

import numpy as np
import pytest

from flightstack.core.types import Phase
from logs.verdict.types import Outcome
from sim.campaign.rows import judge_landing
from sim.runners.landing import land
from sim.scenarios.scenario import load

pytestmark = pytest.mark.slow

BUSY = (Phase.LAND, Phase.TOUCHDOWN)


@pytest.fixture(scope="module")
def flown():
    return land(load("turns_4"), 1)


def phases(landing):
    steps = landing.seen.steps
    at = np.concatenate(([0], np.flatnonzero(np.diff(steps.phase)) + 1))
    return [(Phase(steps.phase[n]), float(steps.t_s[n])) for n in at]


def test_all_land_and_nobody_is_hit(flown):
    verdict = judge_landing(flown)
    assert [landing.verdict.outcome for landing in flown.members] == [Outcome.LANDED] * 4
    assert (verdict.collisions, verdict.ellipsoid_violations) == (0, 0)
    assert [landing.verdict.violation for landing in flown.members] == [False] * 4


def test_three_take_off_again_and_the_last_one_stays(flown):
    turns = sorted((phases(landing) for landing in flown.members), key=lambda each: len(each), reverse=True)
    assert [[phase for phase, _ in each][-3:] for each in turns] == [
        *[[Phase.LANDED, Phase.LEAVE, Phase.LANDED]] * 3,
        [Phase.LAND, Phase.TOUCHDOWN, Phase.LANDED],
    ]


def test_the_next_one_lands_when_the_one_before_has_left(flown):
    """No vehicle is above the pad as long as another vehicle stands on it."""
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

"""Members that nobody hears, and networks cut in two: nothing collides, and every flight ends as declared."""

from dataclasses import replace

import pytest

from logs.verdict.types import Outcome
from sim.campaign.team_rows import judge_team
from sim.runners.fleet.team import land_team
from sim.scenarios.team import ExchangeLink, load

FLEET_3 = load("fleet_3")
ENDS = {Outcome.LANDED, Outcome.ABORTED}
MOMENTS = {"in crossing": 1.5, "in approach to land": 3.0, "in touchdown": 5.0}


@pytest.mark.parametrize("moment", MOMENTS)
@pytest.mark.parametrize(("silent", "apart"), [((1,), ()), ((), (2,)), ((), (1, 3))])
def test_nobody_comes_too_near_and_the_larger_part_lands(silent, apart, moment):
    link = ExchangeLink(silent=silent, apart=apart, broken_from_s=MOMENTS[moment])
    flown = land_team(replace(FLEET_3, exchange=link), 11)
    verdict = judge_team(flown)
    assert (verdict.collisions, verdict.ellipsoid_violations) == (0, 0)
    assert set(verdict.outcomes) <= ENDS, verdict.reason
    assert not any(landing.verdict.violation for landing in flown.landings)
    assert verdict.outcomes.count(Outcome.LANDED) >= 2


@pytest.mark.parametrize("moment", MOMENTS)
def test_a_vehicle_that_is_silent_early_is_flown_past(moment):
    link = ExchangeLink(delay_s=0.1, loss=0.1, silent=(3,), broken_from_s=MOMENTS[moment])
    verdict = judge_team(land_team(replace(FLEET_3, exchange=link), 12))
    assert (verdict.collisions, verdict.ellipsoid_violations) == (0, 0)

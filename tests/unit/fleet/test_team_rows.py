"""Tests the verdict on a team and its campaign row: values of the worst member and of pairs."""

from dataclasses import replace

import pytest

from flightstack.common.strict_toml import ConfigError
from logs.schema.rows import FleetPairRow
from logs.verdict.types import Outcome
from sim.campaign.rows import judge_landing, read_rows, row_of, write_rows
from sim.campaign.run import plan
from sim.campaign.summary import summary
from sim.campaign.workers import fly_seed
from sim.runners.landing import land
from sim.scenarios.scenario import load, text
from tests.unit.fleet.fleet_helpers import FIELD, at, team_of

LANDED, ABORTED, TIMEOUT, CRASHED = Outcome.LANDED, Outcome.ABORTED, Outcome.TIMEOUT, Outcome.CRASHED


@pytest.fixture(scope="module")
def landing():
    return land(FIELD, 1)


@pytest.fixture(scope="module")
def flown(landing):
    def make(outcomes, *pairs):
        first, *others = (
            replace(
                landing, verdict=replace(landing.verdict, outcome=each, reason=f"was {each}"), wait_s=wait_s
            )
            for each, wait_s in zip(outcomes, (0.0, 2.5), strict=True)
        )
        return replace(first, pairs=pairs, others=tuple(others), wall_s=0.5)

    return make


FAR = FleetPairRow(0, 1, 2, 0.9, 0.9, 3.0, 0, 0, -1)


@pytest.mark.parametrize(
    ("outcomes", "worst", "reason"),
    [
        ((LANDED, LANDED), LANDED, "all 2 landed"),
        ((LANDED, ABORTED), ABORTED, "cf2: was aborted"),
        ((TIMEOUT, ABORTED), TIMEOUT, "cf1: was timeout"),
        ((CRASHED, TIMEOUT), CRASHED, "cf1: was crashed"),
        ((CRASHED, CRASHED), CRASHED, "cf1: was crashed; cf2: was crashed"),
    ],
)
def test_a_team_ends_as_its_worst_member(flown, outcomes, worst, reason):
    verdict = judge_landing(flown(outcomes, FAR))
    assert (verdict.outcome, verdict.outcomes, verdict.reason) == (worst, outcomes, reason)
    assert (verdict.collisions, verdict.ellipsoid_violations) == (0, 0)
    assert (verdict.ellipsoid_min, verdict.distance_min_m) == (3.0, 0.9)


def test_the_row_of_a_team_has_the_worst_of_its_members(flown, landing):
    team = flown((LANDED, LANDED), FAR)
    worse = replace(
        landing,
        retries=2,
        verdict=replace(
            landing.verdict, violation=None, started_safe=None, h_min_outside_pad_m=-0.5, h_min_m=-0.6,
            touchdown_error_m=0.09, time_to_land_s=20.0,
        ),
    )  # fmt: skip
    row = row_of(replace(team, others=(replace(worse, wait_s=2.5, simulated_s=70.0),)))
    assert (row.violation, row.started_safe, row.retries) == (None, None, 2 + landing.retries)
    assert (row.h_min_m, row.h_min_outside_pad_m) == (-0.6, -0.5)
    assert (row.touchdown_error_m, row.time_to_land_s) == (0.09, 20.0)
    assert (row.simulated_s, row.wall_s, row.wait_max_s) == (70.0, 0.5, 2.5)
    crashed = row_of(flown((LANDED, CRASHED), FAR))
    assert crashed.time_to_land_s is None
    assert crashed.outcomes == "landed crashed"


@pytest.mark.slow
def test_a_campaign_flies_teams(tmp_path):
    toml = text(team_of(at(0.0, 0.0), at(6.0, 0.0)))
    rows = [fly_seed(toml, seed) for seed in (0, 1)]
    assert [row.outcomes for row in rows] == ["landed landed"] * 2
    assert rows[0].untimed() == fly_seed(toml, 0).untimed()
    write_rows(tmp_path / "rows.csv", rows)
    assert read_rows(tmp_path / "rows.csv") == rows
    told = summary(rows, "fly {seed}", wall_s=1.0, flown_s=14.0)
    assert (told["vehicles"], told["vehicles_landed"], told["collisions"]) == (4, 4, 0)
    assert told["distance_min_m"] > 2.0
    assert told["wait_max_s"] == 0.0


def test_a_plan_of_a_team_is_checked_for_all_members_and_says_how_to_repeat_a_seed():
    wanted = plan("fleet_3", 2, 0, "paper")
    assert wanted.scenario == load("fleet_3").with_filter("paper")
    assert wanted.command == "flightstack sitl --scenario fleet_3 --seed {seed} --filter paper --lockstep"
    assert wanted.duration_max_s == 270.0
    with pytest.raises(ConfigError, match=r"one of: ardupilot_47, deck, .*, fleet_3, fleet_8"):
        plan("fleet_4", 2, 0, None)

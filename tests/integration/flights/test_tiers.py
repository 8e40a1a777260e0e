"""Two hundred seeds of each tier meet its limits; more of them stand in docs/reference/results.md."""

import json

import pytest

from sim.campaign.summary import LIMITS, Tier
from tests.integration.flights.test_campaign import campaign

RUNS = 200
WALL_MAX_S = 900.0  # alone on a core it takes a minute
PAPER_RUNS = 20  # enough for a median


@pytest.mark.parametrize("tier", list(Tier), ids=lambda tier: tier.value)
def test_the_robust_filter_meets_the_limits(tmp_path, tier):
    words = [tier.value, "--workers", 1, "--no-report", "--json"]
    against = []
    if LIMITS[tier].slower_max is not None:
        campaign(
            *words,
            "--runs",
            PAPER_RUNS,
            "--filter",
            "paper",
            "--out",
            tmp_path / "paper",
            wall_max_s=WALL_MAX_S,
        )
        against = ["--against", tmp_path / "paper"]
    done = campaign(
        *words, "--runs", RUNS, "--filter", "robust", "--out", tmp_path / "robust", "--require", tier.value,
        *against, check=False, wall_max_s=WALL_MAX_S,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    told = json.loads(done.stdout.strip().splitlines()[-1])
    assert told["runs"] == RUNS == told["landed"] + told["declared_aborts"] + told["crashes"]
    assert told["crashes"] == told["violations"] == 0
    # what so many runs can show, and no more
    assert told["upper_95_violation_rate"] >= 1.0 - 0.05 ** (1.0 / RUNS) - 1e-9

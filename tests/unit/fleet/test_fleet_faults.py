"""Cells of the grid of faults of a fleet against what is demanded, and against the page."""

from pathlib import Path

import pytest

from logs.verdict.types import Outcome
from tests.fault_grid.fleet import MOMENTS_S, SEED, WHO, Way, fly, row

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[3]
# a place that is wrong makes the third one wait for a minute, at whichever moment: flown at one of them here
CELLS = [(way, m) for way in Way for m in MOMENTS_S if way is not Way.LIES or m == "touchdown"]
PAGE = (ROOT / "docs" / "reference" / "fault_grid.md").read_text()


@pytest.mark.parametrize(("way", "moment"), CELLS)
def test_nothing_collides_and_the_others_land(way, moment):
    verdict = fly(way, MOMENTS_S[moment], SEED)
    assert (verdict.collisions, verdict.ellipsoid_violations) == (0, 0)
    others = [end for number, end in enumerate(verdict.outcomes, 1) if number != WHO]
    # where a pad lies near the one that tells a wrong place, its landing may be given up
    allowed = {Outcome.LANDED, Outcome.ABORTED} if way is Way.LIES else {Outcome.LANDED}
    assert set(others) <= allowed, verdict.reason
    assert row(way, moment, verdict) in PAGE

"""Each cell of the grid of faults of a fleet against what is demanded, and against the page."""

from pathlib import Path

import pytest

from logs.verdict.types import Outcome
from tests.fault_grid.fleet import MOMENTS_S, NAMESAKES, SEED, WHO, WIRE_TEST, Way, fly, row

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "reference" / "fault_grid.md").read_text()


def test_the_page_names_the_tests_of_a_second_process():
    assert NAMESAKES in PAGE
    assert "def test_a_second_process_of_this_vehicle_refuses_the_start" in (ROOT / WIRE_TEST).read_text()
    assert "def test_of_two_processes_of_another_vehicle_the_first_is_heard" in (ROOT / WIRE_TEST).read_text()


@pytest.mark.parametrize("moment", MOMENTS_S)
@pytest.mark.parametrize("way", Way)
def test_nothing_collides_and_the_others_land(way, moment):
    verdict = fly(way, MOMENTS_S[moment], SEED)
    assert (verdict.collisions, verdict.ellipsoid_violations) == (0, 0)
    others = [end for number, end in enumerate(verdict.outcomes, 1) if number != WHO]
    # where a pad lies near the one that tells a wrong place, its landing may be given up
    allowed = {Outcome.LANDED, Outcome.ABORTED} if way is Way.LIES else {Outcome.LANDED}
    assert set(others) <= allowed, verdict.reason
    assert row(way, moment, verdict) in PAGE

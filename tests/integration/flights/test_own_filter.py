"""A filter from outside the package flies `sitl` and `campaign`, by option and by configuration."""

import shutil
from pathlib import Path

import pytest

from sim.campaign.rows import read_rows
from sim.scenarios.scenario import path_of
from tests.integration.runs import called, flightstack, fly, replayed

ROOT = Path(__file__).parents[3]
EXAMPLE = "examples.own_filter:ConeFilter"


@pytest.fixture
def elsewhere(tmp_path):
    """A working folder that holds the filter as a module of another name."""
    shutil.copy(ROOT / "examples" / "own_filter.py", tmp_path / "mine.py")
    return tmp_path


def test_it_flies_over_the_wires_and_its_log_is_replayed(elsewhere, monkeypatch):
    monkeypatch.chdir(elsewhere)
    done = fly(elsewhere / "out", "paper_moving_1", 0, "--filter", "mine:ConeFilter")
    assert done.code == 0, done.out + done.err
    assert done.json["outcome"] == "landed"
    assert done.json["filter"] == "mine:ConeFilter"
    assert 'filter = "mine:ConeFilter"' in (elsewhere / "out" / "onboard.toml").read_text()
    replayed(elsewhere / "out" / "flight.mcap")


def test_it_flies_a_campaign_by_its_name_in_the_scenario(elsewhere):
    text = path_of("paper_moving_1").read_text()
    scenario = elsewhere / "scenario.toml"
    scenario.write_text(text.replace('filter = "paper"', 'filter = "mine:ConeFilter"'))
    options = ("--runs", 2, "--workers", 1, "--no-report", "--json")
    done = flightstack("campaign", scenario, *options, "--out", elsewhere / "named", cwd=elsewhere)
    assert done.code == 0, done.err
    same = flightstack(
        "campaign", "paper_moving_1", *options, "--filter", EXAMPLE, "--out", elsewhere / "given", cwd=ROOT
    )
    assert same.code == 0, same.err
    named, given = (
        [row.untimed() for row in read_rows(elsewhere / name / "rows.csv")] for name in ("named", "given")
    )
    assert named == given
    assert [row.outcome for row in named] == ["landed", "landed"]
    (elsewhere / "mine.py").write_text((elsewhere / "mine.py").read_text() + "# other code\n")
    other = flightstack("campaign", scenario, *options, "--out", elsewhere / "named", cwd=elsewhere)
    assert other.code != 0
    assert "another filter's code" in other.err


@pytest.mark.parametrize("verb", [("sitl", "--scenario", "lab"), ("campaign", "lab"), ("check", "lab")])
def test_a_filter_that_there_is_not_is_refused_with_what_is_allowed(verb):
    done = called(*verb, "--filter", "best")
    assert done.code == 2
    assert "filter: found 'best', allowed: paper, robust, or MODULE:NAME" in done.err
    done = called(*verb, "--filter", "examples.own_filter:Kone")
    assert done.code == 2
    assert "has no Kone" in done.err

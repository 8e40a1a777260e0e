"""Tests that the page of scenario keys and new scenario files agree with the declared keys."""

import re

import pytest

from sim.scenarios.keys import commented, keys
from sim.scenarios.scenario import load
from tests.scenario_keys import PAGE, page

pytestmark = pytest.mark.slow


def test_the_page_is_equal_to_the_declarations():
    assert PAGE.read_text() == page(), "python -m tests.scenario_keys"


def test_each_key_of_a_scenario_has_a_meaning():
    named = [key for key in keys() if not key.table.startswith("onboard")]
    assert len(named) > 80
    assert [key for key in named if key.meaning == key.name.replace("_", " ")] == []


def test_a_new_scenario_is_its_base_and_each_of_its_lines_can_be_used(tmp_path):
    file, text = tmp_path / "mine.toml", commented("mine")
    file.write_text(text)
    lab = load("lab")
    mine = load(file)
    assert (mine.target, mine.onboard, mine.start, mine.wind) == (
        lab.target,
        lab.onboard,
        lab.start,
        lab.wind,
    )
    parts = [part for part in text.split("\n\n") if not re.match(r"# \[(\w+\.error|\w+\.own|judge)\]", part)]
    used = re.sub(r"^# (\[|\w+ = (?!\.\.\.))", r"\1", "\n\n".join(parts), flags=re.MULTILINE)
    file.write_text(used)
    assert (load(file).target, load(file).vehicle) == (lab.target, lab.vehicle)

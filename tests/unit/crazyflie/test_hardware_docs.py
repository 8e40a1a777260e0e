"""docs/how_to/hardware.md says what the suite of any vehicle does: table of limits, options, steps."""

import argparse
from pathlib import Path
from types import SimpleNamespace

from bridge.mavlink.profiles.autopilots import PROFILES
from tests.conftest import pytest_addoption
from tests.flight_suite.room import LIMITS

TEXT = (Path(__file__).parents[3] / "docs" / "how_to" / "hardware.md").read_text()
COLUMNS = {
    "`--autopilot`": lambda name, _: f"`{name}`",
    "waits for rest": lambda _, one: f"{one.settle_s:g} s",
    "drift in 5 s": lambda _, one: f"{one.drift_m:g} m",
    "holds still below": lambda _, one: f"{one.still_m_s:g} m/s",
    "step": lambda _, one: f"{one.step_m_s:g} m/s, {one.step_s:g} s each way",
    "share of its way": lambda _, one: "{:g} to {:g}".format(*one.moved_share),
    "without set-points": lambda _, one: f"{one.lost.value}, seen within {one.lost_s:g} s",
}


def limits_table():
    rows = [[cell(name, one) for cell in COLUMNS.values()] for name, one in LIMITS.items()]
    head, *body = ["| " + " | ".join(cells) + " |" for cells in (COLUMNS, *rows)]
    return "\n".join([head, "|---" * len(COLUMNS) + "|", *body])


def test_the_table_of_limits_is_the_codes():
    within = TEXT.split("<!-- table: limits -->\n")[1].split("\n<!-- end -->")[0]
    assert within == limits_table()


def test_every_profile_has_limits():
    assert set(LIMITS) == set(PROFILES)


def test_every_option_is_in_the_page():
    parser = argparse.ArgumentParser(add_help=False)
    pytest_addoption(SimpleNamespace(addoption=parser.add_argument))
    options = [action.option_strings[0] for action in parser._actions]
    assert len(options) >= 10
    assert [option for option in options if f"`{option}`" not in TEXT and f"`{option} " not in TEXT] == []

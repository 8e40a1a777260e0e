"""docs/how_it_works/robust_filter.md says what the code does: its tables and every number in its text."""

import math
import re
from dataclasses import replace

import pytest

from flightstack.common.strict_toml import to_table
from flightstack.core.parameters.filters import FILTERS
from flightstack.core.safety.barrier import Barrier
from flightstack.identify import velocity_loop as identify
from flightstack.identify.samples import NOISE_SAMPLES
from flightstack.verify import bound as certificate_bound
from flightstack.verify.certificate import checks, problems
from sim.scenarios import scenario
from tests.unit.verify.certificate_helpers import config
from tests.unit.verify.certificate_page import PAGE, split, tables

TEXT = PAGE.read_text()
FLAT = re.sub(r"\s+", " ", TEXT)


@pytest.mark.parametrize("name", ["worked", "verdicts"])
def test_the_tables_are_the_codes(name):
    _, within, _ = split(TEXT, name)
    assert within == tables()[name], "run: python -m tests.unit.verify.certificate_page"


def test_every_parameter_it_names_exists():
    known = to_table(config())
    keys = {key for section in known.values() if isinstance(section, dict) for key in section}
    named = set(re.findall(r"`(?:(\w+)\.)?(\w+_(?:s|m|m_s|m_s2|1_s|hz|sqrthz|factor|spread))`", TEXT))
    assert len(named) > 15
    for section, key in named:
        assert key in keys, key
        if section:
            assert key in known[section], section


def test_every_check_it_names_exists():
    plain, fed_back = config(), config(velocity_feedback={"horizontal": True})
    names = {check.name for settings in (plain, fed_back) for check in checks(settings)}
    for named in re.findall(r"[Cc]heck \*([a-z ]+)\*", TEXT):
        assert named in names, named


@pytest.mark.parametrize(
    ("words", "value"),
    [
        ("(at 2 cm height it is {} mm wide)", round(1e3 * 0.02 / 1.5)),
        ("alpha beta / e² ({} for the paper's shape)", round(1.5 / math.e**2, 1)),
        ("nothing more than {} can hide", f"{certificate_bound.TOLERANCE:.0e}".replace("e-0", "e-")),
        ("what is faster than {} s", round(identify.HIGH_PASS_S)),
        ("({} s under set-points", round(identify.TIME_MIN_S)),
        ("commands that vary by {} cm/s", round(1e2 * identify.EXCITATION_MIN_M_S)),
        ("explains {} % of the velocity", round(1e2 * identify.EXPLAINED_MIN)),
        ("the lag known to {} %", round(1e2 * identify.ERROR_MAX)),
    ],
)
def test_numbers_in_the_text(words, value):
    assert words.format(value) in FLAT


def test_parabolas_go_through_nine_samples():
    assert NOISE_SAMPLES == 9
    assert "parabolas through nine samples" in FLAT


def test_what_it_says_of_storm():
    storm = scenario.load("storm").onboard
    assert storm.touchdown.target_speed_max_m_s == storm.limits.velocity_max_m_s[2] == 1.0
    assert Barrier(1.0, 1.5).slope(storm.touchdown.pad_radius_m) >= 1.2
    (climb,) = (check for check in checks(storm) if check.name == "climb")
    assert not climb.proven


@pytest.mark.parametrize("kind", FILTERS)
@pytest.mark.parametrize("name", scenario.names())
def test_no_shipped_scenario_is_refused_with_either_filter(name, kind):
    assert problems(replace(scenario.load(name).onboard, filter=kind)) == []

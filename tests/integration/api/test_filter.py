"""Tests users' filters: one method is enough, flights replay, and a filter's result must be a velocity."""

import re
from copy import deepcopy
from dataclasses import dataclass, fields

import numpy as np
import pytest

import flightstack as fs
from flightstack.common.strict_toml import ConfigError
from flightstack.core.controller import Controller
from flightstack.core.types import FilterStatus
from flightstack.onboard.state_text import state_text
from tests.integration.runs import flightstack

SMOOTH = "examples.own_filter:Smooth"


def returning(value):
    class Wrong(fs.Filter):
        def filter(self, nominal, at):
            return value(nominal, at)

    return Wrong


def test_one_method_flies_the_same_in_every_command(flown):
    flight = flown("lab", 7, "--filter", SMOOTH)
    landing = fs.land("lab", 7, filter=SMOOTH)
    logged = fs.read_log(flight.log)
    assert landing.verdict == logged.verdict
    assert landing.verdict.outcome == "landed"
    assert np.array_equal(landing.log.command_enu_m_s, logged.log.command_enu_m_s)
    assert set(landing.log.filter_status) == {FilterStatus.NOT_RUN, FilterStatus.OWN}
    replayed = flightstack("replay", flight.log, "--check", "--filter", SMOOTH, "--json")
    assert (replayed.code, replayed.json["result"]) == (0, "equal")
    other = flightstack("replay", flight.log, "--filter", "paper")
    assert other.code == 2
    assert f"the log's filter is {SMOOTH}" in other.err
    proof = flightstack("check", "lab", "--filter", SMOOTH, "--json")
    assert proof.code == 1
    assert proof.json["checks"][0]["name"] == "certificate"


def test_its_state_is_restored_and_goes_into_a_log():
    settings = fs.scenario("lab", filter=SMOOTH).onboard
    one, other, text = Controller(settings), Controller(settings), state_text(settings)
    one.strategy.state.velocity_m_s = (0.1, -0.2, 0.3)
    other.restore(deepcopy(one.state))
    assert "velocity_m_s:(float,float,float)" in text.layout
    assert '"filter_state":{"velocity_m_s":[0.1,-0.2,0.3]}' in text.dumps(one.state)
    assert other.strategy.state == one.strategy.state
    assert [field.name for field in fields(one.state)][-2:] == ["filter", "filter_state"]


def test_at_has_barrier_limits_and_states():
    seen = []

    class Looks(fs.Filter):
        def filter(self, nominal, at):
            seen.append(at)
            return at.enforced(nominal)

    landing = fs.land("lab", 3, filter=Looks)
    assert landing.verdict.outcome == "landed"
    assert not landing.verdict.violation
    for at in seen[::50]:
        assert np.allclose(at.position_enu_m - at.target_position_enu_m, at.e_m)
        assert (at.lower_m_s <= at.upper_m_s).all()
        safe = at.enforced(np.array([9.0, 9.0, -9.0]))
        assert (safe >= at.lower_m_s).all()
        assert (safe <= at.upper_m_s).all()
        assert at.gradient.shape == at.velocity_enu_m_s.shape == at.target_velocity_enu_m_s.shape == (3,)
    paper = fs.land("lab", 3, filter="paper")  # apart from rounding, both filters fly the same
    both = slice(0, 200)
    assert np.allclose(landing.log.h_m[both], paper.log.h_m[both], atol=1e-4, equal_nan=True)


def test_what_keeps_no_barrier_is_judged_by_the_flight():
    landing = fs.land("lab", 1, filter=returning(lambda nominal, at: 0.5 * nominal))
    assert landing.verdict.violation


class Hasty(fs.RobustFilter):
    """Flies to the pad as fast as the limits allow; ``enforced`` keeps the barrier with the robust margin."""

    def filter(self, nominal, at):
        return at.enforced(at.target_velocity_enu_m_s - 2.0 * at.e_m)


@pytest.mark.parametrize("seed", range(3))
def test_a_filter_that_extends_the_robust_one_keeps_its_margin(seed):
    landing = fs.land("field", seed, filter=Hasty)
    assert not landing.verdict.violation
    assert landing.verdict.outcome in ("landed", "aborted")


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (lambda nominal, at: nominal * np.nan, r"test_filter.py:Wrong returned array\(\[nan, nan, nan\]\)"),
        (lambda nominal, at: 0.5, r"test_filter.py:Wrong returned 0.5; three finite numbers"),
        (lambda nominal, at: "up", r"test_filter.py:Wrong returned 'up'; three finite numbers"),
        (lambda nominal, at: 1 / 0, "test_filter.py:Wrong raised ZeroDivisionError: division by zero"),
        (lambda nominal, at: None, "test_filter.py:Wrong returned None; three finite numbers"),
        (lambda nominal, at: 10**400, "test_filter.py:Wrong returned 1000.*; three finite numbers"),
    ],
)
def test_a_result_that_is_no_velocity_aborts_and_names_the_class(value, text):
    landing = fs.land("lab", 1, filter=returning(value))
    assert landing.verdict.outcome == "aborted"
    assert re.search(text, landing.verdict.reason)
    assert not landing.verdict.violation


@pytest.mark.parametrize("base", [fs.Filter, fs.RobustFilter])
@pytest.mark.parametrize("helper", ["enforced", "permitted"])
@pytest.mark.parametrize(
    ("value", "found"),
    [
        ((np.nan, 0.0, 0.0), r"\(nan, 0.0, 0.0\)"),
        ((0.0, 0.0, -np.inf), r"\(0.0, 0.0, -inf\)"),
        (0.5, "0.5"),
        (np.zeros((3, 1)), r"array\(\[\[0.\],"),
    ],
)
def test_a_helper_that_is_given_no_velocity_aborts_and_names_it(base, helper, value, found):
    class Wrong(base):
        def filter(self, nominal, at):
            return getattr(at, helper)(value if at.h_m < 0.5 else nominal)

    landing = fs.land("lab", 1, filter=Wrong)
    assert landing.verdict.outcome == "aborted"
    text = rf"test_filter.py:Wrong raised ValueError: at.{helper}: found {found}.*; three finite numbers"
    assert re.search(text, landing.verdict.reason)
    assert not landing.verdict.violation
    assert np.isfinite(landing.log.command_enu_m_s).all()


def test_a_wrong_class_or_state_is_one_clear_line(tmp_path):
    done = flightstack("sitl", "--scenario", "lab", "--filter", "json:loads", "--out", tmp_path)
    assert done.code == 2
    assert "found 'json:loads', which is no subclass of flightstack.Filter" in done.err
    assert len(done.err.strip().splitlines()) <= 3

    class Odd(fs.Filter):
        State = 3

    with pytest.raises(ConfigError, match="State is 3; a dataclass is needed"):
        fs.land("lab", filter=Odd)

    @dataclass
    class Listed:
        found: list = None

    class Untyped(fs.Filter):
        State = Listed

        def filter(self, nominal, at):
            return nominal

    assert fs.land("lab", filter=Untyped).verdict is not None  # without a log, no source text is needed


@pytest.mark.parametrize("verb", ["onboard", "fly"])
def test_a_real_vehicle_flies_it_only_if_told_that_nothing_is_proven(tmp_path, verb):
    config = tmp_path / "mine.toml"
    config.write_text(f'base = "crazyflie"\nfilter = "{SMOOTH}"\n')
    words = (verb, "--vehicle", "udpin:127.0.0.1:0", "--config", config, "--no-record", "--duration", "0.5")
    done = flightstack(*words)
    assert done.code == 2
    refused = f"filter {SMOOTH} has no certificate of its own; --unproven flies it"
    assert refused in " ".join(done.err.split())
    flown = flightstack(*words, "--unproven")
    assert flown.code == 1  # within the time limit no vehicle answers
    assert "no heartbeat" in flown.out
    assert verb == "onboard" or f"config mine, filter {SMOOTH}" in flown.out

"""Tests the profiles of the autopilots, and the page that lists them."""

import sys
from pathlib import Path
from types import ModuleType

import pytest

from bridge.mavlink import profiles
from bridge.mavlink.preflight import table
from bridge.mavlink.profiles import ARDUPILOT, AUTO, CHOICES, PROFILES, PX4, found, refusal
from bridge.target.ros2_target import TargetType
from flightstack.common.options import declared
from flightstack.config.options import TARGET_TYPES, OnboardOptions
from flightstack.core.types import Mode, Request
from tests.unit.mavlink.client.autopilots_page import PAGE, split, tables


def test_every_profile_is_whole():
    for name, each in PROFILES.items():
        assert each.name == name
        assert set(each.sequences) == set(Request)
        assert Mode.EXTERNAL in each.modes.values()
        assert Mode.LAND in each.modes.values()
        assert not any(
            step.blind for r in Request if r is not Request.MOTORS_OFF for step in each.sequences[r]
        )
    assert (AUTO, *PROFILES) == CHOICES


def test_a_profile_is_used_once_it_is_defined(monkeypatch):
    """Another autopilot is a copy of the module with one more definition, and nothing else."""
    source = Path(profiles.__file__).read_text()
    more = 'ACME = replace(ARDUPILOT, name="acme", title="Acme", autopilot=13)\n'
    after = "\n# all profiles of this module"
    assert source.count(after) == 1
    copy = ModuleType("bridge.mavlink.profiles")
    monkeypatch.setitem(sys.modules, copy.__name__, copy)
    exec(source.replace(after, f"\n{more}{after}"), vars(copy))
    acme = copy.ACME
    assert copy.profile("acme") is acme is copy.found(13)
    assert copy.refusal(13, 2, None) is None
    assert "Acme (13)" in copy.refusal(99, 2, None)
    option = next(each.option for each in declared(OnboardOptions) if each.name == "autopilot")
    assert "acme" in option.allowed
    monkeypatch.setattr(table, "PROFILES", copy.PROFILES)
    assert table.table.__wrapped__("acme") == table.table("ardupilot")


def test_the_command_knows_the_types_of_targets():
    assert tuple(each.value for each in TargetType) == TARGET_TYPES


def test_a_variant_does_not_replace_the_autopilot_that_it_imitates():
    assert found(PX4.autopilot) is PX4
    assert {each.autopilot for each in PROFILES.values() if each.mark} == {PX4.autopilot}


@pytest.mark.parametrize(
    ("autopilot", "type_", "chosen", "words"),
    [
        (0, 2, None, ["unsupported", "GENERIC (0)", "PX4", "ArduCopter"]),
        (99, 2, None, ["99"]),
        (12, 1, None, ["FIXED_WING (1)", "QUADROTOR (2)"]),
        (3, 10, ARDUPILOT, ["GROUND_ROVER (10)"]),
        (3, 2, PX4, ["autopilot 3", "'px4'", "auto"]),
    ],
)
def test_who_is_not_known_is_refused_with_what_is(autopilot, type_, chosen, words):
    text = refusal(autopilot, type_, chosen)
    assert text is not None
    for word in words:
        assert word in text


@pytest.mark.parametrize("type_", [2, 13, 14, 15])
def test_multirotors_of_both_are_flown(type_):
    assert refusal(12, type_, None) is None
    assert refusal(3, type_, ARDUPILOT) is None


TEXT = PAGE.read_text()


@pytest.mark.parametrize("name", tables())
def test_the_tables_are_the_codes(name):
    _, within, _ = split(TEXT, name)
    assert within == tables()[name], "run: python -m tests.unit.mavlink.client.autopilots_page"

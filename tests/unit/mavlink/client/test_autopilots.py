"""Tests the profiles of the autopilots, and the page that lists them."""

import pytest

from bridge.mavlink.profiles import ARDUPILOT, AUTO, CHOICES, PROFILES, PX4, refusal
from bridge.target.ros2_target import TargetType
from flightstack.config.options import AUTOPILOTS, TARGET_TYPES
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


def test_the_command_knows_autopilots_and_types_of_targets():
    assert AUTOPILOTS == CHOICES
    assert tuple(each.value for each in TargetType) == TARGET_TYPES


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

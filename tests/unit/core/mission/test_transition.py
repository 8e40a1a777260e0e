"""A change of phase is data; its text is made and read at one place."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.core.memory import AbortWay
from flightstack.core.mission.machine import Transition, parse
from flightstack.core.types import Phase
from tests.point_mass import World
from tests.unit.core.mission.test_guidance import ROBUST

reasons = st.text(st.characters(codec="utf-8"), max_size=40).filter(lambda text: not text.endswith(")"))


@given(st.sampled_from(Phase), st.sampled_from(Phase), st.sampled_from(AbortWay), reasons)
def test_what_was_written_is_read(before, after, way, why):
    if before is after or after is Phase.ABORT:
        after, way = Phase.ABORT, way if way is not AbortWay.NONE else AbortWay.LAND_HERE
    else:
        way = AbortWay.NONE
    change = Transition(before, after, why, way)
    assert parse(change.text) == change
    assert parse(change.told(12.345)) == parse(change.told(1234567.0)) == change


@pytest.mark.parametrize(
    ("text", "change"),
    [
        (
            "LAND -> HOLD: target lost: no sample (of it) has come",
            Transition(Phase.LAND, Phase.HOLD, "target lost: no sample (of it) has come"),
        ),
        (
            "CLIMB -> ABORT: target did not come back (fly clear)",
            Transition(Phase.CLIMB, Phase.ABORT, "target did not come back", AbortWay.FLY_CLEAR),
        ),
        (
            "ABORT: ended by the operator (land here)",
            Transition(Phase.ABORT, Phase.ABORT, "ended by the operator", AbortWay.LAND_HERE),
        ),
    ],
)
def test_the_text_is_that_of_the_log(text, change):
    assert change.text == text
    assert parse(text) == change


@pytest.mark.parametrize(
    "text",
    ["", "target sample refused: jumped", "LAND -> DANCE: why", "LAND: why", "No -> ABORT: x", "-> ABORT"],
)
def test_other_texts_are_no_changes(text):
    assert parse(text) is None


def test_each_change_of_a_flight_is_an_output_and_an_event():
    world = World(ROBUST, solid_pad=True).run(60.0)
    changes = [out.transition for out in world.outputs if out.transition is not None]
    assert changes[-1].after is Phase.LANDED
    assert [parse(text) for text in world.texts] == changes
    phase = Phase.WAIT
    for out in world.outputs:
        if out.transition is not None:
            assert out.transition.before is phase
            phase = out.transition.after
        assert out.phase is phase

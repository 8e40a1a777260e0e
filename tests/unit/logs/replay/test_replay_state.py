"""Tests that a controller whose state was restored from text at any tick decides as the original one."""

import struct
from dataclasses import dataclass, fields, is_dataclass, replace
from enum import Enum
from typing import Any, get_args, get_origin, get_type_hints

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.common.pacing import Tick
from flightstack.core.controller import Controller
from flightstack.core.memory import FleetMemory, State
from flightstack.core.parameters.filters import FILTERS
from flightstack.core.safety.qp_filter import SafetyFilter
from flightstack.core.types import ZERO, MemberStatus, Operator
from flightstack.onboard.state_text import StateText, StateTextError
from logs.schema.controller_rows import step_row
from tests.examples import examples
from tests.point_mass import World, each_sample
from tests.unit.core.test_bad_input import TARGET_FAULTS
from tests.unit.logs.recorder.test_rows import FLOATS, TEXTS
from tests.unit.logs.replay.replay_helpers import CONFIG

TEXT = StateText(State)
PLAIN = {Any: st.none(), float: FLOATS, bool: st.booleans(), int: st.integers(0, 2**40), str: TEXTS}


def any_of(hint):
    """Return a hypothesis strategy for all values of a declared type."""
    if hint in PLAIN:
        return PLAIN[hint]
    if is_dataclass(hint):
        hints = get_type_hints(hint)
        return st.builds(hint, **{f.name: any_of(hints[f.name]) for f in fields(hint)})
    if isinstance(hint, type) and issubclass(hint, tuple) and hasattr(hint, "_fields"):
        return st.builds(hint, **{n: any_of(h) for n, h in get_type_hints(hint).items()})
    if get_origin(hint) is tuple and Ellipsis in get_args(hint):
        return st.lists(any_of(get_args(hint)[0]), max_size=3).map(tuple)
    if get_origin(hint) is tuple:
        return st.tuples(*map(any_of, get_args(hint)))
    if isinstance(hint, type) and issubclass(hint, Enum):
        return st.sampled_from(hint)
    return st.one_of(st.none() if each is type(None) else any_of(each) for each in get_args(hint))


def packed(value):
    """Return every leaf of a state; floats as bits, because NaN does not equal itself."""
    if is_dataclass(value):
        return [(f.name, packed(getattr(value, f.name))) for f in fields(value)]
    if isinstance(value, tuple):
        return [packed(v) for v in value]
    return struct.pack("<d", value) if isinstance(value, float) else (type(value), value)


@given(any_of(State))
def test_any_state_comes_back_to_the_bit(state):
    back = TEXT.loads(TEXT.layout, TEXT.dumps(state))
    assert packed(back) == packed(state)


@given(any_of(FleetMemory))
def test_what_is_remembered_of_a_fleet_comes_back_to_the_bit(memory):
    text = StateText(FleetMemory)
    assert packed(text.loads(text.layout, text.dumps(memory))) == packed(memory)


@pytest.mark.parametrize("found", ["3", "{}", "null"])
def test_a_tuple_of_any_length_is_a_list_in_the_text(found):
    text = StateText(MemberStatus)
    whole = text.dumps(MemberStatus(3, 0.0, 0.0, ZERO, ZERO, ZERO, yields_to=(1, 2)))
    assert text.loads(text.layout, whole).yields_to == (1, 2)
    with pytest.raises(StateTextError, match=r"yields_to: .* a list is needed"):
        text.loads(text.layout, whole.replace("[1,2]", found))


FAULTS = {
    "none": None,
    **TARGET_FAULTS,
    "abort": lambda w, i: i.__class__(i.own, i.status, i.target_samples, Operator.ABORT),
    "emergency": lambda w, i: i.__class__(i.own, i.status, i.target_samples, Operator.EMERGENCY_STOP),
    "no own state": lambda w, i: i.__class__(None, i.status, i.target_samples),
    "elsewhere": each_sample(position_enu_m=(2.0, 2.0, 0.2)),
}


def step_bytes(tick, now_s, out):
    events = tuple(out.events)
    return step_row(Tick(tick, now_s, tick, 0.0, 0.0), out).pack(), events


@examples(25)
@given(
    fault=st.sampled_from(sorted(FAULTS)),
    at_s=st.floats(0.0, 3.0),
    lasts_s=st.floats(0.05, 2.5),
    cut=st.integers(0, 399),
    kind=st.sampled_from(sorted(FILTERS)),
)
def test_restored_at_any_tick_it_decides_what_the_straight_run_decides(fault, at_s, lasts_s, cut, kind):
    config = replace(CONFIG, filter=kind)
    world = World(config, FAULTS[fault], at_s, at_s + lasts_s, position=(-0.5, 0.2, 0.9))
    flown = []
    text = None
    for tick in range(400):
        now_s, given = world.t_s, world.inputs()
        out = world.step()
        flown.append((now_s, given, step_bytes(tick, now_s, out)))
        if tick == cut:
            text = TEXT.dumps(world.controller.state)
    controller = Controller(config)
    controller.restore(TEXT.loads(TEXT.layout, text))
    for tick, (now_s, inputs, expected) in enumerate(flown[cut + 1 :], cut + 1):
        assert step_bytes(tick, now_s, controller.step(inputs, now_s)) == expected
    assert TEXT.dumps(controller.state) == TEXT.dumps(world.controller.state)


def leaves(value, name="controller"):
    """Yield all plain values in an object, at any depth, except the solver's scratch memory."""
    if isinstance(value, SafetyFilter | type) or callable(value):
        return
    if is_dataclass(value):
        inner = {f.name: getattr(value, f.name) for f in fields(value)}
    elif isinstance(value, tuple | list):
        inner = dict(enumerate(value))
    else:
        inner = value if isinstance(value, dict) else getattr(value, "__dict__", None)
    if inner is None:
        yield name, struct.pack("<d", value) if isinstance(value, float) else value
        return
    for key, each in inner.items():
        yield from leaves(each, f"{name}.{key}")


@pytest.mark.parametrize("filter_kind", FILTERS)
def test_the_state_is_all_that_changes_in_a_controller(filter_kind):
    config = replace(CONFIG, filter=filter_kind)
    fault = each_sample(position_enu_m=(2.0, 2.0, 0.2))
    world = World(config, fault, 0.5, 0.8, position=(-0.5, 0.2, 0.9)).run(2.0)
    restored = Controller(config)
    fresh = dict(leaves(restored))
    restored.restore(TEXT.loads(TEXT.layout, TEXT.dumps(world.controller.state)))
    flown = dict(leaves(world.controller))
    assert dict(leaves(restored)) == flown
    assert fresh != flown
    assert any(name.endswith("offset_s") for name in flown)  # the search reaches nested values


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (('"retries":0', '"retries":0.5'), "memory.retries"),
        (('"retries":0', '"retries":true'), "memory.retries"),
        (('"retries":0', '"tries":0'), "memory"),
        (('"phase":"WAIT"', '"phase":"DANCE"'), "memory.phase"),
        (('"phase_since_s":0.0', '"phase_since_s":NaN'), "NaN"),
        (('"phase_since_s":0.0', '"phase_since_s":"f64:00"'), "memory.phase_since_s"),
        (('"command":[0.0,0.0,0.0]', '"command":[0.0,0.0]'), "memory.command"),
        (('"yaw_rad":null', '"yaw_rad":"north"'), "memory.yaw_rad"),
        (('{"memory"', '["memory"'), "not JSON"),
    ],
)
def test_text_that_is_no_state_is_refused_and_named(change, word):
    controller = Controller(CONFIG)
    controller.state.memory.swings = 1  # a part that equals its default is left out of the text
    text = TEXT.dumps(controller.state)
    assert change[0] in text
    with pytest.raises(StateTextError, match=word):
        TEXT.loads(TEXT.layout, text.replace(*change))


@dataclass
class _Listed:
    values: list[float]


@dataclass
class _Either:
    value: int | str


@pytest.mark.parametrize("cls", [_Listed, _Either])
def test_a_type_that_cannot_be_written_is_refused_at_the_start(cls):
    with pytest.raises(TypeError, match=cls.__name__):
        StateText(cls)


def test_another_layout_is_refused():
    with pytest.raises(StateTextError, match="layout 'old' found"):
        TEXT.loads("old", TEXT.dumps(Controller(CONFIG).state))

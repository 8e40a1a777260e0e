"""Tests that a controller with the restored state of any tick makes the original decisions."""

import struct
from copy import deepcopy
from dataclasses import dataclass, fields, is_dataclass, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.common.pacing import Tick
from flightstack.core.controller import Controller
from flightstack.core.memory import State
from flightstack.core.parameters.filters import FILTERS
from flightstack.core.safety.qp_filter import SafetyFilter
from flightstack.core.types import Operator
from flightstack.onboard.state_text import StateText
from logs.schema.controller_rows import step_row
from tests.examples import examples
from tests.point_mass import World, each_sample
from tests.unit.core.test_bad_input import TARGET_FAULTS
from tests.unit.logs.replay.replay_helpers import CONFIG

TEXT = StateText(State)
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
    state = None
    for tick in range(400):
        now_s, given = world.t_s, world.inputs()
        out = world.step()
        flown.append((now_s, given, step_bytes(tick, now_s, out)))
        if tick == cut:
            state = deepcopy(world.controller.state)
    controller = Controller(config)
    controller.restore(state)
    for tick, (now_s, inputs, expected) in enumerate(flown[cut + 1 :], cut + 1):
        assert step_bytes(tick, now_s, controller.step(inputs, now_s)) == expected
    assert TEXT.dumps(controller.state) == TEXT.dumps(world.controller.state)


def leaves(value, name="controller"):
    """Yield (name, value) of all plain values in an object, at any depth, except those of the solver."""
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
    restored.restore(deepcopy(world.controller.state))
    flown = dict(leaves(world.controller))
    assert dict(leaves(restored)) == flown
    assert fresh != flown
    assert any(name.endswith("offset_s") for name in flown)  # the search reaches nested values


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

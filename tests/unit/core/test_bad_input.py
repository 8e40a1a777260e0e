"""Tests bad samples of the target, and vehicle states with NaN or infinity."""

import dataclasses
import math

import pytest

from flightstack.core.parameters.filters import FILTERS
from flightstack.core.types import OwnState, Phase
from tests.point_mass import DT_S, World, each_sample
from tests.unit.core.core_helpers import SLOW, config

CONFIG = config(limits=SLOW, touchdown={"rule": "paper"})


def no_samples(_, inputs):
    return inputs._replace(target_samples=())


def stuck_sample(world, inputs):
    """Replace the target samples by the first samples, like a sender that is stuck."""
    if not hasattr(world, "stuck"):
        world.stuck = inputs.target_samples
    return inputs._replace(target_samples=tuple(s._replace(arrival_s=world.t_s) for s in world.stuck))


def late_by(inputs, late_s):
    samples = (s._replace(source_time_s=s.source_time_s - late_s) for s in inputs.target_samples)
    return inputs._replace(target_samples=tuple(samples))


def older_each_time(world, inputs):
    return late_by(inputs, 2.0 * (world.t_s - world.fault_from_s) + DT_S)


def half_a_second_late(world, inputs):
    """Delay the target samples by half a second, without a change of their order."""
    queue = world.__dict__.setdefault("queue", {})
    queue.update((s.arrival_s, s) for s in inputs.target_samples)
    come = tuple(s for t_s, s in queue.items() if abs(world.t_s - 0.5 - t_s) < 0.5 * DT_S)
    return inputs._replace(target_samples=tuple(s._replace(arrival_s=world.t_s) for s in come))


TARGET_FAULTS = {
    "missing": no_samples,
    "late": half_a_second_late,
    "out of order": older_each_time,
    "repeated": stuck_sample,
    "not a number": each_sample(position_enu_m=(math.nan, 0.0, 0.2)),
    "another robot": each_sample(child_frame_id="other"),
}


def flown(fault, phase=Phase.APPROACH, seconds=math.inf):
    return World(CONFIG).fault_in(phase, fault, seconds)


def test_a_stream_of_refused_samples_is_told_by_doublings():
    world = flown(stuck_sample)
    for _ in range(40):
        world.step()
    told = [text for text in world.texts if text.startswith("target sample refused: ")]
    count = world.controller.track.memory.rejected
    assert count >= 30
    assert len(told) == count.bit_length()
    assert told[-1].endswith(f"({2 ** (len(told) - 1)} refused so far)")


BAD = (math.nan, math.inf, -math.inf)
GOOD = OwnState(1.0, 2.0, (0.1, 0.2, 0.3), (0.4, 0.5, 0.6), 0.7)
# times in the controller's state that are infinite or NaN before their event
TIMES = ("started_s", "own_ok_s", "offset_s", "time_s", "claim_s", "committed_s", "crowded_s")
# NaN if the vehicle was never on the ground, or if it reports neither battery nor throttle
UNSET = ("ground_z_m", "effort")


def spoiled(own, field, axis, bad):
    value = getattr(own, field)
    if isinstance(value, tuple):
        bad = (*value[:axis], bad, *value[axis + 1 :])
    return own._replace(**{field: bad})


def numbers(value):
    """Yield the floats of a nested state, except those of ``TIMES``, ``UNSET`` and ``*since_s``."""
    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            if field.name not in UNSET and not field.name.endswith("since_s") and field.name not in TIMES:
                yield from numbers(getattr(value, field.name))
    elif isinstance(value, tuple):
        for item in value:
            yield from numbers(item)
    elif isinstance(value, float):
        yield value


FIELDS = [("velocity_enu_m_s", axis) for axis in range(3)] + [("position_enu_m", axis) for axis in range(3)]


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize(("field", "axis"), [*FIELDS, ("yaw_rad", 0), ("arrival_s", 0)])
def test_one_number_is_enough(field, axis, bad):
    assert GOOD.is_finite
    assert not spoiled(GOOD, field, axis, bad).is_finite
    if field.endswith(("_m", "_m_s")):
        other = spoiled(GOOD, field, (axis + 1) % 3, -bad)
        assert not spoiled(other, field, axis, bad).is_finite  # two such values do not cancel each other


@pytest.mark.parametrize("kind", FILTERS)
@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize(("field", "axis"), [("velocity_enu_m_s", 2), ("position_enu_m", 0), ("yaw_rad", 0)])
def test_the_memory_stays_finite_and_the_flight_goes_on_when_it_is_over(kind, field, axis, bad):
    """If states have NaN or infinity, the controller's state remains finite, and the vehicle lands later."""
    world = World(config(kind, limits=SLOW), solid_pad=True)
    world.run(0.5)
    learned = world.controller.state.tracking.disturbance_m_s
    world.fault = lambda _, inputs: inputs._replace(own=spoiled(inputs.own, field, axis, bad))
    world.fault_from_s, world.fault_to_s = world.t_s, world.t_s + 0.25
    began = len(world.outputs)
    while world.t_s < world.fault_to_s:
        out = world.step()
        assert out.snapshot.inputs.own is None
        assert out.setpoint is None
        assert all(map(math.isfinite, numbers(world.controller.state)))
    assert world.controller.state.tracking.disturbance_m_s == learned
    assert Phase.HOLD in {out.phase for out in world.outputs[began:]}
    world.run(60.0, until=lambda w: w.phase in (Phase.LANDED, Phase.ABORT))
    assert world.phase is Phase.LANDED


@pytest.mark.parametrize("bad", BAD)
def test_a_flight_that_begins_with_it_takes_no_heading_from_it(bad):
    world = World(config(limits=SLOW))
    world.fault = lambda _, inputs: inputs._replace(own=inputs.own._replace(yaw_rad=bad))
    world.fault_from_s, world.fault_to_s = 0.0, 0.1
    world.run(0.1)
    assert world.controller.memory.yaw_rad is None
    world.run(0.1)
    assert world.controller.memory.yaw_rad == 0.0

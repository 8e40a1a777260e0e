"""Faults of the links and the vehicle's reaction: it holds, climbs or lands away in time."""

import dataclasses
import itertools
import math
from dataclasses import replace

import pytest

from flightstack.core.memory import AbortWay
from flightstack.core.parameters.filters import FILTERS
from flightstack.core.types import FilterStatus, Mode, OwnState, Phase
from tests.point_mass import DT_S, World, each_sample
from tests.unit.core.core_helpers import SLOW, config

REACTION_MAX_S = 0.5
CONFIG = config(limits=SLOW, touchdown={"rule": "paper"})


def no_samples(_, inputs):
    return inputs._replace(target_samples=())


def stuck_sample(world, inputs):
    """Repeat the same message."""
    if not hasattr(world, "stuck"):
        world.stuck = inputs.target_samples
    return inputs._replace(target_samples=tuple(s._replace(arrival_s=world.t_s) for s in world.stuck))


def late_by(inputs, late_s):
    samples = (s._replace(source_time_s=s.source_time_s - late_s) for s in inputs.target_samples)
    return inputs._replace(target_samples=tuple(samples))


def older_each_time(world, inputs):
    return late_by(inputs, 2.0 * (world.t_s - world.fault_from_s) + DT_S)


def half_a_second_late(world, inputs):
    """Delay messages by half a second, in order."""
    queue = world.__dict__.setdefault("queue", {})
    queue.update((s.arrival_s, s) for s in inputs.target_samples)
    come = tuple(s for t_s, s in queue.items() if abs(world.t_s - 0.5 - t_s) < 0.5 * DT_S)
    return inputs._replace(target_samples=tuple(s._replace(arrival_s=world.t_s) for s in come))


def jumped_by_a_metre(_, inputs):
    def jumped(sample):
        x, y, z = sample.position_enu_m
        return sample._replace(position_enu_m=(x + 1.0, y, z))

    return inputs._replace(target_samples=tuple(map(jumped, inputs.target_samples)))


def silent(world, inputs):
    """Repeat the vehicle state from the start of the fault."""
    if not hasattr(world, "frozen"):
        world.frozen = inputs.own
    return inputs._replace(own=world.frozen)


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


@pytest.mark.slow
@pytest.mark.parametrize("phase", [Phase.APPROACH, Phase.LAND])
@pytest.mark.parametrize("name", TARGET_FAULTS)
def test_a_target_that_cannot_be_believed_is_held_then_climbed_from_then_landed_away_from(name, phase):
    world = flown(TARGET_FAULTS[name], phase)
    since_s = world.fault_from_s
    world.run(REACTION_MAX_S, until=lambda w: w.phase is Phase.HOLD)
    assert world.phase is Phase.HOLD
    assert world.t_s - since_s <= REACTION_MAX_S
    held_at_m = world.position[2]
    world.run(20.0, until=lambda w: w.phase is Phase.CLIMB)
    assert world.phase is Phase.CLIMB
    assert world.position[2] > held_at_m - 0.1
    world.run(60.0)
    assert world.phase is Phase.ABORT
    assert world.controller.memory.abort_way is AbortWay.FLY_CLEAR
    known = world.controller.memory.target_position_enu_m
    assert math.dist(world.position[:2], known[:2]) >= CONFIG.checks.clearance_m - 0.05
    assert not world.armed  # landed next to the robot


@pytest.mark.parametrize("name", TARGET_FAULTS)
def test_a_target_that_comes_back_is_landed_on(name):
    world = flown(TARGET_FAULTS[name], seconds=0.6)
    world.run(60.0)
    assert world.phase is Phase.LANDED
    assert any("inputs good again" in text for text in world.texts)


def test_retries_are_limited():
    def now_and_then(world, inputs):
        return no_samples(world, inputs) if (world.t_s - world.fault_from_s) % 1.2 < 0.6 else inputs

    world = flown(now_and_then).run(60.0)
    assert world.phase is Phase.ABORT
    assert world.controller.memory.retries == CONFIG.checks.retries_max


def test_a_jump_by_a_metre_is_not_followed_until_it_has_proved_itself():
    world = flown(jumped_by_a_metre)
    before = len(world.sent)
    world.run(0.2)
    target = world.outputs[-1].snapshot.target.position_enu_m
    assert target[0] < world.pad[0] + 0.1  # still at its estimated position
    assert len(world.sent) > before
    world.run(5.0, until=lambda w: w.phase is Phase.HOLD)
    assert world.phase is Phase.HOLD


def test_a_silent_vehicle_gets_no_velocity_at_all():
    world = flown(silent)
    world.run(CONFIG.checks.own_age_max_s + 2 * DT_S)
    sent = len(world.sent)
    assert world.t_s - world.fault_from_s < REACTION_MAX_S
    world.run(5.0)
    assert len(world.sent) == sent  # no stale set-point is repeated
    assert world.mode is Mode.LAND  # the vehicle's own fail-safe, or ours
    assert world.phase is Phase.ABORT


def test_a_vehicle_that_comes_back_is_flown_on():
    world = flown(silent, seconds=0.3).run(60.0)
    assert any("own state lost" in text for text in world.texts)
    assert world.phase is Phase.LANDED


def test_a_solver_that_fails_in_flight_is_replaced_and_the_landing_goes_on(monkeypatch):
    world = World(CONFIG)
    monkeypatch.setattr(world.controller.program, "_osqp", lambda *_: ((0.0, 0.0, 0.0), math.inf, 4000))
    world.run(60.0)
    assert world.phase is Phase.LANDED
    landing = [o for o in world.outputs if o.phase in (Phase.APPROACH, Phase.LAND) and o.barrier is not None]
    assert {o.barrier.result.status for o in landing} <= {FilterStatus.CLOSED_FORM, FilterStatus.INFEASIBLE}


@pytest.mark.parametrize("kind", FILTERS)
def test_every_set_point_is_inside_the_box_and_what_is_wanted_changes_no_faster_than_allowed(kind):
    settings = replace(CONFIG, filter=kind)
    world = World(settings).run(60.0)
    fastest = {
        "paper": settings.limits.slew_max_m_s2,
        "robust": settings.robust.acceleration_max_m_s2,
    }
    assert len(world.sent) > 200
    for _, setpoint in world.sent:
        for axis in range(3):
            assert abs(setpoint[axis]) <= settings.limits.velocity_max_m_s[axis] + 1e-9
    for before, after in itertools.pairwise(world.outputs):
        sent = before.setpoint is not None and after.setpoint is not None
        if not sent or before.snapshot.inputs.status.mode is not Mode.EXTERNAL:
            continue
        for axis in range(3):
            change = abs(after.wanted[axis] - before.wanted[axis])
            assert change <= fastest[kind][axis] * DT_S + 1e-9
        if kind == "paper":
            assert after.setpoint.velocity_enu_m_s == after.wanted


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
TIMES = ("started_s", "own_ok_s", "offset_s", "time_s")  # infinite or NaN until they are known
UNSET = "ground_z_m"  # unknown if it never stood on the ground


def spoiled(own, field, axis, bad):
    """Return the vehicle state with one number replaced."""
    value = getattr(own, field)
    if isinstance(value, tuple):
        bad = (*value[:axis], bad, *value[axis + 1 :])
    return own._replace(**{field: bad})


def numbers(value):
    """Yield every number of a tree of states, except times and values unknown in this flight."""
    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            if field.name != UNSET and not field.name.endswith("since_s") and field.name not in TIMES:
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
        assert not spoiled(other, field, axis, bad).is_finite  # two such numbers do not cancel each other


@pytest.mark.parametrize("kind", FILTERS)
@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize(("field", "axis"), [("velocity_enu_m_s", 2), ("position_enu_m", 0), ("yaw_rad", 0)])
def test_the_memory_stays_finite_and_the_flight_goes_on_when_it_is_over(kind, field, axis, bad):
    """After the age limit it holds as after any loss of the vehicle state, and then lands."""
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

"""An own state with a number that is not finite: it is never used, and nothing of it stays in a memory."""

import dataclasses
import math

import pytest

from flightstack.core.parameters.filters import FILTERS
from flightstack.core.types import OwnState, Phase
from tests.point_mass import World
from tests.unit.core.core_helpers import SLOW, config

BAD = (math.nan, math.inf, -math.inf)
GOOD = OwnState(1.0, 2.0, (0.1, 0.2, 0.3), (0.4, 0.5, 0.6), 0.7)
TIMES = ("started_s", "own_ok_s", "offset_s", "time_s")  # infinite or NaN before they are known
UNSET = "ground_z_m"  # it never stood


def spoiled(own, field, axis, bad):
    """The own state with one number replaced."""
    value = getattr(own, field)
    if isinstance(value, tuple):
        bad = (*value[:axis], bad, *value[axis + 1 :])
    return own._replace(**{field: bad})


def numbers(value):
    """Every number of a tree of states, but for times and what is not known in this flight."""
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
        assert not spoiled(other, field, axis, bad).is_finite  # nor do two of them cancel


@pytest.mark.parametrize("kind", FILTERS)
@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize(("field", "axis"), [("velocity_enu_m_s", 2), ("position_enu_m", 0), ("yaw_rad", 0)])
def test_the_memory_stays_finite_and_the_flight_goes_on_when_it_is_over(kind, field, axis, bad):
    """Longer than the age limit: it holds like after any loss of the own state, and lands then."""
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

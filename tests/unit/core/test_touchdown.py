"""The last centimetres: by the paper's rule, and by contact."""

import math
import random
from dataclasses import replace

import pytest

from flightstack.common.strict_toml import from_table
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.types import Landed, Mode, Operator, Phase, Request
from tests.point_mass import World


def config(rule):
    return from_table(
        FlightConfig,
        {
            "barrier": {"alpha_1_m": 1.0, "beta_m": 1.5},
            "limits": {"velocity_max_m_s": [0.4, 0.4, 0.5]},
            "touchdown": {"rule": rule},
        },
    )


def landed(rule, **changes):
    world = World(config(rule), solid_pad=True, **changes)
    return world.run(60.0, until=lambda w: w.phase in (Phase.LANDED, Phase.ABORT))


def height_at(world, phase):
    """Relative height at which the phase began."""
    return next(o.seen.e_m[2] for o in world.outputs if o.phase is phase)


def test_by_the_papers_rule_the_motors_go_off_below_five_centimetres_inside_the_cone():
    world = landed("paper")
    assert world.phase is Phase.LANDED
    off = next(o for o in world.outputs if o.request is Request.MOTORS_OFF)
    assert 0.045 < off.seen.e_m[2] < 0.05
    assert world.controller.barrier.h(off.seen.e_m) >= 0.0


@pytest.mark.parametrize("says_standing", [True, False])
def test_by_contact_they_go_off_after_it_stands(says_standing):
    world = landed("contact", says_standing=says_standing)
    assert world.phase is Phase.LANDED
    assert height_at(world, Phase.TOUCHDOWN) > 0.04
    off = next(o for o in world.outputs if o.request is Request.MOTORS_OFF)
    assert off.seen.inputs.own.arrival_s >= world.touched_s
    assert off.seen.inputs.own.arrival_s - world.touched_s < 0.5


def test_a_pad_that_is_not_where_it_was_said_to_be_ends_in_an_abort():
    world = World(config("contact"))  # nothing to stand on
    world.run(60.0, until=lambda w: w.phase is Phase.ABORT)
    assert world.phase is Phase.ABORT
    assert any("no contact" in text for text in world.texts)


def test_a_target_lost_in_the_last_centimetres_is_landed_on_all_the_same():
    world = World(config("contact"), solid_pad=True)
    world.fault_in(Phase.TOUCHDOWN, lambda _, inputs: replace(inputs, target_samples=()))
    world.run(10.0, until=lambda w: w.phase in (Phase.LANDED, Phase.ABORT))
    assert world.phase is Phase.LANDED
    assert math.dist(world.position[:2], world.pad[:2]) < 0.1


def blown_off(_, inputs):
    """Seen 7 cm beside the middle and going away from it."""
    x, y, z = inputs.target_samples[0].position_enu_m
    vx, vy, vz = inputs.target_samples[0].velocity_enu_m_s
    own = inputs.own
    place = (x + 0.07, y, max(own.position_enu_m[2], z + 0.2))
    return replace(inputs, own=replace(own, position_enu_m=place, velocity_enu_m_s=(vx + 0.5, vy, vz)))


def test_the_robust_filter_goes_around_when_it_is_blown_off_and_lands_then():
    world = World(config("contact"), solid_pad=True)
    world.fault_in(Phase.TOUCHDOWN, blown_off, seconds=0.015)
    out = world.step()
    assert out.phase is Phase.APPROACH
    assert world.controller.memory.retries == 1
    assert out.request is Request.EXTERNAL
    world.run(60.0, until=lambda w: w.phase in (Phase.LANDED, Phase.ABORT))
    assert world.phase is Phase.LANDED


def test_a_new_descent_forgets_what_the_last_one_had_begun_to_see():
    """Not sinking for a moment, then around: in the next descent that moment is long ago, but it is over."""

    def stopped(w, inputs):
        return replace(inputs, own=replace(inputs.own, velocity_enu_m_s=(*w.velocity[:2], 0.0)))

    world = World(config("contact"), solid_pad=True)
    world.fault_in(Phase.TOUCHDOWN, stopped, seconds=1.0)
    memory = world.controller.memory
    world.run(1.0, until=lambda _: memory.stopped_since_s < math.inf)
    world.fault, world.fault_from_s = blown_off, world.t_s
    world.run(0.1, until=lambda w: w.phase is not Phase.TOUCHDOWN)
    assert world.phase is Phase.APPROACH
    assert memory.stopped_since_s < world.t_s
    memory.contact_since_s = memory.stopped_since_s  # as after a touch of the pad's edge
    world.fault = None
    world.run(60.0, until=lambda w: w.phase is Phase.TOUCHDOWN)
    assert world.phase is Phase.TOUCHDOWN
    assert memory.stopped_since_s == memory.contact_since_s == math.inf
    world.run(60.0, until=lambda w: w.phase in (Phase.LANDED, Phase.ABORT))
    assert world.phase is Phase.LANDED


def test_it_goes_around_no_more_often_than_allowed_and_then_flies_clear():
    world = World(config("contact"), solid_pad=True)
    world.fault = lambda w, inputs: blown_off(w, inputs) if w.phase is Phase.TOUCHDOWN else inputs
    world.fault_from_s = 0.0
    world.run(90.0, until=lambda w: w.phase in (Phase.LANDED, Phase.ABORT))
    assert world.phase is Phase.ABORT
    assert world.controller.memory.retries == world.config.checks.retries_max
    assert sum("go around" in text for text in world.texts) == world.config.checks.retries_max
    assert any("no retry left" in text for text in world.texts)


def test_the_papers_filter_does_not_go_around():
    world = World(replace(config("contact"), filter="paper"), solid_pad=True)
    world.fault_in(Phase.TOUCHDOWN, blown_off, seconds=0.015)
    assert world.step().phase is Phase.TOUCHDOWN


@pytest.mark.parametrize("end", [Phase.LANDED, Phase.ABORT])
def test_nothing_that_comes_in_leads_out_of_the_end(end):
    world = World(config("contact"), solid_pad=end is Phase.LANDED)
    world.run(60.0, until=lambda w: w.phase is end)
    assert world.phase is end
    chance = random.Random(9)
    for _ in range(2000):
        world.armed, world.mode = chance.random() < 0.5, chance.choice(list(Mode))
        world.landed = chance.choice(list(Landed))
        world.position = tuple(chance.uniform(-1.0, 2.0) for _ in range(3))
        inputs = world.inputs()
        if chance.random() < 0.2:
            inputs = replace(inputs, target_samples=())
        if chance.random() < 0.2:
            inputs = replace(inputs, operator=Operator.ABORT)
        out = world.controller.step(inputs, world.t_s, command_failed=chance.random() < 0.1)
        world.t_s += 0.05
        assert out.phase is end
        if end is Phase.LANDED:
            assert (out.setpoint, out.request) == (None, Request.NONE)

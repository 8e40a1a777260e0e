"""The last centimetres: by the paper's rule, and by contact."""

import math
from dataclasses import replace

import pytest

from flightstack.config import FlightConfig
from flightstack.strict_toml import from_table
from flightstack.types import Phase, Request
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

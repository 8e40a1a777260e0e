"""Tests the wait above a fast target: at a larger height, for a limited time, until the target is slower."""

import pytest

from flightstack.core.memory import Memory
from flightstack.core.mission import conditions
from flightstack.core.mission.phases import TABLE, Condition, first
from flightstack.core.strategies.user_filter import NOWHERE
from flightstack.core.types import Charge, Phase
from tests.point_mass import World
from tests.unit.core.core_helpers import config
from tests.unit.core.mission.mission_helpers import NOW_S, PAPER, ROBUST, mission_of, names, tick

# the robot of these tests drives at 0.1 m/s
CALM = config(touchdown={"calm_wait_s": 12.0, "calm_speed_m_s": 0.05, "calm_height_m": 0.3})


def touches_s(settings):
    """Return the time from the landing's start to TOUCHDOWN, s, and the lowest relative height in LAND, m."""
    world = World(settings)
    world.run(30.0, until=lambda w: w.phase is Phase.TOUCHDOWN)
    assert world.phase is Phase.TOUCHDOWN
    return world.t_s - world.controller.memory.started_s, min(
        o.snapshot.e_m[2] for o in world.outputs if o.phase is Phase.LAND
    )


def test_over_a_fast_target_it_waits_for_a_slower_one_but_not_for_ever():
    at_once_s, _ = touches_s(config())
    waited_s, lowest_m = touches_s(CALM)
    assert at_once_s < 9.0
    assert 12.0 <= waited_s < 15.0
    assert lowest_m > 0.1


@pytest.mark.parametrize(("height_m", "waits"), [(0.02, False), (0.1, True)])
def test_a_vehicle_that_is_on_the_pad_already_stays_there(height_m, waits):
    at = tick(CALM, (0.0, 0.0, height_m), target_velocity=(0.1, 0.0, 0.0), velocity=(0.1, 0.0, 0.0))
    assert bool(at & Condition.TOUCH) is not waits


def leads_to(height_m=0.6, speed_m_s=0.1, charge=Charge.FIT, **memory):
    """Return the phase after TOUCHDOWN of a vehicle above the centre of the target; None: no change."""
    moving = (speed_m_s, 0.0, 0.0)
    flags = tick(
        CALM, (0.0, 0.0, height_m), target_velocity=moving, velocity=moving, charge=charge,
        memory=Memory(phase=Phase.TOUCHDOWN, **memory),
    )  # fmt: skip
    rule = first(TABLE[Phase.TOUCHDOWN], flags)
    return rule.to if rule is not None else None


def goes_around(*where, **memory):
    return leads_to(*where, **memory) is Phase.APPROACH


def test_a_target_that_sets_off_during_the_descent_is_gone_around_from_while_there_is_height():
    left_m = CALM.retreat.h_left_m
    assert goes_around(left_m + 1e-6)
    assert not goes_around(left_m - 1e-6)
    assert not goes_around(speed_m_s=0.04)
    assert not goes_around(contact=True)
    assert goes_around(retries=CALM.checks.retries_max - 1)
    assert not goes_around(retries=CALM.checks.retries_max)
    assert not goes_around(started_s=-CALM.touchdown.calm_wait_s)
    assert leads_to(charge=Charge.TIRED) is Phase.ABORT  # the battery allows no go-around


CHECKS, PAD_M = ROBUST.checks, ROBUST.touchdown.pad_radius_m
IN, OUT = (0.0, 0.0, 0.3), (3.0 * PAD_M, 0.0, 0.3)


LEFT = "left the cone over it 4 times; checks.swings_max is 3"
STAYED = "no touchdown in checks.over_pad_time_max_s, 15 s"


@pytest.mark.parametrize(
    ("swings", "in_phase_s", "e", "text"),
    [
        (CHECKS.swings_max, 0.1, OUT, LEFT),
        (CHECKS.swings_max, 0.1, IN, ""),
        (CHECKS.swings_max - 1, 0.1, OUT, ""),
        (0, CHECKS.over_pad_time_max_s + 0.1, IN, STAYED),
        (0, CHECKS.over_pad_time_max_s - 0.1, IN, ""),
    ],
)
def test_leaving_the_cone_again_and_again_and_staying_in_it_is_swinging(swings, in_phase_s, e, text):
    began_s = NOW_S - in_phase_s
    memory = Memory(phase=Phase.LAND, swings=swings, phase_since_s=began_s, started_s=began_s)
    assert ("CHECK_FAILED" in names(tick(e=e, memory=memory))) is bool(text)
    mission = mission_of(ROBUST)
    mission.memory = memory
    assert conditions.check_fails(mission, NOWHERE, NOW_S, e is IN, True) is bool(text)
    assert mission.failure.endswith(text)
    assert "CHECK_FAILED" not in names(tick(PAPER, e=e, memory=memory))  # the paper's filter has no such rule
    memory.phase = Phase.APPROACH
    assert "CHECK_FAILED" not in names(tick(e=e, memory=memory))


def test_a_check_needs_only_its_test_and_its_text(monkeypatch):
    def near(s, at, now_s, over_pad, permitted):
        d_m, least_m = at.d_m, 0.5
        return d_m < least_m and s.fail("too near", "{:.1f} m from it; {:g} m are allowed", d_m, least_m)

    monkeypatch.setattr(conditions, "check_fails", near)
    world = World(config())
    world.run(30.0, until=lambda w: w.phase is Phase.ABORT)
    assert world.phase is Phase.ABORT
    assert world.controller.memory.reason == "too near: 0.5 m from it; 0.5 m are allowed"

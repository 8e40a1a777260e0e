"""Over a fast target the vehicle waits for a slower one, higher and for a limited time."""

import pytest

from flightstack.core.memory import Memory
from flightstack.core.mission.phases import Condition
from flightstack.core.types import Phase
from tests.point_mass import World
from tests.unit.core.core_helpers import config
from tests.unit.core.mission.mission_helpers import tick

CALM = config(
    touchdown={"calm_wait_s": 12.0, "calm_speed_m_s": 0.05, "calm_height_m": 0.3}
)  # the robot: 0.1 m/s


def touches_s(settings):
    """Time from the landing's begin to the commit, and the lowest height over the pad before it."""
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


def test_while_it_waits_for_a_slower_target_it_stays_high():
    world = World(CALM)
    world.run(30.0, until=lambda w: w.controller.memory.started_s < w.t_s - 11.5)
    heights_m = [o.snapshot.e_m[2] for o in world.outputs if o.phase is Phase.LAND]
    assert min(heights_m) == pytest.approx(0.3, abs=0.03)


def test_a_slow_target_is_not_waited_for():
    slow = config(touchdown={"calm_wait_s": 12.0, "calm_speed_m_s": 0.2, "calm_height_m": 0.3})
    assert touches_s(slow) == touches_s(config())


@pytest.mark.parametrize(("height_m", "waits"), [(0.02, False), (0.1, True)])
def test_a_vehicle_that_is_on_the_pad_already_stays_there(height_m, waits):
    at = tick(CALM, (0.0, 0.0, height_m), target_velocity=(0.1, 0.0, 0.0), velocity=(0.1, 0.0, 0.0))
    assert bool(at & Condition.TOUCH) is not waits


def goes_around(height_m=0.6, speed_m_s=0.1, **memory):
    """Whether the descent over the middle of a target is broken off."""
    moving = (speed_m_s, 0.0, 0.0)
    at = tick(
        CALM, (0.0, 0.0, height_m), target_velocity=moving, velocity=moving,
        memory=Memory(phase=Phase.TOUCHDOWN, **memory),
    )  # fmt: skip
    return bool(at & Condition.DRIFTED)


def test_a_target_that_sets_off_during_the_descent_is_gone_around_from_while_there_is_height():
    left_m = CALM.retreat.h_left_m
    assert goes_around(left_m + 1e-6)
    assert not goes_around(left_m - 1e-6)
    assert not goes_around(speed_m_s=0.04)
    assert not goes_around(contact=True)
    assert goes_around(retries=CALM.checks.retries_max - 1)
    assert not goes_around(retries=CALM.checks.retries_max)
    assert not goes_around(started_s=-CALM.touchdown.calm_wait_s)

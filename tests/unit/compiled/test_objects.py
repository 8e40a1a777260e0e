"""Tests objects in compiled code: their fields, their methods, and the cases that Python computes instead."""

from copy import deepcopy
from dataclasses import fields

import pytest

from flightstack.compiled.jit import is_off, jitted
from flightstack.compiled.objects import Objects
from flightstack.core.controller import Controller
from flightstack.core.numeric import NotOrdinary
from flightstack.core.types import Landed, Mode, TargetSample, VehicleStatus
from tests.point_mass import World
from tests.unit.core.core_helpers import config


@pytest.fixture
def flown():
    world = World(config())
    world.run(2.0)
    return world.controller


def test_the_state_comes_back_as_it_was(flown):
    objects, before = Objects(flown), deepcopy(flown.state)
    assert objects.write()
    flown.restore(Controller(config()).state)
    assert flown.state != before
    objects.read()
    flown.memory.reason, flown.track.memory.refusal = before.memory.reason, before.track.refusal
    assert repr(flown.state) == repr(before)
    assert all(
        type(getattr(flown.memory, f.name)) is type(getattr(before.memory, f.name))
        for f in fields(before.memory)
    )


@pytest.mark.parametrize("lacks", ["yaw_rad", "target_position_enu_m"])
def test_a_state_that_lacks_something_is_pythons(flown, lacks):
    setattr(flown.memory, lacks, None)
    assert not Objects(flown).write()


def test_a_state_with_something_that_compiled_code_does_not_know_is_pythons(flown):
    status = VehicleStatus(0.0, True, Mode.EXTERNAL, Landed.IN_AIR, True)
    assert flown.ordinary(status)
    flown.track.memory.elsewhere = flown.track.memory.last
    assert not flown.ordinary(status)


def take(kernel, later_s, x_m):
    """Pass the newest target sample again to the kernel, ``later_s`` later and moved along x by ``x_m``."""
    last = kernel.track.newest
    x, y, z = last.position_enu_m
    kernel.take(
        TargetSample(
            last.arrival_s + later_s, last.source_time_s + later_s, last.frame_id, last.child_frame_id,
            (x + x_m, y, z), last.velocity_enu_m_s, last.yaw_rad, 0.0, 0.0, 0.0,
        )
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.skipif(is_off(), reason="nothing is compiled")
def test_compiled_methods_change_the_same_state_and_leave_rare_things_to_python(flown):
    other = Controller(config())
    other.restore(deepcopy(flown.state))
    objects = Objects(flown)
    assert objects.write()
    jitted(take)(objects, 0.02, 0.001)
    objects.read()
    take(other, 0.02, 0.001)
    assert repr(flown.state) == repr(other.state)
    with pytest.raises(NotOrdinary):  # the target jumps, so Python must compute this tick
        jitted(take)(objects, 0.02, 5.0)

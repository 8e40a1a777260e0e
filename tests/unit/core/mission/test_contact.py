"""Tests that contact with the pad is detected, and that the flag of the contact then remains set."""

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from flightstack.core.memory import Memory
from flightstack.core.mission.machine import SLIDING_TIME_S, STANDING_S
from flightstack.core.strategies.packaged.robust import COMMANDED_SHARE, STOPPED_SHARE
from flightstack.core.types import Landed, Phase
from tests.unit.core.mission.mission_helpers import NOW_S, PAPER, ROBUST, names, starting, tick


def test_a_contact_counts_in_the_touchdown_alone():
    for phase in Phase:
        found = names(tick(memory=Memory(phase=phase, contact=True)))
        assert ("ON_PAD" in found) is (phase is Phase.TOUCHDOWN)
    assert "ON_PAD" not in names(tick(memory=Memory(phase=Phase.TOUCHDOWN)))


ON_PAD = (0.02, 0.0, 0.0144)


def contact_after(settings, memory, seconds, **changes):
    """Whether contact is detected within ``seconds``, with a tick every 10 ms."""
    for n in range(round(seconds / 0.01) + 1):
        tick(settings, memory=memory, now_s=NOW_S + 0.01 * n, **changes)
    return memory.contact


@pytest.mark.parametrize("settings", [PAPER, ROBUST])
def test_contact_is_standing_there_for_a_while_or_saying_so(settings):
    def down(**changes):
        return Memory(phase=Phase.TOUCHDOWN, **changes)

    assert contact_after(settings, down(), 0.0, e=ON_PAD, landed=Landed.ON_GROUND)
    contact = settings.contact
    assert not contact_after(settings, down(), contact.time_s - 0.02, e=ON_PAD)
    assert contact_after(settings, down(), contact.time_s + 0.01, e=ON_PAD)
    high = (*ON_PAD[:2], settings.touchdown.feet_below_reference_m + contact.gap_m + 1e-6)
    assert not contact_after(settings, down(), 1.0, e=high)
    assert not contact_after(settings, down(), 1.0, e=(settings.touchdown.pad_radius_m + 1e-6, 0.0, 0.0144))
    fast = (0.0, 0.0, -1.01 * contact.speed_m_s)
    assert not contact_after(settings, down(), 1.0, e=ON_PAD, velocity=fast, landed=Landed.ON_GROUND)
    assert not contact_after(
        settings, down(), 1.0, e=ON_PAD, target_velocity=(0.0, 0.0, 1.01 * contact.speed_m_s)
    )
    assert contact_after(settings, down(), 1.0, e=ON_PAD, velocity=tuple(0.9 * v for v in fast))
    assert contact_after(settings, down(contact=True), 0.0, e=(2.0, 0.0, 2.0))  # contact remains detected


@pytest.mark.parametrize("settings", [PAPER, starting("paper", touchdown={"rule": "paper"})])
def test_what_stands_on_the_pad_below_the_cone_has_landed(settings):
    below = (0.06, 0.0, ON_PAD[2])  # h < 0, so the paper's touchdown rule is never fulfilled
    memory = Memory(phase=Phase.LAND)
    assert "TOUCH" not in names(tick(settings, memory=memory, e=below))
    assert not contact_after(settings, memory, STANDING_S - 0.02, e=below, landed=Landed.ON_GROUND)
    assert contact_after(settings, memory, STANDING_S + 0.01, e=below)
    assert "TOUCH" in names(tick(settings, memory=memory, e=below, now_s=NOW_S + STANDING_S + 0.1))
    assert not contact_after(settings, Memory(phase=Phase.LAND), 5.0, e=(0.12, 0.0, ON_PAD[2]))
    assert not contact_after(settings, Memory(phase=Phase.APPROACH), 5.0, e=below, landed=Landed.ON_GROUND)


def test_a_descent_that_stopped_low_over_the_pad_is_contact():
    r, stopped_s = ROBUST.robust, ROBUST.contact.stopped_time_s
    told = (0.0, 0.0, -1.01 * COMMANDED_SHARE * r.descent_m_s)
    slow = (0.0, 0.0, -0.99 * STOPPED_SHARE * r.descent_m_s)
    low = (0.02, 0.0, 0.9 * r.touch_height_m)

    def found(seconds, command=told, **changes):
        changes = {"e": low, "velocity": slow, **changes}
        return contact_after(ROBUST, Memory(phase=Phase.TOUCHDOWN, command=command), seconds, **changes)

    assert found(stopped_s + 0.01)
    assert not found(stopped_s - 0.02)
    assert not found(1.0, command=tuple(0.98 * v for v in told))
    assert not found(1.0, velocity=tuple(1.02 * v for v in slow))
    assert not found(1.0, e=(*low[:2], 1.01 * r.touch_height_m))
    assert not found(1.0, e=(0.0, 1.01 * ROBUST.touchdown.pad_radius_m, low[2]))
    # commanded and measured velocities are compared relative to the pad
    rising = (0.0, 0.0, 0.3)
    assert found(
        0.05, command=(0.0, 0.0, told[2] + 0.3), velocity=(0.0, 0.0, slow[2] + 0.3), target_velocity=rising
    )
    assert not found(1.0, target_velocity=(0.0, 0.0, -0.3))
    memory = Memory(phase=Phase.TOUCHDOWN, command=told)
    assert not contact_after(PAPER, memory, 1.0, e=low, velocity=slow)


@given(
    st.floats(0.0, 0.12),
    st.floats(0.0, 0.5),
    st.floats(-0.02, 0.05),
    st.floats(-3.1, 3.1),
    st.sampled_from([0.0, 0.012]),
)
def test_a_vehicle_that_slides_is_in_contact_at_once(d_m, slip_m_s, gap_m, heading, sliding_gap_m):
    settings = starting(contact={"sliding_gap_m": sliding_gap_m})
    velocity = (slip_m_s * math.cos(heading) + 0.2, slip_m_s * math.sin(heading), -0.3)
    moves = {"velocity": velocity, "target_velocity": (0.2, 0.0, 0.0)}
    e = (0.0, d_m, settings.touchdown.feet_below_reference_m + gap_m)
    memory = Memory(phase=Phase.TOUCHDOWN)
    tick(settings, e=e, memory=memory, **moves)
    soon_m = d_m + SLIDING_TIME_S * slip_m_s
    assume(abs(soon_m - settings.contact.sliding_radius_m) > 1e-9 and abs(gap_m - sliding_gap_m) > 1e-9)
    assume(abs(d_m - settings.touchdown.pad_radius_m) > 1e-9)
    on_pad = d_m < settings.touchdown.pad_radius_m
    slides = soon_m > settings.contact.sliding_radius_m
    assert memory.contact is (on_pad and slides and sliding_gap_m > max(0.0, gap_m))


def test_a_target_out_of_sight_in_the_last_centimetres():
    r = ROBUST.robust
    gone = {"target_age_s": 9.0, "e": (0.02, 0.0, 0.9 * r.touch_height_m)}
    told = (0.0, 0.0, -r.descent_m_s)
    for settings in (PAPER, ROBUST):
        memory = Memory(phase=Phase.TOUCHDOWN)
        assert not contact_after(settings, memory, 1.0, **gone)
        assert contact_after(settings, memory, 0.0, landed=Landed.ON_GROUND, **gone)
        assert not contact_after(settings, Memory(phase=Phase.LAND), 1.0, landed=Landed.ON_GROUND, **gone)
    stopped_s = ROBUST.contact.stopped_time_s
    assert contact_after(ROBUST, Memory(phase=Phase.TOUCHDOWN, command=told), stopped_s + 0.01, **gone)
    assert not contact_after(PAPER, Memory(phase=Phase.TOUCHDOWN, command=told), 1.0, **gone)
    high = {**gone, "e": (0.02, 0.0, 1.1 * r.touch_height_m)}
    assert not contact_after(ROBUST, Memory(phase=Phase.TOUCHDOWN, command=told), 1.0, **high)
    blind = {**gone, "own_age_s": 9.0}
    assert not contact_after(ROBUST, Memory(phase=Phase.TOUCHDOWN, command=told), 1.0, **blind)

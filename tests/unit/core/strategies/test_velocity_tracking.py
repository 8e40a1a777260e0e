"""Tests lag compensation and velocity feedback of the set-point, on a plant that deviates from the model."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.core.parameters.robust import VelocityFeedback
from flightstack.core.strategies.velocity_tracking import VelocityTracking
from flightstack.core.types import ZERO
from tests.examples import examples
from tests.unit.core.strategies.loop_helpers import AXES, LOOP, T_S, WIDE, Plant, constant, flown

FEEDBACK = VelocityFeedback(horizontal=True)
EAGER = replace(LOOP, slope_time_s=0.04)
pushes = st.tuples(*(st.floats(-0.25, 0.25),) * 3)
wanted = st.tuples(*(st.floats(-0.3, 0.3),) * 3)


def lead(delay_s=0.0):
    del delay_s
    return VelocityTracking(LOOP, T_S)


def fed_back(delay_s=0.0, loop=EAGER):
    return VelocityTracking(loop, T_S, FEEDBACK, delay_s)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("made", "rates", "dampings"),
    [(lead, st.floats(0.7, 1.3), st.floats(0.7, 1.3)), (fed_back, st.floats(0.77, 1.42), st.just(1.0))],
)
def test_a_vehicle_that_answers_otherwise_than_modelled_still_flies_what_is_wanted(made, rates, dampings):
    """Despite model errors and a constant push, the velocity converges to the reference."""

    @given(wanted, rates, dampings, pushes)
    @examples(40)
    def flies(reference, rate, damping, push):
        plant = Plant(rate=rate, damping=damping, push=push)
        tracking, setpoints, velocities = flown(constant(reference), plant, made())
        assert np.abs(velocities[-100:] - reference).max() < 1e-3
        assert np.abs(velocities).max() < 1.5
        assert np.abs(np.diff(setpoints[-100:], axis=0)).max() < 1e-4
        assert tracking.memory.disturbance_m_s == pytest.approx(push, abs=1e-3)

    flies()


@pytest.mark.parametrize("made", [lead, fed_back])
@given(
    ticks=st.lists(
        st.tuples(wanted, wanted, st.tuples(*(st.floats(-50.0, 50.0),) * 3)), min_size=1, max_size=30
    ),
    most=st.tuples(*(st.floats(0.05, 5.0),) * 3),
)
def test_the_limits_hold_whatever_is_measured(made, ticks, most):
    tracking = made(delay_s=0.03)
    for n, (before, reference, velocity) in enumerate(ticks):
        tracking.observe(velocity, commanding=n > 0)
        setpoint = tracking.command(before, reference, velocity, most)
        assert all(abs(u) <= m for u, m in zip(setpoint, most, strict=True))
        assert all(abs(d) <= LOOP.disturbance_max_m_s for d in tracking.memory.disturbance_m_s)
        assert tracking.memory.setpoint_m_s == setpoint


@pytest.mark.parametrize("made", [lead, fed_back])
def test_all_of_its_state_is_its_memory(made):
    """A tracker with a copy of the memory returns the same set-points as the original, bit for bit."""
    references = [tuple(0.2 * math.sin(0.02 * n + axis) for axis in AXES) for n in range(200)]
    plant = Plant(push=(0.1, 0.0, 0.0))
    tracking, _, _ = flown(references[:100], plant, made(delay_s=0.03))
    other = made(delay_s=0.03)
    other.memory = replace(tracking.memory)
    for before, reference in itertools.pairwise(references[99:]):
        for either in (tracking, other):
            either.observe(plant.velocity, commanding=True)
            either.command(before, reference, plant.velocity, WIDE)
        assert tracking.memory == other.memory
        plant.fly(tracking.memory.setpoint_m_s)


@pytest.mark.parametrize("period_s", [0.1, 0.02, 0.002])
@given(damping=st.floats(0.1, 2.0), axis=st.sampled_from(AXES), start=st.floats(-1.0, 1.0))
@examples(20)
def test_the_model_is_stable_up_to_the_rate_that_is_allowed_and_not_above(period_s, damping, axis, start):
    def left(share):
        """Return the model velocity after 2000 ticks, m/s; ``share``: model rate divided by its limit."""
        rate = share * replace(LOOP, damping=damping).rate_max_1_s(period_s)
        loop = replace(LOOP, damping=damping, rate_xy_1_s=rate, rate_z_1_s=rate)
        tracking = VelocityTracking(loop, period_s)
        away = [0.0, 0.0, 0.0]
        away[axis] = start
        tracking.memory.model_m_s, tracking.memory.model_m_s2 = tuple(away), (0.1, 0.1, 0.1)
        for _ in range(2000):
            tracking.observe(ZERO, commanding=True)
        return max(map(abs, tracking.memory.model_m_s))

    assert left(0.99) < 1e-3
    assert left(1.01) > 1.0


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_tilt_is_bounded_twice(sign):
    """Two limits bound the set-point: of the acceleration, and of the difference to the velocity."""
    far = (3.0 * sign, 0.0, 0.0)
    wide = replace(EAGER, error_max_m_s=10.0)
    for loop, most in ((wide, 13.0 * 3.0 / LOOP.rate_xy_1_s**2), (replace(EAGER, error_max_m_s=0.3), 0.3)):
        tracking = fed_back(loop=loop)
        tracking.observe(ZERO, commanding=False)
        assert tracking.command(far, far, ZERO, WIDE)[0] == pytest.approx(sign * most)

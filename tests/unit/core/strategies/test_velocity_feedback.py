"""Feedback of the vehicle's whole state against a plant of its own, and against the lead."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flightstack.core.parameters.robust import VelocityFeedback, VelocityLoop
from flightstack.core.strategies.velocity_tracking import VelocityTracking
from flightstack.core.types import ZERO
from tests.unit.core.target.tracking_helpers import AXES, LOOP, T_S, WIDE, Plant, constant, flown

FEEDBACK = VelocityFeedback(horizontal=True)
EAGER = replace(LOOP, slope_time_s=0.04)

spreads = st.floats(0.77, 1.42)
pushes = st.tuples(*(st.floats(-0.25, 0.25),) * 3)
wanted = st.tuples(*(st.floats(-0.3, 0.3),) * 3)


def fed_back(delay_s=0.0, feedback=FEEDBACK, loop=EAGER):
    return VelocityTracking(loop, T_S, feedback, delay_s)


@given(wanted, spreads, pushes)
@settings(max_examples=40)
def test_a_vehicle_that_answers_otherwise_than_modelled_still_flies_what_is_wanted(reference, rate, push):
    tracking, setpoints, velocities = flown(constant(reference), Plant(rate=rate, push=push), fed_back())
    assert np.abs(velocities[-100:] - reference).max() < 1e-3
    assert np.abs(velocities).max() < 1.5
    assert np.abs(np.diff(setpoints[-100:], axis=0)).max() < 1e-4
    # what it learns of a push is the push
    assert tracking.memory.disturbance_m_s == pytest.approx(push, abs=1e-3)


def off_after_a_gust(tracking):
    """Horizontal velocity error summed over a second, after a push that comes at once, and its largest."""
    plant = Plant()
    flown(constant((0.1, 0.0, 0.0), 3.0), plant, tracking)
    plant.push = (0.25, 0.0, 0.0)
    _, _, velocities = flown(constant((0.1, 0.0, 0.0), 1.0), plant, tracking)
    error = np.abs(velocities[:, 0] - 0.1)
    return float(error.sum() * T_S), float(error.max())


def test_a_gust_is_answered_in_half_the_way_of_the_lead():
    hard = replace(LOOP, gain_xy=1.0, disturbance_time_s=0.3)
    way, most = off_after_a_gust(fed_back())
    way_of_lead, most_of_lead = off_after_a_gust(VelocityTracking(hard, T_S))
    assert way < 0.5 * way_of_lead
    assert most < most_of_lead


def test_upwards_it_is_the_lead():
    references = [(0.1, 0.1, 0.2)] * 50 + [(0.1, 0.1, -0.2)] * 50
    push = (0.0, 0.0, 0.1)
    _, setpoints, _ = flown(references, Plant(push=push), fed_back())
    _, of_lead, _ = flown(references, Plant(push=push), VelocityTracking(EAGER, T_S))
    assert [u[2] for u in setpoints] == [u[2] for u in of_lead]
    assert [u[0] for u in setpoints] != [u[0] for u in of_lead]


@given(
    st.lists(st.tuples(wanted, wanted, st.tuples(*(st.floats(-50.0, 50.0),) * 3)), min_size=1, max_size=30),
    st.tuples(*(st.floats(0.05, 5.0),) * 3),
)
def test_the_limits_hold_whatever_is_measured(ticks, most):
    tracking = fed_back(delay_s=0.03)
    for n, (before, reference, velocity) in enumerate(ticks):
        tracking.observe(velocity, commanding=n > 0)
        setpoint = tracking.command(before, reference, velocity, most)
        assert all(abs(u) <= m for u, m in zip(setpoint, most, strict=True))
        assert all(abs(d) <= LOOP.disturbance_max_m_s for d in tracking.memory.disturbance_m_s)


def test_the_set_point_is_that_of_the_formula():
    """u = v + (2 z w a + m (a* - a)) / w^2 with a* = s + l (r - v) - f, the state carried on by the delay."""
    loop = VelocityLoop(rate_xy_1_s=5.0, damping=0.5, slope_time_s=0.04, error_max_m_s=10.0)
    feedback = VelocityFeedback(
        horizontal=True, error_rate_1_s=4.0, tilt_rate_1_s=10.0, acceleration_max_m_s2=20.0
    )
    tracking = VelocityTracking(loop, T_S, feedback, 0.02)
    memory = tracking.memory
    memory.slope_m_s2, memory.model_m_s, memory.model_m_s2 = (1.0, 0.0, 0.0), (0.2, 0.0, 0.0), (0.5, 0.0, 0.0)
    memory.disturbance_m_s = (0.1, 0.0, 0.0)
    found = tracking.command((0.1, 0.0, 0.0), (0.12, 0.0, 0.0), (9.9, 0.0, 0.0), WIDE)[0]
    push = 0.1 * 5.0 / (2.0 * 0.5)
    now = 0.2 + 0.02 * (0.5 + push)
    slope = 1.0 + 0.25 * (0.02 / T_S - 1.0)
    aim = slope + 4.0 * (0.12 - now) - push
    assert found == pytest.approx(now + (2.0 * 0.5 * 5.0 * 0.5 + 10.0 * (aim - 0.5)) / 25.0)
    assert memory.slope_m_s2[0] == pytest.approx(slope)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_tilt_is_bounded_twice(sign):
    """By the acceleration wanted, and by the set-point's distance from the velocity."""
    far = (3.0 * sign, 0.0, 0.0)
    wide = replace(EAGER, error_max_m_s=10.0)
    for loop, most in ((wide, 13.0 * 3.0 / LOOP.rate_xy_1_s**2), (replace(EAGER, error_max_m_s=0.3), 0.3)):
        tracking = fed_back(loop=loop)
        tracking.observe(ZERO, commanding=False)
        assert tracking.command(far, far, ZERO, WIDE)[0] == pytest.approx(sign * most)


def test_while_somebody_else_flies_the_model_follows_and_nothing_is_learned():
    tracking, _, _ = flown(constant((0.2, 0.1, -0.1), 3.0), Plant(push=(0.1, 0.0, -0.1)), fed_back())
    learned = tracking.memory.disturbance_m_s
    tracking.observe((1.0, 0.0, 0.0), commanding=False)
    assert tracking.memory.model_m_s == (1.0, 0.0, 0.0)
    assert tracking.memory.model_m_s2 == tracking.memory.slope_m_s2 == ZERO
    assert tracking.memory.disturbance_m_s == learned


def test_all_of_its_state_is_its_memory():
    """A copy that is given the memory goes on to the last bit."""
    plant = Plant(push=(0.1, 0.0, 0.0))
    tracking, _, _ = flown(constant((0.1, -0.1, 0.0), 1.0), plant, fed_back(delay_s=0.03))
    other = fed_back(delay_s=0.03)
    other.memory = replace(tracking.memory)
    for n in range(100):
        reference = (0.1 + 0.001 * n, -0.1, 0.0)
        for either in (tracking, other):
            either.observe(plant.velocity, commanding=True)
            either.command(reference, reference, plant.velocity, WIDE)
        assert tracking.memory == other.memory
        plant.fly(tracking.memory.setpoint_m_s)


@pytest.mark.parametrize("axis", AXES[:2])
def test_both_horizontal_axes_are_alike(axis):
    reference = [0.0, 0.0, 0.0]
    reference[axis] = 0.2
    _, setpoints, _ = flown(constant(tuple(reference), 2.0), Plant(), fed_back())
    _, other, _ = flown(constant((0.2, 0.0, 0.0), 2.0), Plant(), fed_back())
    assert [u[axis] for u in setpoints] == [u[0] for u in other]

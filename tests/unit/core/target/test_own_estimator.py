"""Tests the estimator of the vehicle state with late positions, wrong velocities and a loop model."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_are

from flightstack.core.memory import OwnMemory
from flightstack.core.parameters.robust import OwnStateLink, VelocityLoop
from flightstack.core.target.own_estimator import (
    PUSH_M_S2,
    PUSH_TIME_S,
    VELOCITY_NOISE_M_S,
    OwnEstimator,
    steady_gains,
)
from flightstack.core.types import ZERO, OwnState
from tests.point_mass import World
from tests.unit.core.core_helpers import config

PERIOD_S = 0.01
LOOP = VelocityLoop(rate_xy_1_s=5.8, damping=0.6)
LINK = OwnStateLink(delay_s=0.02, position_noise_m=0.01, velocity_error_m_s=0.02, velocity_error_time_s=0.7)
QUICK = OwnStateLink(delay_s=0.0, position_noise_m=0.002, velocity_error_m_s=0.05, velocity_error_time_s=0.15)
MOST = (0.7, 0.7, 0.7)


class Vehicle:
    """A vehicle with the modelled velocity loop; the reported state is late and has a velocity error."""

    def __init__(self, error_m_s=(0.0, 0.0, 0.0), delay_ticks=2, rate_1_s=LOOP.rate_xy_1_s):
        self.error_m_s, self.delay, self.rate_1_s = np.array(error_m_s), delay_ticks, rate_1_s
        self.p, self.v, self.a = np.zeros(3), np.zeros(3), np.zeros(3)
        self.tick, self.past = 0, []

    def fly(self, setpoint_m_s):
        w, z = self.rate_1_s, LOOP.damping
        u = np.array(setpoint_m_s)
        a = self.a + PERIOD_S * (w * w * (u - self.v - self.error_m_s) - 2.0 * z * w * self.a)
        self.p = self.p + PERIOD_S * self.v
        self.v = self.v + PERIOD_S * self.a
        self.a = a
        self.tick += 1

    def state(self):
        t = self.tick * PERIOD_S
        self.past.append(OwnState(t, t, tuple(self.p), tuple(self.v + self.error_m_s), 0.0))
        return self.past[max(0, len(self.past) - 1 - self.delay)]


def wanted(t_s):
    return (0.3 * math.sin(2.0 * t_s), 0.2 * math.cos(1.3 * t_s) - 0.2, 0.0)


def follow(vehicle, estimator, seconds, *, lost=()):
    """Fly a varying velocity; return the last estimate. ``lost``: numbers of ticks without a state."""
    found = None
    for k in range(round(seconds / PERIOD_S)):
        own = vehicle.state()
        if k not in lost:
            found = estimator.step(own)
            estimator.to_send(wanted(k * PERIOD_S), MOST)
        vehicle.fly(estimator.memory.sent_m_s)
    return found


def test_gains_are_those_of_the_riccati_equation():
    t, w, two_zw = PERIOD_S, LOOP.rate_xy_1_s, 2.0 * LOOP.damping * LOOP.rate_xy_1_s
    step = np.eye(5) + t * np.array(
        [
            [0, 1, 0, 0, 0],
            [0, 0, 1, 0, 1],
            [0, -w * w, -two_zw, -w * w, 0],
            [0, 0, 0, -1 / LINK.velocity_error_time_s, 0],
            [0, 0, 0, 0, -1 / PUSH_TIME_S],
        ]
    )
    told = np.array([[1.0, 0, 0, 0, 0], [0, 1, 0, 1, 0]])
    noise = np.diag(
        [0, 0, 0, 2 * t * LINK.velocity_error_m_s**2 / LINK.velocity_error_time_s,
         2 * t * PUSH_M_S2**2 / PUSH_TIME_S]
    )  # fmt: skip
    measured = np.diag([LINK.position_noise_m**2, VELOCITY_NOISE_M_S**2])
    p = solve_discrete_are(step.T, told.T, noise, measured)
    expected = p @ told.T @ np.linalg.inv(told @ p @ told.T + measured)
    found = np.array(steady_gains(LOOP, LINK, PERIOD_S)).T
    assert found == pytest.approx(expected, rel=2e-3, abs=2e-4)


@pytest.mark.parametrize("rate_1_s", [0.5 * LOOP.rate_xy_1_s, LOOP.rate_xy_1_s, 4.0 * LOOP.rate_xy_1_s])
def test_without_the_loops_model_an_error_is_learned_whatever_the_loop(rate_1_s):
    error_m_s = (0.08, -0.04, 0.05)
    vehicle = Vehicle(error_m_s, delay_ticks=0, rate_1_s=rate_1_s)
    estimator = OwnEstimator(QUICK, LOOP, PERIOD_S, by_loop=False)
    follow(vehicle, estimator, 3.0)
    memory = estimator.memory
    assert (memory.x[3], memory.y[3], memory.z_error_m_s) == pytest.approx(error_m_s, abs=5e-3)
    assert np.array((memory.x[1], memory.y[1])) == pytest.approx(vehicle.v[:2], abs=0.03)


def test_forgotten_it_believes_the_next_sample():
    vehicle, estimator = Vehicle((0.05, 0.0, 0.02)), OwnEstimator(LINK, LOOP, PERIOD_S, by_loop=True)
    follow(vehicle, estimator, 5.0)
    estimator.forget()
    own = vehicle.state()
    assert estimator.step(own).velocity_enu_m_s == own.velocity_enu_m_s


@given(
    jumps=st.lists(st.tuples(st.floats(-3, 3), st.floats(-3, 3)), min_size=1, max_size=60),
    most=st.floats(0.01, 0.5),
    by_loop=st.booleans(),
)
def test_the_error_learned_is_bounded_whatever_is_told(jumps, most, by_loop):
    link = OwnStateLink(velocity_error_m_s=0.02, velocity_error_max_m_s=most)
    estimator = OwnEstimator(link, LOOP, PERIOD_S, by_loop=by_loop)
    for k, (p, v) in enumerate(jumps):
        estimator.step(OwnState(k * 0.01, k * 0.01, (p, -p, p), (v, p, v), 0.0))
        told = estimator.to_send(ZERO, MOST)
        assert max(map(abs, told)) <= most + 1e-12


def test_a_believed_velocity_needs_no_estimator():
    world = World(config())
    world.step()
    assert world.controller.strategy.own == OwnMemory()

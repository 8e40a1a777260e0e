"""Compares the target's estimator with a matrix Kalman filter, and tests its error estimate."""

import functools
import math
import random
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from flightstack.core.memory import MotionMemory
from flightstack.core.parameters.robust import TargetLink
from flightstack.core.target.estimator import TargetEstimator
from flightstack.core.types import TargetSample

pytestmark = pytest.mark.slow

LINK = TargetLink()
links = st.builds(
    TargetLink,
    delay_s=st.just(0.02),
    position_noise_m=st.floats(1e-3, 0.1),
    velocity_noise_m_s=st.floats(1e-3, 0.3),
    jerk_xy_m_s3_sqrthz=st.floats(0.05, 10.0),
    jerk_z_m_s3_sqrthz=st.floats(0.02, 10.0),
    acceleration_xy_m_s2=st.floats(0.05, 3.0),
    acceleration_z_m_s2=st.floats(0.01, 3.0),
    acceleration_time_s=st.one_of(st.floats(0.05, 2.0), st.floats(2.0, 1000.0)),
)


def assumed(link, axis):
    """Return, for an axis, jerk noise, and initial standard deviation and decay time of the acceleration."""
    if axis == 2:
        return link.jerk_z_m_s3_sqrthz, link.acceleration_z_m_s2, math.inf
    return link.jerk_xy_m_s3_sqrthz, link.acceleration_xy_m_s2, link.acceleration_time_s


@functools.cache
def carried(jerk, fade_s, dt_s):
    """Return transition matrix and noise covariance over ``dt_s`` (Van Loan; noise without decay)."""
    drift, noise = np.diag([1.0, 1.0], 1), np.diag([0.0, 0.0, jerk**2])
    block = expm(np.block([[-drift, noise], [np.zeros((3, 3)), drift.T]]) * dt_s)
    return expm((drift - np.diag([0.0, 0.0, 1.0 / fade_s])) * dt_s), block[3:, 3:].T @ block[:3, 3:]


class ByMatrices:
    """Kalman filter of one axis in matrix form; each update uses position and velocity together."""

    def __init__(self, link, axis):
        self.jerk, self.prior, self.fade_s = assumed(link, axis)
        self.r = np.diag([link.position_noise_m**2, link.velocity_noise_m_s**2])
        self.t, self.x, self.p = None, None, None

    def update(self, t_s, position, velocity):
        z = np.array([position, velocity])
        if self.t is None or not 0.0 < t_s - self.t <= 1.0:
            self.t, self.x = t_s, np.array([position, velocity, 0.0])
            self.p = np.diag([self.r[0, 0], self.r[1, 1], self.prior**2])
            return
        f, q = carried(self.jerk, self.fade_s, t_s - self.t)
        x, p, h = f @ self.x, f @ self.p @ f.T + q, np.eye(2, 3)
        k = p @ h.T @ np.linalg.inv(h @ p @ h.T + self.r)
        rest = np.eye(3) - k @ h
        self.t, self.x, self.p = t_s, x + k @ (z - h @ x), rest @ p @ rest.T + k @ self.r @ k.T

    def at(self, t_s):
        f, _ = carried(self.jerk, self.fade_s, t_s - self.t)
        f_ahead, q_ahead = carried(self.jerk, self.fade_s, max(0.0, t_s - self.t))
        return f @ self.x, f_ahead @ self.p @ f_ahead.T + q_ahead


ROWS, COLUMNS = np.triu_indices(3)  # elements of a stored covariance in order: pp, pv, pa, vv, va, aa


def covariance(estimator, axis):
    """Return the covariance of one axis as a matrix."""
    memory, found = estimator.memory, np.empty((3, 3))
    found[ROWS, COLUMNS] = found[COLUMNS, ROWS] = memory.covariance_z if axis == 2 else memory.covariance_xy
    return found


def assert_same(estimator, references, ahead_s):
    memory = estimator.memory
    motion = estimator.at(memory.time_s + ahead_s)
    for axis, reference in enumerate(references):
        found = [
            vector[axis]
            for vector in (memory.position_enu_m, memory.velocity_enu_m_s, memory.acceleration_enu_m_s2)
        ]
        assert np.allclose(found, reference.x, rtol=1e-6, atol=1e-7)
        sigma = np.sqrt(np.diag(reference.p))
        scale = np.outer(sigma, sigma)
        assert np.allclose(covariance(estimator, axis) / scale, reference.p / scale, atol=1e-6)
        x, p = reference.at(reference.t + ahead_s)
        found = [vector[axis] for vector in (motion.position_enu_m, motion.velocity_enu_m_s)]
        assert np.allclose(found, x[:2], rtol=1e-6, atol=1e-7)
        if axis == 2:
            assert motion.position_sigma_z_m == pytest.approx(math.sqrt(p[0, 0]), rel=1e-6)
        else:
            assert motion.position_sigma_m == pytest.approx(math.sqrt(p[0, 0]), rel=1e-6)
            assert motion.velocity_sigma_m_s == pytest.approx(math.sqrt(p[1, 1]), rel=1e-6)


steps = st.one_of(
    st.floats(1e-3, 0.3), st.floats(0.3, 1.0), st.just(1.0), st.floats(1.0, 5.0), st.floats(-3.0, 0.0)
)
vectors = st.tuples(*(st.floats(-2.0, 2.0),) * 3)


@given(links, st.lists(st.tuples(steps, vectors, vectors), min_size=1, max_size=25), st.floats(-0.1, 0.5))
def test_it_is_the_text_book_filter_at_any_times(link, samples, ahead_s):
    estimator, references = TargetEstimator(link), [ByMatrices(link, axis) for axis in range(3)]
    t_s = 1e3
    for step_s, position, velocity in samples:
        t_s += step_s
        estimator.update(t_s, position, velocity)
        for axis, reference in enumerate(references):
            reference.update(t_s, position[axis], velocity[axis])
        assert_same(estimator, references, ahead_s)


def circle(t_s, radius_m=0.5, speed_m_s=0.3):
    w = speed_m_s / radius_m
    c, s = math.cos(w * t_s), math.sin(w * t_s)
    return (radius_m * c, radius_m * s, 0.2), (-speed_m_s * s, speed_m_s * c, 0.0)


def test_without_a_sample_there_is_no_motion():
    with pytest.raises(ValueError, match="no target sample yet"):
        TargetEstimator(LINK).at(0.0)
    assert math.isnan(MotionMemory().time_s)


def sample(t_s, **changes):
    position, velocity = circle(t_s)
    made = TargetSample(t_s, 1000.0 + t_s, "map", "target", position, velocity, 0.0, 0.0)
    return made._replace(**changes)


def fed(link, said=(0.0, 0.0), count=60):
    estimator, chance = TargetEstimator(link), random.Random(8)
    for n in range(count):
        position, velocity = circle(0.02 * n)
        noisy = tuple(a + chance.gauss(0.0, 0.02) for a in position)
        estimator.update(0.02 * n, noisy, velocity, math.nan, *said)
    return estimator


@given(st.floats(0.0, 0.2), st.floats(0.0, 1.0))
def test_a_sender_that_says_it_is_worse_is_believed_and_one_that_is_better_is_not(position_m, velocity_m_s):
    """In x and y a reported deviation above the configured deviation is used; in z none is used."""
    found = fed(LINK, (position_m, velocity_m_s))
    noise = {
        "position_noise_m": max(position_m, LINK.position_noise_m),
        "velocity_noise_m_s": max(velocity_m_s, LINK.velocity_noise_m_s),
    }
    configured = fed(replace(LINK, **noise))
    assert found.memory.covariance_xy == pytest.approx(configured.memory.covariance_xy, rel=1e-12)
    assert found.memory.position_enu_m[:2] == pytest.approx(configured.memory.position_enu_m[:2], abs=1e-12)
    assert found.memory.covariance_z == fed(LINK).memory.covariance_z
    assert found.at(1.3).position_sigma_m >= fed(LINK).at(1.3).position_sigma_m

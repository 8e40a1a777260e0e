"""The target's estimator compared with a matrix Kalman filter, and its own error estimate."""

import functools
import itertools
import math
import random
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from flightstack.common.strict_toml import from_table
from flightstack.core.controller import Controller
from flightstack.core.memory import MotionMemory
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.parameters.robust import TargetLink
from flightstack.core.target.estimator import RESTART_S, TargetEstimator
from flightstack.core.types import Inputs, TargetSample

pytestmark = pytest.mark.slow

LINK = TargetLink()
ORIGIN = (0.0, 0.0, 0.0)
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
    """Jerk, initial acceleration and its decay time for one axis."""
    if axis == 2:
        return link.jerk_z_m_s3_sqrthz, link.acceleration_z_m_s2, math.inf
    return link.jerk_xy_m_s3_sqrthz, link.acceleration_xy_m_s2, link.acceleration_time_s


@functools.cache
def carried(jerk, fade_s, dt_s):
    """Return transition and noise over a time by matrix exponential (Van Loan), noise without decay."""
    drift, noise = np.diag([1.0, 1.0], 1), np.diag([0.0, 0.0, jerk**2])
    block = expm(np.block([[-drift, noise], [np.zeros((3, 3)), drift.T]]) * dt_s)
    return expm((drift - np.diag([0.0, 0.0, 1.0 / fade_s])) * dt_s), block[3:, 3:].T @ block[:3, 3:]


class ByMatrices:
    """Textbook filter of one axis, with both measurements in one update."""

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


ROWS, COLUMNS = np.triu_indices(3)  # the order of a stored covariance: pp, pv, pa, vv, va, aa


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
        found = [
            vector[axis]
            for vector in (motion.position_enu_m, motion.velocity_enu_m_s, motion.acceleration_enu_m_s2)
        ]
        assert np.allclose(found, x, rtol=1e-6, atol=1e-7)
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


def driven(chance, link, times_s):
    """Return a motion from the filter's model: lists of (t, state by axis, measurement)."""
    state = np.array([[0.0, 0.0, chance.gauss(0.0, assumed(link, axis)[1])] for axis in range(3)])
    before_s, found = times_s[0], []
    for t_s in times_s:
        if t_s > before_s:
            state = state.copy()
            for axis in range(3):
                jerk, _, fade_s = assumed(link, axis)
                f, q = carried(jerk, fade_s, round(t_s - before_s, 6))
                noise = [chance.gauss(0.0, 1.0) for _ in range(3)]
                state[axis] = f @ state[axis] + np.linalg.cholesky(q) @ noise
        before_s = t_s
        measured = [
            tuple(x + chance.gauss(0.0, s) for x in state[:, n])
            for n, s in enumerate((link.position_noise_m, link.velocity_noise_m_s))
        ]
        found.append((t_s, state, measured))
    return found


def test_its_error_is_as_large_as_it_says():
    """The normalised estimation error squared of three states per axis is 3 on average if consistent."""
    chance, errors, ahead = random.Random(4), [], []
    for _ in range(100):
        estimator = TargetEstimator(LINK)
        times_s, t_s = [], 0.0
        for _ in range(40):
            t_s += chance.choice((0.02, 0.033, 0.05, 0.2))  # some samples are lost
            times_s.append(t_s)
        *past, (at_s, later, _) = driven(chance, LINK, times_s)
        for t_s, _, measured in past:
            estimator.update(t_s, *measured)
        memory, (_, state, _) = estimator.memory, past[-1]
        found = np.array([memory.position_enu_m, memory.velocity_enu_m_s, memory.acceleration_enu_m_s2]).T
        for axis in range(3):
            miss = found[axis] - state[axis]
            errors.append(float(miss @ np.linalg.solve(covariance(estimator, axis), miss)))
        motion = estimator.at(at_s)
        ahead += [(motion.position_enu_m[axis] - later[axis, 0]) / motion.position_sigma_m for axis in (0, 1)]
    assert np.mean(errors) == pytest.approx(3.0, abs=4.0 * math.sqrt(6.0 / len(errors)))  # 4 standard errors
    assert np.mean(np.square(ahead)) == pytest.approx(1.0, abs=4.0 * math.sqrt(2.0 / len(ahead)))
    assert abs(np.mean(ahead)) < 4.0 / math.sqrt(len(ahead))


def circle(t_s, radius_m=0.5, speed_m_s=0.3):
    w = speed_m_s / radius_m
    c, s = math.cos(w * t_s), math.sin(w * t_s)
    return (radius_m * c, radius_m * s, 0.2), (-speed_m_s * s, speed_m_s * c, 0.0)


def stop_and_go(t_s, speed_m_s=0.2):
    """Reverse with a period of 4 s and 0.5 m/s2."""
    ramp = min(1.0, max(-1.0, (abs(t_s % 4.0 - 2.0) - 1.0) / 0.4))
    return ramp * speed_m_s


def test_on_motions_that_it_does_not_know_it_is_no_worse_than_it_says():
    chance, inside, total = random.Random(5), 0, 0
    for _ in range(8):
        estimator, x = TargetEstimator(LINK), 0.0
        for n in range(400):
            t_s = 0.02 * n
            v = stop_and_go(t_s)
            x += 0.02 * v
            (cx, cy, cz), (vx, vy, vz) = circle(t_s)
            truth = (cx + x, cy, cz)
            moved = tuple(a + chance.gauss(0.0, LINK.position_noise_m) for a in truth)
            speed = tuple(a + chance.gauss(0.0, LINK.velocity_noise_m_s) for a in (vx + v, vy, vz))
            if n % 10 < 9:  # one of ten is lost
                estimator.update(t_s, moved, speed)
            if n > 20:
                motion = estimator.at(t_s)
                inside += (
                    math.dist(motion.position_enu_m, truth) < 3.0 * math.sqrt(3.0) * motion.position_sigma_m
                )
                total += 1
    assert inside / total > 0.99


@pytest.mark.parametrize(
    "link", [LINK, replace(LINK, jerk_xy_m_s3_sqrthz=6.0), replace(LINK, position_noise_m=0.02)]
)
def test_what_is_older_is_less_certain(link):
    estimator = TargetEstimator(link)
    for n in range(50):
        estimator.update(0.05 * n, ORIGIN, ORIGIN)
    motions = [estimator.at(estimator.memory.time_s + 0.01 * n) for n in range(300)]
    for sooner, later in itertools.pairwise(motions):
        assert later.position_sigma_m > sooner.position_sigma_m
        assert later.position_sigma_z_m > sooner.position_sigma_z_m
        assert later.velocity_sigma_m_s > sooner.velocity_sigma_m_s


def test_before_the_newest_sample_it_is_as_certain_as_at_it():
    estimator = TargetEstimator(LINK)
    estimator.update(5.0, (1.0, 2.0, 3.0), (0.1, -0.2, 0.3))
    motion = estimator.at(4.9)
    assert motion.position_enu_m == pytest.approx((0.99, 2.02, 2.97))
    assert motion.position_sigma_m == estimator.at(5.0).position_sigma_m == LINK.position_noise_m
    assert motion.velocity_sigma_m_s == LINK.velocity_noise_m_s


@pytest.mark.parametrize("gap_s", [RESTART_S + 1e-6, 30.0, 0.0, -0.01, -1e6])
def test_after_a_gap_or_backwards_it_starts_anew(gap_s):
    estimator, fresh = TargetEstimator(LINK), TargetEstimator(LINK)
    for n in range(20):
        estimator.update(7.0 + 0.05 * n, *circle(0.05 * n))
    at_s = estimator.memory.time_s + gap_s
    for either in (estimator, fresh):
        either.update(at_s, (5.0, 6.0, 7.0), (0.1, 0.2, 0.3))
    assert estimator.memory == fresh.memory
    assert estimator.memory.acceleration_enu_m_s2 == ORIGIN
    for axis in range(3):
        expected = (LINK.position_noise_m, LINK.velocity_noise_m_s, assumed(LINK, axis)[1])
        assert np.array_equal(covariance(estimator, axis), np.diag([sigma**2 for sigma in expected]))


def test_a_gap_up_to_the_limit_goes_on():
    estimator = TargetEstimator(LINK)
    estimator.update(1.0, ORIGIN, ORIGIN)
    estimator.update(1.0 + RESTART_S, (0.001, 0.0, 0.0), ORIGIN)
    assert 0.0 < estimator.memory.position_enu_m[0] < 0.001


def test_without_a_sample_there_is_no_motion():
    with pytest.raises(ValueError, match="no target sample yet"):
        TargetEstimator(LINK).at(0.0)
    assert math.isnan(MotionMemory().time_s)


def sample(t_s, **changes):
    position, velocity = circle(t_s)
    made = TargetSample(t_s, 1000.0 + t_s, "map", "target", position, velocity, 0.0, 0.0)
    return made._replace(**changes)


@pytest.mark.parametrize(
    "changes",
    [
        {"source_time_s": 1000.5},  # out of order
        {"source_time_s": 1000.95},  # repeated
        {"source_time_s": 1000.96, "arrival_s": 1.6},  # too late
        {"position_enu_m": (math.nan, 0.0, 0.0)},
        {"velocity_enu_m_s": (2.0, 0.0, 0.0)},  # faster than allowed
        {"position_enu_m": (3.0, 3.0, 0.2)},  # jumped
        {"child_frame_id": "other"},
    ],
)
def test_a_sample_that_is_not_believed_changes_nothing(changes):
    config = from_table(FlightConfig, {"barrier": {"alpha_1_m": 1.0, "beta_m": 1.5}})
    controller = Controller(config)
    for n in range(20):
        controller.step(Inputs(target_samples=(sample(0.05 * n),)), 0.05 * n)
    before = replace(controller.state.motion)
    assert before.time_s == 1000.95
    controller.step(Inputs(target_samples=(sample(1.0, **changes),)), 1.0)
    assert controller.state.motion == before
    controller.step(Inputs(target_samples=(sample(1.0),)), 1.0)
    assert controller.state.motion.time_s == 1001.0


def fed(link, said=(0.0, 0.0), count=60):
    estimator, chance = TargetEstimator(link), random.Random(8)
    for n in range(count):
        position, velocity = circle(0.02 * n)
        noisy = tuple(a + chance.gauss(0.0, 0.02) for a in position)
        estimator.update(0.02 * n, noisy, velocity, math.nan, *said)
    return estimator


@given(st.floats(0.0, 0.2), st.floats(0.0, 1.0))
def test_a_sender_that_says_it_is_worse_is_believed_and_one_that_is_better_is_not(position_m, velocity_m_s):
    """Velocity checks apply to x and y; robots on wheels may report any vertical velocity."""
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

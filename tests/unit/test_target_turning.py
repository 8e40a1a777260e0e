"""The estimator and targets that do not drive straight: its acceleration turns, its jerk grows."""

import math
import random
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.target_estimator import TargetEstimator
from flightstack.types import ZERO
from tests.unit.test_target_estimator import LINK, circle, vectors


def bend(t_s, speed_m_s, turn_rate_rad_s):
    """A robot that drives in a circle: position and velocity."""
    turned, radius = turn_rate_rad_s * t_s, speed_m_s / turn_rate_rad_s
    sin, cos = math.sin(turned), math.cos(turned)
    return (radius * sin, -radius * cos, 0.0), (speed_m_s * cos, speed_m_s * sin, 0.0)


@given(st.floats(0.2, 1.0), st.floats(0.2, 0.8), st.sampled_from([-1.0, 1.0]), st.floats(0.0, 0.4))
def test_a_steady_bend_is_followed_without_an_error_that_stays(speed_m_s, rate_rad_s, side, ahead_s):
    """However little jerk it believes in; without the yaw rate it cuts the bend."""
    link = replace(LINK, jerk_xy_m_s3_sqrthz=0.05)
    told, untold = TargetEstimator(link), TargetEstimator(link)
    for n in range(500):
        sample = bend(0.02 * n, speed_m_s, side * rate_rad_s)
        told.update(0.02 * n, *sample, side * rate_rad_s)
        untold.update(0.02 * n, *sample)
    t_s = 0.02 * 499 + ahead_s
    position, velocity = bend(t_s, speed_m_s, side * rate_rad_s)
    missed_m = math.dist(told.at(t_s).position_enu_m, position)
    assert missed_m < 2e-4
    assert math.dist(told.at(t_s).velocity_enu_m_s, velocity) < 2e-3
    assert missed_m < 0.2 * math.dist(untold.at(t_s).position_enu_m, position)


@given(
    st.lists(st.tuples(st.floats(1e-3, 0.9), vectors, vectors, st.floats(-50.0, 50.0)), min_size=2),
    st.floats(0.0, 1.0),
)
def test_no_yaw_rate_makes_the_acceleration_longer(samples, ahead_s):
    estimator, t_s = TargetEstimator(LINK), 0.0
    for step_s, position, velocity, rate_rad_s in samples:
        t_s += step_s
        estimator.update(t_s, position, velocity, rate_rad_s)
    now = estimator.memory.acceleration_enu_m_s2
    ahead = estimator.at(t_s + ahead_s).acceleration_enu_m_s2
    assert math.hypot(*ahead) == pytest.approx(math.hypot(*now), rel=1e-4, abs=1e-12)


STEADY = replace(LINK, jerk_xy_m_s3_sqrthz=0.05)
ROUSED = replace(STEADY, jerk_growth_max=10.0)


def worst_m(link, brakes, seed):
    """Largest miss in the second after two seconds at 0.6 m/s, when it brakes with 1 m/s2 or drives on."""
    chance, estimator = random.Random(seed), TargetEstimator(link)
    worst, x, v = 0.0, 0.0, 0.6
    for n in range(150):
        v = max(0.0, v - 0.02) if brakes and n >= 100 else v
        x += 0.02 * v
        place = (chance.gauss(x, link.position_noise_m), 0.0, 0.0)
        estimator.update(0.02 * n, place, (chance.gauss(v, link.velocity_noise_m_s), 0.0, 0.0))
        if n >= 100:
            worst = max(worst, abs(estimator.at(0.02 * n + 0.1).position_enu_m[0] - x - 0.1 * v))
    return worst


def test_little_jerk_that_may_grow_follows_a_braking_target_and_knows_a_steady_one():
    def mean(link, brakes):
        return np.mean([worst_m(link, brakes, seed) for seed in range(30)])

    assert mean(ROUSED, True) < 0.85 * mean(STEADY, True)
    assert mean(ROUSED, False) < 0.8 * mean(replace(STEADY, jerk_xy_m_s3_sqrthz=0.5), False)


def test_surprise_makes_it_less_sure_up_to_the_bound_and_passes():
    estimator, sigma = TargetEstimator(ROUSED), []
    bound = TargetEstimator(replace(STEADY, jerk_xy_m_s3_sqrthz=0.5))
    for n in range(300):
        x = 0.02 * n * (1.0 if 100 <= n < 150 else 0.0)  # jumps there and back
        estimator.update(0.02 * n, (x, 0.0, 0.0), ZERO)
        bound.update(0.02 * n, (x, 0.0, 0.0), ZERO)
        sigma.append(estimator.at(0.02 * n + 0.2).position_sigma_m)
        assert sigma[-1] <= bound.at(0.02 * n + 0.2).position_sigma_m * (1.0 + 1e-9)
    assert max(sigma[100:200]) > 2.0 * sigma[99]
    assert sigma[-1] == pytest.approx(sigma[99], rel=0.02)


@pytest.mark.parametrize("unknown", [math.nan, math.inf])
def test_a_yaw_rate_that_is_no_number_is_none(unknown):
    without, with_ = TargetEstimator(LINK), TargetEstimator(LINK)
    for n in range(50):
        without.update(0.02 * n, *circle(0.02 * n))
        with_.update(0.02 * n, *circle(0.02 * n), unknown)
    assert with_.memory == without.memory

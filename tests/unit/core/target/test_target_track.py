"""Which target samples are believed."""

import math
import random
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.core.parameters.flight import Checks
from flightstack.core.target.estimator import TURN_RATE_MAX_RAD_S, TargetEstimator
from flightstack.core.target.track import TargetTrack, Verdict
from flightstack.core.types import ZERO, TargetSample
from tests.unit.core.target.test_target_estimator import LINK, circle, vectors


def within(most):
    return st.tuples(*(st.floats(-most, most),) * 3)


FIRST = TargetSample(10.0, 1000.0, "map", "target", (1.0, 2.0, 0.2), (0.1, 0.0, 0.0), 0.0, 0.0)


def later(seconds, **changes):
    moved = (1.0 + 0.1 * seconds, 2.0, 0.2)
    base = {"arrival_s": 10.0 + seconds, "source_time_s": 1000.0 + seconds, "position_enu_m": moved}
    return FIRST._replace(**{**base, **changes})


@pytest.fixture
def track():
    track = TargetTrack(Checks())
    assert track.accept(FIRST) is Verdict.ACCEPTED
    return track


@pytest.mark.parametrize(
    ("sample", "verdict"),
    [
        (later(0.01), Verdict.ACCEPTED),
        (later(0.01, position_enu_m=(math.nan, 2.0, 0.2)), Verdict.NOT_FINITE),
        (later(0.01, velocity_enu_m_s=(math.inf, 0.0, 0.0)), Verdict.NOT_FINITE),
        (later(0.01, child_frame_id="other"), Verdict.WRONG_ROBOT),
        (later(0.01, frame_id="odom"), Verdict.WRONG_ROBOT),
        (later(0.01, source_time_s=1000.0), Verdict.REPEATED),
        (later(0.01, source_time_s=999.9), Verdict.OUT_OF_ORDER),
        (later(0.01, velocity_enu_m_s=(1.6, 0.0, 0.0)), Verdict.TOO_FAST),
        (later(0.01, position_enu_m=(2.001, 2.0, 0.2)), Verdict.JUMP),
        (
            later(0.01, position_enu_m=(1.2009, 2.0, 0.2)),
            Verdict.ACCEPTED,
        ),  # 0.2 m from where it was expected
        (later(0.01, position_enu_m=(1.202, 2.0, 0.2)), Verdict.JUMP),
    ],
)
def test_verdicts(track, sample, verdict):
    assert track.accept(sample) is verdict
    assert (track.accepted, track.rejected) == ((2, 0) if verdict is Verdict.ACCEPTED else (1, 1))


@given(st.floats(0.01, 0.24), within(0.3), within(2.0), within(0.1))
def test_a_robot_that_sets_off_in_a_gap_is_believed(gap_s, before_m_s, acceleration_m_s2, off_m):
    """Velocity and position say the same: it is where they lead, within the bound and the noise."""
    gone = [
        p + v * gap_s + 0.5 * a * gap_s**2 + o
        for p, v, a, o in zip(FIRST.position_enu_m, before_m_s, acceleration_m_s2, off_m, strict=True)
    ]
    then = tuple(v + a * gap_s for v, a in zip(before_m_s, acceleration_m_s2, strict=True))
    track = TargetTrack(Checks())
    track.accept(FIRST._replace(velocity_enu_m_s=before_m_s))
    sample = later(gap_s, position_enu_m=tuple(gone), velocity_enu_m_s=then)
    assert track.accept(sample) is Verdict.ACCEPTED


def test_a_robot_that_jumps_is_refused_whatever_its_velocity_says(track):
    fast = (1.4, 0.0, 0.0)  # of which the mean explains 0.15 m
    assert (
        track.accept(later(0.2, position_enu_m=(1.34, 2.0, 0.2), velocity_enu_m_s=fast)) is Verdict.ACCEPTED
    )
    track = TargetTrack(Checks())
    track.accept(FIRST)
    assert track.accept(later(0.2, position_enu_m=(1.36, 2.0, 0.2), velocity_enu_m_s=fast)) is Verdict.JUMP


def test_of_a_lost_robot_the_velocity_of_now_proves_no_place(track):
    assert track.accept(later(0.2, position_enu_m=(2.0, 2.0, 0.2))) is Verdict.JUMP
    fast = (1.0, 0.0, 0.0)  # the mean of both leads to where it is told to be, 0.9 s after the last one
    there = later(0.9, position_enu_m=(1.495, 2.0, 0.2), velocity_enu_m_s=fast)
    assert track.accept(there) is Verdict.JUMP


def test_a_sample_that_was_long_on_its_way_is_late(track):
    track.accept(later(0.2))
    slow = later(0.21)._replace(arrival_s=10.21 + 0.26)
    assert track.accept(slow) is Verdict.LATE


def test_the_age_counts_from_the_measurement_less_the_shortest_delay(track):
    assert track.at(10.1).age_s == pytest.approx(0.1)
    slow = later(0.1)._replace(arrival_s=10.1 + 0.05)  # 50 ms longer under way than the first
    track.accept(slow)
    assert track.at(10.15).age_s == pytest.approx(0.05)


def test_the_target_is_moved_on_with_its_velocity(track):
    assert track.at(10.1).position_enu_m == pytest.approx((1.01, 2.0, 0.2))


def test_a_lost_track_takes_a_jump_but_no_older_sample(track):
    assert track.accept(later(0.5, position_enu_m=(3.0, 2.0, 0.2))) is Verdict.ACCEPTED
    track = TargetTrack(Checks())
    track.accept(FIRST)
    assert track.accept(later(0.5)._replace(source_time_s=999.0)) is Verdict.OUT_OF_ORDER


def test_a_sender_that_started_anew_is_taken_again(track):
    restarted = later(5.0)._replace(source_time_s=3.0)
    assert track.accept(restarted) is Verdict.ACCEPTED
    assert track.at(15.0).age_s == pytest.approx(0.0)


def test_no_sample_no_target():
    assert TargetTrack(Checks()).at(1.0) is None


def bend(t_s, speed_m_s, turn_rate_rad_s):
    """A robot that drives in a circle: position and velocity."""
    turned, radius = turn_rate_rad_s * t_s, speed_m_s / turn_rate_rad_s
    sin, cos = math.sin(turned), math.cos(turned)
    return (radius * sin, -radius * cos, 0.0), (speed_m_s * cos, speed_m_s * sin, 0.0)


@given(
    st.floats(0.2, 1.0), st.floats(0.2, 0.8), st.sampled_from([-1.0, 1.0]), st.floats(0.0, 0.4),
    st.floats(-math.pi, math.pi),
)  # fmt: skip
def test_a_steady_bend_is_followed_without_an_error_that_stays(speed_m_s, rate, side, ahead_s, yaw_rad):
    """However little jerk it believes in; without the yaw, or told not to mind it, it cuts the bend."""
    link = replace(LINK, jerk_xy_m_s3_sqrthz=0.05)
    told, untold, sideways = (
        TargetEstimator(one) for one in (link, link, replace(link, turns_with_yaw=False))
    )
    for n in range(500):
        sample = bend(0.02 * n, speed_m_s, side * rate)
        yaw = math.remainder(yaw_rad + side * rate * 0.02 * n, math.tau)  # of any place on the robot
        told.update(0.02 * n, *sample, yaw)
        sideways.update(0.02 * n, *sample, yaw)
        untold.update(0.02 * n, *sample)
    t_s = 0.02 * 499 + ahead_s
    position, velocity = bend(t_s, speed_m_s, side * rate)
    missed_m = math.dist(told.at(t_s).position_enu_m, position)
    assert missed_m < 1e-5
    assert math.dist(told.at(t_s).velocity_enu_m_s, velocity) < 1e-4
    assert missed_m < 0.2 * math.dist(untold.at(t_s).position_enu_m, position)
    assert sideways.at(t_s) == untold.at(t_s)


@given(
    st.lists(st.tuples(st.floats(1e-3, 0.9), vectors, vectors, st.floats(-math.pi, math.pi)), min_size=2),
    st.floats(0.0, 1.0),
    st.floats(0.1, 5.0),
)
def test_no_yaw_makes_the_target_faster_and_its_acceleration_fades(samples, ahead_s, fade_s):
    estimator, t_s = TargetEstimator(replace(LINK, acceleration_time_s=fade_s)), 0.0
    for step_s, position, velocity, yaw_rad in samples:
        t_s += step_s
        estimator.update(t_s, position, velocity, yaw_rad)
    memory, ahead = estimator.memory, estimator.at(t_s + ahead_s)
    (vx, vy, vz), (ax, ay, az) = memory.velocity_enu_m_s, memory.acceleration_enu_m_s2
    fx, fy, fz = ahead.acceleration_enu_m_s2
    left = math.exp(-ahead_s / fade_s)
    assert math.hypot(fx, fy) == pytest.approx(left * math.hypot(ax, ay), rel=1e-4, abs=1e-12)
    assert fz == az
    gained_s = fade_s * (1.0 - left)
    speed_m_s = math.hypot(*ahead.velocity_enu_m_s[:2])
    assert speed_m_s == pytest.approx(math.hypot(vx + gained_s * ax, vy + gained_s * ay), rel=1e-4, abs=1e-9)
    assert ahead.velocity_enu_m_s[2] == pytest.approx(vz + ahead_s * az, abs=1e-9)
    assert abs(memory.turn_rate_rad_s) <= TURN_RATE_MAX_RAD_S


@given(vectors, vectors, st.floats(-2.0, 2.0), st.floats(0.01, 0.12), st.floats(0.05, 100.0))
def test_carried_on_twice_is_carried_on_once(position, velocity, rate, step_s, fade_s):
    def started(estimator, position, velocity, acceleration):
        memory = estimator.memory
        memory.time_s, memory.position_enu_m, memory.velocity_enu_m_s = 0.0, position, velocity
        memory.acceleration_enu_m_s2, memory.turn_rate_rad_s = acceleration, rate
        return estimator.at(step_s)

    estimator = TargetEstimator(replace(LINK, acceleration_time_s=fade_s))
    half = started(estimator, position, velocity, (0.7, -0.4, 0.2))
    twice = started(TargetEstimator(replace(LINK, acceleration_time_s=fade_s)), *half[:3])
    started(estimator, position, velocity, (0.7, -0.4, 0.2))
    once = estimator.at(2.0 * step_s)
    assert np.allclose(twice[1:3], once[1:3], rtol=1e-5, atol=1e-5)
    assert np.allclose(twice[0], once[0], rtol=1e-5, atol=4e-3 * step_s)


def test_over_a_gap_a_robot_that_sets_off_is_not_made_faster_than_it_can_be():
    """At 1 m/s2 for 0.8 s, then lost for half a second: it has long stopped to speed up."""
    lasting, fading = (TargetEstimator(replace(LINK, acceleration_time_s=time_s)) for time_s in (1000.0, 0.5))
    for n in range(41):
        t_s = 0.02 * n
        for estimator in (lasting, fading):
            estimator.update(t_s, (0.5 * t_s * t_s, 0.0, 0.0), (t_s, 0.0, 0.0), 0.0)
    too_fast = [one.at(0.8 + 0.58).velocity_enu_m_s[0] - 0.8 for one in (lasting, fading)]
    assert 0.0 < too_fast[1] < 0.7 * too_fast[0]


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
def test_a_yaw_that_is_no_number_turns_nothing(unknown):
    without, with_ = TargetEstimator(LINK), TargetEstimator(LINK)
    for n in range(50):
        without.update(0.02 * n, *circle(0.02 * n))
        with_.update(0.02 * n, *circle(0.02 * n), unknown)
    assert with_.memory.turn_rate_rad_s == 0.0
    assert with_.at(2.0) == without.at(2.0)
    with_.update(1.0, *circle(1.0), 3.0)
    with_.update(1.02, *circle(1.02), -3.2)  # turned by 0.08 rad across the seam
    assert 0.0 < with_.memory.turn_rate_rad_s < TURN_RATE_MAX_RAD_S

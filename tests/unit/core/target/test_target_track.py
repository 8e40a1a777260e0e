"""Which target samples are accepted."""

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
        ),  # 0.2 m from the expected position
        (later(0.01, position_enu_m=(1.202, 2.0, 0.2)), Verdict.JUMP),
    ],
)
def test_verdicts(track, sample, verdict):
    assert track.accept(sample) is verdict
    assert (track.memory.accepted, track.memory.rejected) == (
        (2, 0) if verdict is Verdict.ACCEPTED else (1, 1)
    )


def drives(t_s, stamp_s):
    """Return a robot at 0.1 m/s on a clock that is 1000 s ahead."""
    return TargetSample(
        t_s, 1000.0 + stamp_s, "map", "target", (1.0 + 0.1 * t_s, 0.0, 0.2), (0.1, 0.0, 0.0), 0.0, 0.0
    )


def ticks(since_s, until_s):
    return [since_s + 0.02 * k for k in range(round((until_s - since_s) / 0.02))]


def steady(until_s, settled):
    """Track samples at 50 Hz until this time."""
    track = TargetTrack(Checks(), 0.01)
    track.memory.settled = settled
    for t_s in ticks(0.0, until_s):
        assert track.accept(drives(t_s, t_s)) is Verdict.ACCEPTED
    return track


@given(st.floats(0.01, 0.24), within(0.3), within(2.0), within(0.1))
def test_a_robot_that_sets_off_in_a_gap_is_believed(gap_s, before_m_s, acceleration_m_s2, off_m):
    """Velocity and position agree: the sample is at the predicted position within bound and noise."""
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
    fast = (1.4, 0.0, 0.0)  # the mean explains 0.15 m
    assert (
        track.accept(later(0.2, position_enu_m=(1.34, 2.0, 0.2), velocity_enu_m_s=fast)) is Verdict.ACCEPTED
    )
    track = TargetTrack(Checks())
    track.accept(FIRST)
    assert track.accept(later(0.2, position_enu_m=(1.36, 2.0, 0.2), velocity_enu_m_s=fast)) is Verdict.JUMP


def test_of_a_lost_robot_the_velocity_of_now_proves_no_place(track):
    assert track.accept(later(0.2, position_enu_m=(2.0, 2.0, 0.2))) is Verdict.JUMP
    fast = (1.0, 0.0, 0.0)  # the mean of both predicts the reported position, 0.9 s after the last one
    there = later(0.9, position_enu_m=(1.495, 2.0, 0.2), velocity_enu_m_s=fast)
    assert track.accept(there) is Verdict.JUMP


def test_a_sample_that_was_long_on_its_way_is_late(track):
    track.accept(later(0.2))
    slow = later(0.21)._replace(arrival_s=10.21 + 0.26)
    assert track.accept(slow) is Verdict.LATE


def test_the_age_counts_from_the_measurement_less_the_shortest_delay(track):
    assert track.at(10.1).age_s == pytest.approx(0.1)
    slow = later(0.1)._replace(arrival_s=10.1 + 0.05)  # 50 ms more latency than the first sample
    track.accept(slow)
    assert track.at(10.15).age_s == pytest.approx(0.05)


def test_the_target_is_moved_on_with_its_velocity(track):
    assert track.at(10.1).position_enu_m == pytest.approx((1.01, 2.0, 0.2))


def test_a_lost_track_takes_a_jump_but_no_older_sample(track):
    assert track.accept(later(0.5, position_enu_m=(3.0, 2.0, 0.2))) is Verdict.ACCEPTED
    track = TargetTrack(Checks())
    track.accept(FIRST)
    assert track.accept(later(0.5)._replace(source_time_s=999.0)) is Verdict.OUT_OF_ORDER


@pytest.mark.parametrize("settled", [False, True])
@pytest.mark.parametrize("ahead_s", [0.05, 0.15, 0.3, 60.0, 3600.0, 1e9, 1e300, math.inf, math.nan, -1e9])
def test_one_wrong_stamp_costs_one_sample(ahead_s, settled):
    track = steady(2.0, settled)
    assert track.accept(drives(2.0, 2.0 + ahead_s)) is not Verdict.ACCEPTED
    for k in range(1, 100):
        t_s = 2.0 + 0.02 * k
        assert track.accept(drives(t_s, t_s)) is Verdict.ACCEPTED
        assert track.at(t_s).age_s < 1e-6


@pytest.mark.parametrize("settled", [False, True])
@pytest.mark.parametrize("silent_s", [0.02, 0.4])
@pytest.mark.parametrize("by_s", [-900.0, -9.0, -1.0, -0.3, 0.05, 0.2, 2.0, 3600.0])
def test_a_clock_that_was_set_is_followed_after_samples_that_agree(by_s, silent_s, settled):
    """Until then no sample is fresh; a clock set back during a silence may be a queue."""
    track, proof_s = steady(2.0, settled), Checks().recovery_time_s
    for k in range(200):
        t_s = 2.0 + silent_s + 0.02 * k
        good = track.accept(drives(t_s, t_s + by_s)) is Verdict.ACCEPTED
        if 0.02 * k < proof_s - 1e-9:
            assert not good
            assert track.at(t_s).age_s == pytest.approx(t_s - 1.98)
        elif not -0.4 <= by_s <= -0.3 or silent_s < 0.3:
            assert good or 0.02 * k < proof_s + 0.03
            assert not good or track.at(t_s).age_s < 1e-6


def test_a_queue_that_drains_at_the_start_is_none_a_moment_later():
    """Samples that waited during the start: 600 samples of 12 s in one tick."""
    track = TargetTrack(Checks(), 0.01)
    for stamp_s in ticks(0.0, 12.0):
        moved = drives(stamp_s, stamp_s).position_enu_m
        assert track.accept(drives(12.0, stamp_s)._replace(position_enu_m=moved)) is Verdict.ACCEPTED
    track.memory.settled = True
    for t_s in ticks(12.0, 14.0):
        assert track.accept(drives(t_s, t_s)) is Verdict.ACCEPTED
        assert track.at(t_s).age_s < 0.03


def test_a_clock_and_a_place_that_begin_anew_are_not_followed_in_flight():
    track = steady(2.0, True)
    anew = [drives(t_s, t_s - 2.3)._replace(position_enu_m=(9.0, 0.0, 0.2)) for t_s in ticks(2.3, 10.0)]
    assert {track.accept(sample) for sample in anew} == {Verdict.OUT_OF_ORDER, Verdict.JUMP}


@pytest.mark.parametrize("by_s", [-30.0, -0.15, 0.15, 30.0])
def test_of_two_senders_that_take_turns_one_is_never_believed(by_s):
    track = steady(2.0, True)
    for t_s in ticks(2.0, 20.0):
        assert track.accept(drives(t_s, t_s)) is Verdict.ACCEPTED
        assert track.accept(drives(t_s + 0.01, t_s + 0.01 + by_s)) is not Verdict.ACCEPTED


@pytest.mark.parametrize("rate", [-0.03, -1e-4, 1e-4, 0.03])
def test_a_clock_that_drifts_is_followed(rate):
    track = steady(2.0, True)
    for t_s in ticks(2.0, 120.0):
        assert track.accept(drives(t_s, t_s + rate * (t_s - 2.0))) is Verdict.ACCEPTED
        assert track.at(t_s).age_s < 0.05


def test_a_queue_that_grows_is_seen_as_age_and_is_not_believed_when_it_is_full():
    track = steady(2.0, True)
    for t_s in ticks(2.0, 20.0):
        delay_s = min(3.0, 0.2 * (t_s - 2.0))
        track.accept(drives(t_s, t_s - delay_s))
        assert track.at(t_s).age_s >= min(delay_s - 0.06, 0.7 * delay_s - 0.02)
    assert track.at(20.0).age_s > 3.0
    for t_s in ticks(20.0, 22.0):
        assert track.accept(drives(t_s, t_s)) is Verdict.ACCEPTED  # the queue is empty again


def test_before_the_first_sample_there_is_no_target():
    with pytest.raises(AssertionError):
        TargetTrack(Checks()).at(1.0)


def bend(t_s, speed_m_s, turn_rate_rad_s):
    """Return a robot that drives in a circle: position and velocity."""
    turned, radius = turn_rate_rad_s * t_s, speed_m_s / turn_rate_rad_s
    sin, cos = math.sin(turned), math.cos(turned)
    return (radius * sin, -radius * cos, 0.0), (speed_m_s * cos, speed_m_s * sin, 0.0)


@given(
    st.floats(0.2, 1.0), st.floats(0.2, 0.8), st.sampled_from([-1.0, 1.0]), st.floats(0.0, 0.4),
    st.floats(-math.pi, math.pi),
)  # fmt: skip
def test_a_steady_bend_is_followed_without_an_error_that_stays(speed_m_s, rate, side, ahead_s, yaw_rad):
    """With any assumed jerk the filter follows the bend; without the yaw it cuts the bend."""
    link = replace(LINK, jerk_xy_m_s3_sqrthz=0.05)
    told, untold, sideways = (
        TargetEstimator(one) for one in (link, link, replace(link, turns_with_yaw=False))
    )
    for n in range(500):
        sample = bend(0.02 * n, speed_m_s, side * rate)
        yaw = math.remainder(yaw_rad + side * rate * 0.02 * n, math.tau)  # for any point on the robot
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
    """After 0.8 s at 1 m/s2 and a loss of half a second it has stopped accelerating."""
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
    """Return the largest error in the second after two seconds at 0.6 m/s, with or without braking."""
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
        x = 0.02 * n * (1.0 if 100 <= n < 150 else 0.0)  # a jump and a jump back
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


def test_a_velocity_that_is_noise_leads_to_no_wrong_place(track):
    """A robot is reported 0.3 m from its position, for long: its last velocity leads there."""
    track.memory.settled = True
    wrong = {"position_enu_m": (1.3, 2.0, 0.2), "velocity_enu_m_s": (0.02, 0.0, 0.0)}
    assert {track.accept(later(0.02 * k, **wrong)) for k in range(1, 600)} == {Verdict.JUMP}
    back = track.accept(later(2.0, arrival_s=22.02, source_time_s=1012.02, position_enu_m=(2.2, 2.0, 0.2)))
    assert back is Verdict.ACCEPTED  # the position predicted by the last velocity, away from the wrong one


def test_numbers_of_a_target_that_is_stuck_are_the_last_also_at_rest(track):
    """Noise of a velocity at rest is enough to detect that a position is repeated."""
    rest = {"position_enu_m": FIRST.position_enu_m, "velocity_enu_m_s": (0.004, -0.003, 0.0)}
    assert track.accept(later(0.02, **rest)) is Verdict.FROZEN
    assert track.accept(later(0.04, **(rest | {"velocity_enu_m_s": ZERO}))) is Verdict.ACCEPTED

"""Tests which target samples are accepted."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.core.parameters.flight import Checks
from flightstack.core.sender_clock import Reading
from flightstack.core.target.estimator import TURN_RATE_MAX_RAD_S, TargetEstimator
from flightstack.core.target.track import TargetTrack
from flightstack.core.types import ZERO, TargetSample
from tests.unit.core.target.test_target_estimator import LINK, circle


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
    assert track.accept(FIRST) is Reading.FRESH
    return track


@pytest.mark.parametrize(
    ("sample", "verdict"),
    [
        (later(0.01), Reading.FRESH),
        (later(0.01, position_enu_m=(math.nan, 2.0, 0.2)), Reading.NOT_FINITE),
        (later(0.01, velocity_enu_m_s=(math.inf, 0.0, 0.0)), Reading.NOT_FINITE),
        (later(0.01, child_frame_id="other"), Reading.WRONG_ROBOT),
        (later(0.01, frame_id="odom"), Reading.WRONG_ROBOT),
        (later(0.01, source_time_s=1000.0), Reading.REPEATED),
        (later(0.01, source_time_s=999.9), Reading.OUT_OF_ORDER),
        (later(0.01, velocity_enu_m_s=(1.6, 0.0, 0.0)), Reading.TOO_FAST),
        (later(0.01, position_enu_m=(2.001, 2.0, 0.2)), Reading.JUMP),
        # a sample is accepted up to 0.2 m from its expected position
        (later(0.01, position_enu_m=(1.2009, 2.0, 0.2)), Reading.FRESH),
        (later(0.01, position_enu_m=(1.202, 2.0, 0.2)), Reading.JUMP),
    ],
)
def test_verdicts(track, sample, verdict):
    assert track.accept(sample) is verdict
    assert (track.memory.accepted, track.memory.rejected) == ((2, 0) if verdict is Reading.FRESH else (1, 1))


def drives(t_s, stamp_s):
    """Return a sample of a robot that drives at 0.1 m/s; the robot's clock is 1000 s ahead."""
    return TargetSample(
        t_s, 1000.0 + stamp_s, "map", "target", (1.0 + 0.1 * t_s, 0.0, 0.2), (0.1, 0.0, 0.0), 0.0, 0.0
    )


def ticks(since_s, until_s):
    return [since_s + 0.02 * k for k in range(round((until_s - since_s) / 0.02))]


def steady(until_s, settled):
    """Return a track that has accepted samples at 50 Hz from 0 to ``until_s``."""
    track = TargetTrack(Checks(), 0.01)
    track.memory.settled = settled
    for t_s in ticks(0.0, until_s):
        assert track.accept(drives(t_s, t_s)) is Reading.FRESH
    return track


@given(st.floats(0.01, 0.24), within(0.3), within(2.0), within(0.1))
def test_a_robot_that_sets_off_in_a_gap_is_believed(gap_s, before_m_s, acceleration_m_s2, off_m):
    """After an acceleration in a gap, a sample is accepted if acceleration and noise explain it."""
    gone = [
        p + v * gap_s + 0.5 * a * gap_s**2 + o
        for p, v, a, o in zip(FIRST.position_enu_m, before_m_s, acceleration_m_s2, off_m, strict=True)
    ]
    then = tuple(v + a * gap_s for v, a in zip(before_m_s, acceleration_m_s2, strict=True))
    track = TargetTrack(Checks())
    track.accept(FIRST._replace(velocity_enu_m_s=before_m_s))
    sample = later(gap_s, position_enu_m=tuple(gone), velocity_enu_m_s=then)
    assert track.accept(sample) is Reading.FRESH


def test_of_a_lost_robot_the_velocity_of_now_proves_no_place(track):
    assert track.accept(later(0.2, position_enu_m=(2.0, 2.0, 0.2))) is Reading.JUMP
    fast = (1.0, 0.0, 0.0)  # the mean of both velocities predicts this position after 0.9 s
    there = later(0.9, position_enu_m=(1.495, 2.0, 0.2), velocity_enu_m_s=fast)
    assert track.accept(there) is Reading.JUMP


def test_a_sample_that_was_long_on_its_way_is_late(track):
    track.accept(later(0.2))
    slow = later(0.21)._replace(arrival_s=10.21 + 0.26)
    assert track.accept(slow) is Reading.LATE


def test_the_age_counts_from_the_measurement_less_the_shortest_delay(track):
    assert track.at(10.1).age_s == pytest.approx(0.1)
    slow = later(0.1)._replace(arrival_s=10.1 + 0.05)  # 50 ms more latency than for the first sample
    track.accept(slow)
    assert track.at(10.15).age_s == pytest.approx(0.05)


@pytest.mark.parametrize("settled", [False, True])
@pytest.mark.parametrize("ahead_s", [0.05, 0.15, 0.3, 60.0, 3600.0, 1e9, 1e300, math.inf, math.nan, -1e9])
def test_one_wrong_stamp_costs_one_sample(ahead_s, settled):
    track = steady(2.0, settled)
    assert track.accept(drives(2.0, 2.0 + ahead_s)) is not Reading.FRESH
    for k in range(1, 100):
        t_s = 2.0 + 0.02 * k
        assert track.accept(drives(t_s, t_s)) is Reading.FRESH
        assert track.at(t_s).age_s < 1e-6


@pytest.mark.parametrize("settled", [False, True])
@pytest.mark.parametrize("silent_s", [0.02, 0.4])
@pytest.mark.parametrize("by_s", [-900.0, -9.0, -1.0, -0.3, 0.05, 0.2, 2.0, 3600.0])
def test_a_clock_that_was_set_is_followed_after_samples_that_agree(by_s, silent_s, settled):
    """After a step of the robot's clock, samples are rejected until they have agreed for some time."""
    track, proof_s = steady(2.0, settled), Checks().recovery_time_s
    for k in range(200):
        t_s = 2.0 + silent_s + 0.02 * k
        good = track.accept(drives(t_s, t_s + by_s)) is Reading.FRESH
        if 0.02 * k < proof_s - 1e-9:
            assert not good
            assert track.at(t_s).age_s == pytest.approx(t_s - 1.98)
        elif not -0.4 <= by_s <= -0.3 or silent_s < 0.3:
            assert good or 0.02 * k < proof_s + 0.03
            assert not good or track.at(t_s).age_s < 1e-6


def test_before_the_first_sample_there_is_no_target():
    with pytest.raises(AssertionError):
        TargetTrack(Checks()).at(1.0)


def bend(t_s, speed_m_s, turn_rate_rad_s):
    """Return position and velocity of a robot that drives on a circle."""
    turned, radius = turn_rate_rad_s * t_s, speed_m_s / turn_rate_rad_s
    sin, cos = math.sin(turned), math.cos(turned)
    return (radius * sin, -radius * cos, 0.0), (speed_m_s * cos, speed_m_s * sin, 0.0)


@given(
    st.floats(0.2, 1.0), st.floats(0.2, 0.8), st.sampled_from([-1.0, 1.0]), st.floats(0.0, 0.4),
    st.floats(-math.pi, math.pi),
)  # fmt: skip
def test_a_steady_bend_is_followed_without_an_error_that_stays(speed_m_s, rate, side, ahead_s, yaw_rad):
    """On a circle the estimate with yaw is exact to 10 um, at least five times better than without yaw."""
    link = replace(LINK, jerk_xy_m_s3_sqrthz=0.05)
    told, untold, sideways = (
        TargetEstimator(one) for one in (link, link, replace(link, turns_with_yaw=False))
    )
    for n in range(500):
        sample = bend(0.02 * n, speed_m_s, side * rate)
        # the yaw differs from the direction of travel by a constant angle
        yaw = math.remainder(yaw_rad + side * rate * 0.02 * n, math.tau)
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


STEADY = replace(LINK, jerk_xy_m_s3_sqrthz=0.05)
ROUSED = replace(STEADY, jerk_growth_max=10.0)


def test_surprise_makes_it_less_sure_up_to_the_bound_and_passes():
    estimator, sigma = TargetEstimator(ROUSED), []
    bound = TargetEstimator(replace(STEADY, jerk_xy_m_s3_sqrthz=0.5))
    for n in range(300):
        x = 0.02 * n * (1.0 if 100 <= n < 150 else 0.0)  # the position jumps at samples 100 and 150
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
    with_.update(1.02, *circle(1.02), -3.2)  # the yaw changes by 0.08 rad and passes +-pi
    assert 0.0 < with_.memory.turn_rate_rad_s < TURN_RATE_MAX_RAD_S


def test_numbers_of_a_target_that_is_stuck_are_the_last_also_at_rest(track):
    """At rest a repeated position is rejected if the velocity has noise, and accepted at zero velocity."""
    rest = {"position_enu_m": FIRST.position_enu_m, "velocity_enu_m_s": (0.004, -0.003, 0.0)}
    assert track.accept(later(0.02, **rest)) is Reading.FROZEN
    assert track.accept(later(0.04, **(rest | {"velocity_enu_m_s": ZERO}))) is Reading.FRESH


def test_a_robot_that_jumps_is_refused_whatever_its_velocity_says(track):
    fast = (1.4, 0.0, 0.0)  # the mean velocity predicts a distance of 0.15 m
    assert track.accept(later(0.2, position_enu_m=(1.34, 2.0, 0.2), velocity_enu_m_s=fast)) is Reading.FRESH
    track = TargetTrack(Checks())
    track.accept(FIRST)
    assert track.accept(later(0.2, position_enu_m=(1.36, 2.0, 0.2), velocity_enu_m_s=fast)) is Reading.JUMP

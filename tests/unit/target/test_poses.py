"""Tests targets that send poses: their computed velocity, and a landing spot beside the tracked point."""

import math

import numpy as np
import pytest

from bridge.frames import quaternion_from_yaw
from bridge.ros2.cdr import Odometry, Pose
from bridge.target.odometry import RawSample, excess_noise, sample_of
from bridge.target.ros2_target import (
    OFFSET_MAX_M,
    OUTLIERS_MAX,
    SETTLED_M_S,
    PoseTrack,
    TargetSource,
    TargetSpec,
    TargetType,
)
from bridge.zenoh.zenoh_link import dropping_publisher, open_session
from flightstack.core.parameters.robust import TargetLink
from tests.unit.target import ros2_helpers as ros

LINK = TargetLink()
SPEED_M_S, TURN_RAD_S = 0.2, 0.5


def circle(t_s, noise=(0.0, 0.0, 0.0), frame="map"):
    """Return the pose of a robot on a circle, as a tracker measures it."""
    radius_m, yaw_rad = SPEED_M_S / TURN_RAD_S, TURN_RAD_S * t_s
    x, y = radius_m * math.sin(yaw_rad), radius_m * (1.0 - math.cos(yaw_rad))
    position = (x + noise[0], y + noise[1], 0.2 + noise[2])
    return Pose(round(t_s * 1e9), frame, position, quaternion_from_yaw(yaw_rad))


def drive(track, begin_s, end_s, rate_hz=50, sigma_m=0.0, seed=1):
    """Pass measured poses on a circle to ``track``; yield time and sample for each output."""
    chance = np.random.default_rng(seed)
    for i in range(round(begin_s * rate_hz), round(end_s * rate_hz)):
        t_s = i / rate_hz
        odometry = track.take(circle(t_s, tuple(map(float, chance.normal(0.0, 1.0, 3) * sigma_m))))
        if odometry is not None:
            yield t_s, sample_of(RawSample(b"", odometry=odometry), t_s)


def velocity_error_m_s(t_s, sample):
    yaw_rad = TURN_RAD_S * t_s
    vx, vy, vz = sample.velocity_enu_m_s
    return math.hypot(vx - SPEED_M_S * math.cos(yaw_rad), vy - SPEED_M_S * math.sin(yaw_rad), vz)


def test_the_velocity_of_a_clean_circle_is_right_and_turned_into_the_world():
    samples = list(drive(PoseTrack(LINK, "base"), 0.0, 5.0))
    assert samples[0][0] < 0.25
    assert max(velocity_error_m_s(*one) for one in samples if one[0] > 1.0) < 0.01
    t_s, last = samples[-1]
    assert (last.frame_id, last.child_frame_id) == ("map", "base")
    assert last.source_time_s == pytest.approx(t_s)
    assert last.position_enu_m == circle(t_s).position_m  # the measured position is not changed
    assert last.yaw_rate_rad_s == pytest.approx(TURN_RAD_S, rel=0.01)


def test_poses_that_are_too_few_or_too_bad_go_nowhere_and_it_is_said():
    track = PoseTrack(TargetLink(position_noise_m=0.02), "base")
    assert list(drive(track, 0.0, 10.0, 20, 0.02)) == []
    assert "0.05 m/s are needed" in track.problem


def covariance(xx=0.0, yy=0.0):
    out = [0.0] * 36
    out[0], out[7] = xx, yy
    return out


def test_a_sender_worse_than_configured_is_told_of():
    assert excess_noise(covariance(2.5e-5, 2.5e-5), covariance(4e-4, 4e-4), LINK) == ""
    text = excess_noise(covariance(0.0025, 0.0025), covariance(0.04, 0.01), LINK)
    assert "0.05 m where target.position_noise_m is 0.005" in text
    assert "0.2 m/s where target.velocity_noise_m_s is 0.02" in text


OFFSET = (-0.032, 0.0, 0.2)
STAMP = 1_700_000_000_000_000_000


def at(t_s, speed_m_s=0.2, turn_rad_s=0.5):
    """Return odometry of a robot on a circle."""
    radius_m, yaw_rad = speed_m_s / turn_rad_s, turn_rad_s * t_s
    position_m = (radius_m * math.sin(yaw_rad), -radius_m * math.cos(yaw_rad), 0.0)
    return Odometry(
        STAMP + round(t_s * 1e9), "odom", "base", position_m,
        quaternion_from_yaw(yaw_rad), (speed_m_s, 0.0, 0.0), (0.0, 0.0, turn_rad_s),
    )  # fmt: skip


def sample(odometry):
    return sample_of(RawSample(b"", odometry=odometry), 0.0)


def test_the_velocity_is_the_derivative_of_the_position():
    for t_s in np.linspace(0.0, 12.0, 25):
        before, here, after = (sample(at(float(t)).shifted(OFFSET)) for t in (t_s - 1e-4, t_s, t_s + 1e-4))
        slope = (np.array(after.position_enu_m) - np.array(before.position_enu_m)) / 2e-4
        assert here.velocity_enu_m_s == pytest.approx(slope, abs=1e-6)
        assert here.position_enu_m[2] == pytest.approx(0.2)
        plain = sample(at(float(t_s)))
        gap = np.array(here.position_enu_m)[:2] - np.array(plain.position_enu_m)[:2]
        assert gap == pytest.approx([-0.032 * math.cos(plain.yaw_rad), -0.032 * math.sin(plain.yaw_rad)])
        assert here.yaw_rad == plain.yaw_rad


@pytest.mark.parametrize("kind", [TargetType.ODOMETRY, TargetType.POSE])
def test_a_source_shifts_what_it_hears(kind):
    session = open_session()
    try:
        spec = TargetSpec.parse("x/y", kind, offset_m=OFFSET)
        assert not spec.is_direct
        listening = TargetSource(session, spec, "odom", "base", TargetLink())
        put = dropping_publisher(session, "x/y")
        for i in range(100):
            truth = at(i / 50)
            if kind is TargetType.ODOMETRY:
                put.put(truth.pack())
            else:
                put.put(ros.pose_stamped(truth.stamp_ns, "odom", truth.position_m, truth.orientation_wxyz))
        raw = listening.poll()[-1]
        last, wanted = sample_of(raw, 0.0), sample(at(99 / 50).shifted(OFFSET))
        assert sample_of(RawSample(raw.payload), 0.0) == last  # the logged bytes give the flown sample again
        assert last.position_enu_m == pytest.approx(wanted.position_enu_m)
        assert last.velocity_enu_m_s == pytest.approx(wanted.velocity_enu_m_s, abs=0.01)
        put.put(b"\x00\x01\x00\x00")
        assert listening.poll() == [] or kind is TargetType.POSE
        assert listening.refused == 1
    finally:
        session.close()


@pytest.mark.parametrize(
    "offset", [(OFFSET_MAX_M + 0.1, 0.0, 0.0), (0.0, math.nan, 0.0), (0.0, 0.0, -math.inf)]
)
def test_an_offset_that_is_none_is_refused(offset):
    with pytest.raises(ValueError, match="up to 5 m"):
        TargetSpec.parse("x/y", offset_m=offset)


@pytest.mark.parametrize("ahead_s", [0.05, 0.3, 0.9])
def test_one_stamp_from_the_future_does_not_silence_a_target(ahead_s):
    track = PoseTrack(LINK, "base")
    assert list(drive(track, 0.0, 3.0))
    track.take(circle(3.0)._replace(stamp_ns=round((3.0 + ahead_s) * 1e9)))
    (t_s, first), *_, last = drive(track, 3.0, 5.0)
    assert t_s < 3.0 + 0.3
    assert velocity_error_m_s(t_s, first) < 3.0 * SETTLED_M_S
    assert velocity_error_m_s(*last) < 0.02
    # single poses that are out of order do not reset the estimate
    for k in range(20):
        assert list(drive(track, 5.0 + 0.1 * k, 5.1 + 0.1 * k))
        assert track.take(circle(5.0 + 0.1 * k)) is None


def test_an_outlier_goes_nowhere_and_does_not_move_the_velocity():
    track = PoseTrack(LINK, "base")
    list(drive(track, 0.0, 2.0))
    assert track.take(circle(2.0, (0.25, 0.0, 0.0))) is None
    after = list(drive(track, 2.02, 2.2))
    assert len(after) == 9
    assert max(velocity_error_m_s(*one) for one in after) < 0.02


def test_a_target_that_was_carried_away_is_followed_anew():
    track = PoseTrack(LINK, "base")
    list(drive(track, 0.0, 2.0))
    out = [track.take(circle(2.0 + i / 50, (3.0, 0.0, 0.0))) for i in range(50)]
    first = next(i for i, odometry in enumerate(out) if odometry is not None)
    assert OUTLIERS_MAX <= first < OUTLIERS_MAX + 15
    late = sample_of(RawSample(b"", odometry=out[-1]), 0.0)
    assert velocity_error_m_s(2.0 + 49 / 50, late) < 0.02

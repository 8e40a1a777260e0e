"""Poses for PX4 against the truth they are made of."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from sim.px4.messages import Px4Mocap
from sim.px4.plant import Body
from sim.scenarios.scenario import OdometryLink

SOUND = OdometryLink(100.0)
STEP_NS = 4_000_000


def body(position=(1.0, 2.0, 3.0), q=(1.0, 0.0, 0.0, 0.0)):
    return Body(position, (0.0, 0.0, 0.0), q, (0.0, 0.0, 0.0))


def poses(link, state, count=2500, seed=1):
    """Time in ms and pose of everything that comes within so many steps."""
    mocap = Px4Mocap(link, seed)
    return [(4 * k, m) for k in range(count) for m in mocap.poll(state, k * STEP_NS, 1_000_000 + 4000 * k)]


def test_comes_at_50_hz_at_most_and_at_a_lower_rate_if_the_scenario_has_one():
    assert len(poses(SOUND, body(), 250)) == 50
    assert len(poses(OdometryLink(30.0), body(), 250)) == 30
    assert [ms for ms, _ in poses(SOUND, body(), 12)] == [0, 20, 40]


def test_comes_after_the_delay_with_the_pose_of_before():
    mocap = Px4Mocap(OdometryLink(50.0, delay_s=0.012), 1)
    found = []
    for k in range(10):
        found += [(k, m) for m in mocap.poll(body((0.1 * k, 0.0, 0.0)), k * STEP_NS, 4000 * k)]
    assert [(k, round(m.y, 3)) for k, m in found] == [(3, 0.0), (8, 0.5)]
    assert [m.time_usec for _, m in found] == [12000, 32000]


@settings(max_examples=50)
@given(st.tuples(*[st.floats(-10.0, 10.0)] * 3), st.tuples(*[st.floats(-1.0, 1.0)] * 4))
def test_shows_the_pose_of_frd_in_ned(position, raw):
    assume(math.hypot(*raw) > 0.1)
    q = np.array(raw) / math.hypot(*raw)
    _, m = poses(SOUND, body(position, tuple(q)), 1)[0]
    assert (m.x, m.y, m.z) == pytest.approx((position[1], position[0], -position[2]))

    def matrix(w, x, y, z):
        r = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        return np.eye(3) + 2 * w * r + 2 * r @ r

    ned_of_enu = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    assert matrix(*m.q) == pytest.approx(ned_of_enu @ matrix(*q) @ np.diag([1, -1, -1]), abs=1e-6)
    assert (m.frame_id, m.child_frame_id, m.estimator_type) == (1, 12, 2)  # NED, body FRD, vision
    assert math.isnan(m.vx)
    assert math.isnan(m.rollspeed)


def test_noise_and_losses_are_the_scenario_s_and_the_variances_say_so():
    link = OdometryLink(50.0, position_noise_m=0.01, yaw_noise_rad=0.05, loss=0.2)
    found = [m for _, m in poses(link, body(), 12_500)]
    assert len(found) == pytest.approx(0.8 * 2500, rel=0.05)
    assert np.std([(m.x, m.y, m.z) for m in found], axis=0) == pytest.approx([0.01] * 3, rel=0.1)
    yaw = [2.0 * math.atan2(m.q[3], m.q[0]) - math.pi / 2 for m in found]
    assert np.std([math.remainder(y, math.tau) for y in yaw]) == pytest.approx(0.05, rel=0.1)
    variances = [found[0].pose_covariance[i] for i in (0, 6, 11, 15, 18, 20)]
    assert variances == pytest.approx([1e-4] * 3 + [2.5e-3] * 3)


def test_the_same_seed_loses_and_shakes_the_same():
    link = OdometryLink(50.0, position_noise_m=0.01, loss=0.2)

    def numbers(seed):
        return [(ms, m.x, m.y, m.z) for ms, m in poses(link, body(), 500, seed)]

    assert numbers(1) == numbers(1)
    assert numbers(1) != numbers(2)


def test_a_perfect_camera_still_has_a_variance():
    _, m = poses(SOUND, body(), 1)[0]
    assert min(m.pose_covariance[i] for i in (0, 6, 11, 15, 18, 20)) > 0.0

"""The landing spot away from the frame that is tracked: as a rigid body moves."""

import math

import numpy as np
import pytest

from bridge.frames import quaternion_from_yaw
from bridge.ros2.cdr import Odometry, Pose
from bridge.target.odometry import RawSample, sample_from_cdr, sample_of, shift_odometry, shift_pose
from bridge.target.ros2_target import OFFSET_MAX_M, TargetSource, TargetSpec, TargetType
from bridge.zenoh.zenoh_link import dropping_publisher, open_session
from flightstack.core.parameters.robust import TargetLink
from tests.unit.target import ros2_helpers as ros

OFFSET = (-0.032, 0.0, 0.2)
STAMP = 1_700_000_000_000_000_000


def at(t_s, speed_m_s=0.2, turn_rad_s=0.5):
    """Odometry of a robot on a circle."""
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
        before, here, after = (
            sample(shift_odometry(at(float(t)), OFFSET)) for t in (t_s - 1e-4, t_s, t_s + 1e-4)
        )
        slope = (np.array(after.position_enu_m) - np.array(before.position_enu_m)) / 2e-4
        assert here.velocity_enu_m_s == pytest.approx(slope, abs=1e-6)
        assert here.position_enu_m[2] == pytest.approx(0.2)
        plain = sample(at(float(t_s)))
        gap = np.array(here.position_enu_m)[:2] - np.array(plain.position_enu_m)[:2]
        assert gap == pytest.approx([-0.032 * math.cos(plain.yaw_rad), -0.032 * math.sin(plain.yaw_rad)])
        assert here.yaw_rad == plain.yaw_rad


def test_a_tilted_robot_carries_its_pad_along():
    q = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)  # nose down by 90 deg: its up is forward
    shifted = shift_pose(Pose(STAMP, "odom", (1.0, 2.0, 3.0), q), (0.0, 0.0, 0.5))
    assert shifted.position_m == pytest.approx((1.5, 2.0, 3.0))


def test_everything_else_stays():
    full = Odometry(
        STAMP, "odom", "base", (1.0, 2.0, 3.0), quaternion_from_yaw(0.3), (0.1, 0.2, 0.3), (0.01, 0.02, 0.03),
        tuple(map(float, range(36))), tuple(map(float, range(36, 72))),
    )  # fmt: skip
    shifted = shift_odometry(full, OFFSET)
    for name in set(Odometry.__dataclass_fields__) - {"position_m", "linear_m_s"}:
        assert getattr(shifted, name) == getattr(full, name)


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
        last, wanted = sample_of(raw, 0.0), sample(shift_odometry(at(99 / 50), OFFSET))
        assert sample_from_cdr(raw.payload, 0.0) == last  # the log's bytes say what is flown by
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

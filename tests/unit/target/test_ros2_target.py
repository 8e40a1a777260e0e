"""Tests a ROS 2 target behind a router: messages of another library are valid, bad messages rejected."""

import math
import struct
from contextlib import contextmanager

import pytest
from zenoh.ext import declare_advanced_publisher

from bridge.frames import quaternion_from_yaw
from bridge.ros2.ros2_names import topic_key
from bridge.target.odometry import RawSample, sample_of
from bridge.target.ros2_target import ROS_TYPES, TargetSource, TargetSpec, TargetType
from bridge.zenoh import zenoh_link
from flightstack.core.parameters.robust import TargetLink
from tests.processes.bounded import wait_for
from tests.unit.target import ros2_helpers as ros

FRAME, CHILD = "odom", "base_footprint"  # names in TurtleBot3's burger.yaml
STAMP = 1_700_000_000_500_000_000


def attachment(sequence, time_ns):
    """Return an attachment by rmw_zenoh's design document: two int64, a length, 16 bytes."""
    return struct.pack("<qqB", sequence, time_ns, 16) + ros.GID


class Robot:
    """Publishes like rmw_zenoh: with an advanced publisher without a cache (rmw_publisher_data.cpp)."""

    def __init__(self, session, key):
        self.publisher = declare_advanced_publisher(session, key)
        self._probe = zenoh_link.dropping_publisher(session, key)  # shows only whether a subscriber exists
        self.sequence = 0

    def put(self, payload, with_attachment=True):
        self.sequence += 1
        if with_attachment:
            self.publisher.put(payload, attachment=attachment(self.sequence, STAMP + self.sequence))
        else:
            self.publisher.put(payload)

    def wait(self):
        wait_for(lambda: zenoh_link.is_matched(self._probe), "the subscription")


@contextmanager
def source(text, kind=TargetType.ODOMETRY, key=None, domain=0, link=None):
    """Yield a ROS 2 robot, and the source that subscribes to it through a router."""
    with ros.network() as (_, ours, theirs):
        spec = TargetSpec.parse(text, kind, domain)
        listening = TargetSource(ours, spec, FRAME, CHILD, link or TargetLink())
        robot = Robot(theirs, key or spec.key.replace("*/*", "/".join(_typed(kind))))
        robot.wait()
        yield robot, listening


def _typed(kind):
    known = ROS_TYPES[kind]
    return topic_key(0, "/x", known.name, known.type_hash).split("/")[2:]


def collect(listening, count):
    samples = []
    wait_for(lambda: samples.extend(listening.poll()) or len(samples) >= count, f"sample {count}")
    return samples


def told(listening):
    """Wait for the next problem that the source reports; return its text."""

    def one():
        assert listening.poll() == []
        return listening.take_problems()

    return wait_for(one, "a reason")[0]


def test_a_turtlebot_is_followed_by_its_topic():
    yaw = quaternion_from_yaw(math.pi / 2)
    with source("ros2:/robot1/odom", domain=7) as (robot, listening):
        assert str(robot.publisher.key_expr).startswith(
            "7/robot1/odom/nav_msgs::msg::dds_::Odometry_/RIHS01_3cc9"
        )
        robot.put(ros.odometry(STAMP, FRAME, CHILD, (1.0, 2.0, 0.0), yaw, (0.2, 0.0, 0.0), (0.0, 0.0, 0.3)))
        [raw] = collect(listening, 1)
        sample = sample_of(RawSample(raw.payload), 3.0)
        assert (raw.sequence, raw.source_time_ns) == (1, STAMP + 1)
        assert (sample.frame_id, sample.child_frame_id) == (FRAME, CHILD)
        assert sample.position_enu_m == (1.0, 2.0, 0.0)
        assert sample.velocity_enu_m_s == pytest.approx((0.0, 0.2, 0.0))  # rotated from the child frame
        assert sample.source_time_s == pytest.approx(STAMP / 1e9)
        assert listening.take_problems() == []


@pytest.mark.parametrize(
    ("name", "type_hash"), [("nav_msgs/msg/Odometry", "RIHS01_" + "0" * 64), ROS_TYPES[TargetType.POSE]]
)
def test_another_type_or_hash_is_refused_with_its_name(name, type_hash):
    with source("ros2:/odom", key=topic_key(0, "/odom", name, type_hash)) as (robot, listening):
        robot.put(ros.odometry(STAMP, FRAME, CHILD))
        text = told(listening)
        assert text.startswith("ros2:/odom: 0/odom/")
        assert f"/{type_hash} carries another type: nav_msgs/msg/Odometry with hash RIHS01_3cc9" in text
        assert listening.refused == 1
        robot.put(ros.odometry(STAMP, FRAME, CHILD))
        wait_for(lambda: listening.poll() == [] and listening.refused == 2)
        assert listening.take_problems() == []  # the problem is reported only once


@pytest.mark.parametrize(
    ("frame", "child", "words"),
    [
        ("map", CHILD, "frame_id is 'map', checks.target_frame is 'odom'"),
        (FRAME, "base_link", "child_frame_id is 'base_link', checks.target_child_frame is 'base_footprint'"),
    ],
)
def test_wrong_frames_are_told_and_left_to_the_controller_to_refuse(frame, child, words):
    with source("ros2:/odom") as (robot, listening):
        robot.put(ros.odometry(STAMP, frame, child))
        [raw] = collect(listening, 1)
        assert sample_of(RawSample(raw.payload), 0.0).frame_id == frame
        assert words in listening.take_problems()[0]


@pytest.mark.parametrize(
    ("kind", "payload", "words"),
    [
        (TargetType.POSE, ros.pose_stamped(STAMP, "camera", (0.0, 0.0, 0.0)), "frame_id is 'camera'"),
        (TargetType.POSE, ros.pose_stamped(STAMP, FRAME, (0.0, 0.0, 0.0), (0.0,) * 4), "never set"),
        (TargetType.POSE, b"\x00\x01\x00\x00", "cut short"),
    ],
    ids=["other frame", "no quaternion", "cut short"],
)  # fmt: skip
def test_poses_that_lead_nowhere_are_told(kind, payload, words):
    with source("ros2:/pose", kind) as (robot, listening):
        robot.put(payload)
        assert words in told(listening)

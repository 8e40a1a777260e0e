"""Tests that odometry and poses have the CDR bytes that the library rosbags writes."""

import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from bridge.frames import quaternion_from_yaw
from bridge.ros2.cdr import POSE, POSE_COVARIANCE, Odometry, OdometryError, Pose, decode_odometry, decode_pose
from bridge.target.odometry import RawSample, sample_of
from bridge.zenoh.zenoh_link import parse_attachment
from tests.examples import examples
from tests.unit.target.ros2_helpers import pose_covariance, pose_stamped

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = STORE.types
NAME = "nav_msgs/msg/Odometry"
S = math.sqrt(0.5)

doubles = st.floats(allow_nan=True, allow_infinity=True, width=64)
names = st.text(st.characters(exclude_characters="\x00", exclude_categories=("Cs",)), max_size=40)


def ros_message(odometry):
    time = TYPES["builtin_interfaces/msg/Time"]
    vector = TYPES["geometry_msgs/msg/Vector3"]
    w, x, y, z = odometry.orientation_wxyz
    seconds, nanoseconds = divmod(odometry.stamp_ns, 10**9)
    return TYPES[NAME](
        TYPES["std_msgs/msg/Header"](time(seconds, nanoseconds), odometry.frame_id),
        odometry.child_frame_id,
        TYPES["geometry_msgs/msg/PoseWithCovariance"](
            TYPES["geometry_msgs/msg/Pose"](
                TYPES["geometry_msgs/msg/Point"](*odometry.position_m),
                TYPES["geometry_msgs/msg/Quaternion"](x, y, z, w),
            ),
            np.array(odometry.pose_covariance),
        ),
        TYPES["geometry_msgs/msg/TwistWithCovariance"](
            TYPES["geometry_msgs/msg/Twist"](vector(*odometry.linear_m_s), vector(*odometry.angular_rad_s)),
            np.array(odometry.twist_covariance),
        ),
    )


@st.composite
def odometries(draw):
    def n(count):
        return tuple(draw(st.lists(doubles, min_size=count, max_size=count)))

    stamp = draw(st.integers(-(2**31), 2**31 - 1)) * 10**9 + draw(st.integers(0, 10**9 - 1))
    return Odometry(stamp, draw(names), draw(names), n(3), n(4), n(3), n(3), n(36), n(36))


@examples(150)
@given(odometries())
def test_encoding_is_byte_equal_with_rosbags(odometry):
    assert odometry.pack() == bytes(STORE.serialize_cdr(ros_message(odometry), NAME))


@examples(150)
@given(odometries())
def test_decoding_what_rosbags_wrote_gives_the_same_values(odometry):
    decoded = decode_odometry(bytes(STORE.serialize_cdr(ros_message(odometry), NAME)))
    assert repr(decoded) == repr(odometry)  # repr, because NaN does not equal itself


def usual(**changes):
    values = {
        "stamp_ns": 1_500_000_000,
        "frame_id": "map",
        "child_frame_id": "target",
        "position_m": (1.0, 2.0, 0.2),
        "orientation_wxyz": quaternion_from_yaw(math.pi / 2),
        "linear_m_s": (0.1, 0.0, 0.0),
        "angular_rad_s": (0.0, 0.0, 0.4),
    }
    return Odometry(**(values | changes)).pack()


def test_twist_is_turned_by_the_whole_quaternion():
    # The robot heads north and pitches up by 90 deg: forward is up, left is west.
    q = (0.5, 0.5, -0.5, 0.5)
    sample = sample_of(RawSample(usual(orientation_wxyz=q, linear_m_s=(0.3, 0.1, 0.0))), 0.0)
    assert sample.velocity_enu_m_s == pytest.approx((-0.1, 0.0, 0.3))


@pytest.mark.parametrize("data", [None, b"", bytes(33), bytes(77), struct.pack("<qq", 1, 0)])
def test_anything_else_is_no_attachment(data):
    assert parse_attachment(data) is None


@pytest.mark.parametrize(
    ("x", "y", "sigma"),
    [
        (0.0, 0.0, 0.0),  # zeros mean an unknown covariance (nav_msgs/msg/Odometry)
        (0.0004, 0.0009, 0.03),
        (0.0009, 0.0004, 0.03),
        (0.0004, 0.0, 0.0),
        (-1.0, -1.0, 0.0),
        (1e6, 1e6, 0.0),  # large values that drivers use for unmeasured axes
        (math.nan, 0.01, 0.0),
        (0.01, math.nan, 0.0),
        (math.inf, 0.01, 0.0),
    ],
)
def test_what_a_sender_says_of_its_accuracy_is_in_the_sample(x, y, sigma):
    """The sample has the larger deviation of x and y, or 0 if one is zero, negative, huge or not finite."""
    covariance = np.random.default_rng(1).normal(size=36)
    covariance[0], covariance[7] = x, y
    for name, field in (
        ("pose_covariance", "position_sigma_m"), ("twist_covariance", "velocity_sigma_m_s"),
    ):  # fmt: skip
        odometry = Odometry(
            10**9, "map", "base", (1.0, 2.0, 3.0), (S, 0.0, 0.0, S), (0.2, 0.0, 0.0), (0.0, 0.0, 0.3)
        )
        payload = bytes(
            STORE.serialize_cdr(ros_message(odometry._replace(**{name: tuple(covariance)})), NAME)
        )
        found = sample_of(RawSample(payload), 0.0)
        assert getattr(found, field) == pytest.approx(sigma)
        assert found._replace(**{field: 0.0}) == sample_of(RawSample(odometry.pack()), 0.0)


Q = (0.5, -0.5, 0.5, 0.5)
STAMP = 1_700_000_000_123_456_789
frame_names = st.text(st.characters(exclude_characters="\x00", exclude_categories=("Cs",)), max_size=20)
numbers = st.floats(-1e6, 1e6)
positions = st.tuples(numbers, numbers, numbers)


@examples(60)
@given(frame_names, positions)
def test_a_pose_of_another_library_is_read(frame, position):
    assert decode_pose(pose_stamped(STAMP, frame, position, Q)) == Pose(STAMP, frame, position, Q)


@examples(60)
@given(frame_names, positions, st.lists(numbers, min_size=36, max_size=36))
def test_a_pose_with_covariance_is_read(frame, position, covariance):
    found = decode_pose(pose_covariance(STAMP, frame, position, covariance, Q), POSE_COVARIANCE)
    assert found == Pose(STAMP, frame, position, Q, tuple(covariance))


POSED = pose_stamped(1, "map", (0.0, 0.0, 0.0))


def read(schema, payload):
    return sample_of(RawSample(payload), 0.0) if schema == NAME else decode_pose(payload, schema)


@pytest.mark.parametrize(
    ("schema", "payload", "words"),
    [
        (NAME, b"", "0 bytes starts with nothing"),
        (NAME, b"\x00\x00" + usual()[2:], "starts with 00 00"),
        (NAME, b"{}" + usual()[2:], "starts with 7b 7d"),
        (NAME, usual()[:300], "cut short"),
        (NAME, usual()[:14], "cut short"),
        (NAME, usual()[:12] + b"\xff\xff\xff\x7f" + usual()[16:], "cut short"),
        (NAME, usual()[:16] + b"\xff\xfe\xfd" + usual()[19:], "utf-8"),
        (NAME, usual(position_m=(math.nan, 0.0, 0.0)), "not finite"),
        (NAME, usual(linear_m_s=(0.0, math.inf, 0.0)), "not finite"),
        (NAME, usual(angular_rad_s=(0.0, 0.0, -1e300)), "beyond"),
        (NAME, usual(orientation_wxyz=(0.0, 0.0, 0.0, 0.0)), "unit quaternion"),
        (NAME, usual(orientation_wxyz=(1.0, 1.0, 0.0, 0.0)), "unit quaternion"),
        (POSE, POSED[:40], "not a geometry_msgs/msg/PoseStamped"),
        (POSE, pose_stamped(1, "map", (math.nan, 0.0, 0.0)), "not finite"),
        (POSE, pose_stamped(1, "map", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)), "never set"),
        (POSE_COVARIANCE, POSED, "PoseWithCovarianceStamped"),
    ],
)
def test_what_is_refused_and_why(schema, payload, words):
    with pytest.raises(OdometryError, match=words):
        read(schema, payload)


@examples(500)
@given(
    st.sampled_from([NAME, POSE, POSE_COVARIANCE]),
    st.binary(max_size=80), st.integers(0, 715), st.integers(0, 715),
)  # fmt: skip
def test_damaged_payload_never_raises_anything_else(schema, noise, start, stop):
    whole = usual() if schema == NAME else pose_covariance(STAMP, "map", (1.0, 2.0, 3.0), [0.0] * 36, Q)
    for damaged in (noise, whole[:start] + noise + whole[stop:], whole[:stop]):
        try:
            found = read(schema, damaged)
        except OdometryError:
            continue
        numbers = (found.position_enu_m + found.velocity_enu_m_s) if schema == NAME else found.position_m
        assert all(map(math.isfinite, numbers))

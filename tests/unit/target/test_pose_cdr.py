"""Poses and transforms written by another CDR library are read; damaged ones are refused with a reason."""

import math
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.ros2.cdr import (
    TRANSFORMS_MAX,
    OdometryError,
    Pose,
    decode_pose,
    decode_pose_with_covariance,
    decode_transforms,
)
from tests.unit.target.ros2_helpers import pose_covariance, pose_stamped, transforms

Q = (0.5, -0.5, 0.5, 0.5)
STAMP = 1_700_000_000_123_456_789
names = st.text(st.characters(exclude_characters="\x00", exclude_categories=("Cs",)), max_size=20)
numbers = st.floats(-1e6, 1e6)
positions = st.tuples(numbers, numbers, numbers)


@settings(max_examples=60)
@given(names, positions)
def test_a_pose_of_another_library_is_read(frame, position):
    assert decode_pose(pose_stamped(STAMP, frame, position, Q)) == Pose(STAMP, frame, position, Q)


@settings(max_examples=60)
@given(names, positions, st.lists(numbers, min_size=36, max_size=36))
def test_a_pose_with_covariance_is_read(frame, position, covariance):
    found = decode_pose_with_covariance(pose_covariance(STAMP, frame, position, covariance, Q))
    assert found == Pose(STAMP, frame, position, Q, tuple(covariance))


@settings(max_examples=60)
@given(st.lists(st.tuples(names, names, positions), max_size=6))
def test_transforms_are_read(edges):
    payload = transforms(*[(STAMP + i, parent, child, p, Q) for i, (parent, child, p) in enumerate(edges)])
    found = decode_transforms(payload)
    assert [(one.child_frame_id, one.pose) for one in found] == [
        (child, Pose(STAMP + i, parent, p, Q)) for i, (parent, child, p) in enumerate(edges)
    ]


def test_a_slightly_long_quaternion_is_made_a_unit():
    found = decode_pose(pose_stamped(STAMP, "map", (0.0, 0.0, 0.0), (1.003, 0.0, 0.0, 0.0)))
    assert found.orientation_wxyz == (1.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("decode", "payload", "words"),
    [
        (decode_pose, b"", "not even a CDR header"),
        (decode_pose, b"\x00\x00" + pose_stamped(1, "map", (0.0, 0.0, 0.0))[2:], "big endian"),
        (decode_pose, pose_stamped(1, "map", (0.0, 0.0, 0.0))[:40], "no geometry_msgs/msg/PoseStamped"),
        (decode_pose, pose_stamped(1, "map", (0.0, 0.0, 0.0))[:13], "no geometry_msgs/msg/PoseStamped"),
        (decode_pose, pose_stamped(1, "map", (math.nan, 0.0, 0.0)), "not finite"),
        (decode_pose, pose_stamped(1, "map", (1e12, 0.0, 0.0)), "beyond"),
        (decode_pose, pose_stamped(1, "map", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)), "never set"),
        (decode_pose_with_covariance, pose_stamped(1, "map", (0.0, 0.0, 0.0)), "PoseWithCovarianceStamped"),
        (decode_transforms, transforms((1, "a", "b", (0.0, 0.0, 0.0), Q))[:-9], "no tf2_msgs/msg/TFMessage"),
        (decode_transforms, b"\x00\x01\x00\x00" + struct.pack("<I", TRANSFORMS_MAX + 1), "1000 are allowed"),
        (decode_transforms, b"\x00\x01\x00\x00" + struct.pack("<I", 5), "no tf2_msgs/msg/TFMessage"),
    ],
)
def test_what_is_refused_and_why(decode, payload, words):
    with pytest.raises(OdometryError, match=words):
        decode(payload)


@settings(max_examples=300)
@given(st.binary(max_size=60), st.integers(0, 240), st.integers(0, 240))
def test_damage_raises_nothing_else(noise, start, stop):
    whole = transforms(*[(STAMP, "map", "odom", (1.0, 2.0, 3.0), Q)] * 2)
    for decode in (decode_pose, decode_pose_with_covariance, decode_transforms):
        for damaged in (noise, whole[:start] + noise + whole[stop:], whole[:stop]):
            try:
                found = decode(damaged)
            except OdometryError:
                continue
            for one in found if isinstance(found, list) else [found]:
                position = one.pose.position_m if isinstance(found, list) else one.position_m
                assert all(map(math.isfinite, position))

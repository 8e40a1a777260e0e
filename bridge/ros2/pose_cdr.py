"""CDR of poses without a velocity: ``PoseStamped``, ``PoseWithCovarianceStamped`` and ``TFMessage``.

Only what a tracker needs is read. The layout rules are those of ``cdr.py``.
"""

from __future__ import annotations

import math
import struct
from typing import NamedTuple

from bridge.frames import Quat
from bridge.ros2.cdr import NO_COVARIANCE, OdometryError, check_header, decode_string
from flightstack.core.types import Vec3

TRANSFORMS_MAX = 1000  # in one message; a robot has some dozens
_UNIT_TOLERANCE = 0.01  # of the squared norm, as in odometry.py
_LARGEST_M = 1e9  # beyond this a number is damage, not a measurement
_STAMP = struct.Struct("<iI")
_COUNT = struct.Struct("<I")
_POSE = struct.Struct("<7d")  # position, orientation x y z w
_COVARIANCE = struct.Struct("<36d")
_NS_PER_S = 1_000_000_000


class Pose(NamedTuple):
    """A pose in a frame; the quaternion is w, x, y, z and of unit length."""

    stamp_ns: int
    frame_id: str
    position_m: Vec3
    orientation_wxyz: Quat
    covariance: tuple[float, ...] = NO_COVARIANCE  # 6 x 6, order x y z roll pitch yaw; all zero: unknown


class Transform(NamedTuple):
    """Pose of the frame ``child_frame_id`` in another."""

    child_frame_id: str
    pose: Pose


def decode_pose(payload: bytes) -> Pose:
    """Parse a ``geometry_msgs/msg/PoseStamped``.

    Raises:
        OdometryError: cut short, in another encoding, or no pose.
    """
    pose, _ = _pose(payload, "geometry_msgs/msg/PoseStamped")
    return pose


def decode_pose_with_covariance(payload: bytes) -> Pose:
    """Parse a ``geometry_msgs/msg/PoseWithCovarianceStamped``.

    Raises:
        OdometryError: cut short, in another encoding, or no pose.
    """
    name = "geometry_msgs/msg/PoseWithCovarianceStamped"
    pose, at = _pose(payload, name)
    return pose._replace(covariance=_unpack(_COVARIANCE, payload, at, name))


def decode_transforms(payload: bytes) -> list[Transform]:
    """Parse a ``tf2_msgs/msg/TFMessage``.

    Raises:
        OdometryError: cut short, in another encoding, too long, or a transform that is none.
    """
    name = "tf2_msgs/msg/TFMessage"
    check_header(payload)
    (count,) = _unpack(_COUNT, payload, 4, name)
    if count > TRANSFORMS_MAX:
        raise OdometryError(f"{name} holds {count} transforms: {TRANSFORMS_MAX} are allowed")
    transforms: list[Transform] = []
    at = 4 + _COUNT.size
    for _ in range(int(count)):
        stamp_ns, frame_id, at = _header(payload, _aligned(at, 4), name)
        child_frame_id, at = _string(payload, at, name)
        numbers, at = _doubles(payload, at, name)
        transforms.append(Transform(child_frame_id, _checked(stamp_ns, frame_id, numbers)))
    return transforms


def _pose(payload: bytes, name: str) -> tuple[Pose, int]:
    """The pose behind a header, and the offset after it."""
    check_header(payload)
    stamp_ns, frame_id, at = _header(payload, 4, name)
    numbers, at = _doubles(payload, at, name)
    return _checked(stamp_ns, frame_id, numbers), at


def _header(payload: bytes, at: int, name: str) -> tuple[int, str, int]:
    seconds, nanoseconds = _unpack(_STAMP, payload, at, name)
    frame_id, at = _string(payload, at + _STAMP.size, name)
    return int(seconds) * _NS_PER_S + int(nanoseconds), frame_id, at


def _string(payload: bytes, at: int, name: str) -> tuple[str, int]:
    try:
        return decode_string(payload, _aligned(at, 4))
    except struct.error as error:
        raise _short(payload, name) from error


def _doubles(payload: bytes, at: int, name: str) -> tuple[tuple[float, ...], int]:
    at = _aligned(at, 8)
    return _unpack(_POSE, payload, at, name), at + _POSE.size


def _aligned(at: int, size: int) -> int:
    return ((at - 4 + size - 1) & -size) + 4  # counted from after the 4-byte header


def _unpack(layout: struct.Struct, payload: bytes, at: int, name: str) -> tuple[float, ...]:
    try:
        return layout.unpack_from(payload, at)
    except struct.error as error:
        raise _short(payload, name) from error


def _short(payload: bytes, name: str) -> OdometryError:
    return OdometryError(f"payload of {len(payload)} bytes is cut short: that is no {name}")


def _checked(stamp_ns: int, frame_id: str, numbers: tuple[float, ...]) -> Pose:
    if not all(abs(n) < _LARGEST_M for n in numbers):  # False for NaN
        raise OdometryError(
            f"pose in {frame_id!r} holds a number that is not finite or beyond 1e9: {numbers}"
        )
    px, py, pz, x, y, z, w = numbers
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if abs(norm * norm - 1.0) > _UNIT_TOLERANCE:
        raise OdometryError(
            f"pose in {frame_id!r} has an orientation (w, x, y, z) = ({w}, {x}, {y}, {z}) of norm "
            f"{norm:.4f}: a unit quaternion is needed; was it never set?"
        )
    return Pose(stamp_ns, frame_id, (px, py, pz), (w / norm, x / norm, y / norm, z / norm))

"""Odometry and poses in CDR, the encoding of ROS 2 messages.

Odometry is ``nav_msgs/msg/Odometry``; poses without a velocity are ``PoseStamped`` and
``PoseWithCovarianceStamped``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from bridge.frames import Quat, world_from_body
from bridge.ros2.codec import CDR_HEADER, Unpack, codec
from flightstack.core.types import ZERO, Vec3

NO_COVARIANCE: tuple[float, ...] = (0.0,) * 36  # unknown covariance: all zeros, by the convention of ROS
# tolerance of a quaternion's squared norm, as in tf2 (buffer_core.cpp, QUATERNION_NORMALIZATION_TOLERANCE)
_UNIT_TOLERANCE = 0.01
_LARGEST = 1e9  # limit of valid values, m, m/s, rad/s; a value at or above this limit is damaged data
ODOMETRY = "nav_msgs/msg/Odometry"
POSE = "geometry_msgs/msg/PoseStamped"
POSE_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
_pack_odometry, _unpack_odometry = codec(ODOMETRY, frame_id=None, foreign=True)
_UNPACK_POSE = {name: codec(name, frame_id=None, foreign=True)[1] for name in (POSE, POSE_COVARIANCE)}


class OdometryError(ValueError):
    """The payload is not a usable message of the expected type."""


class Odometry(NamedTuple):
    """Fields of one ``nav_msgs/msg/Odometry``.

    The pose is in ``frame_id``, the twist in ``child_frame_id`` (ROS convention). Metres, radians, seconds;
    quaternion in the order w, x, y, z; covariances 6 x 6, row by row, in the order x y z roll pitch yaw.
    """

    stamp_ns: int
    frame_id: str
    child_frame_id: str
    position_m: Vec3
    orientation_wxyz: Quat
    linear_m_s: Vec3 = ZERO
    angular_rad_s: Vec3 = ZERO
    pose_covariance: Sequence[float] = NO_COVARIANCE
    twist_covariance: Sequence[float] = NO_COVARIANCE

    def pack(self) -> bytes:
        w, x, y, z = self.orientation_wxyz
        header, pose = (self.stamp_ns, self.frame_id), (self.position_m, (x, y, z, w))
        twist = (self.linear_m_s, self.angular_rad_s)
        poses, twists = (pose, self.pose_covariance), (twist, self.twist_covariance)
        return _pack_odometry((header, self.child_frame_id, poses, twists))

    def shifted(self, offset_m: Vec3) -> Odometry:
        """Return the odometry of the point at ``offset_m`` in child axes: v + w x r, same covariances."""
        (wx, wy, wz), (x, y, z) = self.angular_rad_s, offset_m
        return self._replace(
            position_m=_sum(self.position_m, world_from_body(self.orientation_wxyz, offset_m)),
            linear_m_s=_sum(self.linear_m_s, (wy * z - wz * y, wz * x - wx * z, wx * y - wy * x)),
        )


class Pose(NamedTuple):
    """A pose in a frame; the quaternion is w, x, y, z and has unit length."""

    stamp_ns: int
    frame_id: str
    position_m: Vec3
    orientation_wxyz: Quat
    covariance: tuple[float, ...] = NO_COVARIANCE  # 6 x 6, order x y z roll pitch yaw; all zeros: unknown

    def shifted(self, offset_m: Vec3) -> Pose:
        """Return the pose of the point at ``offset_m`` in the axes of the pose; same covariance."""
        return self._replace(
            position_m=_sum(self.position_m, world_from_body(self.orientation_wxyz, offset_m))
        )


def _sum(a: Vec3, b: Vec3) -> Vec3:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def decode_odometry(payload: bytes) -> Odometry:
    """Decode odometry; padding after the last field is ignored. Raises OdometryError."""
    (stamp_ns, frame_id), child_frame_id, (pose, pose_cov), (twist, twist_cov) = _decoded(
        _unpack_odometry, payload
    )
    position_m, (x, y, z, w) = pose
    linear_m_s, angular_rad_s = twist
    return Odometry(
        stamp_ns, frame_id, child_frame_id, position_m, (w, x, y, z), linear_m_s, angular_rad_s, pose_cov,
        twist_cov,
    )  # fmt: skip


def decode_pose(payload: bytes, schema: str = POSE) -> Pose:
    """Decode a message of type ``POSE`` or ``POSE_COVARIANCE``. Raises OdometryError: not a usable pose."""
    (stamp_ns, frame_id), pose = _decoded(_UNPACK_POSE[schema], payload)
    pose, covariance = pose if schema == POSE_COVARIANCE else (pose, NO_COVARIANCE)
    position_m, (x, y, z, w) = pose
    return Pose(stamp_ns, frame_id, position_m, checked_unit((w, x, y, z), position_m), covariance)


def checked_unit(orientation_wxyz: Quat, others: Vec3 | tuple[float, ...]) -> Quat:
    """Return the quaternion with unit length. Raises OdometryError: bad quaternion, or a bad other number."""
    w, x, y, z = orientation_wxyz
    n = (*others, w, x, y, z)
    if not (math.isfinite(sum(n)) and max(n) < _LARGEST and min(n) > -_LARGEST):
        raise OdometryError(f"message holds a number that is not finite or beyond 1e9: {n}")
    squared = w * w + x * x + y * y + z * z
    if abs(squared - 1.0) > _UNIT_TOLERANCE:
        raise OdometryError(
            f"orientation (w, x, y, z) = ({w}, {x}, {y}, {z}) has norm {math.sqrt(squared):.4f}: "
            "a unit quaternion is needed; was it never set?"
        )
    scale = 1.0 / math.sqrt(squared)
    return (w * scale, x * scale, y * scale, z * scale)


def _decoded(unpack: Unpack, payload: bytes) -> Any:
    # Newer versions of the standard use the two option bytes for a padding length; ROS 2 also ignores these.
    if payload[:2] != CDR_HEADER[:2]:
        raise OdometryError(
            f"payload of {len(payload)} bytes starts with {payload[:4].hex(' ') or 'nothing'}: only CDR "
            "little endian, 00 01, is understood; let the publisher send that"
        )
    try:
        return unpack(CDR_HEADER + payload[4:] if payload[2:4] != CDR_HEADER[2:] else payload)
    except ValueError as error:
        raise OdometryError(f"payload of {len(payload)} bytes is cut short or damaged: {error}") from error

"""Moves a pose from the tracked frame to the landing spot: a fixed offset in the axes of the tracked frame.

A robot's odometry is that of a point between its wheels; the pad is somewhere above.
"""

from __future__ import annotations

from bridge.frames import world_from_body
from bridge.ros2.cdr import decode_odometry, encode_odometry
from bridge.ros2.pose_cdr import Pose
from flightstack.core.types import Vec3


def shift_pose(pose: Pose, offset_m: Vec3) -> Pose:
    """Return the pose of the point at ``offset_m`` in the axes of the pose; the covariance is unchanged."""
    return pose._replace(position_m=_shift(pose.position_m, world_from_body(pose.orientation_wxyz, offset_m)))


def shift_odometry(payload: bytes, offset_m: Vec3) -> bytes:
    """Return serialised odometry of the point at ``offset_m`` in the axes of the child frame.

    The velocity is that of a rigid body, v + w x r. Covariances are left as they are.

    Raises:
        OdometryError: no odometry, or numbers that do not fit any more.
    """
    odometry = decode_odometry(payload)
    (wx, wy, wz), (x, y, z) = odometry.angular_rad_s, offset_m
    return encode_odometry(
        odometry.stamp_ns,
        odometry.frame_id,
        odometry.child_frame_id,
        _shift(odometry.position_m, world_from_body(odometry.orientation_wxyz, offset_m)),
        odometry.orientation_wxyz,
        _shift(odometry.linear_m_s, (wy * z - wz * y, wz * x - wx * z, wx * y - wy * x)),
        odometry.angular_rad_s,
        odometry.pose_covariance,
        odometry.twist_covariance,
    )


def _shift(a: Vec3, b: Vec3) -> Vec3:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])

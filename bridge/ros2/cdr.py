"""CDR of ``nav_msgs/msg/Odometry``, and of poses without a velocity: ``PoseStamped`` and the like.

A hand-written fast path, byte-equal with rosbags' generic codec. Layout (OMG CDR version 1, little endian,
alignment counted from after the 4-byte header): stamp as int32 and uint32, strings (length with the closing
NUL, then the bytes), then doubles. Odometry holds two strings and 85 doubles: position, orientation x y z w,
36 covariances, linear and angular twist, 36 covariances. Of poses only what a tracker needs is read.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

from bridge.frames import Quat
from flightstack.core.types import ZERO, Vec3

NO_COVARIANCE: tuple[float, ...] = (0.0,) * 36  # REP 103 practice: all zero means unknown
_HEADER = b"\x00\x01\x00\x00"  # CDR version 1, little endian, no options
_STAMP = struct.Struct("<iI")
_LENGTH = struct.Struct("<I")
_DOUBLES = struct.Struct("<85d")
_POSE_AND_TWIST = struct.Struct("<8d48xd224x7d48xd224x")  # of the covariances the variances of x and y alone
_NS_PER_S = 1_000_000_000
TRANSFORMS_MAX = 1000  # in one message; a robot has some dozens
_UNIT_TOLERANCE = 0.01  # of the squared norm, as in odometry.py
_LARGEST_M = 1e9  # beyond this a number is damage, not a measurement
_POSE = struct.Struct("<7d")  # position, orientation x y z w
_COVARIANCE = struct.Struct("<36d")
_ENCODINGS = {
    (0, 0): "CDR, big endian",
    (0, 2): "parameter list, big endian",
    (0, 3): "parameter list, little endian",
    (0, 6): "XCDR2, big endian",
    (0, 7): "XCDR2, little endian",
    (0, 8): "delimited XCDR2, big endian",
    (0, 9): "delimited XCDR2, little endian",
}


class OdometryError(ValueError):
    """A payload that is not a usable ``nav_msgs/msg/Odometry``; the text says what was found."""


@dataclass(frozen=True, slots=True)
class Odometry:
    """One ``nav_msgs/msg/Odometry``.

    The pose is in ``frame_id``, the twist in ``child_frame_id`` (ROS convention). Metres, radians, seconds;
    quaternion in the order w, x, y, z; covariances row by row, 6 x 6, order x y z roll pitch yaw.
    """

    stamp_ns: int
    frame_id: str
    child_frame_id: str
    position_m: Vec3
    orientation_wxyz: Quat
    linear_m_s: Vec3 = ZERO
    angular_rad_s: Vec3 = ZERO
    pose_covariance: tuple[float, ...] = NO_COVARIANCE
    twist_covariance: tuple[float, ...] = NO_COVARIANCE

    def pack(self) -> bytes:
        """Serialise it, as ``encode_odometry`` does."""
        return encode_odometry(
            self.stamp_ns, self.frame_id, self.child_frame_id, self.position_m, self.orientation_wxyz,
            self.linear_m_s, self.angular_rad_s, self.pose_covariance, self.twist_covariance,
        )  # fmt: skip


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


def encode_odometry(
    stamp_ns: int,
    frame_id: str,
    child_frame_id: str,
    position_m: Vec3,
    orientation_wxyz: Quat,
    linear_m_s: Vec3 = ZERO,
    angular_rad_s: Vec3 = ZERO,
    pose_covariance: Sequence[float] = NO_COVARIANCE,
    twist_covariance: Sequence[float] = NO_COVARIANCE,
) -> bytes:
    """Serialise an odometry message; the arguments are the fields of ``Odometry``.

    Raises:
        OdometryError: the stamp does not fit 32-bit seconds, or a covariance has not 36 entries.
    """
    seconds, nanoseconds = divmod(stamp_ns, _NS_PER_S)
    w, x, y, z = orientation_wxyz
    try:
        return b"".join(
            (
                _HEADER,
                _STAMP.pack(seconds, nanoseconds),
                _encode_strings(frame_id, child_frame_id),
                _DOUBLES.pack(
                    *position_m, x, y, z, w, *pose_covariance, *linear_m_s, *angular_rad_s, *twist_covariance
                ),
            )
        )
    except struct.error as error:
        raise OdometryError(
            f"odometry cannot be encoded: {error}; allowed are a stamp of 32-bit seconds ({seconds} s given) "
            f"and covariances of 36 numbers ({len(pose_covariance)} and {len(twist_covariance)} given)"
        ) from error


def decode_odometry(payload: bytes) -> Odometry:
    """Parse a serialised odometry message, from ROS 2 or from ``encode_odometry``.

    Bytes after the last field are ignored: some writers pad.

    Raises:
        OdometryError: the payload is too short, in another encoding, or its strings are broken.
    """
    stamp_ns, frame_id, child_frame_id, n = _unpack(payload, _DOUBLES)
    return Odometry(
        stamp_ns,
        frame_id,
        child_frame_id,
        (n[0], n[1], n[2]),
        (n[6], n[3], n[4], n[5]),
        (n[43], n[44], n[45]),
        (n[46], n[47], n[48]),
        n[7:43],
        n[49:85],
    )


def decode_pose_and_twist(payload: bytes) -> tuple[int, str, str, tuple[float, ...]]:
    """Parse the fields that the controller needs; it costs half, since most covariances are skipped.

    Returns:
        Stamp in nanoseconds, frame, child frame, and 17 numbers as on the wire: position, orientation
        x y z w, variances of x and y, linear and angular twist, variances of the linear one's x and y.

    Raises:
        OdometryError: as ``decode_odometry``.
    """
    return _unpack(payload, _POSE_AND_TWIST)


def decode_pose(payload: bytes) -> Pose:
    """Parse a ``geometry_msgs/msg/PoseStamped``.

    Raises:
        OdometryError: cut short, in another encoding, or no pose.
    """
    with _whole(payload, "geometry_msgs/msg/PoseStamped"):
        return _read_pose(payload)[0]


def decode_pose_with_covariance(payload: bytes) -> Pose:
    """Parse a ``geometry_msgs/msg/PoseWithCovarianceStamped``.

    Raises:
        OdometryError: cut short, in another encoding, or no pose.
    """
    with _whole(payload, "geometry_msgs/msg/PoseWithCovarianceStamped"):
        pose, at = _read_pose(payload)
        return pose._replace(covariance=_COVARIANCE.unpack_from(payload, at))


def decode_transforms(payload: bytes) -> list[Transform]:
    """Parse a ``tf2_msgs/msg/TFMessage``.

    Raises:
        OdometryError: cut short, in another encoding, too long, or a transform that is none.
    """
    transforms: list[Transform] = []
    with _whole(payload, "tf2_msgs/msg/TFMessage") as name:
        (count,) = _LENGTH.unpack_from(payload, 4)
        if count > TRANSFORMS_MAX:
            raise OdometryError(f"{name} holds {count} transforms: {TRANSFORMS_MAX} are allowed")
        at = 4 + _LENGTH.size
        for _ in range(count):
            stamp_ns, frame_id, at = _read_header(payload, _aligned(at, 4))
            child_frame_id, at = _decode_string(payload, _aligned(at, 4))
            at = _aligned(at, 8)
            pose = _checked(stamp_ns, frame_id, _POSE.unpack_from(payload, at))
            transforms.append(Transform(child_frame_id, pose))
            at += _POSE.size
    return transforms


@contextmanager
def _whole(payload: bytes, name: str) -> Iterator[str]:
    """Refuse a payload in another encoding, and one that ends before a message of this type does."""
    _check_header(payload)
    try:
        yield name
    except struct.error as error:
        raise OdometryError(f"payload of {len(payload)} bytes is cut short: that is no {name}") from error


def _read_pose(payload: bytes) -> tuple[Pose, int]:
    stamp_ns, frame_id, at = _read_header(payload, 4)
    at = _aligned(at, 8)
    return _checked(stamp_ns, frame_id, _POSE.unpack_from(payload, at)), at + _POSE.size


def _read_header(payload: bytes, at: int) -> tuple[int, str, int]:
    seconds, nanoseconds = _STAMP.unpack_from(payload, at)
    frame_id, at = _decode_string(payload, at + _STAMP.size)
    return seconds * _NS_PER_S + nanoseconds, frame_id, at


def _aligned(at: int, size: int) -> int:
    return ((at - 4 + size - 1) & -size) + 4  # counted from after the 4-byte header


def _unpack(payload: bytes, doubles: struct.Struct) -> tuple[int, str, str, tuple[float, ...]]:
    _check_header(payload)
    try:
        stamp_ns, frame_id, at = _read_header(payload, 4)
        child_frame_id, at = _decode_string(payload, _aligned(at, 4))
        numbers = doubles.unpack_from(payload, _aligned(at, 8))
    except struct.error as error:
        raise OdometryError(
            f"odometry payload of {len(payload)} bytes is cut short: nav_msgs/msg/Odometry holds a "
            "stamp, two frame names and 85 doubles (680 bytes)"
        ) from error
    return stamp_ns, frame_id, child_frame_id, numbers


def _check_header(payload: bytes) -> None:
    """Refuse a payload without the header of little-endian CDR.

    Raises:
        OdometryError: it does not.
    """
    # The two option bytes carry padding in newer versions of the standard and are ignored, as ROS 2 does.
    if payload[:2] == _HEADER[:2]:
        return
    if len(payload) < 4:
        raise OdometryError(f"odometry payload has {len(payload)} bytes: not even a CDR header")
    found = _ENCODINGS.get((payload[0], payload[1]), "not a CDR encoding")
    raise OdometryError(
        f"odometry payload starts with {payload[:4].hex(' ')} ({found}): only CDR little endian, 00 01, is "
        "understood; let the publisher send that"
    )


@lru_cache(maxsize=64)
def _encode_strings(frame_id: str, child_frame_id: str) -> bytes:
    """Both strings with their padding, ready for the doubles to follow."""
    out = _STAMP.pack(0, 0)  # stands for the stamp, so that alignment counts right
    for text in (frame_id, child_frame_id):
        data = text.encode() + b"\x00"
        out += bytes(-len(out) % 4) + _LENGTH.pack(len(data)) + data
    return out[_STAMP.size :] + bytes(-len(out) % 8)


def _decode_string(payload: bytes, at: int) -> tuple[str, int]:
    """The string at ``at`` and the offset behind it.

    Raises:
        OdometryError: it does not fit, or is not UTF-8.
        struct.error: the payload ends before its length.
    """
    (length,) = _LENGTH.unpack_from(payload, at)
    start = at + 4
    end = start + length
    if end > len(payload):
        raise OdometryError(
            f"odometry payload of {len(payload)} bytes has a frame name of {length} bytes at byte {at}: "
            "that does not fit"
        )
    data = payload[start:end]
    try:
        return data.removesuffix(b"\x00").decode(), end
    except UnicodeDecodeError as error:
        raise OdometryError(f"odometry payload has a frame name that is not UTF-8: {data[:32]!r}") from error


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

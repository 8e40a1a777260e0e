"""Conversions between ENU/FLU, the frames of the stack, and NED/FRD, the frames of MAVLink.

World: ENU is x east, y north, z up; NED is x north, y east, z down (REP 103; MAV_FRAME_LOCAL_NED).
Body: FLU is x forward, y left, z up; FRD is x forward, y right, z down.
Yaw in ENU is counter-clockwise from east, in NED clockwise from north. Quaternions are Hamilton, in the
order w, x, y, z, and rotate a body vector into the world. No other module may convert frames.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from flightstack.core.numeric import wrapped
from flightstack.core.types import Vec3

Quat = tuple[float, float, float, float]

_SQRT_HALF = math.sqrt(0.5)
_POLE = 1.0 - 1e-12  # sine of the pitch above which the nose counts as vertical: 1.4e-6 rad from 90 degrees
_NED_AXIS = (1, 0, 2, 4, 3, 5)  # index of the ENU axis of each NED axis, for position, then for rotation
_NED_SIGN = (1.0, 1.0, -1.0, 1.0, 1.0, -1.0)


def ned_from_enu(v: Vec3) -> Vec3:
    return (v[1], v[0], -v[2])


def frd_from_flu(v: Vec3) -> Vec3:
    return (v[0], -v[1], -v[2])


# Both conversions are their own inverses.
enu_from_ned, flu_from_frd = ned_from_enu, frd_from_flu


def wrap_angle(angle_rad: float) -> float:
    """Wrap a finite angle to (-pi, pi]. Raises ValueError: the angle is infinite."""
    turned = wrapped(angle_rad)
    return math.pi if turned <= -math.pi else turned


def yaw_enu_from_ned(yaw_ned_rad: float) -> float:
    """Convert a heading clockwise from north into a heading counter-clockwise from east, in (-pi, pi]."""
    return wrap_angle(math.pi / 2 - yaw_ned_rad)


def yaw_ned_from_enu(yaw_enu_rad: float) -> float:
    """Convert a heading counter-clockwise from east into a heading clockwise from north, in (-pi, pi]."""
    return wrap_angle(math.pi / 2 - yaw_enu_rad)


def ned_frd_from_enu_flu(q: Quat) -> Quat:
    """Convert the attitude of FLU in ENU into the attitude of FRD in NED.

    The formula is the expanded product q(NED<-ENU) q q(FLU<-FRD) with the half turns (0, s, s, 0), s =
    sqrt(1/2), and (0, 1, 0, 0). The sign of the quaternion makes the conversion its own inverse.
    """
    w, x, y, z = q
    return (_SQRT_HALF * (w + z), _SQRT_HALF * (x + y), _SQRT_HALF * (x - y), _SQRT_HALF * (w - z))


def quaternion_from_yaw(yaw_rad: float) -> Quat:
    """Return the attitude of a level body that is rotated by ``yaw_rad`` about the world's z axis."""
    return (math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2))


def yaw_from_quaternion(q: Quat) -> float:
    """Return the heading of the body's x axis in the world's x-y plane, (-pi, pi]; ``q``: unit quaternion."""
    w, x, y, z = q
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def world_from_body(q: Quat, v: Vec3) -> Vec3:
    """Rotate a vector from the body frame into the world frame; ``q`` is a unit quaternion."""
    w, x, y, z = q
    # The formula is v + 2 r x (r x v + w v), r being the vector part of q: 18 products, no matrix.
    tx = y * v[2] - z * v[1] + w * v[0]
    ty = z * v[0] - x * v[2] + w * v[1]
    tz = x * v[1] - y * v[0] + w * v[2]
    return (
        v[0] + 2.0 * (y * tz - z * ty),
        v[1] + 2.0 * (z * tx - x * tz),
        v[2] + 2.0 * (x * ty - y * tx),
    )


def body_from_world(q: Quat, v: Vec3) -> Vec3:
    """Rotate a vector from the world frame into the body frame; ``q`` is a unit quaternion."""
    return world_from_body((q[0], -q[1], -q[2], -q[3]), v)


def ned_covariance_from_enu(covariance: Sequence[float]) -> list[float]:
    """Convert a covariance of position and rotation about the world's axes from ENU into NED.

    ``covariance`` is 6 x 6, row by row, in the order x, y, z and rotations about x, y, z (geometry_msgs). The
    result has the axes north, east and down, and only the 21 upper entries, row by row, as in MAVLink.
    """
    return [
        _NED_SIGN[i] * _NED_SIGN[j] * covariance[6 * _NED_AXIS[i] + _NED_AXIS[j]]
        for i in range(6)
        for j in range(i, 6)
    ]


def euler_from_quaternion(q: Quat) -> Vec3:
    """Return roll, pitch in [-pi/2, pi/2] and yaw of a unit quaternion (intrinsic rotations about z, y, x).

    If the nose points straight up or down, roll and yaw have the same axis; roll is then 0.
    """
    w, x, y, z = q
    sine = 2.0 * (w * y - z * x)
    if abs(sine) >= _POLE:
        return (
            0.0,
            math.copysign(math.pi / 2, sine),
            wrap_angle(-math.copysign(2.0, sine) * math.atan2(x, w)),
        )
    return (
        math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
        math.asin(sine),
        math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
    )

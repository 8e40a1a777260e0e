"""Decodes and checks velocity set-points from MAVLink messages."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.frames import enu_from_ned, flu_from_frd, quaternion_from_yaw, world_from_body, yaw_enu_from_ned
from flightstack.core.types import Vec3

SPEED_MAX_M_S = 5.0  # greatest accepted speed, m/s; far above the commands of any controller of this stack
YAW_RATE_MAX_RAD_S = 6.0  # greatest accepted yaw rate, rad/s

# POSITION_TARGET_TYPEMASK: a set bit means "ignore". Bit 9 concerns the acceleration, which is unused.
_POSITION = 0b000000111
_VELOCITY = 0b000111000
_ACCELERATION = 0b111000000
_YAW = 1 << 10
_YAW_RATE = 1 << 11
_FRAMES = (dialect.MAV_FRAME_LOCAL_NED, dialect.MAV_FRAME_BODY_NED)


class Setpoint(NamedTuple):
    """A velocity set-point with its heading or yaw rate."""

    velocity_enu_m_s: Vec3
    yaw_rad: float | None  # heading to hold; None: ``yaw_rate_rad_s`` applies
    yaw_rate_rad_s: float  # yaw rate, counter-clockwise; 0 holds the present heading


def read_setpoint(message: Any, yaw_rad: Callable[[], float | None]) -> Setpoint | str:
    """Convert SET_POSITION_TARGET_LOCAL_NED into a set-point, or return the reason of its refusal.

    A velocity in a body frame is rotated by the heading only, as in PX4. ``yaw_rad`` returns the present
    heading of the vehicle, counter-clockwise from east; None: unknown.
    """
    mask = message.type_mask
    if mask & _POSITION != _POSITION or mask & _ACCELERATION != _ACCELERATION or mask & _VELOCITY:
        return f"Set-point dropped: mask {mask}, only velocity (2503)"
    v = (message.vx, message.vy, message.vz)
    if not math.isfinite(sum(v)):
        return "Set-point dropped: velocity not finite"
    if v[0] * v[0] + v[1] * v[1] + v[2] * v[2] > SPEED_MAX_M_S**2:
        return f"Set-point dropped: above {SPEED_MAX_M_S:g} m/s"
    if message.coordinate_frame not in _FRAMES:
        known = " or ".join(map(str, _FRAMES))
        return f"Set-point dropped: frame {message.coordinate_frame}, only {known}"
    if message.coordinate_frame == dialect.MAV_FRAME_BODY_NED:
        heading_rad = yaw_rad()
        if heading_rad is None:
            return "Set-point dropped: body frame, but the heading is not known"
        velocity = world_from_body(quaternion_from_yaw(heading_rad), flu_from_frd(v))
    else:
        velocity = enu_from_ned(v)
    if not mask & _YAW:
        if not math.isfinite(message.yaw):
            return "Set-point dropped: yaw not finite"
        return Setpoint(velocity, yaw_enu_from_ned(message.yaw), 0.0)
    if not mask & _YAW_RATE:
        if not abs(message.yaw_rate) <= YAW_RATE_MAX_RAD_S:  # this form also rejects NaN
            return f"Set-point dropped: yaw rate above {YAW_RATE_MAX_RAD_S:g} rad/s"
        return Setpoint(velocity, None, -message.yaw_rate)
    return Setpoint(velocity, None, 0.0)

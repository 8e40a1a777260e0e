"""SET_POSITION_TARGET_LOCAL_NED for a Crazyflie: velocities only, and what is accepted of them."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.frames import enu_from_ned, flu_from_frd, quaternion_from_yaw, world_from_body, yaw_enu_from_ned
from flightstack.core.types import Vec3

SPEED_ABSURD_M_S = 10.0  # m/s; a number beyond this is damage, not a wish
YAW_RATE_MAX_RAD_S = 6.0  # rad/s
# POSITION_TARGET_TYPEMASK: a set bit means "ignore". Bit 9, how to read the acceleration, does not matter.
_POSITION, _VELOCITY, _ACCELERATION, _YAW, _YAW_RATE = 0o7, 0o70, 0o700, 1 << 10, 1 << 11


class Wish(NamedTuple):
    """A velocity, and what to do with the heading."""

    velocity_enu_m_s: Vec3
    yaw_rad: float | None  # None: turn with the rate
    yaw_rate_rad_s: float = 0.0  # counter-clockwise


def read_setpoint(message: Any, yaw_rad: float | None) -> Wish | str:
    """Turn a message into a wish, or into the reason why it is none.

    Args:
        message: in LOCAL_NED, or BODY_NED which is turned by the heading alone (as PX4 does).
        yaw_rad: present heading, counter-clockwise from east; None: not known.
    """
    mask = message.type_mask
    if mask & _POSITION != _POSITION or mask & _ACCELERATION != _ACCELERATION or mask & _VELOCITY:
        return f"Set-point dropped: mask {mask}, only velocity (2503)"
    v = (message.vx, message.vy, message.vz)
    if not (math.isfinite(sum(v)) and max(map(abs, v)) <= SPEED_ABSURD_M_S):
        return f"Set-point dropped: velocity not finite or above {SPEED_ABSURD_M_S:g} m/s"
    if message.coordinate_frame == dialect.MAV_FRAME_LOCAL_NED:
        velocity = enu_from_ned(v)
    elif message.coordinate_frame == dialect.MAV_FRAME_BODY_NED and yaw_rad is not None:
        velocity = world_from_body(quaternion_from_yaw(yaw_rad), flu_from_frd(v))
    else:
        return f"Set-point dropped: frame {message.coordinate_frame}, only 1 or 8"
    if not mask & _YAW:
        if not math.isfinite(message.yaw):
            return "Set-point dropped: yaw not finite"
        return Wish(velocity, yaw_enu_from_ned(message.yaw))
    if not mask & _YAW_RATE:
        if not abs(message.yaw_rate) <= YAW_RATE_MAX_RAD_S:  # also refuses NaN
            return f"Set-point dropped: yaw rate above {YAW_RATE_MAX_RAD_S:g} rad/s"
        return Wish(velocity, None, -message.yaw_rate)
    return Wish(velocity, None)

"""The companion's own messages: its heartbeat, and the velocity set-point."""

from __future__ import annotations

from typing import Protocol

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.frames import ned_from_enu, yaw_ned_from_enu
from bridge.mavlink.codec.decoding import Message
from bridge.mavlink.profiles.profile import Profile
from flightstack.core.types import Vec3


def companion_heartbeat() -> Message:
    """Heartbeat of an onboard controller that is active."""
    return dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_ONBOARD_CONTROLLER, dialect.MAV_AUTOPILOT_INVALID, 0, 0, dialect.MAV_STATE_ACTIVE, 3
    )


class Setpoint(Protocol):
    """What may be sent: made by the safety gate and by nothing else."""

    @property
    def velocity_enu_m_s(self) -> Vec3:
        """Velocity, ENU, m/s."""

    @property
    def yaw_rad(self) -> float:
        """Heading to hold, counter-clockwise from east."""


def velocity_setpoint(setpoint: Setpoint, profile: Profile, target: tuple[int, int], now_s: float) -> Message:
    """SET_POSITION_TARGET_LOCAL_NED of a velocity and heading.

    Args:
        setpoint: what the safety gate approved; finite numbers.
        profile: its mask and frame.
        target: system and component of the autopilot.
        now_s: the stack's clock.
    """
    unused = (0.0, 0.0, 0.0)
    return dialect.MAVLink_set_position_target_local_ned_message(
        round(now_s * 1000) & 0xFFFFFFFF,
        *target,
        profile.frame,
        profile.setpoint_mask,
        *unused,
        *ned_from_enu(setpoint.velocity_enu_m_s),
        *unused,
        yaw_ned_from_enu(setpoint.yaw_rad),
        0.0,
    )

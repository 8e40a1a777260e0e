"""Messages of the companion: heartbeat, velocity set-point, origin, and the request for a message."""

from __future__ import annotations

import math
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.frames import ned_from_enu, yaw_ned_from_enu
from bridge.mavlink.codec.messages import Message
from bridge.mavlink.profiles import Profile
from flightstack.core.safety.gate import ApprovedSetpoint
from flightstack.core.types import VehicleStatus

_PERIOD_S = 1.0  # time between two tries, s
_TRIES = 60
_E7 = 1e7  # MAVLink's integer degrees are multiples of 1e-7 degrees


class Origin(NamedTuple):
    """Position of local (0, 0, 0) on earth, WGS84."""

    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float


class OriginSender:
    """Sends SET_GPS_GLOBAL_ORIGIN until the vehicle reports its origin; only while disarmed on the ground."""

    def __init__(self, origin: Origin | None, target_system: int) -> None:
        """``origin`` None: no message is sent."""
        self._origin, self._target_system = origin, target_system
        self._tries = 0
        self._last_s = -math.inf

    def restart(self) -> None:
        """Start again after a restart of the vehicle, which may have lost its origin."""
        self._tries = 0

    def step(self, status: VehicleStatus | None, known: bool, now_s: float) -> list[Message]:
        """Return the message to send now.

        ``known``: the vehicle has sent its origin, or a local position, which requires an origin. Then no
        message is sent, since setting the origin again resets the estimate.
        """
        origin = self._origin
        if origin is None or status is None or status.armed or known or self._tries >= _TRIES:
            return []
        if now_s - self._last_s < _PERIOD_S:
            return []
        self._tries += 1
        self._last_s = now_s
        place = (round(origin.latitude_deg * _E7), round(origin.longitude_deg * _E7))
        height_mm = round(origin.altitude_amsl_m * 1000.0)
        return [dialect.MAVLink_set_gps_global_origin_message(self._target_system, *place, height_mm)]


def companion_heartbeat() -> Message:
    """Return the heartbeat of an active onboard controller."""
    return dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_ONBOARD_CONTROLLER, dialect.MAV_AUTOPILOT_INVALID, 0, 0, dialect.MAV_STATE_ACTIVE, 3
    )


def request_message(target: tuple[int, int], message_id: int, unset: float) -> Message:
    """Return the command REQUEST_MESSAGE; ``unset`` is the autopilot's value of an omitted parameter."""
    params = (float(message_id), *(unset,) * 5, 0.0)
    return dialect.MAVLink_command_long_message(*target, dialect.MAV_CMD_REQUEST_MESSAGE, 0, *params)


def velocity_setpoint(
    setpoint: ApprovedSetpoint, profile: Profile, target: tuple[int, int], now_s: float
) -> Message:
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

"""Messages of the companion: heartbeat, velocity set-point, origin, and requests for messages."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
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
    """Sends SET_GPS_GLOBAL_ORIGIN until the vehicle reports its origin, if it is disarmed on the ground."""

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


_SET_MESSAGE_INTERVAL = 511  # MAV_CMD number of SET_MESSAGE_INTERVAL
_CHECK_S = 1.0  # time over which a rate is measured, s
_ENOUGH = 0.7  # sufficient fraction of the requested rate; loss and the autopilot's ticks reduce it
_ROUNDING_S = 1e-6  # margin above the rounding error of a time, s
_REQUESTS = 5  # number of requests that follow each other every _CHECK_S
_AGAIN_S = 3.0  # time between two later tries, s, as long as no message arrives


@dataclass(slots=True)
class _Stream:
    message_id: int
    rate_hz: float
    tries: int = 0
    seen: int = 0
    since_s: float = 0.0


class StreamRequests:
    """Counts messages and returns SET_MESSAGE_INTERVAL commands as long as their rate is too low. Pure.

    It requests every second at first, then less often as long as no message arrives: an autopilot may have no
    position for minutes (no satellites, no origin). ``rates_hz`` has message ids as keys.
    """

    def __init__(
        self, rates_hz: Mapping[int, float], target_system: int, target_component: int, unset: float
    ) -> None:
        self._streams = {id_: _Stream(id_, rate) for id_, rate in rates_hz.items()}
        self._target = (target_system, target_component)
        self._unset = unset
        self.quiet_until_s = -math.inf  # time before which ``step`` returns no message

    def seen(self, message_id: int, count: int = 1) -> None:
        stream = self._streams.get(message_id)
        if stream is not None:
            stream.seen += count

    @property
    def asked(self) -> tuple[int, ...]:
        return tuple(self._streams)

    def restart(self) -> None:
        """Immediately request missing messages again: a restarted vehicle has lost the requests."""
        for stream in self._streams.values():
            stream.tries = min(stream.tries, 1)
        self.quiet_until_s = -math.inf

    def step(self, now_s: float) -> list[Message]:
        """Return the commands to send now; called only after the first message of the vehicle."""
        if now_s < self.quiet_until_s:
            return []
        streams = self._streams.values()
        messages = [self._ask(stream, now_s) for stream in streams if self._due(stream, now_s)]
        since_s = min((stream.since_s for stream in streams), default=now_s)
        self.quiet_until_s = since_s + _CHECK_S - _ROUNDING_S
        return messages

    def _due(self, stream: _Stream, now_s: float) -> bool:
        elapsed_s = now_s - stream.since_s
        if stream.tries and elapsed_s < _CHECK_S:
            return False
        if stream.tries and stream.seen >= _ENOUGH * stream.rate_hz * elapsed_s:
            stream.tries = 1  # the stream arrives; if it stops, requests start again
            stream.seen, stream.since_s = 0, now_s
            return False
        if stream.tries < _REQUESTS:
            return True
        if stream.seen:  # the vehicle or its line is slower than requested: accept this
            stream.seen, stream.since_s = 0, now_s
            return False
        return elapsed_s >= _AGAIN_S

    def _ask(self, stream: _Stream, now_s: float) -> Message:
        stream.tries += 1
        stream.seen, stream.since_s = 0, now_s
        interval_us = float(round(1e6 / stream.rate_hz))
        rest = (self._unset,) * 4
        return dialect.MAVLink_command_long_message(
            *self._target, _SET_MESSAGE_INTERVAL, 0, float(stream.message_id), interval_us, *rest, 0.0
        )

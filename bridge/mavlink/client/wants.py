"""Requests of the companion to the vehicle: mode, message rates and origin, as its profile needs them."""

from __future__ import annotations

import math
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.client.commands import CommandSequencer
from bridge.mavlink.client.companion import Origin, OriginSender
from bridge.mavlink.client.streams import StreamRequests
from bridge.mavlink.profiles.profile import Profile
from flightstack.core.types import Request, VehicleStatus

_LANDED_STATE_HZ = 5.0  # Hz; the default of PX4
_THROTTLE_HZ = 10.0  # Hz of VFR_HUD, where the thrust reserve is estimated


class Wants(NamedTuple):
    """Senders of requests; each request is repeated until the vehicle shows it."""

    sequencer: CommandSequencer
    streams: StreamRequests
    origin: OriginSender

    def idle_until_s(self, request: Request, status: VehicleStatus | None) -> float:
        """Time until which nothing is due if request and status do not change, s; -inf: due now."""
        return self.streams.quiet_until_s if self.sequencer.idle(request, status) else -math.inf

    def took(self, now_s: float, ticks: int, *, setpoints: bool) -> None:
        """Record ticks in which position and attitude arrived; all with a set-point or none."""
        for id_ in (dialect.MAVLINK_MSG_ID_ATTITUDE, dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED):
            self.streams.seen(id_, ticks)
        if setpoints:
            self.sequencer.note_setpoint(now_s)


def wanted(
    profile: Profile,
    target: tuple[int, int],
    takeoff_height_m: float,
    state_hz: float,
    *,
    power: bool,
    origin: Origin | None,
) -> Wants:
    """The senders of commands, message rates and origin for one autopilot.

    ``takeoff_height_m``: climb of a take-off; ``state_hz``: rate of position and attitude; ``power``: request
    the throttle; ``origin``: sent to an autopilot that needs one.
    """
    rates_hz = {
        dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: state_hz,
        dialect.MAVLINK_MSG_ID_ATTITUDE: state_hz,
        dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _LANDED_STATE_HZ,
        **profile.asked_hz,
        **({dialect.MAVLINK_MSG_ID_VFR_HUD: _THROTTLE_HZ} if power else {}),
    }
    return Wants(
        CommandSequencer(profile, *target, takeoff_height_m),
        StreamRequests(rates_hz, *target, profile.unset, profile.data_streams),
        OriginSender(origin if profile.needs_origin else None, target[0]),
    )

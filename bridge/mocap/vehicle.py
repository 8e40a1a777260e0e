"""The MAVLink side of motion capture: poses to a vehicle as its autopilot wants them. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.client.companion import Origin, OriginSender, companion_heartbeat
from bridge.mavlink.codec.decoding import Message
from bridge.mocap.checks import WANTS, Limits, PoseChecks, Sample, Wants
from flightstack.core.types import Landed, Mode, VehicleStatus

COMPONENT_ID = dialect.MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY
SILENT_S = 3.0  # s without the vehicle's heartbeat: it is gone, and what it wants is asked anew
_HEARTBEAT_S = 1.0
_HELLO_S = 0.2  # s between heartbeats until the vehicle has been heard


class MocapVehicle:
    """Call ``handle`` with what the vehicle says, then ``step``.

    Attributes:
        checks: of the poses, with their counts.
        wants: what the vehicle wants; None before its first heartbeat.
        unknown_autopilot: MAV_AUTOPILOT of a vehicle that is not in the table, else None.
    """

    def __init__(self, system_id: int, limits: Limits, origin: Origin | None) -> None:
        """Set up. ``origin`` is the place on earth of the room's zero, for an autopilot that needs one."""
        self.checks = PoseChecks(limits)
        self.wants: Wants | None = None
        self.unknown_autopilot: int | None = None
        self._limits, self._origin, self._system_id = limits, origin, system_id
        self._origin_sender = OriginSender(None, system_id)
        self._origin_known = False
        self._armed = False
        self._heard_s = self._beat_s = -math.inf

    @property
    def origin_missing(self) -> bool:
        """Whether the vehicle needs an origin and nobody gave one."""
        return (
            self.wants is not None
            and self.wants.needs_origin
            and self._origin is None
            and not self._origin_known
        )

    def heard(self, now_s: float) -> bool:
        """Whether the vehicle is there."""
        return now_s - self._heard_s <= SILENT_S

    def flies(self, now_s: float) -> bool:
        """Whether it is there and armed: then it needs its poses."""
        return self._armed and self.heard(now_s)

    def handle(self, message: Message, now_s: float) -> list[Message]:
        """Take a message of the vehicle's autopilot; returns what to answer."""
        id_ = message.get_msgId()
        if id_ == dialect.MAVLINK_MSG_ID_HEARTBEAT:
            self._on_heartbeat(message, now_s)
        elif id_ == dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN:
            self._origin_known = True
        elif id_ == dialect.MAVLINK_MSG_ID_TIMESYNC and message.tc1 == 0:
            # PX4 takes our time stamps once it has synchronised with such answers (Timesync.cpp)
            return [dialect.MAVLink_timesync_message(max(1, round(now_s * 1e9)), message.ts1)]
        return []

    def step(self, samples: Sequence[Sample], now_s: float) -> tuple[list[Message], str | None]:
        """What to send now, and why there is no pose to rely on."""
        judged = self.checks.step(samples, now_s, armed=self.flies(now_s))
        messages: list[Message] = []
        if now_s - self._beat_s >= (_HEARTBEAT_S if self.heard(now_s) else _HELLO_S) - 1e-9:
            self._beat_s = now_s
            messages.append(companion_heartbeat())
        wants = self.wants
        if wants is None or not self.heard(now_s):
            return messages, judged.problem
        messages += [wants.message(p, round(p.measured_s * 1e6)) for p in judged.passed]
        status = VehicleStatus(now_s, self._armed, Mode.UNKNOWN, Landed.UNKNOWN, False)
        messages += self._origin_sender.step(status, self._origin_known, now_s)
        return messages, judged.problem

    def _on_heartbeat(self, message: Message, now_s: float) -> None:
        self._armed = bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)
        wants = WANTS.get(message.autopilot)
        self.unknown_autopilot = message.autopilot if wants is None else None
        if wants is not self.wants or not self.heard(now_s):
            self.wants, self._origin_known = wants, False
            origin = self._origin if wants is not None and wants.needs_origin else None
            self._origin_sender = OriginSender(origin, self._system_id)
            if wants is not None:
                rate_hz = min(self._limits.rate_max_hz, wants.rate_max_hz)
                self.checks.limits = replace(self._limits, rate_max_hz=rate_hz)
        self._heard_s = now_s

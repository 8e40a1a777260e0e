"""Presents a Crazyflie to MAVLink clients as a PX4 vehicle: it takes messages and returns messages.

Pure: no socket, no clock, no thread. Telemetry is made only from new states, so an old state is never sent as
new. Without a state of the Crazyflie no heartbeat is sent, only status texts.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.crazyflie.packets import (
    GRAVITY,
    HEALTH,
    STATE,
    ArmReply,
    BootClock,
    Connected,
    Event,
    LogPacket,
    Lost,
    ParamValue,
    decode_health,
    decode_state,
)
from bridge.crazyflie.rules import CrazyflieOptions
from bridge.crazyflie.vehicle import Vehicle
from bridge.mavlink.codec.messages import Message
from bridge.mavlink.server import telemetry
from bridge.mavlink.server.commands import ACCEPTED, REJECTED, Reply
from bridge.mavlink.server.parameters import Parameters, fixed
from bridge.mavlink.server.server import COMPONENT_ID, Server
from bridge.mavlink.server.telemetry import Snapshot, StreamTable
from flightstack.core.types import Vec3

READINESS_S = 1.0  # time between two checks of the conditions for arming, s
_RATE_HZ = 1000.0 / STATE.period_ms  # rate of new states, Hz
_M = dialect
_NOTHING: frozenset[int] = frozenset()
# The position is sent only as long as its estimate is good, as in PX4.
_NEED_POSITION = frozenset({_M.MAVLINK_MSG_ID_LOCAL_POSITION_NED})
_GAP_S = 0.05  # age of the state, s (five packets), above which no message with state values is sent
_OF_STATE = _NEED_POSITION | {_M.MAVLINK_MSG_ID_ATTITUDE, _M.MAVLINK_MSG_ID_ATTITUDE_QUATERNION}

_OF_CLIENTS = (
    _M.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED, _M.MAVLINK_MSG_ID_COMMAND_LONG,
    _M.MAVLINK_MSG_ID_COMMAND_INT,
)  # fmt: skip


def _home_position(s: Snapshot[Vehicle]) -> Message:
    return telemetry.home_position(s, 0, 0)  # the position on earth is unknown


def _vfr_hud(s: Snapshot[Vehicle]) -> Message:
    health = s.vehicle.health
    return telemetry.vfr_hud(s, round(100 * health.throttle) if health is not None else 0)


# Streams in their order within a datagram, with default rates, Hz; None: with every state, or on request
_STREAMS: StreamTable[Vehicle] = {
    _M.MAVLINK_MSG_ID_ATTITUDE: (telemetry.attitude, None),
    _M.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: (telemetry.attitude_quaternion, 50.0),
    _M.MAVLINK_MSG_ID_LOCAL_POSITION_NED: (telemetry.local_position_ned, None),
    _M.MAVLINK_MSG_ID_SYS_STATUS: (telemetry.sys_status, 5.0),
    _M.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: (telemetry.extended_sys_state, 5.0),
    _M.MAVLINK_MSG_ID_BATTERY_STATUS: (telemetry.battery_status, 1.0),
    _M.MAVLINK_MSG_ID_HOME_POSITION: (_home_position, 1.0),
    _M.MAVLINK_MSG_ID_VFR_HUD: (_vfr_hud, None),
}


class Node(Server[Vehicle]):
    """MAVLink server of a Crazyflie: call ``take`` per event, ``handle`` per message, then ``step``."""

    def __init__(self, options: CrazyflieOptions, drag_1_s: Vec3 | None) -> None:
        self.clock = BootClock()  # converts the firmware's time stamps
        self._streamed: list[Message] = []  # messages that were made from new states and are not sent yet
        self._readiness_due_s, self._readiness = READINESS_S, ""
        self._shown_armed = False
        self._restarts = 0
        parameters = Parameters(
            (
                fixed("MAV_SYS_ID", options.system_id),
                fixed("MAV_COMP_ID", COMPONENT_ID),
                fixed("MAV_TYPE", dialect.MAV_TYPE_QUADROTOR),
            )
        )
        vehicle = Vehicle(options, drag_1_s)
        super().__init__(vehicle, _STREAMS, parameters, _RATE_HZ, system_id=options.system_id)
        self._events: dict[type, Callable[[Any, float], None]] = {
            Connected: self.vehicle.connected,
            Lost: self.vehicle.lost,
            ArmReply: self.vehicle.arm_reply,
            ParamValue: self.vehicle.param,
            LogPacket: self._on_log,
        }

    def take(self, event: Event, at_s: float) -> None:
        """Handle an event of the link; ``at_s`` is its arrival time on the bridge's clock."""
        if isinstance(event, Connected):
            self.clock.begin()
        self._events[type(event)](event, at_s)

    def step(self, now_s: float) -> tuple[list[Message], list[Reply]]:
        """Advance the vehicle; return telemetry for all clients, and delayed acknowledgements of arming."""
        vehicle = self.vehicle
        vehicle.step(now_s)
        if now_s >= self._readiness_due_s and not vehicle.armed:
            self._readiness_due_s = now_s + READINESS_S
            self._tell_readiness(now_s)
        messages = [*self._new_home(now_s), *self.telemetry(now_s)]
        if vehicle.arming:
            return messages, []
        return messages, self.commands.finish(ACCEPTED if vehicle.armed else REJECTED)

    def snapshot(self, now_s: float) -> Snapshot[Vehicle] | None:
        """Return the state of the Crazyflie; None if no state arrives."""
        vehicle = self.vehicle
        if vehicle.state is None or not vehicle.alive(now_s):
            return None
        known = vehicle.position_known(now_s)
        return Snapshot(vehicle, vehicle.state, known, now_s, vehicle.state.boot_ms / 1000.0)

    def streamed(self, snapshot: Snapshot[Vehicle]) -> list[Message]:
        """Return messages made from new states; if states are missing, add due messages that need none."""
        messages, self._streamed = self._streamed, []
        return messages + super().streamed(snapshot) if self._gap(snapshot.now_s) else messages

    def hidden(self, now_s: float) -> frozenset[int]:
        """Hide the position if its estimate is bad, and all messages of a state that is too old."""
        if self._gap(now_s):
            return _OF_STATE
        return _NOTHING if self.vehicle.position_known(now_s) else _NEED_POSITION

    def boot_ns(self, now_s: float) -> int | None:
        """Return the firmware's clock, ns; None before the first state."""
        return self.clock.now_ns(now_s) if self.clock.running else None

    def heard(self, message: Message, now_s: float) -> None:
        """Register a client by its heartbeat, set-point or command; other vehicles are no clients."""
        kind = message.get_msgId()
        beats = kind == _M.MAVLINK_MSG_ID_HEARTBEAT and message.autopilot == _M.MAV_AUTOPILOT_INVALID
        if beats or kind in _OF_CLIENTS:
            self.vehicle.client(now_s)

    def _new_home(self, now_s: float) -> list[Message]:
        """Send the home position before the armed heartbeat: clients add the take-off height to home."""
        changed, self._shown_armed = self.vehicle.armed != self._shown_armed, self.vehicle.armed
        snapshot = self.snapshot(now_s) if changed else None
        return [_home_position(snapshot)] if snapshot is not None else []

    def _gap(self, now_s: float) -> bool:
        state = self.vehicle.state
        return state is None or now_s - state.at_s > _GAP_S

    def _tell_readiness(self, now_s: float) -> None:
        """Report the reason against arming when its text changes; a change of numbers does not count."""
        found = self.vehicle.problems(now_s)
        text = f"Not ready: {found[0]}" if found else "Ready to arm"
        kind = re.sub(r"[-+.\d]+", "", text)
        if kind != self._readiness:
            self._readiness = kind
            self.vehicle.texts.say(dialect.MAV_SEVERITY_INFO, text)

    def _on_log(self, packet: LogPacket, at_s: float) -> None:
        if packet.block == STATE.name:
            self._on_state(packet, at_s)
        elif packet.block == HEALTH.name:
            self.vehicle.health = decode_health(packet.values, at_s)
        else:
            self.vehicle.take_gravity(tuple(packet.values[name] for name in GRAVITY.variables))

    def _on_state(self, packet: LogPacket, at_s: float) -> None:
        timed = self.clock.take(packet.time_ms, at_s)
        if timed is None or self.vehicle.link.protocol is None:  # old or late packet, or no link
            return
        boot_ms, late_s = timed
        state = decode_state(packet.values, boot_ms, at_s - late_s)  # at the time of measurement
        restarts, self._restarts = self._restarts, self.clock.restarts
        self.vehicle.take_state(state, at_s, restarted=restarts != self.clock.restarts)
        snapshot = self.snapshot(state.at_s)  # streams follow the time of measurement, which has no jitter
        if snapshot is not None:
            self._streamed += super().streamed(snapshot)

"""The MAVLink vehicle that clients see in front of a Crazyflie: PX4's personality, messages in and out.

Pure: no socket, no clock, no thread. Telemetry is made from new states only, so an old one is never sent as
if it were new; a Crazyflie that is not heard sends no heartbeat, only the text that says so.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.crazyflie.modes import Mode, mode_of
from bridge.crazyflie.owner import Right, Sender
from bridge.crazyflie.rules import Rules
from bridge.crazyflie.server.commands import ACCEPTED, REJECTED, Commands, read_command
from bridge.crazyflie.server.messages import View, heartbeat
from bridge.crazyflie.server.setpoint import read_setpoint
from bridge.crazyflie.server.streams import Streams
from bridge.crazyflie.state import LATE_MAX_S, BootClock, decode_health, decode_state
from bridge.crazyflie.texts import INFO, Text, statustexts
from bridge.crazyflie.types import (
    ArmReply,
    Arrived,
    Connected,
    HealthBlock,
    Lost,
    ParamValue,
    StateBlock,
)
from bridge.crazyflie.vehicle import Vehicle
from bridge.frames import yaw_from_quaternion
from bridge.mavlink.codec.decoding import Message

SYSTEM_ID = 1
COMPONENT_ID = dialect.MAV_COMP_ID_AUTOPILOT1  # clients look for the autopilot nowhere else
HEARTBEAT_S = 1.0
READINESS_S = 1.0  # s between two looks at whether it could be armed
_ARM = dialect.MAV_CMD_COMPONENT_ARM_DISARM
Handler = Callable[[Any, Sender, float], list[Message]]


class Reply(NamedTuple):
    """An acknowledgement that comes later than its command."""

    sender: Sender
    message: Message


class Node:
    """Call ``take`` and ``handle`` as things come, then ``step``; send what they return.

    Attributes:
        vehicle: the Crazyflie.
        late: states that had been held up too long to be sent.
    """

    def __init__(self, rules: Rules, system_id: int = SYSTEM_ID) -> None:
        self.vehicle = Vehicle(rules)
        self.late = 0
        self.clock = BootClock()
        self._system_id = system_id
        self._streams = Streams()
        self._commands = Commands(self.vehicle, self._streams)
        self._arming_for: set[Sender] = set()
        self._beat_s = -math.inf
        self._readiness_due_s, self._readiness = READINESS_S, ""
        self._shown: object = None
        self._text_id = 0
        self._out: list[Message] = []
        self._said: list[Text] = []
        m = dialect
        self._handlers: dict[int, Handler] = {
            m.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: self._on_setpoint,
            m.MAVLINK_MSG_ID_COMMAND_LONG: self._on_command,
            m.MAVLINK_MSG_ID_COMMAND_INT: self._on_command,
            m.MAVLINK_MSG_ID_SET_MODE: self._on_set_mode,
            m.MAVLINK_MSG_ID_HEARTBEAT: self._on_heartbeat,
            m.MAVLINK_MSG_ID_TIMESYNC: self._on_timesync,
            m.MAVLINK_MSG_ID_PING: _on_ping,
        }
        self._events: dict[type, Callable[[Any, float], None]] = {
            Connected: self.vehicle.connected,
            Lost: self.vehicle.lost,
            ArmReply: self.vehicle.arm_reply,
            ParamValue: self.vehicle.param,
            StateBlock: self._on_state,
            HealthBlock: self._on_health,
        }

    def take(self, arrived: Arrived, at_s: float) -> None:
        """An event of the link; ``at_s`` is its arrival on the bridge's clock."""
        self._events[type(arrived.event)](arrived.event, at_s)

    def handle(self, message: Message, sender: Sender, now_s: float) -> list[Message]:
        """Act on a message; returns what to answer its sender."""
        handler = self._handlers.get(message.get_msgId())
        if handler is None or sender == (self._system_id, COMPONENT_ID) or not self._for_us(message):
            return []
        return handler(message, sender, now_s)

    def step(self, now_s: float) -> tuple[list[Message], list[Reply]]:
        """Fly, and return the telemetry for everybody and late acknowledgements."""
        vehicle = self.vehicle
        vehicle.step(now_s)
        if now_s >= self._readiness_due_s and not vehicle.armed:
            self._readiness_due_s = now_s + READINESS_S
            self._tell_readiness(now_s)
        messages, self._out = self._out, []
        if vehicle.alive(now_s) and vehicle.state is not None:
            view = View(vehicle, vehicle.state, now_s)
            shown = (vehicle.mode, vehicle.armed, vehicle.failsafe, vehicle.landed_state)
            if shown != self._shown or now_s - self._beat_s >= HEARTBEAT_S - 1e-3:
                if shown != self._shown:
                    self._streams.hasten(dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE)
                self._shown, self._beat_s = shown, now_s
                messages.append(heartbeat(view))
            messages += self._streams.by_time(view)
        for text in vehicle.texts.take():
            self._text_id = self._text_id % 0xFFFF + 1
            messages += statustexts(text, self._text_id)
            self._said = [*self._said, text][-64:]
        return messages, self._late_replies()

    def take_texts(self) -> list[Text]:
        """What was said since the last call, for the terminal."""
        said, self._said = self._said, []
        return said

    def _tell_readiness(self, now_s: float) -> None:
        """Say what keeps it from arming, when that changes; a number in it that changes does not count."""
        found = self.vehicle.problems(now_s)
        text = f"Not ready: {found[0]}" if found else "Ready to arm"
        kind = re.sub(r"[-+.\d]+", "", text)
        if kind != self._readiness:
            self._readiness = kind
            self.vehicle.texts.say(INFO, text)

    def _late_replies(self) -> list[Reply]:
        if not self._arming_for or self.vehicle.arming:
            return []
        result = ACCEPTED if self.vehicle.armed else REJECTED
        replies = [Reply(to, _ack(_ARM, result, to)) for to in sorted(self._arming_for)]
        self._arming_for.clear()
        return replies

    def _on_state(self, block: StateBlock, at_s: float) -> None:
        timed = self.clock.take(block.time_ms, at_s)
        if timed is None or self.vehicle.link.protocol is None:  # out of order, or the link is being set up
            return
        boot_ms, late_s = timed
        if late_s > LATE_MAX_S:
            self.late += 1
            return
        state = decode_state(block, boot_ms, at_s - late_s)  # as old as it is, not as it came
        self.vehicle.take_state(state, at_s)
        self._out += self._streams.per_state(View(self.vehicle, state, at_s))

    def _on_health(self, block: HealthBlock, at_s: float) -> None:
        self.vehicle.health = decode_health(block, at_s)

    def _for_us(self, message: Any) -> bool:
        system = getattr(message, "target_system", 0)
        return system in (0, self._system_id) and getattr(message, "target_component", 0) in (0, COMPONENT_ID)

    def _on_setpoint(self, message: Any, sender: Sender, now_s: float) -> list[Message]:
        vehicle = self.vehicle
        vehicle.client(now_s)
        yaw = yaw_from_quaternion(vehicle.state.quaternion) if vehicle.state is not None else None
        wish = read_setpoint(message, yaw)
        refused = wish if isinstance(wish, str) else vehicle.take_setpoint(*wish, sender, now_s)
        if refused is not None:
            vehicle.texts.refuse(refused, now_s, "set-point")
        return []

    def _on_command(self, message: Any, sender: Sender, now_s: float) -> list[Message]:
        number = message.command
        if message.target_system == 0 and number != dialect.MAV_CMD_REQUEST_MESSAGE:
            return []
        self.vehicle.client(now_s)
        answer = self._commands.run(number, read_command(message, now_s), sender)
        if answer.reason is not None:
            self.vehicle.texts.refuse(answer.reason, now_s)
        if answer.later:
            if len(self._arming_for) < 8:
                self._arming_for.add(sender)
            return []
        ack = _ack(number, answer.result, sender)
        return [ack] if answer.message is None else [ack, answer.message]

    def _on_set_mode(self, message: Any, sender: Sender, now_s: float) -> list[Message]:
        """SET_MODE, which has no answer but the text."""
        mode = mode_of(message.custom_mode >> 16 & 0xFF, message.custom_mode >> 24 & 0xFF)
        if message.target_system != self._system_id:
            return []
        if mode is None:
            reason: str | None = f"Mode {message.custom_mode:#x} refused: there is none"
        else:
            right = Right.ANYBODY if mode is Mode.LAND else Right.OWNER
            reason = self.vehicle.forbids(sender, right, now_s)
            reason = self.vehicle.set_mode(mode, now_s) if reason is None else f"Mode refused: {reason}"
        if reason is not None:
            self.vehicle.texts.refuse(reason, now_s)
        return []

    def _on_heartbeat(self, message: Any, sender: Sender, now_s: float) -> list[Message]:
        del sender
        if message.autopilot == dialect.MAV_AUTOPILOT_INVALID:  # of a client, not of another vehicle
            self.vehicle.client(now_s)
        return []

    def _on_timesync(self, message: Any, sender: Sender, now_s: float) -> list[Message]:
        del sender
        if message.tc1 != 0 or not self.clock.running:
            return []
        return [dialect.MAVLink_timesync_message(self.clock.now_ns(now_s), message.ts1)]


def _ack(number: int, result: int, sender: Sender) -> Message:
    return dialect.MAVLink_command_ack_message(number, result, 0, 0, *sender)


def _on_ping(message: Any, sender: Sender, now_s: float) -> list[Message]:
    del now_s
    if message.target_system != 0 or message.target_component != 0:
        return []  # an answer
    return [dialect.MAVLink_ping_message(message.time_usec, message.seq, *sender)]

"""Server for one MAVLink vehicle: receives messages with times, returns messages.

Pure: no socket, no clock, no randomness. It behaves like PX4 1.18 (``Commander.cpp``,
``mavlink_receiver.cpp``, ``streams/*.hpp``), except where a comment states a difference.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Generic

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.messages import Message
from bridge.mavlink.server.commander import Right, Sender, Text, read_setpoint
from bridge.mavlink.server.commands import Commands, Entry
from bridge.mavlink.server.parameters import Parameters
from bridge.mavlink.server.telemetry import (
    Builder,
    Snapshot,
    Streams,
    StreamTable,
    V,
    autopilot_version,
    heartbeat,
)  # fmt: skip

SYSTEM_ID = 1
COMPONENT_ID = dialect.MAV_COMP_ID_AUTOPILOT1  # clients look for the autopilot only at this component id
_HEARTBEAT_S = 1.0
_LOG_MAX = 1024  # maximum number of texts that wait for the log
_BROADCAST = frozenset({dialect.MAV_CMD_REQUEST_MESSAGE})  # commands accepted with target system 0 (all)
_NOTHING: frozenset[int] = frozenset()

# Opcodes and errors of FILE_TRANSFER_PROTOCOL (mavlink.io, services/ftp).
_FTP_NAK = 129
_FTP_FAIL = 1
_FTP_BYTES = 251
_FTP_HEADER = 12  # bytes: sequence (2), session, opcode, size, requested opcode, burst, padding, offset (4)
# Types of mission items; the vehicle has no items, so it replies with empty lists.
_TYPES = (dialect.MAV_MISSION_TYPE_MISSION, dialect.MAV_MISSION_TYPE_FENCE, dialect.MAV_MISSION_TYPE_RALLY)
_ALL = dialect.MAV_MISSION_TYPE_ALL
_ITEM_REQUESTS = (dialect.MAVLINK_MSG_ID_MISSION_REQUEST, dialect.MAVLINK_MSG_ID_MISSION_REQUEST_INT)
_MISSIONS = tuple(
    getattr(dialect, f"MAVLINK_MSG_ID_MISSION_{name}")
    for name in (
        "REQUEST", "REQUEST_INT", "REQUEST_LIST", "COUNT", "CLEAR_ALL", "ITEM", "ITEM_INT",
        "WRITE_PARTIAL_LIST", "REQUEST_PARTIAL_LIST",
    )
)  # fmt: skip
_REFUSED_SETPOINTS = {
    dialect.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET: "attitude",
    dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT: "global position",
}

Handler = Callable[[Any, Sender, float], list[Message]]  # (message, sender, time in s) to replies


class Server(ABC, Generic[V]):
    """MAVLink server of one autopilot; a subclass adds the features of its vehicle."""

    def __init__(
        self,
        vehicle: V,
        streams: StreamTable[V],
        parameters: Parameters,
        rate_hz: float,
        *,
        system_id: int = SYSTEM_ID,
    ) -> None:
        """``rate_hz``: rate of the ticks, and maximum rate of every message."""
        self.vehicle, self.parameters = vehicle, parameters
        self.system_id = system_id
        self.streams: Streams[V] = Streams(rate_hz, streams)
        requestable: dict[int, Builder[V]] = {
            **{id_: builder for id_, (builder, _) in streams.items()},
            dialect.MAVLINK_MSG_ID_HEARTBEAT: heartbeat,
            dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION: autopilot_version,
        }
        self.messages = frozenset(requestable)  # ids of the messages that clients may request
        self.commands = Commands(vehicle, self.streams, requestable, self.snapshot, self.own_commands())
        self._handlers: dict[int, Handler] = {
            dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: self._on_setpoint,
            dialect.MAVLINK_MSG_ID_COMMAND_LONG: self._on_command,
            dialect.MAVLINK_MSG_ID_COMMAND_INT: self._on_command,
            dialect.MAVLINK_MSG_ID_SET_MODE: self._on_set_mode,
            dialect.MAVLINK_MSG_ID_TIMESYNC: self._on_timesync,
            dialect.MAVLINK_MSG_ID_HEARTBEAT: lambda *_: [],
            dialect.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: parameters.list_all,
            dialect.MAVLINK_MSG_ID_PARAM_REQUEST_READ: parameters.read,
            dialect.MAVLINK_MSG_ID_PARAM_SET: self._on_parameter_set,
            **dict.fromkeys(_REFUSED_SETPOINTS, self._refuse_setpoint),
            **_REPLIES,
            **self.own_handlers(),
        }
        self._heartbeat_due_s = -math.inf
        self._shown: object = None  # value of ``condition`` at the last HEARTBEAT
        self._landed_shown = vehicle.landed_state
        self._texts_to_log: list[Text] = []

    # Methods that subclasses implement or extend

    @abstractmethod
    def snapshot(self, now_s: float) -> Snapshot[V] | None:
        """Return the present state of the vehicle; None: unknown state, so no telemetry is sent."""

    def heard(self, message: Message, now_s: float) -> None:
        """Take note of a message to this vehicle before its handler runs; a subclass may override this."""

    def own_commands(self) -> dict[int, Entry]:
        """Return commands that extend or replace the common commands."""
        return {}

    def own_handlers(self) -> dict[int, Handler]:
        return {}

    def condition(self, snapshot: Snapshot[V]) -> object:
        """Return a value; when it changes, HEARTBEAT and SYS_STATUS are sent immediately."""
        vehicle = snapshot.vehicle
        return vehicle.mode, vehicle.armed, vehicle.failsafe, snapshot.valid

    def hidden(self, _now_s: float) -> frozenset[int]:
        """Return the ids of the messages that are not sent now."""
        return _NOTHING

    def boot_ns(self, now_s: float) -> int | None:
        return round(now_s * 1e9)

    # Methods that the process calls

    def handle(self, message: Message, sender: Sender, now_s: float) -> list[Message]:
        """Handle a message with a correct checksum, but unchecked content; return the replies."""
        handler = self._handlers.get(message.get_msgId())  # some messages have a field named id
        if handler is None or sender[:2] == (self.system_id, COMPONENT_ID) or not self._for_us(message):
            return []
        self.heard(message, now_s)
        return handler(message, sender, now_s)

    def telemetry(self, now_s: float) -> list[Message]:
        """Return the messages due for all clients: heartbeat, texts, streams, values of a parameter list."""
        snapshot = self.snapshot(now_s)
        messages = self._announced(snapshot, now_s) if snapshot is not None else []
        if self.vehicle.texts.waiting:
            texts = self.vehicle.texts.take()
            for text in texts:
                messages += self.vehicle.texts.messages(text)
            self._texts_to_log = [*self._texts_to_log, *texts][-_LOG_MAX:]
        if snapshot is not None:
            messages += self.streamed(snapshot)
            if self.parameters.left_to_list:
                messages += self.parameters.listing()
        return messages

    def silent_until_s(self, now_s: float, heeded: frozenset[int]) -> float:
        """Return the time before which no message with these ids is due, if the vehicle does not change.

        ``now_s`` is the time of the next tick. Messages sent at every tick do not count.
        """
        if self._calm(now_s) is None:
            return -math.inf
        return min(self._heartbeat_due_s, self.streams.next_s(heeded))

    def brief(self, now_s: float, heeded: frozenset[int]) -> list[Message] | None:
        """Return the due messages with these ids, as ``telemetry`` does, without the messages of every tick.

        Return None, and change no state, if texts, parameters or a change of the vehicle must be sent.
        """
        snapshot = self._calm(now_s)
        if snapshot is None:
            return None
        return [*self._announced(snapshot, now_s), *self.streams.pass_over(snapshot, heeded)]

    def _calm(self, now_s: float) -> Snapshot[V] | None:
        """Return the vehicle's state; None: unknown, or texts, parameters or a change must be sent now."""
        snapshot, texts = self.snapshot(now_s), self.vehicle.texts.waiting or self._texts_to_log
        if snapshot is None or texts or self.parameters.left_to_list:
            return None
        shown = (self.condition(snapshot), self.vehicle.landed_state) == (self._shown, self._landed_shown)
        return snapshot if shown else None

    def streamed(self, snapshot: Snapshot[V]) -> list[Message]:
        self.streams.hide(self.hidden(snapshot.now_s))
        return self.streams.due(snapshot)

    def take_texts(self) -> list[Text]:
        """Return the texts for the log that were sent since the last call."""
        texts, self._texts_to_log = self._texts_to_log, []
        return texts

    def _announced(self, snapshot: Snapshot[V], now_s: float) -> list[Message]:
        """Return HEARTBEAT if it is due or if the condition has changed."""
        shown, landed_state = self.condition(snapshot), self.vehicle.landed_state
        messages = []
        if shown != self._shown or now_s >= self._heartbeat_due_s:
            messages.append(heartbeat(snapshot))
            self._heartbeat_due_s = now_s + _HEARTBEAT_S - 1e-6
            if shown != self._shown:
                self.streams.hasten(dialect.MAVLINK_MSG_ID_SYS_STATUS)
            self._shown = shown
        if landed_state != self._landed_shown:
            self._landed_shown = landed_state
            self.streams.hasten(dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE)
        return messages

    def _for_us(self, message: Any) -> bool:
        """Whether a message is for this system or all systems; a message without an address is for all."""
        system = getattr(message, "target_system", 0)
        return system in (0, self.system_id) and getattr(message, "target_component", 0) in (0, COMPONENT_ID)

    def _on_setpoint(self, message: Any, sender: Sender, now_s: float) -> list[Message]:
        """Handle SET_POSITION_TARGET_LOCAL_NED; the only reply is a text after a refusal."""
        vehicle, setpoint = self.vehicle, read_setpoint(message, self.vehicle.yaw_rad)
        refused = setpoint if isinstance(setpoint, str) else vehicle.take_setpoint(setpoint, sender, now_s)
        if refused is not None:
            vehicle.texts.refuse(refused, now_s, "set-point")
        return []

    def _on_command(self, message: Any, sender: Sender, now_s: float) -> list[Message]:
        if message.target_system == 0 and message.command not in _BROADCAST:
            return []
        return self.commands.run(message, sender, now_s)

    def _on_set_mode(self, message: Any, sender: Sender, now_s: float) -> list[Message]:
        """Handle SET_MODE as DO_SET_MODE; the only reply is a text."""
        if message.target_system == self.system_id:
            main, sub = message.custom_mode >> 16 & 0xFF, message.custom_mode >> 24 & 0xFF
            command = dialect.MAVLink_command_long_message(
                self.system_id, COMPONENT_ID, dialect.MAV_CMD_DO_SET_MODE, 0,
                dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, main, sub, 0.0, 0.0, 0.0, 0.0,
            )  # fmt: skip
            self.commands.run(command, sender, now_s)
        return []

    def _on_timesync(self, message: Any, _sender: Sender, now_s: float) -> list[Message]:
        boot_ns = self.boot_ns(now_s) if message.tc1 == 0 else None  # tc1 != 0 marks a reply
        if boot_ns is None:
            return []
        return [dialect.MAVLink_timesync_message(max(1, boot_ns), message.ts1)]  # 0 would mark a request

    def _on_parameter_set(self, message: Any, sender: Sender, now_s: float) -> list[Message]:
        forbidden = self.vehicle.forbids(sender, Right.OWNER, now_s)
        replies, reason = self.parameters.write(message, sender, forbidden, armed=self.vehicle.armed)
        if reason is not None:
            self.vehicle.texts.refuse(reason, now_s)
        return replies

    def _refuse_setpoint(self, message: Any, _sender: Sender, now_s: float) -> list[Message]:
        kind = _REFUSED_SETPOINTS[message.get_msgId()]
        self.vehicle.texts.refuse(f"Set-point dropped: {kind}, only local velocity", now_s)
        return []


def _ping(message: Any, sender: Sender, _now_s: float) -> list[Message]:
    if message.target_system != 0 or message.target_component != 0:
        return []  # the message is a reply, not a request
    return [dialect.MAVLink_ping_message(message.time_usec, message.seq, *sender[:2])]


def _mission(message: Any, sender: Sender, _now_s: float) -> list[Message]:
    """Reply that there are no mission, fence or rally items; only an empty list is accepted."""
    kind, known = message.get_msgId(), message.mission_type in _TYPES
    if kind == dialect.MAVLINK_MSG_ID_MISSION_REQUEST_LIST and known:
        return [dialect.MAVLink_mission_count_message(*sender[:2], 0, message.mission_type)]
    uploads = kind == dialect.MAVLINK_MSG_ID_MISSION_COUNT and known and not message.count
    clears = kind == dialect.MAVLINK_MSG_ID_MISSION_CLEAR_ALL and (known or message.mission_type == _ALL)
    result = dialect.MAV_MISSION_UNSUPPORTED
    if uploads or clears:
        result = dialect.MAV_MISSION_ACCEPTED
    elif kind in _ITEM_REQUESTS:
        result = dialect.MAV_MISSION_INVALID_SEQUENCE
    return [dialect.MAVLink_mission_ack_message(*sender[:2], result, message.mission_type)]


def _log_list(_message: Any, _sender: Sender, _now_s: float) -> list[Message]:
    return [dialect.MAVLink_log_entry_message(0, 0, 0, 0, 0)]


def _file_transfer(message: Any, sender: Sender, _now_s: float) -> list[Message]:
    request = bytes(message.payload)
    sequence = (int.from_bytes(request[:2], "little") + 1) & 0xFFFF
    reply = bytearray(_FTP_BYTES)
    reply[:2] = sequence.to_bytes(2, "little")
    reply[2:6] = bytes((request[2], _FTP_NAK, 1, request[3]))
    reply[_FTP_HEADER] = _FTP_FAIL
    return [dialect.MAVLink_file_transfer_protocol_message(0, *sender[:2], reply)]


# Replies to other programs. Without a reply to an unsupported protocol, clients would wait and repeat their
# request for seconds. REQUEST_DATA_STREAM has no handler, as in PX4: the rates that MAVProxy and dronekit
# request at their start (4 Hz of every message) would slow down the companion's position stream.
_REPLIES: dict[int, Handler] = {
    dialect.MAVLINK_MSG_ID_PING: _ping,
    **dict.fromkeys(_MISSIONS, _mission),
    dialect.MAVLINK_MSG_ID_LOG_REQUEST_LIST: _log_list,
    dialect.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL: _file_transfer,
}

"""Replies for parameters, ping, and unsupported protocols, which are refused at once.

Without a reply clients would wait and repeat their request for seconds.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.messages import Message, parameter_name
from bridge.mavlink.server.commander import Commander, Right, Sender
from bridge.mavlink.server.parameters import NOT_NOW, Parameters, Refused

Handler = Callable[[Any, Sender, float], list[Message]]

# Opcodes and errors of FILE_TRANSFER_PROTOCOL (mavlink.io, services/ftp).
_FTP_NAK = 129
_FTP_FAIL = 1
_FTP_BYTES = 251
_FTP_HEADER = 12  # bytes: sequence (2), session, opcode, size, requested opcode, burst, padding, offset (4)
# Mission, fence and rally points: known types, of which the vehicle has no items.
_TYPES = frozenset(
    {dialect.MAV_MISSION_TYPE_MISSION, dialect.MAV_MISSION_TYPE_FENCE, dialect.MAV_MISSION_TYPE_RALLY}
)
_ALL = dialect.MAV_MISSION_TYPE_ALL
_ITEM_REQUESTS = (dialect.MAVLINK_MSG_ID_MISSION_REQUEST, dialect.MAVLINK_MSG_ID_MISSION_REQUEST_INT)
_ITEMS = (
    dialect.MAVLINK_MSG_ID_MISSION_ITEM,
    dialect.MAVLINK_MSG_ID_MISSION_ITEM_INT,
    dialect.MAVLINK_MSG_ID_MISSION_WRITE_PARTIAL_LIST,
    dialect.MAVLINK_MSG_ID_MISSION_REQUEST_PARTIAL_LIST,
)
_REFUSED_SETPOINTS = {
    dialect.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET: "attitude",
    dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT: "global position",
}


class Services:
    """Handlers by message id; each returns the reply to the sender.

    REQUEST_DATA_STREAM has no handler, as in PX4: the rates that MAVProxy and dronekit request at their start
    (4 Hz of every message) would slow down the companion's position stream.
    """

    def __init__(self, vehicle: Commander, parameters: Parameters) -> None:
        self._vehicle, self._parameters = vehicle, parameters
        m = dialect
        self.handlers: dict[int, Handler] = {
            m.MAVLINK_MSG_ID_PING: _ping,
            m.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: self._parameter_list,
            m.MAVLINK_MSG_ID_PARAM_REQUEST_READ: self._parameter_read,
            m.MAVLINK_MSG_ID_PARAM_SET: self._parameter_set,
            m.MAVLINK_MSG_ID_MISSION_REQUEST_LIST: _mission_list,
            m.MAVLINK_MSG_ID_MISSION_COUNT: _mission_change,
            m.MAVLINK_MSG_ID_MISSION_CLEAR_ALL: _mission_change,
            **dict.fromkeys((*_ITEM_REQUESTS, *_ITEMS), _mission_refused),
            m.MAVLINK_MSG_ID_LOG_REQUEST_LIST: _log_list,
            m.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL: _file_transfer,
            **dict.fromkeys(_REFUSED_SETPOINTS, self._refuse_setpoint),
        }

    def _parameter_list(self, _message: Any, _sender: Sender, _now_s: float) -> list[Message]:
        self._parameters.list_all()  # sent with the telemetry of the next ticks
        return []

    def _parameter_read(self, message: Any, sender: Sender, _now_s: float) -> list[Message]:
        name = self._parameters.find(parameter_name(message.param_id), message.param_index)
        return [_no_parameter(message, sender)] if name is None else [self._parameters.message(name)]

    def _parameter_set(self, message: Any, sender: Sender, now_s: float) -> list[Message]:
        name = self._parameters.find(parameter_name(message.param_id), -1)
        if name is None:
            return [_no_parameter(message, sender)]
        forbidden = self._vehicle.forbids(sender, Right.OWNER, now_s)
        if forbidden is not None:
            refused: Refused | None = Refused(NOT_NOW, f"{name} refused: {forbidden}")
        else:
            refused = self._parameters.set(
                name, message.param_value, message.param_type, armed=self._vehicle.armed
            )
        in_force = self._parameters.message(name)
        if refused is None:
            return [in_force]
        self._vehicle.texts.refuse(refused.reason, now_s)
        # The error is sent first: MAVSDK treats a different value as a lost write and repeats it five times.
        return [_parameter_error(name.encode(), -1, refused.error, sender), in_force]

    def _refuse_setpoint(self, message: Any, _sender: Sender, now_s: float) -> list[Message]:
        kind = _REFUSED_SETPOINTS[message.get_msgId()]
        self._vehicle.texts.refuse(f"Set-point dropped: {kind}, only local velocity", now_s)
        return []


def _no_parameter(message: Any, sender: Sender) -> Message:
    """Return an error; PX4 sends no reply, and clients wait for seconds (mavlink.io, services/parameter)."""
    index = getattr(message, "param_index", -1)
    name = parameter_name(message.param_id).encode("ascii", "replace")
    return _parameter_error(name, index, dialect.MAV_PARAM_ERROR_DOES_NOT_EXIST, sender)


def _parameter_error(name: bytes, index: int, error: int, sender: Sender) -> Message:
    return dialect.MAVLink_param_error_message(*sender[:2], name, index, error)


def _ping(message: Any, sender: Sender, _now_s: float) -> list[Message]:
    if message.target_system != 0 or message.target_component != 0:
        return []  # the message is a reply, not a request
    return [dialect.MAVLink_ping_message(message.time_usec, message.seq, *sender[:2])]


def _mission_list(message: Any, sender: Sender, _now_s: float) -> list[Message]:
    """Reply to MISSION_REQUEST_LIST: there are no items."""
    if message.mission_type not in _TYPES:
        return _mission_ack(message, sender, dialect.MAV_MISSION_UNSUPPORTED)
    return [dialect.MAVLink_mission_count_message(*sender[:2], 0, message.mission_type)]


def _mission_change(message: Any, sender: Sender, _now_s: float) -> list[Message]:
    """Reply to MISSION_COUNT (start of an upload) and MISSION_CLEAR_ALL: only an empty list is accepted."""
    clears = message.get_msgId() == dialect.MAVLINK_MSG_ID_MISSION_CLEAR_ALL
    known = message.mission_type in _TYPES or (clears and message.mission_type == _ALL)
    taken = known and (clears or not message.count)
    result = dialect.MAV_MISSION_ACCEPTED if taken else dialect.MAV_MISSION_UNSUPPORTED
    return _mission_ack(message, sender, result)


def _mission_refused(message: Any, sender: Sender, _now_s: float) -> list[Message]:
    """Refuse mission items: none exists, and none was requested."""
    wanted = message.get_msgId() in _ITEM_REQUESTS
    result = dialect.MAV_MISSION_INVALID_SEQUENCE if wanted else dialect.MAV_MISSION_UNSUPPORTED
    return _mission_ack(message, sender, result)


def _mission_ack(message: Any, sender: Sender, result: int) -> list[Message]:
    return [dialect.MAVLink_mission_ack_message(*sender[:2], result, message.mission_type)]


def _log_list(_message: Any, _sender: Sender, _now_s: float) -> list[Message]:
    return [dialect.MAVLink_log_entry_message(0, 0, 0, 0, 0)]


def _file_transfer(message: Any, sender: Sender, _now_s: float) -> list[Message]:
    asked = bytes(message.payload)
    sequence = (int.from_bytes(asked[:2], "little") + 1) & 0xFFFF
    reply = bytearray(_FTP_BYTES)
    reply[:2] = sequence.to_bytes(2, "little")
    reply[2:6] = bytes((asked[2], _FTP_NAK, 1, asked[3]))
    reply[_FTP_HEADER] = _FTP_FAIL
    return [dialect.MAVLink_file_transfer_protocol_message(0, *sender[:2], reply)]

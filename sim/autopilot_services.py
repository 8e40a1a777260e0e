"""The small protocols around flying: parameters, clock, ping, and honest noes to missions and files."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.decoding import Message
from sim.autopilot_flight import Flight
from sim.autopilot_parameters import Parameters
from sim.autopilot_setpoints import Sender

# FILE_TRANSFER_PROTOCOL payload (mavlink.io, services/ftp): silence would cost clients seconds of retries.
_FTP_NAK = 129
_FTP_FAIL = 1
_FTP_BYTES = 251
_FTP_HEADER = 12  # bytes: sequence (2), session, opcode, size, requested opcode, burst, padding, offset (4)

Handler = Callable[[Any, Sender, float], list[Message]]


class Services:
    """Handlers by message id; each returns the answer to the sender."""

    def __init__(self, flight: Flight, parameters: Parameters) -> None:
        self._flight = flight
        self._parameters = parameters
        m = dialect
        self.handlers: dict[int, Handler] = {
            m.MAVLINK_MSG_ID_TIMESYNC: _timesync,
            m.MAVLINK_MSG_ID_PING: _ping,
            m.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: self._parameter_list,
            m.MAVLINK_MSG_ID_PARAM_REQUEST_READ: self._parameter_read,
            m.MAVLINK_MSG_ID_PARAM_SET: self._parameter_set,
            m.MAVLINK_MSG_ID_MISSION_REQUEST_LIST: _mission_list,
            m.MAVLINK_MSG_ID_MISSION_COUNT: _mission_count,
            m.MAVLINK_MSG_ID_MISSION_CLEAR_ALL: _mission_clear,
            m.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL: _file_transfer,
        }

    def _parameter_list(self, message: Any, sender: Sender, now_s: float) -> list[Message]:
        del message, sender, now_s
        return self._parameters.messages()

    def _parameter_read(self, message: Any, sender: Sender, now_s: float) -> list[Message]:
        del sender, now_s
        name = self._parameters.find(_text(message.param_id), message.param_index)
        return [] if name is None else [self._parameters.message(name)]

    def _parameter_set(self, message: Any, sender: Sender, now_s: float) -> list[Message]:
        del sender, now_s
        name = self._parameters.find(_text(message.param_id), -1)
        if name is None:
            return []  # as PX4: the client sees that nothing comes
        reason = self._parameters.set(
            name, message.param_value, message.param_type, armed=self._flight.vehicle.armed
        )
        if reason is not None:
            self._flight.say(dialect.MAV_SEVERITY_WARNING, reason)
        return [self._parameters.message(name)]  # the value in force, whatever was asked


def _text(field: str | bytes) -> str:
    raw = field.encode("latin-1", "replace") if isinstance(field, str) else bytes(field)
    return raw.partition(b"\x00")[0].decode("ascii", "replace")


def _timesync(message: Any, sender: Sender, now_s: float) -> list[Message]:
    del sender
    if message.tc1 != 0:
        return []  # an answer
    return [dialect.MAVLink_timesync_message(max(1, round(now_s * 1e9)), message.ts1)]  # 0 would ask back


def _ping(message: Any, sender: Sender, now_s: float) -> list[Message]:
    del now_s
    if message.target_system != 0 or message.target_component != 0:
        return []  # an answer
    return [dialect.MAVLink_ping_message(message.time_usec, message.seq, *sender)]


def _mission_list(message: Any, sender: Sender, now_s: float) -> list[Message]:
    del now_s
    return [dialect.MAVLink_mission_count_message(*sender, 0, message.mission_type)]


def _mission_count(message: Any, sender: Sender, now_s: float) -> list[Message]:
    del now_s
    result = dialect.MAV_MISSION_UNSUPPORTED if message.count else dialect.MAV_MISSION_ACCEPTED
    return [dialect.MAVLink_mission_ack_message(*sender, result, message.mission_type)]


def _mission_clear(message: Any, sender: Sender, now_s: float) -> list[Message]:
    del now_s
    return [dialect.MAVLink_mission_ack_message(*sender, dialect.MAV_MISSION_ACCEPTED, message.mission_type)]


def _file_transfer(message: Any, sender: Sender, now_s: float) -> list[Message]:
    del now_s
    asked = bytes(message.payload)
    sequence = (int.from_bytes(asked[:2], "little") + 1) & 0xFFFF
    answer = bytearray(_FTP_BYTES)
    answer[:2] = sequence.to_bytes(2, "little")
    answer[2:6] = bytes((asked[2], _FTP_NAK, 1, asked[3]))
    answer[_FTP_HEADER] = _FTP_FAIL
    return [dialect.MAVLink_file_transfer_protocol_message(0, *sender, answer)]

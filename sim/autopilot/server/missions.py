"""Missions and files: the autopilot has none, and says so at once instead of letting clients wait."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.decoding import Message
from sim.autopilot.owner import Sender

# FILE_TRANSFER_PROTOCOL payload (mavlink.io, services/ftp): silence would cost clients seconds of retries.
_FTP_NAK = 129
_FTP_FAIL = 1
_FTP_BYTES = 251
_FTP_HEADER = 12  # bytes: sequence (2), session, opcode, size, requested opcode, burst, padding, offset (4)
# Mission, fence and rally points; of these there are none, other types are not known.
_TYPES = frozenset(
    {dialect.MAV_MISSION_TYPE_MISSION, dialect.MAV_MISSION_TYPE_FENCE, dialect.MAV_MISSION_TYPE_RALLY}
)
_ALL = dialect.MAV_MISSION_TYPE_ALL


def mission_list(message: Any, sender: Sender, now_s: float) -> list[Message]:
    """MISSION_REQUEST_LIST: empty."""
    del now_s
    if message.mission_type not in _TYPES:
        return _ack(message, sender, dialect.MAV_MISSION_UNSUPPORTED)
    return [dialect.MAVLink_mission_count_message(*sender, 0, message.mission_type)]


def mission_count(message: Any, sender: Sender, now_s: float) -> list[Message]:
    """MISSION_COUNT, the beginning of an upload: only an empty one is taken."""
    del now_s
    known = message.mission_type in _TYPES and not message.count
    return _ack(message, sender, dialect.MAV_MISSION_ACCEPTED if known else dialect.MAV_MISSION_UNSUPPORTED)


def mission_clear(message: Any, sender: Sender, now_s: float) -> list[Message]:
    """MISSION_CLEAR_ALL: it is empty."""
    del now_s
    known = message.mission_type in _TYPES or message.mission_type == _ALL
    return _ack(message, sender, dialect.MAV_MISSION_ACCEPTED if known else dialect.MAV_MISSION_UNSUPPORTED)


def mission_item_wanted(message: Any, sender: Sender, now_s: float) -> list[Message]:
    """MISSION_REQUEST, MISSION_REQUEST_INT: there is no such item."""
    del now_s
    return _ack(message, sender, dialect.MAV_MISSION_INVALID_SEQUENCE)


def mission_refused(message: Any, sender: Sender, now_s: float) -> list[Message]:
    """Items nobody asked for, and parts of a mission."""
    del now_s
    return _ack(message, sender, dialect.MAV_MISSION_UNSUPPORTED)


def log_list(message: Any, sender: Sender, now_s: float) -> list[Message]:
    """LOG_REQUEST_LIST: no logs on board."""
    del message, sender, now_s
    return [dialect.MAVLink_log_entry_message(0, 0, 0, 0, 0)]


def file_transfer(message: Any, sender: Sender, now_s: float) -> list[Message]:
    """FILE_TRANSFER_PROTOCOL: NAK."""
    del now_s
    asked = bytes(message.payload)
    sequence = (int.from_bytes(asked[:2], "little") + 1) & 0xFFFF
    reply = bytearray(_FTP_BYTES)
    reply[:2] = sequence.to_bytes(2, "little")
    reply[2:6] = bytes((asked[2], _FTP_NAK, 1, asked[3]))
    reply[_FTP_HEADER] = _FTP_FAIL
    return [dialect.MAVLink_file_transfer_protocol_message(0, *sender, reply)]


def _ack(message: Any, sender: Sender, result: int) -> list[Message]:
    return [dialect.MAVLink_mission_ack_message(*sender, result, message.mission_type)]

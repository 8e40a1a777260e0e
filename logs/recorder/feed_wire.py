"""Records on the local socket between the processes of a run and the flight recorder.

A stream of records, each a fixed header and a payload. The header carries the times and the sequence
number, so the recorder never parses the payload of a message.
"""

from __future__ import annotations

import json
import struct
from enum import IntEnum
from typing import NamedTuple

HEADER = struct.Struct("<IHHqqI")  # payload length, kind, channel, log time ns, publish time ns, sequence
SOCKET_PATH_MAX = 107  # bytes (unix(7))
MAX_PAYLOAD = 16 * 2**20  # bytes; a longer one is a broken stream, not a message


class Kind(IntEnum):
    """What a record's payload is."""

    DECLARE = 0  # JSON {"topic", "schema"}; the channel number is the sender's
    MESSAGE = 1  # CDR with its four-byte header
    METADATA = 2  # JSON {"name", "values": {str: str}}
    ATTACHMENT = 3  # one line of JSON {"name", "media_type"}, then the data
    LOSSES = 4  # JSON {"client", "dropped"}: records the sender had to drop so far; also its introduction
    GOODBYE = 5  # orderly end


class Record(NamedTuple):
    kind: int
    channel: int
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    payload: bytes


class WireError(ValueError):
    """A stream that is not made of records; the client that sent it cannot be followed any further."""


def encode(
    kind: Kind, channel: int, log_time_ns: int, publish_time_ns: int, sequence: int, payload: bytes
) -> bytes:
    return HEADER.pack(len(payload), kind, channel, log_time_ns, publish_time_ns, sequence) + payload


def encode_json(kind: Kind, channel: int, log_time_ns: int, content: object) -> bytes:
    return encode(kind, channel, log_time_ns, log_time_ns, 0, json.dumps(content).encode())


class Splitter:
    """Cuts the byte stream of one client into records."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    @property
    def pending(self) -> int:
        return len(self._buffer)

    def feed(self, data: bytes) -> list[Record]:
        """Add bytes and return the records that are whole now, in order."""
        buffer = self._buffer
        buffer += data
        records: list[Record] = []
        at, end, size = 0, len(buffer), HEADER.size
        with memoryview(buffer) as view:
            while end - at >= size:
                length, kind, channel, log_time_ns, publish_time_ns, sequence = HEADER.unpack_from(buffer, at)
                if length > MAX_PAYLOAD:
                    raise WireError(f"record of {length} bytes; at most {MAX_PAYLOAD} are allowed")
                after = at + size + length
                if after > end:
                    break
                payload = view[at + size : after].tobytes()
                records.append(Record(kind, channel, log_time_ns, publish_time_ns, sequence, payload))
                at = after
        del buffer[:at]
        return records

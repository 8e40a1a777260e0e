"""Decodes recorded MAVLink frames into messages with named fields.

The decoder reads the bytes of the raw record (``logs.schema.mavlink``) directly: frames are most of a log.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import NamedTuple

from logs.schema.mavlink import PEER_CHARACTERS, FrameError, Type, of

TOPICS_MAX = 512  # greatest number of topics, since a sender can invent system ids
_HEADER_BYTES = 20  # length of encapsulation, stamp and frame_id of three characters; fields follow aligned
_NOBODY = struct.pack("<I", PEER_CHARACTERS + 1) + b"p--\x00"  # frame_id of a frame with unknown peer
# Offsets in the raw record.
_NAME_LENGTH_AT = 12
_FIXED_AT, _FIXED_NOBODY_AT = 20, 17  # offset of framing_status with a peer name, and without one
_LENGTH, _SENDER = 2, 6  # offsets from there: payload length, system and component
_ID_AT = 28  # offset of the message id
_WORDS_END, _PAYLOAD_AT = 40, 44


def _fixed_at(payload: bytes) -> int:
    return _FIXED_AT if payload[_NAME_LENGTH_AT] == PEER_CHARACTERS + 1 else _FIXED_NOBODY_AT


class Decoded(NamedTuple):
    topic: str
    type: Type


class FrameDecoder:
    """Converts records of raw frames into messages with named fields."""

    def __init__(self, topic: str) -> None:
        """Set the topic of the raw frames; its first part is the name space until the run sets one."""
        self.topic = topic  # topic of the raw frames
        self._space = "/" + topic.strip("/").partition("/")[0]
        self._known: dict[bytes, Decoded | None] = {}

    def configure(self, onboard: Mapping[str, str]) -> None:
        """Set the name space from the metadata of the onboard process."""
        if "namespace" in onboard:
            self._space = "/" + onboard["namespace"].strip("/")
            self._known.clear()

    def step(self, log_time_ns: int, payload: bytes) -> list[tuple[str, str, bytes]]:
        """Return (topic, schema, CDR) for one record of :func:`logs.schema.mavlink.pack_mavlink`."""
        del log_time_ns
        if len(payload) < _WORDS_END:
            raise FrameError(f"frame record of {len(payload)} bytes is cut short")
        at = _fixed_at(payload)
        key = payload[at + _SENDER : at + _SENDER + 2] + payload[_ID_AT : _ID_AT + 4]
        known = self._known[key] if key in self._known else self._meet(key)
        if known is None:
            return []
        length, kind = payload[at + _LENGTH], known.type
        body = payload[_PAYLOAD_AT : _PAYLOAD_AT + min(length, kind.size)]
        head = payload[:_HEADER_BYTES] if at == _FIXED_AT else payload[:_NAME_LENGTH_AT] + _NOBODY
        body = body.ljust(kind.size, b"\x00")
        return [(known.topic, kind.schema, head + (body if kind.verbatim else repacked(kind, body)))]

    def _meet(self, key: bytes) -> Decoded | None:
        """Return the topic of a new sender or message; None: the dialect does not have the message."""
        system, component, number = struct.unpack("<BBI", key)
        kind = of(number)
        found = None
        if len(self._known) < TOPICS_MAX:
            if kind is not None:
                topic = f"{self._space}/mavlink/sys{system}/comp{component}/{kind.message}"
                found = Decoded(topic, kind)
            self._known[key] = found
        return found


def repacked(kind: Type, payload: bytes) -> bytes:
    """Return a MAVLink payload as the body of a CDR message, with strings and CDR's alignment."""
    out = bytearray()
    at = 0
    for field in kind.fields:
        size = field.size * max(1, field.array)
        raw = payload[at : at + size]
        at += size
        if field.kind == "string":
            text = raw.partition(b"\x00")[0].decode("utf-8", "replace").encode() + b"\x00"
            out += bytes(-len(out) % 4) + struct.pack("<I", len(text)) + text
        else:
            out += bytes(-len(out) % field.size) + raw  # both encodings are little-endian
    return bytes(out)

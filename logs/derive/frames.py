"""Decodes recorded MAVLink frames into messages with named fields."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import NamedTuple

from logs.schema.mavlink import PEER_CHARACTERS, Type, of, parts, peer_of, unpack_mavlink

TOPICS_MAX = 512  # greatest number of topics, since a sender can invent system ids
_STAMP_BYTES = 12  # length of encapsulation and stamp
_HEADER_BYTES = 20  # the same with a frame_id of three characters; fields follow aligned
_NOBODY = struct.pack("<I", PEER_CHARACTERS + 1) + b"p--\x00"  # frame_id of a frame with unknown peer


class Decoded(NamedTuple):
    topic: str
    type: Type


class FrameDecoder:
    """Converts records of raw frames into messages with named fields."""

    def __init__(self, topic: str) -> None:
        """Set the topic of the raw frames; its first part is the name space until the run sets one."""
        self.topic = topic  # topic of the raw frames
        self._space = "/" + topic.strip("/").partition("/")[0]
        self._known: dict[tuple[int, int, int], Decoded | None] = {}

    def configure(self, onboard: Mapping[str, str]) -> None:
        """Set the name space from the metadata of the onboard process."""
        if "namespace" in onboard:
            self._space = "/" + onboard["namespace"].strip("/")
            self._known.clear()

    def step(self, log_time_ns: int, payload: bytes) -> list[tuple[str, str, bytes]]:
        """Return (topic, schema, CDR) for one record of :func:`logs.schema.mavlink.pack_mavlink`."""
        del log_time_ns
        frame = parts(unpack_mavlink(payload)[1])
        key = (frame.system, frame.component, frame.number)
        known = self._known[key] if key in self._known else self._meet(*key)
        if known is None:
            return []
        kind = known.type
        head = payload[:_HEADER_BYTES] if peer_of(payload) else payload[:_STAMP_BYTES] + _NOBODY
        body = frame.payload[: kind.size].ljust(kind.size, b"\x00")
        return [(known.topic, kind.schema, head + (body if kind.verbatim else repacked(kind, body)))]

    def _meet(self, system: int, component: int, number: int) -> Decoded | None:
        """Return the topic of a new sender or message; None: the dialect does not have the message."""
        kind = of(number)
        found = None
        if len(self._known) < TOPICS_MAX:
            if kind is not None:
                topic = f"{self._space}/mavlink/sys{system}/comp{component}/{kind.message}"
                found = Decoded(topic, kind)
            self._known[system, component, number] = found
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

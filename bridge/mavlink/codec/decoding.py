"""Turns a checked MAVLink 2 frame into pymavlink's message object, at half the cost of pymavlink's decode.

``framing`` has checked checksum and length of the frame. Here the payload is unpacked, and its fields, which
are sorted by size on the wire, are put into the order of the constructor. The result equals that of
``MAVLink.decode`` for every message of the dialect (tested).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.wide_messages import MESSAGES

Message = Any  # an instance of one of pymavlink's generated classes, which carry no types

_HEADER = struct.Struct("<xBBBBBBHB")
_HEADER_BYTES = 10
_SIGNED = 0x01


@dataclass(frozen=True, slots=True)
class _Layout:
    """Layout of a message: position of each constructor argument in the unpacked tuple."""

    make: Any
    unpacker: struct.Struct
    size: int
    fields: tuple[tuple[int, int], ...]  # (first, last + 1) in the tuple; a scalar or string spans one
    plain: tuple[int, ...] | None  # positions alone, when there are neither arrays nor strings


def message_id(frame: bytes) -> int:
    """Message id in the header of a frame of version 2."""
    return frame[7] | frame[8] << 8 | frame[9] << 16


def parameter_name(field: str | bytes) -> str:
    """Name of a parameter up to its first zero byte; bytes that are not ASCII become U+FFFD."""
    raw = field.encode("latin-1", "replace") if isinstance(field, str) else bytes(field)
    return raw.partition(b"\x00")[0].decode("ascii", "replace")


def decode(frame: bytes) -> Message:
    """Decode one frame from ``split_frames``.

    Raises KeyError: the message is not known; Exception: of a message class for its field values.
    """
    length, incompat, compat, sequence, system, component, id_low, id_high = _HEADER.unpack_from(frame)
    id_ = id_low | id_high << 16
    layout = _LAYOUTS[id_]
    end = _HEADER_BYTES + length
    payload = frame[_HEADER_BYTES:end]
    # The sender omits trailing zeros; fields that a newer dialect has appended are dropped here.
    if length != layout.size:
        payload = payload[: layout.size].ljust(layout.size, b"\x00")
    values = layout.unpacker.unpack(payload)
    if layout.plain is not None:
        message = layout.make(*[values[i] for i in layout.plain])
    else:
        message = layout.make(*[_field(values, first, stop) for first, stop in layout.fields])
    message._msgbuf = bytearray(frame)
    message._payload = message._msgbuf[6:end]  # as pymavlink, which counts from a version 1 header
    message._crc = frame[end] | frame[end + 1] << 8
    message._header = dialect.MAVLink_header(id_, incompat, compat, length, sequence, system, component)
    return message


def _field(values: tuple[Any, ...], first: int, stop: int) -> Any:
    if stop - first > 1:
        return list(values[first:stop])
    value = values[first]
    return value.rstrip(b"\x00") if isinstance(value, bytes) else value


def _layout(cls: Any) -> _Layout:
    # ``lengths`` are in wire order, one entry a field; a string of n bytes is one value of the tuple.
    starts: list[int] = []
    spans: list[int] = []
    at = 0
    for length, kind in zip(cls.lengths, _wire_kinds(cls), strict=True):
        span = 1 if kind == "char" else max(1, length)
        starts.append(at)
        spans.append(span)
        at += span
    fields = tuple((starts[i], starts[i] + spans[i]) for i in cls.orders)
    scalar = all(span == 1 for span in spans) and "char" not in cls.fieldtypes
    return _Layout(
        cls, cls.unpacker, cls.unpacker.size, fields, tuple(f[0] for f in fields) if scalar else None
    )


def _wire_kinds(cls: Any) -> list[str]:
    kind_of = dict(zip(cls.fieldnames, cls.fieldtypes, strict=True))
    return [kind_of[name] for name in cls.ordered_fieldnames]


_LAYOUTS: dict[int, _Layout] = {id_: _layout(cls) for id_, cls in MESSAGES.items()}

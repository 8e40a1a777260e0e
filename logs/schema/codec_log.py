"""CDR packer for ``rcl_interfaces/msg/Log``, the events of ``/rosout``."""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import NamedTuple

ONBOARD, CONTROLLER = "onboard", "controller"  # who speaks; what the controller says is part of its decisions

_NS = 1_000_000_000  # nanoseconds in a second
_PREFIX = struct.Struct("<4siIB3x")  # encapsulation, stamp, level, padding to the first string
_U32 = struct.Struct("<I")
_PADDING = (b"", b"\x00\x00\x00", b"\x00\x00", b"\x00")  # to a multiple of four, by remainder


class Severity(IntEnum):
    """Levels of ``rcl_interfaces/msg/Log``."""

    DEBUG = 10
    INFO = 20
    WARN = 30
    ERROR = 40
    FATAL = 50


class LogRow(NamedTuple):
    """One event."""

    stamp_ns: int
    level: int
    name: str
    message: str
    file: str
    function: str
    line: int


def pack_log(
    stamp_ns: int,
    level: int,
    name: str,
    message: str,
    file: str = "",
    function: str = "",
    line: int = 0,
) -> bytes:
    """Return an event as CDR; ``name`` is the part of the stack that speaks."""
    seconds, nanoseconds = divmod(stamp_ns, _NS)
    parts = [_PREFIX.pack(b"\x00\x01\x00\x00", seconds, nanoseconds, level)]
    for text in (name, message, file, function):
        raw = text.encode() + b"\x00"
        parts += (_U32.pack(len(raw)), raw, _PADDING[len(raw) & 3])
    parts.append(_U32.pack(line))
    return b"".join(parts)


def pack_string(text: str) -> bytes:
    """Return a ``std_msgs/msg/String`` as CDR."""
    raw = text.encode() + b"\x00"
    return b"\x00\x01\x00\x00" + _U32.pack(len(raw)) + raw


def unpack_log(data: bytes) -> LogRow:
    """Return the event in a CDR payload.

    Raises:
        ValueError: Cut short, or not little-endian CDR.
    """
    try:
        header, seconds, nanoseconds, level = _PREFIX.unpack_from(data, 0)
        if header[:2] != b"\x00\x01":
            raise ValueError(f"not little-endian CDR: begins with {bytes(header).hex()}")
        at, texts = _PREFIX.size, []
        for _ in range(4):
            (length,) = _U32.unpack_from(data, at)
            raw = data[at + 4 : at + 4 + length]
            if len(raw) != length:
                raise ValueError(f"text of {length} bytes cut short after {len(raw)}")
            texts.append(raw[:-1].decode())
            at += 4 + length + (-length & 3)
        (line,) = _U32.unpack_from(data, at)
    except struct.error as error:
        raise ValueError(f"event of {len(data)} bytes is cut short: {error}") from error
    name, message, file, function = texts
    return LogRow(seconds * _NS + nanoseconds, level, name, message, file, function, line)

"""Texts of the vehicle: STATUSTEXT, which splits long texts into chunks, and PX4's events.

PX4 sends an event as a number with arguments (MAVLink EVENT) on every link, and its text as STATUSTEXT only
to a ground station. ``px4_events.json`` holds these texts (with release and licence); ``python -m
tests.tables px4_events FILE`` makes this file from the metadata of a PX4 build. An event outside the table is
shown as its number. Format: github.com/mavlink/libevents, README.
"""

from __future__ import annotations

import re
import struct
from functools import cache
from importlib.resources import files

import msgspec

from bridge.mavlink.codec.messages import Message

_CHUNK = 50  # number of characters of a full chunk; a shorter chunk ends the text
_CHUNKS_MAX = 16  # maximum number of chunks of a text: 800 characters


class TextAssembler:
    """Joins the chunks of one text at a time, as PX4 sends them."""

    def __init__(self) -> None:
        self._id = 0
        self._severity = 0
        self._next = 0
        self._parts: list[str] = []

    def add(self, message: Message) -> list[tuple[int, str]]:
        """Add a STATUSTEXT; return the completed (severity, text). An incomplete text ends in " ..."."""
        texts: list[tuple[int, str]] = []
        if self._parts and (message.id != self._id or message.chunk_seq != self._next):
            texts.append(self._take(" ..."))
        if message.id == 0 and not self._parts:
            return [*texts, (message.severity, clean(message.text))]
        self._id, self._severity, self._next = message.id, message.severity, message.chunk_seq + 1
        self._parts.append(message.text)
        if len(message.text) < _CHUNK or len(self._parts) == _CHUNKS_MAX:
            texts.append(self._take(""))
        return texts

    def _take(self, mark: str) -> tuple[int, str]:
        text = clean("".join(self._parts)) + mark
        self._parts = []
        return (self._severity, text)


def clean(text: str) -> str:
    """Return only printable characters, because text from the network is shown in terminals and logs."""
    return "".join(c if c.isprintable() else " " for c in text).strip()


EVENT = 410  # message id; pymavlink has no name for it
_SHOWN_MAX = 7  # highest log level that is a MAV_SEVERITY; higher levels: protocol, disabled
_ARGUMENT = re.compile(r"\{(\d+)(?::\.(\d+))?(m\^2|m/s|m_v|m|C)?\}")
# code of the module ``struct`` by MAVLink type
_CODES = {
    "uint8_t": "B", "int8_t": "b", "uint16_t": "H", "int16_t": "h", "uint32_t": "I", "int32_t": "i",
    "float": "f", "uint64_t": "Q", "int64_t": "q",
}  # fmt: skip
_UNITS = {None: "", "m": " m", "m_v": " m", "m^2": " m²", "m/s": " m/s", "C": " °C"}
_TAG = re.compile(r"(?<!\\)</?[a-z][^>]*>")
_ESCAPED = re.compile(r"\\(.)")


class _Enum(msgspec.Struct, array_like=True):
    kind: str  # integer type of the enumeration
    is_bitfield: bool
    entries: dict[int, str]

    def text(self, value: int) -> str:
        """Return the text of a value; for a bit field, the texts of all its bits."""
        if not self.is_bitfield:
            return self.entries.get(value, str(value))
        return ", ".join(text for bit, text in self.entries.items() if value & bit) or str(value)


class _Table(msgspec.Struct):
    events: dict[int, list[str]]  # text and argument types by event id
    enums: dict[str, _Enum]


def event_text(message: Message) -> tuple[int, str] | None:
    """Return MAV_SEVERITY and text of an EVENT; None if the event is not meant for people."""
    severity: int = message.log_levels & 0x0F  # bits 0 to 3: external level; bits 4 to 7: internal level
    if severity > _SHOWN_MAX:
        return None
    known = _table().events.get(message.id)
    if known is None:
        return severity, f"event {message.id:#010x} of the autopilot, which this release does not know"
    template, *kinds = known
    return severity, clean(_filled(template, _values(kinds, bytes(message.arguments))))


def _values(kinds: list[str], data: bytes) -> list[float | str]:
    """Decode the arguments of an event: little-endian, without padding."""
    enums = [_table().enums.get(kind) for kind in kinds]
    codes = (_CODES[enum.kind if enum else kind] for enum, kind in zip(enums, kinds, strict=True))
    numbers = struct.unpack_from("<" + "".join(codes), data)
    return [enum.text(n) if enum else n for enum, n in zip(enums, numbers, strict=True)]


def _filled(template: str, values: list[float | str]) -> str:
    def argument(match: re.Match[str]) -> str:
        index, digits, unit = int(match[1]) - 1, match[2], match[3]
        if not 0 <= index < len(values):
            return match[0]
        value = values[index]
        if isinstance(value, float):
            value = f"{value:.{digits}f}" if digits is not None else f"{value:g}"
        return f"{value}{_UNITS[unit]}"

    return _ESCAPED.sub(r"\1", _ARGUMENT.sub(argument, _TAG.sub("", template)))


@cache
def _table() -> _Table:
    """Return the table of events; the first call reads the file, which takes a millisecond."""
    data = files("bridge.mavlink.client").joinpath("px4_events.json").read_bytes()
    return msgspec.json.decode(data, type=_Table)

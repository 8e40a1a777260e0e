"""MAVLink's messages as pymavlink's classes, and their decoding from checked MAVLink 2 frames.

``wide_messages.json`` holds messages that pymavlink's dialect ``ardupilotmega`` lacks: those of its dialect
``all`` (which takes 0.6 s to load), and messages of MAVLink's ``common`` that PX4 sends and pymavlink lacks.
``python -m tests.tables messages`` updates the first group and keeps the second.

They are added to pymavlink's table, so its parser decodes them.
"""

from __future__ import annotations

import struct
from importlib.resources import files
from typing import Any

import msgspec
from pymavlink.dialects.v20 import ardupilotmega as dialect

# code of the module ``struct`` by MAVLink type
CODES = {
    "char": "c", "uint8_t": "B", "int8_t": "b", "uint16_t": "H", "int16_t": "h", "uint32_t": "I",
    "int32_t": "i", "float": "f", "uint64_t": "Q", "int64_t": "q", "double": "d",
}  # fmt: skip


class WideField(msgspec.Struct, array_like=True, frozen=True):
    kind: str  # MAVLink type, without the array length
    name: str
    array: int  # number of elements; 0: no array
    extension: bool  # whether the field follows the sorted fields and is not in CRC_EXTRA

    @property
    def size(self) -> int:
        return struct.calcsize(f"<{CODES[self.kind]}")

    @property
    def code(self) -> str:
        code = CODES[self.kind]
        if not self.array:
            return code
        return f"{self.array}s" if self.kind == "char" else f"{self.array}{code}"


class Definition(msgspec.Struct, array_like=True, frozen=True):
    """A message of the table; its fields have the order of the XML definition, not that of the wire."""

    id: int
    name: str
    crc_extra: int
    fields: tuple[WideField, ...]

    @property
    def on_the_wire(self) -> list[WideField]:
        """Fields in wire order: sorted by size, then extensions (MAVLink serialization guide)."""
        extensions = [field for field in self.fields if field.extension]
        rest = [field for field in self.fields if not field.extension]
        return [*sorted(rest, key=lambda field: -field.size), *extensions]


class _Table(msgspec.Struct):
    messages: list[Definition]  # messages in ascending order of id


def definitions() -> list[Definition]:
    data = files("bridge.mavlink.codec").joinpath("wide_messages.json").read_bytes()
    return msgspec.json.decode(data, type=_Table).messages


def make_class(definition: Definition) -> Any:
    """Make a message class with the attributes of pymavlink's generated classes."""
    wire = definition.on_the_wire
    names = [field.name for field in definition.fields]

    def init(self: Any, *values: Any, **named: Any) -> None:
        dialect.MAVLink_message.__init__(self, definition.id, definition.name)
        self._fieldnames, self._instance_field, self._instance_offset = names, None, -1
        given = {**dict(zip(names, values, strict=False)), **named}
        if len(values) > len(names) or len(given) < len(values) + len(named) or set(given) != set(names):
            raise TypeError(f"{definition.name} has the fields {', '.join(names)}")
        for field in definition.fields:
            value = given[field.name]
            if field.kind == "char":
                setattr(self, f"_{field.name}_raw", value)
                value = value.split(b"\x00", 1)[0].decode("ascii", errors="replace")
            setattr(self, field.name, value)

    unpacker = struct.Struct("<" + "".join(field.code for field in wire))
    return type(
        f"MAVLink_{definition.name.lower()}_message",
        (dialect.MAVLink_message,),
        {
            "__init__": init,
            "id": definition.id,
            "msgname": definition.name,
            "fieldnames": names,
            "ordered_fieldnames": [field.name for field in wire],
            "fieldtypes": [field.kind for field in definition.fields],
            "fielddisplays_by_name": {},
            "fieldenums_by_name": {},
            "fieldunits_by_name": {},
            "native_format": bytearray(b"<" + "".join(CODES[field.kind] for field in wire).encode()),
            "orders": [wire.index(field) for field in definition.fields],
            "lengths": [1 if field.kind == "char" else max(1, field.array) for field in wire],
            "array_lengths": [field.array for field in wire],
            "crc_extra": definition.crc_extra,
            "unpacker": unpacker,
            "instance_field": None,
            "instance_offset": -1,
        },
    )


# All known messages by id: pymavlink's, then those of the table.
MESSAGES: dict[int, Any] = dialect.mavlink_map
MESSAGES.update({d.id: make_class(d) for d in definitions()})

# CRC_EXTRA of every known message: the checksum also covers the message's definition.
CRC_EXTRA: dict[int, bytes] = {id_: bytes([cls.crc_extra]) for id_, cls in MESSAGES.items()}
# CRC-16/MCRF4XX by the package fastcrc; without a build of it, by pymavlink's slow class.
checksum = dialect.mcrf4xx or (lambda data: dialect.x25crc(data).crc)

Message = Any  # an instance of one of pymavlink's generated classes, which have no type hints


def message_id(frame: bytes) -> int:
    return frame[7] | frame[8] << 8 | frame[9] << 16


def parameter_name(field: str | bytes) -> str:
    """Return a parameter's name up to its first zero byte; bytes that are not ASCII become U+FFFD."""
    raw = field.encode("latin-1", "replace") if isinstance(field, str) else bytes(field)
    return raw.partition(b"\x00")[0].decode("ascii", "replace")


def decode(frame: bytes) -> Message:
    """Decode one frame of ``split_frames``. Raises the error of a message class that rejects its values."""
    return _DECODER.decode(bytearray(frame))


_DECODER = dialect.MAVLink(None)

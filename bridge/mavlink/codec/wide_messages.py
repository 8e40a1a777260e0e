"""Classes for MAVLink messages that pymavlink's dialect ``ardupilotmega`` lacks, in pymavlink's form.

``wide_messages.csv`` holds them: the additional messages of pymavlink's dialect ``all`` (which takes 0.6 s to
load), and messages of MAVLink's ``common`` that PX4 sends and pymavlink lacks. ``python -m tests.tables
messages`` updates the first group and keeps the second.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from importlib.resources import files
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

# MAVLink type to ``struct`` code
CODES = {
    "char": "c", "uint8_t": "B", "int8_t": "b", "uint16_t": "H", "int16_t": "h", "uint32_t": "I",
    "int32_t": "i", "float": "f", "uint64_t": "Q", "int64_t": "q", "double": "d",
}  # fmt: skip


class WideField(NamedTuple):
    kind: str  # MAVLink type, without the array length
    name: str
    array: int  # number of elements; 0: no array
    extension: bool  # sent after the sorted fields, not in CRC_EXTRA

    @property
    def size(self) -> int:
        return struct.calcsize(f"<{CODES[self.kind]}")

    @property
    def code(self) -> str:
        code = CODES[self.kind]
        if not self.array:
            return code
        return f"{self.array}s" if self.kind == "char" else f"{self.array}{code}"


class Definition(NamedTuple):
    """One line of the table; its fields have the order of the XML definition, not that of the wire."""

    id: int
    name: str
    crc_extra: int
    fields: tuple[WideField, ...]

    @classmethod
    def parse(cls, line: str) -> Definition:
        """Read ``id;name;crc_extra;type name;...``: ``type[n]`` is an array, ``+type`` an extension.

        Raises ValueError: the line has another form, or a type is unknown.
        """
        id_, name, crc_extra, *fields = line.split(";")
        return cls(int(id_), name, int(crc_extra), tuple(_field(text) for text in fields))

    @property
    def on_the_wire(self) -> list[WideField]:
        """Fields in wire order: sorted by size, then extensions (MAVLink serialization guide)."""
        extensions = [field for field in self.fields if field.extension]
        rest = [field for field in self.fields if not field.extension]
        return [*sorted(rest, key=lambda field: -field.size), *extensions]


def definitions() -> Iterator[Definition]:
    """Read the table; yield one definition per message, in ascending order of id."""
    text = files("bridge.mavlink.codec").joinpath("wide_messages.csv").read_text(encoding="ascii")
    for line in text.splitlines():
        if line and not line.startswith("#"):
            yield Definition.parse(line)


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


def _field(text: str) -> WideField:
    kind, _, name = text.removeprefix("+").partition(" ")
    kind, _, array = kind.removesuffix("]").partition("[")
    if kind not in CODES or not name:
        raise ValueError(f"field {text!r} of a MAVLink message: allowed are the types {', '.join(CODES)}")
    return WideField(kind, name, int(array or 0), text.startswith("+"))


# All known messages by id: pymavlink's, then those of the table.
MESSAGES: dict[int, Any] = {**dialect.mavlink_map, **{d.id: make_class(d) for d in definitions()}}

"""ROS message types of decoded MAVLink messages, made from pymavlink's message classes.

``LOCAL_POSITION_NED`` becomes ``mavlink_msgs/msg/LocalPositionNed``: a header and the message's fields in the
order of the wire, in the units of MAVLink. Names become lower case, which ROS asks for; text of fixed length
becomes a string. In the order of the wire (sorted by size, MAVLink serialization guide) most payloads are
valid CDR as they are.
"""

from __future__ import annotations

import struct
from functools import cache
from typing import Any, NamedTuple

PACKAGE = "mavlink_msgs/msg/"
_ROS = {
    "char": ("uint8", "B", 1),
    "uint8_t": ("uint8", "B", 1),
    "int8_t": ("int8", "b", 1),
    "uint16_t": ("uint16", "H", 2),
    "int16_t": ("int16", "h", 2),
    "uint32_t": ("uint32", "I", 4),
    "int32_t": ("int32", "i", 4),
    "float": ("float32", "f", 4),
    "uint64_t": ("uint64", "Q", 8),
    "int64_t": ("int64", "q", 8),
    "double": ("float64", "d", 8),
}


class Field(NamedTuple):
    """One field of a message, in the order of the wire."""

    name: str  # as in ROS
    kind: str  # ROS primitive type; "string" for text
    code: str  # of ``struct``
    size: int  # bytes of one element
    array: int  # elements; 0: no array
    comment: str  # unit or enumeration


class Type(NamedTuple):
    """One MAVLink message as a ROS type."""

    message: str  # LOCAL_POSITION_NED
    schema: str  # mavlink_msgs/msg/LocalPositionNed
    fields: tuple[Field, ...]
    size: int  # bytes of the whole payload
    verbatim: bool  # the payload, with its cut zeros, is the body of the CDR


def numbers() -> list[int]:
    """Return the numbers of all messages of the dialect."""
    return sorted(_dialect())


@cache
def of(number: int) -> Type | None:
    """Return the message with a number; None if the dialect has none."""
    cls = _dialect().get(number)
    return None if cls is None else _type(cls)


def definition(schema: str) -> str:
    """Return the ``.msg`` text of a type."""
    made = _type(_dialect()[_numbers()[schema]])
    lines = [
        f"# MAVLink {made.message}, fields in the order of the wire.",
        "",
        "std_msgs/Header header  # stamp = of the raw frame, frame_id = name of its peer",
    ]
    for field in made.fields:
        array = f"[{field.array}]" if field.array and field.kind != "string" else ""
        comment = f"  # {field.comment}" if field.comment else ""
        lines.append(f"{field.kind}{array} {field.name}{comment}")
    return "\n".join(lines) + "\n"


@cache
def _dialect() -> dict[int, Any]:
    """Classes of all known messages by number; imported when first needed, since that takes a while."""
    from bridge.mavlink.codec.wide_messages import MESSAGES

    return MESSAGES


@cache
def _numbers() -> dict[str, int]:
    return {_schema(cls.msgname): number for number, cls in _dialect().items()}


def _schema(message: str) -> str:
    return PACKAGE + "".join(word.capitalize() for word in message.split("_"))


def _type(cls: Any) -> Type:
    """Read one of pymavlink's message classes."""
    kinds = dict(zip(cls.fieldnames, cls.fieldtypes, strict=True))
    # A scalar has length 1 and array length 0; both lists are in the order of the wire.
    counts = zip(cls.ordered_fieldnames, cls.lengths, cls.array_lengths, strict=True)
    fields, verbatim, at = [], True, 0
    for name, length, array in counts:
        kind, code, size = _ROS[kinds[name]]
        text = kinds[name] == "char" and array > 0
        comment = cls.fieldunits_by_name.get(name) or cls.fieldenums_by_name.get(name) or ""
        comment = comment.encode("ascii", "replace").decode()
        fields.append(Field(name.lower(), "string" if text else kind, code, size, array, comment))
        verbatim = verbatim and not text and at % size == 0
        at += size * max(1, length)
    layout: struct.Struct = cls.unpacker
    return Type(cls.msgname, _schema(cls.msgname), tuple(fields), layout.size, verbatim)
